"""Linear least squares: one factorisation, then cross-validation in closed form."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _core
from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.caching import cached_property
from mexpress.index_sets import IndexSets, checked, compress, singletons
from mexpress.leastsquares.cross_validation import (
    CrossValidation,
    RankLossWarning,
    expect_scheme_of,
    warn_of_loss,
    warn_of_rank_loss,
)
from mexpress.leastsquares.problem import Problem
from mexpress.leastsquares.rows import read_only
from mexpress.leastsquares.tall import TallLeastSquares
from mexpress.schemes import Scheme, leave_one_out

if TYPE_CHECKING:
    from mexpress.leastsquares.nested import Nested


@dataclass(frozen=True, eq=False, repr=False, init=False)
class LeastSquares:
    """A linear least-squares fit: ``min sum_i w_i ||b_i - A_i x||^2 + ||Z x||^2``.

    The design is factorised once. Every prediction residual then has the closed form
    ``e_(K) = (I - H_KK)^-1 e_K`` (equation 6), without a refit.

    Parameters
    ----------
    A : (m, p) array
        Design matrix. The model keeps `A`, `b` and `penalty` without a copy if they are float64 arrays in C order: do
        not change them while the model is in use.
    b : (m,) or (m, r) array
        Responses; r responses share the design (equation 4).
    coupling : int or (m,) int array, default 1
        The number of consecutive rows per datum, or the datum of every row, labelled 0 to n - 1. The rows of a datum
        are held out together.
    weights : (n,) array, optional
        Positive weight of each datum, in the fit and in the scores. The largest is at most 1e12 times the smallest.
    penalty : (k, p) array, optional
        Z. Its rows are never held out; they count for the rank as the rows of `A` do.
    threads : int, optional
        Largest number of threads; MEXPRESS_NUM_THREADS or all cores by default.

    Attributes
    ----------
    coefficients : (p,) or (p, r) array
        x. Without full rank, the solution of least norm for columns scaled to unit length.
    residuals : (m,) or (m, r) array
        b - A x.
    leverage : (m,) array
        Diagonal of the hat matrix, from 0 to 1; its sum is the effective number of parameters.
    rank : int
        Rank of ``[A; Z]`` with columns scaled to unit length, by the rule of `numpy.linalg.matrix_rank`.
    n_data : int
        Number of data, n.

    Raises
    ------
    ValueError, TypeError
        If a shape does not fit, an entry is not a finite number, or an entry of `b` exceeds 1e303.

    Examples
    --------
    A straight line fitted to five points, of which the last is an outlier:

    >>> import mexpress as mx
    >>> import numpy as np
    >>> x, y = np.arange(5.0), np.array([0.0, 1.1, 1.9, 3.0, 8.0])
    >>> model = mx.LeastSquares(np.column_stack([np.ones(5), x]), y)
    >>> model
    LeastSquares(5 data, 5 rows, 2 columns, rank 2, fit_rms=1.147083)
    >>> float(model.held_out_residuals([4])[0].round(6))
    4.05
    """

    rank: int
    n_data: int
    _factor: _core.Factor = field(repr=False)
    _coupling: IndexSets = field(repr=False)
    _flat: bool = field(repr=False)

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
        self._keep(problem, _core.Factor(problem.arrays, check.threads(threads)))

    @classmethod
    def _of(cls, problem: Problem, factor: _core.Factor) -> LeastSquares:
        """The fit that the core has made of a problem."""
        model = object.__new__(cls)
        model._keep(problem, factor)
        return model

    @classmethod
    def orthonormal(
        cls,
        Q: Floats,
        b: Floats,
        coupling: int,
        penalty: Floats,
        threads: int | None = None,
        weights: Floats | None = None,
        source: tuple[Floats, Floats] | None = None,
    ) -> LeastSquares:
        """Do what `LeastSquares` does; deprecated."""
        warnings.warn(
            "LeastSquares.orthonormal does what LeastSquares does now.", DeprecationWarning, stacklevel=2
        )
        return cls(Q, b, coupling, weights, penalty, threads=threads)

    @staticmethod
    def from_blocks(
        blocks: Any, coupling: int = 1, *, directory: Any = None, threads: int | None = None
    ) -> TallLeastSquares:
        """Fit rows that need not fit in memory: of memory-mapped or dask arrays, or that come a block at a time.

        All rows are read once, and reduced to a triangle by reflections (TSQR). Cross-validation reads them twice more:
        see `TallLeastSquares`.

        Parameters
        ----------
        blocks : tuple of arrays, or iterable of such tuples
            ``(A, b)`` or ``(A, b, weights)``: (m, p), (m,) or (m, r), and one weight a datum, (n,). Arrays in
            memory-mapped files (`numpy.load` with ``mmap_mode="r"``) stay there. If A is a dask array (extra ``dask``),
            all work is done where its blocks are, by Dask's scheduler; b and the weights may be dask arrays or others.
            What an iterable yields is kept in a temporary file, as large as all its blocks.
        coupling : int, default 1
            The number of consecutive rows per datum.
        directory : str or Path, optional
            Where the temporary file is made.
        threads : int, optional
            Largest number of threads. With dask arrays, those of a task: one by default.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> x = np.linspace(0, 1, 10_000)
        >>> blocks = ((np.vander(part, 4), np.sin(6 * part)) for part in np.split(x, 10))
        >>> mx.LeastSquares.from_blocks(blocks)
        TallLeastSquares(10000 data, 10000 rows, 4 columns, rank 4, fit_rms=0.05899825)
        """
        return TallLeastSquares.of(blocks, coupling, directory, threads)

    def _keep(self, problem: Problem, factor: _core.Factor) -> None:
        vars(self).update(
            rank=factor.rank,
            n_data=len(problem.coupling),
            _factor=factor,
            _coupling=problem.coupling,
            _flat=problem.responses.ndim == 1,
        )

    @cached_property
    def coefficients(self) -> Floats:
        """The solution x, (p,) or (p, r)."""
        return self._kept(np.ascontiguousarray(self._factor.coefficients))

    @cached_property
    def residuals(self) -> Floats:
        """Return b - A x, (m,) or (m, r)."""
        return self._kept(self._factor.residuals)

    @cached_property
    def leverage(self) -> Floats:
        """The diagonal of the hat matrix, (m,)."""
        return read_only(self._factor.leverage)

    def _kept(self, columns: Floats) -> Floats:
        """One column for each response, or the only one, read-only."""
        return read_only(columns[:, 0] if self._flat else columns)

    def _over_basis(self, rows: Floats, threads: int | None = None) -> Floats:
        """Return rows (k, p) of numbers a . x over an orthonormal basis, (k, p): ``a R^-1``.

        A number grows with the response of a row of A by its product with that row of `_weighted_basis`. NaN if the
        rank of A and its penalty is lost.
        """
        return self._factor.over_basis(rows, check.threads(threads))

    @property
    def _weighted_basis(self) -> Floats:
        """The rows of the orthonormal basis times the roots of their weights, (m, rank)."""
        return self._factor.weighted_basis

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
        return self._factor.fit_rms(self._coupling.arrays)

    @property
    def press(self) -> float:
        """P, with every row held out on its own: ``P^2 = sum_j w_j (e_j / (1 - h_jj))^2 / sum_j w_j``, equation (3).

        w_j is the weight of the datum of row j. P is NaN, with a `RankLossWarning`, if the model is not determined
        without some row.

        Examples
        --------
        >>> import mexpress as mx
        >>> round(mx.LeastSquares([[1.0], [1.0], [1.0]], [1.0, 2.0, 6.0]).press, 6)
        3.24037
        """
        found = leave_row_out(self, None)
        warn_of_loss(found.undefined, len(found.rows), "rows", "the first is row")
        return found.score

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
        prediction = self._predict([Scheme(m, sets, sets)], singletons(m), None)[0]
        if len(prediction.undefined):
            warnings.warn(RankLossWarning("The other rows no longer determine the model."), stacklevel=2)
        return prediction.residuals[np.argsort(np.argsort(order))]

    def hat_blocks(self, sets: IndexSets | None = None, *, threads: int | None = None) -> list[Floats]:
        """Diagonal blocks ``H_KK`` of the hat matrix, computed without the whole matrix.

        Parameters
        ----------
        sets : IndexSets, optional
            Sets of rows; the rows of each datum by default.
        threads : int, optional
            Largest number of threads.

        Returns
        -------
        list of (q, q) arrays
            One per set, of the weighted design if there are weights.

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
        """Covariance of the prediction residuals of every pair under noise of variance one: ``((I - H_KK)^-1)_TT``.

        The noise is independent, with the same variance in all rows, and every response has the same covariance. With
        weights, the residuals are multiplied by the roots of their weights, and the unit is the variance of a row of
        weight one. With a penalty, the matrix exceeds the covariance, which
        does not include the error of the model.

        Parameters
        ----------
        scheme : Scheme
            A scheme over this model's data, see `mexpress.schemes`.
        threads : int, optional
            Largest number of threads. The result does not depend on it.

        Returns
        -------
        list of (t, t) arrays
            One per pair, for its validated rows in the order of `cross_validate`; NaN if the training rows lose rank.

        Examples
        --------
        >>> import mexpress as mx
        >>> model = mx.LeastSquares([[1.0], [1.0], [1.0]], [1.0, 2.0, 6.0])
        >>> [float(c[0, 0].round(6)) for c in model.prediction_spread(mx.schemes.leave_one_out(3))]
        [1.5, 1.5, 1.5]
        """
        expect_scheme_of(self.n_data, scheme)
        validated, rows = scheme.validated, self._coupling
        workers = check.threads(threads)
        flat = self._factor.spread((scheme.sets, None), rows.arrays, workers)
        ends = np.concatenate([[0], np.cumsum(rows.sizes[validated.indices])])[validated.offsets]
        return _square_blocks(flat, np.diff(ends))

    def cross_validate(self, scheme: Scheme, threads: int | None = None) -> CrossValidation:
        """Predict the validated data of every pair of a scheme from the data that the pair does not hold out.

        Parameters
        ----------
        scheme : Scheme
            A scheme over this model's data, see `mexpress.schemes`.
        threads : int, optional
            Largest number of threads. The result does not depend on it.

        Returns
        -------
        CrossValidation
            The score is NaN, with a `RankLossWarning`, if the training rows of a pair lose rank.

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
        expect_scheme_of(self.n_data, scheme)
        result = self._predict([scheme], self._coupling, threads)[0]
        warn_of_rank_loss(result, len(scheme))
        return result

    def _predict(
        self, schemes: Iterable[Scheme], coupling: IndexSets, threads: int | None
    ) -> list[CrossValidation]:
        """Cross-validate by schemes over data that have these rows, in one call, so that the core shares work."""
        given, workers = [scheme.arguments for scheme in schemes], check.threads(threads)
        try:
            found = self._factor.predict(given, coupling.arrays, workers)
        except RuntimeError as error:
            check.refuse("A", "It must not change while the model is in use.", str(error))
        return [
            CrossValidation(score, residuals[:, 0] if self._flat else residuals, *places)
            for score, residuals, *places in found
        ]


def datum_of_row(model: LeastSquares | Nested) -> Integers:
    """The datum of each row of the design, (m,)."""
    rows = model._coupling
    data = np.empty(len(rows.indices), dtype=np.int64)
    data[rows.indices] = np.repeat(np.arange(model.n_data), rows.sizes)
    return data


def leave_row_out(model: LeastSquares, threads: int | None) -> CrossValidation:
    """Hold out every row on its own: the score is PRESS."""
    alone = leave_one_out(len(model._coupling.indices))
    return model._predict([alone], alone.held_out, threads)[0]


def cross_validate_all(
    model: LeastSquares, schemes: Mapping[str, Scheme], threads: int | None
) -> dict[str, CrossValidation]:
    """Cross-validate all schemes in one call, so that the core shares work between them."""
    for scheme in schemes.values():
        expect_scheme_of(model.n_data, scheme)
    found = model._predict(schemes.values(), model._coupling, threads)
    return dict(zip(schemes, found, strict=True))


def _square_blocks(flat: Floats, sizes: Integers) -> list[Floats]:
    """Split a flat array into square matrices."""
    parts = np.split(flat, np.cumsum(sizes**2)[:-1]) if len(sizes) else []
    return [part.reshape(size, size) for part, size in zip(parts, sizes, strict=True)]
