"""Fits of surfaces to data as linear least-squares problems.

Examples
--------
>>> from mexpress.models import nested_surface_design
>>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
>>> nested_surface_design(square, [0, 2, 2, 4], square)
NestedSurfaceDesign(4 x 4)
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.liftings import Lifting, ThinPlateSpline, nested_basis, nested_bending
from mexpress.models.surface import Surface
from mexpress.placement import covered_region

__all__ = ["NestedSurfaceDesign", "SurfaceDesign", "measured_data", "nested_surface_design", "surface_design"]


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceDesign:
    """The linear least-squares problem whose solution is a surface: minimise ||b - A x||.

    Attributes
    ----------
    A : ndarray, (n, l)
        Design matrix, the lifting's basis at the data.
    b : ndarray, (n,) or (n, d)
        Values at the data.
    coupling : int
        Rows of A per datum: 1.
    lifting : Lifting
        With l control points.
    domain : ndarray, (k, 2)
        Convex hull of the data.

    Examples
    --------
    >>> import mexpress as mx
    >>> from mexpress.liftings import ThinPlateSpline
    >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
    >>> design = surface_design(ThinPlateSpline(square[:3]), square, [0, 2, 2, 4])
    >>> design.model(mx.LeastSquares(design.A, design.b).coefficients)
    Surface(depth, tps, 3 control points)
    """

    A: Floats
    b: Floats
    coupling: int
    lifting: Lifting
    domain: Floats

    def __repr__(self) -> str:
        return f"SurfaceDesign({self.A.shape[0]} x {self.A.shape[1]}, {self.lifting!r})"

    @property
    def count(self) -> int:
        """Number of control points, l.

        Examples
        --------
        >>> from mexpress.liftings import ThinPlateSpline
        >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
        >>> surface_design(ThinPlateSpline(square), square, [0, 2, 2, 4]).count
        4
        """
        return len(self.lifting.control_points)

    def model(self, coefficients: ArrayLike, smoothing: float = 0.0) -> Surface:
        """Return the surface of a solution x.

        Parameters
        ----------
        coefficients : array_like, (l,) or (l, d)
            Unknowns.
        smoothing : float
            Weight of the bending energy that they were found with; the surface keeps it.

        Examples
        --------
        See the class.
        """
        return Surface(self.lifting, np.asarray(coefficients, dtype=np.float64), self.domain, smoothing)

    def bending(self) -> Floats:
        """Return the rows Z whose squared norm ||Z x||^2 is the bending energy, (k, l).

        Of one value, so rows apply to every response; in the unit of the values per unit of the points.

        Examples
        --------
        >>> from mexpress.liftings import ThinPlateSpline
        >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
        >>> surface_design(ThinPlateSpline(square), square, [0, 2, 2, 4]).bending().shape
        (1, 4)
        """
        return self.lifting.bending()


def surface_design(lifting: Lifting, points: ArrayLike, values: ArrayLike) -> SurfaceDesign:
    """Write the fit of a surface to data as a linear least-squares problem.

    Parameters
    ----------
    lifting : Lifting
        With control points among the positions.
    points : array_like, (n, 2)
        Positions of the data.
    values : array_like, (n,) or (n, d)
        Depths, or points in space, at these positions.

    Raises
    ------
    ValueError
        If the data are not n positions with a value each, all finite, or the positions are on a line.

    Examples
    --------
    >>> from mexpress.liftings import ThinPlateSpline
    >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
    >>> surface_design(ThinPlateSpline(square), square, [0, 2, 2, 4])
    SurfaceDesign(4 x 4, ThinPlateSpline(4 control points))
    """
    points, values, domain = measured_data(points, values)
    return SurfaceDesign(lifting.basis(points), values, 1, lifting, domain)


@dataclass(frozen=True, eq=False, repr=False)
class NestedSurfaceDesign:
    """Surfaces with more and more control points as one least-squares problem: minimise ||b - A x||.

    The first k columns of A make the surface with the first k control points, so that all can be fitted and
    judged at once.

    Attributes
    ----------
    A : ndarray, (n, l)
        Design matrix, the nested basis at the data.
    b : ndarray, (n,) or (n, d)
        Values at the data.
    coupling : int
        Rows of A per datum: 1.
    control_points : ndarray, (l, 2)
        In the order of the columns.
    domain : ndarray, (k, 2)
        Convex hull of the data.

    Examples
    --------
    >>> import mexpress as mx
    >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
    >>> design = nested_surface_design(square, [0, 2, 2, 4], square)
    >>> model = mx.LeastSquares(design.A[:, :3], design.b, coupling=design.coupling)
    >>> design.model(model.coefficients, 3)
    Surface(depth, tps, 3 control points)
    """

    A: Floats
    b: Floats
    coupling: int
    control_points: Floats
    domain: Floats

    def __repr__(self) -> str:
        return f"NestedSurfaceDesign({self.A.shape[0]} x {self.A.shape[1]})"

    def columns(self, count: int) -> int:
        """Return how many columns the first control points have: one each.

        Examples
        --------
        >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
        >>> nested_surface_design(square, [0, 2, 2, 4], square).columns(3)
        3
        """
        return count

    def model(self, coefficients: ArrayLike, count: int, smoothing: float = 0.0) -> Surface:
        """Return the surface of a solution x of the first columns.

        Parameters
        ----------
        coefficients : array_like, (count,) or (count, d)
            Unknowns of the first columns of A; those of later columns are taken as 0.
        count : int
            Number of control points.
        smoothing : float
            Weight of the bending energy that they were found with; the surface keeps it.

        Examples
        --------
        >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
        >>> design = nested_surface_design(square, [0, 2, 2, 5], square)
        >>> design.model([0, 2, 2], 3)([[1, 1]]).round(6)
        array([2.])
        """
        centres = self.control_points[:count]
        x = np.asarray(coefficients, dtype=np.float64)[:count]
        values = nested_basis(centres, centres) @ x
        return Surface(ThinPlateSpline(centres), values, self.domain, smoothing)

    def bending(self) -> Floats:
        """Return the rows Z whose squared norm ||Z x||^2 is the bending energy of the surface.

        Of one value, so rows apply to every response. The surface with k control points has the first k - 3
        rows, of which only k columns are not 0.

        Returns
        -------
        ndarray, (l - 3, l)
            In the unit of the values per unit of the points.

        Examples
        --------
        >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
        >>> nested_surface_design(square, [0, 2, 2, 4], square).bending().shape
        (1, 4)
        """
        return nested_bending(self.control_points)


def nested_surface_design(
    points: ArrayLike, values: ArrayLike, control_points: ArrayLike
) -> NestedSurfaceDesign:
    """Write the fits of surfaces with more and more control points as one least-squares problem.

    Parameters
    ----------
    points : array_like, (n, 2)
        Positions of the data.
    values : array_like, (n,) or (n, d)
        Depths, or points in space, at these positions.
    control_points : array_like, (l, 2)
        In the order in which they are added; the first three are not on a line, and best far apart.

    Returns
    -------
    NestedSurfaceDesign
        Of which the first k columns are the problem with the first k control points.

    Raises
    ------
    ValueError
        If the data are not n positions with a value each, all finite, if the positions are on a line, or if
        the control points are too few, nearly coincide or begin on a line.

    Examples
    --------
    >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
    >>> nested_surface_design(square, [0, 2, 2, 4], square)
    NestedSurfaceDesign(4 x 4)
    """
    points, values, domain = measured_data(points, values)
    control_points = check.points(control_points, "control_points")
    return NestedSurfaceDesign(nested_basis(points, control_points), values, 1, control_points, domain)


def measured_data(points: ArrayLike, values: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Return data as arrays, checked to be as many, and the region that they cover."""
    points = check.points(points, "points")
    values = check.columns(values, "values", len(points))
    return points, values, covered_region(points)
