"""Linear least squares, factorised once and cross-validated in closed form.

Examples
--------
>>> import mexpress as mx
>>> mx.LeastSquares([[1.0], [1.0], [1.0]], [1.0, 2.0, 6.0])
LeastSquares(3 data, 3 rows, 1 columns, rank 1, fit_rms=2.160247)
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _core
from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.index_sets import IndexSets, checked, compress, concatenate, singletons
from mexpress.leastsquares.problem import Problem
from mexpress.schemes import Scheme


class RankLossWarning(UserWarning):
    """Some held-out sets leave training rows that no longer determine the model.

    What they would predict is NaN, and so is the score.

    Examples
    --------
    The third row alone sees the second column:

    >>> import warnings
    >>> import mexpress as mx
    >>> model = mx.LeastSquares([[1.0, 0.0], [1.0, 0.0], [1.0, 1.0]], [1.0, 2.0, 6.0])
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     model.held_out_residuals([2])
    array([nan])
    >>> caught[0].message
    RankLossWarning('The other rows no longer determine the model.')
    """


@dataclass(frozen=True, eq=False, repr=False)
class CrossValidation:
    """Prediction residuals of a scheme, and their score.

    Parameters
    ----------
    score : float
        P, in the responses' unit: ``P^2 = sum w ||e||^2 / sum w`` over the validated data; NaN if a pair is undefined.
    residuals : (k,) or (k, r) array
        Prediction residuals of the validated rows, pair after pair, in the responses' unit; NaN where undefined.
    rows : (k,) int64 array
        The rows of the design that the residuals belong to.
    pairs : (k,) int64 array
        The pairs of the scheme that they belong to.
    undefined : int64 array
        The pairs whose training rows lost rank; empty as a rule.

    Examples
    --------
    >>> import mexpress as mx
    >>> model = mx.LeastSquares([[1.0], [1.0], [1.0]], [1.0, 2.0, 6.0])
    >>> model.cross_validate(mx.schemes.leave_one_out(3))
    CrossValidation(score=3.24037, 3 residuals, 0 undefined pairs)
    """

    score: float
    residuals: Floats
    rows: Integers
    pairs: Integers
    undefined: Integers

    def __repr__(self) -> str:
        counts = f"{len(self.rows)} residuals, {len(self.undefined)} undefined pairs"
        return f"CrossValidation(score={self.score:.7g}, {counts})"


@dataclass(frozen=True, eq=False, repr=False, init=False)
class LeastSquares:
    """A linear least-squares fit: ``min sum_i w_i ||b_i - A_i x||^2 + ||Z x||^2``.

    The design is factorised once; every prediction residual then follows in closed form,
    ``e_(K) = (I - H_KK)^-1 e_K`` (equation 6), without refitting.

    Parameters
    ----------
    A : (m, p) array
        Design matrix. The model keeps it, not a copy, if it is a float64 array in C order, and `b` likewise: do
        not change them while the model is in use.
    b : (m,) or (m, r) array
        Responses; r of them share the design (equation 4).
    coupling : int or (m,) int array, default 1
        How rows make up data: the number of consecutive rows of each datum, or the datum of every row,
        labelled 0 to n - 1. Rows of a datum are held out together.
    weights : (n,) array, optional
        Positive weight of each datum, in the fit and in the scores; within a factor of 1e12.
    penalty : (k, p) array, optional
        Z: rows that are never held out, to be made small (`A` and `Z` both count for the rank).
    threads : int, optional
        At most so many threads; MEXPRESS_NUM_THREADS or all cores if not given.

    Attributes
    ----------
    coefficients : (p,) or (p, r) array
        x. If rank is lost, the solution of least norm when columns have unit length.
    residuals : (m,) or (m, r) array
        b - A x.
    leverage : (m,) array
        Diagonal of the hat matrix, from 0 to 1; its sum is the effective number of parameters.
    rank : int
        Rank of ``[A; Z]``, columns at unit length, by the rule of `numpy.linalg.matrix_rank`.
    n_data : int
        Number of data, n.

    Raises
    ------
    ValueError, TypeError
        If a shape does not fit, an entry is not a finite number, or one of `b` exceeds 1e303.

    Examples
    --------
    A straight line through five points, the last of them off:

    >>> import mexpress as mx
    >>> import numpy as np
    >>> x, y = np.arange(5.0), np.array([0.0, 1.1, 1.9, 3.0, 8.0])
    >>> model = mx.LeastSquares(np.column_stack([np.ones(5), x]), y)
    >>> model
    LeastSquares(5 data, 5 rows, 2 columns, rank 2, fit_rms=1.147083)
    >>> float(model.held_out_residuals([4])[0].round(6))
    4.05
    """

    coefficients: Floats
    residuals: Floats
    leverage: Floats
    rank: int
    n_data: int
    _factor: _core.Factor = field(repr=False)
    _coupling: IndexSets = field(repr=False)
    _row_weights: Floats | None = field(repr=False)

    def __init__(
        self,
        A: ArrayLike,
        b: ArrayLike,
        coupling: int | ArrayLike = 1,
        weights: ArrayLike | None = None,
        penalty: ArrayLike | None = None,
        *,
        threads: int | None = None,
    ) -> None:
        problem = Problem.of(A, b, coupling, weights, penalty)
        self._keep(problem, _core.Factor(*problem.arrays, check.threads(threads)))

    @classmethod
    def _from_orthonormal(
        cls, Q: Floats, b: Floats, coupling: int, penalty: Floats, threads: int | None = None
    ) -> LeastSquares:
        """Fit a design whose columns, stacked on the penalty rows, are orthonormal: this skips the factorisation."""
        model = object.__new__(cls)
        problem = Problem.of(Q, b, coupling, None, penalty)
        design, responses, _, rows = problem.arrays
        model._keep(problem, _core.Factor.orthonormal(design, responses, rows, check.threads(threads)))
        return model

    def _keep(self, problem: Problem, factor: _core.Factor) -> None:
        flat = problem.responses.ndim == 1
        residuals, coefficients = factor.residuals, np.ascontiguousarray(factor.coefficients)
        self._set(
            coefficients=coefficients[:, 0] if flat else coefficients,
            residuals=residuals[:, 0] if flat else residuals,
            leverage=factor.leverage,
            rank=factor.rank,
            n_data=len(problem.coupling),
            _factor=factor,
            _coupling=problem.coupling,
            _row_weights=problem.row_weights,
        )

    def _set(self, **fields: Any) -> None:
        for name, value in fields.items():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        m, p = len(self.residuals), len(self.coefficients)
        size = f"{self.n_data} data, {m} rows, {p} columns, rank {self.rank}"
        return f"LeastSquares({size}, fit_rms={self.fit_rms:.7g})"

    def __reduce__(self) -> NoReturn:
        rule = "It cannot be pickled or copied: build it again from A and b."
        check.refuse("model", rule, repr(self), TypeError)

    @property
    def fit_rms(self) -> float:
        """E, the root mean square residual over the data: ``E^2 = sum w ||e||^2 / sum w``, equation (11).

        Examples
        --------
        >>> import mexpress as mx
        >>> round(mx.LeastSquares([[1.0], [1.0], [1.0]], [1.0, 2.0, 6.0]).fit_rms, 6)
        2.160247
        """
        return _root_mean(self.residuals, self._row_weights, float(self._share_of_row(slice(None)).sum()))

    @property
    def press(self) -> float:
        """P, every row held out on its own: ``P^2 = sum_j w_j (e_j / (1 - h_jj))^2 / sum_j w_j``, equation (3).

        The sums are over rows, and w_j is the weight of the row's datum; without weights this is the mean over
        rows. NaN, with a `RankLossWarning`, if a row alone determines some part of the model.

        Examples
        --------
        >>> import mexpress as mx
        >>> round(mx.LeastSquares([[1.0], [1.0], [1.0]], [1.0, 2.0, 6.0]).press, 6)
        3.24037
        """
        value, lost = leave_row_out(self, None)
        _warn(lost, len(self.leverage), "rows", "the first is row")
        return value

    def held_out_residuals(self, rows: ArrayLike) -> Floats:
        """Residuals of rows predicted from all other rows: ``e_(K) = (I - H_KK)^-1 e_K``, equation (6).

        Parameters
        ----------
        rows : (k,) int array
            Distinct rows of the design.

        Returns
        -------
        (k,) or (k, r) array
            In the order of `rows`. NaN, with a `RankLossWarning`, if the other rows no longer determine the model.

        Examples
        --------
        >>> import mexpress as mx
        >>> mx.LeastSquares([[1.0], [1.0], [1.0]], [1.0, 2.0, 6.0]).held_out_residuals([2, 1])
        array([5., 1.])
        """
        m = len(self.leverage)
        order = check.indices(rows, "rows", m)
        sets = compress([order])
        prediction = self._predict(sets, sets, singletons(m), None)
        if len(prediction.undefined):
            warnings.warn(RankLossWarning("The other rows no longer determine the model."), stacklevel=2)
        return prediction.residuals[np.argsort(np.argsort(order))]

    def hat_blocks(self, sets: IndexSets | None = None, *, threads: int | None = None) -> list[Floats]:
        """Diagonal blocks ``H_KK`` of the hat matrix, without the matrix.

        Parameters
        ----------
        sets : IndexSets, optional
            Sets of rows; the rows of each datum if not given.
        threads : int, optional
            At most so many threads.

        Returns
        -------
        list of (q, q) arrays
            One a set, of the weighted design if there are weights.

        Examples
        --------
        >>> import mexpress as mx
        >>> model = mx.LeastSquares([[1.0], [1.0], [1.0], [1.0]], [1.0, 2.0, 6.0, 0.0], coupling=2)
        >>> model.hat_blocks()[0]
        array([[0.25, 0.25],
               [0.25, 0.25]])
        """
        blocks = self._coupling if sets is None else checked(sets, "sets", len(self.leverage))
        flat = self._factor.hat_blocks(blocks.arrays, check.threads(threads))
        return _square_blocks(flat, blocks.sizes)

    def prediction_spread(self, scheme: Scheme, threads: int | None = None) -> list[Floats]:
        """How far noise alone drives the prediction residuals of every pair: ``((I - H_KK)^-1)_TT``.

        That is their covariance, in units of the variance of noise that is independent and the same in all rows; each
        response has the same. With weights it is that of residuals times the root of the weight, and in units
        of the variance of a row of weight one. With a penalty it is larger than the covariance, which leaves out
        the model's own error.

        Parameters
        ----------
        scheme : Scheme
            From `mexpress.schemes`; over this model's data.
        threads : int, optional
            At most so many threads. The result does not depend on it.

        Returns
        -------
        list of (t, t) arrays
            One a pair, for the rows of the validated data in the order of `cross_validate`; NaN if the pair's training
            rows lose rank.

        Examples
        --------
        >>> import mexpress as mx
        >>> model = mx.LeastSquares([[1.0], [1.0], [1.0]], [1.0, 2.0, 6.0])
        >>> [float(c[0, 0].round(6)) for c in model.prediction_spread(mx.schemes.leave_one_out(3))]
        [1.5, 1.5, 1.5]
        """
        _expect_scheme(self, scheme)
        validated, rows = scheme.validated, self._coupling
        workers = check.threads(threads)
        flat = self._factor.spread(scheme.held_out.arrays, validated.arrays, rows.arrays, workers)
        ends = np.concatenate([[0], np.cumsum(rows.sizes[validated.indices])])[validated.offsets]
        return _square_blocks(flat, np.diff(ends))

    def cross_validate(self, scheme: Scheme, threads: int | None = None) -> CrossValidation:
        """Predict the validated data of every pair of a scheme, its held-out data left out of the fit.

        Parameters
        ----------
        scheme : Scheme
            From `mexpress.schemes`; over this model's data.
        threads : int, optional
            At most so many threads. The result does not depend on it.

        Returns
        -------
        CrossValidation
            With NaN for a score, and a `RankLossWarning`, if a pair's training rows lose rank.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> x = np.linspace(0, 1, 50)
        >>> model = mx.LeastSquares(np.vander(x, 4), np.sin(6 * x))
        >>> near = mx.schemes.exclusion_radius(x[:, None], 0.1)
        >>> model.cross_validate(near).score > model.fit_rms
        True
        """
        _expect_scheme(self, scheme)
        result = cross_validate_all(self, {"": scheme}, threads)[""]
        where = "the attribute 'undefined' of the result lists them, the first is"
        _warn(result.undefined, len(scheme), "pairs", where)
        return result

    def _part(self, whole: CrossValidation, first: int, last: int) -> CrossValidation:
        """The pairs first..last - 1 alone, scored."""
        a, b = np.searchsorted(whole.pairs, [first, last])
        lost = whole.undefined[(whole.undefined >= first) & (whole.undefined < last)] - first
        residuals, rows = whole.residuals[a:b], whole.rows[a:b]
        weights = None if self._row_weights is None else self._row_weights[rows]
        score = np.nan if len(lost) else _root_mean(residuals, weights, float(self._share_of_row(rows).sum()))
        return CrossValidation(score, residuals, rows, whole.pairs[a:b] - first, lost)

    def _predict(
        self,
        held: IndexSets,
        validated: IndexSets,
        coupling: IndexSets,
        threads: int | None,
        order: Integers | None = None,
    ) -> CrossValidation:
        """Residuals of all pairs, not yet scored; an order of the data that keeps neighbours together saves time."""
        workers = check.threads(threads)
        try:
            residuals, rows, offsets, lost = self._factor.predict(
                held.arrays,
                validated.arrays,
                coupling.arrays,
                np.zeros(0, dtype=np.int64) if order is None else order,
                workers,
            )
        except RuntimeError as error:
            check.refuse("A", "It must not change while the model is in use.", str(error))
        pairs = np.repeat(np.arange(len(held)), np.diff(offsets))
        flat = residuals[:, 0] if self.residuals.ndim == 1 else residuals
        return CrossValidation(np.nan, flat, rows, pairs, lost)

    def _share_of_row(self, rows: Integers | slice) -> Floats:
        """Weights of rows, each a part of its datum's: a datum's weight counts once, however many rows it has."""
        parts = np.reciprocal(self._coupling.sizes[datum_of_row(self)[rows]], dtype=np.float64)
        return parts if self._row_weights is None else parts * self._row_weights[rows]


def datum_of_row(model: LeastSquares) -> Integers:
    """The datum that each row of the design belongs to, (m,)."""
    data = np.empty(len(model.leverage), dtype=np.int64)
    data[model._coupling.indices] = np.repeat(np.arange(model.n_data), model._coupling.sizes)
    return data


def leave_row_out(model: LeastSquares, threads: int | None) -> tuple[float, Integers]:
    """PRESS, and the rows that alone determine some part of the model."""
    m, weights = len(model.leverage), model._row_weights
    alone = singletons(m)
    prediction = model._predict(alone, alone, alone, threads)
    total = float(m) if weights is None else float(weights.sum())
    return _root_mean(prediction.residuals, weights, total), prediction.undefined


def cross_validate_all(
    model: LeastSquares, schemes: Mapping[str, Scheme], threads: int | None
) -> dict[str, CrossValidation]:
    """Every scheme in one call, so that the core sees all the work and shares what it can."""
    if not schemes:
        return {}
    for scheme in schemes.values():
        _expect_scheme(model, scheme)
    held = concatenate(scheme.held_out for scheme in schemes.values())
    validated = concatenate(scheme.validated for scheme in schemes.values())
    along = next((scheme for scheme in schemes.values() if scheme.order is not None), None)
    order = None if along is None else _first_validated(along)
    together = model._predict(held, validated, model._coupling, threads, order)
    ends = np.cumsum([len(scheme) for scheme in schemes.values()])
    starts = ends - [len(scheme) for scheme in schemes.values()]
    return {
        name: model._part(together, first, last)
        for name, first, last in zip(schemes, starts, ends, strict=True)
    }


def _expect_scheme(model: LeastSquares, scheme: Any) -> None:
    """A scheme is over the model's data."""
    if not isinstance(scheme, Scheme):
        rule = "It must come from mexpress.schemes."
        check.refuse("scheme", rule, check.describe(scheme), TypeError)
    if scheme.n_data != model.n_data:
        rule = f"It must be over the model's {model.n_data} data."
        check.refuse("scheme", rule, f"a scheme over {scheme.n_data} data")


