"""`mexpress apply` to an image: the image itself is moved, as its points would be."""

from __future__ import annotations

import argparse
import re

import numpy as np

from mexpress.cli import common
from mexpress.io.image_writing import IMAGES, is_writable, write_image
from mexpress.io.images import read_image
from mexpress.models.base import Model
from mexpress.models.warp import Warp
from mexpress.resampling import resampled


def apply_image(model: Model, arguments: argparse.Namespace) -> None:
    """Write the image that is moved by a warp, and say how much of it comes from nowhere."""
    if not isinstance(model, Warp):
        raise common.UsageError("an image is moved by a warp, and MODEL is none")
    if arguments.out is None or not is_writable(arguments.out):
        raise common.UsageError(
            f"--out must be given for an image, and end in one of {' '.join(sorted(IMAGES))}"
        )
    image = read_image(arguments.points)
    width, height = arguments.size or image.shape[1::-1]
    positions = (model.dense_map if arguments.inverse else model.inverse_map)(width, height)
    write_image(arguments.out, resampled(image, positions, 0), "--out")
    lost = np.count_nonzero(np.isnan(positions[0]))
    if lost:
        what = "image" if arguments.inverse else "origin"
        common.warn(f"{lost} of {width * height} pixels have no {what}, and are 0")


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
