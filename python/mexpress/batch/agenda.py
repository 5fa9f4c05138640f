"""What is left to do: problems wait here, come back, and are settled."""

from __future__ import annotations

import heapq
import math
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any

from mexpress.batch.calls import Failure, Outcome
from mexpress.logger import LOG

TICK = 1.0
"""Seconds between looks at workers that say nothing; on Windows, Ctrl-C is heard between waits only."""

SPELL = 0.1
"""Seconds of work that a worker is given at once, and after which it gives back what it has not begun."""

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

    def __init__(self, indices: Iterable[int], number: int, retries: int, raising: bool) -> None:
        self.waiting = list(indices)  # in order, and so a heap
        self.unsettled = set(self.waiting)
        self.number, self.retries, self.raising = number, retries, raising
        self.suspects: list[int] = []
        self.alone: set[int] = set()
        self.tries: Counter[int] = Counter()
        self.pace = math.inf
        self.failures: set[int] = set()
        self.first: Failure | None = None

    def take(self, workers: int) -> list[int]:
        """Return problems for one of so many workers: so many as fill a spell, and leave enough for the others."""
        if self.suspects:
            return [heapq.heappop(self.suspects)]
        share = math.ceil(len(self.waiting) / (2 * workers))
        most = max(1, min(share, int(SPELL / max(self.pace, 1e-9))))
        return [heapq.heappop(self.waiting) for _ in range(min(most, len(self.waiting)))]

    def learn(self, number: int, seconds: float) -> None:
        """Take how long a worker took for so many problems."""
        if number:
            self.pace = seconds / number

    def put_back(self, indices: Iterable[int]) -> None:
        """Let problems wait again."""
        for index in indices:
            if index in self.unsettled:
                heapq.heappush(self.waiting, index)

    def suspect(self, indices: Iterable[int]) -> None:
        """Let problems wait, each to be taken alone, before others: one of them makes trouble."""
        for index in indices:
            if index in self.unsettled:
                self.alone.add(index)
                heapq.heappush(self.suspects, index)

    def settle(self, index: int, outcome: Outcome) -> Iterator[tuple[int, Any]]:
        """Take the outcome of a call; return its result, or its failure, unless it is tried again."""
        done, value = outcome
        self.alone.discard(index)
        if done:
            self.unsettled.discard(index)
            yield index, value
        else:
            yield from self._fail(value, self.retries)

    def lose(self, index: int, error: RuntimeError) -> Iterator[tuple[int, Any]]:
        """Take that the process of a problem has ended."""
        yield from self._fail(Failure(index, error), max(self.retries, _PATIENCE))

    def _fail(self, failure: Failure, allowed: int) -> Iterator[tuple[int, Any]]:
        index = failure.index
        self.tries[index] += 1
        what = f"problem {index}: {failure.error!r}"
        if index in self.unsettled and self.tries[index] <= allowed:
            LOG.warning("Try %d of %d of %s", self.tries[index], allowed + 1, what)
            self.put_back([index])
            return
        LOG.warning("No result of %s", what)
        self.failures.add(index)
        self.unsettled.discard(index)
        if not self.raising:
            yield index, failure
        elif self.first is None or index < self.first.index:
            self.first = failure
            self.unsettled = {other for other in self.unsettled if other < index}
            self.waiting = [other for other in sorted(self.waiting) if other < index]
            self.suspects = [other for other in sorted(self.suspects) if other < index]
            self.alone &= self.unsettled

    def conclude(self) -> None:
        """Raise the error of the first problem that failed, if errors are to be raised."""
        if self.first is not None:
            error = self.first.error
            error.add_note(f"This was problem {self.first.index} (from 0) of {self.number}.")
            if error.__traceback__ is None and self.first.traceback:
                error.__cause__ = RemoteTraceback(self.first.traceback)
            raise error
