"""Images in files, sample by sample as they stand there: TIFF, PGM, PPM, PFM, ESRI's grids, and what Pillow reads.

Examples
--------
>>> import tempfile
>>> with tempfile.TemporaryDirectory() as folder:
...     size = Path(f"{folder}/depth.pgm").write_text("P2 3 2 4095 1500 1501 1502 1503 1504 1505")
...     read_image(Path(f"{folder}/depth.pgm"))
array([[1500, 1501, 1502],
       [1503, 1504, 1505]], dtype=uint16)
"""

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress.io.endings import readable
from mexpress.io.grids import is_grid, read_grid
from mexpress.io.netpbm import is_netpbm, netpbm_white, read_netpbm
from mexpress.io.pillow import lossy_by_pillow, orientation_by_pillow, read_by_pillow
from mexpress.io.raster import Raster
from mexpress.io.tiff import is_tiff, read_tiff


def read_image(path: Path, name: str = "image") -> NDArray[Any]:
    """Read an image.

    Parameters
    ----------
    path : path
        Name of the file. Its first bytes tell what it is.
    name : str
        What messages call it.

    Returns
    -------
    ndarray, (height, width) or (height, width, channels)
        The samples, in the file's own type, turned and mirrored as EXIF data and tags of a TIFF say, as viewers and
        `cv2.imread` do.

    Raises
    ------
    ImportError
        If the file needs Pillow, and it is not installed.
    ValueError
        If the file is damaged, holds something else, or holds samples that would be changed.
    OSError
        If it cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     size = Path(f"{folder}/colour.ppm").write_bytes(b"P6 2 1 255 " + bytes([255, 0, 0, 0, 0, 255]))
    ...     read_image(Path(f"{folder}/colour.ppm")).shape
    (1, 2, 3)
    """
    return read_raster(path, name).upright()


def read_raster(path: Path, name: str) -> Raster:
    """Read an image, and what its file says of the meaning of its samples.

    Parameters
    ----------
    path, name
        As for `read_image`.

    Returns
    -------
    Raster
        What means no data is said by GeoTIFF and by ESRI's grids, and so is whether there is a place on earth; a scale
        and an offset by GDAL's metadata in a TIFF.
        Pixels are not turned.

    Raises
    ------
    ImportError, ValueError, OSError
        As `read_image` does.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     size = Path(f"{folder}/heights.asc").write_text("ncols 2 nrows 1 cellsize 30 NODATA_value -1  7 -1")
    ...     read_raster(Path(f"{folder}/heights.asc"), "cloud").no_data
    (-1.0,)
    """
    content = path.read_bytes()
    try:
        if is_netpbm(content):
            return Raster(read_netpbm(content), white=netpbm_white(content))
        if is_grid(content):
            return read_grid(content)
        raster = read_tiff(content) if is_tiff(content) else None
        if raster is not None:
            return raster
        pixels, turned = read_by_pillow(content), orientation_by_pillow(content)
        return Raster(pixels, orientation=turned, exact=not lossy_by_pillow(content))
    except ValueError as error:
        check.refuse(name, f"It must be a whole image. {readable(name)}", f"{path.name}: {error}")
