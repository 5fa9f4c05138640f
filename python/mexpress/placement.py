"""Placement of control points: over the region of the data, at data that fit badly, or at data far from each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _core
from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.geometry import (
    NEAR_LINE,
    Region,
    about_mean,
    area,
    covered_region,
    diagonal,
    hull,
    lattice,
    middle,
    moments,
    thinness,
    whitened,
)

__all__ = ["area", "by_residual", "covered_region", "farthest_first", "lattice", "lloyd", "thinness"]


def __dir__() -> list[str]:
    return sorted(__all__)


COINCIDENT = 1e-5
"""Control points coincide when they are nearer than this fraction of the largest distance to their mean."""

SPACING = 0.025
"""Default smallest distance in `by_residual`, as a fraction of the diagonal of the data's bounding box."""

_EXACT = 1e-12
"""Placement by residual ends at residuals of this fraction of the largest value, relative to their middle."""

_TIED = 1e-9
"""Squared distances that differ by less than this fraction are equal: on a grid, rounding must not decide."""

_DRAWS = 100

_MAX_STEPS = 100
_TOLERANCE = 1e-4


def lloyd(
    points: ArrayLike | Region,
    count: int,
    seed: int | np.random.Generator | None = 0,
    threads: int | None = None,
) -> Floats:
    """Spread control points over the region that the data cover, by Lloyd's algorithm.

    The region is the convex hull of the points, and is sampled evenly. Every centre moves to the mean of its nearest
    samples until all stay. The density of the data has no effect, only their hull.

    Parameters
    ----------
    points : array_like, (n, 2), or Region
        Positions of the data, x then y, in any unit, or the region that they cover.
    count : int
        Number of control points, 3 or more.
    seed : int, Generator or None
        Seed of the starting centres. The same number gives the same control points, None fresh ones.
    threads : int, optional
        Largest number of threads; all cores by default. The result does not depend on it.

    Returns
    -------
    ndarray, (count, 2)
        Control points, in the unit of the data. A translation or scaling of the data applies to them alike.

    Raises
    ------
    ValueError
        If there are fewer than three distinct points, or they are on a line or not finite, or `count` is below 3.
    TypeError
        If the points are not numbers, or an option has a wrong type.

    Examples
    --------
    >>> corners = [[0, 0], [400, 0], [400, 400], [0, 400]]
    >>> sorted(map(tuple, lloyd(corners, 4).round(-1).tolist()))
    [(100.0, 100.0), (100.0, 300.0), (300.0, 100.0), (300.0, 300.0)]
    """
    corners = Region.of(points).corners
    count = check.count(count, "count", 3)
    random, threads = check.generator(seed), check.threads(threads)
    origin = corners.min(axis=0)  # exact differences, so that rounding is the same far from zero
    corners = corners - origin
    centroid, shape, _ = moments(corners)
    samples = whitened(lattice(corners, max(2000, 60 * count)), centroid, shape)
    isotropic = shape / np.linalg.norm(shape)
    # In a thin region the best few centres are on its axis, and do not determine a warp. In coordinates where
    # the region has unit covariance, it is as wide as long, and they are not on a line.
    for frame in (isotropic, np.eye(2)):
        here = samples @ frame.T
        start = _spread_start(here, count, random)
        centres = _core.lloyd(here, start, _MAX_STEPS, _TOLERANCE, threads)
        white = np.asarray(np.linalg.solve(frame, centres.T).T)
        if thinness(white) > 0.1:
            break
    return np.asarray(origin + (centroid + white @ shape.T))


def farthest_first(points: ArrayLike, max_count: int) -> Integers:
    """Order data so that each next datum is the farthest from all before it: every leading part is spread evenly.

    The first datum is the farthest from the mean, the second is the farthest from the first, and the third makes the
    largest triangle with them.

    Parameters
    ----------
    points : array_like, (n, 2)
        Positions of the data, x then y, in any unit.
    max_count : int
        Largest number of data, 3 or more.

    Returns
    -------
    ndarray, (l,)
        Indices of the data; of equally far data, the smallest index. Fewer than `max_count` if all others coincide
        with them (are nearer than 1e-5 of the diagonal of the points' bounding box).

    Raises
    ------
    ValueError
        If there are fewer than three distinct points, or they are on a line or not finite, or `max_count` is below 3.
    TypeError
        If the points are not numbers, or `max_count` is not a number.

    Examples
    --------
    >>> farthest_first([[0, 0], [4, 0], [4, 4], [0, 4], [2, 2], [2, 1]], 5)
    array([2, 0, 1, 3, 4])
    """
    points = check.points(points, "points")
    hull(points, "points")
    return farthest_order(points, check.count(max_count, "max_count", 3))


