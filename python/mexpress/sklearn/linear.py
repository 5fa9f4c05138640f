"""Linear and ridge regression of scikit-learn, with cross-validation in closed form."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
from sklearn.utils import check_X_y
from sklearn.utils.validation import check_is_fitted, validate_data

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.sklearn.folds import expect_partition
from mexpress.sklearn.held_out import LinearProblem
from mexpress.sklearn.regression import Regression, checked_weights
from mexpress.sklearn.scores import fold_scores, scorer_of


class LinearModel(MultiOutputMixin, RegressorMixin, BaseEstimator):  # type: ignore[misc]  # scikit-learn has no types
    """What fits of linear models share; a feature's unit does not matter to their digits."""

    fit_intercept: bool

    def _fitted(self, alphas: Floats, X: Floats, y: Floats, weights: Floats | None) -> Self:
        """Fit checked data, with a weight of the ridge for each response, (r,)."""
        columns = y.reshape(len(y), -1)
        coefficients, intercepts = np.empty((columns.shape[1], X.shape[1])), np.empty(columns.shape[1])
        for alpha in np.unique(alphas):
            some = alphas == alpha
            fit = LinearProblem(X, columns[:, some], weights, self.fit_intercept).fit(alpha)
            coefficients[some], intercepts[some] = fit.coefficients.T, fit.intercept
        one = 0 if y.ndim == 1 else slice(None)
        self.coef_, self.intercept_ = coefficients[one], intercepts[one]
        return self

    def predict(self, X: ArrayLike) -> Floats:
        """Predict the responses, (k,) or (k, r), of features (k, p)."""
        check_is_fitted(self)
        features = validate_data(self, X, reset=False, dtype=np.float64)
        return np.asarray(features @ self.coef_.T + self.intercept_)


class _ClosedForm(LinearModel):
    """Cross-validation of a linear estimator without refits, except where training data lose rank."""

    def fit(self, X: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None = None) -> Self:
        """Fit responses (n,) or (n, r) to features (n, p), with weights of the data, (n,)."""
        features, responses = validate_data(self, X, y, multi_output=True, y_numeric=True, dtype=np.float64)
        alphas = self._alphas(responses[0].size)
        return self._fitted(alphas, features, responses, checked_weights(sample_weight, len(features)))

    def cross_val_predict(
        self,
        X: ArrayLike,
        y: ArrayLike,
        cv: Any = None,
        *,
        groups: Any = None,
        sample_weight: ArrayLike | None = None,
        threads: int | None = None,
    ) -> Floats:
        """Predict every datum by the fit without the data that are held out with it.

        The same numbers as `sklearn.model_selection.cross_val_predict`, without refits: equation (6).

        Parameters
        ----------
        X : (n, p) array or frame
            Features.
        y : (n,) or (n, r) array
            Responses.
        cv : int, splitter, Scheme or iterable of (train, test), optional
            What is held out, see `mexpress.schemes`; five folds by default. Every datum is validated once.
        groups : (n,) array, optional
            Groups of the data, for splitters that need them.
        sample_weight : (n,) array, optional
            Weights of the data in the fits. A datum of weight 0 is absent from all fits, and predicted all the same.
        threads : int, optional
            Largest number of threads; MEXPRESS_NUM_THREADS or all cores by default.

        Returns
        -------
        (n,) or (n, r) array
            A prediction of each datum. Where training data lose rank it is a refit's, of the smallest coefficients.

        Raises
        ------
        ValueError
            If a datum is not validated once, a pair leaves no training data, or the data are not finite.

        Examples
        --------
        >>> import mexpress as mx
        >>> from mexpress.sklearn import LinearRegression
        >>> LinearRegression().cross_val_predict([[0.0], [1.0], [2.0]], [0.0, 1.0, 5.0], cv=3).round(6)
        array([-3. ,  2.5,  2. ])
        """
        features, responses = check_X_y(X, y, dtype=np.float64, multi_output=True, y_numeric=True)
        regression = Regression.of(features, responses, cv, groups, sample_weight)
        expect_partition(regression.scheme)
        predictions = np.empty_like(regression.y)
        predictions[regression.scheme.validated.indices] = self._held_out(regression, threads)
        return regression.as_given(predictions)

    def cross_val_score(
        self,
        X: ArrayLike,
        y: ArrayLike,
        cv: Any = None,
        *,
        scoring: Any = None,
        groups: Any = None,
        sample_weight: ArrayLike | None = None,
        threads: int | None = None,
    ) -> Floats:
        """Score how the data of every pair are predicted by the fit without what it holds out.

        The same numbers as `sklearn.model_selection.cross_val_score`, without refits.

        Parameters
        ----------
        X, y, groups, threads
            As for `cross_val_predict`.
        cv : int, splitter, Scheme or iterable of (train, test), optional
            What is held out, see `mexpress.schemes`; five folds by default.
        scoring : str or callable, optional
            As for scikit-learn; R^2 by default, which is not defined where a pair validates a single datum: take
            "neg_mean_squared_error" there. A callable is given an estimator that knows the predictions of a pair's
            validated data, all of them at once, and nothing else; these data, as an array; and their responses.
        sample_weight : (n,) array, optional
            Weights of the data in the fits, not in the scores. A datum of weight 0 is absent from all fits.

        Returns
        -------
        (k,) array
            A score of each pair.

        Examples
        --------
        >>> import mexpress as mx
        >>> from mexpress.sklearn import LinearRegression
        >>> X, y = [[0.0], [1.0], [2.0]], [0.0, 1.0, 5.0]
        >>> LinearRegression().cross_val_score(X, y, cv=3, scoring="neg_mean_absolute_error").round(6)
        array([-3. , -1.5, -3. ])
        """
        scorer_of(scoring)
        features, responses = check_X_y(X, y, dtype=np.float64, multi_output=True, y_numeric=True)
        regression = Regression.of(features, responses, cv, groups, sample_weight)
        validated = regression.scheme.validated
        truth, predictions = (
            regression.as_given(each) for each in (regression.validated, self._held_out(regression, threads))
        )
        return fold_scores(scoring, validated.offsets, features, validated.indices, truth, predictions)

    def _alphas(self, responses: int) -> Floats:
        """Weight of the ridge for each response, (r,)."""
        return np.zeros(responses)

    def _held_out(self, regression: Regression, threads: int | None) -> Floats:
        """Predictions of the validated data, pair after pair, (t, r)."""
        weights = self._alphas(regression.y.shape[1])
        values = np.empty_like(regression.validated)
        for alpha in np.unique(weights):
            some = weights == alpha
            problem = regression.problem(some, fit_intercept=self.fit_intercept, threads=threads)
            values[:, some] = problem.ridge_regression(alpha).predict(regression.scheme)
        return values


