"""How complex should this model be? Closed-form cross-validation of linear least squares and image warps.

Examples
--------
>>> import mexpress as mx
>>> model = mx.LeastSquares([[1.0], [1.0], [1.0]], [1.0, 2.0, 6.0])
>>> model.cross_validate(mx.schemes.leave_one_out(3))
CrossValidation(score=3.24037, 3 residuals, 0 undefined pairs)
"""

from importlib.metadata import version

from mexpress import criteria, schemes
from mexpress.designs import fit_warp
from mexpress.files import load
from mexpress.leastsquares import CrossValidation, LeastSquares, RankLossWarning
from mexpress.selection import Selection, WarpSelection, select_warp
from mexpress.warps import Warp

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
