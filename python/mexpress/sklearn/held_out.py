"""Fits by a linear model with an intercept, weights and a ridge, and its predictions of held-out data without refits.

The intercept is a column of ones that the ridge does not penalise, so a constant may be taken off any column. It is the
value nearest to the column's mean: features far from zero keep their digits, and as the value occurs, a column that
is constant but for a few data is zero but for them, and stays so without them. Less its mean, it would there be
parallel to the ones, which a small ridge tells apart only by digits that are lost.

A ridge does not change under rotations: features that outnumber the data are replaced by their coordinates in the
space that the data span.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.caching import cached_property
from mexpress.leastsquares import CrossValidation, LeastSquares, RankLossWarning
from mexpress.leastsquares.penalty_path import PenaltyPath
from mexpress.schemes import Scheme
from mexpress.sklearn.least_norm import LinearFit, fits_without

_DRAWN = 1000
"""Data whose values are tried for one near the mean; all of them would take as long as half a fit."""

_UNEVEN = 1e10
"""Ratio of the sizes of features from which one decomposition for all ridges would lose digits."""


@dataclass(frozen=True, eq=False)
class LinearProblem:
    """A linear regression of r responses, (n, r), on p features, (n, p); data of weight 0 are not fitted.

    Examples
    --------
    >>> import mexpress as mx
    >>> line = LinearProblem(np.arange(4.0)[:, None], np.array([[0.0], [1.0], [2.0], [9.0]]), None, True)
    >>> line.ridge_regression(0.0).predict(mx.schemes.leave_one_out(4))[3].round(6)
    array([3.])
    >>> line.fit(0.0).coefficients.round(6)
    array([[2.8]])
    """

    X: Floats
    y: Floats
    weights: Floats | None
    fit_intercept: bool
    threads: int | None = None

    def __post_init__(self) -> None:
        check.flag(self.fit_intercept, "fit_intercept")

    @cached_property
    def present(self) -> Integers:
        """Data of positive weight."""
        return np.arange(len(self.X)) if self.weights is None else np.flatnonzero(self.weights)

    def ridge_regression(self, alpha: float) -> HeldOut:
        """Return the fit with a weight of the ridge."""
        some, design = self.present, self._design if alpha == 0 else self._ridge_design
        rows = np.sqrt(alpha) * self._ridge if alpha else None
        weights, responses = self._present_weights, self._shifted[1][some]
        model = LeastSquares(design[some], responses, 1, weights, rows, threads=self.threads)
        return HeldOut(self, alpha, design, model)

    def fit(self, alpha: float) -> LinearFit:
        """Return the fit with a weight of the ridge; of least norm where the data do not determine it."""
        model, ones = self.ridge_regression(alpha).model, int(self.fit_intercept)
        solution = model.coefficients
        if model.rank < len(solution):
            return next(self.refits(alpha, [np.zeros(0, dtype=np.int64)]))
        turned, coefficients = self._rotation if alpha > 0 else None, solution[ones:]
        if turned is not None:
            coefficients = turned @ coefficients
        return LinearFit(coefficients, solution[:ones].sum(axis=0), *self._shifts)

    def refits(self, alpha: float, held: Sequence[Integers]) -> Iterator[LinearFit]:
        """Yield the fits without sets of the data that are present, of least norm where these do not determine them."""
        X, y = (each[self.present] for each in self._shifted)
        found = fits_without(X, y, self._present_weights, alpha, self.fit_intercept, held)
        return (LinearFit(*each, *self._shifts) for each in found)

    def ridge_regressions(self, alphas: Iterable[float]) -> Iterator[HeldOut]:
        """Yield the fits with several weights of the ridge, from one decomposition; no datum is absent."""
        for alpha in alphas:
            if alpha == 0 or self._uneven:
                yield self.ridge_regression(alpha)
            else:
                yield HeldOut(self, alpha, self._ridge_design, self._path.fit(alpha, self.threads).model)

    @cached_property
    def _present_weights(self) -> Floats | None:
        return None if self.weights is None else self.weights[self.present]

    @cached_property
    def _shifts(self) -> tuple[Floats, Floats]:
        """What is taken off features, (p,), and responses, (r,)."""
        if not self.fit_intercept:
            return np.zeros(self.X.shape[1]), np.zeros(self.y.shape[1])
        some = slice(None) if self.weights is None else self.present  # a slice copies nothing
        return _central(self.X[some]), _central(self.y[some])

    @cached_property
    def _shifted(self) -> tuple[Floats, Floats]:
        """Features and responses less what is taken off."""
        X_shift, y_shift = self._shifts
        return self.X - X_shift, self.y - y_shift

    @cached_property
    def _design(self) -> Floats:
        return self._with_ones(self._shifted[0])

    @cached_property
    def _rotation(self) -> Floats | None:
        """Orthonormal rows, (p, n), that span the features if they outnumber the data."""
        features = self._shifted[0]
        n, p = features.shape
        return np.linalg.qr(features.T).Q if p > n else None

    @cached_property
    def _ridge_design(self) -> Floats:
        """A design of few more columns than data at most, with the same ridge regressions."""
        turned = self._rotation
        return self._design if turned is None else self._with_ones(self._shifted[0] @ turned)

    @cached_property
    def _uneven(self) -> bool:
        sizes = np.abs(self._shifted[0]).max(axis=0)
        return bool(sizes.max() > _UNEVEN * sizes[sizes > 0].min(initial=np.inf))

    def _with_ones(self, features: Floats) -> Floats:
        return np.hstack([np.ones((len(features), int(self.fit_intercept))), features])

    @cached_property
    def _ridge(self) -> Floats:
        """The penalty of weight one: a row for each column but the ones."""
        return np.eye(self._ridge_design.shape[1])[int(self.fit_intercept) :]

    @cached_property
    def _path(self) -> PenaltyPath:
        some, weights = self.present, self._present_weights
        design, responses = self._ridge_design[some], self._shifted[1][some]
        return PenaltyPath(design, responses, 1, self._ridge, weights, self.threads)


@dataclass(frozen=True, eq=False)
class HeldOut:
    """A fit, which predicts any held-out data.

    Parameters
    ----------
    problem : LinearProblem
        The data.
    alpha : float
        Weight of the ridge.
    design : (n, q) array
        Rows of all data over the unknowns of the fit.
    model : LeastSquares
        The fit of the data that are present.
    """

    problem: LinearProblem
    alpha: float
    design: Floats
    model: LeastSquares

    def predict(self, scheme: Scheme) -> Floats:
        """Predict the validated data of a scheme over all data, absent ones too, from those not held out: (t, r)."""
        problem, some = self.problem, self.problem.present
        responses, validated, n = problem._shifted[1], scheme.validated.indices, scheme.n_data
        values = np.empty((len(validated), responses.shape[1]))
        is_present = np.zeros(n, dtype=np.bool_)
        is_present[some] = True
        known = is_present[validated]
        found = self._cross_validated(scheme if len(some) == n else scheme.restricted(some))
        values[known] = responses[validated[known]] - found.residuals
        lost = found.undefined
        if not known.all():
            values[~known], others = self._absent(scheme, ~known)
            lost = np.union1d(lost, others)
        values += problem._shifts[1]
        self._refit(scheme, np.union1d(lost, self._parallel(scheme)), values)
        return values

    def _refit(self, scheme: Scheme, pairs: Integers, values: Floats) -> None:
        """Put the predictions of refits, for pairs whose training data lose rank, into those of a scheme."""
        validated, held, problem = scheme.validated, scheme.held_out, self.problem
        pairs = pairs[validated.sizes[pairs] > 0]
        if not len(pairs):
            return
        if len(problem.present) < scheme.n_data:
            held = held.restricted(problem.present, scheme.n_data)
        refits = problem.refits(self.alpha, [held[pair] for pair in pairs])
        for pair, refit in zip(pairs, refits, strict=True):
            of_pair = slice(validated.offsets[pair], validated.offsets[pair + 1])
            values[of_pair] = refit.predict(problem.X[validated[pair]])

    def _parallel(self, scheme: Scheme) -> Integers:
        """Pairs that leave fewer than half the data, in which a feature is a multiple of the ones.

        Only a ridge tells the two apart, by digits that the closed form has lost. Where more data are left, such a
        feature is zero in these: its value is that nearest to the mean.
        """
        problem = self.problem
        if self.alpha == 0 or not problem.fit_intercept or problem._rotation is not None:
            return np.zeros(0, dtype=np.int64)
        X, found = problem._shifted[0], []
        for pair in np.flatnonzero(2 * scheme.held_out.sizes > scheme.n_data):
            here = np.zeros(scheme.n_data, dtype=np.bool_)
            here[problem.present] = True
            here[scheme.held_out[pair]] = False
            train = np.flatnonzero(here)
            first = X[train[0]]
            alike = np.flatnonzero((first != 0) & (first == X[train[-1]]))
            if (X[train][:, alike] == first[alike]).all(axis=0).any():
                found.append(pair)
        return np.array(found, dtype=np.int64)

    def _cross_validated(self, scheme: Scheme) -> CrossValidation:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RankLossWarning)  # such pairs are told by the result
            return self.model.cross_validate(scheme, self.problem.threads)

    def _absent(self, scheme: Scheme, absent: NDArray[np.bool_]) -> tuple[Floats, Integers]:
        """Predictions of the validated data that are absent, (a, r), and the pairs that lose rank.

        Without K, the fit is that of all data with the responses of K replaced by their predictions: it changes by
        the held-out residuals e_(K).
        """
        problem, model = self.problem, self.model
        pairs = np.repeat(np.arange(len(scheme)), scheme.validated.sizes)[absent]
        rows = self.design[scheme.validated.indices[absent]]
        values = rows @ model.coefficients
        if model.rank < self.design.shape[1]:  # a row may be no combination of those that are present
            return values, np.unique(pairs)
        held = scheme.held_out.restricted(problem.present, scheme.n_data)
        found = self._cross_validated(Scheme(len(problem.present), held, held))
        over, basis, ends = model._over_basis(rows, problem.threads), model._weighted_basis, held.offsets
        for pair in np.unique(pairs):
            members, of_pair = slice(ends[pair], ends[pair + 1]), pairs == pair
            values[of_pair] -= over[of_pair] @ (basis[held.indices[members]].T @ found.residuals[members])
        return values, found.undefined


def _central(columns: Floats) -> Floats:
    """The value of each column that is nearest to its mean; of many data, among some drawn at random."""
    n = len(columns)
    drawn = columns if n <= _DRAWN else columns[np.random.default_rng(0).integers(n, size=_DRAWN)]
    nearest = np.abs(drawn - columns.mean(axis=0)).argmin(axis=0)
    return np.asarray(drawn[nearest, np.arange(columns.shape[1])])
