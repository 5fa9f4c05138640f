"""ESRI's grids in text, `.asc`: a header of names and numbers, then the cells, row after row from the north.

Examples
--------
>>> grid = read_grid(b"NCOLS 2 NROWS 2 XLLCORNER 0 YLLCORNER 0 CELLSIZE 30 NODATA_VALUE -1  1.5 2  3 -1")
>>> grid.pixels, grid.no_data
(array([[ 1.5,  2. ],
       [ 3. , -1. ]]), (-1.0,))
"""

import re

from mexpress.io.raster import Raster
from mexpress.io.words import as_numbers

_NAMES = {
    "ncols",
    "nrows",
    "xllcorner",
    "yllcorner",
    "xllcenter",
    "yllcenter",
    "cellsize",
    "dx",
    "dy",
    "nodata_value",
}
_UNSAID = -9999.0
"""What means no data where a header does not say it."""


_BEGINNING = rb"(\xef\xbb\xbf)?(\s*#[^\r\n]*[\r\n])*"
"""What may stand before a header: a byte-order mark, and comments."""


def is_grid(content: bytes) -> bool:
    """Tell whether a file begins as a grid does, but for comments: the ending is that of points in text, too.

    Examples
    --------
    >>> is_grid(b"ncols 4"), is_grid(b"1.0 2.0 3.0")
    (True, False)
    """
    return re.match(_BEGINNING + rb"\s*n(cols|rows)\s+[0-9]", content, re.IGNORECASE) is not None


def read_grid(content: bytes) -> Raster:
    """Read a grid.

    Parameters
    ----------
    content : bytes
        The file. Names of its header may be in any order, and in capitals.

    Returns
    -------
    Raster
        Georeferenced; -9999 means no data unless the header says otherwise.

    Raises
    ------
    ValueError
        If the file is damaged; the message says how.

    Examples
    --------
    >>> read_grid(b"ncols 3 nrows 2 cellsize 1  1 2 3")
    Traceback (most recent call last):
        ...
    ValueError: it has 3 numbers, not 3 x 2
    """
    words = re.sub(rb"\A" + _BEGINNING, b"", content).split()
    header, at = dict[str, float](), 0
    while at + 1 < len(words) and (name := words[at].decode("latin-1").lower()) in _NAMES:
        header[name] = float(as_numbers(words[at + 1 : at + 2])[0])
        at += 2
    columns, rows = header.get("ncols", 0), header.get("nrows", 0)
    cells = as_numbers(words[at:])
    if not (columns % 1 == rows % 1 == 0 and columns * rows == len(cells) > 0):
        raise ValueError(f"it has {len(cells)} numbers, not {columns:g} x {rows:g}")
    pixels = cells.reshape(int(rows), int(columns))
    return Raster(pixels, (header.get("nodata_value", _UNSAID),), georeferenced=True)
