"""Data of surfaces: depth maps, disparities, terrain, random fields, and a sheet in space."""

from functools import lru_cache
from pathlib import Path

import numpy as np
import skimage
from matplotlib.cbook import get_sample_data
from scipy.spatial import KDTree

from comparison.fields import sample
from comparison.matches import thirds
from comparison.problem import Problem
from mexpress.io.clouds import read_cloud

UNSEEN = 3000
"""Pixels of a map that judge, at most."""

TRACKS = 10
"""Lines that ships sail along."""


@lru_cache(maxsize=2)
def depth_map(path, scale):
    """Return the pixels with a depth, and the depths in m."""
    cloud = read_cloud(path, scale, max_data=None)
    return cloud.points, cloud.values


def pixels_of(image):
    """Return the pixels of an image that have a value, and the values."""
    row, column = np.nonzero(np.isfinite(image))
    return np.column_stack([column, row]).astype(float), image[row, column].astype(float)


@lru_cache(maxsize=1)
def terrain():
    """Return the pixels of the Jacksboro elevations, and the elevations in m."""
    with get_sample_data("jacksboro_fault_dem.npz") as archive:
        return pixels_of(archive["elevation"].astype(float))


@lru_cache(maxsize=1)
def disparities():
    """Return the pixels of scikit-image's motorcycle that have a disparity, and the disparities in px."""
    with np.load(Path(skimage.__file__).parent / "data" / "motorcycle_disp.npz") as archive:
        return pixels_of(archive["arr_0"])


def pixels(read, number, draw):
    """Take some pixels of a map for data, and others to judge."""
    points, values = read()
    mixed = np.random.default_rng(draw).permutation(len(points))
    train, test = mixed[:number], mixed[number : number + UNSEEN]
    return Problem(points[train], values[train], points[test], values[test])


def tracks(read, number, draw):
    """Take pixels of a map along straight lines for data, as ships sound the sea, and others anywhere to judge."""
    (points, values), random = read(), np.random.default_rng(draw)
    low, high = points.min(axis=0), points.max(axis=0)
    ends = random.uniform(low, high, (2, TRACKS, 2))
    along = random.uniform(0, 1, (number, 1))
    which = random.integers(TRACKS, size=number)
    wished = (1 - along) * ends[0, which] + along * ends[1, which]
    train = np.unique(KDTree(points).query(wished)[1])
    test = np.setdiff1d(random.permutation(len(points))[:UNSEEN], train)
    return Problem(points[train], values[train], points[test], values[test])


def field(kind, draw, most=None):
    """Take noisy data of a random surface, all or the first ones; the surface itself judges."""
    drawn = sample(kind, draw)
    return Problem(drawn.points[:most], drawn.values[:most], drawn.grid, drawn.truth)


def sheet_in_space(path, noise, draw):
    """Take two thirds of the points of a bent sheet in space, by their place on the flat sheet; the others judge."""
    random = np.random.default_rng(draw)
    with np.load(path) as arrays:
        flat, bent = arrays["uv"], arrays["points3d"]
    train, test = thirds(len(flat), random)
    noisy = bent[train] + noise * random.normal(size=(len(train), 3))
    return Problem(flat[train], noisy, flat[test], bent[test])


def whole_sheet_in_space(path, noise, draw):
    """Take all points of a bent sheet in space, which are fitted and judge, until gaps are made."""
    random = np.random.default_rng(draw)
    with np.load(path) as arrays:
        flat, bent = arrays["uv"], arrays["points3d"]
    return Problem(flat, bent + noise * random.normal(size=bent.shape), flat, bent)
