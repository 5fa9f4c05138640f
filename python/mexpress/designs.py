"""Fits of warps and surfaces as linear least-squares problems: from control points to a design, and back.

Examples
--------
>>> from mexpress.designs import warp_design
>>> from mexpress.liftings import ThinPlateSpline
>>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
>>> warp_design(ThinPlateSpline(square), square, square, fractional=False).A.shape
(4, 4)
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.leastsquares import LeastSquares
from mexpress.liftings import Lifting, ThinPlateSpline, make_lifting, nested_basis, nested_bending
from mexpress.placement import covered_region
from mexpress.surfaces import Surface
from mexpress.warps import Warp

__all__ = ["SurfaceDesign", "WarpDesign", "fit_surface", "fit_warp", "surface_design", "warp_design"]


@dataclass(frozen=True, eq=False, repr=False)
class WarpDesign:
    """The linear least-squares problem whose solution is a warp: minimise ||b - A x||.

    The residual b - A x is in pixels of the target image in both forms.

    Attributes
    ----------
    A : ndarray, (2n, 3l - 1) or (n, l)
        Design matrix. Fractional: rows 2i and 2i + 1 are the x and y equations of match i; columns are those
        of p_1 (l), of p_2 (l) and of z (l - 1), where p_3 = 1 + N z. Otherwise: the lifting's basis.
    b : ndarray, (2n,) or (n, 2)
        Responses.
    coupling : int
        Rows of A per match: 2 or 1.
    lifting : Lifting
        With l control points.
    domain : ndarray, (k, 2)
        Convex hull of the source points.
    centre : ndarray, (2,)
        Mean of the target points, the origin of the unknowns p_1 and p_2.
    scale : float
        Root mean square distance of the target points to their mean, the unit of p_1 and p_2.

    Examples
    --------
    >>> import mexpress as mx
    >>> from mexpress.liftings import ThinPlateSpline
    >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
    >>> design = warp_design(ThinPlateSpline(square[:3]), square, square)
    >>> model = mx.LeastSquares(design.A, design.b, coupling=design.coupling)
    >>> design.warp(model.coefficients)
    Warp(fractional tps, 3 control points)
    """

    A: Floats
    b: Floats
    coupling: int
    lifting: Lifting
    domain: Floats
    centre: Floats
    scale: float

    def __repr__(self) -> str:
        return f"WarpDesign({self.A.shape[0]} x {self.A.shape[1]}, {self.lifting!r})"

    @property
    def fractional(self) -> bool:
        """Whether the warp has a denominator.

        Examples
        --------
        >>> from mexpress.liftings import ThinPlateSpline
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> warp_design(ThinPlateSpline(square), square, square, fractional=False).fractional
        False
        """
        return self.b.ndim == 1

    def warp(self, coefficients: ArrayLike) -> Warp:
        """Return the warp of a solution x.

        Parameters
        ----------
        coefficients : array_like, (3l - 1,) or (l, 2)
            Unknowns, in the order of the columns of A.

        Examples
        --------
        >>> from mexpress.liftings import ThinPlateSpline
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> design = warp_design(ThinPlateSpline(square), square, square, fractional=False)
        >>> design.warp(square)
        Warp(tps, 4 control points)
        """
        x = np.asarray(coefficients, dtype=np.float64)
        if not self.fractional:
            return Warp(self.lifting, x, self.domain)
        count = len(self.lifting.control_points)
        denominator = 1 + _ones_complement(count) @ x[2 * count :]
        numerators = self.scale * x[: 2 * count].reshape(2, count).T + np.outer(denominator, self.centre)
        return Warp(self.lifting, np.column_stack([numerators, denominator]), self.domain)

    def bending(self) -> Floats:
        """Return the rows Z whose squared norm ||Z x||^2 is the bending energy of the warp.

        Not fractional: of one coordinate, so rows apply to both responses. Fractional: of its three functions
        with the target centred, the denominator times `scale`: all are then in pixels of the target image,
        and a similarity of it does not matter.

        Returns
        -------
        ndarray, (3(l - 3), 3l - 1) or (l - 3, l)
            In pixels of the target image per pixel of the source image.

        Examples
        --------
        >>> from mexpress.liftings import ThinPlateSpline
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> warp_design(ThinPlateSpline(square), square, square).bending().shape
        (3, 11)
        """
        one = self.lifting.bending()
        if not self.fractional:
            return one
        (k, count), last = one.shape, one @ _ones_complement(one.shape[1])
        rows = np.zeros((3 * k, 3 * count - 1))
        rows[:k, :count] = rows[k : 2 * k, count : 2 * count] = one
        rows[2 * k :, 2 * count :] = last
        return self.scale * rows


def warp_design(
    lifting: Lifting, source: ArrayLike, target: ArrayLike, fractional: bool = True
) -> WarpDesign:
    """Write the fit of a warp to matches as a linear least-squares problem.

    Fractional: the algebraic error of match i is s (t p_3 . nu - p . nu) for p = p_1, p_2 and t = x, y of the
    target point, centred and in units of s. With denominators of mean one, p_3 = 1 + N z, it is close to the
    transfer error in pixels. Otherwise it is the transfer error.

    Parameters
    ----------
    lifting : Lifting
        With control points in the source image.
    source, target : array_like, (n, 2)
        Matched points in pixels of either image, x then y.
    fractional : bool
        Whether the warp has a denominator.

    Returns
    -------
    WarpDesign
        Its solution does not change, but for rounding, with a similarity of either image.

    Raises
    ------
    ValueError
        If the points are not n pairs of finite numbers, or the source points are on a line.

    Examples
    --------
    >>> from mexpress.liftings import ThinPlateSpline
    >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
    >>> warp_design(ThinPlateSpline(square), square, square)
    WarpDesign(8 x 11, ThinPlateSpline(4 control points))
    """
    source, target = matched(source, target)
    domain = covered_region(source, "source")
    basis = lifting.basis(source)
    centre = target.mean(axis=0)
    about = target - centre
    scale = float(np.sqrt((about**2).sum(axis=1).mean())) or 1.0
    if not fractional:
        return WarpDesign(basis, target, 1, lifting, domain, centre, scale)
    n, count = basis.shape
    rows = np.zeros((n, 2, 3 * count - 1))
    rows[:, 0, :count] = rows[:, 1, count : 2 * count] = scale * basis
    rows[:, :, 2 * count :] = -about[:, :, None] * (basis @ _ones_complement(count))[:, None, :]
    return WarpDesign(rows.reshape(2 * n, -1), about.reshape(-1), 2, lifting, domain, centre, scale)


def fit_warp(
    source: ArrayLike,
    target: ArrayLike,
    control_points: ArrayLike,
    lifting: str = "tps",
    fractional: bool = True,
) -> Warp:
    """Fit a warp with given control points to matches, by least squares.

    Parameters
    ----------
    source, target : array_like, (n, 2)
        Matched points in pixels of either image, x then y.
    control_points : array_like, (l, 2)
        In pixels of the source image, 3 or more. With three the warp is affine, or a homography.
    lifting : str
        Name of the functions that bend the plane: "tps", thin-plate splines.
    fractional : bool
        Whether the warp has a denominator, that is, models perspective. It then has 3l - 1 parameters instead
        of 2l and minimises the algebraic error, close to the transfer error in pixels.

    Returns
    -------
    Warp
        From the source image to the target image.

    Raises
    ------
    ValueError
        If the input is not n matches and l distinct control points that are not on a line, or if the matches
        do not determine the warp: they are too few, or none is near some control point.

    Examples
    --------
    >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
    >>> warp = fit_warp(square, [[0, 0], [100, 0], [20, 100], [80, 100]], square[:3])
    >>> warp
    Warp(fractional tps, 3 control points)
    >>> warp([[50, 0], [100, 100]]).round(6) + 0.0
    array([[ 50.,   0.], [ 80., 100.]])
    """
    fractional = check.flag(fractional, "fractional")
    design = warp_design(make_lifting(lifting, control_points), source, target, fractional)
    model = LeastSquares(design.A, design.b, coupling=design.coupling)
    rows, unknowns = design.A.shape
    if model.rank < unknowns:
        rule = "The matches must determine the warp, so take fewer control points."
        count, matches = len(design.lifting.control_points), rows // design.coupling
        given = f"{count}, hence {unknowns} unknowns, and {matches} matches of rank {model.rank} in all"
        check.refuse("control_points", rule, given)
    return design.warp(model.coefficients)


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceDesign:
    """The linear least-squares problems whose solutions are surfaces: minimise ||b - A x||.

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
    >>> design = surface_design(square, [0, 2, 2, 4], square)
    >>> model = mx.LeastSquares(design.A[:, :3], design.b, coupling=design.coupling)
    >>> design.surface(model.coefficients, 3)
    Surface(depth, tps, 3 control points)
    """

    A: Floats
    b: Floats
    coupling: int
    control_points: Floats
    domain: Floats

    def __repr__(self) -> str:
        return f"SurfaceDesign({self.A.shape[0]} x {self.A.shape[1]})"

    def surface(self, coefficients: ArrayLike, count: int) -> Surface:
        """Return the surface of a solution x.

        Parameters
        ----------
        coefficients : array_like, (count,) or (count, d)
            Unknowns of the first columns of A; those of later columns are taken as 0.
        count : int
            Number of control points.

        Examples
        --------
        >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
        >>> design = surface_design(square, [0, 2, 2, 5], square)
        >>> design.surface([0, 2, 2], 3)([[1, 1]]).round(6)
        array([2.])
        """
        centres = self.control_points[:count]
        x = np.asarray(coefficients, dtype=np.float64)[:count]
        return Surface(ThinPlateSpline(centres), nested_basis(centres, centres) @ x, self.domain)

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
        >>> surface_design(square, [0, 2, 2, 4], square).bending().shape
        (1, 4)
        """
        return nested_bending(self.control_points)


