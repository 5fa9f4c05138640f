"""A model's local-exclusion score for several radii, and the distances from its domain to the nearest datum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.geometry import Region, hull, lattice, nearest
from mexpress.geometry import diagonal as _diagonal
from mexpress.leastsquares.model import LeastSquares, cross_validate_all
from mexpress.schemes import Places

PERCENTS = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 7.5, 10.0, 15.0, 20.0)
QUERIES = 1000


@dataclass(frozen=True, eq=False, repr=False)
class RadiusCurve:
    """Scores of a model by the radius within which data are held out.

    Parameters
    ----------
    percents : (k,) array
        Radii, in percent of the diagonal.
    scores : (k,) array
        P of every radius, in the responses' unit; NaN where undefined.
    held : (k,) array
        Mean number of held-out data.
    reach : (q,) array
        Distances to the nearest datum from places all over the region of the data, increasing, in percent of the
        diagonal.

    Examples
    --------
    >>> import numpy as np
    >>> RadiusCurve(np.array([0.0, 5.0]), np.array([1.0, 1.5]), np.array([1.0, 9.0]), np.array([0.5, 3.0, 4.0]))
    RadiusCurve(1 at 0 % to 1.5 at 5 %, half of the domain within 3 % of a datum)
    """

    percents: Floats
    scores: Floats
    held: Floats
    reach: Floats

    def __repr__(self) -> str:
        first, last = (f"{self.scores[k]:.4g} at {self.percents[k]:g} %" for k in (0, -1))
        return f"RadiusCurve({first} to {last}, half of the domain within {np.median(self.reach):.2g} % of a datum)"


def score_by_radius(
    model: LeastSquares,
    points: ArrayLike,
    diagonal: float | None = None,
    percents: Sequence[float] | None = None,
    threads: int | None = None,
) -> RadiusCurve:
    """Score a model by local exclusion with several radii.

    Parameters
    ----------
    model : LeastSquares
        A model of n data.
    points : (n, 2) array
        Positions of the data.
    diagonal : float, optional
        Length of which radii are percentages, in the unit of the points; that of their bounding box by default.
    percents : sequence of float, optional
        Radii in percent, increasing; 0 to 20 by default.
    threads : int, optional
        Largest number of threads.

    Raises
    ------
    ValueError, TypeError
        If the points are not those of the model's data or do not cover a region, or radii do not increase.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> x, y = points = np.random.default_rng(0).uniform(size=(2, 100))
    >>> model = mx.LeastSquares(np.column_stack([x**0, x, y, x * y]), np.sin(3 * x) + y)
    >>> curve = score_by_radius(model, points.T, percents=[0, 5, 10])
    >>> curve.held.tolist()
    [1.0, 2.28, 6.52]
    """
    where = check.points(points, "points")
    if len(where) != model.n_data:
        rule = f"They must be those of the model's {model.n_data} data."
        check.refuse("points", rule, f"{len(where)} points")
    size = _diagonal(where) if diagonal is None else check.positive(diagonal, "diagonal")
    return radius_curve(model, Places(where, threads), Region(hull(where, "points")), size, percents, threads)


def radius_curve(
    model: LeastSquares,
    places: Places,
    domain: Region,
    diagonal: float,
    percents: Sequence[float] | None,
    threads: int | None,
) -> RadiusCurve:
    """`score_by_radius` of checked data."""
    radii = _checked(PERCENTS if percents is None else percents)
    scores, held = np.empty(len(radii)), np.empty(len(radii))
    for k, percent in enumerate(radii):  # one by one: the lists for all radii at once would be large
        scheme = places.within(percent / 100 * diagonal)
        scores[k] = cross_validate_all(model, {"": scheme}, threads)[""].score
        held[k] = scheme.held_out.sizes.mean()
    _, reach = nearest(lattice(domain.corners, QUERIES), places.points)
    with np.errstate(over="ignore"):  # an image of any size may be given
        return RadiusCurve(radii, scores, held, 100 * (np.sort(reach) / diagonal))


def _checked(percents: ArrayLike) -> Floats:
    rule = "They must be one or more increasing percentages of at least 0."
    radii = check.real(percents, "percents")
    if radii.ndim != 1 or radii.size == 0:
        check.refuse("percents", rule, check.describe(percents))
    if check.finite(radii, "percents")[0] < 0 or (np.diff(radii) <= 0).any():
        check.refuse("percents", rule, check.describe(percents))
    return radii
