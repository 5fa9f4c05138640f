"""What is left to do: problems wait here, come back, and are settled."""

from __future__ import annotations

import math
from bisect import insort
from collections import Counter
from collections.abc import Callable, Iterable
from operator import neg
from typing import Any, TypeAlias

from mexpress.batch.calls import Failure, Outcome, failed
from mexpress.logger import LOG

TICK = 1.0
"""Seconds between looks at workers that say nothing; on Windows, Ctrl-C is heard between waits only."""

Results: TypeAlias = list[tuple[int, Any]]
"""What came of problems at the same time, each with its index."""

Keep: TypeAlias = Callable[[Results], list[tuple[int, Exception]]]
"""Keeps results in a file; returns those that it cannot keep, with the reasons."""

_LEAST = 0.003
"""Seconds of work that are not divided among workers: to send so little takes as long."""

_PATIENCE = 2
"""How often a problem is repeated whose process was ended: as a rule by somebody or something else."""


class RemoteTraceback(Exception):  # noqa: N818 - it is a cause, to be printed above the error itself
    """Where an error was raised in another process."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


class Agenda:
    """The problems that wait, by their indices, and those that are not settled, here or with a worker.

    If `raising`, a failure bounds what is left: problems before it are still done, later ones are not begun.
    """

    def __init__(
        self, indices: Iterable[int], number: int, retries: int, raising: bool, keep: Keep | None = None
    ) -> None:
        self.waiting = sorted(indices, reverse=True)  # the next one is the last: it leaves no gap
        self.unsettled = set(self.waiting)
        self.number, self.retries, self.raising, self.keep = number, retries, raising, keep
        self.suspects: list[int] = []
        self.alone: set[int] = set()
        self.tries: Counter[int] = Counter()
        self.pace = math.inf
        self.failures: set[int] = set()
        self.first: Failure | None = None

    def take(self, workers: int, spell: float, room: Callable[[int], int] | None = None) -> list[int]:
        """Return problems for one of so many workers: what fills so many seconds, and leaves enough for the others.

        There are no more than have room if all are like the first.
        """
        if self.suspects:
            return [self.suspects.pop()]
        share = math.ceil(len(self.waiting) / (2 * workers))
        pace = max(self.pace, 1e-9)
        most = max(1, min(max(share, int(_LEAST / pace)), int(spell / pace)))
        if room and self.waiting:
            most = min(most, room(self.waiting[-1]))
        taken = self.waiting[: -most - 1 : -1]
        del self.waiting[-most:]
        return taken

    def learn(self, number: int, seconds: float) -> None:
        """Take how long a worker took for so many problems."""
        if number:
            self.pace = seconds / number

    def put_back(self, indices: Iterable[int]) -> None:
        """Let problems wait again."""
        for index in indices:
            if index in self.unsettled:
                insort(self.waiting, index, key=neg)

    def suspect(self, indices: Iterable[int]) -> None:
        """Let problems wait, each to be taken alone, before others: one of them makes trouble."""
        for index in indices:
            if index in self.unsettled:
                self.alone.add(index)
                insort(self.suspects, index, key=neg)

    def settle(self, outcomes: Iterable[tuple[int, Outcome]]) -> Results:
        """Take the outcomes of calls; return the results, and the failures that are not tried again."""
        results, failures = [], []
        for index, (done, value) in outcomes:
            if done:
                results.append((index, value))
            else:
                failures.append(value)
        if self.keep and results:
            refused = dict(self.keep(results))
            failures += [failed(index, error)[1] for index, error in refused.items()]
            results = [(index, value) for index, value in results if index not in refused]
        settled = [index for index, _ in results]
        self.unsettled.difference_update(settled)
        self.alone.difference_update(settled)
        for failure in failures:
            self.alone.discard(failure.index)
            results += self._fail(failure, self.retries)
        return results

    def lose(self, index: int, error: RuntimeError) -> Results:
        """Take that the process of a problem has ended."""
        return self._fail(Failure(index, error), max(self.retries, _PATIENCE))

    def _fail(self, failure: Failure, allowed: int) -> Results:
        index = failure.index
        self.tries[index] += 1
        what = f"problem {index}: {failure.error!r}"
        if index in self.unsettled and self.tries[index] <= allowed:
            LOG.warning("Try %d of %d of %s", self.tries[index], allowed + 1, what)
            self.put_back([index])
            return []
        LOG.warning("No result of %s", what)
        self.failures.add(index)
        self.unsettled.discard(index)
        if not self.raising:
            return [(index, failure)]
        if self.first is None or index < self.first.index:
            self.first = failure
            self.unsettled = {other for other in self.unsettled if other < index}
            self.waiting = [other for other in self.waiting if other < index]
            self.suspects = [other for other in self.suspects if other < index]
            self.alone &= self.unsettled
        return []

    def conclude(self) -> None:
        """Raise the error of the first problem that failed, if errors are to be raised."""
        if self.first is not None:
            error = self.first.error
            error.add_note(f"This was problem {self.first.index} (from 0) of {self.number}.")
            if error.__traceback__ is None and self.first.traceback:
                error.__cause__ = RemoteTraceback(self.first.traceback)
            raise error
