"""Random surfaces over the unit square, and data of them with noise: alone, alike in neighbours, or in clusters."""

from dataclasses import dataclass

import numpy as np

WAVES = 200
LENGTHS = (0.15, 0.5)
"""Correlation lengths of the surfaces; their standard deviation is about one."""

NUMBERS, CLUSTERED = (400, 1000), (80, 200)
"""How many data there are, spread over the square, and in clusters."""

NOISE = (0.1, 0.4)
REACH = (1.0, 2.0)
"""Correlation lengths of the noise that neighbours share, in typical distances of a datum to the next."""

CLUSTERS, WIDTH = 12, 0.04
SIDE = 60
"""The truth is known on a grid of so many points a side."""


@dataclass(frozen=True)
class Sample:
    """Data, and the truth on a grid."""

    points: np.ndarray
    values: np.ndarray
    grid: np.ndarray
    truth: np.ndarray


def random_surface(random, length):
    """Return a function of points: waves in all directions, their frequencies those of a Gaussian correlation."""
    frequencies, phases = random.normal(size=(WAVES, 2)) / length, random.uniform(0, 2 * np.pi, WAVES)
    return lambda points: np.cos(points @ frequencies.T + phases).sum(axis=1) * np.sqrt(2 / WAVES)


def log_uniform(random, low, high):
    """Draw a number whose logarithm is uniform."""
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def shared_noise(points, length, random):
    """Draw noise of standard deviation one that is alike in points nearer than a length."""
    squared = ((points[:, None] - points) ** 2).sum(axis=2)
    spectrum, basis = np.linalg.eigh(np.exp(-squared / (2 * length**2)))
    return basis @ (np.sqrt(spectrum.clip(0)) * random.normal(size=len(points)))


def sample(kind, draw):
    """Draw a surface and data of it; a surface is the same for all kinds.

    Parameters
    ----------
    kind : {"independent", "correlated", "clustered"}
        Noise that every datum has of its own, or that neighbours share; or few data in clusters, with the former.
    draw : int
        Of everything random.
    """
    random = np.random.default_rng(draw)
    surface = random_surface(random, log_uniform(random, *LENGTHS))
    level, reach = log_uniform(random, *NOISE), log_uniform(random, *REACH)
    number = round(log_uniform(random, *(CLUSTERED if kind == "clustered" else NUMBERS)))
    points = random.uniform(0, 1, (number, 2))
    if kind == "clustered":
        centres = random.uniform(0, 1, (CLUSTERS, 2))
        around = centres[random.integers(CLUSTERS, size=number)] + WIDTH * random.normal(size=(number, 2))
        points = around.clip(0, 1)
    if kind == "correlated":
        noise = shared_noise(points, reach / np.sqrt(number), random)
    else:
        noise = random.normal(size=number)
    side = (np.arange(SIDE) + 0.5) / SIDE
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    return Sample(points, surface(points) + level * noise, grid, surface(grid))
