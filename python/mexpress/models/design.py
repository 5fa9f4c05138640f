"""Fits of warps and surfaces as linear least-squares problems: the way from functions to a design, and back.

A surface, or a warp without a denominator (a surface of two values), is a `LinearDesign`; a warp with a denominator is
a `FractionalDesign`. Either takes the functions of a lifting (`CardinalBasis`), or thin-plate splines in an order of
their control points (`NestedBasis`). With a `NestedBasis`, the first columns are the design of the first control
points, and all numbers of control points can be scored at once.

Examples
--------
>>> import numpy as np
>>> from mexpress.models import NestedBasis, Surface, linear_design
>>> square = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 2.0], [2.0, 2.0]])
>>> linear_design(NestedBasis(square), square, np.array([0.0, 2.0, 2.0, 4.0]), Region.of(square), Surface).columns(3)
3
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar, Generic, Self, TypeAlias, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _core
from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.geometry import Region, middle
from mexpress.leastsquares.model import LeastSquares
from mexpress.liftings import Lifting, NestedSplines, ThinPlateSpline
from mexpress.models.base import Model
from mexpress.models.observations import Observations

ModelT = TypeVar("ModelT", bound=Model)


@dataclass(frozen=True)
class CardinalBasis:
    """The functions of a lifting; with most liftings, parameters are values at the control points.

    Examples
    --------
    >>> from mexpress.liftings import ThinPlateSpline
    >>> CardinalBasis(ThinPlateSpline([[0, 0], [1, 0], [0, 1]])).count
    3
    """

    functions: Lifting

    def __repr__(self) -> str:
        return f"CardinalBasis({self.functions!r})"

    @property
    def count(self) -> int:
        """Number of control points, l."""
        return len(self.functions.control_points)

    def at(self, points: Floats) -> Floats:
        """Return the functions at points, (n, l)."""
        return self.functions.at(points)

    def bending(self) -> Floats:
        """Return the rows Z of the bending energy, (k, l)."""
        return self.functions.bending()

    def lifting(self, count: int) -> Lifting:
        """Return the lifting; it has all control points, since its basis is not nested."""
        return self.functions

    def parameters(self, count: int) -> Floats:
        """Return the matrix from coefficients to parameters of the lifting: the identity."""
        return np.eye(count)

    def denominators(self, rows: Floats, normal: Floats, one: float = 1.0) -> tuple[Floats, Floats]:
        """Return rows @ origin and rows @ N, for rows (n, l): all p_3 with normal . p_3 = 1 are origin + N z.

        The parameters of the origin are all equal, and N is an orthonormal complement of the normal. `one` is the image
        of the constant function 1 under a row: 1 if the rows are values, 0 if they are bendings.
        """
        mirror = normal / np.linalg.norm(normal)
        sign = 1.0 if mirror[0] >= 0 else -1.0
        # A Householder reflection maps the normal to the first axis, and the other axes to its complement.
        mirror[0] += sign
        along = (rows * mirror).sum(axis=1)
        return rows.sum(axis=1) / normal.sum(), rows[:, 1:] - np.outer(along, mirror[1:] / (sign * mirror[0]))

    def blocks(self, count: int) -> tuple[Integers, Integers, Integers]:
        """Return the columns of p_1 (l), p_2 (l) and z (l - 1), one block after another."""
        columns = np.arange(3 * count - 1)
        return columns[:count], columns[count : 2 * count], columns[2 * count :]


class NestedBasis:
    """Thin-plate splines in an order of their control points: the first k functions belong to the first k of them.

    The functions psi_k are those of `mexpress.liftings.nested_basis`. A denominator is 1 + sum z_k (psi_k - mean of
    psi_k) over all functions except the first, so the condition on it does not depend on later control points.

    Parameters
    ----------
    control_points : array_like, (l, 2)
        In their order. The first three are not on a line, and are best far apart.

    Raises
    ------
    ValueError
        If they suit no thin-plate spline, or the first three are on a line.

    Examples
    --------
    >>> NestedBasis([[0, 0], [1, 0], [0, 1], [1, 1]])
    NestedBasis(4 control points)
    """

    def __init__(self, control_points: ArrayLike) -> None:
        self._control_points = check.points(control_points, "control_points")
        self._splines = NestedSplines(self._control_points)

    def __repr__(self) -> str:
        return f"NestedBasis({self.count} control points)"

    @property
    def count(self) -> int:
        """Number of control points, l."""
        return len(self._control_points)

    def at(self, points: Floats) -> Floats:
        """Return the functions at points, (n, l)."""
        return self._splines.at(points)

    def bending(self) -> Floats:
        """Return the rows Z of the bending energy, (l - 3, l); their first columns are those of the first functions."""
        return self._splines.bending()

    def lifting(self, count: int) -> Lifting:
        """Return the thin-plate spline of the first control points."""
        return ThinPlateSpline(self._control_points[:count])

    def parameters(self, count: int) -> Floats:
        """Return the first functions at the first control points: the parameters of a spline are its values there."""
        centres = self._control_points[:count]
        return NestedSplines(centres).at(centres)

    def denominators(self, rows: Floats, normal: Floats, one: float = 1.0) -> tuple[Floats, Floats]:
        """Return the images under the rows of the constant 1, and of every function except the first minus its mean."""
        return np.full(len(rows), one), (rows - one * normal[: rows.shape[1]])[:, 1:]

    def blocks(self, count: int) -> tuple[Integers, Integers, Integers]:
        """Return the columns of the first three control points (eight), then three columns for each later one."""
        later = np.arange(8, 3 * count - 1, 3)
        first = np.concatenate([[0, 1, 2], later])
        second = np.concatenate([[3, 4, 5], later + 1])
        return first, second, np.concatenate([[6, 7], later + 2])


Basis: TypeAlias = CardinalBasis | NestedBasis


@dataclass(frozen=True, eq=False, repr=False)
class Design(ABC, Generic[ModelT]):
    """Minimise ||b - A x||^2 + smoothing ||Z x||^2, where ||Z x||^2 is the bending energy of a warp or a surface.

    Attributes
    ----------
    A : ndarray, (m, p)
        Design matrix.
    b : ndarray, (m,) or (m, r)
        Responses.
    basis : Basis
        Functions of the model.
    domain : Region
        Region that the data cover.
    kind : type
        `Surface` or `Warp`.
    data : Observations
        The data, with their weights, which models keep.
    coupling : int
        Rows of A per datum.
    """

    A: Floats
    b: Floats
    basis: Basis
    domain: Region
    kind: type[ModelT]
    data: Observations
    coupling: ClassVar[int] = 1

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.A.shape[0]} x {self.A.shape[1]}, {self.basis!r})"

    @property
    def count(self) -> int:
        """Number of control points."""
        return self.basis.count

    @property
    def weights(self) -> Floats | None:
        """Weights of the data, (n,); 1 each if None."""
        return self.data.weights

    @abstractmethod
    def columns(self, count: int) -> int:
        """Return the number of columns of the first control points."""

    @abstractmethod
    def bending(self) -> Floats:
        """Return the rows Z, (k, p); with a nested basis, their first columns are those of the smaller designs."""

    @abstractmethod
    def model(self, x: ArrayLike, count: int | None = None, smoothing: float = 0.0) -> ModelT:
        """Return the model of a solution.

        Parameters
        ----------
        x : array_like, (columns(count),) or (columns(count), r)
            Coefficients of the first columns; those of later columns are 0.
        count : int, optional
            Number of control points; all by default.
        smoothing : float
            Weight of the bending energy in the fit, which the model keeps.
        """

    def _model(self, count: int, parameters: Floats, smoothing: float) -> ModelT:
        # A Region passes as the array of its corners, and is not computed again.
        domain = cast(Floats, self.domain)
        return self.kind(self.basis.lifting(count), parameters, domain, smoothing, self.data)

    @abstractmethod
    def rows_at(self, points: Floats) -> tuple[Floats, Floats]:
        """Return what a solution x becomes at points (k, 2): f numbers each, rows (f, k, p) @ x + constants (f, k)."""

    @abstractmethod
    def values_of(self, numbers: Floats) -> Floats:
        """Return the values (..., d) of the model that such numbers (f, ..., r) mean."""

    def weighted(self, weights: Floats | None) -> Self:
        """Return the design with other weights of the data."""
        return replace(self, data=replace(self.data, weights=weights))

    def fit(self, smoothing: float = 0.0, threads: int | None = None) -> LeastSquares:
        """Fit the design with a weight of the bending energy."""
        rows = math.sqrt(smoothing) * self.bending() if smoothing else None
        return LeastSquares(self.A, self.b, self.coupling, self.weights, rows, threads=threads)


@dataclass(frozen=True, eq=False, repr=False)
class LinearDesign(Design[ModelT]):
    """A surface, or a warp without a denominator: every value is a response, and all responses share the functions.

    The bending energy is that of one value, in (unit of the value)^2 per (unit of the points)^2; it applies to every
    response.

    Attributes
    ----------
    A : ndarray, (n, l)
        Functions at the data.
    b : ndarray, (n,) or (n, d)
        Values at the data, relative to the centre.
    centre : ndarray, () or (d,)
        Middle between the smallest and the largest value. All functions sum to one, so that a constant changes nothing
        but digits: of values far from zero, few would be left.

    Examples
    --------
    >>> from mexpress.liftings import ThinPlateSpline
    >>> from mexpress.models import Surface
    >>> square = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 2.0], [2.0, 2.0]])
    >>> plane = CardinalBasis(ThinPlateSpline(square[:3]))
    >>> design = linear_design(plane, square, np.array([0.0, 2.0, 2.0, 4.0]), Region.of(square), Surface)
    >>> design
    LinearDesign(4 x 3, CardinalBasis(ThinPlateSpline(3 control points)))
    >>> design.model(design.fit().coefficients)
    Surface(depth, tps, 3 control points)
    """

    centre: Floats

    def columns(self, count: int) -> int:
        """Return the number of columns of the first control points: one each."""
        return count

    def bending(self) -> Floats:
        """Return the rows Z of the basis, (k, l)."""
        return self.basis.bending()

    def model(self, x: ArrayLike, count: int | None = None, smoothing: float = 0.0) -> ModelT:
        """Return the model of a solution, see `Design`."""
        count = self.count if count is None else count
        with np.errstate(over="ignore", invalid="ignore"):
            solution = np.asarray(x, dtype=np.float64)[:count]
            columns = np.ascontiguousarray(solution.reshape(count, -1))
            product = _core.product(self.basis.parameters(count), columns, check.threads(None))
            parameters = self.centre + product.reshape(solution.shape)
        largest = float(np.abs(parameters).max())
        if not largest <= check.LARGEST_PARAMETER:  # the user has not given them
            rule = (
                f"The parameters of its model must not exceed {check.LARGEST_PARAMETER:g}: take another unit."
            )
            check.refuse("values", rule, f"values of up to {np.abs(self.data.values).max():g}")
        return self._model(count, parameters, smoothing)

    def rows_at(self, points: Floats) -> tuple[Floats, Floats]:
        """Return the functions at points: every value is a number."""
        return self.basis.at(points)[None], np.zeros((1, len(points)))

    def values_of(self, numbers: Floats) -> Floats:
        """Return the centre plus the numbers: the values."""
        return np.asarray(self.centre + numbers[0])


@dataclass(frozen=True, eq=False, repr=False)
class FractionalDesign(Design[ModelT]):
    """The algebraic error of a warp with a denominator, in pixels of the target image.

    The bending energy is the sum over the three functions of the warp, with the target centred and the denominator
    times `scale`. All three are then in pixels of the target image, and a similarity of that image does not change the
    solution.

    Attributes
    ----------
    A : ndarray, (2n, 3l - 1)
        Rows 2i and 2i + 1 are the x and y equations of match i; columns are in the order of the basis.
    b : ndarray, (2n,)
        Responses.
    centre : ndarray, (2,)
        Mean of the target points, the origin of the unknowns p_1 and p_2.
    scale : float
        Root mean square distance of the target points to their mean, the unit of p_1 and p_2.
    normal : ndarray, (l,)
        Denominators satisfy normal . p_3 = 1, see `fractional_design`.

    Examples
    --------
    >>> from mexpress.liftings import ThinPlateSpline
    >>> from mexpress.models import Warp
    >>> square = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0], [100.0, 100.0]])
    >>> homography = CardinalBasis(ThinPlateSpline(square[:3]))
    >>> design = fractional_design(homography, square, 2 * square, Region.of(square), Warp)
    >>> design
    FractionalDesign(8 x 8, CardinalBasis(ThinPlateSpline(3 control points)))
    >>> design.model(design.fit().coefficients)
    Warp(fractional tps, 3 control points)
    """

    centre: Floats
    scale: float
    normal: Floats
    coupling: ClassVar[int] = 2

    def columns(self, count: int) -> int:
        """Return the number of columns of the first control points: three each, minus one."""
        return 3 * count - 1

    def bending(self) -> Floats:
        """Return the rows Z, (3k, 3l - 1): those of the basis, for each of the three functions."""
        one = self.basis.bending()
        first, second, third = self.basis.blocks(self.count)
        rows = np.zeros((3, len(one), self.A.shape[1]))
        rows[0][:, first] = rows[1][:, second] = one
        _, rows[2][:, third] = self.basis.denominators(one, self.normal, 0.0)
        return self.scale * rows.reshape(3 * len(one), self.A.shape[1])

    def model(self, x: ArrayLike, count: int | None = None, smoothing: float = 0.0) -> ModelT:
        """Return the warp of a solution, see `Design`."""
        count = self.count if count is None else count
        first, second, third = (np.asarray(x, dtype=np.float64)[block] for block in self.basis.blocks(count))
        functions = self.basis.parameters(count)
        constant, varying = self.basis.denominators(functions, self.normal)
        denominator = constant + (varying * third).sum(axis=1)
        columns = np.column_stack([first, second])
        numerators = _core.product(self.scale * functions, columns, check.threads(None))
        numerators += np.outer(denominator, self.centre)
        parameters = np.column_stack([numerators, denominator])
        return self._model(count, parameters, smoothing)

    def rows_at(self, points: Floats) -> tuple[Floats, Floats]:
        """Return the rows of two numerators, of the centred target, and of the denominator."""
        functions = self.basis.at(points)
        first, second, third = self.basis.blocks(self.count)
        constant, varying = self.basis.denominators(functions, self.normal)
        rows = np.zeros((3, len(points), self.A.shape[1]))
        rows[0][:, first] = rows[1][:, second] = self.scale * functions
        rows[2][:, third] = varying
        return rows, np.stack([0 * constant, 0 * constant, constant])

    def values_of(self, numbers: Floats) -> Floats:
        """Return target points: the centre plus numerators over denominators."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self.centre + np.moveaxis(numbers[:2, ..., 0] / numbers[2, ..., 0], 0, -1))


