"""Data in files as people have them: text, numpy's archives, images, point clouds and meshes.

Examples
--------
>>> import tempfile
>>> with tempfile.TemporaryDirectory() as folder:
...     with open(f"{folder}/matches.csv", "w") as file:
...         print("1,2,3,4", file=file)
...     read_matches(f"{folder}/matches.csv")
(array([[1., 2.]]), array([[3., 4.]]))
"""

from mexpress.io.clouds import Cloud, read_cloud
from mexpress.io.keypoints import matches_of
from mexpress.io.landmarks import write_landmarks
from mexpress.io.matches import read_matches, read_points, read_weighted_matches, write_matches

__all__ = [
    "Cloud",
    "matches_of",
    "read_cloud",
    "read_matches",
    "read_points",
    "read_weighted_matches",
    "write_landmarks",
    "write_matches",
]


def __dir__() -> list[str]:
    return sorted(__all__)
