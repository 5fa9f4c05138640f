"""Numbers in columns, as text that people write.

Examples
--------
>>> import tempfile
>>> with tempfile.TemporaryDirectory() as folder:
...     with open(f"{folder}/points.txt", "w") as file:
...         print("x;y", file=file)
...         print("1;2", file=file)
...     read_text(Path(f"{folder}/points.txt"), "points", [("x", "y")])
array([[1., 2.]])
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mexpress import _validation as check
from mexpress._validation import Floats

_NUMBER = re.compile(r"[+-]?(([0-9]+\.?[0-9]*|\.[0-9]+)(e[+-]?[0-9]+)?|nan|inf(inity)?)", re.IGNORECASE)


class _Layout(NamedTuple):
    """What the first line says of all: is it a header, how many columns are there, and which ones to take."""

    header: bool
    width: int
    chosen: list[int]
    candidates: Sequence[Sequence[str]]

    def rule(self) -> str:
        """Say what a line must have; a single candidate may be among other columns."""
        if len(self.candidates) == 1:
            return f"A line must have {self.width} columns ({', '.join(self.candidates[0])})."
        choices = (f"{len(columns)} columns ({', '.join(columns)})" for columns in self.candidates)
        return f"A line must have {' or '.join(choices)}."


def read_text(
    path: Path,
    name: str,
    layouts: Sequence[Sequence[str]],
    *,
    missing: bool = False,
    named: Sequence[Sequence[str]] = (),
) -> Floats:
    """Read lines of numbers, separated by commas, semicolons, tabs or blanks.

    Parameters
    ----------
    path : path
        Name of the file. Empty lines and those that begin with # are skipped.
    name : str
        What messages call it.
    layouts : sequence of sequences of str
        Names of the columns; the alternatives differ in their number. If the first line names all columns of
        one of them, the first such is taken and its columns are found by name, else the number of columns
        decides.
    missing : bool
        Whether cells may be NaN or infinite.
    named : sequence of sequences of str
        Layouts that come before the others, but only if the first line names all of their columns.

    Returns
    -------
    ndarray, (n, columns of the layout)
        The numbers.

    Raises
    ------
    ValueError
        If there are none, or a cell is no number; the message names the line.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with open(f"{folder}/cloud.csv", "w") as file:
    ...         print("time,z,x,y", file=file)
    ...         print("noon,3,1,2", file=file)
    ...     read_text(Path(f"{folder}/cloud.csv"), "cloud", [("u", "v", "x", "y", "z"), ("x", "y", "z")])
    array([[1., 2., 3.]])
    """
    lines = list(_lines(path, name))
    if not lines:
        check.refuse(name, "The file must have at least one line of numbers.", f"{path.name}, which has none")
    first = lines[0][1]
    separator = next((s for s in (";", "\t", ",") if s in first), None)
    layout = _layout(_split(first, separator), layouts, named)
    lines = lines[layout.header :]
    if not lines:
        check.refuse(name, "The file must have numbers below its header.", f"{path.name}, which has none")
    table = _at_once(lines, separator, layout)
    if table is None or not (missing or np.isfinite(table).all()):
        table = _one_by_one(lines, separator, layout, name, path, missing)
    return table


def _lines(path: Path, name: str) -> Iterator[tuple[int, str]]:
    """Yield the lines that hold something, and their numbers."""
    try:
        with path.open(encoding="utf-8-sig") as file:
            for number, text in enumerate(file, start=1):
                line = text.strip()
                if line and not line.startswith("#"):
                    yield number, line
    except UnicodeDecodeError:
        check.refuse(name, "A file of this ending must be text.", f"{path.name}, which is not")


def _split(line: str, separator: str | None) -> list[str]:
    return [cell.strip().strip("\"'") for cell in line.split(separator)]


def _layout(
    first: Sequence[str], layouts: Sequence[Sequence[str]], named: Sequence[Sequence[str]]
) -> _Layout:
    header = not any(_NUMBER.fullmatch(cell) for cell in first)
    names = [cell.lower() for cell in first]
    for columns in [*named, *layouts] if header else []:
        if set(columns) <= set(names):
            return _Layout(header, len(names), [names.index(column) for column in columns], [columns])
    fitting = [columns for columns in layouts if len(columns) == len(first)] or layouts
    width = len(fitting[0])
    return _Layout(header, width, list(range(width)), fitting)


def _at_once(lines: Iterable[tuple[int, str]], separator: str | None, layout: _Layout) -> Floats | None:
    """Read lines ten times as fast as one by one; None if there is anything to look at more closely."""
    try:
        table = np.loadtxt((line for _, line in lines), delimiter=separator, comments=None, ndmin=2)
    except ValueError:
        return None
    return table.take(layout.chosen, axis=1) if table.shape[1] == layout.width else None


def _one_by_one(
    lines: Sequence[tuple[int, str]],
    separator: str | None,
    layout: _Layout,
    name: str,
    path: Path,
    missing: bool,
) -> Floats:
    table = np.empty((len(lines), len(layout.chosen)))
    for row, (number, line) in zip(table, lines, strict=True):
        cells, place = _split(line, separator), f"line {number} of {path.name}"
        if len(cells) != layout.width:
            check.refuse(name, layout.rule(), f"{len(cells)} in {place}")
        row[:] = [_value(cells[column], missing, name, place) for column in layout.chosen]
    return table


def _value(cell: str, missing: bool, name: str, place: str) -> float:
    # Not float's own grammar: it reads 1_000, and digits of any script.
    value = float(cell) if _NUMBER.fullmatch(cell) else None
    if value is None or not (missing or np.isfinite(value)):
        check.refuse(name, f"Cells must be {'' if missing else 'finite '}numbers.", f"{cell!r} in {place}")
    return value
