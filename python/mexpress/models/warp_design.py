"""Fits of warps to matches as linear least-squares problems.

Examples
--------
>>> from mexpress.models import warp_design
>>> from mexpress.liftings import ThinPlateSpline
>>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
>>> warp_design(ThinPlateSpline(square), square, square)
WarpDesign(8 x 11, ThinPlateSpline(4 control points))
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.liftings import Lifting, ThinPlateSpline, nested_basis, nested_bending
from mexpress.models.warp import Warp
from mexpress.placement import covered_region

__all__ = ["NestedWarpDesign", "WarpDesign", "matched", "nested_warp_design", "warp_design"]


@dataclass(frozen=True, eq=False, repr=False)
class WarpDesign:
    """The linear least-squares problem whose solution is a warp: minimise ||b - A x||.

    The residual b - A x is in pixels of the target image in both forms.

    Attributes
    ----------
    A : ndarray, (2n, 3l - 1) or (n, l)
        Design matrix. Fractional: rows 2i and 2i + 1 are the x and y equations of match i; columns are those
        of p_1 (l), of p_2 (l) and of z (l - 1), where p_3 = `origin` + N z. Otherwise: the lifting's basis.
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
    normal : ndarray, (l,)
        Denominators satisfy normal . p_3 = 1, see `warp_design`.

    Examples
    --------
    >>> import mexpress as mx
    >>> from mexpress.liftings import ThinPlateSpline
    >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
    >>> design = warp_design(ThinPlateSpline(square[:3]), square, square)
    >>> model = mx.LeastSquares(design.A, design.b, coupling=design.coupling)
    >>> design.model(model.coefficients)
    Warp(fractional tps, 3 control points)
    """

    A: Floats
    b: Floats
    coupling: int
    lifting: Lifting
    domain: Floats
    centre: Floats
    scale: float
    normal: Floats

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

    @property
    def count(self) -> int:
        """Number of control points, l.

        Examples
        --------
        >>> from mexpress.liftings import ThinPlateSpline
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> warp_design(ThinPlateSpline(square), square, square).count
        4
        """
        return len(self.lifting.control_points)

    def model(self, coefficients: ArrayLike, smoothing: float = 0.0) -> Warp:
        """Return the warp of a solution x.

        Parameters
        ----------
        coefficients : array_like, (3l - 1,) or (l, 2)
            Unknowns, in the order of the columns of A.
        smoothing : float
            Weight of the bending energy that they were found with; the warp keeps it.

        Examples
        --------
        >>> from mexpress.liftings import ThinPlateSpline
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> design = warp_design(ThinPlateSpline(square), square, square, fractional=False)
        >>> design.model(square)
        Warp(tps, 4 control points)
        """
        x = np.asarray(coefficients, dtype=np.float64)
        if not self.fractional:
            return Warp(self.lifting, x, self.domain, smoothing)
        denominator = _origin(self.normal) + _complement(self.normal) @ x[2 * self.count :]
        numerators = self.scale * x[: 2 * self.count].reshape(2, -1).T + np.outer(denominator, self.centre)
        return Warp(self.lifting, np.column_stack([numerators, denominator]), self.domain, smoothing)

    def bending(self) -> Floats:
        """Return the rows Z whose squared norm ||Z x||^2 is the bending energy of the warp.

        Not fractional: of one coordinate, so rows apply to both responses. Fractional: of its three functions
        with the target centred, the denominator times `scale`: all are then in pixels of the target image,
        and a similarity of it does not matter.

        Returns
        -------
        ndarray, (3k, 3l - 1) or (k, l)
            In pixels of the target image per pixel of the source image; k rows of the lifting.

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
        k, count = one.shape
        rows = np.zeros((3 * k, 3 * count - 1))
        rows[:k, :count] = rows[k : 2 * k, count : 2 * count] = one
        rows[2 * k :, 2 * count :] = one @ _complement(self.normal)
        return self.scale * rows


