"""Tables: which columns are meant, and which rows have all of their numbers.

A column is found by its name, by its number, or by the number of columns, whatever the table comes from.

Examples
--------
>>> table = ArrayTable("p.npy", "points", ["id", "src_x", "src_y"], np.array([[7, 8], [1.0, 3], [2, np.nan]]))
>>> complete(table, choose(table, [POINTS]).columns, Missing(drop=True))
(array([[1., 2.]]), array([ True, False]))
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.io.missing import Missing

AXES = (
    ("x", "y"),
    ("u", "v"),
    ("xx", "yy"),
    ("easting", "northing"),
    ("east", "north"),
    ("e", "n"),
    ("ost", "nord"),
    ("rechts", "hoch"),
    ("rechtswert", "hochwert"),
    ("longitude", "latitude"),
    ("long", "lat"),
    ("lon", "lat"),
    ("lng", "lat"),
    ("column", "row"),
    ("col", "row"),
    ("c", "r"),
    ("sample", "line"),
)
"""Names of x and y that belong together."""
_EITHER = (("i", "j"), ("j", "i"))
"""Axes of which some take the first for x, and some for y."""
_COUNTED = re.compile(r"[cren]\d*|(col|column|row|line|sample)\d+")
"""Names that say something of their axis only beside those of the other one: columns may be counted so."""
_HEIGHTS = ("z", "depth", "height", "elevation", "elev", "altitude", "value")
_SIDES = (
    *(
        (f"{what}{a}", f"{what}{b}")
        for a, b in ("12", "01", "ab")
        for what in ("", "p", "pt", "im", "img", "image")
    ),
    ("source", "target"),
    ("src", "dst"),
    ("source", "destination"),
    ("source", "dest"),
    ("source", "map"),
    ("pixel", "map"),
    ("moving", "fixed"),
    ("from", "to"),
    ("left", "right"),
    ("query", "train"),
    ("before", "after"),
    ("old", "new"),
    ("pre", "post"),
)
_LETTERS = ("s", "t"), ("s", "d"), ("m", "f"), ("q", "t"), ("l", "r")
"""Sides that are so called only where all four columns are: columns sx, sy are deviations as well."""
SWITCHES = {"enable", "enabled", "active"}
"""Names of the column that says which rows are in use."""
_NO_COORDINATES = {
    *SWITCHES,
    *("id", "index", "idx", "no", "nr", "number", "point", "pointid", "name", "label", "time", "timestamp"),
    *("weight", "weights", "score", "confidence", "sigma", "error"),
}


class Layout(NamedTuple):
    """Columns that belong together: what we call them, what others do, and whether they may go without names."""

    columns: tuple[str, ...]
    spellings: Sequence[tuple[str, ...]]
    nameless: bool = True


def _beside(side: str, axis: str) -> tuple[str, str]:
    return axis + side, side + axis


_PAIRED = [
    names
    for sides in _SIDES
    for axes in AXES
    for names in zip(*(_beside(side, axis) for side in sides for axis in axes), strict=True)
]
MATCHES = Layout(
    ("x1", "y1", "x2", "y2"),
    [
        *_PAIRED,
        *(names for a, b in _LETTERS for names in zip(*map(_beside, (a, a, b, b), "xyxy"), strict=True)),
    ],
)
POINTS = Layout(("x", "y"), [*AXES, *sorted({pair for names in _PAIRED for pair in (names[:2], names[2:])})])
XYZ = Layout(("x", "y", "z"), [(*axes, height) for axes in AXES for height in _HEIGHTS])
UVXYZ = Layout(("u", "v", "x", "y", "z"), [("u", "v", "x", "y", "z")], nameless=False)


_KNOWN = _NO_COORDINATES.union(*(names for one in (MATCHES, POINTS, XYZ, UVXYZ) for names in one.spellings))


def count_known(names: Sequence[str]) -> int:
    """Count the names that say what is in a column.

    Examples
    --------
    >>> count_known(["Source_X [px]", "colour"])
    1
    """
    return sum(plain(name) in _KNOWN for name in names)


class Table(Protocol):
    """Rows of cells, and what is known of its columns."""

    @property
    def where(self) -> str:
        """Name of the file, for messages."""

    @property
    def name(self) -> str:
        """What messages call what is read."""

    @property
    def names(self) -> Sequence[str]:
        """Names of all columns as the header has them, "" for none; no entries without a header."""

    @property
    def width(self) -> int:
        """Number of columns."""

    @property
    def numeric(self) -> Sequence[int]:
        """The columns between those of text at either end, which are labels."""

    def numbers(self, columns: Sequence[int]) -> Floats:
        """Return columns, (rows, columns), NaN where there is no number; refuse text."""

    def place(self, row: int, column: int) -> str:
        """Say what is in a cell, and where that is."""


class Choice(NamedTuple):
    """Columns of a table in the order of a layout, and that of the weights, if any."""

    layout: Layout
    columns: list[int]
    weight: int | None

    @property
    def all(self) -> list[int]:
        """The columns, the weights last."""
        return self.columns if self.weight is None else [*self.columns, self.weight]


def plain(name: str) -> str:
    """Return a column's name in small letters and digits, without a unit in brackets.

    Examples
    --------
    >>> plain("Source_X [px]")
    'sourcex'
    """
    return re.sub(r"\(.*\)|\[.*\]|[^a-z0-9]", "", name.lower())


def choose(
    table: Table,
    layouts: Sequence[Layout],
    columns: Sequence[str | int] | None = None,
    weight: str | int | None = None,
    *,
    first: bool = False,
    more: str = "",
) -> Choice:
    """Choose columns: those that are told, else those that the header names, else all, if their number fits.

    Parameters
    ----------
    table : Table
        Where to choose.
    layouts : sequence of Layout
        What may be there; of those that the header names, the first is taken.
    columns : sequence of str or int, optional
        Names, or numbers from 1, as many as one of the layouts has.
    weight : str or int, optional
        Name or number of the weights, if they are there; these are none of the others.
    first : bool
        Whether columns without known names may be more than the layout has.
    more : str
        What else to say if it is not clear which columns are meant.

    Raises
    ------
    ValueError
        If it is not clear which columns are meant.

    Examples
    --------
    >>> table = ArrayTable.of(np.ones((9, 5)), "m.npy", "matches")
    >>> choose(table, [MATCHES], [2, 3, 4, 5]).columns
    [1, 2, 3, 4]
    """
    weights = None if weight is None else find(table, weight)
    if columns is not None:
        return Choice(*_told(table, layouts, columns), weights)
    for layout in layouts:
        if found := _named(table, layout):
            return Choice(layout, found, weights)
    aside = {k for k, name in enumerate(table.names) if plain(name) in SWITCHES} | {weights}
    free = [k for k in table.numeric if k not in aside and not (k == 0 and _is_index(table.names))]
    for layout in layouts:
        n = len(layout.columns)
        fits = n == len(free) or (first and n < len(free))
        if fits and layout.nameless and not (table.names and _contradicts(table, free[:n], layout)):
            return Choice(layout, free[:n], weights)
    names = f" ({', '.join(table.names[k] or 'unnamed' for k in free)})" if table.names and free else ""
    text = next((f", besides {table.place(0, k)}" for k in range(table.width) if k not in table.numeric), "")
    headed = [table.names[k] for k in free] if table.names else []
    might = next(
        filter(None, (_unclear(headed[: len(one.columns)], one) for one in layouts if one.nameless)), ""
    )
    might = might or _readings(layouts, len(free))
    given = f"{len(free)} columns{names}{might} in {table.where}{text}"
    check.refuse(table.name, _rule(layouts) + more, given)


def _named(table: Table, layout: Layout) -> list[int] | None:
    """Return the columns that the header names: by our own names for them, else by the only other ones that fit."""
    names = [plain(name) for name in table.names]
    fits = [spelling for spelling in layout.spellings if set(spelling) <= set(names)]
    if not fits:
        return None
    if fits[0] != layout.columns and len(fits) > 1:
        readings = " or ".join(", ".join(spelling) for spelling in fits)
        check.refuse(table.name, _rule([layout]), f"{readings} in {table.where}")
    if twice := [name for name in fits[0] if names.count(name) > 1]:
        rule = (
            "Names must be of one column each; else say which are meant by their numbers from 1, such as "
            f"{_numbers(layout)}."
        )
        check.refuse(table.name, rule, f"{twice[0]} twice in {table.where}")
    return [names.index(name) for name in fits[0]]


def _contradicts(table: Table, columns: Sequence[int], layout: Layout) -> bool:
    """Whether a header says, or may say, that its columns are not these, in this order."""
    names = [table.names[column] for column in columns]
    if _unclear(names, layout):
        return True
    known = [{spelling[k] for spelling in layout.spellings} for k in range(len(columns))]
    others = {word for word in _NO_COORDINATES.union(*known) if not _COUNTED.fullmatch(word)}
    return any(plain(name) in others - here for name, here in zip(names, known, strict=True))


def _unclear(names: Sequence[str], layout: Layout) -> str:
    """Say which column may be meant instead of the first, or of one with it, if names contradict the order."""
    plain_names = [plain(name) for name in names]
    pairs: list[tuple[int, int, Sequence[tuple[str, str]]]]
    pairs = [(k, k + 1, (*AXES, *_EITHER)) for k in range(0, len(names) - 1, 2)]
    if layout is MATCHES:
        pairs += [(k, k + 2, _SIDES) for k in range(len(names) - 2)]
    return next(
        (
            f", where {layout.columns[k]} may be {names[k]} or {names[other]},"
            for k, other, words in pairs
            if _is_swapped(plain_names[k], plain_names[other], words)
        ),
        "",
    )


def _is_swapped(name: str, other: str, pairs: Sequence[tuple[str, str]]) -> bool:
    """Whether a name differs from another in nothing but that it has the second word of a pair for the first.

    Examples
    --------
    >>> _is_swapped("ymin", "xmin", [("x", "y")]), _is_swapped("xmin", "ymin", [("x", "y")])
    (True, False)
    """
    return any(
        other in (name[: at.start()] + first + name[at.end() :], name.replace(second, first))
        for first, second in pairs
        for at in re.finditer(second, name)
    )


def _is_index(names: Sequence[str]) -> bool:
    """Whether the first column has no name, as row names that pandas and R write, among others that have."""
    return len(names) > 1 and names[0] in {"", "Unnamed: 0"} and bool(names[1])


def _rule(layouts: Sequence[Layout]) -> str:
    named = " or ".join(", ".join(layout.columns) for layout in layouts)
    nameless = next(layout for layout in layouts if layout.nameless)
    return (
        f"It must have {len(nameless.columns)} columns ({', '.join(nameless.columns)}), or a header that names {named}"
        f"; else say which columns are meant, by name or by number from 1, such as {_numbers(nameless)}."
    )


def _numbers(layout: Layout) -> str:
    """Write how columns are told by number."""
    return f"columns={list(range(1, len(layout.columns) + 1))}"


def _readings(layouts: Sequence[Layout], width: int) -> str:
    """Name what so many columns without names might be."""
    might = [" ".join(layout.columns) for layout in layouts if len(layout.columns) <= width]
    return f", which may be {' or '.join(might)} and others," if len(might) > 1 else ""


def _told(table: Table, layouts: Sequence[Layout], columns: Any) -> tuple[Layout, list[int]]:
    entries = check.items(columns, "columns", "It must be a list of names, or of numbers from 1.")
    layout = next((layout for layout in layouts if len(layout.columns) == len(entries)), None)
    if layout is None:
        counts = " or ".join(f"{len(one.columns)} ({', '.join(one.columns)})" for one in layouts)
        check.refuse("columns", f"They must be {counts}.", f"{len(entries)}, {', '.join(map(str, entries))}")
    found = [k for k in (find(table, entry) for entry in entries) if k is not None]
    if len(set(found)) < len(entries):
        there = (
            f"the columns {', '.join(map(repr, table.names))}"
            if table.names
            else f"{table.width} columns without names"
        )
        rule = "They must be different columns of the file, by name or by number from 1."
        check.refuse("columns", rule, f"{', '.join(map(str, entries))} for {there} in {table.where}")
    return layout, found


def find(table: Table, column: Any) -> int | None:
    """Return the column of a name, as it is written or nearly so, or of a number from 1; None if there is none.

    Examples
    --------
    >>> table = ArrayTable("p.npy", "points", ["Score", "x"], np.ones((2, 9)))
    >>> find(table, "score"), find(table, 2), find(table, "2"), find(table, "y")
    (0, 1, 1, None)
    """
    if isinstance(column, str):
        for form in (str, plain):
            fits = [k for k, name in enumerate(table.names) if form(name) == form(column) != ""]
            if fits:
                return fits[0] if len(fits) == 1 else None
        if not (column.isascii() and column.isdecimal()):
            return None
        column = int(column)
    number = check.count(column, "columns", 1)
    return number - 1 if number <= table.width else None


def complete(
    table: Table,
    columns: Sequence[int],
    missing: Missing,
    off: NDArray[np.bool_] | None = None,
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the rows of columns that have all of their numbers, and which of all rows these are.

    Parameters
    ----------
    table : Table
        Where they are.
    columns : sequence of int
        The columns.
    missing : Missing
        What means no data. Rows with such values are left out; others that are not finite are an error, unless they
        are to be dropped too, or kept: then all rows are returned, those that are incomplete as NaN.
    off : (rows,) array of bool, optional
        Rows that are left out because the file says so.

    Raises
    ------
    ValueError
        If a cell is text, or missing; the message names its row and the remedy. If there are no rows, unless all are
        kept.

    Examples
    --------
    >>> table = ArrayTable.of([[1.0, 2], [3, np.nan], [5, -1]], "p.npy", "points")
    >>> complete(table, [0, 1], Missing.of(["keep", -1]))[0].tolist()
    [[1.0, 2.0], [nan, nan], [nan, nan]]
    """
    numbers = table.numbers(columns)
    gone = np.asarray(missing.told(numbers).any(axis=1))
    if off is not None:
        gone |= off
    holes = ~np.isfinite(numbers) & ~gone[:, None]
    if not (missing.drop or missing.keep) and holes.any():
        row, column = np.argwhere(holes)[0]
        rule = 'Cells must be finite numbers; missing="drop" leaves out the rows of others.'
        check.refuse(table.name, rule, table.place(int(row), columns[column]))
    gone |= holes.any(axis=1)
    if missing.keep:
        numbers[gone] = np.nan
        return numbers, ~gone
    if not len(gone):
        check.refuse(table.name, "It must have rows.", f"{table.where}, which has none")
    if gone.all():
        check.refuse(
            table.name,
            "One row at least must have all of its numbers.",
            f"none of {len(gone)} in {table.where}",
        )
    return numbers[~gone], ~gone


