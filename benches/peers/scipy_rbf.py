"""scipy: a smoothing `RBFInterpolator` fitted anew without each held-out set. It has no cross-validation of its own."""

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import RBFInterpolator


class Refits:
    """The thin-plate spline with a control point at each datum, once a pair."""

    def __init__(self, points: np.ndarray, values: np.ndarray, smoothing: float) -> None:
        self.points, self.values, self.smoothing = points, values, smoothing

    def residuals(self, held_out: Sequence[np.ndarray], validated: Sequence[np.ndarray]) -> np.ndarray:
        """Predict the validated data of every pair, in order."""
        found = []
        for K, T in zip(held_out, validated, strict=True):
            kept = np.delete(np.arange(len(self.values)), K)
            spline = RBFInterpolator(self.points[kept], self.values[kept], smoothing=self.smoothing)
            found.append(self.values[T] - spline(self.points[T]))
        return np.concatenate(found)
