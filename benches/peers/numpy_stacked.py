"""The closed form in numpy: an orthonormal basis once, then a small system a pair."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np

# Gathered bases of this many bytes are solved together: larger stacks fall out of the cache and get slower.
STACK_BYTES = 400_000


class Closed:
    """What all share: ``Q`` and the residuals of the fit."""

    def __init__(self, A: np.ndarray, b: np.ndarray, workers: int = 1) -> None:
        self.Q, _ = np.linalg.qr(A)
        self.e = b - self.Q @ (self.Q.T @ b)
        self.workers = workers

    def residuals(self, held_out: Sequence[np.ndarray], validated: Sequence[np.ndarray]) -> np.ndarray:
        """Predict the validated rows of every pair, in order."""
        return np.concatenate(_shared(self._some, list(held_out), list(validated), self.workers))

    def _some(self, held_out: list[np.ndarray], validated: list[np.ndarray]) -> list[np.ndarray]:
        raise NotImplementedError


class Leverages(Closed):
    """Each datum alone: the residuals of the fit, divided by one minus the leverages."""

    def residuals(self, held_out: Sequence[np.ndarray], validated: Sequence[np.ndarray]) -> np.ndarray:
        """Predict every datum from all others."""
        return self.e / (1 - np.einsum("ij,ij->i", self.Q, self.Q))


class Looped(Closed):
    """A pair at a time, in the smaller of the two spaces; numpy takes ``K.T @ K`` for symmetric."""

    def _some(self, held_out: list[np.ndarray], validated: list[np.ndarray]) -> list[np.ndarray]:
        Q, e, p = self.Q, self.e, self.Q.shape[1]
        identity = np.eye(p)
        predicted = []
        for K, T in zip(held_out, validated, strict=True):
            QK, eK = Q[K], e[K]
            if len(K) < p:
                z = np.linalg.solve(np.eye(len(K)) - QK @ QK.T, eK)
                predicted.append(z[np.searchsorted(K, T)])
            else:
                z = np.linalg.solve(identity - QK.T @ QK, QK.T @ eK)
                predicted.append(e[T] + Q[T] @ z)
        return predicted


class Stacked(Closed):
    """Many pairs at a time with batched products and `numpy.linalg.solve`. All sets must have one size."""

    def _some(self, held_out: list[np.ndarray], validated: list[np.ndarray]) -> list[np.ndarray]:
        step = max(1, STACK_BYTES // (8 * len(held_out[0]) * self.Q.shape[1]))
        starts = range(0, len(held_out), step)
        return [
            self._stack(np.stack(held_out[s : s + step]), np.stack(validated[s : s + step])).ravel()
            for s in starts
        ]

    def _stack(self, K: np.ndarray, T: np.ndarray) -> np.ndarray:
        raise NotImplementedError


class Primal(Stacked):
    """Systems of p unknowns."""

    def _stack(self, K: np.ndarray, T: np.ndarray) -> np.ndarray:
        QK = self.Q[K]
        turned = QK.swapaxes(1, 2)
        right = turned @ self.e[K][..., None]
        z = np.linalg.solve(np.eye(self.Q.shape[1]) - turned @ QK, right)
        return self.e[T] + (self.Q[T] @ z)[..., 0]


class Dual(Stacked):
    """Systems of as many unknowns as rows are held out."""

    def _stack(self, K: np.ndarray, T: np.ndarray) -> np.ndarray:
        QK = self.Q[K]
        z = np.linalg.solve(np.eye(K.shape[1]) - QK @ QK.swapaxes(1, 2), self.e[K][..., None])[..., 0]
        place = (K[:, None, :] == T[:, :, None]).argmax(axis=2)
        return np.take_along_axis(z, place, axis=1)


def _shared(
    work: Callable[[list, list], list], held_out: list, validated: list, workers: int
) -> list[np.ndarray]:
    """Shares the pairs out to threads: better than a BLAS with threads of its own, on products this small."""
    if workers == 1:
        return work(held_out, validated)
    cuts = np.linspace(0, len(held_out), workers + 1).astype(int)
    pieces = [slice(a, b) for a, b in pairwise(cuts)]
    with ThreadPoolExecutor(workers) as pool:
        parts = pool.map(lambda piece: work(held_out[piece], validated[piece]), pieces)
        return [e for part in parts for e in part]
