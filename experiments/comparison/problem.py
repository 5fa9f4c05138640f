"""What a method is given, and what it is judged by."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Problem:
    """Data, (n, 2) -> (n, 2) of a warp or (n,) or (n, 3) of a surface, and what the model should be at other points."""

    source: np.ndarray
    target: np.ndarray
    test_source: np.ndarray
    test_target: np.ndarray
    image_size: tuple[float, float] | None = None

    @property
    def is_warp(self):
        """Tell whether the plane is mapped to the plane."""
        return self.target.shape[1:] == (2,)