def _square_blocks(flat: Floats, sizes: Integers) -> list[Floats]:
    """Square matrices that stand one after another."""
    parts = np.split(flat, np.cumsum(sizes**2)[:-1]) if len(sizes) else []
    return [part.reshape(size, size) for part, size in zip(parts, sizes, strict=True)]


def _first_validated(scheme: Scheme) -> Integers:
    """A datum of each pair that validates any, in the order of the visits."""
    pairs = scheme.visiting_order[scheme.validated.sizes[scheme.visiting_order] > 0]
    return scheme.validated.indices[scheme.validated.offsets[pairs]]


def _root_mean(residuals: Floats, weights: Floats | None, total: float) -> float:
    """sqrt(sum w ||e||^2 / total), free of overflow."""
    if residuals.size == 0:
        return float("nan")
    errors = residuals.reshape(len(residuals), -1)
    if weights is not None:
        errors = np.sqrt(weights)[:, None] * errors
    largest = float(np.abs(errors).max())
    if largest == 0.0 or not np.isfinite(largest):
        return largest
    return largest * float(np.sqrt(((errors / largest) ** 2).sum() / total))


def _warn(lost: Integers, total: int, what: str, where: str) -> None:
    if len(lost):
        text = (
            f"{len(lost)} of {total} {what} lose rank when held out, so there is no score: {where} {lost[0]}."
        )
        warnings.warn(RankLossWarning(text), stacklevel=3)
