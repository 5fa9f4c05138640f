"""A regression whose data and folds are checked, and the predictions of its held-out data."""

from __future__ import annotations

from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils import check_array

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.caching import cached_property
from mexpress.leastsquares.problem import WEIGHT_RATIO
from mexpress.schemes import Scheme
from mexpress.sklearn.folds import expect_training, scheme_of
from mexpress.sklearn.held_out import LinearProblem


@dataclass(frozen=True, eq=False)
class Regression:
    """Features (n, p), responses (n, r), weights (n,) or None, and what is held out."""

    X: Floats
    y: Floats
    flat: bool
    """Whether the responses were given as (n,)."""
    weights: Floats | None
    scheme: Scheme

    @classmethod
    def of(cls, X: Floats, y: Any, cv: Any, groups: Any, sample_weight: ArrayLike | None) -> Regression:
        """Return the regression of features and responses that scikit-learn has checked."""
        responses = np.asarray(y, dtype=np.float64)
        weights = checked_weights(sample_weight, len(X))
        scheme = scheme_of(cv, X, responses, groups)
        expect_training(scheme, weights)
        return cls(X, responses.reshape(len(responses), -1), responses.ndim == 1, weights, scheme)

    def without_absent(self) -> Regression:
        """Return the regression of the data whose weight is above 0."""
        if self.weights is None or self.weights.all():
            return self
        some = np.flatnonzero(self.weights)
        scheme = self.scheme.restricted(some)
        return replace(self, X=self.X[some], y=self.y[some], weights=self.weights[some], scheme=scheme)

    @cached_property
    def validated(self) -> Floats:
        """Responses of the validated data, pair after pair, (t, r)."""
        return self.y[self.scheme.validated.indices]

    def as_given(self, columns: Floats) -> Floats:
        """Responses in the shape in which they were given."""
        return columns[:, 0] if self.flat else columns

    def problem(
        self, targets: Any = slice(None), *, fit_intercept: bool, threads: int | None
    ) -> LinearProblem:
        """Return the linear problem of some of the responses."""
        return LinearProblem(self.X, self.y[:, targets], self.weights, fit_intercept, threads)


def checked_weights(sample_weight: ArrayLike | None, n: int) -> Floats | None:
    """Check weights of the data: n numbers of at least 0, not all 0, one number for all, or None."""
    if sample_weight is None:
        return None
    shares = np.full(n, sample_weight) if isinstance(sample_weight, Real) else sample_weight
    weights = check_array(shares, ensure_2d=False, dtype=np.float64, input_name="sample_weight")
    rule = f"It must be {n} numbers of at least 0, one for each datum, not all zero."
    if weights.shape != (n,):
        check.refuse("sample_weight", rule, f"shape {weights.shape}")
    if weights.min() < 0 or weights.max() == 0:
        check.refuse("sample_weight", rule, f"{weights.min():g} for datum {int(weights.argmin())}")
    smallest, largest = weights[weights > 0].min(), weights.max()
    if smallest < largest / WEIGHT_RATIO:
        rule = f"The largest must not exceed {WEIGHT_RATIO:g} times the smallest above 0."
        check.refuse("sample_weight", rule, f"{largest:g} and {smallest:g}")
    return np.asarray(weights)
