"""The paper's 450 simulated image pairs (section 4.4.2): pairs of sheets, their views, and the matches."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.simulation.cameras import FOCAL, IMAGE_SIZE, Camera, in_frame
from mexpress.simulation.developable import COUNT, Sheet, sheets
from mexpress.simulation.poses import random_camera
from mexpress.simulation.settings import DEFAULT, Setting, checked_setting

VIEWS = 5
"""Number of views (poses and focal lengths) of each pair of sheets."""

DENSE = (75, 42)
"""Columns and rows of a grid on a sheet; its points inside both images are the dense points."""

View: TypeAlias = tuple[Sheet, Camera]
Views: TypeAlias = tuple[View, View]


@dataclass(frozen=True)
class Configuration:
    """A pair of sheets and one of its views.

    Parameters
    ----------
    source, target : int
        Indices of two sheets, from 0 to 9.
    view : int
        Index of the poses and the focal length, from 0 to 4.

    Raises
    ------
    ValueError, TypeError
        If an index is out of range, or the sheets are the same.

    Examples
    --------
    >>> from mexpress.simulation import Configuration
    >>> Configuration(3, 7, 0)
    Configuration(source=3, target=7, view=0)
    """

    source: int
    target: int
    view: int

    def __post_init__(self) -> None:
        for name, bound in (("source", COUNT), ("target", COUNT), ("view", VIEWS)):
            object.__setattr__(self, name, check.count(getattr(self, name), name, 0, bound - 1))
        if self.source == self.target:
            check.refuse("target", "It must be another sheet than the source.", f"{self.target} twice")


@dataclass(frozen=True, eq=False, repr=False)
class Correspondences:
    """Points of a sheet in two images.

    Parameters
    ----------
    source, target : (n, 2) array
        Matches in pixels, with noise.
    dense_source, dense_target : (k, 2) array
        Images, without noise and in pixels, of the points of a regular grid on the sheet that are inside both images.
    contour_source, contour_target : (c, 2) array, optional
        Images, without noise and in pixels, of a smooth closed curve on the sheet.
    image_size : (float, float), default (1920.0, 1080.0)
        Width and height of both images in pixels.
    """

    source: Floats
    target: Floats
    dense_source: Floats
    dense_target: Floats
    contour_source: Floats | None = None
    contour_target: Floats | None = None
    image_size: tuple[float, float] = IMAGE_SIZE

    def __repr__(self) -> str:
        return f"Correspondences({len(self.source)} matches, {len(self.dense_source)} dense points)"


def configurations() -> list[Configuration]:
    """All 450 configurations, in a fixed order: ordered pairs of different sheets, with five views each.

    Examples
    --------
    >>> from mexpress import simulation
    >>> every = simulation.configurations()
    >>> len(every), every[-1]
    (450, Configuration(source=9, target=8, view=4))
    """
    pairs = [(source, target) for source in range(COUNT) for target in range(COUNT) if source != target]
    return [Configuration(*pair, view) for pair in pairs for view in range(VIEWS)]


def correspondences(
    configuration: Configuration, n: int, noise: float = 1.0, seed: int = 0, setting: Setting = DEFAULT
) -> Correspondences:
    """Matches between the images of two sheets.

    The source points are uniform over the part of the sheet's image that is inside both images. The result depends on
    the arguments alone, not on earlier calls; sheets and cameras do not depend on the number of points.

    Parameters
    ----------
    configuration : Configuration
        The sheets and the view.
    n : int
        Number of matches, at least 1.
    noise : float, default 1
        Standard deviation in pixels of every coordinate of every image point in both images.
    seed : int, default 0
        Seed of the sheets, the views, the points and the noise.
    setting : Setting, optional
        How the sheets bend, and how the cameras see them.

    Returns
    -------
    Correspondences
        The matches, and dense points without noise.

    Raises
    ------
    ValueError, TypeError
        If an argument is invalid.

    Examples
    --------
    >>> from mexpress import simulation
    >>> simulation.correspondences(simulation.Configuration(3, 7, 0), 150)
    Correspondences(150 matches, ... dense points)
    """
    if not isinstance(configuration, Configuration):
        check.refuse("configuration", "It must be a Configuration.", check.describe(configuration), TypeError)
    n, seed = check.count(n, "n", 1), check.count(seed, "seed", 0)
    noise = check.number(noise, "noise", "It must be a number of at least 0.", 0.0)
    where = (configuration.source, configuration.target, configuration.view)
    return match(views(configuration, seed, checked_setting(setting)), n, noise, stream(seed, 2, *where, n))


@lru_cache(maxsize=8)
def views(configuration: Configuration, seed: int, setting: Setting = DEFAULT) -> Views:
    """Both sheets with their cameras, cached for problems of several sizes."""
    rng = stream(seed, 1, configuration.source, configuration.target, configuration.view)
    focal = float(rng.uniform(*FOCAL))
    every = sheets(seed, setting)
    source, target = (
        (sheet, random_camera(sheet, focal, rng, fill=setting.fill, tilt=setting.tilt))
        for sheet in (every[configuration.source], every[configuration.target])
    )
    return source, target


def stream(seed: int, *place: int) -> np.random.Generator:
    """Random generator for one place in a simulation."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=place))


def match(
    pair: Views, n: int, noise: float, rng: np.random.Generator, contour: Floats | None = None
) -> Correspondences:
    """Images of n random points inside both views, of a grid of such points, and of a curve on the sheet (c, 2)."""
    points, sheet = scatter(pair, n, rng), pair[0][0]
    source, target = images(pair, points) + (rng.normal(0.0, noise, (2, n, 2)) if noise else 0.0)
    grid = sheet.grid(*DENSE)
    dense_source, dense_target = images(pair, grid[seen(pair, grid)])
    curves = (None, None) if contour is None else images(pair, contour)
    return Correspondences(source, target, dense_source, dense_target, *curves)


def images(pair: Views, points: Floats) -> Floats:
    """Images in both views of points on the sheet (k, 2), (2, k, 2)."""
    return np.stack([camera(sheet(points)) for sheet, camera in pair])


def seen(pair: Views, points: Floats) -> NDArray[np.bool_]:
    """Whether points on the sheet (k, 2) are inside both views, (k,)."""
    first, second = images(pair, points)
    return in_frame(first) & in_frame(second)


def scatter(pair: Views, n: int, rng: np.random.Generator) -> Floats:
    """Points on the sheet inside both views, (n, 2), whose first images are uniform over the sheet's image."""
    sheet, camera = pair[0]
    most = 1.1 * camera.enlargement(*sheet.samples).max()
    places = np.zeros((0, 2))
    while len(places) < n:
        points = rng.uniform(-0.5, 0.5, (4 * n, 2)) * (sheet.width, sheet.height)
        size = camera.enlargement(sheet(points), sheet.normals(points))
        drawn = size > most * rng.uniform(size=len(points))
        places = np.concatenate([places, points[drawn & seen(pair, points)]])
    return places[:n]
