"""Piecewise affine functions over triangles: local, but not smooth."""

from collections.abc import Iterator
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.caching import cached_property
from mexpress.geometry import Region
from mexpress.liftings.grids import grid, grid_counts
from mexpress.liftings.lifting import register
from mexpress.liftings.sparse import Entries, SparseLifting
from mexpress.liftings.triangulation import Indices, Triangulation


@register
class PiecewiseAffine(SparseLifting):
    """Hat functions: affine in every triangle of the Delaunay triangulation of the control points.

    Function k is 1 at control point k and 0 at the others, so parameters are values at the control points. At a point,
    only the three functions of its triangle are nonzero; they are positive and sum to one. Slopes jump at the edges of
    triangles: a point on an edge has the slopes of one of the two sides.

    Outside the triangles f(q) = f(h) + g(h) . (q - h), where h is the point of the hull nearest to q. At a control
    point on the hull, the slope g is the mean over the triangles of the two adjacent hull edges; between control points
    it is interpolated. So f is continuous everywhere, and affine functions remain affine.

    Parameters
    ----------
    control_points : array_like, (l, 2)
        Positions, see `Lifting`.

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
        """Return one row per inner edge; the squared norm of the rows is a discrete bending energy.

        f has no second derivatives. The second derivative across an edge is replaced by the jump of the slope over the
        distance of the centroids of its two triangles; its square over 8 pi is integrated over a third of their area.
        For a quadratic function on fine regular triangles, the result is 0.5 times (bowl) to 1 times (saddle) the
        integral of f_xx^2 + 2 f_xy^2 + f_yy^2 over 8 pi, and on a grid with diagonals 0.75 to 2.25 times. A weight thus
        gives about the same stiffness as for the smooth liftings. Long thin triangles, as scattered points have them at
        the hull, have steep slopes and contribute much more.

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
        """Return 3 and the numbers of control points of the grids of `place`, increasing.

        Examples
        --------
        >>> PiecewiseAffine.counts(np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 2.0]]), 12)
        [3, 4, 6, 8, 12]
        """
        return [3, *(count for count in grid_counts(region, largest) if count <= largest)]

    @classmethod
    def place(cls, points: ArrayLike, count: int, seed: int = 0, threads: int | None = None) -> Floats:
        """Return the grid over the bounding box of the points with the number nearest to a count, (l, 2).

        The triangle of three control points contains the box, so all points are inside. Nothing is random.

        Examples
        --------
        >>> PiecewiseAffine.place([[0, 0], [4, 0], [4, 2], [0, 2]], 3)
        array([[0., 0.], [8., 0.], [0., 4.]])
        """
        return _place(Region.of(points), count)

    @classmethod
    def place_over(cls, region: Region, count: int, seed: int = 0, threads: int | None = None) -> Floats:
        """Return the control points of `place` over a known region."""
        return _place(region, count)

    def entries(self, points: Floats, along: int | None = None) -> Entries:
        """Return the nonzero elements of the basis at n points, or of its derivative along x (0) or y (1)."""
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
        """Return functions and elements at points outside the hull.

        f(q) = sum_v w_v (f_v + g_v . d), where v are the ends of the hull edge nearest to q, w_v are their shares in
        the nearest point h, and d = q - h.
        """
        mesh, (triangle, side) = self._mesh, self._mesh.hull
        start, edges = self.control_points[mesh.corners[triangle, side]], mesh.sides[triangle, side]
        nearest, share, offset = _nearest(points, start, edges)
        edge = edges[nearest]
        shift = np.zeros_like(points)  # the derivative of d, with that of the share
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
        """Return the triangles of both hull edges at a control point on the hull, (l, 2); arbitrary ones elsewhere."""
        triangle, side = self._mesh.hull
        triangles = np.zeros((len(self.control_points), 2), dtype=np.intp)
        for end in range(2):
            triangles[self._mesh.corners[triangle, (side + end) % 3], end] = triangle
        return triangles


def _place(region: Region, count: int) -> Floats:
    if check.count(count, "count", 3) > 3:
        return grid(region, count)
    corners = region.corners
    return np.asarray(corners.min(axis=0) + np.array([[0, 0], [2, 0], [0, 2]]) * np.ptp(corners, axis=0))


def _nearest(points: Floats, start: Floats, edges: Floats) -> tuple[Indices, Floats, Floats]:
    """Return the nearest edge to each point, the share of its end in the nearest place, and the offset from there."""
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
