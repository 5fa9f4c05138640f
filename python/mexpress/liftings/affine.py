"""Piecewise affine functions over triangles: local, but not smooth."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _core
from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.caching import cached_property
from mexpress.geometry import Region
from mexpress.liftings.grids import grid, grid_counts
from mexpress.liftings.lifting import register
from mexpress.liftings.sparse import LocalLifting
from mexpress.liftings.triangulation import Triangulation


@register
class PiecewiseAffine(LocalLifting):
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

    def preimages(self, positions: Floats, parameters: Floats, least: float) -> Floats:
        """Return the points that a map takes to positions: inside the triangles, where there is exactly one.

        Examples
        --------
        >>> hats = PiecewiseAffine([[0, 0], [2, 0], [0, 2]])
        >>> hats.preimages(np.array([[15.0, 5.0], [9.0, 99.0]]), np.array([[10.0, 0], [20, 0], [10, 10]]), 0.5)
        array([[ 1.,  1.],
               [nan, nan]])
        """
        denominators = np.ones(len(parameters)) if parameters.shape[1] == 2 else parameters[:, 2]
        maps = np.column_stack([self.control_points, parameters[:, :2], denominators])
        corners = maps[self._mesh.corners.ravel()]
        return _core.preimages(np.ascontiguousarray(positions, float), corners, least, check.threads(None))

    @cached_property
    def _functions(self) -> _core.LocalFunctions:
        mesh = self._mesh
        triangles, sides = (np.ascontiguousarray(numbers).view(np.uintp) for numbers in mesh.hull)
        return _core.LocalFunctions.hats(
            self.control_points,
            mesh.corners.ravel().view(np.uintp),
            mesh.gradients.reshape(-1, 2),
            triangles,
            sides,
        )

    @cached_property
    def _mesh(self) -> Triangulation:
        return Triangulation(self.control_points)


def _place(region: Region, count: int) -> Floats:
    if check.count(count, "count", 3) > 3:
        return grid(region, count)
    corners = region.corners
    return np.asarray(corners.min(axis=0) + np.array([[0, 0], [2, 0], [0, 2]]) * np.ptp(corners, axis=0))
