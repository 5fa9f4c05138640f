"""How complex should this model be? Closed-form cross-validation of linear least squares, warps and surfaces."""

from importlib.metadata import version

from mexpress import criteria, schemes
from mexpress.files import load
from mexpress.leastsquares import CrossValidation, LeastSquares, RankLossWarning
from mexpress.selection import Selection, WarpSelection, select_warp
from mexpress.warps import Warp, fit_warp

__all__ = [
    "CrossValidation",
    "LeastSquares",
    "RankLossWarning",
    "Selection",
    "Warp",
    "WarpSelection",
    "criteria",
    "fit_warp",
    "load",
    "schemes",
    "select_warp",
]

__version__ = version("mexpress")
