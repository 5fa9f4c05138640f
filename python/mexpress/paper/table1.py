"""Table 1 and figures 2 and 3: what every criterion selects on 450 simulated pairs of images of bent sheets.

All three read the same rows, one for each configuration, number of correspondences and number of control points, in
``table1-curves.sqlite`` of the output directory, and write them as ``table1-curves.csv``; whichever is made first
computes them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, astuple
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mexpress import simulation
from mexpress.batch import map_problems
from mexpress.io.matches import write_rows
from mexpress.io.records import Records
from mexpress.paper.experiment import Experiment, Options, Outcome
from mexpress.paper.plot_table1 import plot_mean_curves, plot_selections
from mexpress.paper.published import CRITERIA, SIZES
from mexpress.paper.table1_cells import Comparison, Curves, compared, fit_scale, table
from mexpress.paper.table1_claims import claims
from mexpress.selection import WarpSelection, largest_count, select_warp
from mexpress.simulation import Configuration, Correspondences, Setting

_CURVES = "table1-curves.csv"
_NAMES = ("FIT", *CRITERIA, "TEST")
_KEY: dict[str, type[int]] = {"source": int, "target": int, "view": int, "n": int}

_QUICK = {15: (7, 1), 30: (11, 1), 150: (31, 4), 500: (59, 8)}
"""By number of correspondences: a quick run takes every so many configurations, and numbers of control points."""

_SETTING = Setting(waves=7, decay=0.0, tilt=(0.5, 0.0), fill=1.5)
_NOISE = 0.5
"""How sheets bend and are seen, and the noise in pixels of every coordinate, of which a match's four together have one:
fitted to the row TEST of the paper's table alone."""

Task = tuple[Configuration, tuple[int, ...]]
Row = tuple[float, ...]


def measure(configuration: Configuration, n: int, stride: int = 1, seed: int = 0) -> list[Row]:
    """Measure every criterion on one simulated pair of images.

    Parameters
    ----------
    configuration : Configuration
        Which sheets and views.
    n : int
        Number of correspondences.
    stride : int, default 1
        Every so many numbers of control points, from three to the largest.
    seed : int, default 0
        Of the simulation and of what is random in the selection.

    Returns
    -------
    list of tuples
        A row for each number of control points: source, target, view, n, the number, FIT, the 13 criteria and TEST
        in pixels.

    Examples
    --------
    >>> rows = measure(Configuration(0, 1, 0), 15)
    >>> [int(row[4]) for row in rows]
    [3, 4, 5, 6, 7]
    """
    matches = simulation.correspondences(configuration, n, _NOISE, seed, _SETTING)
    selection = select_warp(
        matches.source,
        matches.target,
        criterion="FIT",
        criteria=CRITERIA,
        counts=_counts(n, stride),
        image_size=matches.image_size,
        seed=seed,
        threads=1,
        smoothing=0,
    )
    place = (configuration.source, configuration.target, configuration.view, n)
    curves = selection.curves | {"TEST": _test_errors(selection, matches)}
    return [
        (*place, int(count), *(float(curves[name][k]) for name in _NAMES))
        for k, count in enumerate(selection.counts)
    ]


def _counts(n: int, stride: int) -> range:
    return range(3, largest_count(n) + 1, stride)


def _test_errors(selection: WarpSelection, matches: Correspondences) -> list[float]:
    """TEST: the root mean square of the algebraic transfer error all over the sheet, in pixels, for every count."""
    errors = []
    for count in selection.counts:
        warp = selection.warps.get(int(count))
        if warp is None:
            errors.append(math.nan)
            continue
        values = warp.lifting.values(matches.dense_source, warp.parameters)
        error = matches.dense_target * values[:, 2:] - values[:, :2]
        errors.append(float(np.sqrt((error**2).sum(axis=1).mean())))
    return errors


def _measured(configuration: Configuration, sizes: Mapping[int, int], seed: int) -> list[list[Row]]:
    """Measure with several numbers of correspondences, each with its stride, in one process: they share cameras."""
    return [measure(configuration, n, stride, seed=seed) for n, stride in sizes.items()]


def _tasks(quick: bool) -> list[Task]:
    """Return configurations one after the other, with their numbers of correspondences, the costly ones first."""
    strides = {n: stride if quick else 1 for n, (stride, _) in _QUICK.items()}
    tasks = []
    for k, configuration in enumerate(simulation.configurations()):
        sizes = tuple(n for n in sorted(SIZES, reverse=True) if k % strides[n] == 0)
        tasks += [(configuration, sizes)] if sizes else []
    return tasks


def _computed(options: Options) -> dict[int, Curves]:
    """Compute what the directory lacks, and return the curves by number of correspondences."""
    simulated = {"setting": repr(_SETTING), "noise": _NOISE}
    run = {"experiment": "table1", "seed": options.seed, "quick": options.quick, **simulated}
    columns = {**_KEY, "count": int, **dict.fromkeys(_NAMES, float)}
    strides = {n: stride if options.quick else 1 for n, (_, stride) in _QUICK.items()}
    with Records(options.out / _CURVES, run, columns, len(_KEY)) as records:
        todo = []
        for configuration, sizes in _tasks(options.quick):
            place = (configuration.source, configuration.target, configuration.view)
            left = {n: strides[n] for n in sizes if (*place, n) not in records}
            todo += [(configuration, left)] if left else []

        def add(_: int, tasks: list[list[Row]]) -> None:
            for rows in tasks:
                records.add(rows)

        map_problems(
            _measured,
            todo,
            workers=options.threads,
            progress=options.progress,
            on_result=add,
            seed=options.seed,
        )
        return _curves(records.table())


