"""Files of matches and of points: text with numbers in columns, and numpy's archives."""

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress.placement import Array

__all__ = ["read_matches", "read_points", "write_matches", "write_points_csv"]

MATCH_COLUMNS = ("x1", "y1", "x2", "y2")
POINT_COLUMNS = ("x", "y")

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf(inity)?)", re.IGNORECASE)
_ARRAYS = {".npy", ".npz"}

Path_ = str | os.PathLike[str]


def read_matches(path: Path_) -> tuple[Array, Array]:
    """Read matched points of two images.

    Parameters
    ----------
    path : str or path
        Text: a match per line, x1 y1 x2 y2 in pixels, separated by commas, semicolons, tabs or blanks. Empty
        lines and those that begin with # are skipped. The first line may name the columns; if it names x1,
        y1, x2 and y2 they are found by name, in any order and among others. Or `.npz`: arrays `source` and
        `target`, (n, 2) each, or one (n, 4) array, which is named `matches` or `tentative` if there are
        others. Or `.npy`: one (n, 4) array.

    Returns
    -------
    source, target : ndarray, (n, 2)
        Matched points.

    Raises
    ------
    ValueError
        If the file holds no matches, or a cell is no finite number; the message names the line.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_matches(f"{folder}/matches.csv", [[0, 1], [2, 3]], [[10, 11], [12, 13.5]])
    ...     read_matches(f"{folder}/matches.csv")[1]
    array([[10. , 11. ],
           [12. , 13.5]])
    """
    path = Path(path)
    if path.suffix.lower() not in _ARRAYS:
        table = _read_text(path, "matches", MATCH_COLUMNS)
        return table[:, :2].copy(), table[:, 2:].copy()
    arrays = _read_arrays(path, "matches")
    if {"source", "target"} <= arrays.keys():
        source, target = (check.points(arrays[name], name) for name in ("source", "target"))
        if len(source) != len(target):
            rule = "It must have one point per source point."
            check.refuse("target", rule, f"{len(target)} for {len(source)} in {path.name}")
        return source, target
    rule = "It must hold arrays source and target, (n, 2), or one (n, 4) array (among several: matches)."
    table = check.points(_the_array(path, arrays, "matches", ("matches", "tentative"), 4, rule), "matches", 4)
    return table[:, :2].copy(), table[:, 2:].copy()


def read_points(path: Path_) -> Array:
    """Read points.

    Parameters
    ----------
    path : str or path
        As `read_matches` has it, with two columns: x and y. An `.npz` holds one (n, 2) array, named `points`
        if there are others.

    Returns
    -------
    ndarray, (n, 2)
        The points.

    Raises
    ------
    ValueError, OSError
        As in `read_matches`.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with open(f"{folder}/points.txt", "w") as file:
    ...         print("1 2", "3 4.5", sep="\\n", file=file)
    ...     read_points(f"{folder}/points.txt")
    array([[1. , 2. ],
           [3. , 4.5]])
    """
    path = Path(path)
    if path.suffix.lower() not in _ARRAYS:
        return _read_text(path, "points", POINT_COLUMNS)
    arrays = _read_arrays(path, "points")
    rule = "It must hold one (n, 2) array (among several: points)."
    return check.points(_the_array(path, arrays, "points", ("points",), 2, rule), "points")


def write_matches(path: Path_, source: ArrayLike, target: ArrayLike) -> None:
    """Write matches as text that `read_matches` reads, bit for bit.

    Parameters
    ----------
    path : str or path
        Name of the file.
    source, target : array_like, (n, 2)
        Matched points.

    Examples
    --------
    See `read_matches`.
    """
    rows = np.column_stack([check.points(source, "source"), check.points(target, "target")])
    with Path(path).open("w", encoding="utf-8", newline="\n") as file:
        write_rows(file, MATCH_COLUMNS, rows.tolist())


def write_points_csv(file: TextIO, points: Array, columns: Sequence[str] = POINT_COLUMNS) -> None:
    """Write points as comma-separated text, with as many digits as reading them back needs.

    Parameters
    ----------
    file : text file
        Where to write.
    points : ndarray, (n, d)
        A row per point; NaN is written as nan.
    columns : sequence of str
        Names of the d columns.

    Examples
    --------
    >>> import sys
    >>> write_points_csv(sys.stdout, np.array([[0.1, 2.0], [np.nan, 1 / 3]]))
    x,y
    0.1,2.0
    nan,0.3333333333333333
    """
    write_rows(file, columns, points.tolist())


def write_rows(file: TextIO, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a header and rows, comma-separated."""
    file.write(",".join(columns) + "\n")
    file.writelines(",".join(map(str, row)) + "\n" for row in rows)


def _read_text(path: Path, name: str, columns: Sequence[str]) -> Array:
    lines = list(_lines(path, name))
    if not lines:
        check.refuse(name, "The file must have at least one line of numbers.", f"{path.name}, which is empty")
    separator = next((s for s in (";", "\t", ",") if s in lines[0][1]), None)
    split = [(line, [cell.strip().strip("\"'") for cell in text.split(separator)]) for line, text in lines]
    first = split[0][1]
    chosen = list(range(len(columns)))
    if not any(_NUMBER.fullmatch(cell) for cell in first):
        header = [cell.lower() for cell in first]
        if set(columns) <= set(header):
            chosen = [header.index(column) for column in columns]
        split = split[1:]
        if not split:
            check.refuse(name, "The file must have numbers below its header.", f"none in {path.name}")
    width = len(first) if chosen != list(range(len(columns))) or _named(first, columns) else len(columns)
    rows = [_numbers(cells, chosen, width, f"{path.name}, line {line}", name, columns) for line, cells in split]
    return np.array(rows, dtype=np.float64)


def _named(header: Sequence[str], columns: Sequence[str]) -> bool:
    return set(columns) <= {cell.lower() for cell in header}
