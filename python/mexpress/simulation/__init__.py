"""Simulated images of bent sheets, as in section 4.4.2 of the paper.

The paper's sheets and poses are not published. Ours are exactly isometric, nowhere hidden, and fill the view: a camera
is so near that parts of a sheet are outside its image. Matches are points inside both images. How long the waves of the
sheets are, the tilt of the views and their distance are a `Setting`; ``docs/reproduction.md`` of the project says which
one the paper's table 1 is made with, and how it was chosen.

Examples
--------
>>> from mexpress import simulation
>>> matches = simulation.correspondences(simulation.Configuration(0, 1, 0), 30)
>>> matches.source.shape, matches.target.shape, matches.image_size
((30, 2), (30, 2), (1920.0, 1080.0))
"""

from mexpress.simulation.cameras import Camera
from mexpress.simulation.developable import Sheet, sheets
from mexpress.simulation.pairs import Configuration, Correspondences, configurations, correspondences
from mexpress.simulation.scenes import scene
from mexpress.simulation.settings import Setting

__all__ = [
    "Camera",
    "Configuration",
    "Correspondences",
    "Setting",
    "Sheet",
    "configurations",
    "correspondences",
    "scene",
    "sheets",
]


def __dir__() -> list[str]:
    return sorted(__all__)
