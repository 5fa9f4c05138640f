"""Heights of a hilly piece of land."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mexpress import _validation as check
from mexpress._validation import Floats

SIDE, SPACING = 129, 10.0
"""Number of places along either side of the square, and metres between them."""

ROUGHNESS = 2.6
"""Amplitudes of waves fall with this power of their number on the square."""

RELIEF = 60.0
"""Standard deviation of the heights in metres."""


@dataclass(frozen=True, eq=False, repr=False)
class Terrain:
    """Measured heights, and the truth on a lattice.

    Parameters
    ----------
    points : (n, 2) array
        Where heights were measured: metres east and north.
    values : (n,) array
        The heights in metres, with noise.
    dense_points : (16641, 2) array
        A lattice, row after row of 129 points.
    dense_values : (16641,) array
        The heights there: the truth.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> land = mx.datasets.terrain(500)
    >>> sel = mx.select_surface(land.points, land.values)
    >>> errors = sel.surface(land.dense_points).ravel() - land.dense_values
    >>> bool(np.sqrt((errors**2).mean()) < 5)
    True
    """

    points: Floats
    values: Floats
    dense_points: Floats
    dense_values: Floats

    def __repr__(self) -> str:
        return f"Terrain({len(self.values)} heights of {SIDE} x {SIDE})"


def terrain(n: int = 2000, noise: float = 1.0, seed: int = 0) -> Terrain:
    """Heights of a simulated piece of hilly land, 1280 m long and wide.

    Waves of all lengths, the short ones low. Heights are measured at points of the lattice, each once.

    Parameters
    ----------
    n : int, default 2000
        Number of measured heights, from 1 to 16641.
    noise : float, default 1
        Standard deviation in metres of a measured height.
    seed : int, default 0
        Seed of the land, of the places, and of the noise.

    Returns
    -------
    Terrain
        The measured heights, and the truth.

    Raises
    ------
    ValueError, TypeError
        If an argument is invalid.

    Examples
    --------
    >>> import mexpress as mx
    >>> land = mx.datasets.terrain(500, noise=0)
    >>> land.points.shape, land.values.shape
    ((500, 2), (500,))
    """
    n, seed = check.count(n, "n", 1, SIDE**2), check.count(seed, "seed", 0)
    noise = check.number(noise, "noise", "It must be a number of at least 0.", 0.0)
    rng = np.random.default_rng(seed)
    heights = relief(rng).ravel()
    north, east = SPACING * np.indices((SIDE, SIDE), dtype=np.float64)
    dense = np.column_stack([east.ravel(), north.ravel()])
    measured = rng.permutation(SIDE**2)[:n]
    return Terrain(dense[measured], heights[measured] + noise * rng.normal(size=n), dense, heights)


def relief(rng: np.random.Generator) -> Floats:
    """Return random heights, (129, 129): white noise, of which long waves are kept.

    The waves are of a square twice as long and wide, so that opposite edges are not alike.
    """
    size = 2 * SIDE
    across, along = np.fft.fftfreq(size) * size, np.fft.rfftfreq(size) * size
    waves = np.fft.rfft2(rng.normal(size=(size, size))) / (1 + np.hypot(across[:, None], along)) ** ROUGHNESS
    heights = np.fft.irfft2(waves, (size, size))[:SIDE, :SIDE]
    return np.asarray(RELIEF * (heights - heights.mean()) / heights.std())
