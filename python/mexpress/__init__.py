"""How complex should this model be? Closed-form cross-validation of linear least squares and image warps.

Examples
--------
>>> import mexpress as mx
>>> model = mx.LeastSquares([[1.0], [1.0], [1.0]], [1.0, 2.0, 6.0])
>>> model.cross_validate(mx.schemes.leave_one_out(3))
CrossValidation(score=3.24037, 3 residuals, 0 undefined pairs)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from mexpress import _core  # noqa: F401 - a build that does not suit this Python fails here, not at first use

if TYPE_CHECKING:
    from typing import Any

    from mexpress import criteria, datasets, io, liftings, placement, schemes, simulation
    from mexpress.batch import Failure, iterate_problems, map_problems
    from mexpress.io.clouds import Cloud, read_cloud
    from mexpress.leastsquares import (
        BatchCrossValidation,
        CrossValidation,
        LeastSquares,
        RankLossWarning,
        TallLeastSquares,
        cross_validate_batch,
        cross_validate_nested,
    )
    from mexpress.models import Surface, Warp
    from mexpress.selection import (
        Selection,
        SurfaceSelection,
        WarpSelection,
        fit_surface,
        fit_warp,
        select_surface,
        select_warp,
    )
    from mexpress.selection.files import load
    from mexpress.versions import show_versions

    __version__: str

__all__ = [
    "BatchCrossValidation",
    "Cloud",
    "CrossValidation",
    "Failure",
    "LeastSquares",
    "RankLossWarning",
    "Selection",
    "Surface",
    "SurfaceSelection",
    "TallLeastSquares",
    "Warp",
    "WarpSelection",
    "criteria",
    "cross_validate_batch",
    "cross_validate_nested",
    "datasets",
    "fit_surface",
    "fit_warp",
    "io",
    "iterate_problems",
    "liftings",
    "load",
    "map_problems",
    "placement",
    "read_cloud",
    "schemes",
    "select_surface",
    "select_warp",
    "show_versions",
    "simulation",
]

_HOMES = {
    "mexpress.batch": ["Failure", "iterate_problems", "map_problems"],
    "mexpress.io.clouds": ["Cloud", "read_cloud"],
    "mexpress.leastsquares": [
        "BatchCrossValidation",
        "CrossValidation",
        "LeastSquares",
        "RankLossWarning",
        "TallLeastSquares",
        "cross_validate_batch",
        "cross_validate_nested",
    ],
    "mexpress.models": ["Surface", "Warp"],
    "mexpress.selection": [
        "Selection",
        "SurfaceSelection",
        "WarpSelection",
        "fit_surface",
        "fit_warp",
        "select_surface",
        "select_warp",
    ],
    "mexpress.selection.files": ["load"],
    "mexpress.versions": ["show_versions"],
}
"""Where public names are; the others are modules. Each is imported when it is first used: all of them, and what they
import, take four times as long as numpy."""


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])


if not TYPE_CHECKING:  # for type checkers, only what is imported above is there

    def __getattr__(name: str) -> Any:
        if name == "__version__":
            value = import_module("importlib.metadata").version("mexpress")
        elif name in __all__:
            home = next((home for home, names in _HOMES.items() if name in names), None)
            value = import_module(f"mexpress.{name}") if home is None else getattr(import_module(home), name)
        else:
            raise AttributeError(f"module 'mexpress' has no attribute {name!r}")
        globals()[name] = value
        return value
