"""Liftings: the functions whose linear combinations bend the plane.

A lifting nu maps a point q to l numbers; a scalar function is f(q) = nu(q) . x. Another lifting is one more
class with the members of `Lifting`, entered in `LIFTINGS`.

Examples
--------
>>> make_lifting("tps", [[0, 0], [2, 0], [0, 2]]).basis([[1, 1]]).round(6) + 0.0
array([[0. , 0.5, 0.5]])
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.placement import COINCIDENT, NEAR_LINE, thinness

__all__ = [
    "LIFTINGS",
    "Lifting",
    "ThinPlateSpline",
    "evaluate",
    "make_lifting",
    "nested_basis",
    "nested_bending",
    "slopes",
]

_CHUNK = 1 << 14
"""Numbers in one block of a temporary array, 128 KiB: blocks that stay in cache are also the fastest."""


class Lifting(Protocol):
    """What a warp asks of a lifting with l control points: nu(q) = terms(q) @ expansion.

    Examples
    --------
    >>> lifting: Lifting = ThinPlateSpline([[0, 0], [1, 0], [0, 1], [1, 1]])
    >>> lifting.name, lifting.basis([[0, 0]]).shape, lifting.bending().shape
    ('tps', (1, 4), (1, 4))
    """

    name: ClassVar[str]

    @property
    def control_points(self) -> Floats:
        """Control points, (l, 2)."""

    def basis(self, points: ArrayLike) -> Floats:
        """Return nu at n points, (n, l)."""

    def derivatives(self, points: ArrayLike) -> Floats:
        """Return the derivatives of nu along x and y at n points, (n, l, 2)."""

    def bending(self) -> Floats:
        """Return Z, (k, l), with ||Z x||^2 the bending energy of nu . x."""

    @property
    def expansion(self) -> Floats:
        """Weights of the t terms in the l functions, (t, l)."""

    def terms(self, points: Floats) -> Floats:
        """Return the terms at n points, (n, t)."""

    def term_slopes(self, points: Floats) -> Floats:
        """Return the derivatives of the terms along x and y at n points, (2, n, t)."""


@dataclass(frozen=True, eq=False, repr=False)
class ThinPlateSpline:
    """Thin-plate splines with given control points, in cardinal form.

    The functions f(q) = a . (1, q) + sum_k w_k phi(|q - c_k|), phi(r) = r^2 log r, whose weights satisfy
    sum_k w_k (1, c_k) = 0: a space of dimension l. Its coordinates x are the values f(c_k) at the control
    points, so x is in the unit of the function, and constants and affine functions are contained exactly.
    With three control points there are only the affine functions. So far from the control points that squared
    distances overflow, values are infinite or NaN.

    Parameters
    ----------
    control_points : array_like, (l, 2)
        Positions c_k, x then y; l is 3 or more.

    Raises
    ------
    ValueError
        If there are fewer than three control points, if two coincide (they are nearer than 1e-5 of the
        largest distance to the mean), or if all are on a line (their spread across it is below 1e-6 of that
        along it). Both rules compare distances, so no unit matters.

    Examples
    --------
    >>> spline = ThinPlateSpline([[0, 0], [100, 0], [0, 100], [100, 100]])
    >>> spline
    ThinPlateSpline(4 control points)
    >>> spline.basis([[100, 0], [50, 50]]).round(6) + 0.0
    array([[0.  , 1.  , 0.  , 0.  ],
           [0.25, 0.25, 0.25, 0.25]])
    """

    control_points: Floats
    name: ClassVar[str] = "tps"

    def __post_init__(self) -> None:
        points = check.points(self.control_points, "control_points").copy()
        _check_spread(points)
        points.flags.writeable = False
        object.__setattr__(self, "control_points", points)

    def __repr__(self) -> str:
        return f"ThinPlateSpline({len(self.control_points)} control points)"

    def basis(self, points: ArrayLike) -> Floats:
        """Return the l cardinal functions at n points.

        Parameters
        ----------
        points : array_like, (n, 2)
            Positions, in the unit of the control points.

        Returns
        -------
        ndarray, (n, l)
            Row i holds nu(q_i): the k-th function is 1 at control point k and 0 at the others; rows sum to 1.

        Examples
        --------
        >>> ThinPlateSpline([[0, 0], [2, 0], [0, 2]]).basis([[1, 1]]).round(6) + 0.0
        array([[0. , 0.5, 0.5]])
        """
        return evaluate(self, check.points(points, "points"), np.eye(len(self.control_points)))

    def derivatives(self, points: ArrayLike) -> Floats:
        """Return the derivatives of the l cardinal functions at n points.

        Parameters
        ----------
        points : array_like, (n, 2)
            Positions, in the unit of the control points.

        Returns
        -------
        ndarray, (n, l, 2)
            Element [i, k, b] is the derivative of function k along coordinate b at point i, per unit of the
            points.

        Examples
        --------
        >>> ThinPlateSpline([[0, 0], [2, 0], [0, 2]]).derivatives([[1, 1]]).round(6) + 0.0
        array([[[-0.5, -0.5],
                [ 0.5,  0. ],
                [ 0. ,  0.5]]])
        """
        return slopes(self, check.points(points, "points"), np.eye(len(self.control_points)))

    def bending(self) -> Floats:
        """Return the rows Z whose squared norm is the bending energy.

        ||Z x||^2 = w^T K w with K_jk = phi(|c_j - c_k|) and distances in the unit of the control points.
        8 pi times this is the integral of f_xx^2 + 2 f_xy^2 + f_yy^2 over the plane. It is in (unit of f)^2
        per (unit of the points)^2 and belongs to the function, not to its control points: splines with
        different control points compare.

        Returns
        -------
        ndarray, (l - 3, l)
            No rows with three control points: affine functions do not bend.

        Examples
        --------
        >>> energy = ThinPlateSpline([[0, 0], [1, 0], [0, 1], [1, 1]]).bending() @ [0, 0, 0, 1]
        >>> (energy @ energy).round(6)
        np.float64(0.360674)
        """
        return self._solution[1] / self._scale

    @property
    def expansion(self) -> Floats:
        """Weights w and affine part a of every cardinal function, (l + 3, l).

        Examples
        --------
        >>> ThinPlateSpline([[0, 0], [2, 0], [0, 2]]).expansion.shape
        (6, 3)
        """
        return self._solution[0]

    def terms(self, points: Floats) -> Floats:
        """Return phi(|q - c_k|), x, y and 1 at n points, in normalised coordinates, (n, l + 3).

        Examples
        --------
        >>> ThinPlateSpline([[0, 0], [2, 0], [0, 2]]).terms(np.array([[1.0, 1.0]])).shape
        (1, 6)
        """
        here, centres = self._normalised(points), self._normalised(self.control_points)
        terms = np.empty((len(points), len(centres) + 3))
        terms[:, :-3] = _kernel(here, centres)
        terms[:, -3:-1] = here
        terms[:, -1] = 1
        return terms

    def term_slopes(self, points: Floats) -> Floats:
        """Return the derivatives of the terms along x and y, per unit of the points, (2, n, l + 3).

        Examples
        --------
        >>> ThinPlateSpline([[0, 0], [2, 0], [0, 2]]).term_slopes(np.array([[1.0, 1.0]])).shape
        (2, 1, 6)
        """
        offsets = _offsets(self._normalised(points), self._normalised(self.control_points))
        radial = 1 + np.log(np.maximum(offsets[0] ** 2 + offsets[1] ** 2, np.finfo(float).tiny))
        terms = np.zeros((2, len(points), len(self.control_points) + 3))
        for b in range(2):
            terms[b, :, :-3] = radial * offsets[b]
            terms[b, :, b - 3] = 1
        return np.asarray(terms / self._scale)

    @cached_property
    def _centre(self) -> Floats:
        return np.asarray(self.control_points.mean(axis=0))

    @cached_property
    def _scale(self) -> float:
        return float(np.hypot(*(self.control_points - self._centre).T).max())

    def _normalised(self, points: Floats) -> Floats:
        # A similarity changes phi by multiples of r^2, which the conditions on w turn into constants: the
        # functions are the same, and coordinates of thousands of pixels lose no digits.
        return np.asarray((points - self._centre) / self._scale)

    @cached_property
    def _solution(self) -> tuple[Floats, Floats]:
        """Return the cardinal functions' weights and affine parts, and the bending rows.

        With U an orthonormal basis of {w : sum_k w_k (1, c_k) = 0}, G = U^T K U is positive definite, w = E x
        with E = U G^-1 U^T, and the affine part interpolates what K w leaves: a = P^+ (x - K E x).
        """
        terms = self.terms(self.control_points)
        kernel, affine = terms[:, :-3], terms[:, -3:]
        side = np.linalg.qr(affine, mode="complete").Q[:, 3:]
        factor = np.linalg.cholesky(side.T @ kernel @ side)
        bending = np.linalg.solve(factor, side.T)
        weights = bending.T @ bending
        remainder = np.eye(len(kernel)) - kernel @ weights
        return np.vstack([weights, np.linalg.pinv(affine) @ remainder]), bending


LIFTINGS: dict[str, Callable[[Floats], Lifting]] = {ThinPlateSpline.name: ThinPlateSpline}
"""Every lifting by the name that `fit_warp` and files use."""


def make_lifting(name: str, control_points: ArrayLike) -> Lifting:
    """Return the lifting of a name over control points, (l, 2).

    Raises
    ------
    ValueError
        If there is no lifting of this name, or the control points do not suit it.

    Examples
    --------
    >>> make_lifting("tps", [[0, 0], [1, 0], [0, 1]])
    ThinPlateSpline(3 control points)
    """
    if not isinstance(name, str) or name not in LIFTINGS:
        check.refuse("lifting", f"It must be one of {', '.join(LIFTINGS)}.", check.describe(name))
    return LIFTINGS[name](check.points(control_points, "control_points"))


@np.errstate(over="ignore", invalid="ignore")
def evaluate(lifting: Lifting, points: Floats, parameters: Floats) -> Floats:
    """Return nu(q_i) . x for every column x of the parameters.

    Parameters
    ----------
    lifting : Lifting
        With l control points.
    points : ndarray, (n, 2)
        Positions; a million of them need no (n, l) array.
    parameters : ndarray, (l, r)
        One column a function.

    Returns
    -------
    ndarray, (n, r)
        Values, in the unit of the parameters.

    Examples
    --------
    >>> plane = ThinPlateSpline([[0, 0], [1, 0], [0, 1]])
    >>> evaluate(plane, np.array([[2.0, 0.5]]), np.array([[1.0], [2.0], [3.0]])).round(6)
    array([[4.]])
    """
    weights = lifting.expansion @ parameters
    values = np.empty((len(points), parameters.shape[1]))
    for rows in _blocks(len(points), len(weights)):
        values[rows] = lifting.terms(points[rows]) @ weights
    return values


@np.errstate(over="ignore", invalid="ignore")
def slopes(lifting: Lifting, points: Floats, parameters: Floats) -> Floats:
    """Return the derivatives of nu(q) . x, for every column x of the parameters.

    Parameters
    ----------
    lifting : Lifting
        With l control points.
    points : ndarray, (n, 2)
        Positions; a million of them need no (n, l, 2) array.
    parameters : ndarray, (l, r)
        One column a function.

    Returns
    -------
    ndarray, (n, r, 2)
        Element [i, a, b] is the derivative of function a along coordinate b at point i.

    Examples
    --------
    >>> plane = ThinPlateSpline([[0, 0], [1, 0], [0, 1]])
    >>> slopes(plane, np.array([[2.0, 0.5]]), np.array([[1.0], [2.0], [3.0]])).round(6)
    array([[[1., 2.]]])
    """
    weights = lifting.expansion @ parameters
    values = np.empty((len(points), parameters.shape[1], 2))
    for rows in _blocks(len(points), len(weights)):
        for b, terms in enumerate(lifting.term_slopes(points[rows])):
            values[rows, :, b] = terms @ weights
    return values


@np.errstate(over="ignore", invalid="ignore")
def nested_basis(points: ArrayLike, control_points: ArrayLike) -> Floats:
    """Return functions of which the first k span the thin-plate splines of the first k control points.

    The first three are the barycentric coordinates with respect to the first three control points. Function
    k > 3 is phi(|q - c_k|) minus its barycentric combination of the kernels of these three, in coordinates
    where they are about one apart: a function does not change with the control points after its own.

    Parameters
    ----------
    points : array_like, (n, 2)
        Positions, in the unit of the control points.
    control_points : array_like, (l, 2)
        As for `ThinPlateSpline`. The farther apart the first three are, the fewer digits are lost.

    Returns
    -------
    ndarray, (n, l)
        Row i holds the functions at q_i.

    Raises
    ------
    ValueError
        If the control points suit no thin-plate spline, or the first three are on a line.

    Examples
    --------
    >>> corners = [[0, 0], [2, 0], [0, 2], [2, 2]]
    >>> nested_basis([[1, 1], [2, 2]], corners).round(6) + 0.0
    array([[ 0.      ,  0.5     ,  0.5     ,  0.      ],
           [-1.      ,  1.      ,  1.      ,  0.693147]])
    """
    points, origin, scale, centres, shares = check.points(points, "points"), *_nested_frame(control_points)
    functions = np.empty((len(points), len(centres)))
    for rows in _blocks(len(points), len(centres)):
        here = (points[rows] - origin) / scale
        kernel = _kernel(here, centres)
        functions[rows, :3] = _barycentric(here, centres)
        functions[rows, 3:] = kernel[:, 3:]
        for i in range(3):
            functions[rows, 3:] -= np.outer(kernel[:, i], shares[3:, i])
    return functions


def nested_bending(control_points: ArrayLike) -> Floats:
    """Return the rows Z whose squared norm is the bending energy, of every leading part of `nested_basis`.

    The energy of the k-th leading model is ||Z[:k - 3, :k] x||^2, in the unit of `ThinPlateSpline.bending`.

    Parameters
    ----------
    control_points : array_like, (l, 2)
        As for `nested_basis`.

    Returns
    -------
    ndarray, (l - 3, l)
        Zeros for the affine functions, then an upper triangle.

    Examples
    --------
    >>> energy = nested_bending([[0, 0], [2, 0], [0, 2], [2, 2]]) @ [5, 5, 5, 1]
    >>> (energy @ energy).round(6)
    np.float64(0.693147)
    """
    _, scale, centres, shares = _nested_frame(control_points)
    weights = np.vstack([-shares[3:].T, np.eye(len(centres) - 3)])
    side, triangle = np.linalg.qr(weights)
    factor = np.linalg.cholesky(side.T @ _kernel(centres, centres) @ side)
    rows = np.zeros((len(centres) - 3, len(centres)))
    rows[:, 3:] = factor.T @ triangle / scale
    return rows


def _nested_frame(control_points: ArrayLike) -> tuple[Floats, float, Floats, Floats]:
    """Return origin, unit, and the control points in this frame, with their barycentric coordinates."""
    points = check.points(control_points, "control_points")
    _check_spread(points)
    if thinness(points[:3]) <= NEAR_LINE:
        rule = f"The first three must not lie on a line, to within {NEAR_LINE:g} of their extent."
        check.refuse("control_points", rule, f"{points[:3].tolist()}")
    origin = points[0]
    scale = float(np.hypot(*(points[1:3] - origin).T).max())
    centres = (points - origin) / scale
    return origin, scale, centres, _barycentric(centres, centres)


def _barycentric(points: Floats, centres: Floats) -> Floats:
    """Return barycentric coordinates with respect to the first three centres, of which the first is 0."""
    (x, y), (a, b), (c, d) = points.T, *centres[1:3]
    second, third = (d * x - c * y) / (a * d - b * c), (a * y - b * x) / (a * d - b * c)
    return np.column_stack([1 - second - third, second, third])


def _blocks(n: int, width: int) -> Iterator[slice]:
    step = max(1, _CHUNK // width)
    return (slice(first, first + step) for first in range(0, n, step))


def _offsets(points: Floats, centres: Floats) -> tuple[Floats, Floats]:
    x, y = (np.subtract.outer(points[:, b], centres[:, b]) for b in range(2))
    return x, y


def _kernel(points: Floats, centres: Floats) -> Floats:
    """Return phi = r^2 log r = (r^2 log r^2) / 2, (n, l); the floor under the logarithm gives 0 at r = 0."""
    x, y = _offsets(points, centres)
    squared = x**2 + y**2
    return np.asarray(0.5 * squared * np.log(np.maximum(squared, np.finfo(float).tiny)))


def _check_spread(points: Floats) -> None:
    name = "control_points"
    if len(points) < 3:
        check.refuse(name, "There must be 3 or more.", f"{len(points)}")
    if thinness(points) <= NEAR_LINE:
        rule = f"They must not lie on a line, to within {NEAR_LINE:g} of their extent."
        check.refuse(name, rule, f"{len(points)} points on a line")
    size = np.hypot(*(points - points.mean(axis=0)).T).max()
    distance = np.hypot(*_offsets(points / size, points / size))
    np.fill_diagonal(distance, np.inf)
    first, second = np.unravel_index(distance.argmin(), distance.shape)
    if distance[first, second] <= COINCIDENT:
        rule = f"They must be farther apart than {COINCIDENT:g} of their extent."
        check.refuse(
            name, rule, f"{points[first].tolist()} at {first} and {points[second].tolist()} at {second}"
        )
