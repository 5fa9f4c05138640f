"""One penalised design at every weight of its penalty, for little more than the price of one weight.

With ``[A; sqrt(v) Z] = [Q_A; Q_Z] R`` for some weight v, and the singular value decomposition ``Q_A = U C V^T``,
the columns of ``Q_Z V`` are orthogonal with lengths S, and ``C^2 + S^2 = I``. At any weight w, the rows of the design
in an orthonormal basis of ``[A; sqrt(w) Z]`` are ``U D``, up to a rotation that does not change the hat matrix, with

    D = C (C^2 + (w / v) S^2)^(-1/2)

Weights of the data multiply the rows of A by their roots.

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

    def __init__(self, A: Floats, b: Floats, coupling: int, Z: Floats, weights: Floats | None = None) -> None:
        m, p = A.shape
        # Fits depend on the ratio of weights to the penalty's; with a largest weight of one, the core scales neither.
        self._largest = 1.0 if weights is None else float(weights.max())
        weights = None if weights is None else weights / self._largest
        self._problem = np.ascontiguousarray(A), b, coupling, np.ascontiguousarray(Z), weights
        self._roots = None if weights is None else np.repeat(np.sqrt(weights), coupling)[:, None]
        size = np.linalg.norm(Z)
        rows = A if self._roots is None else self._roots * A
        self._unit = float(np.linalg.norm(rows) / size) if size else 1.0
        basis, triangle = np.linalg.qr(np.vstack([rows, self._unit * Z]))
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
        A, b, coupling, Z, weights = self._problem
        weight /= self._largest
        if not self.determined:
            rows = np.sqrt(weight) * Z
            return FittedAt.of(LeastSquares(A, b, coupling, weights, rows, threads=threads))
        sines = np.sqrt(weight) / self._unit * self._sines
        lengths = np.hypot(self._cosines, sines)
        lengths[lengths == 0] = 1.0
        basis, rest = self._left * (self._cosines / lengths), np.diag(sines / lengths)
        if self._roots is not None:
            basis /= self._roots
        # With fewer rows than unknowns the basis has other columns than the design.
        source = (A, np.sqrt(weight) * Z) if basis.shape[1] == A.shape[1] else None
        model = LeastSquares._from_orthonormal(basis, b, coupling, rest, threads, weights, source)
        # Residuals are finite where coefficients are too large.
        with np.errstate(over="ignore", invalid="ignore"):
            return FittedAt(model, np.asarray((self._back / lengths) @ model.coefficients))
