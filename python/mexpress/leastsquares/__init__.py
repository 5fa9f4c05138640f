"""Linear least squares and its closed-form cross-validation: sections 2, 3.1 and 3.2 of the paper."""

from mexpress.leastsquares.batch import BatchCrossValidation, cross_validate_batch
from mexpress.leastsquares.model import CrossValidation, LeastSquares, RankLossWarning
from mexpress.leastsquares.nested import cross_validate_nested

__all__ = [
    "BatchCrossValidation",
    "CrossValidation",
    "LeastSquares",
    "RankLossWarning",
    "cross_validate_batch",
    "cross_validate_nested",
]
