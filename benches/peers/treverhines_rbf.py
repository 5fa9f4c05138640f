"""treverhines-rbf: `RBFInterpolant.loocv`, the leave-one-out score of a smoothing spline in closed form.

It inverts the matrix of the spline (Fasshauer 2007, equation 17.1) and returns the norm of all prediction residuals.
It has no other held-out sets.
"""

from collections.abc import Sequence

import numpy as np
from rbf.interpolate import RBFInterpolant


class LeaveOneOut:
    """The thin-plate spline with a control point at each datum."""

    def __init__(self, points: np.ndarray, values: np.ndarray, smoothing: float) -> None:
        self.points, self.values, self.sigma = points, values, np.sqrt(smoothing)

    def residuals(self, held_out: Sequence[np.ndarray], validated: Sequence[np.ndarray]) -> np.ndarray:
        """Norm of the residuals of all data, each predicted from all others."""
        return np.array([RBFInterpolant.loocv(self.points, self.values, self.sigma, phi="phs2", order=1)])
