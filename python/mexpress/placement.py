"""Where control points go: over the region that the data cover, to the data that fit worst, or to all data in turn."""

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _core
from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.geometry import (
    NEAR_LINE,
    Region,
    area,
    covered_region,
    diagonal,
    hull,
    lattice,
    moments,
    thinness,
    whitened,
)

__all__ = ["area", "by_residual", "covered_region", "farthest_first", "lattice", "lloyd", "thinness"]

COINCIDENT = 1e-5
"""Control points coincide when they are nearer than this fraction of the largest distance to their mean."""

SPACING = 0.025
"""What `by_residual` keeps control points apart by, as a fraction of the diagonal of the data's bounding box."""

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

    The region, the convex hull of the points, is sampled evenly; every centre moves to the mean of the
    samples nearest to it, until none moves. Where the data are dense does not matter, only where they end.

    Parameters
    ----------
    points : array_like, (n, 2), or Region
        Data positions, x then y, in any unit; or the region that they cover.
    count : int
        Number of control points, 3 or more.
    seed : int, Generator or None
        Of the starting centres: the same number gives the same control points, None fresh ones.
    threads : int, optional
        Upper bound on threads; all cores by default. The result does not depend on it.

    Returns
    -------
    ndarray, (count, 2)
        Control points, in the unit of the data. They move with the data when these are translated or scaled.

    Raises
    ------
    ValueError
        If the points are on a line, fewer than three distinct ones, not finite, or `count` is below 3.
    TypeError
        If the points are not numbers, or an option has not its type.

    Examples
    --------
    >>> corners = [[0, 0], [400, 0], [400, 400], [0, 400]]
    >>> sorted(map(tuple, lloyd(corners, 4).round(-1).tolist()))
    [(100.0, 100.0), (100.0, 300.0), (300.0, 100.0), (300.0, 300.0)]
    """
    corners = Region.of(points).corners
    count = check.count(count, "count", 3)
    random, threads = check.generator(seed), check.threads(threads)
    centroid, shape, _ = moments(corners)
    samples = whitened(lattice(corners, max(2000, 60 * count)), centroid, shape)
    isotropic = shape / np.linalg.norm(shape)
    # In a thin region the best few centres are on its axis, which determines no warp. In coordinates where
    # the region has unit covariance it is as wide as long, and they are not.
    for frame in (isotropic, np.eye(2)):
        here = samples @ frame.T
        start = _spread_start(here, count, random)
        centres = _core.lloyd(here, start, _MAX_STEPS, _TOLERANCE, threads)
        white = np.asarray(np.linalg.solve(frame, centres.T).T)
        if thinness(white) > 0.1:
            break
    return np.asarray(centroid + white @ shape.T)


def farthest_first(points: ArrayLike, max_count: int) -> Integers:
    """Order data so that every leading part of them is spread evenly: each next is farthest from those before.

    The first is farthest from the mean of the data, the second from the first, and the third makes the largest
    triangle with them.

    Parameters
    ----------
    points : array_like, (n, 2)
        Data positions, x then y, in any unit.
    max_count : int
        How many are wanted, 3 or more.

    Returns
    -------
    ndarray, (l,)
        Indices of the data; a tie goes to the smallest. Fewer than `max_count` if the others coincide with them
        (they are nearer than 1e-5 of the diagonal of the points' bounding box).

    Raises
    ------
    ValueError
        If the points are on a line, fewer than three distinct ones, not finite, or `max_count` is below 3.
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
    """`farthest_first` of points that are checked, and cover a region."""
    # A power of two, so that ties stay ties; squares then neither overflow nor underflow.
    x, y = np.ldexp(points, -int(np.frexp(diagonal(points))[1])).T.copy()
    first = int(_squares(x, y, x.mean(), y.mean()).argmax())
    second = int(_squares(x, y, x[first], y[first]).argmax())
    a, b = x[second] - x[first], y[second] - y[first]
    chosen = [first, second, int(np.abs(b * (x - x[first]) - a * (y - y[first])).argmax())]
    nearest = np.min([_squares(x, y, x[k], y[k]) for k in chosen], axis=0)
    coincident = COINCIDENT**2 * (np.ptp(x) ** 2 + np.ptp(y) ** 2)
    while len(chosen) < min(max_count, len(points)):
        k = int(nearest.argmax())
        if nearest[k] <= coincident:
            break
        chosen.append(k)
        np.minimum(nearest, _squares(x, y, x[k], y[k]), out=nearest)
    return np.array(chosen, dtype=np.int64)


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
    """Choose the data that become control points: always the one that fits worst so far.

    Starts from three random data and the affine fit. Then a thin-plate spline on the control points so far is
    fitted to all data by plain least squares, and of the data farther than `min_distance` from every control
    point the one with the largest residual is the next, until `max_count` is reached or there is none. It
    also ends when no residual is above 1e-12 of the largest value: data exactly on a plane get three
    control points.

    Parameters
    ----------
    points : array_like, (n, 2)
        Data positions, x then y, in any unit.
    values : array_like, (n,) or (n, d)
        Values there, in any unit; the residual of a datum is the norm over its d values. A tie, to within
        1e-9, goes to the smallest index.
    max_count : int
        Largest number of control points, 3 or more.
    min_distance : float, optional
        Control points are farther apart than this, in the unit of the points; 2.5% of the diagonal of the
        points' bounding box by default.
    seed : int, Generator or None
        Of the first three: the same number gives the same control points, None fresh ones.
    threads : int, optional
        Upper bound on threads; all cores by default. The result does not depend on it.

    Returns
    -------
    ndarray, (l,)
        Indices of the data that become control points, in the order in which they come: the first k are what
        `max_count=k` gives. Fewer than `max_count` if the placement ends earlier.

    Raises
    ------
    ValueError
        If the points are on a line or fewer than three distinct ones, if values do not match them, entries are
        not finite, or `max_count` is below 3.
    TypeError
        If points or values are not numbers, or an option has not its type.

    Notes
    -----
    A penalty on bending plays no part: which data become control points does not depend on the smoothing that
    is chosen later.

    The first three are drawn with a probability proportional to the squared area of their triangle. So they
    are well spread, never on a line or in one place, and in a thin or slanted strip as good as in a square,
    without a threshold to tune. A draw with two of them nearer than `min_distance` is repeated, up to a
    hundred times; if all fail, the one with the largest shortest side stands.

    The default of `min_distance` keeps cross-validation well-conditioned. The paper's advice is to hold out the
    data within 10% of the diagonal. With control points 1% apart some such discs enclose so many of them that
    the other data no longer determine them (smallest eigenvalue of I - H_KK below 1e-10); at 2.5% it stays above
    1e-8 with 175 control points on real depth maps, and the fit is as good. Nor are control points
    ever nearer than 1e-5 of the diagonal, where splines cannot tell them apart.

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
    """`by_residual` of data that are checked, and cover a region."""
    random, threads = check.generator(seed), check.threads(threads)
    size = diagonal(points)
    distance = SPACING * size
    if min_distance is not None:
        rule = "It must be a distance of at least 0."
        distance = max(check.number(min_distance, "min_distance", rule, 0.0), COINCIDENT * size)
    first = _spread_triangle(points, distance, random)
    outputs = values.reshape(len(values), -1)
    return _core.place_by_residual(points, outputs, first, min(max_count, len(points)), distance, threads)


def _spread_triangle(points: Floats, distance: float, random: np.random.Generator) -> tuple[int, int, int]:
    """Draw three points, farther apart than a distance if a hundred draws will do."""
    centred = points - points.mean(axis=0)
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

    That is the squared determinant of their rows in any basis of the affine functions. If it is orthonormal,
    the first is drawn by the squared norms of the rows, the next by those of what is left of the rows when
    the direction of the first is taken away, and so on.
    """
    left, drawn = basis, []
    for _ in range(3):
        squares = (left**2).sum(axis=1)
        drawn.append(int(random.choice(len(left), p=squares / squares.sum())))
        row = left[drawn[-1]]
        left = left - np.outer(left @ row, row / (row @ row))
    return drawn[0], drawn[1], drawn[2]


def _spread_start(samples: Floats, count: int, random: np.random.Generator) -> Floats:
    """Draw samples, each with a probability that grows with its squared distance to those already drawn."""
    centres = samples[_core.spread(samples, random.random(count))]
    # Off the grid: samples as near to one centre as to another would leave the choice to rounding.
    return np.asarray(centres + 0.01 / np.sqrt(count) * random.standard_normal(centres.shape))
