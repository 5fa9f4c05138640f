"""What a file of pixels says, besides its pixels, of their meaning.

Examples
--------
>>> Raster(np.ones((2, 3)), no_data=(-9999.0,))
Raster(3 x 2 pixels, float64)
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

UNSCALED = 1.0, 0.0
"""The scale and the offset of numbers that mean what they are."""


@dataclass(frozen=True, eq=False, repr=False)
class Raster:
    """Pixels, and what the file says of them.

    Parameters
    ----------
    pixels : ndarray, (height, width) or (height, width, channels)
        The samples in the file's own type, rows from the top.
    no_data : tuple of float
        Values that the file itself says mean no data.
    georeferenced : bool
        Whether the file says where on earth its pixels are.
    orientation : int
        How its pixels are to be seen, 1 to 8 as in EXIF: 1 as they stand.
    white : int, optional
        The sample that the file says is white, if that need not be the largest of the type.
    scaling : (scale, offset)
        What the file says that samples are to be multiplied by, and what is then to be added.
    exact : bool
        Whether the samples are those that were written, as they are not after JPEG.
    """

    pixels: NDArray[Any]
    no_data: tuple[float, ...] = ()
    georeferenced: bool = False
    orientation: int = 1
    white: int | None = None
    scaling: tuple[float, float] = UNSCALED
    exact: bool = True

    def upright(self) -> NDArray[Any]:
        """Return the pixels as they are to be seen.

        Examples
        --------
        >>> Raster(np.array([[1, 2, 3], [4, 5, 6]]), orientation=6).upright()  # turned to the right
        array([[4, 1],
               [5, 2],
               [6, 3]])
        """
        turned = np.swapaxes(self.pixels, 0, 1) if self.orientation > 4 else self.pixels
        down, across = self.orientation % 4 in {0, 3}, self.orientation % 4 in {2, 3}
        return turned[:: -1 if down else 1, :: -1 if across else 1]

    def __repr__(self) -> str:
        height, width = np.shape(self.pixels)[:2]
        return f"Raster({width} x {height} pixels, {self.pixels.dtype})"
