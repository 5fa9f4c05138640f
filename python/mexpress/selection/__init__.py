"""How many control points, and how stiff: every criterion for every model, and the model that one criterion chooses.

Examples
--------
>>> import numpy as np
>>> from mexpress.selection import select_warp
>>> source = np.random.default_rng(0).uniform(0, 100, (20, 2))
>>> select_warp(source, 2 * source + 1, counts=[3, 4, 5]).counts
array([3, 4, 5])
"""

from mexpress.selection.candidates import largest_count
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
