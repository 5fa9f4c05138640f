"""scikit-learn: `RidgeCV` with ``cv=None``, leave-one-out of ridge regressions in closed form."""

from collections.abc import Sequence

import numpy as np
from sklearn.linear_model import RidgeCV


class LeaveOneOut:
    """The scores of all weights, and the fit of the best one.

    Parameters
    ----------
    A, b : (n, p) and (n,) arrays
        The first column of A is constant; the intercept replaces it.
    alphas : (k,) array
        Weights of the ridge.
    """

    def __init__(self, A: np.ndarray, b: np.ndarray, alphas: np.ndarray) -> None:
        self.fit = RidgeCV(alphas, store_cv_results=True).fit(A[:, 1:], b)

    def residuals(self, held_out: Sequence[np.ndarray], validated: Sequence[np.ndarray]) -> np.ndarray:
        """Mean squared error of each weight; each datum is held out."""
        return self.fit.cv_results_.mean(axis=0)
