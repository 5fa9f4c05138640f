"""Two images under a slider: before and after one of them was registered to the other."""

from __future__ import annotations

import base64
import io
from html import escape

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress._validation import Floats
from mexpress.extras import required
from mexpress.models import Warp
from mexpress.plotting import rasters

_QUALITY = 88


def compared_images(warp: Warp, source_image: ArrayLike, target_image: ArrayLike) -> str:
    """Return the source image and the target image in its frame, as it was taken and as the warp registers it.

    Parameters
    ----------
    warp : Warp
        From the source image to the target image.
    source_image, target_image : array_like, (height, width) or (height, width, 3 or 4)
        As for `mexpress.WarpSelection.plot_registration`.

    Returns
    -------
    str
        HTML.

    Raises
    ------
    ImportError
        Without Pillow.
    ValueError, TypeError
        If an argument is no image.

    Examples
    --------
    >>> import mexpress as mx
    >>> image = np.random.default_rng(0).uniform(size=(60, 80))
    >>> corners = [[5, 5], [70, 5], [70, 50], [5, 50]]
    >>> compared_images(mx.fit_warp(corners, corners, corners[:3]), image, image).count("<img")
    3
    """
    first, step = rasters.reduced(rasters.as_image(source_image, "source_image"))
    second, target_step = rasters.reduced(rasters.as_image(target_image, "target_image"))
    centres = rasters.pixel_centres(first, step)

    def pulled(positions: Floats) -> Floats:
        return rasters.gray_behind(rasters.pulled(second, target_step, positions, first))

    size = first.shape[1], first.shape[0]
    layers = [
        _image(first, size, "Source image", "source"),
        _image(pulled(warp(centres)), size, "Target image, registered by the warp", "right registered"),
        _image(pulled(centres), size, "Target image as it was taken", "right taken"),
    ]
    return (
        '<figure class="compare"><h3>Registration</h3>'
        "<fieldset><legend>On the right, the target image</legend>"
        '<label><input type="radio" name="target" value="taken"> before: as it was taken</label>'
        '<label><input type="radio" name="target" value="registered" checked> after: registered</label></fieldset>'
        f'<div class="stack">{"".join(layers)}'
        '<input type="range" min="0" max="100" step="0.5" value="50" '
        'aria-label="Where the source image ends, in percent">'
        '</div><p class="sides"><span>source</span><span>target</span></p>'
        "<figcaption>In the frame of the source image. Move the edge: where the warp is right, nothing jumps there. "
        "Gray is outside of the target image.</figcaption></figure>"
    )


def _image(pixels: Floats, size: tuple[int, int], words: str, kind: str) -> str:
    wide, high = size
    return f'<img class="{kind}" alt="{escape(words)}" width="{wide}" height="{high}" src="{jpeg(pixels)}">'


def jpeg(image: Floats) -> str:
    """Return an image of numbers from 0 to 1, (h, w) or (h, w, 3), as the address of its own content.

    Raises
    ------
    ImportError
        Without Pillow.

    Examples
    --------
    >>> jpeg(np.zeros((8, 8)))[:27]
    'data:image/jpeg;base64,/9j/'
    """
    library = required("PIL.Image", "Images in a report need Pillow", "image")
    samples: NDArray[np.uint8] = np.rint(255 * np.clip(image, 0, 1)).astype(np.uint8)
    file = io.BytesIO()
    library.fromarray(samples).save(file, "JPEG", quality=_QUALITY, optimize=True)
    return "data:image/jpeg;base64," + base64.b64encode(file.getvalue()).decode()
