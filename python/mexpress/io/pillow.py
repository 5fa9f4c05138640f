"""Images that Pillow reads, an extra: PNG, JPEG and many others, but no sample that it changes.

Examples
--------
>>> import io
>>> file = io.BytesIO()
>>> pillow().fromarray(np.full((2, 3), 40_000, np.uint16)).save(file, "PNG")
>>> read_by_pillow(file.getvalue())
array([[40000, 40000, 40000],
       [40000, 40000, 40000]], dtype=uint16)
"""

import io
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mexpress.extras import required

_PLAIN = {"1", "L", "LA", "RGB", "RGBA"}
_PALETTES = {"P", "PA"}
_PNG = b"\x89PNG\r\n\x1a\n"
_GRAY = 0
_LOSSY = {"JPEG", "MPO", "WEBP", "JPEG2000", "AVIF"}
_LOSSY_IN_TIFF = {"jpeg", "tiff_jpeg", "webp"}
_ORIENTATION = 0x0112


def pillow() -> ModuleType:
    """Return Pillow's module of images.

    Raises
    ------
    ImportError
        If it is not installed; the message names the extra.

    Examples
    --------
    >>> pillow().__name__
    'PIL.Image'
    """
    return required("PIL.Image", "Reading this image needs Pillow", "image")


def read_by_pillow(content: bytes) -> NDArray[Any]:
    """Read an image.

    Parameters
    ----------
    content : bytes
        The file.

    Returns
    -------
    ndarray, (height, width) or (height, width, channels)
        The samples: bool of a black and white image, uint8, or uint16 of a gray PNG of 16 bits. Those of a palette are
        its colours.

    Raises
    ------
    ValueError
        If Pillow cannot read it, or would change its samples; the message says why.
    ImportError
        If Pillow is not installed.

    Examples
    --------
    >>> read_by_pillow(b"nothing")
    Traceback (most recent call last):
        ...
    ValueError: it is no image that Pillow knows
    """
    library = pillow()
    samples: NDArray[Any]
    is_png = content.startswith(_PNG) and len(content) > 25
    bits, colour = content[24:26] if is_png else (8, _GRAY)
    if bits == 16 and colour != _GRAY:
        raise ValueError("it has channels of 16 bits, which Pillow would cut to 8; a TIFF can have them")
    packed = ""
    try:
        with library.open(io.BytesIO(content)) as image:
            packed = f", packed by {name}" if (name := image.info.get("compression")) else ""
            colours = "RGBA" if image.has_transparency_data else "RGB"
            plain = image.convert(colours) if image.mode in _PALETTES else image
            mode, samples = plain.mode, np.array(plain)
    except library.UnidentifiedImageError:
        raise ValueError("it is no image that Pillow knows") from None
    except Exception as error:  # whatever the reader of the format meets first in damaged bytes
        raise ValueError(str(error)) from error
    if bits == 16:
        return samples.astype(np.uint16)
    if mode not in _PLAIN:
        raise ValueError(f"it is of Pillow's mode {mode}{packed}; gray, RGB and RGBA of 8 bits can be read")
    if bits in {2, 4} and mode == "L":
        samples //= 255 // (2**bits - 1)  # Pillow stretches them to 8 bits
    return samples


def lossy_by_pillow(content: bytes) -> bool:
    """Tell whether samples that `read_by_pillow` reads need not be those that were written.

    Examples
    --------
    >>> file = io.BytesIO()
    >>> pillow().new("L", (3, 2)).save(file, "JPEG")
    >>> lossy_by_pillow(file.getvalue())
    True
    """
    with pillow().open(io.BytesIO(content)) as image:
        return image.format in _LOSSY or image.info.get("compression") in _LOSSY_IN_TIFF


def orientation_by_pillow(content: bytes) -> int:
    """Return how what `read_by_pillow` reads is to be seen, by EXIF data: 1 to 8, and 1 if nothing there says.

    Examples
    --------
    >>> file = io.BytesIO()
    >>> pillow().new("L", (3, 2)).save(file, "JPEG")
    >>> orientation_by_pillow(file.getvalue())
    1
    """
    try:
        with pillow().open(io.BytesIO(content)) as image:
            if image.format == "TIFF":  # Pillow turns these itself
                return 1
            orientation = image.getexif().get(_ORIENTATION, 1)
    except Exception:  # damaged EXIF data say nothing, and the image is read all the same
        return 1
    return orientation if orientation in range(1, 9) else 1
