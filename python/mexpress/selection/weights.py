"""The weight of the bending energy: one, several, or as many as it takes to find the best.

Examples
--------
>>> smoothing_weights([10, 1], 50, 1e4, 20)
array([ 1., 10.])
"""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats

AUTO = "auto"

_WEIGHTS = 20
"""How many weights "auto" tries."""

_MOST_PARAMETERS = 900
"""Of a design whose stiffness is found automatically: the time grows with their cube."""

_STIFFEST, _LOOSEST = 100.0, 1e-3
"""Largest and smallest weight that "auto" tries, in units of n x area; the smallest is divided by the square of the
largest count too. The bending energy of a wave of unit amplitude, k radians a length, over an area a is k^4 a / 16 pi,
and n data resist it with n / 2: the weight at which both are equal is 8 pi n / (k^4 a), from about 0.3 n a for waves
as wide as the domain down to 0.3 n a / l^2 for the shortest that l control points make. Beyond, little changes."""


def several_weights(smoothing: float | ArrayLike | str) -> bool:
    """Tell whether more than one weight is to be tried.

    Examples
    --------
    >>> several_weights("auto"), several_weights([1.0, 1.0])
    (True, False)
    """
    return len(smoothing_weights(smoothing, 1, 1.0, 1)) > 1


def tie_slack(smoothing: Any, n: int) -> float:
    """Return the fraction of the best score within which scores are ties, with an automatic weight.

    Sums of squared prediction errors count as equal if they differ by less than 1/n.

    Examples
    --------
    >>> tie_slack(0.0, 50), round(tie_slack("auto", 50), 4)
    (0.0, 0.01)
    """
    return math.sqrt(1 + 1 / n) - 1 if is_automatic(smoothing) else 0.0


def largest_automatic_count(n: int, functions: int) -> int:
    """Return the most control points that an automatic weight needs: one a datum, unless unknowns become too many.

    Parameters
    ----------
    n : int
        Number of data.
    functions : int
        How many functions share a design: three of a fractional warp, otherwise one.

    Examples
    --------
    >>> largest_automatic_count(60, 3), largest_automatic_count(5000, 3)
    (60, 300)
    """
    return max(3, min(n, _MOST_PARAMETERS // functions))


def is_automatic(smoothing: Any) -> bool:
    """Tell whether the weight is left to the library.

    Examples
    --------
    >>> is_automatic("auto"), is_automatic(0.0)
    (True, False)
    """
    return isinstance(smoothing, str) and smoothing == AUTO


def smoothing_weights(smoothing: float | ArrayLike | str, n: int, area: float, largest: int) -> Floats:
    """Return the weights that are to be tried, increasing.

    Parameters
    ----------
    smoothing : float, list of float, or "auto"
        A weight, weights, or "auto" for twenty between the two that are explained above.
    n : int
        Number of data.
    area : float
        Of the region that they cover.
    largest : int
        Number of control points of the largest model.

    Raises
    ------
    ValueError, TypeError
        If a weight is no finite number of at least 0, or there is none.

    Examples
    --------
    >>> smoothing_weights("auto", 100, 1e4, 50).shape
    (20,)
    """
    if is_automatic(smoothing):
        unit = n * area
        weights = unit * np.geomspace(_LOOSEST / largest**2, _STIFFEST, _WEIGHTS)
        return np.clip(weights, np.finfo(float).tiny, np.finfo(float).max)
    rule = 'It must be a number of at least 0, a list of such numbers, or "auto".'
    if isinstance(smoothing, str):
        check.refuse("smoothing", rule, check.describe(smoothing))
    if check.array(smoothing, "smoothing", rule).ndim == 0:
        return np.array([check.number(smoothing, "smoothing", rule, 0.0)])
    several = check.real(smoothing, "smoothing")
    if several.ndim != 1 or several.size == 0:
        check.refuse("smoothing", rule, check.describe(smoothing))
    several = check.finite(several, "smoothing")
    return np.unique([check.number(weight, "smoothing", rule, 0.0) for weight in several.tolist()])
