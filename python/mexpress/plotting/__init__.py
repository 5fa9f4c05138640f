"""Plots: criteria against the number of control points, and what warps and surfaces do to the data.

Figures are made without pyplot: neither the backend nor the current figure changes, and nothing is kept. A notebook
shows a figure that is a cell's last value. `ax=` draws into axes of your own, of pyplot or not.

Examples
--------
>>> import mexpress as mx
>>> source = [[0, 0], [9, 0], [0, 9], [9, 9], [4, 5]]
>>> plot_warp(mx.fit_warp(source, source, source[:3]), source, source)
<Figure size ...>
"""

from mexpress.plotting.curves import plot_selection
from mexpress.plotting.errors import plot_error
from mexpress.plotting.radii import plot_radii
from mexpress.plotting.surfaces import plot_control_points, plot_residuals, plot_surface
from mexpress.plotting.warps import plot_registration, plot_warp

__all__ = [
    "plot_control_points",
    "plot_error",
    "plot_radii",
    "plot_registration",
    "plot_residuals",
    "plot_selection",
    "plot_surface",
    "plot_warp",
]
