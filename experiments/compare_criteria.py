"""How much is lost by what a criterion selects: error over that of the best of the models it chose from.

Usage: ``python experiments/compare_criteria.py [DATA] --out DIR [--quick]``; needs matplotlib. Random surfaces are
sampled with noise in three ways (`comparison.fields`): every datum with noise of its own, with noise that neighbours
share, and few data in clusters. Two families of models are selected from by `mexpress.select_surface`:

count    a number of control points, without smoothing
weight   many control points, or three, and a weight of the bending energy, by ``smoothing="auto"``

The error is the root mean square distance to the surface itself over the whole square.

A last table is of counts alone, and of what the default call gives in their place. It has real maps too, of which 300
or 1,000 pixels are data and others judge: the Jacksboro terrain, and the depth maps in the directory DATA, if there, as
``compare_models.py`` has them.

DIR/criteria.csv, with
criteria.sqlite beside it, keeps the losses, so what is there is not computed again; DIR gets criteria.md and
criteria.png too.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from comparison import heights, problems
from comparison.errors import Errors
from comparison.fields import Sample, sample
from matplotlib.figure import Figure

import mexpress as mx
from mexpress.models.nested_errors import nested_errors

KINDS = {
    "independent": "noise of its own",
    "correlated": "noise shared by neighbours",
    "clustered": "few data, in clusters",
}
FAMILIES = {"count": 0.0, "weight": "auto"}
"""What `smoothing` is."""

CRITERIA = ("CMPRESS", "KF10", "GCV", "AIC", "BIC", "MATCHED", "ER01", "ER05", "ER10")
CRITERIA += ("NN01PCT", "NN05PCT", "NN10PCT")
BEST = "best possible"
DEFAULT = "default"
"""The default call: the loss in its place is the error itself."""

SIZES = (300, 1000)
"""Numbers of pixels that are the data of a real map."""

COUNTED = ("CMPRESS", "MATCHED", "ER01", "ER05", "ER10")
"""Criteria in the table of counts alone."""

DRAWS, FEW = 40, 6
LARGEST = 175
MOST = 300.0
"""Where the plot ends, in per cent."""


def true_map(selection, data):
    """Return the error of every model of a selection, a row for each count and a column for each weight."""
    if len(selection.weights) == 1:
        known = data.points, data.values, selection.control_points
        return nested_errors(*known, data.grid, data.truth)[:, None]
    errors = np.empty((len(selection.counts), len(selection.weights)))
    for place in np.ndindex(errors.shape):
        control_points = selection.control_points[: selection.counts[place[0]]]
        surface = mx.fit_surface(
            data.points, data.values, control_points, smoothing=selection.weights[place[1]]
        )
        errors[place] = np.sqrt(((surface(data.grid) - data.truth) ** 2).mean())
    return errors


def real_maps(folder):
    """Return by row what reads a map, and how many pixels are data."""
    return {f"{name} ({n})": (read, n) for name, read in problems.maps(folder).items() for n in SIZES}


def drawn(kind, draw, folder):
    """Return a draw of random surfaces of a kind, or of a real map."""
    if kind in KINDS:
        return sample(kind, draw)
    problem = heights.pixels(*real_maps(folder)[kind], draw)
    return Sample(problem.source, problem.target, problem.test_source, problem.test_target)


def default_error(kind, draw, folder):
    """Return {DEFAULT: (error, seconds)} of the default call for a draw."""
    data, start = drawn(kind, draw, folder), time.perf_counter()
    surface = mx.select_surface(data.points, data.values, criteria=[]).surface
    seconds = time.perf_counter() - start
    return {DEFAULT: (float(np.sqrt(((surface(data.grid) - data.truth) ** 2).mean())), seconds)}


def losses(kind, family, draw, names, folder=Path()):
    """Return {criterion: (loss in per cent, seconds)} for a draw, and the least error."""
    if family == DEFAULT:
        return default_error(kind, draw, folder)
    data, start = drawn(kind, draw, folder), time.perf_counter()
    most = min(LARGEST, len(data.points) // 2)
    selection = mx.select_surface(
        data.points, data.values, "FIT", names, max_count=most, smoothing=FAMILIES[family]
    )
    seconds = (time.perf_counter() - start) / len(names)
    errors = true_map(selection, data)
    results = {BEST: (float(errors.min()), seconds)}
    for name in names:
        count, weight = selection.selected[name], selection.selected_smoothing[name]
        at = selection.counts == count, selection.weights == weight
        chosen = np.inf if count is None else errors[np.ix_(*at)].item()
        results[name] = float(100 * (chosen / errors.min() - 1)), seconds
    return results


def compute(records, draws, folder):
    """Compute the losses that are missing."""
    rows = {(kind, family): CRITERIA for kind in KINDS for family in FAMILIES}
    rows |= {(kind, "count"): COUNTED for kind in real_maps(folder)}
    rows |= {(kind, DEFAULT): (DEFAULT,) for kind in [*KINDS, *real_maps(folder)]}
    wanted = [
        (kind, family, draw, names, folder)
        for draw in range(draws)
        for (kind, family), criteria in rows.items()
        if (names := [name for name in criteria if (f"{kind}, {family}", draw, name) not in records])
    ]

    def keep(index, results):
        kind, family, draw, *_ = wanted[index]
        records.keep(f"{kind}, {family}", draw, results)

    mx.map_problems(losses, wanted, progress=True, on_result=keep)


def table(records, draws):
    """Return the lines of a Markdown table: the median loss, and the 90th percentile in brackets."""
    rows = [f"{kind}, {family}" for kind in KINDS for family in FAMILIES]
    titles = [f"{KINDS[kind]}: {family}" for kind in KINDS for family in FAMILIES]
    lines = ["| | " + " | ".join(titles) + " |", "|---" * (len(rows) + 1) + "|"]
    for name in CRITERIA:
        cells = (np.percentile(records.drawn(row, name, draws), [50, 90]) for row in rows)
        lines.append(
            f"| {name} | " + " | ".join(f"{middle:.0f} ({high:.0f})" for middle, high in cells) + " |"
        )
    least = (np.median(records.drawn(row, BEST, draws)) for row in rows)
    return [*lines, f"| {BEST}: RMS | " + " | ".join(f"{error:.3f}" for error in least) + " |"]


def errors_of(records, row, name, draws):
    """Return the errors of what a criterion selected, a draw each."""
    return (1 + records.drawn(row, name, draws) / 100) * records.drawn(row, BEST, draws)


def gains(records, draws):
    """Return the lines of a Markdown table: the selected weight's error over the selected count's, the median."""
    lines = ["| | " + " | ".join(KINDS.values()) + " |", "|---" * (len(KINDS) + 1) + "|"]
    for name in CRITERIA:
        pairs = (
            [errors_of(records, f"{kind}, {family}", name, draws) for family in FAMILIES] for kind in KINDS
        )
        ratios = (np.median(weight / count) for count, weight in pairs)
        lines.append(f"| {name} | " + " | ".join(f"{ratio:.2f}" for ratio in ratios) + " |")
    return lines


def counts_alone(records, draws, folder):
    """Return the lines of a Markdown table: geometric means of errors over those of the best counts."""
    real = list(real_maps(folder))
    groups = {"terrain and depth": real, **{title: [kind] for kind, title in KINDS.items()}}
    lines = ["| | " + " | ".join(groups) + " |", "|---" * (len(groups) + 1) + "|"]
    for name in (*COUNTED, DEFAULT):
        cells = (
            np.concatenate([over_best_count(records, kind, name, draws) for kind in kinds])
            for kinds in groups.values()
        )
        title = "the default call" if name == DEFAULT else name
        lines.append(f"| {title} | " + " | ".join(f"{np.exp(np.log(x).mean()):.2f}" for x in cells) + " |")
    return lines


def over_best_count(records, kind, name, draws):
    """Return the errors over those of the best counts, a draw each."""
    if name == DEFAULT:
        best = records.drawn(f"{kind}, count", BEST, draws)
        return records.drawn(f"{kind}, {DEFAULT}", DEFAULT, draws) / best
    return 1 + records.drawn(f"{kind}, count", name, draws) / 100


def draw_losses(records, draws, path):
    """Plot the loss of every surface, a line for each criterion, with the median and the 90th percentile."""
    figure = Figure(figsize=(12, 1 + 0.55 * len(CRITERIA)), layout="constrained", dpi=120)
    grid = figure.subplots(len(FAMILIES), len(KINDS), sharex=True, sharey=True)
    ticks = [0, 5, 10, 30, 100, 300]
    for place, axes in np.ndenumerate(grid):
        family, kind = list(FAMILIES)[place[0]], list(KINDS)[place[1]]
        for height, name in enumerate(reversed(CRITERIA)):
            drawn = records.drawn(f"{kind}, {family}", name, draws).clip(max=MOST)
            middle, high = np.percentile(drawn, [50, 90])
            axes.plot(drawn, np.full(draws, height), "o", color="#0072B2", alpha=0.35, ms=4, mew=0)
            axes.plot([middle, high], [height, height], color="#D55E00", lw=2)
            axes.plot(middle, height, "o", color="#D55E00", ms=8, mec="white")
        axes.set_title(f"{KINDS[kind]}: {family}", fontsize=11)
        axes.set_xscale("symlog", linthresh=10)
        axes.set(xlim=(-0.5, MOST), yticks=range(len(CRITERIA)), yticklabels=CRITERIA[::-1])
        axes.set_xticks(ticks, ticks)
        axes.set_xticks([], minor=True)
        axes.grid(alpha=0.25)
    figure.supxlabel(
        "error over that of the best model of the family (%): every surface, the median, up to the 90th percentile"
    )
    figure.savefig(path)


def arguments():
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add = parser.add_argument
    add("data", metavar="DATA", type=Path, nargs="?", default=Path(), help="directory with depth maps")
    add("--out", metavar="DIR", type=Path, required=True, help="made if it does not exist")
    add("--quick", action="store_true", help=f"{FEW} surfaces instead of {DRAWS}")
    return parser.parse_args()


def run(options):
    """Compute, and write the table and the plot."""
    options.out.mkdir(parents=True, exist_ok=True)
    draws = FEW if options.quick else DRAWS
    with Errors(options.out / "criteria.csv") as records:
        compute(records, draws, options.data)
        tables = (table(records, draws), gains(records, draws), counts_alone(records, draws, options.data))
        lines = "\n\n".join("\n".join(lines) for lines in tables)
        (options.out / "criteria.md").write_text(f"{lines}\n", encoding="utf-8")
        print(lines)
        draw_losses(records, draws, options.out / "criteria.png")


if __name__ == "__main__":
    run(arguments())