def farthest_order(points: Floats, max_count: int) -> Integers:
    """`farthest_first` of checked points that cover a region."""
    # Scaling by a power of two is exact and keeps ties; squares then neither overflow nor underflow.
    x, y = np.ldexp(about_mean(points), -int(np.frexp(diagonal(points))[1])).T.copy()
    first = _first_largest(_squares(x, y, 0.0, 0.0))
    second = _first_largest(_squares(x, y, x[first], y[first]))
    a, b = x[second] - x[first], y[second] - y[first]
    chosen = [first, second, _first_largest(np.abs(b * (x - x[first]) - a * (y - y[first])))]
    nearest = np.min([_squares(x, y, x[k], y[k]) for k in chosen], axis=0)
    coincident = COINCIDENT**2 * (np.ptp(x) ** 2 + np.ptp(y) ** 2)
    while len(chosen) < min(max_count, len(points)):
        k = _first_largest(nearest)
        if nearest[k] <= coincident:
            break
        chosen.append(k)
        np.minimum(nearest, _squares(x, y, x[k], y[k]), out=nearest)
    return np.array(chosen, dtype=np.int64)


def _first_largest(values: Floats) -> int:
    """Return the first place of the largest number, or of one that differs from it by rounding."""
    return int((values >= (1 - _TIED) * values.max()).argmax())


def _squares(x: Floats, y: Floats, a: float, b: float) -> Floats:
    """Squared distances to a point."""
    squares = x - a
    squares *= squares
    rest = y - b
    rest *= rest
    squares += rest
    return squares


def by_residual(
    points: ArrayLike,
    values: ArrayLike,
    max_count: int,
    min_distance: float | None = None,
    seed: int | np.random.Generator | None = 0,
    threads: int | None = None,
) -> Integers:
    """Choose the data that become control points: the next one is always the datum that fits worst so far.

    The first three are random. Then a thin-plate spline with the control points so far (an affine function at first) is
    fitted to all data by plain least squares. Of the data farther than `min_distance` from every control point, the one
    with the largest residual is next, until there are `max_count` control points or no such datum. The placement also
    ends when no residual exceeds 1e-12 of the values' spread, or eight units in their last place: data exactly on a
    plane get three control points.

    Parameters
    ----------
    points : array_like, (n, 2)
        Positions of the data, x then y, in any unit.
    values : array_like, (n,) or (n, d)
        Values of the data, in any unit. The residual of a datum is the norm over its d values; of residuals equal to
        within 1e-9, the smallest index is next.
    max_count : int
        Largest number of control points, 3 or more.
    min_distance : float, optional
        Control points are farther apart than this, in the unit of the points; 2.5% of the diagonal of the points'
        bounding box by default.
    seed : int, Generator or None
        Seed of the first three. The same number gives the same control points, None fresh ones.
    threads : int, optional
        Largest number of threads; all cores by default. The result does not depend on it.

    Returns
    -------
    ndarray, (l,)
        Indices of the data that become control points, in order: the first k are the result of `max_count=k`. Fewer
        than `max_count` if the placement ends earlier.

    Raises
    ------
    ValueError
        If there are fewer than three distinct points, or they are on a line, if values do not match them, if entries
        are not finite, or `max_count` is below 3.
    TypeError
        If points or values are not numbers, or an option has a wrong type.

    Notes
    -----
    The placement does not depend on the weight of the bending energy that is selected later.

    The first three are drawn with a probability proportional to the squared area of their triangle. They are thus well
    spread and never on a line, in a thin or slanted strip as in a square, without a threshold to tune. A draw with two
    points nearer than `min_distance` is repeated up to a hundred times; if all fail, the draw with the largest shortest
    side is used.

    The default of `min_distance` keeps cross-validation well-conditioned. The paper advises to hold out the data within
    10% of the diagonal. With control points 1% apart, some such discs contain so many control points that the other
    data do not determine the model (smallest eigenvalue of I - H_KK below 1e-10). At 2.5% it stays above 1e-8 with 175
    control points on real depth maps, and the fit is as good. Control points are never nearer than 1e-5 of the
    diagonal, where splines cannot distinguish them.

    Examples
    --------
    >>> x, y = np.meshgrid(np.arange(20.0), np.arange(20.0))
    >>> points, heights = np.column_stack([x.ravel(), y.ravel()]), np.exp(-((x - 7) ** 2) / 9).ravel()
    >>> chosen = by_residual(points, heights, 8)
    >>> len(chosen), len(set(chosen.tolist()))
    (8, 8)
    >>> bool((chosen[:5] == by_residual(points, heights, 5)).all())
    True
    """
    points = check.points(points, "points")
    values = check.columns(values, "values", len(points))
    hull(points, "points")
    return residual_order(points, values, check.count(max_count, "max_count", 3), min_distance, seed, threads)


