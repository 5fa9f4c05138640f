"""Scores of the predictions of every fold, as scikit-learn's scorers give them, for thousands of folds at once."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from inspect import signature
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.exceptions import UndefinedMetricWarning
from sklearn.metrics import get_scorer

from mexpress import _validation as check
from mexpress._validation import Floats, Integers


class Predicted(RegressorMixin, BaseEstimator):  # type: ignore[misc]  # scikit-learn has no types
    """What scorers take for the estimators of a fold: it knows the predictions of that fold's data, and no others."""

    def __init__(self, features: Floats, predictions: Floats) -> None:
        self.features = features
        self.predictions = predictions

    def __sklearn_is_fitted__(self) -> bool:
        return True

    def predict(self, X: ArrayLike) -> Floats:
        """Return the predictions of the fold's data."""
        if X is not self.features and not np.array_equal(X, self.features):
            rule = f"A scorer must predict all {len(self.features)} data of its fold at once: no others are known."
            check.refuse("X", rule, check.describe(X))
        return self.predictions


def scorer_of(scoring: Any) -> Any:
    """Return the scorer that a name or a callable stands for; R^2 if None."""
    return get_scorer("r2" if scoring is None else scoring)


def takes_weights(scorer: Any) -> bool:
    """Whether a scorer takes `sample_weight`, as scikit-learn's searches ask.

    Examples
    --------
    >>> takes_weights(scorer_of("r2")), takes_weights(lambda estimator, X, y: 0.0)
    (True, False)
    """
    if hasattr(scorer, "_accept_sample_weight"):
        return bool(scorer._accept_sample_weight())
    try:
        return "sample_weight" in signature(scorer).parameters
    except (TypeError, ValueError):  # of compiled functions
        return False


def fold_scores(
    scoring: Any,
    ends: Integers,
    X: Floats,
    rows: Integers,
    truth: Floats,
    predictions: Floats,
    weights: Floats | None = None,
) -> Floats:
    """Score each fold, (k,).

    Parameters
    ----------
    scoring : str, callable or None
        As for `sklearn.model_selection.cross_val_score`; R^2 if None.
    ends : (k + 1,) int array
        Fold f has the data from ``ends[f]`` to ``ends[f + 1]``.
    X : (n, p) array
        Features of all data, for scorers that look at them.
    rows : (t,) int array
        Validated data, fold after fold.
    truth, predictions : (t,) or (t, r) arrays
        Their responses and predictions.
    weights : (t,) array, optional
        Their weights in the scores.

    Examples
    --------
    >>> ends, rows = np.array([0, 2, 3]), np.arange(3)
    >>> truth, predictions = np.array([1.0, 2.0, 3.0]), np.array([1.0, 4.0, 3.0])
    >>> fold_scores("neg_mean_squared_error", ends, np.eye(3), rows, truth, predictions)
    array([-2., -0.])
    """
    of_folds = None if callable(scoring) else _MANY_FOLDS.get("r2" if scoring is None else scoring)
    if of_folds is not None:
        shape = len(truth), -1
        shares = np.ones((len(truth), 1)) if weights is None else weights[:, None]
        return of_folds(Folds(ends, shares), truth.reshape(shape), predictions.reshape(shape))
    scorer = scorer_of(scoring)
    scores = []
    for fold in map(slice, ends[:-1], ends[1:]):
        weighted = {} if weights is None else {"sample_weight": weights[fold]}
        features = X[rows[fold]]
        estimator = Predicted(features, predictions[fold])
        scores.append(float(scorer(estimator, features, truth[fold], **weighted)))
    return np.array(scores)


class Folds(NamedTuple):
    """The ends of folds, and the weights of their data, (t, 1)."""

    ends: Integers
    weights: Floats

    @property
    def sizes(self) -> Integers:
        """Number of data of each fold."""
        return np.diff(self.ends)

    def sums(self, numbers: Floats) -> Floats:
        """Weighted sum of the numbers of each fold, (k, r)."""
        filled = self.sizes > 0  # reduceat takes an empty fold for one number
        sums = np.zeros((len(filled), numbers.shape[1]))
        if filled.any():
            sums[filled] = np.add.reduceat(self.weights * numbers, self.ends[:-1][filled], axis=0)
        return sums

    def means(self, numbers: Floats) -> Floats:
        """Weighted mean of the numbers of each fold, (k, r); NaN of none."""
        with np.errstate(invalid="ignore"):
            return self.sums(numbers) / self.sums(np.ones_like(self.weights))


def _squared(folds: Folds, truth: Floats, predictions: Floats) -> Floats:
    return np.asarray(-folds.means((truth - predictions) ** 2).mean(axis=1))


def _root_squared(folds: Folds, truth: Floats, predictions: Floats) -> Floats:
    return np.asarray(-np.sqrt(folds.means((truth - predictions) ** 2)).mean(axis=1))


def _absolute(folds: Folds, truth: Floats, predictions: Floats) -> Floats:
    return np.asarray(-folds.means(np.abs(truth - predictions)).mean(axis=1))


def _determination(folds: Folds, truth: Floats, predictions: Floats) -> Floats:
    """R^2, the mean over the responses; a constant response scores 1 if it is predicted exactly, else 0."""
    about = np.repeat(folds.means(truth), folds.sizes, axis=0)
    missed, spread = folds.sums((truth - predictions) ** 2), folds.sums((truth - about) ** 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        scores = np.where(spread > 0, 1 - missed / spread, np.where(missed > 0, 0.0, 1.0)).mean(axis=1)
    few = folds.sizes < 2
    if few.any():
        message = "R^2 score is not well-defined with less than two samples."
        warnings.warn(message, UndefinedMetricWarning, stacklevel=2)
    return np.where(few, np.nan, scores)


_MANY_FOLDS: dict[str, Callable[[Folds, Floats, Floats], Floats]] = {
    "r2": _determination,
    "neg_mean_squared_error": _squared,
    "neg_root_mean_squared_error": _root_squared,
    "neg_mean_absolute_error": _absolute,
}
"""Scores of all folds at once. A scorer takes longer for one fold than the closed form takes to predict it."""