def linear_design(
    basis: Basis, points: Floats, values: Floats, domain: Region, kind: type[ModelT]
) -> LinearDesign[ModelT]:
    """Write the fit of a surface, or of a warp without a denominator, as a linear least-squares problem.

    `points` (n, 2) are finite; `values` (n,) or (n, d) are depths, points in space, or target points of a warp; `kind`
    is `Surface` or `Warp`.
    """
    centre = middle(values)
    data = Observations(points, values)
    return LinearDesign(basis.at(points), values - centre, basis, domain, kind, data, centre)


def fractional_design(
    basis: Basis,
    source: Floats,
    target: Floats,
    domain: Region,
    kind: type[ModelT],
    over_data: bool | None = None,
) -> FractionalDesign[ModelT]:
    """Write the fit of a warp with a denominator as a linear least-squares problem (eqs. 16-21).

    The algebraic error of match i is s (t p_3 . nu - p . nu) for p = p_1, p_2 and t = x, y of the target point, centred
    and in units of s. With denominators of mean one, it is close to the transfer error in pixels. A similarity of
    either image changes the solution only by rounding.

    Parameters
    ----------
    basis : Basis
        Functions of the source image.
    source, target : ndarray, (n, 2)
        Matches in pixels, finite.
    domain : Region
        Region that the source points cover.
    kind : type
        `Warp`.
    over_data : bool, optional
        Whether the denominators have mean one over the matches, as nested models need it. Otherwise their parameters
        have mean one, as in the paper (eq. 19): for a thin-plate spline that is the mean over the control points, and
        the default of a cardinal basis. Control points of other liftings may be far from the matches, where a
        denominator can grow while it vanishes over the matches.
    """
    functions = basis.at(source)
    n, count = functions.shape
    lowest = target.min(axis=0)
    mean = (target - lowest).mean(axis=0)  # the mean of the target itself is rounded far from zero
    about = (target - lowest) - mean
    scale = float(np.sqrt((about**2).sum(axis=1).mean())) or 1.0
    if over_data is None:
        over_data = not (isinstance(basis, CardinalBasis) and isinstance(basis.functions, ThinPlateSpline))
    normal = functions.mean(axis=0) if over_data else np.full(count, 1 / count)
    first, second, third = basis.blocks(count)
    constant, varying = basis.denominators(functions, normal)
    rows = np.zeros((n, 2, 3 * count - 1))
    rows[:, 0, first] = rows[:, 1, second] = scale * functions
    rows[:, :, third] = -about[:, :, None] * varying[:, None, :]
    right = about * constant[:, None]
    return FractionalDesign(
        rows.reshape(2 * n, -1),
        right.reshape(-1),
        basis,
        domain,
        kind,
        Observations(source, target, over_data=over_data),
        lowest + mean,
        scale,
        normal,
    )