@dataclass(frozen=True, eq=False)
class ArrayTable:
    """A table of arrays or of a frame of pandas or polars.

    Parameters
    ----------
    where, name : str
        What messages call where it comes from, and what is read.
    names : sequence of str
        Names of the columns, if they have some.
    arrays : sequence of (rows,) arrays
        The columns.
    """

    where: str
    name: str
    names: Sequence[str]
    arrays: Sequence[NDArray[Any]]

    @classmethod
    def of(cls, array: ArrayLike, where: str, name: str) -> Self:
        """Return the table of a 2-D array, or of one with fields, which have names."""
        array = np.asarray(array)
        if array.dtype.names and array.ndim == 1:
            return cls(where, name, array.dtype.names, [array[field] for field in array.dtype.names])
        rule = "It must be an array of real numbers with rows and columns."
        array = check.as_rows(check.array(array, name, rule, "biuf"))
        if array.ndim != 2:
            check.refuse(name, rule, f"shape {array.shape} in {where}")
        return cls(f"{where} of shape {array.shape}", name, (), list(array.T))

    @classmethod
    def of_frame(cls, frame: Any, where: str, name: str) -> Self:
        """Return the table of a frame, as pandas, polars and pyarrow have them: columns by their names.

        Examples
        --------
        >>> import pandas as pd
        >>> ArrayTable.of_frame(pd.DataFrame({"x": [1.5, None]}), "the frame", "points").numbers([0]).tolist()
        [[1.5], [nan]]
        """
        names = list(getattr(frame, "column_names", frame.columns))
        return cls(where, name, tuple(map(str, names)), [np.asarray(frame[key].to_numpy()) for key in names])

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.arrays)

    @property
    def numeric(self) -> Sequence[int]:
        """The columns between those of text at either end."""
        return between_labels([self._is_text(array) for array in self.arrays])

    @staticmethod
    def _is_text(array: NDArray[Any]) -> bool:
        objects = array.tolist() if array.dtype.kind == "O" else []
        return array.dtype.kind in "UST" or any(isinstance(cell, str) for cell in objects)

    def numbers(self, columns: Sequence[int]) -> Floats:
        """Return columns, NaN where there is no number; refuse text."""
        return np.column_stack([self._column(k) for k in columns])

    def _column(self, k: int) -> Floats:
        array = self.arrays[k]
        if array.dtype.kind == "O":
            array = np.array([np.nan if _is_nothing(cell) else cell for cell in array.tolist()])
        if array.dtype.kind not in "biuf" or array.ndim != 1:
            kind = "text" if array.dtype.kind == "U" else f"{array.dtype}"
            given = f"{kind} in column {self.names[k] if self.names else k + 1} of {self.where}"
            check.refuse(self.name, "Columns must hold numbers.", given)
        return array.astype(np.float64)

    def place(self, row: int, column: int) -> str:
        """Say what is in a cell, and where that is."""
        return f"{self.arrays[column][row]} at row {row} of {self.where}"


def _is_nothing(cell: Any) -> bool:
    return cell is None or type(cell).__name__ in {"NAType", "NaTType"}  # of pandas


def between_labels(text: Sequence[bool]) -> range:
    """Return the columns between those of text at either end.

    Examples
    --------
    >>> between_labels([True, False, False, True, True])
    range(1, 3)
    """
    columns = [k for k, is_text in enumerate(text) if not is_text]
    return range(columns[0], columns[-1] + 1) if columns else range(0)
