"""A least-squares problem as the core takes it, checked once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.index_sets import IndexSets, singletons

# If the weights span d digits, residuals of the smallest weight lose d / 2 digits.
WEIGHT_RATIO = 1e12


@dataclass(frozen=True, eq=False, repr=False)
class Problem:
    """A least-squares problem as the core takes it, checked."""

    design: Floats
    responses: Floats
    coupling: IndexSets
    row_weights: Floats | None
    penalty: Floats

    @classmethod
    def of(
        cls,
        A: ArrayLike,
        b: ArrayLike,
        coupling: int | ArrayLike = 1,
        weights: ArrayLike | None = None,
        penalty: ArrayLike | None = None,
    ) -> Problem:
        """Check the arguments of `LeastSquares`."""
        design = check.matrix(A, "A")
        m, p = design.shape
        responses = check.columns(b, "b", m)
        rows = couple(coupling, m)
        row_weights, exponent = _weigh(weights, rows)
        extra = np.zeros((0, p)) if penalty is None else _penalise(penalty, p, exponent)
        return cls(design, responses, rows, row_weights, extra)

    def __repr__(self) -> str:
        m, p = self.design.shape
        return f"Problem({len(self.coupling)} data, {m} rows, {p} columns)"

    @property
    def arrays(self) -> tuple[Floats, Floats, Floats | None, Floats]:
        """Design, responses (m, r), roots of the row weights, and penalty rows."""
        roots = None if self.row_weights is None else np.sqrt(self.row_weights)
        return self.design, self.responses.reshape(len(self.design), -1), roots, self.penalty


def couple(coupling: Any, m: int) -> IndexSets:
    """Check a coupling, and return the rows of every datum."""
    rule = f"It must be a number of rows, or the datum (0 to n - 1) of each of the {m} rows."
    if isinstance(coupling, int) or check.array(coupling, "coupling", rule).ndim == 0:
        g = check.count(coupling, "coupling", 1)
        if m % g:
            check.refuse("coupling", f"It must divide the {m} rows of A.", str(g))
        return singletons(m) if g == 1 else IndexSets(np.arange(0, m + 1, g), np.arange(m))
    labels = check.integers(coupling, "coupling", rule)
    if labels.shape != (m,) or labels.min() < 0 or labels.max() >= m:
        check.refuse("coupling", rule, check.describe(coupling))
    sizes = np.bincount(labels)
    if (sizes == 0).any():
        check.refuse("coupling", "Every datum must have a row.", f"none for datum {np.argmin(sizes)}")
    order = np.argsort(labels, kind="stable").astype(np.int64)
    return IndexSets(np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64), order)


def _weigh(weights: ArrayLike | None, rows: IndexSets) -> tuple[Floats | None, int]:
    """Check weights of the data; the weight of every row over a power of four, and its exponent.

    Fits and scores depend on ratios of weights alone, and roots of these weights times responses do not overflow.
    """
    if weights is None:
        return None, 0
    row_weights, exponent = scaled_weights(expect_weights(weights, len(rows)), rows)
    return row_weights, int(exponent)


def expect_weights(weights: ArrayLike, n: int) -> Floats:
    """Check weights of n data: positive, and not too far apart."""
    data_weights = check.real(weights, "weights")
    rule = f"It must be {n} positive numbers, one for each datum."
    if data_weights.shape != (n,):
        check.refuse("weights", rule, f"shape {data_weights.shape}")
    if check.finite(data_weights, "weights").min() <= 0:
        rule += " Leave out data that shall not count."
        check.refuse("weights", rule, f"{data_weights.min()} for datum {int(data_weights.argmin())}")
    if data_weights.min() < data_weights.max() / WEIGHT_RATIO:
        rule = f"The largest must not exceed {WEIGHT_RATIO:g} times the smallest."
        check.refuse("weights", rule, f"{data_weights.max():g} and {data_weights.min():g}")
    return data_weights


def weight_exponents(weights: Floats) -> NDArray[np.intc]:
    """Exponents of the powers of four that are near the largest weights, (...), of weights (..., n)."""
    return np.asarray(np.frexp(weights.max(axis=-1))[1] // 2)


def scaled_weights(weights: Floats, rows: IndexSets) -> tuple[Floats, NDArray[np.intc]]:
    """Weights of the rows over the power of four that brings the largest near one, (..., m), and its exponents, (...).

    Of the weights of data, (..., n), of one problem or of several.
    """
    exponents = weight_exponents(weights)
    row_weights = np.empty((*weights.shape[:-1], len(rows.indices)))
    scaled = np.ldexp(weights, -2 * exponents[..., None])
    row_weights[..., rows.indices] = np.repeat(scaled, rows.sizes, axis=-1)
    return row_weights, exponents


def penalty_rows(penalty: ArrayLike, p: int) -> Floats:
    """Check penalty rows: p columns, finite."""
    rows = check.real(penalty, "penalty")
    if rows.ndim != 2 or rows.shape[1] != p:
        ridge = f": sqrt(w) * np.eye({p}) is ridge regression of weight w" if rows.ndim == 0 else ""
        rule = f"It must have shape (k, {p}), as A has {p} columns{ridge}."
        check.refuse("penalty", rule, f"shape {rows.shape}" if rows.ndim else check.describe(penalty))
    return check.finite(rows, "penalty")


def _penalise(penalty: ArrayLike, p: int, exponent: int) -> Floats:
    """Penalty rows, scaled to match weights that are divided by a power of four."""
    rows = penalty_rows(penalty, p)
    if exponent == 0:  # a copy of millions of rows takes long
        return rows
    with np.errstate(over="ignore"):
        scaled = np.ldexp(rows, -exponent)
    if not np.isfinite(scaled).all():
        rule = "It must not exceed 1e308 times the root of the largest weight."
        check.refuse("penalty", rule, f"{np.abs(rows).max():g}")
    return scaled
