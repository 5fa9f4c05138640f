"""How many control points, and how stiff: every criterion for every model, and the model that one criterion chooses.

Examples
--------
See `select_warp` and `select_surface`.
"""

from mexpress.selection.candidates import largest_count
from mexpress.selection.selection import Selection
from mexpress.selection.surface import SurfaceSelection, select_surface
from mexpress.selection.warp import WarpSelection, select_warp

__all__ = ["Selection", "SurfaceSelection", "WarpSelection", "largest_count", "select_surface", "select_warp"]