def surface_design(points: ArrayLike, values: ArrayLike, control_points: ArrayLike) -> SurfaceDesign:
    """Write the fit of surfaces to data as nested linear least-squares problems.

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
    SurfaceDesign
        Of which the first k columns are the problem with the first k control points.

    Raises
    ------
    ValueError
        If the data are not n positions with a value each, all finite, if the positions are on a line, or if
        the control points are too few, nearly coincide or begin on a line.

    Examples
    --------
    >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
    >>> surface_design(square, [0, 2, 2, 4], square)
    SurfaceDesign(4 x 4)
    """
    points, values, domain = measured_data(points, values)
    control_points = check.points(control_points, "control_points")
    return SurfaceDesign(nested_basis(points, control_points), values, 1, control_points, domain)


def fit_surface(points: ArrayLike, values: ArrayLike, control_points: ArrayLike) -> Surface:
    """Fit a surface with given control points to data, by least squares.

    Parameters
    ----------
    points : array_like, (n, 2)
        Positions of the data: pixels of a depth map, or the coordinates of a template.
    values : array_like, (n,) or (n, d)
        Depths, or points in space, at these positions.
    control_points : array_like, (l, 2)
        In the unit of the positions, 3 or more, in any order. With three the surface is a plane.

    Returns
    -------
    Surface
        A thin-plate spline with values of the shape of one datum's.

    Raises
    ------
    ValueError
        If the input is not n data and l distinct control points that are not on a line, or if the data do
        not determine the surface: they are too few, or none is near some control point.

    Examples
    --------
    >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
    >>> surface = fit_surface(square, [0, 2, 2, 5], square)
    >>> surface
    Surface(depth, tps, 4 control points)
    >>> surface([[2, 2], [1, 1]]).round(6)
    array([5.  , 2.25])
    """
    points, values, domain = measured_data(points, values)
    spline = ThinPlateSpline(check.points(control_points, "control_points"))
    model = LeastSquares(spline.basis(points), values)
    count = len(spline.control_points)
    if model.rank < count:
        rule = "The data must determine the surface, so take fewer control points."
        check.refuse("control_points", rule, f"{count} and {len(points)} data of rank {model.rank}")
    return Surface(spline, model.coefficients, domain)


def matched(source: ArrayLike, target: ArrayLike) -> tuple[Floats, Floats]:
    """Return matched points as arrays, checked to be as many."""
    source, target = check.points(source, "source"), check.points(target, "target")
    if len(source) != len(target):
        rule = "It must have one point per source point."
        check.refuse("target", rule, f"{len(target)} for {len(source)}")
    return source, target


def measured_data(points: ArrayLike, values: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Return data as arrays, checked to be as many, and the region that they cover."""
    points = check.points(points, "points")
    values = check.columns(values, "values", len(points))
    return points, values, covered_region(points)


def _ones_complement(count: int) -> Floats:
    """Return N, (count, count - 1): Helmert's orthonormal basis of the vectors of mean zero."""
    k = np.arange(1, count)
    columns = np.triu(np.ones((count, count - 1)))
    columns[k, k - 1] = -k
    return np.asarray(columns / np.sqrt(k * (k + 1)))
