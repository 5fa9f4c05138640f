"""Regions of images: how well two of them agree, and where a warp puts them.

A region is a mask, bool (height, width), or a closed polygon, (k, 2), x then y in pixels, or a sequence of such rings:
what is inside an odd number of them is inside, so that holes are rings like any other. Pixel centres are whole numbers.

Examples
--------
>>> square = [[10, 10], [20, 10], [20, 20], [10, 20]]
>>> jaccard(square, [[10, 10], [20, 10], [20, 15], [10, 15]], (40, 30))
0.5
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.extras import required

if TYPE_CHECKING:
    from mexpress.models.warp import Warp

Mask: TypeAlias = NDArray[np.bool_]
Rings: TypeAlias = tuple[Floats, ...]

_MOST = 1_000_000
"""Points of a contour: that of a large image has some thousands."""

_RULE = "It must be a bool mask (height, width), or polygons (k, 2) of three corners at least."


def jaccard(first: Any, second: Any, image_size: tuple[float, float]) -> float:
    """Return the Jaccard index of two regions: the area of what they share over that of what they cover together.

    Parameters
    ----------
    first, second : mask, polygon or sequence of polygons
        Regions of one image, in pixels.
    image_size : (width, height)
        Of the image, in pixels. Only what is inside counts.

    Returns
    -------
    float
        From 0, nothing shared, to 1, equal; NaN if both are empty.

    Raises
    ------
    ValueError, TypeError
        If a region is none.

    Examples
    --------
    >>> import numpy as np
    >>> mask = np.zeros((30, 40), dtype=bool)
    >>> mask[10:20, 10:20] = True
    >>> jaccard(mask, [[10, 10], [20, 10], [20, 20], [10, 20]], (40, 30))
    1.0
    """
    one, other = rasterised(first, image_size, "first"), rasterised(second, image_size, "second")
    covered = int(np.count_nonzero(one | other))
    return int(np.count_nonzero(one & other)) / covered if covered else math.nan


def rasterised(region: Any, image_size: tuple[float, float], name: str = "region") -> Mask:
    """Return which pixels of an image have their centre in a region.

    Parameters
    ----------
    region : mask, polygon or sequence of polygons
        In pixels. A mask is taken as it is, and cut or continued by False to the image's size.
    image_size : (width, height)
        Of the image, in pixels; parts of a pixel count as one.
    name : str
        What messages call the region.

    Returns
    -------
    ndarray of bool, (height, width)
        Centres on a left or an upper edge are in, on a right or a lower one out: regions side by side share none.

    Raises
    ------
    ValueError, TypeError
        If it is none.

    Notes
    -----
    An edge flips all pixels below it. Libraries that ask each pixel about each edge take seconds for contours with
    thousands of corners.

    Examples
    --------
    >>> rasterised([[1, 0], [3, 0], [1, 2]], (5, 3)).astype(int)
    array([[0, 1, 1, 0, 0],
           [0, 1, 0, 0, 0],
           [0, 0, 0, 0, 0]])
    """
    width, height = (math.ceil(size) for size in image_size)
    if isinstance(region, np.ndarray) and region.dtype == np.bool_ and region.ndim == 2:
        mask = np.zeros((height, width), dtype=np.bool_)
        part = region[:height, :width]
        mask[: part.shape[0], : part.shape[1]] = part
        return mask
    flips = np.zeros((height + 1, width), dtype=np.uint8)
    for ring in _rings(region, name):
        columns, y = _crossings(ring, width)
        np.bitwise_xor.at(flips, (np.ceil(np.clip(y, 0, height)).astype(np.intp), columns), 1)
    for above, below in pairwise(flips):  # faster than bitwise_xor.accumulate
        np.bitwise_xor(above, below, out=below)
    return flips[:height].view(np.bool_)


def _crossings(ring: Floats, width: int) -> tuple[NDArray[np.intp], Floats]:
    """Return where the edges of a ring cross the columns of an image: column and y of each crossing."""
    start, stop = ring, np.roll(ring, -1, axis=0)
    left, right = np.minimum(start[:, 0], stop[:, 0]), np.maximum(start[:, 0], stop[:, 0])
    first, last = (np.ceil(np.clip(x, 0, width)).astype(np.intp) for x in (left, right))
    number = last - first  # columns with left <= column < right
    edge = np.repeat(np.arange(len(ring)), number)
    columns = np.arange(len(edge)) - np.repeat(np.cumsum(number) - number - first, number)
    slope = (stop[edge, 1] - start[edge, 1]) / (stop[edge, 0] - start[edge, 0])
    return columns, start[edge, 1] + (columns - start[edge, 0]) * slope


def outlines(mask: Any) -> Rings:
    """Return the rings that bound a mask, of holes too; needs the extra ``paper``.

    Parameters
    ----------
    mask : array of bool, (height, width)
        Which pixels are inside.

    Returns
    -------
    tuple of ndarray, (k, 2)
        Corners x, y in pixels, half-way between pixels that are inside and their neighbours outside.

    Raises
    ------
    ImportError
        If scikit-image is not installed.
    ValueError
        If it is no mask.

    Examples
    --------
    >>> import numpy as np
    >>> mask = np.zeros((3, 4), dtype=bool)
    >>> mask[1, 2] = True
    >>> sorted(outlines(mask)[0].tolist())
    [[1.5, 1.0], [2.0, 0.5], [2.0, 1.5], [2.5, 1.0]]
    """
    library = required("skimage.measure", "Outlines of masks need scikit-image", "paper")
    inside = np.asarray(mask)
    if inside.dtype != np.bool_ or inside.ndim != 2:
        check.refuse("mask", "It must be a bool array (height, width).", check.describe(inside))
    trace: Callable[..., list[Floats]] = library.find_contours
    framed = np.pad(inside, 1).astype(np.float64)  # else a ring that meets the border stays open
    return tuple(np.ascontiguousarray(ring[:-1, ::-1]) - 1.0 for ring in trace(framed, 0.5))


def resampled(ring: Any, step: float = 1.0) -> Floats:
    """Return points along a closed polygon, its corners among them.

    Parameters
    ----------
    ring : array_like, (k, 2)
        Corners, in pixels.
    step : float
        Upper bound on the distance from one point to the next.

    Returns
    -------
    ndarray, (m, 2)
        Points in order; a warp bends what is between the corners too.

    Raises
    ------
    ValueError, TypeError
        If it is no polygon.

    Examples
    --------
    >>> resampled([[0, 0], [2, 0], [0, 1]]).round(2).tolist()
    [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [1.33, 0.33], [0.67, 0.67], [0.0, 1.0]]
    """
    step = check.positive(step, "step")
    corners = check.points(ring, "ring")
    if len(corners) < 3:
        check.refuse("ring", "A polygon must have three corners at least.", str(len(corners)))
    edges = np.roll(corners, -1, axis=0) - corners
    pieces = np.maximum(np.ceil(np.hypot(*edges.T) / step), 1)
    if pieces.sum() > _MOST:
        rule = f"It must be no longer than {_MOST:,} steps of {step:g}."
        check.refuse("ring", rule, f"a contour of length {np.hypot(*edges.T).sum():.3g}")
    parts = pieces.astype(np.intp)
    edge = np.repeat(np.arange(len(corners)), parts)
    share = (np.arange(len(edge)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[edge]
    return np.asarray(corners[edge] + share[:, None] * edges[edge])


def transferred(warp: Warp, rings: Rings) -> Rings | None:
    """Return where a warp puts a region's rings.

    Parameters
    ----------
    warp : Warp
        From the image that the region is of.
    rings : tuple of ndarray, (k, 2)
        As `resampled` makes them: every point is mapped, and neighbours are joined by straight lines.

    Returns
    -------
    tuple of ndarray, (k, 2), or None
        None if the denominator vanishes on a ring, whose image then goes through infinity. A ring where the warp folds
        may cross itself.

    Examples
    --------
    >>> import mexpress as mx
    >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
    >>> warp = mx.fit_warp(square, [[0, 0], [100, 0], [20, 100], [80, 100]], square[:3])
    >>> transferred(warp, (resampled([[0, 0], [100, 0], [100, 100]], 200),))[0].round(6) + 0.0
    array([[  0.,   0.],
           [100.,   0.],
           [ 80., 100.]])
    >>> transferred(warp, (resampled([[0, 0], [100, 0], [0, -1000]]),)) is None
    True
    """
    if any(warp.vanishes(ring).any() for ring in rings):
        return None
    return tuple(warp(ring) for ring in rings)


def _rings(region: Any, name: str) -> Rings:
    """Return the rings of a polygon or of several."""
    if isinstance(region, np.ndarray) and region.ndim == 2:
        listed: Sequence[Any] = [region]
    else:
        listed = check.items(region, name, _RULE)
        if listed and np.ndim(listed[0]) == 1:
            listed = [listed]
    rings = tuple(check.points(ring, name) for ring in listed)
    for ring in rings:
        if len(ring) < 3:
            check.refuse(name, _RULE, f"a polygon with {len(ring)} corners")
    return rings
