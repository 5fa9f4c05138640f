"""How complex should this model be? Closed-form cross-validation of linear least squares, warps and surfaces."""

from mexpress import schemes
from mexpress.leastsquares import CrossValidation, LeastSquares, RankLossWarning

__all__ = ["CrossValidation", "LeastSquares", "RankLossWarning", "schemes"]
