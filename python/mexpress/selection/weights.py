"""The weights of the bending energy to try: one, several, or automatic ones."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.selection.defaults import AUTO, is_automatic

_WEIGHTS = 20
"""Number of weights that "auto" tries."""

_STIFFEST, _LOOSEST = 100.0, 1e-3
"""Largest and smallest weight that "auto" tries, in units of n x area; the smallest is also divided by the square
of the largest count. A wave of unit amplitude and wavenumber k has the bending energy k^4 a / 16 pi over an area a, and
its squares at n data sum to n / 2. Both are equal at the weight 8 pi n / (k^4 a): about 0.3 n a for waves as wide as
the domain, and 0.3 n a / l^2 for the shortest waves of l control points. Weights outside this range change little."""


def several_weights(smoothing: float | ArrayLike | str) -> bool:
    """Return whether there is more than one weight to try."""
    return len(smoothing_weights(smoothing, 1.0, 1.0, 1)) > 1


def tie_slack(smoothing: Any, n: int) -> float:
    """Return the fraction of the best score within which scores are ties; 0 without an automatic weight.

    Sums of squared prediction errors count as equal if they differ by less than 1/n.

    Examples
    --------
    >>> tie_slack(0.0, 50), round(tie_slack("auto", 50), 4)
    (0.0, 0.01)
    """
    return math.sqrt(1 + 1 / n) - 1 if is_automatic(smoothing) else 0.0


def smoothing_weights(smoothing: float | ArrayLike | str, n: float, area: float, largest: int) -> Floats:
    """Return the weights to try, increasing: those given or, with "auto", twenty between the limits above.

    Parameters
    ----------
    smoothing : float, list of float, or "auto"
        Weights of at least 0.
    n : float
        Number of data, or the sum of their weights.
    area : float
        Area of the region that they cover.
    largest : int
        Number of control points of the largest model.

    Examples
    --------
    >>> smoothing_weights([10, 1], 50, 1e4, 20), smoothing_weights("auto", 100, 1e4, 50).shape
    (array([ 1., 10.]), (20,))
    """
    if is_automatic(smoothing):
        unit = n * area
        weights = unit * np.geomspace(_LOOSEST / largest**2, _STIFFEST, _WEIGHTS)
        return np.clip(weights, np.finfo(float).tiny, np.finfo(float).max)
    rule = 'It must be a number of at least 0, a list of such numbers, or "auto".'
    if isinstance(smoothing, str):
        check.refuse("smoothing", rule + check.nearest_name(smoothing, [AUTO]), check.describe(smoothing))
    if check.array(smoothing, "smoothing", rule).ndim == 0:
        return np.array([check.number(smoothing, "smoothing", rule, 0.0)])
    several = check.real(smoothing, "smoothing")
    if several.ndim != 1 or several.size == 0:
        check.refuse("smoothing", rule, check.describe(smoothing))
    several = check.finite(several, "smoothing")
    return np.unique([check.number(weight, "smoothing", rule, 0.0) for weight in several.tolist()])
