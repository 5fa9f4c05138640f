"""One penalised design at every weight of its penalty, for little more than the price of one weight.

With ``A = Q T`` and ``[T; v Z] = [Q_T; Q_Z] R`` for some v, and the singular value decomposition ``Q_T = U C V^T``,
the columns of ``Q_Z V`` are orthogonal with lengths S, and ``C^2 + S^2 = I``. At any weight w, the rows of the design
in an orthonormal basis of ``[A; sqrt(w) Z]`` are ``Q U D``, up to a rotation that does not change the hat matrix, with

    D = C (C^2 + (w / v^2) S^2)^(-1/2)

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

from dataclasses import dataclass, replace

import numpy as np

from mexpress import _core
from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.leastsquares.model import LeastSquares
from mexpress.leastsquares.problem import Problem


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

    def __init__(
        self,
        A: Floats,
        b: Floats,
        coupling: int,
        Z: Floats,
        weights: Floats | None = None,
        threads: int | None = None,
    ) -> None:
        self._problem = Problem.of(A, b, coupling, weights, Z)
        self._path = _core.PenaltyPath(self._problem.arrays, check.threads(threads))
        self.determined, self.rank = self._path.determined, self._path.rank

    def fit(self, weight: float, threads: int | None = None) -> FittedAt:
        """Return the fit at a weight above zero."""
        problem, workers = self._problem, check.threads(threads)
        if not self.determined:
            here = replace(problem, penalty=np.sqrt(weight) * problem.penalty)
            return FittedAt.of(LeastSquares._of(here, _core.Factor(here.arrays, workers)))
        factor, columns = self._path.fit(weight, workers)
        coefficients = columns[:, 0] if problem.responses.ndim == 1 else np.ascontiguousarray(columns)
        return FittedAt(LeastSquares._of(problem, factor), coefficients)
