"""No closed form: fit the training rows of every pair anew."""

from collections.abc import Sequence

import numpy as np
from sklearn.linear_model import LinearRegression
from sklearn.model_selection import cross_val_predict


class Refit:
    """`numpy.linalg.lstsq` on the training rows."""

    def __init__(self, A: np.ndarray, b: np.ndarray) -> None:
        self.A, self.b = A, b

    def residuals(self, held_out: Sequence[np.ndarray], validated: Sequence[np.ndarray]) -> np.ndarray:
        """Predict the validated rows of every pair, in order."""
        predicted = []
        for K, T in zip(held_out, validated, strict=True):
            x = np.linalg.lstsq(np.delete(self.A, K, axis=0), np.delete(self.b, K), rcond=None)[0]
            predicted.append(self.b[T] - self.A[T] @ x)
        return np.concatenate(predicted)


class Sklearn:
    """`cross_val_predict` of a `LinearRegression` with an intercept, for folds that partition the data.

    Parameters
    ----------
    A, b : (m, p) and (m,) arrays
        The first column of A is constant; the intercept replaces it.
    """

    def __init__(self, A: np.ndarray, b: np.ndarray) -> None:
        self.X, self.b = A[:, 1:], b

    def residuals(self, held_out: Sequence[np.ndarray], validated: Sequence[np.ndarray]) -> np.ndarray:
        """Predict the validated rows of every pair, in order."""
        every = np.arange(len(self.b))
        splits = [(np.setdiff1d(every, K), T) for K, T in zip(held_out, validated, strict=True)]
        found = self.b - cross_val_predict(LinearRegression(), self.X, self.b, cv=splits)
        return found[np.concatenate(list(validated))]


class SklearnOneByOne:
    """A `LinearRegression` for each pair, as `cross_val_predict` fits them."""

    def __init__(self, A: np.ndarray, b: np.ndarray) -> None:
        self.X, self.b = A[:, 1:], b

    def residuals(self, held_out: Sequence[np.ndarray], validated: Sequence[np.ndarray]) -> np.ndarray:
        """Predict the validated rows of every pair, in order."""
        found = []
        for K, T in zip(held_out, validated, strict=True):
            model = LinearRegression().fit(np.delete(self.X, K, axis=0), np.delete(self.b, K))
            found.append(self.b[T] - model.predict(self.X[T]))
        return np.concatenate(found)