def warp_design(
    lifting: Lifting,
    source: ArrayLike,
    target: ArrayLike,
    fractional: bool = True,
    over_data: bool | None = None,
) -> WarpDesign:
    """Write the fit of a warp to matches as a linear least-squares problem.

    Fractional: the algebraic error of match i is s (t p_3 . nu - p . nu) for p = p_1, p_2 and t = x, y of the
    target point, centred and in units of s. With denominators of mean one it is close to the transfer error in
    pixels. Otherwise it is the transfer error.

    Parameters
    ----------
    lifting : Lifting
        With control points in the source image.
    source, target : array_like, (n, 2)
        Matched points in pixels of either image, x then y.
    fractional : bool
        Whether the warp has a denominator.
    over_data : bool, optional
        Whether the denominators have mean one over the matches. Otherwise their parameters do, as in the paper
        (eq. 19): for a thin-plate spline that is the mean over the control points, and its default. Control points
        of other liftings may be far from the matches, where a denominator can grow while it vanishes over them.

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
    n, count = basis.shape
    centre, about, scale = _centred(target)
    usual = not isinstance(lifting, ThinPlateSpline)
    normal = basis.mean(axis=0) if (usual if over_data is None else over_data) else np.full(count, 1 / count)
    if not fractional:
        return WarpDesign(basis, target, 1, lifting, domain, centre, scale, normal)
    rows = np.zeros((n, 2, 3 * count - 1))
    rows[:, 0, :count] = rows[:, 1, count : 2 * count] = scale * basis
    rows[:, :, 2 * count :] = -about[:, :, None] * (basis @ _complement(normal))[:, None, :]
    right = about * (basis @ _origin(normal))[:, None]
    return WarpDesign(rows.reshape(2 * n, -1), right.reshape(-1), 2, lifting, domain, centre, scale, normal)


@dataclass(frozen=True, eq=False, repr=False)
class NestedWarpDesign:
    """Warps with more and more control points as one least-squares problem: leading columns are the smaller ones.

    Attributes
    ----------
    A : ndarray, (2n, 3l - 1) or (n, l)
        Design matrix. Fractional: three columns a control point, of p_1, p_2 and z, but the first three control
        points have eight columns together. The denominator is 1 + sum_k z_k (psi_k - mean of psi_k), with psi the
        functions of `nested_basis` but the first, and the mean over the matches. Otherwise: the nested basis.
    b : ndarray, (2n,) or (n, 2)
        Responses.
    coupling : int
        Rows of A per match: 2 or 1.
    control_points : ndarray, (l, 2)
        In their order.
    domain, centre, scale
        As in `WarpDesign`.
    means : ndarray, (l,)
        Means of the nested functions over the matches.

    Examples
    --------
    >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
    >>> nested_warp_design(square, square, square)
    NestedWarpDesign(8 x 11)
    """

    A: Floats
    b: Floats
    coupling: int
    control_points: Floats
    domain: Floats
    centre: Floats
    scale: float
    means: Floats

    def __repr__(self) -> str:
        return f"NestedWarpDesign({self.A.shape[0]} x {self.A.shape[1]})"

    def columns(self, count: int) -> int:
        """Return how many columns the first control points have.

        Examples
        --------
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> nested_warp_design(square, square, square).columns(3)
        8
        """
        return 3 * count - 1 if self.b.ndim == 1 else count

    def model(self, coefficients: ArrayLike, count: int, smoothing: float = 0.0) -> Warp:
        """Return the warp of a solution x of the first columns.

        Parameters
        ----------
        coefficients : array_like, (columns(count),) or (count, 2)
            Unknowns.
        count : int
            Number of control points.
        smoothing : float
            Weight of the bending energy that they were found with; the warp keeps it.

        Examples
        --------
        >>> import mexpress as mx
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> design = nested_warp_design(square, square, square)
        >>> design.model(mx.LeastSquares(design.A[:, :8], design.b, 2).coefficients, 3)
        Warp(fractional tps, 3 control points)
        """
        x, centres = np.asarray(coefficients, dtype=np.float64), self.control_points[:count]
        basis, lifting = nested_basis(centres, centres), ThinPlateSpline(centres)
        if self.b.ndim > 1:
            return Warp(lifting, basis @ x, self.domain, smoothing)
        first, second, third = (x[part] for part in _parts(count))
        denominator = 1 + (basis - self.means[:count])[:, 1:] @ third
        numerators = self.scale * basis @ np.column_stack([first, second])
        numerators += np.outer(denominator, self.centre)
        return Warp(lifting, np.column_stack([numerators, denominator]), self.domain, smoothing)

    def bending(self) -> Floats:
        """Return the rows Z whose squared norm ||Z x||^2 is the bending energy, for every leading part of x.

        Returns
        -------
        ndarray, (3(l - 3), 3l - 1) or (l - 3, l)
            In the unit of `WarpDesign.bending`.

        Examples
        --------
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> nested_warp_design(square, square, square).bending().shape
        (3, 11)
        """
        one = nested_bending(self.control_points)
        if self.b.ndim > 1:
            return one
        first, second, third = _parts(len(self.control_points))
        rows = np.zeros((3, len(one), self.A.shape[1]))
        rows[0][:, first] = rows[1][:, second] = one
        rows[2][:, third] = one[:, 1:]
        return self.scale * rows.reshape(3 * len(one), -1)


def nested_warp_design(
    source: ArrayLike, target: ArrayLike, control_points: ArrayLike, fractional: bool = True
) -> NestedWarpDesign:
    """Write the fits of warps with more and more control points as one least-squares problem.

    The first k control points make the problem of `warp_design` with thin-plate splines and denominators of mean
    one over the matches: a condition that does not depend on the control points, so that models stay nested.

    Parameters
    ----------
    source, target : array_like, (n, 2)
        Matched points in pixels of either image, x then y.
    control_points : array_like, (l, 2)
        In their order; the first three not on a line, and best far apart.
    fractional : bool
        Whether the warps have a denominator.

    Raises
    ------
    ValueError
        If the points are not n pairs of finite numbers, or suit no thin-plate spline.

    Examples
    --------
    >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
    >>> nested_warp_design(square, square, square, fractional=False)
    NestedWarpDesign(4 x 4)
    """
    source, target = matched(source, target)
    domain = covered_region(source, "source")
    control_points = check.points(control_points, "control_points")
    basis = nested_basis(source, control_points)
    n, count = basis.shape
    centre, about, scale = _centred(target)
    means = basis.mean(axis=0)
    if not fractional:
        return NestedWarpDesign(basis, target, 1, control_points, domain, centre, scale, means)
    first, second, third = _parts(count)
    rows = np.zeros((n, 2, 3 * count - 1))
    rows[:, 0, first] = rows[:, 1, second] = scale * basis
    rows[:, :, third] = -about[:, :, None] * (basis - means)[:, None, 1:]
    return NestedWarpDesign(
        rows.reshape(2 * n, -1), about.reshape(-1), 2, control_points, domain, centre, scale, means
    )


def matched(source: ArrayLike, target: ArrayLike) -> tuple[Floats, Floats]:
    """Return matched points as arrays, checked to be as many."""
    source, target = check.points(source, "source"), check.points(target, "target")
    if len(source) != len(target):
        rule = "It must have one point per source point."
        check.refuse("target", rule, f"{len(target)} for {len(source)}")
    return source, target


def _centred(target: Floats) -> tuple[Floats, Floats, float]:
    """Mean of the target points, the points about it, and their root mean square distance to it."""
    centre = target.mean(axis=0)
    about = target - centre
    return centre, about, float(np.sqrt((about**2).sum(axis=1).mean())) or 1.0


def _parts(count: int) -> tuple[Integers, Integers, Integers]:
    """Columns of p_1, of p_2 and of z: those of the first three control points first, then three for each."""
    later = np.arange(8, 3 * count - 1, 3)
    first = np.concatenate([[0, 1, 2], later])
    second = np.concatenate([[3, 4, 5], later + 1])
    return first, second, np.concatenate([[6, 7], later + 2])


def _origin(normal: Floats) -> Floats:
    """Return the parameters, all the same, that a normal gives the value one: a constant denominator."""
    return np.full(len(normal), 1 / normal.sum())


def _complement(normal: Floats) -> Floats:
    """Return N, (l, l - 1), an orthonormal basis of the vectors that a normal gives the value zero."""
    mirror = normal / np.linalg.norm(normal)
    sign = 1.0 if mirror[0] >= 0 else -1.0
    # Householder's reflection takes the normal to the first axis, and the other axes to its complement.
    mirror[0] += sign
    return np.asarray((np.eye(len(mirror)) - np.outer(mirror, mirror / (sign * mirror[0])))[:, 1:])
