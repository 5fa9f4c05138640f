"""Constants that seem to mean no data, though nobody says so: -9999, -32768, 65535, 1e10, 0 where all else is above.

Examples
--------
>>> heights = np.append(np.linspace(200, 300, 50), [-9999, -9999])
>>> note_placeholders(heights, "dem.tif")
['2 of 52 values in dem.tif are -9999, far from all others, 200 to 300: if it means no data, say missing=[-9999].']
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

_FEWEST = 10
"""Among fewer values nothing is far from the others."""

_FAR, _FAR_ALONE = 1, 100
"""How many times the range of all others one constant is away from them, or one single value."""

_USUAL = {-9999.0, -99999.0, -32768.0, -32767.0, 65535.0, 1e10, 1e20, float(np.finfo("f4").min)}
"""What stands for no data in many files: at half the range from all others it seems to, also alone."""

_HALF = 0.5

_APART = 10
"""How many times the usual step from one value to the next 0 is away from the smallest."""


class _Placeholder(NamedTuple):
    value: float
    times: int
    low: float
    high: float


def note_placeholders(numbers: NDArray[Any], place: str) -> list[str]:
    """Return a sentence on each constant that lies far outside of all other values.

    Parameters
    ----------
    numbers : array, (n,) or (n, d)
        Finite numbers as they stand in the file; columns are looked at one by one.
    place : str
        What the sentence calls the file.

    Examples
    --------
    >>> note_placeholders(np.append(np.linspace(0.5, 3, 60), 0), "depth.tif")
    ['1 of 61 values in depth.tif are 0, far from all others, 0.5 to 3: if it means no data, say missing=[0].']
    >>> note_placeholders(np.linspace(0, 3, 60), "ramp.tif")
    []
    """
    found = dict[float, _Placeholder]()
    for column in np.atleast_2d(numbers.T):
        left = column
        while (one := _outlying(left)) is not None:
            found.setdefault(one.value, one)
            left = left[left != one.value]
    return [
        f"{one.times} of {len(numbers)} values in {place} are {one.value:.17g}, far from all others, {one.low:.6g} to "
        f"{one.high:.6g}: if it means no data, say missing=[{one.value:.17g}]."
        for one in found.values()
    ]


def _outlying(column: NDArray[Any]) -> _Placeholder | None:
    """Return the smallest or the largest value of a column, if it lies far outside of all others."""
    if len(column) <= _FEWEST:
        return None
    for value in (column.min(), column.max()):
        others = column[column != value]
        if len(others) < _FEWEST:
            continue
        one = _Placeholder(float(value), len(column) - len(others), float(others.min()), float(others.max()))
        gap = max(one.low - one.value, one.value - one.high)
        if one.value in _USUAL:
            seems = gap > _HALF * (one.high - one.low)
        elif one.low == one.high:  # of two values, neither is far from the other
            seems = False
        else:
            seems = gap > (one.high - one.low) * (_FAR if one.times > 1 else _FAR_ALONE)
            seems |= one.value == 0 < one.low and _apart(others)
        if seems:
            return one
    return None


def _apart(values: NDArray[Any]) -> bool:
    """Tell whether positive values begin farther from 0 than they usually are from one another."""
    steps = np.diff(np.unique(values))
    return bool(values.min() > _APART * (np.median(steps) if len(steps) else 0))
