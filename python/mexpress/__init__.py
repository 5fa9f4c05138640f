"""How complex should this model be? Closed-form cross-validation of linear least squares and image warps.

Examples
--------
>>> import mexpress as mx
>>> model = mx.LeastSquares([[1.0], [1.0], [1.0]], [1.0, 2.0, 6.0])
>>> model.cross_validate(mx.schemes.leave_one_out(3))
CrossValidation(score=3.24037, 3 residuals, 0 undefined pairs)
"""

from importlib.metadata import version

from mexpress import criteria, io, schemes
from mexpress.batch import map_problems
from mexpress.io.clouds import Cloud, read_cloud
from mexpress.leastsquares import CrossValidation, LeastSquares, RankLossWarning, cross_validate_nested
from mexpress.models import Surface, Warp
from mexpress.models.files import load
from mexpress.selection import (
    Selection,
    SurfaceSelection,
    WarpSelection,
    fit_surface,
    fit_warp,
    select_surface,
    select_warp,
)
from mexpress.versions import show_versions

__all__ = [
    "Cloud",
    "CrossValidation",
    "LeastSquares",
    "RankLossWarning",
    "Selection",
    "Surface",
    "SurfaceSelection",
    "Warp",
    "WarpSelection",
    "criteria",
    "cross_validate_nested",
    "fit_surface",
    "fit_warp",
    "io",
    "load",
    "map_problems",
    "read_cloud",
    "schemes",
    "select_surface",
    "select_warp",
    "show_versions",
]

__version__ = version("mexpress")
