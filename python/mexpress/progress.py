"""Progress of long work: on one line of standard error, or in a bar of the user's own.

Whoever has work to show takes a `Show`, which `shown` makes of an argument ``progress``: True, False, or what makes a
bar, such as the class ``tqdm.tqdm``. It is called with ``total``, the number of steps, and ``desc``, what they are;
what it returns has ``update``, which is called with 1 after each step, and ``close``, which is called at the end, after
an error, too. What they raise ends the work.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from itertools import accumulate
from typing import Any, TextIO, TypeAlias

from mexpress import _validation as check

Show: TypeAlias = Callable[[Sequence[float]], AbstractContextManager[Callable[[], None]]]
"""Takes the cost of every step, and yields a function to call after each."""

_PATIENCE = 1.0
"""Seconds before progress is shown: short work needs none."""

_TERMINAL_PERIOD = 0.1
_LOG_PERIOD = 5.0
"""Seconds between lines in a log, which grows; a line on a terminal is redrawn."""

_CELLS = 24


def hidden(costs: Sequence[float]) -> AbstractContextManager[Callable[[], None]]:
    """Show nothing."""
    return nullcontext(lambda: None)


def shown(progress: bool | Callable[..., Any], label: str) -> Show:
    """Return what shows the progress of work called `label`, as `progress` says.

    Examples
    --------
    >>> class Meter:
    ...     def __init__(self, total, desc):
    ...         print(f"{desc}: {total} steps")
    ...     def update(self, number):
    ...         print(f"{number} done")
    ...     def close(self):
    ...         print("closed")
    >>> with shown(Meter, "warps")([1, 4]) as step:
    ...     step()
    warps: 2 steps
    1 done
    closed
    """
    if callable(progress):
        return partial(_others, progress, label)
    rule = "It must be True, False, or what makes a bar, such as tqdm.tqdm."
    return partial(bar, label=label) if check.flag(progress, "progress", rule) else hidden


@contextmanager
def _others(make: Callable[..., Any], label: str, costs: Sequence[float]) -> Iterator[Callable[[], None]]:
    """Show progress in a bar that the user's callable makes."""
    made = make(total=len(costs), desc=label)
    if not all(callable(getattr(made, name, None)) for name in ("update", "close")):
        rule = "What it makes must have update and close, as a bar of tqdm has."
        check.refuse("progress", rule, check.describe(made), TypeError)
    try:
        yield lambda: made.update(1)
    finally:
        made.close()


@contextmanager
def bar(
    costs: Sequence[float],
    label: str,
    stream: TextIO | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> Iterator[Callable[[], None]]:
    """Show the progress of work called `label`; yields a function to call after each step.

    `costs` has a number for each step, in any unit: the time that is left is what the costs so far have taken for what
    is left of them.

    Nothing is shown in the first second. After that, a terminal shows one line that is redrawn, and wiped at the end.
    Any other stream, such as a log file, gets a line every five seconds. The stream is standard error by default;
    without one (`sys.stderr` may be None), nothing is shown. `clock` returns the time in seconds.

    Examples
    --------
    >>> with bar([1, 1, 4], "warps") as step:
    ...     for _ in range(3):
    ...         step()
    """
    line = _Line(costs, label, stream or sys.stderr, clock)
    try:
        yield line.step
    finally:
        line.wipe()


class _Line:
    def __init__(
        self, costs: Sequence[float], label: str, stream: TextIO | None, clock: Callable[[], float]
    ) -> None:
        self.label, self.stream, self.clock = label, stream, clock
        self.total, self.done = len(costs), 0
        self.reached = list(accumulate(costs, initial=0.0))
        self.start = clock()
        self.next = self.start + _PATIENCE
        self.terminal = stream is not None and stream.isatty()
        self.width = 0

    def step(self) -> None:
        self.done += 1
        now = self.clock()
        if self.stream is None or now < self.next:
            return
        self.next = now + (_TERMINAL_PERIOD if self.terminal else _LOG_PERIOD)
        text = self.text(now - self.start)
        if self.terminal:
            self.stream.write("\r" + text.ljust(self.width))
            self.width = len(text)
        else:
            self.stream.write(text + "\n")
        self.stream.flush()

    def text(self, elapsed: float) -> str:
        share = self.reached[min(self.done, self.total)] / self.reached[-1]
        left = elapsed / share - elapsed
        counted = f"{self.label}: {self.done} of {self.total}, {_duration(left)} left"
        if not self.terminal:
            return counted
        full = int(share * _CELLS)
        return f"[{'#' * full}{'.' * (_CELLS - full)}] {counted}"

    def wipe(self) -> None:
        if self.stream is not None and self.width:
            self.stream.write("\r" + " " * self.width + "\r")
            self.stream.flush()


def _duration(seconds: float) -> str:
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
