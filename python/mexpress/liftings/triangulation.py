"""Delaunay triangulation: triangles, their neighbours, and the hull."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mexpress import _core
from mexpress._validation import Floats
from mexpress.caching import cached_property
from mexpress.geometry import about_mean

Indices: TypeAlias = NDArray[np.intp]

_SAME_DIRECTION = 1e-9
"""Two neighbours of a point are in the same direction from it if the angle between them is below this."""

_SHEAR = 2.0**-20
"""Shear that decides between several Delaunay triangulations."""

_NEXT = np.array([1, 2, 0])


@dataclass(frozen=True, eq=False, repr=False)
class Triangulation:
    """The Delaunay triangulation of points that are neither on a line nor coincident.

    Parameters
    ----------
    points : ndarray, (l, 2)
        Corners of the triangles.

    Examples
    --------
    >>> square = Triangulation(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.5, 0.5]]))
    >>> square
    Triangulation(5 points, 4 triangles)
    >>> square.corners
    array([[0, 1, 4],
           [0, 4, 3],
           [1, 2, 4],
           [2, 3, 4]])
    """

    points: Floats

    def __repr__(self) -> str:
        return f"Triangulation({len(self.points)} points, {len(self.corners)} triangles)"

    @cached_property
    def corners(self) -> Indices:
        """Points of every triangle, counter-clockwise from the smallest index, (t, 3)."""
        here, after, following = _turns(self.points)
        faces = np.column_stack([here, after, following])
        smallest = faces.argmin(axis=1)[:, None]
        faces, found = np.unique(
            np.take_along_axis(faces, (smallest + np.arange(3)) % 3, axis=1), axis=0, return_counts=True
        )
        # All faces except the outer one are triangles. The outer face has three corners only if there is one triangle.
        triangles = faces[found == 3]
        return np.asarray(triangles[_doubled_area(self.points[triangles]) > 0])

    @cached_property
    def sides(self) -> Floats:
        """Vectors from every corner of every triangle to the next corner, (t, 3, 2)."""
        corners = self.points[self.corners]
        return np.asarray(corners[:, _NEXT] - corners)

    @cached_property
    def areas(self) -> Floats:
        """Areas of the triangles, (t,)."""
        return 0.5 * _doubled_area(self.points[self.corners])

    @cached_property
    def neighbours(self) -> Indices:
        """The triangle beyond every side of every triangle, -1 beyond the hull, (t, 3)."""
        ends, count = self.corners[:, _NEXT], len(self.points)
        one_way, other_way = (self.corners * count + ends).ravel(), (ends * count + self.corners).ravel()
        order = one_way.argsort()
        place = order[np.searchsorted(one_way, other_way, sorter=order).clip(max=len(order) - 1)]
        return np.where(one_way[place] == other_way, place // 3, -1).reshape(-1, 3)

    @cached_property
    def gradients(self) -> Floats:
        """Derivatives along x and y of every corner's barycentric coordinate, (t, 3, 2)."""
        opposite = self.sides[:, _NEXT]
        return np.stack([-opposite[..., 1], opposite[..., 0]], axis=-1) / (2 * self.areas[:, None, None])

    @cached_property
    def hull(self) -> tuple[Indices, Indices]:
        """Triangle and side of every edge of the hull, (h,) each."""
        triangle, side = np.nonzero(self.neighbours < 0)
        return triangle, side


def _doubled_area(corners: Floats) -> Floats:
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])


def _turns(points: Floats) -> tuple[Indices, Indices, Indices]:
    """Return every point with two of its neighbours that are successive counter-clockwise.

    Where points are on a straight part of the hull within rounding, hull edges may skip some of them. Such an edge has
    the direction of a shorter edge and is omitted: the triangle between them is empty. Angles are measured in
    coordinates with equal spread along x and y, which keep the order of directions and which a thin strip needs.
    """
    about = about_mean(points)
    about = about / np.abs(about).max()
    white = np.linalg.solve(np.linalg.cholesky(about.T @ about), about.T).T
    # Every cell of a grid can be cut in two ways. This metric, close to the usual one, cuts all cells the same way;
    # otherwise rounding would decide, and depend on the unit.
    offsets, members = _core.neighbours_delaunay(about @ np.array([[1.0, 0.0], [_SHEAR, 1.0]]))
    here = np.repeat(np.arange(len(points)), np.diff(offsets))
    here, there = here[members != here], members[members != here]
    while True:
        offset = white[there] - white[here]
        angle = np.arctan2(offset[:, 1], offset[:, 0])
        order = np.lexsort((angle, here))
        here, there, angle, offset = here[order], there[order], angle[order], offset[order]
        first = np.searchsorted(here, np.arange(len(points)))
        following = np.arange(1, len(here) + 1)
        following[np.append(first[1:], len(here)) - 1] = first
        same = np.abs((angle[following] - angle + np.pi) % (2 * np.pi) - np.pi) < _SAME_DIRECTION
        if not same.any():
            return here, there, there[following]
        length = np.hypot(*offset.T)
        longer = np.where(length > length[following], np.arange(len(here)), following)[same]
        left_out = np.concatenate(
            [here[longer] * len(points) + there[longer], there[longer] * len(points) + here[longer]]
        )
        kept = ~np.isin(here * len(points) + there, left_out)
        here, there = here[kept], there[kept]
