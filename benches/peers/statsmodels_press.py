"""statsmodels: `OLSInfluence.resid_press`, the residuals divided by one minus the leverages, from a pseudo-inverse."""

from collections.abc import Sequence

import numpy as np
from statsmodels.regression.linear_model import OLS


class Press:
    """Leave-one-out of an ordinary least-squares fit."""

    def __init__(self, A: np.ndarray, b: np.ndarray) -> None:
        self.fit = OLS(b, A).fit()

    def residuals(self, held_out: Sequence[np.ndarray], validated: Sequence[np.ndarray]) -> np.ndarray:
        """Predict each datum from all others."""
        return self.fit.get_influence().resid_press
