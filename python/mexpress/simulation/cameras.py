"""Pinhole cameras, and the nearest camera with all points of a surface in view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress._validation import Floats

IMAGE_SIZE = (1920.0, 1080.0)
"""Width and height in pixels."""

SENSOR = 35.0
"""Width of the sensor in millimetres."""

FOCAL = (20.0, 50.0)
"""Focal lengths in millimetres."""


@dataclass(frozen=True, eq=False, repr=False)
class Camera:
    """A pinhole camera of 1920 x 1080 pixels, with its principal point in the middle.

    Parameters
    ----------
    focal : float
        Focal length in millimetres, with a sensor 35 mm wide.
    rotation : array_like, (3, 3)
    translation : array_like, (3,)
        A point X of space has the camera coordinates rotation X + translation: x right, y down, z ahead.
    affine : bool, default False
        Whether all points are projected with the depth of the origin of space (weak perspective).

    Raises
    ------
    ValueError, TypeError
        If a shape is wrong, `rotation` is not a rotation, or the origin of space is not ahead.

    Examples
    --------
    >>> from mexpress.simulation import Camera
    >>> camera = Camera(35.0, np.eye(3), [0.0, 0.0, 2.0])
    >>> camera([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]])
    array([[ 960.,  540.], [1440.,  540.]])
    """

    focal: float
    rotation: Floats
    translation: Floats
    affine: bool = False

    def __post_init__(self) -> None:
        rotation = check.matrix(self.rotation, "rotation").copy()
        if rotation.shape != (3, 3) or not is_rotation(rotation):
            check.refuse("rotation", "It must be a rotation, (3, 3).", check.describe(self.rotation))
        translation = check.columns(self.translation, "translation", 3).copy()
        if translation.shape != (3,) or translation[2] <= 0:
            rule = "It must be three numbers, the last one above 0."
            check.refuse("translation", rule, check.describe(self.translation))
        for name, array in (("rotation", rotation), ("translation", translation)):
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        object.__setattr__(self, "focal", check.positive(self.focal, "focal"))
        check.flag(self.affine, "affine")

    def __repr__(self) -> str:
        kind = "weak perspective, " if self.affine else ""
        return f"Camera({kind}{self.focal:.3g} mm, {self.translation[2]:.3g} away)"

    def __call__(self, points: ArrayLike) -> Floats:
        """Project points to the image.

        Parameters
        ----------
        points : array_like, (k, 3)
            Points ahead of the camera.

        Returns
        -------
        ndarray, (k, 2)
            Positions in pixels, x right and y down from the corner of the image.

        Raises
        ------
        ValueError, TypeError
            If a point is not ahead of the camera.
        """
        seen = check.points(points, "points", 3) @ self.rotation.T + self.translation
        depth = np.broadcast_to(self.translation[2:] if self.affine else seen[:, 2:], (len(seen), 1))
        if (depth <= 0).any():
            check.refuse("points", "They must be ahead of the camera.", f"a depth of {depth.min():g}")
        return np.asarray(pixels(self.focal) * seen[:, :2] / depth + 0.5 * np.array(IMAGE_SIZE))

    def enlargement(self, points: Floats, normals: Floats) -> Floats:
        """Square pixels per unit of area of a surface at points (k, 3) with normals (k, 3), (k,)."""
        if self.affine:
            return np.asarray((pixels(self.focal) / self.translation[2]) ** 2 * (normals @ self.rotation[2]))
        seen = points @ self.rotation.T + self.translation
        towards = ((normals @ self.rotation.T) * seen).sum(axis=1)
        return np.asarray(pixels(self.focal) ** 2 * towards / seen[:, 2] ** 3)

    def rays(self, points: Floats) -> Floats:
        """Unit directions in space from the camera to points (k, 3), (k, 3)."""
        if self.affine:
            return np.broadcast_to(self.rotation[2], points.shape)
        seen = points + self.rotation.T @ self.translation
        return np.asarray(seen / np.linalg.norm(seen, axis=1, keepdims=True))


def is_rotation(matrix: Floats) -> bool:
    """Whether a matrix (3, 3) is a rotation."""
    return bool(np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-6) and np.linalg.det(matrix) > 0)


def pixels(focal: float) -> float:
    """Focal length in pixels of a focal length in millimetres."""
    return focal * IMAGE_SIZE[0] / SENSOR


def look(points: Floats, rotation: Floats, focal: float, affine: bool = False, fill: float = 1.0) -> Camera:
    """The nearest camera of a direction with all points (k, 3) in view, centred; then nearer by the factor `fill`."""
    seen = points @ rotation.T
    depth = np.zeros(len(seen)) if affine else seen[:, 2]
    centres, distances = [], []
    for axis in range(2):
        # x + t <= slope (z + d) and -(x + t) <= slope (z + d) for all points.
        slope = IMAGE_SIZE[axis] / 2 / pixels(focal)
        high = (seen[:, axis] - slope * depth).max()
        low = (-seen[:, axis] - slope * depth).max()
        centres.append((low - high) / 2)
        distances.append((low + high) / 2 / slope)
    return Camera(focal, rotation, np.array([*centres, max(distances) / fill]), affine)


def facing(points: Floats, normals: Floats, camera: Camera) -> float:
    """Smallest cosine between normals and viewing rays; -1 if a point is not ahead of the camera."""
    if not camera.affine and (points @ camera.rotation[2] + camera.translation[2]).min() <= 0:
        return -1.0
    return float((normals * camera.rays(points)).sum(axis=1).min())


def in_frame(images: Floats) -> NDArray[np.bool_]:
    """Whether points (k, 2) are inside the image, (k,)."""
    return np.asarray(((images >= 0) & (images <= IMAGE_SIZE)).all(axis=1))
