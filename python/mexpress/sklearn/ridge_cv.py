"""Ridge regression whose weight is selected by predictions of held-out data, for any hold-out."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils.validation import validate_data

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.schemes import leave_one_out
from mexpress.sklearn.linear import LinearModel
from mexpress.sklearn.regression import Regression
from mexpress.sklearn.scores import fold_scores, scorer_of, takes_weights

_ALPHAS = "They must be numbers of at least 0, one or more."


class RidgeCV(LinearModel):
    """Ridge regression with the weight that predicts held-out data best.

    One decomposition serves all weights and all pairs of a splitter; scikit-learn's own closed form is leave-one-out
    only, and any other splitter is a search over refits. Features whose sizes differ by more than a factor of 1e10 are
    decomposed for every weight, as one decomposition would lose digits of the small ones.

    Parameters
    ----------
    alphas : array of float, default (0.1, 1.0, 10.0)
        Weights of the sum of squared coefficients that compete.
    fit_intercept : bool, default True
        Whether the model has a constant, which is not penalised.
    scoring : str or callable, optional
        As for `Ridge.cross_val_score`. By default R^2, the mean over the pairs; for leave-one-out, and where a pair
        validates a single datum, whose R^2 is not defined, the negated mean of weight times squared error. A callable
        is given the weights of the data if it takes `sample_weight`; if not, a warning says so.
    cv : int, splitter, Scheme or iterable of (train, test), optional
        What is held out, see `mexpress.schemes`; leave-one-out by default.
    alpha_per_target : bool, default False
        Whether every response has a weight of its own.
    threads : int, optional
        Largest number of threads; MEXPRESS_NUM_THREADS or all cores by default.

    Attributes
    ----------
    alpha_ : float or (r,) array
        The selected weight.
    best_score_ : float or (r,) array
        Its score.
    cv_scores_ : (k,) or (k, r) array
        The score of every weight.
    coef_ : (p,) or (r, p) array
        Coefficients.
    intercept_ : float or (r,) array
        Constants.

    Examples
    --------
    >>> import numpy as np
    >>> import mexpress as mx
    >>> from mexpress.sklearn import RidgeCV
    >>> rng = np.random.default_rng(0)
    >>> place = rng.uniform(0, 10, (300, 2))
    >>> X = np.cos(place @ rng.normal(size=(2, 40)))
    >>> y = np.sin(place[:, 0]) + 0.3 * rng.normal(size=300)
    >>> RidgeCV(np.logspace(-3, 3, 25), cv=mx.schemes.exclusion_radius(place, 1.0)).fit(X, y).alpha_.round(3)
    np.float64(5.623)
    """

    def __init__(
        self,
        alphas: ArrayLike = (0.1, 1.0, 10.0),
        *,
        fit_intercept: bool = True,
        scoring: Any = None,
        cv: Any = None,
        alpha_per_target: bool = False,
        threads: int | None = None,
    ) -> None:
        self.alphas = alphas
        self.fit_intercept = fit_intercept
        self.scoring = scoring
        self.cv = cv
        self.alpha_per_target = alpha_per_target
        self.threads = threads

    def fit(
        self, X: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None = None, *, groups: Any = None
    ) -> Self:
        """Select the weight, and fit all data with it.

        Parameters
        ----------
        X : (n, p) array or frame
            Features.
        y : (n,) or (n, r) array
            Responses.
        sample_weight : (n,) array, optional
            Weights of the data. A datum of weight 0 is absent from all fits.
        groups : (n,) array, optional
            Groups of the data, for splitters that need them.

        Returns
        -------
        RidgeCV
            Itself.
        """
        alphas = _checked_alphas(self.alphas)
        features, responses = validate_data(
            self, X, y, multi_output=True, y_numeric=True, dtype=np.float64, ensure_min_samples=2
        )
        cv = leave_one_out(len(features)) if self.cv is None else self.cv
        regression = Regression.of(features, responses, cv, groups, sample_weight).without_absent()
        weights = self._score_weights(regression)
        scores = np.array(
            [self._scores(regression, each, weights) for each in self._tried(regression, alphas)]
        )
        if np.isnan(scores).all(axis=0).any():
            check.refuse(
                "scoring", "A weight at least must have a score.", f"{self.scoring!r}, which is NaN for all"
            )
        best = np.nanargmax(scores, axis=0)
        self.alpha_, self.best_score_ = alphas[best], scores[best, np.arange(len(best))]
        self.cv_scores_ = scores
        if not self.alpha_per_target or regression.flat:
            self.alpha_, self.best_score_, self.cv_scores_ = alphas[best[0]], scores[best[0], 0], scores[:, 0]
        each = np.broadcast_to(self.alpha_, regression.y.shape[1])
        return self._fitted(each, regression.X, regression.as_given(regression.y), regression.weights)

    def _tried(self, regression: Regression, alphas: Floats) -> Iterator[Floats]:
        """Predictions of the validated data, (t, r), with every weight."""
        problem = regression.problem(fit_intercept=self.fit_intercept, threads=self.threads)
        for held_out in problem.ridge_regressions(alphas):
            yield held_out.predict(regression.scheme)

    def _score_weights(self, regression: Regression) -> Floats | None:
        """Weights of the validated data in scores, (t,), if there are some and the scorer takes them."""
        if regression.weights is None:
            return None
        if not takes_weights(scorer_of(self.scoring)):
            message = "scoring takes no sample_weight: the weights count in the fits, not in the scores."
            warnings.warn(message, UserWarning, stacklevel=3)
            return None
        return regression.weights[regression.scheme.validated.indices]

    def _scores(self, regression: Regression, predictions: Floats, some: Floats | None) -> Floats:
        """Score of predictions, (1,), or of those of each response, (r,)."""
        validated = regression.scheme.validated
        ends = np.append(validated.offsets[:-1][validated.sizes > 0], validated.offsets[-1])
        if self.scoring is None and (self.cv is None or np.diff(ends).min() < 2):
            errors = (regression.validated - predictions) ** 2
            means = -np.mean(errors if some is None else some[:, None] * errors, axis=0)
            return np.asarray(means if self.alpha_per_target else means.mean(keepdims=True))
        pairs = [(regression.as_given(regression.validated), regression.as_given(predictions))]
        if self.alpha_per_target:
            pairs = list(zip(regression.validated.T, predictions.T, strict=True))
        if self.cv is None:
            ends = ends[[0, -1]]
        X, rows = regression.X, validated.indices
        return np.array([fold_scores(self.scoring, ends, X, rows, *pair, some).mean() for pair in pairs])


def _checked_alphas(alphas: ArrayLike) -> Floats:
    """Weights as an array, (k,)."""
    weights = np.atleast_1d(check.real(alphas, "alphas"))
    if weights.ndim != 1 or not len(weights):
        check.refuse("alphas", _ALPHAS, f"shape {weights.shape}")
    if check.finite(weights, "alphas").min() < 0:
        check.refuse("alphas", _ALPHAS, f"{weights.min():g}")
    return weights
