"""Landmarks as programs save them that people mark them with: QGIS and BigWarp.

Their tables say which landmarks are in use, and have columns of their own.

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
Landmarks(columns=[2, 3, 0, 1], signs=(1, -1, 1, 1), off=array([False,  True]))
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.io.tables import Table, plain
from mexpress.io.text import TextTable


class Landmarks(NamedTuple):
    """Columns x1 y1 x2 y2 of landmarks, what to multiply them by, and which rows are not in use.

    Those of BigWarp in space have six columns.
    """

    columns: list[int]
    signs: tuple[int, int, int, int]
    off: NDArray[np.bool_]

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
        return np.column_stack([numbers[:, :4] * self.signs, numbers[:, 4:]])


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
    off = table.numbers([names.index("enable")])[:, 0] == 0
    # In QGIS the y of an image without coordinates falls from 0 at its upper edge; ours grows downwards.
    return Landmarks([names.index(name) for name in wanted], (1, -1, 1, 1), off)


def _bigwarp(table: TextTable) -> Landmarks | None:
    if table.width not in (6, 8) or table.first[1].lower() not in {"true", "false"}:
        return None
    off = np.array([word.lower() == "false" for word in table.words(1)])
    return Landmarks(list(range(2, table.width)), (1, 1, 1, 1), off)
