"""Images as arrays: read from whatever users hand in, reduced, sampled, laid over each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress._validation import Floats

_DISPLAYED = 1000
"""Pixels along the longer side of a displayed image."""

_AROUND = 0.05
"""Half the side of the square in which an image's light is taken to be even, as a share of its longer side."""

_EVEN = 0.3
"""Contrast that is added to that of each square, as a share of the whole image's: noise is not to look like edges."""

Extent = tuple[float, float, float, float]


def as_image(value: ArrayLike, name: str) -> Floats:
    """Return an image with numbers from 0 to 1, (h, w) or (h, w, 3), without transparency."""
    array = np.asarray(value)
    rule = "It must be a gray (height, width) or colour (height, width, 3 or 4) image."
    colour = array.ndim == 3 and array.shape[2] in (1, 3, 4)
    if array.size == 0 or not (array.ndim == 2 or colour):
        check.refuse(name, rule, f"shape {array.shape}")
    if array.dtype.kind not in "buif":
        check.refuse(name, rule, check.describe(array), TypeError)
    if colour:
        array = array[:, :, 0] if array.shape[2] == 1 else array[:, :, :3]
    values = array.astype(np.float64)
    if array.dtype.kind in "ui":
        return values / np.iinfo(array.dtype).max
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    if low < 0 or high > 1:
        values = (values - low) / ((high - low) or 1.0)
    return np.nan_to_num(values, nan=0.0, posinf=1.0, neginf=0.0)


def reduced(image: Floats) -> tuple[Floats, int]:
    """Return the means of square blocks, of a size that makes the image small enough, and this size."""
    step = -(-max(image.shape[:2]) // _DISPLAYED)
    high, wide = (max(1, size // step) for size in image.shape[:2])
    blocks = image[: high * step, : wide * step]
    rows = np.add.reduceat(blocks, np.arange(0, blocks.shape[0], step), axis=0)
    sums = np.add.reduceat(rows, np.arange(0, blocks.shape[1], step), axis=1)
    return sums / (min(step, blocks.shape[0]) * min(step, blocks.shape[1])), step


def pixel_centres(image: Floats, step: int) -> Floats:
    """Return the positions of a reduced image's pixels in the image itself, row after row."""
    high, wide = image.shape[:2]
    y, x = np.mgrid[:high, :wide] * float(step) + (step - 1) / 2
    return np.column_stack([x.ravel(), y.ravel()])


def extent(image: Floats, step: int) -> Extent:
    """Left, right, bottom, top of a reduced image, pixel centres being whole numbers in the image itself."""
    return (-0.5, image.shape[1] * step - 0.5, image.shape[0] * step - 0.5, -0.5)


def sampled(image: Floats, positions: Floats) -> Floats:
    """Return an image between its pixels, bilinearly; NaN outside."""
    high, wide = image.shape[:2]
    with np.errstate(invalid="ignore"):
        inside = ((positions >= 0) & (positions <= [wide - 1, high - 1])).all(axis=1)
    values = np.full((len(positions), *image.shape[2:]), np.nan)
    where = positions[inside]
    x, y = np.minimum(where, [max(wide - 2, 0), max(high - 2, 0)]).astype(int).T
    right, below = np.minimum(x + 1, wide - 1), np.minimum(y + 1, high - 1)
    u, v = (where - np.column_stack([x, y])).T.reshape((2, -1) + (1,) * (image.ndim - 2))
    values[inside] = (1 - v) * ((1 - u) * image[y, x] + u * image[y, right]) + v * (
        (1 - u) * image[below, x] + u * image[below, right]
    )
    return values


def pulled(image: Floats, step: int, positions: Floats, frame: Floats) -> Floats:
    """Return a reduced image at positions of its own pixels, one for each pixel of a frame.

    Examples
    --------
    >>> image = np.array([[0.0, 1.0], [2.0, 3.0]])
    >>> pulled(image, 1, pixel_centres(image, 1), image).tolist()
    [[0.0, 1.0], [2.0, 3.0]]
    """
    values = sampled(image, (positions - (step - 1) / 2) / step)
    return values.reshape(frame.shape[:2] + image.shape[2:])


def gray_behind(image: Floats) -> Floats:
    """Return the image with a light gray where it is NaN."""
    return np.where(np.isnan(image), 0.85, image)


def blended(first: Floats, second: Floats) -> Floats:
    """Return source in magenta over target in green, of equal mean and contrast around each pixel where both are known.

    So edges that differ are seen, but not light that differs, such as a shadow on one of them.
    """
    gray, other = (image if image.ndim == 2 else image.mean(axis=2) for image in (first, second))
    known = ~np.isnan(other)
    if known.any():
        (mean, contrast), (others, others_contrast) = (_around(image, known) for image in (gray, other))
        other = (other - others) * (contrast / others_contrast) + mean
    other = np.clip(np.where(known, other, gray), 0, 1)
    return np.where(known[..., None], np.stack([gray, other, gray], axis=-1), 0.5 + 0.5 * gray[..., None])


def _around(image: Floats, known: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Return mean and contrast of the known pixels in a square around each pixel; nowhere is the contrast near zero."""
    radius = max(1, round(_AROUND * max(image.shape)))
    centre, spread = image[known].mean(), float(image[known].std()) or 1.0
    values = np.where(known, (image - centre) / spread, 0.0)
    number = np.maximum(_sums(known.astype(np.float64), radius), 1.0)
    mean = _sums(values, radius) / number
    contrast = np.sqrt(np.maximum(_sums(values**2, radius) / number - mean**2, 0.0))
    return centre + spread * mean, spread * (contrast + _EVEN)


def _sums(image: Floats, radius: int) -> Floats:
    """Return the sums over the square around each pixel, as far as it is in the image."""
    for axis, size in enumerate(image.shape):
        sums = np.insert(np.cumsum(image, axis=axis), 0, 0.0, axis=axis)
        at = np.arange(size)
        ends = np.minimum(at + radius + 1, size), np.maximum(at - radius, 0)
        image = np.subtract(*(sums.take(end, axis=axis) for end in ends))
    return image
