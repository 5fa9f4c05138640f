"""Depth maps: which pixels have a measurement, and what their numbers mean.

Examples
--------
>>> map = depth_of_raster(Raster(np.array([[0, 1500], [1501, 1502]], np.uint16)), "depth.png")
>>> map.data(map.valid())
(array([[1., 0.],
       [0., 1.],
       [1., 1.]]), array([1.5  , 1.501, 1.502]))
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.io.missing import Missing
from mexpress.io.raster import UNSCALED, Raster

_MILLIMETRES = 1000.0


class DepthMap(NamedTuple):
    """A depth map, of whole numbers or not, and what its numbers mean.

    Parameters
    ----------
    raw : array, (height, width)
        The numbers as they stand in the file.
    zero_is_missing : bool
        Whether 0 means no data.
    missing : Missing
        Which other numbers mean no data.
    scaling : (scale, offset)
        What the numbers are multiplied by, and what is then added, to be in the file's unit.
    scale : float
        How many of the file's units are one.
    unit : str or None
        What the depths are in, if that is known.
    intrinsics : (fx, fy, cx, cy), optional
        The camera in pixels, of which no point is at the centre: then 0 means no data, too.
    weights : (height * width,) array, optional
        Weights of the pixels.
    """

    raw: NDArray[Any]
    zero_is_missing: bool
    missing: Missing = Missing()
    scaling: tuple[float, float] = UNSCALED
    scale: float = 1.0
    unit: str | None = None
    intrinsics: tuple[float, float, float, float] | None = None
    weights: Floats | None = None

    @property
    def total(self) -> int:
        """Number of pixels."""
        return self.raw.size

    @property
    def image_size(self) -> tuple[float, float]:
        """Width and height in pixels."""
        return self.raw.shape[1], self.raw.shape[0]

    def valid(self) -> Integers:
        """Return which pixels have a measurement, and a weight if there are weights."""
        raw = self.raw.ravel()
        known = ~self.missing.marks(raw)
        if self.zero_is_missing:
            known &= raw != 0
        if self.intrinsics is not None:
            known &= self._depths(raw) != 0
        return np.flatnonzero(known if self.weights is None else known & np.isfinite(self.weights))

    def numbers(self, chosen: Integers) -> NDArray[Any]:
        """Return the numbers of some pixels as they stand in the file."""
        return self.raw.ravel()[chosen]

    def data(self, chosen: Integers) -> tuple[Floats, Floats]:
        """Return positions (k, 2) of some pixels, and their depths (k,) or, seen by a camera, points (k, 3)."""
        row, column = np.divmod(chosen, self.raw.shape[1])
        points = np.column_stack([column, row]).astype(np.float64)
        depth = self._depths(self.numbers(chosen))
        with np.errstate(over="ignore"):
            if self.intrinsics is None:
                return points, depth
            fx, fy, cx, cy = self.intrinsics
            return points, np.column_stack([(column - cx) / fx * depth, (row - cy) / fy * depth, depth])

    def _depths(self, numbers: NDArray[Any]) -> Floats:
        factor, offset = self.scaling
        with np.errstate(over="ignore"):
            return (numbers.astype(np.float64) * factor + offset) / self.scale


def depth_of_array(array: NDArray[Any], place: str) -> DepthMap:
    """Return the depth map that an array is: in its own unit, and 0 means no data among whole numbers.

    Parameters
    ----------
    array : array, (height, width)
        Real numbers.
    place : str
        What messages call its file.

    Raises
    ------
    ValueError, TypeError
        If it is no such array.

    Examples
    --------
    >>> depth_of_array(np.array([[0, 7], [8, 9]]), "depth.npy").valid()
    array([1, 2, 3])
    """
    rule = "A depth map must have rows and columns, with a real number at each pixel."
    raw = check.array(array, "cloud", rule, "iuf")
    if raw.ndim != 2:
        check.refuse("cloud", rule, f"shape {raw.shape} in {place}")
    return DepthMap(raw, zero_is_missing=raw.dtype.kind != "f")


def depth_of_raster(raster: Raster, place: str) -> DepthMap:
    """Return the depth map that an image is.

    Whole numbers without a sign and without a place on earth are a sensor's: millimetres, and 0 where it measured
    nothing, unless the file says itself what means no data. Others, and those that the file has a scale or an offset
    for, are in a unit that is not known, and 0 is a value. Pixels are where they are to be seen.

    Parameters
    ----------
    raster : Raster
        Of one channel.
    place : str
        What messages call its file.

    Raises
    ------
    ValueError, TypeError
        If it has colours, no numbers, or numbers that packing has changed.

    Examples
    --------
    >>> heights = Raster(np.array([[0, 7], [8, -32768]], np.int16), no_data=(-32768.0,))
    >>> depth_of_raster(heights, "heights.tif").data([0, 1])[1]
    array([0., 7.])
    """
    if not raster.exact:
        rule = "JPEG and the like change numbers: save depths as .png of 16 bits, or as .tif without it."
        check.refuse("cloud", rule, place)
    depth = depth_of_array(raster.upright(), place)._replace(
        zero_is_missing=False, missing=Missing(raster.no_data), scaling=raster.scaling
    )
    if raster.pixels.dtype.kind != "u" or raster.georeferenced or raster.scaling != UNSCALED:
        return depth
    return depth._replace(zero_is_missing=not raster.no_data, scale=_MILLIMETRES, unit="m")
