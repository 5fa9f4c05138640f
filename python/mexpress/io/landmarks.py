"""Landmarks as programs save them that people mark them with: QGIS and BigWarp.

Their tables have columns of their own, and say which landmarks are in use, as tables of any program may.

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
Landmarks(columns=[2, 3, 0, 1], signs=(1, -1, 1, 1))
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.io.tables import SWITCHES, Table, plain
from mexpress.io.text import TextTable

_OFF, _ON = {"0", "0.0", "false", "no", "off"}, {"1", "1.0", "true", "yes", "on"}


class Landmarks(NamedTuple):
    """Columns x1 y1 x2 y2 of landmarks, and what to multiply them by.

    Those of BigWarp in space have six columns.
    """

    columns: list[int]
    signs: tuple[int, int, int, int]

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
    # In QGIS the y of an image without coordinates falls from 0 at its upper edge; ours grows downwards.
    return Landmarks([names.index(name) for name in wanted], (1, -1, 1, 1))


def _bigwarp(table: TextTable) -> Landmarks | None:
    if table.width not in (6, 8) or table.first[1].lower() not in {"true", "false"}:
        return None
    return Landmarks(list(range(2, table.width)), (1, 1, 1, 1))


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
