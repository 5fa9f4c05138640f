"""Landmarks as programs save them that people mark them with: QGIS and BigWarp; and into files of QGIS and GDAL.

Their tables have columns of their own, and say which landmarks are in use, as tables of any program may. QGIS and GDAL
count pixels from the corner of the first one, half a pixel before its centre, where our points have 0.

Examples
--------
>>> import tempfile
>>> from pathlib import Path
>>> from mexpress.io.text import read_text
>>> with tempfile.TemporaryDirectory() as folder:
...     with open(f"{folder}/scan.points", "w") as file:
...         print("mapX,mapY,sourceX,sourceY,enable", file=file)
...         print("500000,4000000,12,-34,1", file=file)
...         print("500900,4000000,90,-34,0", file=file)
...     landmarks(read_text(Path(f"{folder}/scan.points"), "matches"))
Landmarks(columns=[2, 3, 0, 1], signs=(1, -1, 1, 1), origin=0.5)
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.io.archives import replacing
from mexpress.io.tables import SWITCHES, Table, plain
from mexpress.io.text import TextTable

_CORNER = 0.5
"""Where QGIS and GDAL have the centre of the first pixel."""

_OFF, _ON = {"0", "0.0", "false", "no", "off"}, {"1", "1.0", "true", "yes", "on"}


class Landmarks(NamedTuple):
    """Columns x1 y1 x2 y2 of landmarks, what to multiply them by, and where x1 y1 then have the first pixel's centre.

    Those of BigWarp in space have six columns.
    """

    columns: list[int]
    signs: tuple[int, int, int, int]
    origin: float

    def in_image(self, numbers: Floats, table: Table) -> Floats:
        """Return numbers (n, 4 or more) of the columns with y downwards; refuse those that are no pixels of images."""
        if len(self.columns) == 6:
            rule = "Landmarks of BigWarp must have two dimensions."
            check.refuse(table.name, rule, f"three in {table.where}")
        above = numbers[:, 1][numbers[:, 1] > 0]
        if self.signs[1] < 0 and above.size:
            names = [table.names[column] for column in self.columns]
            rule = (
                f"{names[1]} must be at most 0, as QGIS counts in an image without coordinates; that of an image with "
                f"coordinates is read as it is with columns={names!r}."
            )
            check.refuse(table.name, rule.replace("'", '"'), f"{above[0]:g} in {table.where}")
        moved = numbers[:, :4] * self.signs - [self.origin, self.origin, 0, 0]
        return np.column_stack([moved, numbers[:, 4:]])


def landmarks(table: Table) -> Landmarks | None:
    """Return where the landmarks of QGIS or BigWarp are in a table, if it is of one of them.

    Parameters
    ----------
    table : Table
        Of any program.

    Examples
    --------
    >>> from mexpress.io.tables import ArrayTable
    >>> landmarks(ArrayTable.of(np.ones((9, 4)), "m.npy", "matches"))
    """
    return _qgis(table) or (_bigwarp(table) if isinstance(table, TextTable) and not table.names else None)


def _qgis(table: Table) -> Landmarks | None:
    names = [plain(name) for name in table.names]
    source = "pixel" if "pixelx" in names else "source"  # before QGIS 3.26, and since
    wanted = [f"{source}x", f"{source}y", "mapx", "mapy"]
    if not {*wanted, "enable"} <= set(names):
        return None
    # In QGIS the y of an image without coordinates falls from 0 at its upper edge; ours grows downwards.
    return Landmarks([names.index(name) for name in wanted], (1, -1, 1, 1), _CORNER)


def _bigwarp(table: TextTable) -> Landmarks | None:
    if table.width not in (6, 8) or table.first[1].lower() not in {"true", "false"}:
        return None
    return Landmarks(list(range(2, table.width)), (1, 1, 1, 1), 0.0)


def out_of_use(table: Table) -> NDArray[np.bool_] | None:
    """Return which rows are not in use, (rows,), or None if the table does not say it.

    Parameters
    ----------
    table : Table
        Of any program: its header may have one of the names enable, enabled and active.

    Raises
    ------
    ValueError
        If a cell of that column is neither yes nor no.

    Examples
    --------
    >>> from mexpress.io.tables import ArrayTable
    >>> out_of_use(ArrayTable("m.npy", "matches", ["x", "y", "enabled"], np.eye(3)))
    array([ True,  True, False])
    """
    column = next((k for k, name in enumerate(table.names) if plain(name) in SWITCHES), None)
    if column is None and isinstance(table, TextTable) and _bigwarp(table):
        column = 1
    if column is None:
        return None
    if not isinstance(table, TextTable):
        return np.asarray(table.numbers([column])[:, 0] == 0)
    words = [word.lower() for word in table.words(column)]
    for row, word in enumerate(words):
        if word not in _OFF | _ON:
            rule = (
                "What is in use must be 0 or 1, or true or false; call a column for something else otherwise."
            )
            check.refuse(table.name, rule, table.place(row, column))
    return np.array([word in _OFF for word in words], dtype=np.bool_)


def write_landmarks(
    path: str | os.PathLike[str], source: ArrayLike, target: ArrayLike, *, crs: str | None = None
) -> None:
    """Write matches of an image and a map as ground control points of QGIS or GDAL.

    Parameters
    ----------
    path : str or path
        Name of the file; an existing one is replaced once the new one is complete. Its ending tells the program:

        * `.points`: QGIS's Georeferencer loads it. `mexpress.io.read_matches` reads it back.
        * `.txt`: options of GDAL, `gdal_translate --optfile gcps.txt photo.jpg photo.tif`; then
          `gdalwarp -tps photo.tif map.tif`.
    source : array_like, (n, 2)
        Points of the image in pixels, x then y, 0 at the centre of the first pixel. Both programs count from that
        pixel's corner, so that half a pixel is added.
    target : array_like, (n, 2)
        Their coordinates on the map, x (easting) then y (northing).
    crs : str, optional
        Reference system of the map, as the programs take it: "EPSG:32633", or its WKT.

    Raises
    ------
    ValueError, TypeError
        If the points are not as many in either place, or the path has another ending; or if a point for QGIS is above
        the image, as points of images with coordinates are.
    OSError
        If the file cannot be written; an existing file is then unchanged.

    Notes
    -----
    GDAL's ``-tps`` is a thin-plate spline through the points. Through the control points of a warp without a
    denominator, and their images, it is the warp itself: ``write_landmarks(path, warp.control_points,
    warp(warp.control_points))`` hands a smooth warp to GDAL, and the noise of the matches stays behind.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_landmarks(f"{folder}/gcps.txt", [[0, 9]], [[500000, 4000000]], crs="EPSG:32633")
    ...     print(Path(f"{folder}/gcps.txt").read_text(), end="")
    -a_srs "EPSG:32633"
    -gcp 0.5 9.5 500000.0 4000000.0
    """
    pixels, places = check.points(source, "source") + _CORNER, check.points(target, "target")
    check.as_many(places, pixels)
    if not (crs is None or (isinstance(crs, str) and crs.strip())):
        rule = 'It must be a name such as "EPSG:32633", or WKT.'
        check.refuse("crs", rule, check.describe(crs), ValueError if isinstance(crs, str) else TypeError)
    system = None if crs is None else " ".join(crs.split())
    ending = check.path(path).suffix.lower()
    if ending not in _WRITTEN:
        check.refuse("path", "It must end in .points or .txt.", check.describe(os.fspath(path)))
    if ending == ".points" and (pixels[:, 1] < 0).any():
        rule = "y must be at least -0.5 for QGIS, the upper edge of the image: it grows downwards."
        check.refuse("source", rule, f"{pixels[:, 1].min() - _CORNER:g}")
    lines = _WRITTEN[ending](np.column_stack([pixels, places]), system)
    with replacing(path) as file:
        file.write("".join(f"{line}\n" for line in lines).encode())


def _for_qgis(rows: Floats, crs: str | None) -> Iterator[str]:
    if crs is not None:
        yield f"#CRS: {crs}"
    yield "mapX,mapY,sourceX,sourceY,enable,dX,dY,residual"
    for column, line, x, y in rows.tolist():
        yield f"{x},{y},{column},{-line},1,0,0,0"


def _for_gdal(rows: Floats, crs: str | None) -> Iterator[str]:
    if crs is not None:
        yield '-a_srs "{}"'.format(crs.replace("\\", "\\\\").replace('"', '\\"'))
    for column, line, x, y in rows.tolist():
        yield f"-gcp {column} {line} {x} {y}"


_WRITTEN = {".points": _for_qgis, ".txt": _for_gdal}
