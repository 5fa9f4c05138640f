"""Scales of axes: where values are on the page, and at which of them there are ticks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

_TICKS = 6
"""So many ticks along an axis, or a few more if it is logarithmic."""


@dataclass(frozen=True)
class Scale:
    """An axis from one value to another, at two places of the page.

    Examples
    --------
    >>> Scale(0, 10, 100, 200)(5)
    150.0
    >>> Scale(0, 10, 100, 200).ticks()
    [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    >>> Scale(0.4, 30, 0, 1, logarithmic=True).ticks()
    [0.5, 1.0, 2.0, 5.0, 10.0, 20.0]
    """

    low: float
    high: float
    start: float
    stop: float
    logarithmic: bool = False

    def __call__(self, value: float) -> float:
        """Return where a value is."""
        share = (self._even(value) - self._even(self.low)) / (
            (self._even(self.high) - self._even(self.low)) or 1.0
        )
        return self.start + share * (self.stop - self.start)

    def _even(self, value: float) -> float:
        return math.log(value) if self.logarithmic else float(value)

    def ticks(self, most: int = _TICKS) -> list[float]:
        """Return round values, from low to high, about so many."""
        return self._powers() if self.logarithmic else self._steps(most)

    def _steps(self, most: int) -> list[float]:
        span = self.high - self.low
        if not span > 0:
            return [self.low]
        rough = span / most
        power = 10.0 ** math.floor(math.log10(rough))
        step = power * next(part for part in (1, 2, 5, 10) if part * power >= (1 - 1e-9) * rough)
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        return [k * step for k in range(first, last + 1)]

    def _powers(self) -> list[float]:
        decades = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
        for parts in ((1, 2, 5), (1,)):
            found = [
                part * 10.0**k
                for k in decades
                for part in parts
                if self.low <= part * 10.0**k * (1 + 1e-9) and part * 10.0**k <= self.high * (1 + 1e-9)
            ]
            if len(found) <= _TICKS + 4:
                break
        return found[:: max(1, -(-len(found) // (_TICKS + 4)))]


def written(values: Sequence[float]) -> list[str]:
    """Return ticks as text, alike.

    Examples
    --------
    >>> written([0.0, 0.5, 1.0]), written([1e6, 2e6])
    (['0', '0.5', '1'], ['1e+06', '2e+06'])
    """
    return [f"{0.0 if abs(value) < 1e-12 * max(map(abs, values)) else value:.6g}" for value in values]
