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
    """

    pixels: NDArray[Any]
    no_data: tuple[float, ...] = ()
    georeferenced: bool = False

    def __repr__(self) -> str:
        height, width = np.shape(self.pixels)[:2]
        return f"Raster({width} x {height} pixels, {self.pixels.dtype})"
