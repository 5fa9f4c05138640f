"""A photo of the page, which lies bent on a table."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from mexpress._validation import Floats
from mexpress.datasets.printing import PAGE, Image, printed
from mexpress.resampling import resampled
from mexpress.simulation.cameras import IMAGE_SIZE, Camera, look, pixels
from mexpress.simulation.developable import Sheet

PHOTO = (1280, 720)
"""Width and height of the photo in pixels."""

WIDTH, HEIGHT = 1.414, 1.0
"""Size of the page in space."""

FOCAL, TILT, ROLL = 30.0, (0.45, -0.25), -0.12
"""Focal length in millimetres; the camera looks down and from the side by these angles in radians, and is rolled."""

TURN = 0.35
"""Angle in radians from the edges of the page to the rulings along which it bends."""

LIGHT = np.array([0.55, 0.25, 0.8])
"""Direction of the light in space, towards the back of the page."""

TABLE = (92, 74, 60)

STEP = 8
"""Positions on the page are computed for every so many pixels of the photo, and are linear between them."""


@lru_cache(maxsize=1)
def bent() -> tuple[Sheet, Camera]:
    """Return the bent page and the camera."""
    half = (np.cos(TURN) * WIDTH + np.sin(TURN) * HEIGHT) / 2
    ends = np.linspace(-half, half, 200)
    along = ends / half
    slope = 0.62 * np.sin(2.6 * along + 0.5) + 0.3 * np.sin(6.0 * along + 1.0)
    sheet = Sheet(ends[1:], ends[1:], np.diff(slope), TURN, WIDTH, HEIGHT)
    return sheet, look(sheet.samples[0], turned(*TILT, ROLL), FOCAL, fill=0.95)


def turned(down: float, aside: float, roll: float) -> Floats:
    """Return the rotation (3, 3) of a camera about its x axis, its y axis and its z axis, the last one first."""
    matrix = np.eye(3)
    for axis, angle in ((2, roll), (1, aside), (0, down)):
        first, second = (k for k in range(3) if k != axis)
        plane = np.eye(3)
        plane[[first, second], [first, second]] = np.cos(angle)
        plane[first, second], plane[second, first] = -np.sin(angle), np.sin(angle)
        matrix = plane @ matrix
    return matrix


def photographed(points: Floats) -> Floats:
    """Return where points of the page (k, 2) are in the photo, (k, 2), in pixels; the first one's centre is (0, 0)."""
    sheet, camera = bent()
    return (camera(sheet(on_sheet(points))) - 0.5 * np.array(IMAGE_SIZE)) * scale() + centre()


def on_sheet(points: Floats) -> Floats:
    """Return positions on the sheet of pixels of the page, (k, 2)."""
    return ((points + 0.5) / PAGE - 0.5) * (WIDTH, HEIGHT)


def scale() -> float:
    """Return how many pixels of the photo a pixel of the camera is."""
    return PHOTO[0] / IMAGE_SIZE[0]


def centre() -> Floats:
    """Return the middle of the photo; the centre of its first pixel is (0, 0)."""
    return np.array(PHOTO) / 2 - 0.5


def seen(points: Floats) -> tuple[Floats, Floats]:
    """Return what is seen at points of the photo (k, 2): pixels of the page (k, 2), and normals there (k, 3).

    A sheet consists of flat strips, and a flat strip is seen by a homography. Which strip is seen is found by going
    from strip to strip: where a strip, prolonged, is met, another one may be.
    """
    sheet, camera = bent()
    rotations, offsets = sheet.motions
    flat = np.concatenate([rotations[:, :, :2], offsets[:, :, None]], axis=2)
    flat = camera.rotation @ flat
    flat[:, :, 2] += camera.translation
    back = np.linalg.inv(flat)
    rays = np.column_stack([(points - centre()) / (pixels(camera.focal) * scale()), np.ones(len(points))])
    strips = np.full(len(points), len(back) // 2)
    for _ in range(8):
        met = np.einsum("kij,kj->ki", back[strips], rays)
        where = met[:, :2] / met[:, 2:]
        strips = sheet.strips(where)
    return (where / (WIDTH, HEIGHT) + 0.5) * PAGE - 0.5, rotations[strips][:, :, 2]


@lru_cache(maxsize=1)
def photo() -> Image:
    """Return the photo, (720, 1280, 3), red, green and blue; it is made once, and cannot be written to.

    Examples
    --------
    >>> photo().shape
    (720, 1280, 3)
    """
    wide, high = PHOTO
    y, x = np.mgrid[: high + STEP : STEP, : wide + STEP : STEP]
    places, normals = seen(np.column_stack([x.ravel(), y.ravel()]).astype(float))
    coarse = np.column_stack([places, shade(normals)]).reshape(*x.shape, 3).astype(np.float32)
    fine = resampled(coarse, np.mgrid[:high, :wide][::-1] / STEP, 0.0)
    page = resampled(printed(), np.moveaxis(fine[..., :2], -1, 0), 0)
    inside = cover(fine[..., :2])
    table = (1 - 0.55 * shadow(inside))[..., None] * np.array(TABLE, np.float32)
    lit = table + inside[..., None] * (page * fine[..., 2:] - table)
    lit *= vignette()[..., None]
    lit += 2 * np.random.default_rng(0).standard_normal((high, wide, 1), np.float32)
    image: Image = np.rint(lit.clip(0, 255)).astype(np.uint8)
    image.flags.writeable = False
    return image


def shade(normals: Floats) -> Floats:
    """Return the share of the light that is reflected at normals (k, 3), (k,)."""
    return np.asarray(0.35 + 0.65 * (normals @ (LIGHT / np.linalg.norm(LIGHT))).clip(0))


def cover(places: Floats) -> Floats:
    """Return the share of every pixel that the page covers, from the pixels of the page that are seen (h, w, 2)."""
    x, y = np.moveaxis(places, -1, 0)
    inside = np.minimum(np.minimum(x, PAGE[0] - 1 - x), np.minimum(y, PAGE[1] - 1 - y))
    return np.asarray((inside + 1).clip(0, 1))


def shadow(inside: Floats, reach: int = 24) -> Floats:
    """Return the share of the light that the page takes from the table, (h, w)."""
    dark = np.roll(inside, (reach // 2, reach // 2), axis=(0, 1))
    for axis in (0, 1, 0, 1):
        sums = np.cumsum(
            np.pad(dark, [(reach, reach) if k == axis else (0, 0) for k in (0, 1)], mode="edge"), axis
        )
        size = dark.shape[axis]
        high, low = (np.take(sums, range(k, k + size), axis) for k in (reach + reach // 2, reach // 2))
        dark = (high - low) / reach
    return dark


def vignette() -> Floats:
    """Return the light of every pixel of the photo: less towards the corners."""
    x, y = (((np.arange(size) - size / 2) / PHOTO[0]) ** 2 for size in PHOTO)
    return (1 - 0.6 * (x + y[:, None])).astype(np.float32)
