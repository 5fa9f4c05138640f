"""All leading models of a design, in numpy: the nested trick, the formula of every model on its own, and refits.

Each is made from ``(A, b)``, one response and one row a datum, and predicts data with sets around them held out.
"""

from collections.abc import Sequence

import numpy as np

# Under the matrix of a Cholesky factorisation, rows of its factor are forward solves, whatever their own pivots are.
PIVOT = 1e100


class Rings:
    """One Cholesky factorisation a set for all models, on Gram matrices that grow from each set to the next larger one.

    ``I - Q_K^T Q_K = L L^T``, and ``u_j v_j`` summed to the model's number of columns is its prediction, with
    ``L u = q_i`` and ``v = L^T Q^T b - L^-1 Q_K^T e_K``. The factors of all sets around a datum come from one stack.

    Parameters
    ----------
    A, b : (m, p) and (m,) arrays
        Columns in the order of the models.
    """

    def __init__(self, A: np.ndarray, b: np.ndarray) -> None:
        Q, _ = np.linalg.qr(A)
        self.b = b
        self.c = Q.T @ b
        self.rows = np.column_stack([Q, b - Q @ self.c])

    def residuals(self, i: int, balls: Sequence[np.ndarray]) -> np.ndarray:
        """Predict datum i with each of the sets around it held out, by all models: (sets, p)."""
        p = len(self.c)
        systems = np.zeros((len(balls), p + 2, p + 2))
        left, inside = np.eye(p + 1, p), np.zeros(len(self.b), dtype=bool)
        for k in sorted(range(len(balls)), key=lambda k: len(balls[k])):
            ring = self.rows[balls[k][~inside[balls[k]]]]
            inside[balls[k]] = True
            left -= (ring.T @ ring)[:, :p]
            systems[k, :p, :p], systems[k, p, :p], systems[k, p + 1, :p] = left[:p], self.rows[i, :p], left[p]
            systems[k, p, p] = systems[k, p + 1, p + 1] = PIVOT
        factors = np.linalg.cholesky(systems)
        u, v = factors[:, p, :p], factors[:, p + 1, :p] + self.c @ factors[:, :p, :p]
        return self.b[i] - np.cumsum(u * v, axis=1)


class EachModel:
    """The paper's equation (13): a system of ``|K|`` unknowns for each set and model, ``(I - H_KK)^-1 e_K``."""

    def __init__(self, A: np.ndarray, b: np.ndarray) -> None:
        self.Q, _ = np.linalg.qr(A)
        self.b, self.c = b, self.Q.T @ b

    def residual(self, i: int, K: np.ndarray, size: int) -> float:
        """Predict datum i by the model of the first columns, with the sorted K held out."""
        QK = self.Q[K, :size]
        eK = self.b[K] - QK @ self.c[:size]
        return np.linalg.solve(np.eye(len(K)) - QK @ QK.T, eK)[np.searchsorted(K, i)]


class Refits:
    """A QR factorisation of the training rows; faster here than `numpy.linalg.lstsq`, and as accurate."""

    def __init__(self, A: np.ndarray, b: np.ndarray) -> None:
        self.A, self.b = A, b

    def residual(self, i: int, K: np.ndarray, size: int) -> float:
        """Predict datum i by the model of the first columns, with K held out."""
        return self._curve(i, K, size)[-1]

    def curve(self, i: int, K: np.ndarray) -> np.ndarray:
        """Predict datum i by all models: their triangles are leading blocks of the largest one's."""
        return self._curve(i, K, self.A.shape[1])

    def _curve(self, i: int, K: np.ndarray, size: int) -> np.ndarray:
        kept = np.ones(len(self.b), dtype=bool)
        kept[K] = False
        R = np.linalg.qr(np.column_stack([self.A[kept, :size], self.b[kept]]), mode="r")
        u = np.linalg.solve(R[:size, :size].T, self.A[i, :size])
        return self.b[i] - np.cumsum(u * R[:size, size])
