"""cvmatrix: training Gram matrices by subtraction, then a solve.

Its `Partitioner` cuts data into disjoint folds. ``training_XTX_XTY`` takes any set of rows, though, so sets may
overlap without it, and nothing is lost in speed: the partitioner is a dictionary of index arrays.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
from cvmatrix.cvmatrix import CVMatrix


class Folds:
    """One training set at a time.

    Parameters
    ----------
    A, b : (m, p) and (m,) arrays
        The first column of A is constant.
    centred : bool
        Whether cvmatrix centres, which replaces the constant column; otherwise it sees the whole design.
    stacked : bool
        Whether the systems are solved all at once.
    workers : int
        Threads that share the pairs.
    """

    def __init__(
        self, A: np.ndarray, b: np.ndarray, *, centred: bool = False, stacked: bool = False, workers: int = 1
    ) -> None:
        self.X = A[:, 1:] if centred else A
        self.b, self.centred, self.stacked, self.workers = b, centred, stacked, workers
        self.model = CVMatrix(center_X=centred, center_Y=centred, scale_X=False, scale_Y=False, copy=False)
        self.model.fit(self.X, b)

    def residuals(self, held_out: Sequence[np.ndarray], validated: Sequence[np.ndarray]) -> np.ndarray:
        """Predict the validated rows of every pair, in order."""
        work = self._stacked if self.stacked else self._looped
        held_out, validated = list(held_out), list(validated)
        cuts = np.linspace(0, len(held_out), self.workers + 1).astype(int)
        pieces = [slice(a, b) for a, b in pairwise(cuts)]
        if self.workers == 1:
            return work(held_out, validated)
        with ThreadPoolExecutor(self.workers) as pool:
            return np.concatenate(list(pool.map(lambda s: work(held_out[s], validated[s]), pieces)))

    def _looped(self, held_out: list[np.ndarray], validated: list[np.ndarray]) -> np.ndarray:
        predicted = []
        for K, T in zip(held_out, validated, strict=True):
            (XTX, XTY), means = self.model.training_XTX_XTY(K)
            predicted.append(self._residuals(T, np.linalg.solve(XTX, XTY), means))
        return np.concatenate(predicted)

    def _stacked(self, held_out: list[np.ndarray], validated: list[np.ndarray]) -> np.ndarray:
        found = [self.model.training_XTX_XTY(K) for K in held_out]
        left, right = (np.stack([pair[i] for pair, _ in found]) for i in (0, 1))
        beta = np.linalg.solve(left, right)
        every = zip(validated, beta, found, strict=True)
        return np.concatenate([self._residuals(T, x, means) for T, x, (_, means) in every])

    def _residuals(self, T: np.ndarray, beta: np.ndarray, means: tuple) -> np.ndarray:
        if not self.centred:
            return self.b[T] - (self.X[T] @ beta)[:, 0]
        x_mean, _, y_mean, _ = means
        return self.b[T] - y_mean[0, 0] - ((self.X[T] - x_mean) @ beta)[:, 0]
