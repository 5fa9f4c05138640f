"""The selection of the number of control points and of the weight of the bending energy.

Every criterion scores every model, and one criterion selects.
"""

from mexpress.selection.defaults import largest_count
from mexpress.selection.fit import fit_surface, fit_warp
from mexpress.selection.selection import Selection
from mexpress.selection.surface import SurfaceSelection, select_surface
from mexpress.selection.warp import WarpSelection, select_warp

__all__ = [
    "Selection",
    "SurfaceSelection",
    "WarpSelection",
    "fit_surface",
    "fit_warp",
    "largest_count",
    "select_surface",
    "select_warp",
]
