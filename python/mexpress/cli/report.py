"""What a selection says, as text: a table for the terminal, curves as CSV, a summary as JSON."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mexpress._validation import Floats
from mexpress.criteria import UNITLESS
from mexpress.io.matches import write_rows
from mexpress.selection import Selection
from mexpress.selection.selection import plain, weights_tell_more

_MOST_ROWS = 25
"""Rows of a table that can still be read at a glance."""

PathLike = str | os.PathLike[str]


def table(selection: Selection, most_rows: int = _MOST_ROWS, width: int | None = None) -> str:
    """Return the criteria by number of control points; * marks what a criterion selects, - what is undefined.

    A rival has a line of its own below. With several weights of smoothing each count has the one that is best for the
    selecting criterion, and * marks what the others select of these lines. With four counts or fewer there is a line
    for every weight instead, at the selected count, with its effective number of parameters.

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
    >>> print(table(mx.select_warp(source, target, criteria=["FIT"], counts=range(3, 5), smoothing=0)))
    points       FIT      ER10
         3   ...
         4   ...
    """
    lines = _with_rivals(
        selection, _by_weight(selection) if weights_tell_more(selection) else _by_count(selection)
    )
    always = range(len(lines.heads) - len(selection.rivals), len(lines.heads))
    chosen = [k for k in lines.chosen.values() if k is not None]
    rows = _shown_rows(len(lines.heads), [*chosen, *always], most_rows)
    write = _writers(lines.curves)
    cells = [[*lines.titles, *(f"{name} " for name in lines.curves)]]
    for row in rows:
        scores = (
            _cell(write[name], float(curve[row]), row == lines.chosen[name])
            for name, curve in lines.curves.items()
        )
        cells.append([*lines.heads[row], *scores])
    text = _aligned(cells, width, len(lines.titles))
    if len(rows) < len(lines.heads):
        text.append(f"({len(rows)} of {len(lines.heads)} {lines.what}; all are in the curves)")
    return "\n".join(text)


@dataclass(frozen=True)
class _Lines:
    """What a table has: titles of the leading columns, and by line these columns, scores, and what is chosen."""

    titles: list[str]
    heads: list[list[str]]
    curves: dict[str, Floats]
    chosen: dict[str, int | None]
    what: str


def _smallest(curves: Mapping[str, Floats]) -> dict[str, int | None]:
    return {name: None if np.isnan(c).all() else int(np.nanargmin(c)) for name, c in curves.items()}


def _by_count(selection: Selection) -> _Lines:
    counts = selection.counts.tolist()
    titles, heads = ["points"], [[str(count)] for count in counts]
    curves = selection.curves
    if len(selection.weights) > 1:
        best = [selection.best_weight(k) for k in range(len(counts))]
        heads = [
            [*head, "-" if w is None else f"{selection.weights[w]:.3g}"]
            for head, w in zip(heads, best, strict=True)
        ]
        titles = [*titles, "smoothing"]
        curves = {
            name: np.array([np.nan if w is None else row[w] for row, w in zip(scores, best, strict=True)])
            for name, scores in selection.maps.items()
        }
    chosen = _smallest(curves)
    chosen[selection.criterion] = selection.place[0]
    return _Lines(titles, heads, curves, chosen, "numbers of control points")


def _by_weight(selection: Selection) -> _Lines:
    k = selection.place[0]
    parameters = np.full(len(selection.weights), np.nan)
    if selection.parameters is not None:
        parameters = selection.parameters[k]
    heads = [
        [f"{weight:.3g}", "-" if np.isnan(count) else f"{count:.1f}"]
        for weight, count in zip(selection.weights, parameters, strict=True)
    ]
    curves = {name: scores[k] for name, scores in selection.maps.items()}
    chosen = _smallest(curves)
    chosen[selection.criterion] = selection.place[1]
    return _Lines(["smoothing", "parameters"], heads, curves, chosen, "weights")


def _with_rivals(selection: Selection, lines: _Lines) -> _Lines:
    """Add a line for each rival, and mark what is best of all."""
    heads, curves = list(lines.heads), dict(lines.curves)
    for name, rival in selection.rivals.items():
        scores = rival.best_scores()
        heads.append([name, *("" for _ in lines.titles[1:])])
        curves = {key: np.append(curve, scores.get(key, np.nan)) for key, curve in curves.items()}
    chosen = _smallest(curves)
    chosen[selection.criterion] = lines.chosen[selection.criterion]
    if selection.rival is not None:
        chosen[selection.criterion] = len(lines.heads) + list(selection.rivals).index(selection.rival)
    return _Lines(lines.titles, heads, curves, chosen, lines.what)


def _aligned(cells: list[list[str]], width: int | None, leading: int) -> list[str]:
    """Return lines of columns; those beyond the width follow below, beside the leading columns again."""
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    blocks: list[list[int]] = [list(range(leading))]
    for column in range(leading, len(widths)):
        used = sum(widths[k] + 2 for k in blocks[-1])
        if width is not None and len(blocks[-1]) > leading and used + widths[column] > width:
            blocks.append(list(range(leading)))
        blocks[-1].append(column)
    parts = (
        ["  ".join(line[k].rjust(widths[k]) for k in block).rstrip() for line in cells] for block in blocks
    )
    return [line for k, part in enumerate(parts) for line in ([""] if k else []) + part]


def _shown_rows(number: int, selected: list[int], most: int) -> list[int]:
    if number <= most:
        return list(range(number))
    rows = {0, number - 1, *selected}
    # Nearly geometric: criteria change most where models are small.
    for row in np.geomspace(1, number, max(most - len(rows), 0) + 2).round().astype(int) - 1:
        rows.add(int(row))
    return sorted(rows)


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

    With several weights of smoothing there is a row per count and weight, and columns of the weight and of the
    effective number of parameters after that of the count.

    Parameters
    ----------
    path : str or path
        Name of the file.
    selection : Selection
        Result of a sweep.
    """
    columns = selection.columns()
    if len(selection.weights) == 1:
        del columns["smoothing"], columns["parameters"]
    with Path(path).open("w", encoding="utf-8", newline="\n") as file:
        write_rows(file, list(columns), zip(*(column.tolist() for column in columns.values()), strict=True))


def as_json(content: Mapping[str, Any]) -> str:
    """Return a mapping as JSON, each key on a line. NaN and infinities, which JSON does not know, become null.

    Examples
    --------
    >>> print(as_json({"score": 1.5, "scores": [1.0, math.nan]}))
    {
      "score": 1.5,
      "scores": [1.0, null]
    }
    """
    lines = (f"  {json.dumps(key)}: {json.dumps(plain(content[key]), allow_nan=False)}" for key in content)
    return "{\n" + ",\n".join(lines) + "\n}"


def write_summary(path: PathLike, content: Mapping[str, Any]) -> None:
    """Write a summary as JSON, see `as_json`.

    Parameters
    ----------
    path : str or path
        Name of the file.
    content : mapping
        What `Selection.to_dict` returns, and more.
    """
    Path(path).write_text(as_json(content) + "\n", encoding="utf-8")