def residual_order(
    points: Floats,
    values: Floats,
    max_count: int,
    min_distance: float | None,
    seed: int | np.random.Generator | None,
    threads: int | None,
) -> Integers:
    """`by_residual` of checked data that cover a region."""
    random, threads = check.generator(seed), check.threads(threads)
    size = diagonal(points)
    distance = SPACING * size
    if min_distance is not None:
        rule = "It must be a distance of at least 0."
        distance = max(check.number(min_distance, "min_distance", rule, 0.0), COINCIDENT * size)
    first = _spread_triangle(points, distance, random)
    outputs = (values - middle(values)).reshape(len(values), -1)
    exact = max(_EXACT * float(np.abs(outputs).max()), 8 * float(np.spacing(np.abs(values).max())))
    count = min(max_count, len(points))
    return _core.place_by_residual(points, outputs, first, count, (distance, exact), threads)


def _spread_triangle(points: Floats, distance: float, random: np.random.Generator) -> tuple[int, int, int]:
    """Draw three points that are farther apart than a distance, if one of a hundred draws has such points."""
    centred = about_mean(points)
    plane = np.linalg.qr(centred / np.abs(centred).max()).Q
    basis = np.column_stack([np.full(len(points), len(points) ** -0.5), plane])
    widest = COINCIDENT * diagonal(points)
    best = None
    for _ in range(_DRAWS):
        triangle = _triangle(basis, random)
        corners = points[list(triangle)]
        width = float(np.hypot(*(corners - np.roll(corners, 1, axis=0)).T).min())
        if width > widest and thinness(corners) > NEAR_LINE:
            widest, best = width, triangle
            if width > distance:
                break
    if best is None:
        rule = f"Three of them must not lie on a line, to within {NEAR_LINE:g} of their extent, nor coincide."
        check.refuse("points", rule, f"{len(points)} nearly on a line")
    return best


def _triangle(basis: Floats, random: np.random.Generator) -> tuple[int, int, int]:
    """Draw three points with a probability proportional to the squared area of their triangle.

    That is the squared determinant of their rows in any basis of the affine functions. In an orthonormal basis, the
    squared norms of the rows are the probabilities of the first point. Each next point has those of the rows after
    projection orthogonal to the rows drawn so far.
    """
    left, drawn = basis, []
    for _ in range(3):
        squares = (left**2).sum(axis=1)
        drawn.append(int(random.choice(len(left), p=squares / squares.sum())))
        row = left[drawn[-1]]
        left = left - np.outer(left @ row, row / (row @ row))
    return drawn[0], drawn[1], drawn[2]


def _spread_start(samples: Floats, count: int, random: np.random.Generator) -> Floats:
    """Draw samples, each with a probability that grows with the squared distance to the samples so far."""
    centres = samples[_core.spread(samples, random.random(count))]
    # Centres off the grid: rounding would decide between centres that are equally near to a sample.
    return np.asarray(centres + 0.01 / np.sqrt(count) * random.standard_normal(centres.shape))
