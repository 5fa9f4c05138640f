"""Matches and points from files and frames, and into files.

Examples
--------
>>> import sys
>>> write_points_csv(sys.stdout, np.array([[320.0, 240.5]]))
x,y
320.0,240.5
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.io.archives import read_data
from mexpress.io.keypoints import index_pairs
from mexpress.io.landmarks import landmarks, out_of_use
from mexpress.io.missing import Missing
from mexpress.io.placeholders import note_placeholders
from mexpress.io.sources import Source, expect_source, is_frame, read_table, where
from mexpress.io.tables import MATCHES, POINTS, ArrayTable, Table, choose, complete, find

WEIGHT_COLUMN, WEIGHT_ARRAY = "weight", "weights"
"""What weights are called in a text and in an archive, unless a name is given."""


_MATCHED = ("source", "target"), ("mkpts0", "mkpts1")
"""Names of arrays of matched points, ours and those of LoFTR."""


class WeightedMatches(NamedTuple):
    """Matched points (n, 2) of two images, their weights (n,) or None, and which rows of the file these are."""

    source: Floats
    target: Floats
    weights: Floats | None
    known: NDArray[np.bool_]


def read_matches(
    path: Source, *, columns: Sequence[str | int] | None = None, missing: Any = None
) -> tuple[Floats, Floats]:
    """Read matched points of two images.

    Parameters
    ----------
    path : path or frame
        Where they are: a row per match, with columns x1 y1 x2 y2 in pixels.

        * Text: cells separated by commas, semicolons, tabs or blanks, in UTF-8, UTF-16 or Latin-1; with decimal commas
          unless these separate. Lines that begin with #, % or // are comments, and so is what follows a blank and #.
          Words before and after the numbers are labels. "-" is standard input.
        * `.npy`: one (n, 4) array, or one with fields. `.npz`: arrays `source` and `target`, or `mkpts0` and `mkpts1`,
          (n, 2) each; or one array as in `.npy`, which is named `matches` or `tentative` if there are others; or those
          of a matcher, `keypoints0`, `keypoints1`, and `matches` or `matches0`, see `mexpress.io.keypoints.matches_of`.
        * `.parquet`, with the extra ``parquet``.
        * A frame of pandas or polars.
        * Landmarks of QGIS (`.points`) and BigWarp, without those that are not enabled or active. Images of QGIS have a
          y that is negative below their upper edge, and count from the first pixel's corner; the source has y downwards
          and 0 at that pixel's centre. Images with coordinates need `columns`. Rows of any table whose column `enable`,
          `enabled` or `active` is 0 or false are left out.

        A header finds the columns in any order and among others, by these names or by those such as src_x, sourceX,
        x_left, u0, moving_x. Columns of no known name must be four.
    columns : sequence of str or int, optional
        The four columns, by name or by number from 1, as they are.
    missing : float, "drop", "keep", or a sequence of these, optional
        Numbers that mean no data: their rows are left out. "drop" also leaves out rows with cells that are empty, NA,
        NaN or infinite, which otherwise are an error; "keep" keeps all rows, those with something missing as NaN.

    Returns
    -------
    source, target : ndarray, (n, 2)
        Matched points. A `UserWarning` says if one constant lies so far outside of all other coordinates that it seems
        to mean no data.

    Raises
    ------
    ValueError, TypeError
        If it is not clear which columns are meant, or a cell is no finite number; the message names its line.
    ImportError
        If the file needs an extra that is not installed.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with open(f"{folder}/matches.csv", "w") as file:
    ...         print("id;src_x;src_y;dst_x;dst_y", file=file)
    ...         print("7;0,5;1;10;11", file=file)
    ...         print("8;2;;12;13", file=file)
    ...     read_matches(f"{folder}/matches.csv", missing="drop")
    (array([[0.5, 1. ]]), array([[10., 11.]]))
    """
    return _read(path, None, columns, missing)[:2]


def read_weighted_matches(
    path: Source,
    column: str | int | None = None,
    *,
    columns: Sequence[str | int] | None = None,
    missing: Any = None,
) -> WeightedMatches:
    """Read matched points of two images, and their weights if the file has some.

    Parameters
    ----------
    path : path or frame
        As for `read_matches`.
    column : str or int, optional
        Name of the weights: of a column, or its number from 1, or of an array in an `.npz`. By default they are called
        `weight` in a table and `weights` in an `.npz`, and a file need not have any.
    columns, missing
        As for `read_matches`.

    Returns
    -------
    WeightedMatches
        `source` and `target`, (n, 2), `weights`, (n,) or None, and `known`, (rows,): which rows of the file these are,
        since some may be left out. Warns as `read_matches` does.

    Raises
    ------
    ValueError, TypeError, ImportError, OSError
        As in `read_matches`, or if the file has no column of a given name.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with open(f"{folder}/matches.csv", "w") as file:
    ...         print("x1,y1,x2,y2,score", file=file)
    ...         print("1,2,3,4,0.9", file=file)
    ...     read_weighted_matches(f"{folder}/matches.csv", "score")
    WeightedMatches(source=array([[1., 2.]]), target=array([[3., 4.]]), weights=array([0.9]), known=array([ True]))
    """
    return _read(path, column, columns, missing)


def _read(
    path: Source, column: str | int | None, columns: Sequence[str | int] | None, missing: Any
) -> WeightedMatches:
    expect_source(path, "matches")
    table, weight = _match_table(path, column)
    told = Missing.of(missing)
    marked, off = landmarks(table), out_of_use(table)
    if marked and columns is None:
        shares = find(table, weight)
        chosen = marked.columns if shares is None else [*marked.columns, shares]
        numbers, known = complete(table, chosen, told, off)
        numbers = marked.in_image(numbers, table)
    else:
        chosen = choose(table, [MATCHES], columns, weight).all
        numbers, known = complete(table, chosen, told, off)
    weights = numbers[:, 4].copy() if numbers.shape[1] > 4 else None
    named_weights(weights, column, table.where)
    counted = np.isfinite(numbers).all(axis=1) & (True if weights is None else weights != 0)
    for note in note_placeholders(numbers[counted, :4], where(path)):
        warnings.warn(note, stacklevel=3)
    return WeightedMatches(numbers[:, :2].copy(), numbers[:, 2:4].copy(), weights, known)


def named_weights(weights: Any, column: str | int | None, where: str) -> Any:
    """Return weights that were found, or None; refuse the name of a column that was not.

    Examples
    --------
    >>> named_weights(None, None, "matches.csv")
    """
    if weights is None and column is not None:
        rule = "The header of a table, or an archive, must have this name."
        check.refuse("weights", rule, f"{column!r}, which is not in {where}")
    return weights


def _match_table(source: Source, column: str | int | None) -> tuple[Table, str | int]:
    """Return a table with the matches, and what the weights are called there."""
    if is_frame(source) or Path(source).suffix.lower() != ".npz":
        return read_table(source, "matches"), WEIGHT_COLUMN if column is None else column
    path, weight = Path(source), WEIGHT_ARRAY if column is None else column
    arrays = read_data(path, "matches")
    weights = arrays.pop(str(weight), None)
    given, shares = _from_archive(arrays, weights, path)
    if shares is None:
        return given, weight
    if shares.shape != (len(given.arrays[0]),):
        rule = f"They must be {len(given.arrays[0])} numbers, one for each match."
        check.refuse("weights", rule, f"shape {shares.shape} in {path.name}")
    names = given.names or [f"column{k}" for k in range(1, given.width + 1)]
    return replace(given, names=[*names, str(weight)], arrays=[*given.arrays, shares]), weight


def _from_archive(
    arrays: dict[str, NDArray[Any]], weights: NDArray[Any] | None, path: Path
) -> tuple[ArrayTable, NDArray[Any] | None]:
    """Return the matches among arrays, and the weights of these."""
    pairing = next((key for key in ("matches", "matches0") if key in arrays), None)
    if {"keypoints0", "keypoints1"} <= arrays.keys() and pairing:
        first, second = (_two_columns(arrays[name], name) for name in ("keypoints0", "keypoints1"))
        matched = _matched(arrays[pairing], len(first))
        pairs = index_pairs(matched, len(first), len(second))
        if weights is not None and matched.ndim == 1:  # one for each keypoint, matched or not
            weights = weights.reshape(-1)[pairs[:, 0]]
        return _side_by_side(first[pairs[:, 0]], second[pairs[:, 1]], path), weights
    sides = next((names for names in _MATCHED if set(names) <= arrays.keys()), None)
    if sides:
        source, target = (_two_columns(arrays[name], name) for name in sides)
        if len(source) != len(target):
            rule = f"It must have one point per {sides[0]} point."
            check.refuse(sides[1], rule, f"{len(target)} for {len(source)} in {path.name}")
        return _side_by_side(source, target, path), weights
    what = "arrays source and target, (n, 2), or one (n, 4) array (among several: matches)"
    return _the_array(arrays, ("matches", "tentative"), path, f"{path.name} must hold {what}."), weights


def _matched(matches: NDArray[Any], n: int) -> NDArray[Any]:
    """Return matches of n keypoints without the axis of a batch of one."""
    batch = matches.ndim == 3 or (matches.ndim == 2 and matches.shape == (1, n) and n != 2)
    return matches[0] if batch and len(matches) == 1 else matches


def _side_by_side(source: Floats, target: Floats, path: Path) -> ArrayTable:
    return ArrayTable(path.name, "matches", MATCHES.columns, [*source.T, *target.T])


def _two_columns(array: NDArray[Any], name: str) -> Floats:
    numbers = check.as_rows(check.real(array, name))  # also of a batch of one
    if numbers.ndim != 2 or numbers.shape[1] != 2:
        check.refuse(name, "It must be points of shape (n, 2).", f"shape {numbers.shape}")
    return numbers


def read_points(path: Source, *, columns: Sequence[str | int] | None = None, missing: Any = None) -> Floats:
    """Read points.

    Parameters
    ----------
    path : path or frame
        As `read_matches` has it, with two columns: x and y. An `.npz` holds one (n, 2) array, named `points` if there
        are others.
    columns, missing
        As for `read_matches`; here there are two columns. Of landmarks they must be told, and those that are not in use
        are left out, or not known.

    Returns
    -------
    ndarray, (n, 2)
        The points. A `UserWarning` says if one constant seems to mean no data, as that of `read_matches` does. With
        ``missing="keep"`` those that are not known are rows of NaN, as in results of `mexpress apply`,
        and there may be none at all.

    Raises
    ------
    ValueError, TypeError, ImportError, OSError
        As in `read_matches`.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with open(f"{folder}/points.txt", "w") as file:
    ...         print("1 2 left", file=file)
    ...         print("3 4.5 right", file=file)
    ...     read_points(f"{folder}/points.txt")
    array([[1. , 2. ],
           [3. , 4.5]])
    """
    expect_source(path, "points")
    if is_frame(path) or Path(path).suffix.lower() != ".npz":
        table = read_table(path, "points")
    else:
        file = Path(path)
        rule = f"{file.name} must hold one (n, 2) array (among several: points)."
        table = _the_array(read_data(file, "points"), ("points",), file, rule)
    chosen = choose(table, [POINTS], columns).columns
    points = complete(table, chosen, Missing.of(missing), out_of_use(table))[0]
    for note in note_placeholders(points[np.isfinite(points).all(axis=1)], where(path)):
        warnings.warn(note, stacklevel=2)
    return points


def write_matches(path: str | os.PathLike[str], source: ArrayLike, target: ArrayLike) -> None:
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
        write_rows(file, MATCHES.columns, rows.tolist())


def write_points_csv(file: TextIO, points: Floats, columns: Sequence[str] = POINTS.columns) -> None:
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


def _the_array(arrays: dict[str, NDArray[Any]], known: Sequence[str], path: Path, rule: str) -> ArrayTable:
    """Return the array that has a known name, or the only one."""
    named = [key for key in known if key in arrays] or list(arrays)
    if len(named) != 1:
        there = ", ".join(f"{key} {arrays[key].shape}" for key in arrays) or "no arrays"
        check.refuse(known[0], rule, there)
    (key,) = named
    return ArrayTable.of(arrays[key], f"{key} in {path.name}", known[0])
