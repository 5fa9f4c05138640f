"""Cameras that see a whole sheet from random directions."""

from __future__ import annotations

import numpy as np

from mexpress._validation import Floats
from mexpress.simulation.cameras import Camera, facing, look
from mexpress.simulation.developable import Sheet
from mexpress.simulation.settings import DEFAULT

ROLL = 0.1
"""Largest rotation of the sheet in the image, in radians."""

GRAZING = 0.2
"""Smallest cosine between the sheet's normals and the viewing rays."""

DRAWS = 100
"""Number of random poses to try, each nearer to the frontal pose."""


def visible(sheet: Sheet, camera: Camera) -> bool:
    """Whether no part of the sheet hides another, and the camera sees it nowhere at a grazing angle.

    A map that is one-to-one near every point of a disk, and on its border, is one-to-one.
    """
    return facing(*sheet.samples, camera) > GRAZING and is_simple(camera(sheet(sheet.border())))


def is_simple(polygon: Floats) -> bool:
    """Whether the sides of a closed polygon (k, 2) do not cross."""
    start, along = polygon, np.roll(polygon, -1, axis=0) - polygon

    def side(points: Floats) -> Floats:
        """Sides of points (columns) relative to lines (rows)."""
        offset = points[None] - start[:, None]
        return np.sign(along[:, None, 0] * offset[..., 1] - along[:, None, 1] * offset[..., 0])

    starts, ends = side(start), side(start + along)
    apart = starts * ends
    crossing = (apart < 0) & (apart.T < 0)
    return not bool(crossing.any())


def random_camera(
    sheet: Sheet,
    focal: float,
    rng: np.random.Generator,
    affine: bool = False,
    fill: float = 1.0,
    tilt: tuple[float, float] = DEFAULT.tilt,
) -> Camera:
    """A camera that sees a sheet completely from a random direction; from the front if no such direction is found."""
    for share in np.sqrt(np.linspace(1, 0, DRAWS)):
        camera = look(sheet.samples[0], _random_rotation(rng, share, tilt), focal, affine, fill)
        if visible(sheet, camera):
            break
    return camera


def _random_rotation(rng: np.random.Generator, share: float, limits: tuple[float, float]) -> Floats:
    """A tilt about a random axis in the image after a roll, both scaled by a share of their limits."""
    tilt = np.arccos(rng.uniform(*np.cos(share * np.array(limits))))
    roll, axis = share * rng.uniform(-ROLL, ROLL), rng.uniform(0, 2 * np.pi)
    turned = _about_z(axis)
    cosine, sine = np.cos(tilt), np.sin(tilt)
    about_x = np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
    return np.asarray(turned @ about_x @ turned.T @ _about_z(roll))


def _about_z(angle: float) -> Floats:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
