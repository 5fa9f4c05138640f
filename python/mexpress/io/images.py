"""Images in files, read by scikit-image, which is an extra.

Examples
--------
>>> import tempfile
>>> import skimage.io
>>> with tempfile.TemporaryDirectory() as folder:
...     skimage.io.imsave(f"{folder}/depth.png", np.ones((2, 3), np.uint16), check_contrast=False)
...     read_image(Path(f"{folder}/depth.png"))
array([[1, 1, 1],
       [1, 1, 1]], dtype=uint16)
"""

import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check

_TIFF = {".tif", ".tiff"}


def read_image(path: Path, name: str = "image") -> NDArray[Any]:
    """Read an image.

    Parameters
    ----------
    path : path
        Name of the file.
    name : str
        What messages call it.

    Returns
    -------
    ndarray, (height, width) or (height, width, channels)
        The pixels, in the file's own type.

    Raises
    ------
    ImportError
        If scikit-image is not installed.
    ValueError
        If the file is damaged, or holds something else.
    OSError
        If it cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> import skimage.io
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     skimage.io.imsave(f"{folder}/colour.png", np.ones((2, 3, 3), np.uint8), check_contrast=False)
    ...     read_image(Path(f"{folder}/colour.png")).shape
    (2, 3, 3)
    """
    try:
        from skimage.io import imread  # noqa: PLC0415  an extra, imported where used
    except ImportError as error:
        raise ImportError("Reading images needs scikit-image: pip install 'mexpress[image]'") from error
    content = path.read_bytes()  # readers leave files open that they do not understand
    # Without the name a TIFF gets a reader that knows few types, and takes the first of several pages for all.
    source = str(path) if path.suffix.lower() in _TIFF else io.BytesIO(content)
    try:
        image = np.asarray(imread(source))
    except Exception as error:  # whatever the reader of this format raises
        check.refuse(name, "It must be a file that scikit-image reads.", f"{path}: {error}")
    if image.ndim not in (2, 3):
        check.refuse(name, "It must be one gray or colour image.", f"shape {image.shape} in {path}")
    return image
