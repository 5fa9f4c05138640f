"""Data to fit and truth to judge by: simulated images, tracked sheets, depth maps and terrain.

Draw k of a row depends on k alone. A row whose data are not in the data directory is left out.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from matplotlib.cbook import get_sample_data
from skimage.transform import ProjectiveTransform

from mexpress.io.clouds import read_cloud
from mexpress.simulation import Configuration, correspondences

SIZE = (640.0, 480.0)
CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * SIZE
STRONG = 2.0
"""By what factor denominators differ at least, over the points, where perspective is said to be strong."""

UNSEEN = 3000
"""Pixels of a depth map that judge, at most."""


@dataclass(frozen=True)
class Problem:
    """Data, (n, 2) -> (n, 2) of a warp or (n,) of a surface, and what the model should be at other points."""

    source: np.ndarray
    target: np.ndarray
    test_source: np.ndarray
    test_target: np.ndarray
    image_size: tuple[float, float] | None = None


def denominators(homography, points):
    """Return the ratio of the largest to the least denominator of a homography at points; inf if one is 0."""
    below = np.column_stack([points, np.ones(len(points))]) @ homography.params[2]
    below = below / below[0]
    return below.max() / below.min() if below.min() > 0 else np.inf


def homography(number, draw):
    """Match points of a plane under strong perspective, with noise of 1 px in both images."""
    random = np.random.default_rng(draw)
    strength = 0.0
    while not STRONG < strength < 2 * STRONG:
        moved = CORNERS + random.uniform(0, 0.45, (4, 2)) * SIZE * np.sign(0.5 * np.array(SIZE) - CORNERS)
        truth = ProjectiveTransform.from_estimate(CORNERS, moved)
        strength = denominators(truth, CORNERS)
    source, unseen = random.uniform(0, 1, (number, 2)) * SIZE, random.uniform(0, 1, (1000, 2)) * SIZE
    noise = random.normal(size=(2, number, 2))
    return Problem(source + noise[0], truth(source) + noise[1], unseen, truth(unseen), SIZE)


def tracked(path, noise, size, draw):
    """Match two views of a sheet that deforms; a third of the points judges, as measured."""
    random = np.random.default_rng(draw)
    with np.load(path) as arrays:
        views = arrays["image_points"]
    first, second = views[random.choice(len(views), 2, replace=False)]
    mixed = random.permutation(len(first))
    train, test = np.split(mixed, [round(2 * len(first) / 3)])
    noisy = second[train] + noise * random.normal(size=(len(train), 2))
    return Problem(first[train], noisy, first[test], second[test], size)


def sheet(number, draw):
    """Match two images of a simulated sheet, under strong perspective, with noise of 1 px in both."""
    random = np.random.default_rng(draw)
    strength = 0.0
    while strength < STRONG:
        pair = random.choice(10, 2, replace=False)
        where = Configuration(int(pair[0]), int(pair[1]), int(random.integers(5)))
        matches = correspondences(where, number, seed=draw)
        nearest = ProjectiveTransform.from_estimate(matches.dense_source, matches.dense_target)
        strength = denominators(nearest, matches.dense_source)
    dense = matches.dense_source, matches.dense_target
    return Problem(matches.source, matches.target, *dense, matches.image_size)


@lru_cache(maxsize=1)
def depth_map(path, scale):
    """Return the pixels with a depth, and the depths in m."""
    cloud = read_cloud(path, scale, max_data=None)
    return cloud.points, cloud.values


@lru_cache(maxsize=1)
def terrain():
    """Return the pixels of the Jacksboro elevations, and the elevations in m."""
    with get_sample_data("jacksboro_fault_dem.npz") as archive:
        elevation = archive["elevation"].astype(float)
    row, column = np.indices(elevation.shape)
    return np.column_stack([column.ravel(), row.ravel()]).astype(float), elevation.ravel()


def pixels(read, number, draw):
    """Take some pixels of a map for data, and others to judge."""
    points, values = read()
    mixed = np.random.default_rng(draw).permutation(len(points))
    train, test = mixed[:number], mixed[number : number + UNSEEN]
    return Problem(points[train], values[train], points[test], values[test])


def warps(data: Path) -> dict[str, Callable[[int], Problem]]:
    """Return by row what draws its matches."""
    rows = {f"homography ({n})": partial(homography, n) for n in (30, 100, 300)}
    for name, size in (("hulk", None), ("kinectpaper", SIZE)):
        path = data / "sheets" / f"{name}.npz"
        if path.exists():
            rows[f"{name} as measured"] = partial(tracked, path, 0.0, size)
            rows[f"{name} + 2 px"] = partial(tracked, path, 2.0, size)
    return rows | {f"simulated sheets ({n})": partial(sheet, n) for n in (50, 150)}


def surfaces(data: Path) -> dict[str, Callable[[int], Problem]]:
    """Return by row what draws its depths."""
    files = {"TUM": ("TUM_depth.png", 5000.0), "PrimeSense": ("depth_00000.png", 1000.0)}
    maps = {
        name: partial(depth_map, data / "depth" / file, scale)
        for name, (file, scale) in files.items()
        if (data / "depth" / file).exists()
    }
    return {
        f"{name} ({n})": partial(pixels, read, n)
        for name, read in (maps | {"Jacksboro": terrain}).items()
        for n in (300, 1000)
    }
