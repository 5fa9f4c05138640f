"""Fits of warps and surfaces as linear least-squares problems: from control points to a design, and back.

A `Design` has one set of control points and any lifting. A `NestedDesign` has thin-plate splines on control points
in an order: its leading columns are the designs of the first control points, so that all can be judged at once.

Examples
--------
>>> from mexpress.models import warp_design
>>> from mexpress.liftings import ThinPlateSpline
>>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
>>> warp_design(ThinPlateSpline(square), square, square, fractional=False).A.shape
(4, 4)
"""

from mexpress.models.design import Design, NestedDesign
from mexpress.models.surface_design import (
    NestedSurfaceDesign,
    SurfaceDesign,
    measured_data,
    nested_surface_design,
    surface_design,
)
from mexpress.models.warp_design import NestedWarpDesign, WarpDesign, matched, nested_warp_design, warp_design

__all__ = [
    "Design",
    "NestedDesign",
    "NestedSurfaceDesign",
    "NestedWarpDesign",
    "SurfaceDesign",
    "WarpDesign",
    "matched",
    "measured_data",
    "nested_surface_design",
    "nested_warp_design",
    "surface_design",
    "warp_design",
]
