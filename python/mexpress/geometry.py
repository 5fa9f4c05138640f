"""Geometry of the plane: the region that points cover, a lattice over it, and nearest points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.caching import cached_property

NEAR_LINE = 1e-6
"""Points are on a line if their spread across it is below this fraction of the spread along it."""

_SMALLEST_EXTENT = 1e-150
"""Areas of smaller regions are no numbers."""

EDGE = 1e-9
"""A point outside a region by less than this fraction of its extent counts as inside, because of rounding."""


@dataclass(frozen=True, eq=False)
class Region:
    """The convex region that points cover, computed once.

    Examples
    --------
    >>> square = Region.of([[0, 0], [4, 0], [4, 3], [0, 3], [2, 1]])
    >>> square.area, Region.of(square) is square
    (12.0, True)
    """

    corners: Floats

    @classmethod
    def of(cls, points: ArrayLike | Region, name: str = "points") -> Region:
        """Return the region that points cover, or the region itself."""
        return points if isinstance(points, Region) else cls(covered_region(points, name))

    @cached_property
    def area(self) -> float:
        """Area in the squared unit of the corners."""
        return area(self.corners)


def thinness(points: Floats) -> float:
    """Return the spread of points across their main direction over the spread along it.

    Parameters
    ----------
    points : array, (n, 2)
        Positions in any unit; a similarity does not change the ratio.

    Returns
    -------
    float
        Ratio of the two singular values of the centred points: 1 for a square, 0 on a line or for fewer than three
        distinct points.

    Examples
    --------
    >>> thinness(np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 1.0], [10.0, 1.0]])).__round__(6)
    0.1
    """
    centred = about_mean(points)
    size = np.abs(centred).max()
    if len(points) < 3 or size == 0:
        return 0.0
    along, across = np.linalg.svd(centred / size, compute_uv=False)
    return float(across / along)


def lengths_of(vectors: Floats) -> Floats:
    """Return the lengths of vectors, (..., d) to (...), whose squares may be no numbers.

    Examples
    --------
    >>> lengths_of(np.array([[3e300, -4e300], [3e-300, 4e-300]]))
    array([5.e+300, 5.e-300])
    """
    return (
        np.abs(vectors[..., 0]) if vectors.shape[-1] == 1 else np.asarray(np.hypot.reduce(vectors, axis=-1))
    )


def about_mean(points: Floats) -> Floats:
    """Return points (n, d) relative to their mean, the same wherever they are.

    The mean of coordinates far from zero is rounded; of differences between them it is not, and these are exact.

    Examples
    --------
    >>> points = np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 1.0]])
    >>> bool((about_mean(points) == about_mean(points + 2.0**50)).all())
    True
    """
    offsets = points - points.min(axis=0)
    return np.asarray(offsets - offsets.mean(axis=0))


def middle(values: Floats) -> Floats:
    """Return the middle between the smallest and the largest of values, (n,) or (n, d): a constant near all of them.

    Models are fitted and placed relative to it: values far from zero would lose their digits.

    Examples
    --------
    >>> middle(np.array([[1e9, 0.0], [1e9 + 4, 1.0]]))
    array([1.e+09, 5.e-01])
    """
    return np.asarray(values.min(axis=0) + np.ptp(values, axis=0) / 2)


def without_ties(values: Floats) -> Floats:
    """Return values of at least 0, (n,), of which those that differ by rounding are equal.

    On a grid many distances are the same, and which of them is the largest would depend on the unit.

    Examples
    --------
    >>> without_ties(np.array([0.3, 2.0, 0.1 + 0.2]))
    array([0.3, 2. , 0.3])
    """
    order = np.argsort(values, kind="stable")
    ordered = values[order]
    apart = np.append(True, np.diff(ordered) > EDGE * ordered[1:])
    equal = np.empty_like(values)
    equal[order] = ordered[apart][np.cumsum(apart) - 1]
    return equal


def covered_region(points: ArrayLike, name: str = "points") -> Floats:
    """Return the region that points cover: their convex hull.

    Parameters
    ----------
    points : array_like, (n, 2)
        Positions, x then y.
    name : str
        Name of the points in an error message.

    Returns
    -------
    ndarray, (k, 2)
        Corners, counter-clockwise from the leftmost one (the lowest of these), without points on straight edges.

    Raises
    ------
    ValueError
        If there are fewer than three distinct points, or they are on a line: the spread across it is below 1e-6 of
        the spread along it.

    Examples
    --------
    >>> covered_region([[0, 0], [4, 0], [4, 3], [0, 3], [2, 1], [2, 0]])
    array([[0., 0.], [4., 0.], [4., 3.], [0., 3.]])
    """
    return hull(check.points(points, name), name)


def check_extent(points: Floats, name: str) -> None:
    """Refuse points that differ by so little that areas are no numbers; equal ones pass.

    Examples
    --------
    >>> check_extent(np.array([[0.0, 0.0], [3e-160, 0.0]]), "target")
    Traceback (most recent call last):
    ValueError: Invalid target. They must extend over 1e-150 at least: take another unit. Given 2 points that ...
    """
    extent = np.ptp(points, axis=0).max()
    if 0 < extent < _SMALLEST_EXTENT:
        rule = f"They must extend over {_SMALLEST_EXTENT:g} at least: take another unit."
        check.refuse(name, rule, f"{len(points)} points that extend over {extent:.2g}")


def hull(points: Floats, name: str) -> Floats:
    """`covered_region` of checked points."""
    check_extent(points, name)
    corners = _convex_hull(points)
    if len(corners) < 3 or thinness(corners) <= NEAR_LINE:
        rule = "They must cover a region: three distinct points or more, not on a line."
        check.refuse(name, rule, f"{len(points)} points {_lack_of_region(points)}")
    return corners


def _lack_of_region(points: Floats) -> str:
    """Say why points cover no region."""
    places, thin = len(np.unique(points, axis=0)), thinness(points)
    if places < 3:
        return "in one place" if places == 1 else "in two places"
    if thin <= np.finfo(float).eps:
        return "on a line"
    return f"whose spread across a line is {thin:.1g} of that along it"


def area(corners: Floats) -> float:
    """Return the area of a convex region, in the squared unit of its corners, (k, 2).

    Examples
    --------
    >>> area(np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 2.0], [0.0, 2.0]]))
    6.0
    """
    x, y = (corners - corners[0]).T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def diagonal(points: Floats) -> float:
    """Return the diagonal of the bounding box of points, (n, 2), in their unit."""
    return float(np.hypot(*np.ptp(points, axis=0)))


def inside(corners: Floats, x: Floats, y: Floats) -> NDArray[np.bool_]:
    """Return which points are in a convex region or, within rounding, on its edge.

    `x` and `y` are coordinates of shapes that broadcast: (n,) and (n,) for n points, (columns,) and (rows, 1) for a
    grid.

    Examples
    --------
    >>> triangle = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]])
    >>> inside(triangle, np.array([0.5, 1.0, 1.5, -1.0]), np.array([0.5, 1.0, 1.5, 0.5]))
    array([ True,  True, False, False])
    """
    # A convex region is above its lower edges, which run to the right, and below the upper ones.
    low, extent = corners.min(axis=0), np.ptp(corners, axis=0)
    corners, x, y = corners - low, x - low[0], y - low[1]  # exact, so that rounding is the same far from zero
    ends = np.roll(corners, -1, axis=0)
    run = (ends - corners)[:, 0] / extent[0]

    def line(edges: NDArray[np.bool_]) -> Floats:
        return np.vstack([corners[edges], ends[edges][-1:]])

    # Other edges are the left and the right end.
    below, above = np.interp(x, *line(run > 1e-12).T), np.interp(x, *line(run < -1e-12)[::-1].T)
    between = (x >= -EDGE * extent[0]) & (x <= (1 + EDGE) * extent[0])
    return np.asarray(between & (y >= below - EDGE * extent[1]) & (y <= above + EDGE * extent[1]))


def nearest(places: Floats, points: Floats) -> tuple[NDArray[np.intp], Floats]:
    """Return the index of the nearest of n points, (n, 2), to each of k places, (k, 2), and its distance, (k,) each.

    Examples
    --------
    >>> nearest(np.array([[0.0, 1.0], [9.0, 4.0]]), np.array([[0.0, 0.0], [9.0, 9.0]]))
    (array([0, 1]), array([1., 5.]))
    """
    centre = points.mean(axis=0)
    here, there = places - centre, points - centre
    index = np.empty(len(here), dtype=np.intp)
    step = 1 + (1 << 18) // len(there)
    for first in range(0, len(here), step):
        squared = (there**2).sum(axis=1) - 2 * here[first : first + step] @ there.T  # up to a constant
        index[first : first + step] = squared.argmin(axis=1)
    return index, np.asarray(np.hypot(*(places - points[index]).T))


def grid_points(x: Floats, y: Floats) -> Floats:
    """Return the points of a grid with these x and y, row after row, (rows * columns, 2).

    Examples
    --------
    >>> grid_points(np.array([0.0, 2.0]), np.array([5.0, 6.0])).tolist()
    [[0.0, 5.0], [2.0, 5.0], [0.0, 6.0], [2.0, 6.0]]
    """
    return np.column_stack([np.tile(x, len(y)), np.repeat(y, len(x))])


def lattice(corners: Floats, number: int) -> Floats:
    """Return about `number` points spread evenly inside a convex region.

    The lattice is a regular grid in coordinates where the region has unit covariance, so a thin or slanted region has
    as many points across it as along it.

    Parameters
    ----------
    corners : ndarray, (k, 2)
        Corners as `covered_region` gives them.
    number : int
        Desired number of points; the actual number differs by a few percent because of the edges.

    Returns
    -------
    ndarray, (s, 2)
        Positions in the unit of the corners.

    Examples
    --------
    >>> square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    >>> lattice(square, 4)
    array([[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]])
    """
    centroid, shape, size = moments(corners)
    # A lower triangular map keeps vertical lines vertical, and so keeps the order of the corners in x.
    white = whitened(corners, centroid, shape)
    step = np.sqrt(size / np.linalg.det(shape) / number)
    x, y = (_cell_centres(coordinates, step) for coordinates in white.T)
    last = np.lexsort((corners[:, 1], corners[:, 0]))[-1]
    below, above = white[: last + 1], np.vstack([white[last:], white[:1]])[::-1]
    lower, upper = (np.interp(x, *chain.T) for chain in (below, above))
    # The slack keeps points that rounding moves outside an edge, at any position of the region.
    within = (y[:, None] >= lower - EDGE) & (y[:, None] <= upper + EDGE)
    row, column = np.nonzero(within)
    return np.asarray(centroid + np.column_stack([x[column], y[row]]) @ shape.T)


def moments(corners: Floats) -> tuple[Floats, Floats, float]:
    """Return centroid, lower Cholesky factor of the covariance, and area of a convex region.

    A triangle with a share S of the area and corners v_k, relative to the centroid, contributes
    S/12 (sum v_k v_k^T + s s^T) with s = sum v_k.
    """
    fan = np.stack([np.broadcast_to(corners[0], corners[2:].shape), corners[1:-1], corners[2:]], axis=1)
    first, second = fan[:, 1] - fan[:, 0], fan[:, 2] - fan[:, 0]
    areas = 0.5 * (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    total = float(areas.sum())
    shares = areas / total  # in tiny units, products of areas and lengths would underflow
    centroid = corners[0] + shares @ (first + second) / 3
    about = fan - centroid
    about = np.concatenate([about, about.sum(axis=1, keepdims=True)], axis=1)
    covariance = np.einsum("t,tki,tkj->ij", shares, about, about) / 12
    return centroid, np.asarray(np.linalg.cholesky(covariance)), total


def whitened(points: Floats, centroid: Floats, shape: Floats) -> Floats:
    """Return points in the coordinates where a region with these `moments` has unit covariance."""
    return np.asarray(np.linalg.solve(shape, (points - centroid).T).T)


def _cell_centres(coordinates: Floats, step: float) -> Floats:
    low, length = coordinates.min(), np.ptp(coordinates)
    cells = max(1, round(length / step))
    return np.asarray(low + (np.arange(cells) + 0.5) * (length / cells))


def _convex_hull(points: Floats) -> Floats:
    """Andrew's monotone chain; most inner points of a large set are removed first."""
    if len(points) > 50:
        points = _outer(points)
    ordered = points[np.lexsort((points[:, 1], points[:, 0]))].tolist()
    corners = _right_turns_removed(ordered)[:-1] + _right_turns_removed(ordered[::-1])[:-1]
    return np.array(corners or ordered[:1], dtype=np.float64).reshape(-1, 2)


def _outer(points: Floats) -> Floats:
    """Points that are not strictly inside the polygon of the extreme ones in sixteen directions."""
    x, y = points.T.copy()
    angles = np.arange(16) * (np.pi / 8)
    extremes = [(np.cos(angle) * x + np.sin(angle) * y).argmax() for angle in angles]
    corners = _convex_hull(points[extremes])
    within = np.full(len(points), len(corners) > 2)
    for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        within &= (bx - ax) * (y - ay) > (by - ay) * (x - ax)
    return np.asarray(points[~within])


def _right_turns_removed(ordered: list[list[float]]) -> list[list[float]]:
    chain: list[list[float]] = []
    for x, y in ordered:
        while len(chain) > 1:
            (ax, ay), (bx, by) = chain[-2:]
            if (bx - ax) * (y - ay) > (by - ay) * (x - ax):
                break
            chain.pop()
        if chain != [[x, y]]:
            chain.append([x, y])
    return chain
