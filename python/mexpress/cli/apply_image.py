"""`mexpress apply` to an image: the image itself is moved, as its points would be."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence

import numpy as np

from mexpress.cli import common
from mexpress.io.image_writing import IMAGES, is_writable, write_image
from mexpress.io.images import read_raster
from mexpress.models.base import Model
from mexpress.models.warp import Warp


def apply_image(model: Model, arguments: argparse.Namespace) -> None:
    """Write the image that is moved by a warp, and say how much of it comes from nowhere."""
    if not isinstance(model, Warp):
        raise common.UsageError("an image is moved by a warp, and MODEL is none")
    if arguments.out is None or not is_writable(arguments.out):
        raise common.UsageError(
            f"--out must be given for an image, and end in one of {' '.join(sorted(IMAGES))}"
        )
    if arguments.columns is not None or arguments.missing is not None:
        raise common.UsageError("--columns and --missing belong to points, and POINTS is an image")
    raster = read_raster(arguments.points, "image")
    image = raster.upright()
    marked = np.dstack([image, np.ones(image.shape[:2], image.dtype)])  # 0 where the result is filled
    moved = model.remap(marked, arguments.size, inverse=arguments.inverse)
    found = moved[..., -1] != 0
    pixels = moved[..., :-1].reshape(*found.shape, *image.shape[2:])
    write_image(arguments.out, pixels, "--out", raster.white)
    if not found.all():
        elsewhere = (
            ""
            if found.any()
            else _place(model, (found if arguments.inverse else image).shape, arguments.inverse)
        )
        lost = found.size - np.count_nonzero(found)
        common.warn(f"{lost} of {found.size} pixels come from nowhere in the image, and are 0{elsewhere}")


def _place(warp: Warp, shape: Sequence[int], inverse: bool) -> str:
    """Say what the warp makes of the corners and the middle of its source image, height times width pixels.

    That is the result if the target image is moved: Newton's method, the other way, does not go so far.
    """
    x = np.array([0, 1, 0, 1, 0.5]) * (shape[1] - 1)
    y = np.array([0, 0, 1, 1, 0.5]) * (shape[0] - 1)
    places = warp(np.column_stack([x, y]))
    places = places[np.isfinite(places).all(axis=1)]
    if not len(places):
        return ""
    (left, top), (right, bottom) = places.min(axis=0), places.max(axis=0)
    what = "they would be at" if inverse else "it is moved to"
    return f": {what} x {left:.8g} to {right:.8g}, y {top:.8g} to {bottom:.8g}"


def whole_size(text: str) -> tuple[int, int]:
    """Return the width and the height that an option says.

    Examples
    --------
    >>> whole_size("640x480")
    (640, 480)
    """
    sizes = re.fullmatch(r"([1-9][0-9]{0,5})x([1-9][0-9]{0,5})", text.strip().lower())
    if sizes is None:
        raise argparse.ArgumentTypeError(f"must be WIDTHxHEIGHT in pixels, such as 1920x1080, not {text!r}")
    return int(sizes[1]), int(sizes[2])
