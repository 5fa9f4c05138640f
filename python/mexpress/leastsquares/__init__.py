"""Linear least squares and its closed-form cross-validation: sections 2, 3.1 and 3.2 of the paper.

Examples
--------
>>> from mexpress.leastsquares import LeastSquares
>>> LeastSquares([[1.0], [1.0], [1.0]], [1.0, 2.0, 6.0])
LeastSquares(3 data, 3 rows, 1 columns, rank 1, fit_rms=2.160247)
"""

from mexpress.leastsquares.model import CrossValidation, LeastSquares, RankLossWarning
from mexpress.leastsquares.nested import cross_validate_nested

__all__ = ["CrossValidation", "LeastSquares", "RankLossWarning", "cross_validate_nested"]
