"""Simulated images of bent sheets, as in section 4.4.2 of the paper.

Examples
--------
>>> from mexpress import simulation
>>> matches = simulation.correspondences(simulation.Configuration(0, 1, 0), 30)
>>> matches.source.shape, matches.target.shape, matches.image_size
((30, 2), (30, 2), (1920.0, 1080.0))
"""

from mexpress.simulation.cameras import Camera
from mexpress.simulation.configurations import Configuration, Correspondences, configurations, correspondences
from mexpress.simulation.scenes import scene
from mexpress.simulation.sheets import Sheet, sheets

__all__ = [
    "Camera",
    "Configuration",
    "Correspondences",
    "Sheet",
    "configurations",
    "correspondences",
    "scene",
    "sheets",
]