class LinearRegression(_ClosedForm):
    """Ordinary least squares, cross-validated without refits.

    Rank is that of the columns, the ones of the intercept too, at unit length, in fits as in predictions of held-out
    data: a feature counts whatever its unit. Where rank is lost, the smallest coefficients are taken, as by
    `sklearn.linear_model.LinearRegression`. That one drops directions of the features that are a million times
    shorter than the longest; its parameters `copy_X`, `n_jobs`, `positive` and `tol` are not taken.

    Parameters
    ----------
    fit_intercept : bool, default True
        Whether the model has a constant.

    Attributes
    ----------
    coef_ : (p,) or (r, p) array
        Coefficients.
    intercept_ : float or (r,) array
        Constants.

    Examples
    --------
    >>> import numpy as np
    >>> import mexpress as mx
    >>> from mexpress.sklearn import LinearRegression
    >>> rng = np.random.default_rng(0)
    >>> X = rng.uniform(0, 10, (500, 2))
    >>> y = X[:, 0] + np.sin(X[:, 1]) + rng.normal(size=500)
    >>> near = mx.schemes.exclusion_radius(X, 1.0)
    >>> predictions = LinearRegression().cross_val_predict(X, y, cv=near)
    >>> float(np.mean((y - predictions) ** 2).round(3))
    1.676
    """

    def __init__(self, *, fit_intercept: bool = True) -> None:
        self.fit_intercept = fit_intercept


class Ridge(_ClosedForm):
    """Ridge regression, cross-validated without refits.

    The numbers are those of `sklearn.linear_model.Ridge` with its exact solver, "svd".

    Parameters
    ----------
    alpha : float or (r,) array, default 1.0
        Weight of the sum of squared coefficients, for all responses or for each.
    fit_intercept : bool, default True
        Whether the model has a constant, which is not penalised.

    Attributes
    ----------
    coef_ : (p,) or (r, p) array
        Coefficients.
    intercept_ : float or (r,) array
        Constants.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.model_selection import ShuffleSplit
    >>> from mexpress.sklearn import Ridge
    >>> rng = np.random.default_rng(0)
    >>> X = rng.normal(size=(100, 30))
    >>> y = X[:, 0] + rng.normal(size=100)
    >>> often = ShuffleSplit(1000, random_state=0)
    >>> [float(Ridge(alpha).cross_val_score(X, y, cv=often).mean().round(2)) for alpha in (1, 30, 1000)]
    [0.14, 0.28, -0.03]
    """

    def __init__(self, alpha: ArrayLike = 1.0, *, fit_intercept: bool = True) -> None:
        self.alpha = alpha
        self.fit_intercept = fit_intercept

    def _alphas(self, responses: int) -> Floats:
        rule = f"It must be a number of at least 0, or {responses}, one for each response."
        alphas = np.atleast_1d(check.real(self.alpha, "alpha"))
        if alphas.shape not in {(1,), (responses,)}:
            check.refuse("alpha", rule, f"shape {alphas.shape}")
        if check.finite(alphas, "alpha", rule).min() < 0:
            check.refuse("alpha", rule, f"{alphas.min():g}")
        return np.broadcast_to(alphas, responses)
