"""Cameras that see a whole sheet from random directions."""

from __future__ import annotations

import numpy as np

from mexpress._validation import Floats
from mexpress.simulation.cameras import Camera, facing, look
from mexpress.simulation.developable import Sheet

TILT = (0.8, 0.3)
"""Largest and least angle in radians between the optical axis and the sheet's mean normal."""

ROLL = 0.1
"""Largest angle in radians by which the sheet is turned in the image."""

GRAZING = 0.2
"""Least cosine between the sheet's normals and the rays that see it."""

DRAWS = 100
"""Random poses that are tried, ever nearer to the frontal one."""


def visible(sheet: Sheet, camera: Camera) -> bool:
    """Whether nothing hides any part of the sheet, and the camera sees it nowhere grazing.

    A map that is one-to-one near every point of a disk, and on the disk's border, is one-to-one.
    """
    return facing(*sheet.samples, camera) > GRAZING and is_simple(camera(sheet(sheet.border())))


def is_simple(polygon: Floats) -> bool:
    """Whether the sides of a closed polygon (k, 2) meet nowhere but at their common ends."""
    start, along = polygon, np.roll(polygon, -1, axis=0) - polygon

    def side(points: Floats) -> Floats:
        """On which side of every line (rows) points (columns) are."""
        offset = points[None] - start[:, None]
        return np.sign(along[:, None, 0] * offset[..., 1] - along[:, None, 1] * offset[..., 0])

    starts, ends = side(start), side(start + along)
    apart = starts * ends
    crossing = (apart < 0) & (apart.T < 0)
    return not bool(crossing.any())


def random_camera(
    sheet: Sheet, focal: float, rng: np.random.Generator, affine: bool = False, fill: float = 1.0
) -> Camera:
    """A camera that sees a sheet, nowhere hidden, from a random direction; from the front, if it has to be."""
    for share in np.sqrt(np.linspace(1, 0, DRAWS)):
        camera = look(sheet.samples[0], _random_rotation(rng, share), focal, affine, fill)
        if visible(sheet, camera):
            break
    return camera


def _random_rotation(rng: np.random.Generator, share: float) -> Floats:
    """Tilt about any axis in the image, after a roll; both a share of what they may be."""
    tilt = np.arccos(rng.uniform(*np.cos(share * np.array(TILT))))
    roll, axis = share * rng.uniform(-ROLL, ROLL), rng.uniform(0, 2 * np.pi)
    turned = _about_z(axis)
    cosine, sine = np.cos(tilt), np.sin(tilt)
    about_x = np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
    return np.asarray(turned @ about_x @ turned.T @ _about_z(roll))


def _about_z(angle: float) -> Floats:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
