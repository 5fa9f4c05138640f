"""Linear least squares and its closed-form cross-validation: sections 2, 3.1 and 3.2 of the paper."""

from mexpress.leastsquares.batch import BatchCrossValidation, cross_validate_batch
from mexpress.leastsquares.cross_validation import CrossValidation, RankLossWarning
from mexpress.leastsquares.model import LeastSquares
from mexpress.leastsquares.nested import cross_validate_nested
from mexpress.leastsquares.tall import TallLeastSquares

__all__ = [
    "BatchCrossValidation",
    "CrossValidation",
    "LeastSquares",
    "RankLossWarning",
    "TallLeastSquares",
    "cross_validate_batch",
    "cross_validate_nested",
]
