"""Piecewise affine functions over triangles: no smoothness, and nothing but the nearest control points."""

from collections.abc import Iterator
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.geometry import Region
from mexpress.liftings.grids import grid, grid_counts
from mexpress.liftings.lifting import register
from mexpress.liftings.sparse import Entries, SparseLifting
from mexpress.liftings.triangulation import Indices, Triangulation


@register
class PiecewiseAffine(SparseLifting):
    """Hat functions: affine in every triangle of the Delaunay triangulation of the control points.

    Function k is 1 at control point k and 0 at the others, so parameters are values at the control points. At
    a point the three functions of its triangle differ from zero; they are positive and sum to one. Slopes
    jump at the edges of triangles: a point on one has those of either side.

    Outside of the triangles f(q) = f(h) + g(h) . (q - h), with h the point of the hull nearest to q. The slope
    g(h) at a corner of the hull, or a control point on it, is the mean of the slopes in the triangles of both
    edges of the hull that meet there, and in between it is interpolated: so f is continuous everywhere, and
    affine functions go on as they are.

    Parameters
    ----------
    control_points : array_like, (l, 2)
        Positions, as for every `Lifting`.

    Examples
    --------
    >>> hats = PiecewiseAffine([[0, 0], [2, 0], [0, 2], [3, 3]])
    >>> hats
    PiecewiseAffine(4 control points)
    >>> hats.basis([[2, 0], [1, 0.5], [2, 2]])
    array([[0.  , 1.  , 0.  , 0.  ],
           [0.25, 0.5 , 0.25, 0.  ],
           [0.  , 0.25, 0.25, 0.5 ]])
    """

    name: ClassVar[str] = "affine"

    def bending(self) -> Floats:
        """Return one row an inner edge, whose squared norm is a discrete bending energy.

        f has no second derivatives. The jump of slope at an edge, over the distance of the centroids of its two
        triangles, stands for the one across the edge, and holds for a third of their area; its square is
        divided by 8 pi. For a quadratic function on fine regular triangles this is 0.5 (a bowl) to 1 times (a
        saddle) the integral of f_xx^2 + 2 f_xy^2 + f_yy^2, over 8 pi, and on a grid with diagonals 0.75 to 2.25
        times: a weight means about the same stiffness as for the smooth liftings, not exactly. Long thin
        triangles, which scattered points have at the hull, have steep slopes and count much more.

        Returns
        -------
        ndarray, (e, l)
            Zero if and only if f is affine.

        Examples
        --------
        >>> PiecewiseAffine([[0, 0], [2, 0], [0, 2], [3, 3]]).bending().shape
        (1, 4)
        """
        mesh = self._mesh
        first, side = np.nonzero(mesh.neighbours > np.arange(len(mesh.corners))[:, None])
        second, edge = mesh.neighbours[first, side], mesh.sides[first, side]
        across = np.column_stack([edge[:, 1], -edge[:, 0]])
        scale = np.sqrt(0.75 / (8 * np.pi) / (mesh.areas[first] + mesh.areas[second]))
        rows, number = np.zeros((len(first), len(self.control_points))), np.arange(len(first))
        for sign, triangle in ((-1, first), (1, second)):
            for k in range(3):
                slope = (mesh.gradients[triangle, k] * across).sum(axis=1)
                rows[number, mesh.corners[triangle, k]] += sign * scale * slope
        return rows

    @classmethod
    def counts(cls, region: Floats, largest: int) -> list[int]:
        """Return 3 and the numbers of control points of the grids that `place` knows, increasing.

        Examples
        --------
        >>> PiecewiseAffine.counts(np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 2.0]]), 12)
        [3, 4, 6, 8, 12]
        """
        return [3, *(count for count in grid_counts(region, largest) if count <= largest)]

    @classmethod
    def place(
        cls, points: ArrayLike | Region, count: int, seed: int = 0, threads: int | None = None
    ) -> Floats:
        """Return the grid nearest to a count that fills the bounding box of the points, (l, 2).

        Of three control points the triangle contains the box. So all points are inside; nothing is random.

        Examples
        --------
        >>> PiecewiseAffine.place([[0, 0], [4, 0], [4, 2], [0, 2]], 3)
        array([[0., 0.], [8., 0.], [0., 4.]])
        """
        if check.count(count, "count", 3) > 3:
            return grid(points, count)
        corners = Region.of(points).corners
        return np.asarray(corners.min(axis=0) + np.array([[0, 0], [2, 0], [0, 2]]) * np.ptp(corners, axis=0))

    def entries(self, points: Floats, along: int | None = None) -> Entries:
        """Return the nonzero elements of the basis at n points, or of its derivative along x (0) or y (1).

        Examples
        --------
        >>> plane = PiecewiseAffine([[0, 0], [2, 0], [0, 2]])
        >>> sum(float(elements[0]) for _, _, elements in plane.entries(np.array([[1.0, 0.5]]))).__round__(6)
        1.0
        """
        mesh = self._mesh
        triangle = mesh.locate(points)
        inside, outside = np.flatnonzero(triangle >= 0), np.flatnonzero(triangle < 0)
        here = triangle[inside]
        for k in range(3):
            elements = mesh.gradients[here, k]
            if along is None:
                elements = elements * (points[inside] - self.control_points[mesh.corners[here, k - 1]])
                yield inside, mesh.corners[here, k], elements.sum(axis=1)
            else:
                yield inside, mesh.corners[here, k], elements[:, along]
        if len(outside):
            yield from ((outside, *rest) for rest in self._outer_entries(points[outside], along))

    def _outer_entries(self, points: Floats, along: int | None) -> Iterator[tuple[Indices, Floats]]:
        """Return functions and elements at points outside of the hull.

        f(q) = sum_v w_v (f_v + g_v . d), with v the ends of the hull's edge nearest to q, w_v their shares in
        the nearest point h, and d = q - h.
        """
        mesh, (triangle, side) = self._mesh, self._mesh.hull
        start, edges = self.control_points[mesh.corners[triangle, side]], mesh.sides[triangle, side]
        nearest, share, offset = _nearest(points, start, edges)
        edge = edges[nearest]
        shift = np.zeros_like(points)  # the derivative of d, and with it that of the share
        gain = np.zeros(len(points))
        if along is not None:
            between = (share > 0) & (share < 1)
            gain = np.where(between, edge[:, along] / (edge**2).sum(axis=1), 0)
            shift[:, along] = 1
            shift -= gain[:, None] * edge
        here = triangle[nearest]
        for end, (part, growth) in enumerate(((1 - share, -gain), (share, gain))):
            corner = mesh.corners[here, (side[nearest] + end) % 3]
            reach = part[:, None] * offset
            if along is not None:
                reach = growth[:, None] * offset + part[:, None] * shift
            yield corner, part if along is None else growth
            for beside in self._hull_triangles[corner].T:
                for k in range(3):
                    yield mesh.corners[beside, k], (mesh.gradients[beside, k] * reach).sum(axis=1) / 2

    @cached_property
    def _mesh(self) -> Triangulation:
        return Triangulation(self.control_points)

    @cached_property
    def _hull_triangles(self) -> Indices:
        """Return the triangles of both edges of the hull that meet at a control point, (l, 2); any elsewhere."""
        triangle, side = self._mesh.hull
        triangles = np.zeros((len(self.control_points), 2), dtype=np.intp)
        for end in range(2):
            triangles[self._mesh.corners[triangle, (side + end) % 3], end] = triangle
        return triangles


def _nearest(points: Floats, start: Floats, edges: Floats) -> tuple[Indices, Floats, Floats]:
    """Return the nearest edge to each point, its end's share in the nearest place, and the way from there."""
    nearest, share = np.zeros(len(points), dtype=np.intp), np.zeros(len(points))
    offset, distance = np.zeros_like(points), np.full(len(points), np.inf)
    for number, (corner, edge) in enumerate(zip(start, edges, strict=True)):
        part = ((points - corner) @ edge / (edge @ edge)).clip(0, 1)
        way = points - corner - part[:, None] * edge
        length = np.hypot(*way.T)
        closer = length < distance
        nearest[closer], share[closer], offset[closer] = number, part[closer], way[closer]
        distance[closer] = length[closer]
    return nearest, share, offset