def _curves(rows: Mapping[str, NDArray[Any]]) -> dict[int, Curves]:
    """Sort rows, a problem's after each other, into curves."""
    curves = {}
    for n in SIZES:
        here = rows["n"] == n
        counts = np.unique(rows["count"][here])
        values = {name: rows[name][here].reshape(-1, len(counts)) for name in _NAMES}
        curves[n] = Curves(counts, values)
    return curves


def _table1(options: Options) -> Outcome:
    curves = _computed(options)
    comparisons, judged, agreement = compared(curves), claims(curves), {}
    for what, of in (("all", comparisons), ("the 13 criteria", [c for c in comparisons if c.name != "TEST"])):
        within = [within for c in of for within in c.within if within is not None]
        agreement[what] = {"cells": len(within), "within": sum(within)}
    with (options.out / "table1.csv").open("w", encoding="utf-8", newline="\n") as file:
        write_rows(file, _CELL_COLUMNS, map(_cell_row, comparisons))
    lines = [
        _described(curves),
        _unit(curves),
        "mean ± standard deviation; ! our mean is not within the paper's standard deviation of its mean\n",
        table(comparisons),
        "",
        *(
            f"{cells['within']} of {cells['cells']} cells of {what} are within one standard deviation."
            for what, cells in agreement.items()
        ),
        "\nThe paper's claims:",
        *(f"* {claim.text}" for claim in judged),
    ]
    summary = {
        "problems": _problems(curves),
        "fit_scale": fit_scale(curves),
        "cells": [_cell_summary(comparison) for comparison in comparisons],
        "agreement": agreement,
        "claims": [asdict(claim) for claim in judged],
    }
    return Outcome("\n".join(lines), summary, [_CURVES, "table1.csv"])


_CELL_COLUMNS = (
    *("n", "criterion"),
    *(f"{who}{what}" for who in ("", "paper_") for what in ("count", "count_std", "fit", "fit_std")),
    *("count_within", "fit_within"),
)


def _cell_row(comparison: Comparison) -> tuple[object, ...]:
    within = ("" if agrees is None else int(agrees) for agrees in comparison.within)
    return (comparison.n, comparison.name, *astuple(comparison.ours), *astuple(comparison.paper), *within)


def _cell_summary(comparison: Comparison) -> dict[str, Any]:
    return {
        "criterion": comparison.name,
        "n": comparison.n,
        "ours": asdict(comparison.ours),
        "paper": asdict(comparison.paper),
        "within": comparison.within,
    }


def _problems(curves: Mapping[int, Curves]) -> dict[str, int]:
    return {str(n): len(of.values["FIT"]) for n, of in curves.items()}


def _described(curves: Mapping[int, Curves]) -> str:
    numbers = ", ".join(f"{number} of n = {n}" for n, number in _problems(curves).items())
    noise = f"noise of {_NOISE:g} pixels in each of its four coordinates"
    return f"Simulated pairs of images: {numbers} correspondences, each with {noise}."


def _unit(curves: Mapping[int, Curves]) -> str:
    factor = f"{fit_scale(curves):.2f}"
    return f"FIT is in pixels times {factor}: one factor for all cells, fitted to the row TEST."


def _figure2(options: Options) -> Outcome:
    curves = _computed(options)
    lines = [_described(curves), "Every criterion's mean curve has its minimum at so many control points:\n"]
    lowest = {name: {str(n): of.lowest(name) for n, of in curves.items()} for name in _NAMES}
    lines += ["".join(["        ", *(f"{f'n = {n}':>9}" for n in curves)])]
    for name, of in lowest.items():
        cells = ("-" if count is None else str(count) for count in of.values())
        lines.append("".join([f"{name:8}", *(f"{cell:>9}" for cell in cells)]))
    with (options.out / "figure2.csv").open("w", encoding="utf-8", newline="\n") as file:
        write_rows(file, ("n", "count", "criterion", "mean", "std"), _mean_rows(curves))
    summary = {"problems": _problems(curves), "lowest_mean": lowest}
    plots = {"figure2.png": lambda path: plot_mean_curves(curves, path)}
    return Outcome("\n".join(lines), summary, [_CURVES, "figure2.csv"], plots)


def _mean_rows(curves: Mapping[int, Curves]) -> Iterator[tuple[object, ...]]:
    """Yield what figure 2 draws."""
    for n, of in curves.items():
        for name in _NAMES:
            columns = (of.counts.tolist(), *(column.tolist() for column in of.mean(name)))
            yield from ((n, count, name, mean, std) for count, mean, std in zip(*columns, strict=True))


def _figure3(options: Options) -> Outcome:
    curves = _computed(options)
    comparisons = compared(curves)
    plots = {"figure3.png": lambda path: plot_selections(comparisons, path)}
    summary = {
        "problems": _problems(curves),
        "fit_scale": fit_scale(curves),
        "cells": [_cell_summary(c) for c in comparisons],
    }
    return Outcome(
        f"{_described(curves)}\n{_unit(curves)}\n\n{table(comparisons)}", summary, [_CURVES], plots
    )


_ON_SHEETS = "on 450 simulated pairs of bent sheets"

TABLE1 = Experiment(
    "table1", f"what 13 criteria and the truth select {_ON_SHEETS}, beside the paper's table", "", _table1
)
FIGURE2 = Experiment(
    "figure2", f"mean curves of the criteria {_ON_SHEETS}; needs no time after table1", "", _figure2
)
FIGURE3 = Experiment(
    "figure3", f"what the criteria select {_ON_SHEETS}, drawn; needs no time after table1", "", _figure3
)
