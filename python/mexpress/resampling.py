"""Images between their pixels."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check

_AT_ONCE = 1 << 18
"""Pixels that are resampled at once."""

_MOST_PIXELS = 10**10
"""Largest number of pixels of an image, 80 GB of positions; more are refused as a mistake."""


def check_image(value: ArrayLike, name: str) -> NDArray[Any]:
    """Return an image as an array, (h, w) or (h, w, c), of its own type.

    Raises
    ------
    TypeError
        If its elements are no real numbers.
    ValueError
        If it has another shape, or no pixels.

    Examples
    --------
    >>> check_image([[1, 2, 3]], "image").shape
    (1, 3)
    """
    rule = "It must be an image of real numbers, (height, width) or (height, width, channels)."
    pixels = check.array(value, name, rule, "biuf")
    if pixels.ndim not in (2, 3) or pixels.size == 0:
        check.refuse(name, rule, f"shape {pixels.shape}")
    return pixels


def check_pixels(width: Any, height: Any) -> tuple[int, int]:
    """Return the width and the height of an image in pixels; so many that no machine holds them are a mistake.

    Examples
    --------
    >>> check_pixels(10**6, 10**6)
    Traceback (most recent call last):
    ValueError: Invalid width. An image must have at most 1e+10 pixels. Given 1000000, and height 1000000.
    """
    width, height = check.count(width, "width", 1), check.count(height, "height", 1)
    if width * height > _MOST_PIXELS:
        rule = f"An image must have at most {_MOST_PIXELS:g} pixels."
        check.refuse("width", rule, f"{width}, and height {height}")
    return width, height


def check_size(value: Any, name: str) -> tuple[int, int]:
    """Return the width and the height of an image in pixels.

    Examples
    --------
    >>> check_size([640, 480], "size")
    (640, 480)
    """
    rule = "It must be (width, height) in pixels."
    sizes = check.items(value, name, rule)
    if len(sizes) != 2:
        check.refuse(name, rule, check.describe(value))
    width, height = (check.count(number, name, 1) for number in sizes)
    return width, height


def check_fill(value: ArrayLike, image: NDArray[Any]) -> NDArray[Any]:
    """Return the value of a pixel of an image, () or (c,), in its type.

    Examples
    --------
    >>> check_fill(np.nan, np.zeros((2, 3), np.uint8))
    Traceback (most recent call last):
    ValueError: Invalid fill. It must be a value of a pixel, of the image's type uint8. Given nan.
    """
    rule = f"It must be a value of a pixel, of the image's type {image.dtype}."
    wanted = check.array(value, "fill", rule, "biuf")
    with np.errstate(invalid="ignore", over="ignore"):
        fill = wanted.astype(image.dtype)
    if wanted.shape not in {(), image.shape[2:]} or (image.dtype.kind != "f" and (fill != wanted).any()):
        check.refuse("fill", rule, check.describe(value))
    return fill


def resampled(
    image: NDArray[Any], positions: NDArray[np.floating], fill: NDArray[Any] | float
) -> NDArray[Any]:
    """Return an image at positions, bilinearly.

    A pixel is a square about its centre: within half a pixel outside of the centres, the nearest value counts.

    Parameters
    ----------
    image : ndarray, (h, w) or (h, w, c)
        Real numbers of any type; whole ones are rounded.
    positions : ndarray, (2, height, width)
        x, then y; the centre of the first pixel is (0, 0).
    fill : ndarray, () or (c,), or float
        The value at other positions, and at NaN.

    Returns
    -------
    ndarray, (height, width) or (height, width, c)
        Of the image's type.

    Examples
    --------
    >>> image = np.array([[0.0, 1.0], [2.0, 3.0]])
    >>> resampled(image, np.array([[[0.5, 1.4, 9.0]], [[0.5, 0.0, 0.0]]]), np.nan)
    array([[1.5, 1. , nan]])
    """
    result = np.empty((*positions.shape[1:], *image.shape[2:]), image.dtype)
    step = max(1, _AT_ONCE // positions.shape[2])
    for first in range(0, positions.shape[1], step):
        rows = slice(first, first + step)
        result[rows] = _strip(image, positions[:, rows], fill)
    return result


def _strip(image: NDArray[Any], positions: NDArray[np.floating], fill: NDArray[Any] | float) -> NDArray[Any]:
    high, wide = image.shape[:2]
    x, y = positions
    known = (x >= -0.5) & (x <= wide - 0.5) & (y >= -0.5) & (y <= high - 0.5)  # not NaN
    number = _arithmetic(image.dtype)
    left, u = _neighbours(x[known], wide, number)
    top, v = _neighbours(y[known], high, number)
    u, v = (share.reshape(-1, *[1] * (image.ndim - 2)) for share in (u, v))
    pixels = image.reshape(high * wide, *image.shape[2:])
    right, down = min(1, wide - 1), wide * min(1, high - 1)
    corner = top * wide + left
    upper, lower = (
        _mixed(pixels[row].astype(number), pixels[row + right].astype(number), u)
        for row in (corner, corner + down)
    )
    between = _mixed(upper, lower, v)
    strip = np.empty((*x.shape, *image.shape[2:]), image.dtype)
    strip[...] = fill
    strip[known] = between if image.dtype.kind == "f" else np.rint(between)
    return strip


def _neighbours(
    coordinates: NDArray[Any], size: int, number: type[np.floating]
) -> tuple[NDArray[np.intp], Any]:
    """Return the pixel before each coordinate, of two neighbours, and the share of the one behind."""
    within = coordinates.clip(0, size - 1)
    first = np.minimum(within.astype(np.intp), max(size - 2, 0))
    return first, (within - first).astype(number)


def _mixed(first: NDArray[Any], second: NDArray[Any], share: NDArray[Any]) -> NDArray[Any]:
    return np.asarray(first * (1 - share) + second * share)


def _arithmetic(dtype: np.dtype[Any]) -> type[np.floating]:
    """Return the type that holds all numbers of another one."""
    if dtype.itemsize <= 2:
        return np.float32
    return np.longdouble if dtype.kind in "iu" and dtype.itemsize == 8 else np.float64
