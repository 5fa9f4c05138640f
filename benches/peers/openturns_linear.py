"""OpenTURNS: leave-one-out and k folds of a linear model in its analytical forms.

`LinearModelAlgorithm` fits an intercept and the other columns of the design. `LinearModelValidation` then divides the
residuals by one minus the leverages, or, with a `KFoldSplitter`, forms the hat matrix of all data, n x n, and solves
with its block of each fold. Other sets cannot be held out.
"""

from collections.abc import Sequence

import numpy as np
import openturns as ot
from openturns.experimental import LinearModelValidation


class Validation:
    """Prediction residuals of `LinearModelValidation`.

    Parameters
    ----------
    A, b : (n, p) and (n,) arrays
        The first column of A is constant; the intercept replaces it.
    """

    def __init__(self, A: np.ndarray, b: np.ndarray) -> None:
        self.b = b
        algorithm = ot.LinearModelAlgorithm(ot.Sample(A[:, 1:]), ot.Sample(b[:, None]))
        algorithm.run()
        self.result = algorithm.getResult()

    def residuals(self, held_out: Sequence[np.ndarray], validated: Sequence[np.ndarray]) -> np.ndarray:
        """Predict all data, each alone or in folds of consecutive data, which are the splitter's."""
        n, k = len(self.b), len(held_out)
        splitter = ot.LeaveOneOutSplitter(n) if k == n else ot.KFoldSplitter(n, k)
        predicted = LinearModelValidation(self.result, splitter).getMetamodelPredictions()
        return self.b - np.asarray(predicted)[:, 0]
