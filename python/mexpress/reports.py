"""What a selection says, as text: a table for the terminal, curves as CSV, a summary as JSON."""

from __future__ import annotations

import json
import math
import os
import platform
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from mexpress._validation import Floats
from mexpress.criteria import UNITLESS
from mexpress.matches import write_rows
from mexpress.selection import Selection

__all__ = ["summary", "table", "versions", "write_curves", "write_summary"]

_MOST_ROWS = 25
"""Rows of a table that can still be read at a glance."""

PathLike = str | os.PathLike[str]


def table(selection: Selection, most_rows: int = _MOST_ROWS, width: int | None = None) -> str:
    """Return the criteria by number of control points; * marks what a criterion selects, - what is undefined.

    Parameters
    ----------
    selection : Selection
        Result of a sweep.
    most_rows : int
        With more counts only about so many are shown: the first, the last, what a criterion selects, and others
        between, denser where models are small.
    width : int, optional
        Characters in a line: criteria for which there is no room follow below.

    Returns
    -------
    str
        Lines of text.

    Examples
    --------
    >>> import mexpress as mx
    >>> source = np.random.default_rng(0).uniform(0, 100, (40, 2))
    >>> target = source + [[0, 5]] * np.sin(source / 20)
    >>> print(table(mx.select_warp(source, target, criteria=["FIT"], counts=range(3, 5))))
    points       FIT      ER10
         3   ...
         4   ...
    """
    counts = [int(count) for count in selection.counts]
    rows = _shown_rows(len(counts), [counts.index(c) for c in selection.selected.values() if c], most_rows)
    write = _writers(selection.curves)
    cells = [["points", *(f"{name} " for name in selection.curves)]]
    for row in rows:
        scores = (
            _cell(write[name], float(curve[row]), counts[row] == selection.selected[name])
            for name, curve in selection.curves.items()
        )
        cells.append([str(counts[row]), *scores])
    lines = _aligned(cells, width)
    if len(rows) < len(counts):
        lines.append(f"({len(rows)} of {len(counts)} numbers of control points; all are in the curves)")
    return "\n".join(lines)


def _aligned(cells: list[list[str]], width: int | None) -> list[str]:
    """Return lines of columns; those beyond the width follow below, beside the first column again."""
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    blocks: list[list[int]] = [[0]]
    for column in range(1, len(widths)):
        used = sum(widths[k] + 2 for k in blocks[-1])
        if width is not None and len(blocks[-1]) > 1 and used + widths[column] > width:
            blocks.append([0])
        blocks[-1].append(column)
    parts = (
        ["  ".join(line[k].rjust(widths[k]) for k in block).rstrip() for line in cells] for block in blocks
    )
    return [line for k, part in enumerate(parts) for line in ([""] if k else []) + part]


def _shown_rows(number: int, selected: list[int], most: int) -> list[int]:
    if number <= most:
        return list(range(number))
    kept = {0, number - 1, *selected}
    # Nearly geometric: criteria change most where models are small.
    for row in np.geomspace(1, number, max(most - len(kept), 0) + 2).round().astype(int) - 1:
        kept.add(int(row))
    return sorted(kept)


def _writers(curves: Mapping[str, Floats]) -> dict[str, Callable[[float], str]]:
    """Return how to write each criterion's numbers: alike if they share a unit, so that eyes compare them."""
    shared = np.abs(np.concatenate([c for name, c in curves.items() if name not in UNITLESS] or [np.ones(1)]))
    positive = shared[np.isfinite(shared) & (shared > 0)]
    low = float(positive.min()) if positive.size else 1.0
    decimals = max(3 - math.floor(math.log10(low)), 0)

    def with_unit(value: float) -> str:
        return f"{value:.{decimals}f}" if low >= 1e-3 and abs(value) < 1e6 else f"{value:.3e}"

    return {name: "{:.1f}".format if name in UNITLESS else with_unit for name in curves}


def _cell(write: Callable[[float], str], value: float, selected: bool) -> str:
    return ("-" if math.isnan(value) else write(value)) + ("*" if selected else " ")


def write_curves(path: PathLike, selection: Selection) -> None:
    """Write the curves as CSV: a row per number of control points, a column per criterion, nan if undefined.

    Parameters
    ----------
    path : str or path
        Name of the file.
    selection : Selection
        Result of a sweep.

    Examples
    --------
    See `mexpress.cli.main`.
    """
    columns = [selection.counts.tolist(), *(curve.tolist() for curve in selection.curves.values())]
    with Path(path).open("w", encoding="utf-8", newline="\n") as file:
        write_rows(file, ["count", *selection.curves], zip(*columns, strict=True))


def summary(selection: Selection) -> dict[str, Any]:
    """Return what was selected as plain numbers, lists and dicts, None for what is undefined.

    Parameters
    ----------
    selection : Selection
        Result of a sweep.

    Returns
    -------
    dict
        `versions`: of mexpress, numpy and Python. `criterion`: the one that selects; `count`: what it
        selects; `score`: its value there. `selected`: by criterion, what it would select. `counts`: what was
        tried, and `curves`: by criterion, its values there, in pixels for warps and in the data's unit for
        surfaces; AIC and BIC have no unit. `undefined`:
        by criterion and count, the data (from 0) whose prediction lacks the rank.

    Examples
    --------
    >>> import mexpress as mx
    >>> source = np.random.default_rng(0).uniform(0, 100, (40, 2))
    >>> summary(mx.select_warp(source, source**1.1, counts=[3, 4]))["counts"]
    [3, 4]
    """
    chosen = selection.curves[selection.criterion][selection.counts == selection.count]
    return {
        "versions": versions(),
        "criterion": selection.criterion,
        "count": selection.count,
        "score": _plain(float(chosen[0])),
        "selected": dict(selection.selected),
        "counts": selection.counts.tolist(),
        "curves": {name: _plain(curve.tolist()) for name, curve in selection.curves.items()},
        "undefined": {
            name: {str(count): data.tolist() for count, data in by_count.items()}
            for name, by_count in selection.undefined.items()
        },
    }


def versions() -> dict[str, str]:
    """Return the versions of mexpress, numpy and Python.

    Examples
    --------
    >>> sorted(versions())
    ['mexpress', 'numpy', 'python']
    """
    return {
        "mexpress": version("mexpress"),
        "numpy": np.__version__,
        "python": platform.python_version(),
    }


def _plain(value: Any) -> Any:
    """JSON knows neither NaN nor infinity."""
    if isinstance(value, Mapping):
        return {name: _plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_summary(path: PathLike, content: Mapping[str, Any]) -> None:
    """Write a summary as JSON, each key on a line.

    Parameters
    ----------
    path : str or path
        Name of the file.
    content : mapping
        What `summary` returns, and more. NaN and infinities, which JSON does not know, become null.

    Examples
    --------
    See `mexpress.cli.main`.
    """
    plain = _plain(content)
    lines = (f"  {json.dumps(key)}: {json.dumps(value, allow_nan=False)}" for key, value in plain.items())
    Path(path).write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
