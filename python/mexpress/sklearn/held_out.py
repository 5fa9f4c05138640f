"""Predictions of held-out data by a linear model with an intercept, weights and a ridge, without refits.

The intercept is a column of ones that the ridge does not penalise. Columns are centred first, which does not change
the model but saves digits. A ridge does not change under rotations: features that outnumber the data are replaced by
their coordinates in the space that the data span.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mexpress._validation import Floats, Integers
from mexpress.caching import cached_property
from mexpress.leastsquares import CrossValidation, LeastSquares, RankLossWarning
from mexpress.leastsquares.penalty_path import PenaltyPath
from mexpress.schemes import Scheme


@dataclass(frozen=True, eq=False)
class LinearProblem:
    """A linear regression of r responses, (n, r), on p features, (n, p); data of weight 0 are not fitted.

    Examples
    --------
    >>> import mexpress as mx
    >>> line = LinearProblem(np.arange(4.0)[:, None], np.array([[0.0], [1.0], [2.0], [9.0]]), None, True)
    >>> line.ridge_regression(0.0).predict(mx.schemes.leave_one_out(4)).predictions[3].round(6)
    array([3.])
    """

    X: Floats
    y: Floats
    weights: Floats | None
    fit_intercept: bool
    threads: int | None = None

    @cached_property
    def present(self) -> Integers:
        """Data of positive weight."""
        return np.arange(len(self.X)) if self.weights is None else np.flatnonzero(self.weights)

    def ridge_regression(self, alpha: float) -> HeldOut:
        """Return the fit with a weight of the ridge."""
        some, design = self.present, self._design if alpha == 0 else self._ridge_design
        rows = np.sqrt(alpha) * self._ridge if alpha else None
        weights, responses = self._present_weights, self._centred[1][some]
        return HeldOut(
            self, design, LeastSquares(design[some], responses, 1, weights, rows, threads=self.threads)
        )

    def ridge_regressions(self, alphas: Iterable[float]) -> Iterator[HeldOut]:
        """Yield the fits with several weights of the ridge, from one decomposition; no datum is absent."""
        for alpha in alphas:
            if alpha == 0:
                yield self.ridge_regression(alpha)
            else:
                yield HeldOut(self, self._ridge_design, self._path.fit(alpha, self.threads).model)

    @cached_property
    def _present_weights(self) -> Floats | None:
        return None if self.weights is None else self.weights[self.present]

    @cached_property
    def _centred(self) -> tuple[Floats, Floats, Floats]:
        """Features and responses less their means, and the means of the responses."""
        if not self.fit_intercept:
            return self.X, self.y, np.zeros(self.y.shape[1])
        some, weights = self.present, self._present_weights
        X_mean, y_mean = (np.average(each[some], axis=0, weights=weights) for each in (self.X, self.y))
        return self.X - X_mean, self.y - y_mean, y_mean

    @cached_property
    def _design(self) -> Floats:
        return self._with_ones(self._centred[0])

    @cached_property
    def _ridge_design(self) -> Floats:
        """A design of few more columns than data at most, with the same ridge regressions."""
        features = self._centred[0]
        n, p = features.shape
        return self._design if p <= n else self._with_ones(np.transpose(np.linalg.qr(features.T).R))

    def _with_ones(self, features: Floats) -> Floats:
        return np.hstack([np.ones((len(features), int(self.fit_intercept))), features])

    @cached_property
    def _ridge(self) -> Floats:
        """The penalty of weight one: a row for each column but the ones."""
        return np.eye(self._ridge_design.shape[1])[int(self.fit_intercept) :]

    @cached_property
    def _path(self) -> PenaltyPath:
        some, weights = self.present, self._present_weights
        design, responses = self._ridge_design[some], self._centred[1][some]
        return PenaltyPath(design, responses, 1, self._ridge, weights, self.threads)


@dataclass(frozen=True, eq=False)
class Predictions:
    """What a scheme's validated data are predicted to be, pair after pair, (t, r); NaN in the pairs that lose rank."""

    predictions: Floats
    undefined: Integers


@dataclass(frozen=True, eq=False)
class HeldOut:
    """A fit, which predicts any held-out data.

    Parameters
    ----------
    problem : LinearProblem
        The data.
    design : (n, q) array
        Rows of all data over the unknowns of the fit.
    model : LeastSquares
        The fit of the data that are present.
    """

    problem: LinearProblem
    design: Floats
    model: LeastSquares

    def predict(self, scheme: Scheme) -> Predictions:
        """Predict the validated data of a scheme over all data, absent ones too, from those not held out."""
        problem, some = self.problem, self.problem.present
        _, responses, means = problem._centred
        validated, n = scheme.validated.indices, scheme.n_data
        values = np.empty((len(validated), responses.shape[1]))
        is_present = np.zeros(n, dtype=np.bool_)
        is_present[some] = True
        known = is_present[validated]
        found = self._cross_validated(scheme if len(some) == n else scheme.restricted(some))
        values[known] = responses[validated[known]] - found.residuals
        undefined = found.undefined
        if not known.all():
            values[~known], lost = self._absent(scheme, ~known)
            undefined = np.union1d(undefined, lost)
        return Predictions(values + means, undefined)

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
