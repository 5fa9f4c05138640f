"""One penalised design at every weight of its penalty, for little more than the price of one weight.

With ``[A; sqrt(v) Z] = [Q_A; Q_Z] R`` for some weight v, and the singular value decomposition ``Q_A = U C V^T``,
the columns of ``Q_Z V`` are orthogonal with lengths S, and ``C^2 + S^2 = I``. At any weight w, the rows of the design
in an orthonormal basis of ``[A; sqrt(w) Z]`` are ``U D``, up to a rotation that does not change the hat matrix, with

    D = C (C^2 + (w / v) S^2)^(-1/2)

Examples
--------
>>> import mexpress as mx
>>> import numpy as np
>>> x = np.linspace(0, 1, 9)
>>> A, Z = np.vander(x, 4), np.eye(2, 4)
>>> fit = PenaltyPath(A, np.sin(5 * x), 1, Z).fit(0.3)
>>> direct = mx.LeastSquares(A, np.sin(5 * x), penalty=np.sqrt(0.3) * Z)
>>> bool(np.allclose(fit.coefficients, direct.coefficients))
True
"""

from dataclasses import dataclass

import numpy as np

from mexpress._validation import Floats
from mexpress.leastsquares.model import LeastSquares


@dataclass(frozen=True, eq=False, repr=False)
class FittedAt:
    """A fit, and the coefficients of its design; None if they are not determined.

    The fit may have other unknowns than the design, but its residuals, leverages and predictions are the design's.
    """

    model: LeastSquares
    coefficients: Floats | None

    @classmethod
    def of(cls, model: LeastSquares) -> "FittedAt":
        """Wrap a fit whose unknowns are those of the design."""
        return cls(model, model.coefficients if model.rank == len(model.coefficients) else None)


class PenaltyPath:
    """A least-squares problem, factorised once for all weights of its penalty rows Z, (k, p).

    Attributes
    ----------
    determined : bool
        Whether A and Z together determine the coefficients.
    rank : int
        Rank of A alone, up to rounding in the common factorisation.
    """

    def __init__(self, A: Floats, b: Floats, coupling: int, Z: Floats) -> None:
        m, p = A.shape
        self._problem = A, b, coupling, Z
        size = np.linalg.norm(Z)
        self._unit = float(np.linalg.norm(A) / size) if size else 1.0
        basis, triangle = np.linalg.qr(np.vstack([A, self._unit * Z]))
        rounding = (m + p) * np.finfo(float).eps
        pivots, lengths = np.diagonal(triangle), np.linalg.norm(triangle, axis=0)
        small = np.abs(pivots) <= rounding * lengths[: len(pivots)]
        self.determined = len(triangle) == p and not small.any()
        # Directions in the null space of A have coefficient zero at any weight, and are omitted.
        self._left, cosines, right = np.linalg.svd(basis[:m], full_matrices=False)
        sines = np.linalg.norm(basis[m:] @ right.T, axis=0)
        # Rounding, times the root of an extreme weight, would penalise directions without bending energy.
        self._cosines, self._sines = (np.where(part > rounding, part, 0.0) for part in (cosines, sines))
        self._back = np.linalg.solve(triangle, right.T) if self.determined else right.T
        self.rank = int(np.count_nonzero(self._cosines))

    def fit(self, weight: float, threads: int | None = None) -> FittedAt:
        """Return the fit at a weight above zero."""
        A, b, coupling, Z = self._problem
        if not self.determined:
            return FittedAt.of(LeastSquares(A, b, coupling, penalty=np.sqrt(weight) * Z, threads=threads))
        sines = np.sqrt(weight) / self._unit * self._sines
        lengths = np.hypot(self._cosines, sines)
        lengths[lengths == 0] = 1.0
        basis, rest = self._left * (self._cosines / lengths), np.diag(sines / lengths)
        model = LeastSquares._from_orthonormal(basis, b, coupling, rest, threads)
        return FittedAt(model, np.asarray((self._back / lengths) @ model.coefficients))
