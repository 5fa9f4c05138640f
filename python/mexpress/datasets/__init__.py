"""Data with a known truth, to try things on: made when asked for, with nothing to download.

Examples
--------
>>> import mexpress as mx
>>> mx.datasets.bent_page()
BentPage(200 matches, 0 of them wrong, page 1188 x 840, photo 1280 x 720)
>>> mx.datasets.terrain()
Terrain(2000 heights of 129 x 129)
"""

from mexpress.datasets.pages import BentPage, bent_page
from mexpress.datasets.terrains import Terrain, terrain

__all__ = ["BentPage", "Terrain", "bent_page", "terrain"]
