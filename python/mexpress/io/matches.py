"""Files of matches and of points: text with numbers in columns, and numpy's archives.

Examples
--------
>>> import sys
>>> write_points_csv(sys.stdout, np.array([[320.0, 240.5]]))
x,y
320.0,240.5
"""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.io.archives import ARCHIVES, read_arrays
from mexpress.io.text import read_text

MATCH_COLUMNS = ("x1", "y1", "x2", "y2")
POINT_COLUMNS = ("x", "y")

WEIGHT_COLUMN, WEIGHT_ARRAY = "weight", "weights"
"""What weights are called in a text and in an archive, unless a name is given."""

Path_ = str | os.PathLike[str]


def read_matches(path: Path_) -> tuple[Floats, Floats]:
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
    if path.suffix.lower() not in ARCHIVES:
        return _halves(read_text(path, "matches", [MATCH_COLUMNS]))
    return _from_archive(read_arrays(path, "matches"), path)


def read_weighted_matches(path: Path_, column: str | None = None) -> tuple[Floats, Floats, Floats | None]:
    """Read matched points of two images, and their weights if the file has some.

    Parameters
    ----------
    path : str or path
        As for `read_matches`.
    column : str, optional
        Name of the weights: of a column that the first line of a text names, or of an (n,) array in an `.npz`. By
        default they are called `weight` in a text and `weights` in an `.npz`, and a file need not have any.

    Returns
    -------
    source, target : ndarray, (n, 2)
        Matched points.
    weights : ndarray, (n,), or None
        Their weights.

    Raises
    ------
    ValueError, OSError
        As in `read_matches`, or if the file has no column of a given name.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with open(f"{folder}/matches.csv", "w") as file:
    ...         print("x1,y1,x2,y2,score", file=file)
    ...         print("1,2,3,4,0.9", file=file)
    ...     read_weighted_matches(f"{folder}/matches.csv", "score")
    (array([[1., 2.]]), array([[3., 4.]]), array([0.9]))
    """
    path = Path(path)
    if path.suffix.lower() not in ARCHIVES:
        named = (*MATCH_COLUMNS, (column or WEIGHT_COLUMN).lower())
        table = read_text(path, "matches", [MATCH_COLUMNS], named=[named])
        weights = table[:, 4].copy() if table.shape[1] > len(MATCH_COLUMNS) else None
        return *_halves(table), named_weights(weights, column, path)
    arrays = read_arrays(path, "matches")
    weights = named_weights(arrays.pop(column or WEIGHT_ARRAY, None), column, path)
    source, target = _from_archive(arrays, path)
    return source, target, None if weights is None else check.real(weights, "weights")


def named_weights(weights: Any, column: str | None, path: Path) -> Any:
    """Return weights that were found, or None; refuse the name of a column that was not.

    Examples
    --------
    >>> named_weights(None, None, Path("matches.csv"))
    """
    if weights is None and column is not None:
        rule = "The first line of a text, or an archive, must have this name."
        check.refuse("weights", rule, f"{column!r}, which is not in {path.name}")
    return weights


def _halves(table: Floats) -> tuple[Floats, Floats]:
    return table[:, :2].copy(), table[:, 2:4].copy()


def _from_archive(arrays: dict[str, NDArray[Any]], path: Path) -> tuple[Floats, Floats]:
    if {"source", "target"} <= arrays.keys():
        source, target = (check.points(arrays[name], name) for name in ("source", "target"))
        if len(source) != len(target):
            rule = "It must have one point per source point."
            check.refuse("target", rule, f"{len(target)} for {len(source)} in {path.name}")
        return source, target
    what = "arrays source and target, (n, 2), or one (n, 4) array (among several: matches)"
    rule = f"{path.name} must hold {what}."
    return _halves(check.points(_the_array(arrays, ("matches", "tentative"), 4, rule), "matches", 4))


def read_points(path: Path_) -> Floats:
    """Read points.

    Parameters
    ----------
    path : str or path
        As `read_matches` has it, with two columns: x and y. An `.npz` holds one (n, 2) array, named `points`
        if there are others.

    Returns
    -------
    ndarray, (n, 2)
        The points; NaN in the rows of those that are not known, as results of `mexpress apply` have them.

    Raises
    ------
    ValueError, OSError
        As in `read_matches`.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with open(f"{folder}/points.txt", "w") as file:
    ...         print("1 2", file=file)
    ...         print("3 4.5", file=file)
    ...     read_points(f"{folder}/points.txt")
    array([[1. , 2. ],
           [3. , 4.5]])
    """
    path = Path(path)
    if path.suffix.lower() not in ARCHIVES:
        return check.queries(read_text(path, "points", [POINT_COLUMNS], missing=True), "points")
    arrays = read_arrays(path, "points")
    rule = f"{path.name} must hold one (n, 2) array (among several: points)."
    return check.queries(_the_array(arrays, ("points",), 2, rule), "points")


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
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_matches(f"{folder}/matches.csv", [[0, 1]], [[10, 13.5]])
    ...     read_matches(f"{folder}/matches.csv")
    (array([[0., 1.]]), array([[10. , 13.5]]))
    """
    rows = np.column_stack([check.points(source, "source"), check.points(target, "target")])
    with Path(path).open("w", encoding="utf-8", newline="\n") as file:
        write_rows(file, MATCH_COLUMNS, rows.tolist())


def write_points_csv(file: TextIO, points: Floats, columns: Sequence[str] = POINT_COLUMNS) -> None:
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


def _the_array(arrays: dict[str, NDArray[Any]], known: Sequence[str], width: int, rule: str) -> NDArray[Any]:
    """Return the array that has a known name, or the only one."""
    named = [key for key in known if key in arrays] or list(arrays)
    shaped = [key for key in named if arrays[key].ndim == 2 and arrays[key].shape[1] == width]
    if len(named) != 1 or len(shaped) != 1:
        there = ", ".join(f"{key} {arrays[key].shape}" for key in arrays) or "no arrays"
        check.refuse(known[0], rule, there)
    return arrays[named[0]]
