"""Prediction intervals from all leave-one-out models of a design: jackknife+ in closed form."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Generic

import numpy as np

from mexpress import _core
from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.leastsquares.model import cross_validate_all
from mexpress.models.design import Design, ModelT
from mexpress.schemes import leave_one_out

_ENTRIES = 1 << 22
"""Numbers that are in memory together, at most: a block of points times the data."""


@dataclass(frozen=True, eq=False, repr=False)
class Interval:
    """Lower and upper bounds of values.

    Parameters
    ----------
    lower, upper : (k,) or (k, d) array
        In the unit of the values; infinite where the data are too few for a bound, NaN where there is no position.

    Examples
    --------
    >>> Interval(np.zeros(2), np.array([1.0, 3.0]))
    Interval(2 points, median width 2)
    """

    lower: Floats
    upper: Floats

    def __repr__(self) -> str:
        widths = self.upper - self.lower
        widths = widths[~np.isnan(widths)]
        known = f", median width {np.median(widths):.4g}" if widths.size else ""
        return f"Interval({len(self.lower)} points{known})"


class Jackknife(Generic[ModelT]):
    """All models of a design that leave out one datum, from one factorisation.

    With an orthonormal basis Q of the weighted design over its penalty rows, Q R = [sqrt(w) A; sqrt(s) Z], the
    coefficients without datum i are x - R^-1 Q_i^T sqrt(w_i) e_(i), e_(i) its leave-one-out residuals (equation 6).
    All products are the core's, whose results do not depend on the threads of NumPy's BLAS.

    Parameters
    ----------
    design : Design
        Of n data.
    smoothing : float
        Weight of the bending energy.

    Examples
    --------
    >>> from mexpress.geometry import Region
    >>> from mexpress.models import NestedBasis, Surface, linear_design
    >>> square = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    >>> values, plane = np.array([0.0, 1.0, 1.0, 3.0]), NestedBasis(square[:3])
    >>> design = linear_design(plane, square, values, Region.of(square), Surface)
    >>> next(Jackknife(design, 0.0).predictions(square[3:]))[0, :, 0].round(9)
    array([3., 3., 3., 2.])
    """

    def __init__(self, design: Design[ModelT], smoothing: float) -> None:
        self._design = design
        self._fit = fit = design.fit(smoothing)
        n, g = fit.n_data, design.coupling
        left_out = cross_validate_all(fit, {"": leave_one_out(n)}, None)[""].residuals
        self._basis = fit._weighted_basis
        self._across = np.ascontiguousarray(self._basis.T)
        self._coefficients = fit.coefficients.reshape(len(fit.coefficients), -1)
        self._changes = left_out.reshape(n, g, -1)

    def residuals(self) -> Floats:
        """Return how far every datum is from the model without it, (n, d); NaN if the others determine no model."""
        data = self._design.data
        n, g, _ = self._changes.shape
        own = np.empty((n, data.values[0].size))
        step = max(1, _ENTRIES * n // self._basis.size)
        for first in range(0, n, step):
            some = slice(first, first + step)
            rows, numbers = self._whole(data.points[some])
            basis = self._basis.reshape(n, g, -1)[some]
            changes = np.einsum("fkp,kgp,kgr->fkr", rows, basis, self._changes[some], optimize=True)
            own[some] = self._design.values_of(numbers - changes)
        return data.values.reshape(own.shape) - own

    def predictions(self, points: Floats) -> Iterator[Floats]:
        """Return the values at points of the models without each datum, block by block of points: (block, n, d)."""
        n, g, r = self._changes.shape
        step = max(1, _ENTRIES // (3 * n * max(g, r)))
        for first in range(0, len(points), step):
            rows, numbers = self._whole(points[first : first + step])
            together = _product(rows, self._across).reshape(*rows.shape[:2], n, g)
            changes = np.einsum("fkng,ngr->fknr", together, self._changes, optimize=True)
            yield self._design.values_of(numbers[:, :, None] - changes)

    def _whole(self, points: Floats) -> tuple[Floats, Floats]:
        """Return rows at points over the orthonormal basis, (f, k, p), and numbers of the whole model, (f, k, r)."""
        rows, constants = self._design.rows_at(points)
        numbers = _product(rows, self._coefficients) + constants[:, :, None]
        return self._fit._over_basis(rows.reshape(-1, rows.shape[-1])).reshape(rows.shape), numbers


def jackknife_plus(design: Design[ModelT], smoothing: float, points: Floats, level: float) -> Interval:
    """Return the jackknife+ interval of a design's model at points, (k, 2), see `FittedModel.interval`."""
    jackknife = Jackknife(design, smoothing)
    spread = np.abs(jackknife.residuals())
    n = len(spread)
    rank = math.floor((1 - level) * (n + 1) + 1e-9)  # (1 - 0.9) * 10 is below 1
    lower, upper = np.empty((2, len(points), spread.shape[1]))
    first = 0
    for values in jackknife.predictions(points):
        some = slice(first, first := first + len(values))
        lower[some] = _smallest(_defined(values - spread), rank)
        upper[some] = -_smallest(_defined(-values - spread), rank)
    shape = len(points), *design.data.values.shape[1:]
    return Interval(lower.reshape(shape), upper.reshape(shape))


def _defined(bounds: Floats) -> Floats:
    return np.where(np.isnan(bounds), -np.inf, bounds)


def _smallest(bounds: Floats, rank: int) -> Floats:
    """Return the bound of a rank, counted from 1, along the second axis; minus infinity of rank 0."""
    if rank == 0:
        return np.full((len(bounds), *bounds.shape[2:]), -np.inf)
    return np.asarray(np.partition(bounds, rank - 1, axis=1)[:, rank - 1])


def _product(rows: Floats, columns: Floats) -> Floats:
    flat = rows.reshape(-1, rows.shape[-1])
    product = _core.product(flat, np.ascontiguousarray(columns), check.threads(None))
    return product.reshape(*rows.shape[:-1], -1)
