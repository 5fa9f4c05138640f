"""The weight of the bending energy: one, several, or as many as it takes to find the best.

Examples
--------
>>> from mexpress.selection.weights import weights_of
>>> weights_of([10, 1], 50, 1e4, 20)
array([ 1., 10.])
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats

__all__ = ["AUTO", "is_auto", "weights_of"]

AUTO = "auto"

_WEIGHTS = 20
"""How many weights "auto" tries."""

_STIFFEST, _LOOSEST = 100.0, 1e-3
"""Of what "auto" tries, in units of n times the area of the domain; the loosest is divided by the number of control
points squared. The bending energy of a wave of unit amplitude, k radians a length, over an area a is k^4 a / 16 pi,
and n data resist it with n / 2: the weight at which both are equal is 8 pi n / (k^4 a), from about 0.3 n a for waves
as wide as the domain down to 0.3 n a / l^2 for the shortest that l control points make. Beyond, little changes."""


def is_auto(smoothing: Any) -> bool:
    """Tell whether the weight is left to the library.

    Examples
    --------
    >>> is_auto("auto"), is_auto(0.0)
    (True, False)
    """
    return isinstance(smoothing, str) and smoothing == AUTO


def weights_of(smoothing: float | ArrayLike | str, n: int, area: float, largest: int) -> Floats:
    """Return the weights that are to be tried, increasing.

    Parameters
    ----------
    smoothing : float, list of float, or "auto"
        A weight, weights, or what is said above.
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
    >>> weights_of("auto", 100, 1e4, 50).shape
    (20,)
    """
    if is_auto(smoothing):
        unit = n * area
        weights = unit * np.geomspace(_LOOSEST / largest**2, _STIFFEST, _WEIGHTS)
        return np.clip(weights, np.finfo(float).tiny, np.finfo(float).max)
    rule = 'It must be a number of at least 0, a list of such numbers, or "auto".'
    if isinstance(smoothing, str):
        check.refuse("smoothing", rule, check.describe(smoothing))
    if check.array(smoothing, "smoothing", rule).ndim == 0:
        return np.array([check.number(smoothing, "smoothing", rule, 0.0)])
    listed = check.real(smoothing, "smoothing")
    if listed.ndim != 1 or listed.size == 0:
        check.refuse("smoothing", rule, check.describe(smoothing))
    listed = check.finite(listed, "smoothing")
    return np.unique([check.number(weight, "smoothing", rule, 0.0) for weight in listed.tolist()])
