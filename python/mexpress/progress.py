"""Progress of long work, on one line of standard error."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import accumulate
from typing import TextIO

_PATIENCE = 1.0
"""Seconds before progress is shown: short work needs none."""

_TERMINAL_PERIOD = 0.1
_LOG_PERIOD = 5.0
"""Seconds between lines in a log, which grows; a line on a terminal is redrawn."""

_CELLS = 24


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
