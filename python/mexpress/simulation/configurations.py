"""The paper's 450 simulated image pairs (section 4.4.2): which sheets, from where, and the points matched.

See `correspondences`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.simulation.cameras import FOCAL, IMAGE_SIZE, Camera, random_camera
from mexpress.simulation.sheets import COUNT, Sheet, sheets

__all__ = ["Configuration", "Correspondences", "configurations", "correspondences"]

VIEWS = 5
"""Poses and focal lengths for each pair of sheets."""


@dataclass(frozen=True)
class Configuration:
    """Which two sheets are matched, and which of their views.

    Parameters
    ----------
    source, target : int
        Indices of two sheets from 0 to 9.
    view : int
        Which of the pair's poses and focal lengths, from 0 to 4.

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
        Images without noise of a regular grid all over the sheet, row after row, in pixels.
    contour_source, contour_target : (c, 2) array, optional
        Images without noise of a smooth closed curve on the sheet, in pixels.
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
    """All pairs of different sheets, either one first, with five views each: 450, always in the same order.

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
    configuration: Configuration, n: int, noise: float = 1.0, seed: int = 0
) -> Correspondences:
    """Matches between the images of two sheets.

    The points' images are uniform over the sheet's in the source image. What is random depends on the arguments
    alone, not on what was made before; the sheets and cameras do not depend on the number of points.

    Parameters
    ----------
    configuration : Configuration
        Which sheets and views.
    n : int
        Number of matches, at least 1.
    noise : float, default 1
        Standard deviation in pixels of every coordinate of every image point in both images.
    seed : int, default 0
        Of the sheets, the views, the points and the noise.

    Returns
    -------
    Correspondences

    Raises
    ------
    ValueError, TypeError
        If an argument is not as above.

    Examples
    --------
    >>> from mexpress import simulation
    >>> simulation.correspondences(simulation.Configuration(3, 7, 0), 150)
    Correspondences(150 matches, 2040 dense points)
    """
    if not isinstance(configuration, Configuration):
        check.refuse("configuration", "It must be a Configuration.", check.describe(configuration), TypeError)
    n, seed = check.count(n, "n", 1), check.count(seed, "seed", 0)
    noise = check.number(noise, "noise", "It must be a number of at least 0.", 0.0)
    where = (configuration.source, configuration.target, configuration.view)
    rng = stream(seed, 1, *where)
    focal = float(rng.uniform(*FOCAL))
    pair = [sheets(seed)[index] for index in where[:2]]
    views = [(sheet, random_camera(sheet, focal, rng)) for sheet in pair]
    return match(views, n, noise, stream(seed, 2, *where, n))


def stream(seed: int, *place: int) -> np.random.Generator:
    """Random numbers that belong to one place of a simulation alone."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=place))


def match(
    views: list[tuple[Sheet, Camera]],
    n: int,
    noise: float,
    rng: np.random.Generator,
    contour: Floats | None = None,
) -> Correspondences:
    """Images in two views of n random points on a sheet, of its grid, and of a curve on it (c, 2) if there is one."""
    sheet = views[0][0]
    points = scatter(*views[0], n, rng)
    source, target = (
        camera(bent(points)) + rng.normal(0.0, noise, (n, 2)) if noise else camera(bent(points))
        for bent, camera in views
    )
    dense_source, dense_target = (camera(bent(sheet.grid())) for bent, camera in views)
    contours = [None if contour is None else camera(bent(contour)) for bent, camera in views]
    return Correspondences(source, target, dense_source, dense_target, contours[0], contours[1])


def scatter(sheet: Sheet, camera: Camera, n: int, rng: np.random.Generator) -> Floats:
    """Points on a sheet whose images are uniform over the sheet's, (n, 2)."""
    most = 1.1 * camera.enlargement(*sheet.samples).max()
    found = np.zeros((0, 2))
    while len(found) < n:
        points = rng.uniform(-0.5, 0.5, (2 * n, 2)) * (sheet.width, sheet.height)
        size = camera.enlargement(sheet(points), sheet.normals(points))
        found = np.concatenate([found, points[size > most * rng.uniform(size=2 * n)]])
    return found[:n]
