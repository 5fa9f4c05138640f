"""Images written to files by Pillow, which is an extra.

Examples
--------
>>> import tempfile
>>> with tempfile.TemporaryDirectory() as folder:
...     write_image(Path(f"{folder}/gray.png"), np.full((2, 3), 7, np.uint8))
...     Path(f"{folder}/gray.png").read_bytes()[1:4]
b'PNG'
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress.extras import required
from mexpress.io.archives import replacing
from mexpress.io.netpbm import netpbm

IMAGES = {".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp"}
"""Endings of images that can be written, whatever their case."""


_NETPBM = {".pgm", ".ppm"}


def is_writable(path: Path) -> bool:
    """Tell whether a file's name has the ending of an image that can be written.

    Examples
    --------
    >>> is_writable(Path("photo.JPG")), is_writable(Path("photo.gif"))
    (True, False)
    """
    return path.suffix.lower() in IMAGES


def write_image(path: Path, pixels: NDArray[Any], name: str = "path", white: int | None = None) -> None:
    """Write an image in the format that the file's name ends with.

    Parameters
    ----------
    path : path
        Name of the file. An existing file is replaced once the new one is complete.
    pixels : ndarray, (height, width) or (height, width, channels)
        Numbers of a type that the format holds: uint8 suits all of them, gray or colour, and some with transparency;
        uint16 and float32 suit some if gray.
    name : str
        What messages call the file.
    white : int, optional
        The sample that is white, by default the largest of the type. PGM and PPM say so; other formats cannot.

    Raises
    ------
    ImportError
        If Pillow is not installed.
    ValueError
        If the name has another ending, or the format does not hold such numbers.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> write_image(Path("colour.jpg"), np.zeros((2, 3, 3)))
    Traceback (most recent call last):
    ValueError: Invalid path. It must end as a format that holds such an image. Given colour.jpg for shape (2, 3, 3) ...
    """
    library = required("PIL.Image", "Writing images needs Pillow", "image")
    given = f"{path.name} for shape {pixels.shape} and type {pixels.dtype}"
    rule = "It must end as a format that holds such an image."
    if not is_writable(path):
        check.refuse(name, rule, given)
    if pixels.ndim == 3 and pixels.shape[2] == 1:
        pixels = pixels[:, :, 0]
    if white is not None and path.suffix.lower() in _NETPBM:
        with replacing(path) as file:
            file.write(netpbm(pixels, white))
        return
    library.init()
    try:
        image = library.fromarray(np.ascontiguousarray(pixels))
        with replacing(path) as file:
            image.save(file, library.EXTENSION[path.suffix.lower()])
    except (TypeError, KeyError):  # no mode has these numbers, or this Pillow does not write the format
        check.refuse(name, rule, given)
    except OSError as error:
        if "mode" not in str(error):
            raise
        check.refuse(name, rule, f"{given}: {error}")
