"""Bicubic B-splines: smooth and local."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _core
from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.caching import cached_property
from mexpress.geometry import Region
from mexpress.liftings.grids import grid, grid_counts
from mexpress.liftings.lifting import register
from mexpress.liftings.sparse import LocalLifting

_SLACK = 1e-4
"""Largest distance of a control point from the grid, as a fraction of the step."""

_CUBIC = np.array([[1, -3, 3, -1], [4, 0, -6, 3], [1, 3, 3, -3], [0, 0, 0, 1]]) / 6
"""Row a: coefficients of 1, u, u^2, u^3 in the a-th of the four functions of a cell, u in [0, 1]."""


class _Axis(NamedTuple):
    """Grid lines across one axis; the first and the last are outside the span."""

    low: float
    step: float
    number: int


@register
class BSpline(LocalLifting):
    """Uniform bicubic B-splines, each centred at a control point of a regular grid.

    At every point 16 functions are nonzero; they are positive, sum to one, and are twice continuously differentiable.
    An affine function a has the parameters a(c_k), but in general a parameter is not the value at its control point.
    The span ends one grid line before the outermost line. Outside the span, the functions continue along each axis with
    the value and the slope at its edge. A warp is a BBS warp, or with a denominator a NURBS warp with fitted weights.

    Parameters
    ----------
    control_points : array_like, (l, 2)
        A grid of at least 4 x 4 points, in any order, as `place` returns it. The steps along x and y may differ.

    Raises
    ------
    ValueError
        If the control points are not such a grid, to within 1e-4 of its steps.

    Examples
    --------
    >>> spline = BSpline(BSpline.place([[0, 0], [30, 0], [30, 20], [0, 20]], 30))
    >>> spline
    BSpline(30 control points)
    >>> spline.span
    array([[ 0.,  0.], [30.,  0.], [30., 20.], [ 0., 20.]])
    >>> spline.values(np.array([[7.0, 3.0], [99.0, 3.0]]), spline.control_points).round(6)
    array([[ 7.,  3.], [99.,  3.]])
    """

    name: ClassVar[str] = "bspline"

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self._grid  # raises if there is no grid

    @cached_property
    def span(self) -> Floats:
        """Corners of the rectangle outside which the lifting extrapolates, (4, 2), counter-clockwise."""
        x, y = ((axis.low + axis.step, axis.low + (axis.number - 2) * axis.step) for axis in self._grid[:2])
        return np.array([[x[0], y[0]], [x[1], y[0]], [x[1], y[1]], [x[0], y[1]]])

    def bending(self) -> Floats:
        """Return the rows Z of the bending energy ||Z x||^2, (l - 3, l).

        8 pi ||Z x||^2 is the integral of f_xx^2 + 2 f_xy^2 + f_yy^2 over the span. For a thin-plate spline the integral
        is over the plane, so a weight gives the same stiffness.

        Examples
        --------
        >>> bowl = BSpline(BSpline.place([[0, 0], [3, 0], [3, 2], [0, 2]], 30))
        >>> x = (bowl.control_points**2).sum(axis=1)
        >>> float(8 * np.pi * ((bowl.bending() @ x) ** 2).sum() / (4 + 4)).__round__(6)
        6.0
        """
        x, y, order = self._grid
        along_x, along_y = (_factors(axis) for axis in (x, y))
        rows = np.vstack(
            [np.kron(along_y[k], along_x[2 - k]) * root for k, root in enumerate((1, np.sqrt(2), 1))]
        )
        i, j = np.tile(np.arange(x.number), y.number), np.repeat(np.arange(y.number), x.number)
        affine = np.column_stack([np.ones(len(i)), i - i.mean(), j - j.mean()])
        bending = np.empty((len(i) - 3, len(i)))
        # On the complement of the affine functions, so that rounding does not bend them.
        bent = _core.reduced_bending(rows, affine, check.threads(None))
        bending[:, order.ravel()] = bent / np.sqrt(8 * np.pi)
        return bending

    @classmethod
    def counts(cls, region: Floats, largest: int) -> list[int]:
        """Return the numbers of control points of the grids of `place`, increasing.

        Examples
        --------
        >>> BSpline.counts(np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 2.0]]), 36)
        [16, 20, 24, 30, 35]
        """
        return grid_counts(region, largest, ring=1)

    @classmethod
    def place(cls, points: ArrayLike, count: int, seed: int = 0, threads: int | None = None) -> Floats:
        """Return the grid whose span is the bounding box of the points, with the number nearest to a count, (l, 2).

        The cells are as square as possible. Nothing is random.

        Examples
        --------
        >>> BSpline.place([[0, 0], [4, 0], [4, 2], [0, 2]], 16)[:5]
        array([[-4., -2.], [ 0., -2.], [ 4., -2.], [ 8., -2.], [-4.,  0.]])
        """
        return grid(points, count, ring=1)

    @classmethod
    def place_over(cls, region: Region, count: int, seed: int = 0, threads: int | None = None) -> Floats:
        """Return the control points of `place` over a known region."""
        return grid(region, count, ring=1)

    @cached_property
    def _functions(self) -> _core.LocalFunctions:
        x, y, order = self._grid
        return _core.LocalFunctions.bsplines(x, y, order.ravel().view(np.uintp))

    @cached_property
    def _grid(self) -> tuple[_Axis, _Axis, NDArray[np.intp]]:
        """Return both axes, and the index of the control point in every row and column of the grid."""
        (x, i), (y, j) = (_lines(coordinates) for coordinates in self.control_points.T)
        if min(x.number, y.number) < 4 or len(np.unique(i + x.number * j)) != x.number * y.number:
            rule = "They must be a regular grid along x and y, of 4 x 4 or more, as BSpline.place makes it."
            check.refuse("control_points", rule, f"{len(i)} points with {x.number} x and {y.number} y")
        order = np.empty((y.number, x.number), dtype=np.intp)
        order[j, i] = np.arange(len(i))
        return x, y, order


def _lines(coordinates: Floats) -> tuple[_Axis, NDArray[np.intp]]:
    """Return the grid lines of coordinates, and the line of each."""
    ordered = np.sort(coordinates)
    gaps = np.diff(ordered)
    count = 1 + int((gaps > gaps.max() / 2).sum())
    low, step = float(ordered[0]), float(ordered[-1] - ordered[0]) / (count - 1)
    place = (coordinates - low) / step
    index = np.rint(place).astype(np.intp)
    if (np.abs(place - index) > _SLACK).any():
        rule = f"They must be a regular grid along x and y, to within {_SLACK:g} of its steps."
        where = int(np.abs(place - index).argmax())
        check.refuse("control_points", rule, f"the coordinate {coordinates[where]:g} at {where}")
    return _Axis(low, step, count), index


def _in_a_cell(u: Floats, order: int) -> Floats:
    """Return the four functions of a cell, or their first or second derivatives by u, (4, n)."""
    zero = np.zeros_like(u)
    powers = ([zero + 1, u, u**2, u**3], [zero, zero + 1, 2 * u, 3 * u**2], [zero, zero, zero + 2, 6 * u])
    return np.asarray(_CUBIC @ np.stack(powers[order]))


def _factors(axis: _Axis) -> list[Floats]:
    """Return R_k, (count, count), for k = 0, 1, 2: ||R_k x||^2 is the integral of the squared k-th derivative."""
    cells = axis.number - 3
    nodes, weights = np.polynomial.legendre.leggauss(4)  # exact up to degree 7
    factors = []
    for k in range(3):
        rows = np.zeros((cells, 4, axis.number))
        here = _in_a_cell((nodes + 1) / 2, k).T * np.sqrt(weights / 2 * axis.step)[:, None] / axis.step**k
        for cell in range(cells):
            rows[cell, :, cell : cell + 4] = here
        factors.append(np.linalg.qr(rows.reshape(-1, axis.number)).R)
    return factors
