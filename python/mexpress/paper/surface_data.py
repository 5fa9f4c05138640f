"""What the surface experiments are about: a reader's depth map or embedding, or a simulated one.

Examples
--------
>>> simulated_depth(2000, seed=0)
Subject(simulated depth map, 2000 data, depth, truth known)
>>> simulated_embedding(500, seed=0)
Subject(simulated bent sheet, 500 data, values in R^3, truth known)
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.io.clouds import read_cloud
from mexpress.simulation import Sheet

_PIXELS = (160, 120)
"""Width and height of the simulated depth map."""

_HOLES, _HOLE = 6, (0.03, 0.06)
"""Discs without a measurement, and their least and largest radius as a fraction of the image's diagonal."""

_DEPTH_NOISE = 0.0015
"""Standard deviation per squared metre of depth, in metres: that of structured light."""

_BEND, _WAVES, _RULINGS = 2.0, 3, 60
"""How far the sheet's normal swings in radians, in how many waves, and about how many rulings."""

_SHEET_NOISE = 0.004
"""Standard deviation of the sheet's points in each direction; the sheet is 1.6 wide."""


@dataclass(frozen=True, eq=False, repr=False)
class Subject:
    """Data that surfaces are fitted to, and the truth if it is known.

    Parameters
    ----------
    name : str
        What a report calls it.
    points : (n, 2) array
        Pixels, or positions on a flat sheet.
    values : (n,) or (n, d) array
        Depths, or positions in space.
    image_size : tuple of float or None
        (width, height) in pixels, if the points are pixels.
    unit : str or None
        Of the values.
    true_points : (k, 2) array
        Where the truth is known; k is 0 if it is nowhere.
    true_values : (k,) or (k, d) array
        The truth, without noise.
    """

    name: str
    points: Floats
    values: Floats
    image_size: tuple[float, float] | None
    unit: str | None
    true_points: Floats
    true_values: Floats

    def __repr__(self) -> str:
        kind = "depth" if self.dimension == 1 else f"values in R^{self.dimension}"
        truth = ", truth known" if len(self.true_points) else ""
        return f"Subject({self.name}, {len(self.points)} data, {kind}{truth})"

    @property
    def dimension(self) -> int:
        """How many numbers a value has.

        Examples
        --------
        >>> simulated_embedding(500, seed=0).dimension
        3
        """
        return 1 if self.values.ndim == 1 else self.values.shape[1]


def read_subject(path: Path, most: int, seed: int) -> Subject:
    """Read a depth map or an embedding, as `mexpress.io.clouds.read_cloud` tells them apart.

    Parameters
    ----------
    path : Path
        The file.
    most : int
        Of more data, so many are drawn.
    seed : int
        Of the draw.

    Returns
    -------
    Subject
        Without a truth.

    Raises
    ------
    ValueError, OSError, ImportError
        As `mexpress.io.clouds.read_cloud` does.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.save(f"{folder}/depth.npy", np.ones((6, 8)))
    ...     read_subject(Path(folder, "depth.npy"), 40, seed=0)
    Subject(depth.npy, 40 data, depth)
    """
    cloud = read_cloud(path, max_data=most, seed=seed)
    return Subject(
        path.name,
        cloud.points,
        cloud.values,
        cloud.image_size,
        cloud.unit,
        np.zeros((0, 2)),
        cloud.values[:0],
    )


def simulated_depth(number: int, seed: int) -> Subject:
    """Simulate a depth map: folds and bumps before a slanted wall, with noise that grows with depth, and holes.

    Parameters
    ----------
    number : int
        Data that are drawn from its pixels, at most 10,000.
    seed : int
        Of everything random.

    Returns
    -------
    Subject
        The truth is known at every pixel, in the holes too.
    """
    number = check.count(number, "number", 4)
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(7,)))
    row, column = np.divmod(np.arange(_PIXELS[0] * _PIXELS[1]), _PIXELS[0])
    pixels = np.column_stack([column, row]).astype(np.float64)
    depth = _scene(pixels, random)
    seen = np.flatnonzero(~_in_holes(pixels, random))
    drawn = np.sort(random.choice(seen, min(number, len(seen)), replace=False))
    noisy = depth[drawn] + _DEPTH_NOISE * depth[drawn] ** 2 * random.normal(size=len(drawn))
    size = (float(_PIXELS[0]), float(_PIXELS[1]))
    return Subject("simulated depth map", pixels[drawn], noisy, size, "m", pixels, depth)


def _scene(pixels: Floats, random: np.random.Generator) -> Floats:
    """Depths in metres."""
    x, y = (pixels / _PIXELS[0]).T
    depth = 2.4 + 0.3 * x - 0.2 * y + 0.05 * np.sin(18 * x + 3 * y) * np.exp(-(((x - 0.7) / 0.2) ** 2))
    for _ in range(8):
        place, width = random.uniform(0, 1, 2) * (1, 0.75), random.uniform(0.06, 0.16)
        height = random.choice([-1, 1]) * random.uniform(0.5, 1.5) * width
        depth += height * np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / (2 * width**2))
    return np.asarray(depth)


def _in_holes(pixels: Floats, random: np.random.Generator) -> NDArray[np.bool_]:
    diagonal = float(np.hypot(*_PIXELS))
    places = random.uniform(0.1, 0.9, (_HOLES, 2)) * _PIXELS
    radii = diagonal * random.uniform(*_HOLE, _HOLES)
    apart = np.linalg.norm(pixels[:, None] - places, axis=2)
    return np.asarray((apart < radii).any(axis=1))


def simulated_embedding(number: int, seed: int) -> Subject:
    """Simulate a bent sheet of paper: positions on it when flat, and in space with noise.

    Parameters
    ----------
    number : int
        Data, at random places of the sheet.
    seed : int
        Of the noise, the places and the sheet.

    Returns
    -------
    Subject
        The truth is known on a regular grid.
    """
    number = check.count(number, "number", 4)
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(9,)))
    sheet = _sheet(random)
    where = random.uniform(-0.5, 0.5, (number, 2)) * (sheet.width, sheet.height)
    grid = sheet.grid()
    noisy = sheet(where) + _SHEET_NOISE * random.normal(size=(number, 3))
    return Subject("simulated bent sheet", where, noisy, None, None, grid, sheet(grid))


def _sheet(random: np.random.Generator) -> Sheet:
    """Return a sheet that bends slowly, as paper on a desk does, about parallel rulings."""
    turn, *phases = random.uniform(0, 2 * np.pi, 1 + _WAVES)
    across = np.linspace(-1, 1, _RULINGS)
    time = np.linspace(0, 1, _RULINGS + 1)
    waves = [np.cos(np.pi * (k + 1) * time + phase) / (k + 1) for k, phase in enumerate(phases)]
    normal = np.sum(waves, axis=0)
    return Sheet(across, across, np.diff(normal) * _BEND / np.ptp(normal), turn)
