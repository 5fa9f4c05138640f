"""How far from held-out points warps and surfaces are, of mexpress and of other libraries.

Usage: ``python experiments/compare_models.py DATA --out DIR [--quick] [--rows A,B] [--methods A,B] [--again]``; needs
scikit-image, scipy, matplotlib and treverhines-rbf. DATA is a directory with any of

sheets/NAME.npz   image_points (views, n, 2) of a sheet that deforms: hulk and kinectpaper
sheets/bent_paper_239.npz   uv (n, 2) on a flat sheet, points3d (n, 3) of it in space
flat/NAME_matches.npz   tentative matches (n, 4) of a plane and its homography H_A_to_B: adam and boat
flat/H1to3p.xml   homography between two images, graf1 and graf3
depth/TUM_depth.png, depth_00000.png   depth maps

Of every row problems are drawn at random, always the same ones, and every method is used in one way in all rows. What
counts is the median over the draws of the root mean square error: a draw in which a model folds, or the best is found
by luck, has no more weight than another. The worst draw stands beside it.

DIR/errors.csv, with errors.sqlite beside it, keeps all errors, so what is there is not computed again; DIR gets
models.md and models.png too.
"""

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from comparison import fixed, methods, problems
from comparison.errors import Errors
from matplotlib.figure import Figure

import mexpress as mx

DRAWS, FEW = 12, 4
IN_GAPS, MANY = 12, 24
"""Draws of gaps, and of rows that differ more or are judged by few points: real matches, and few matches."""

OURS, ASKED = "mexpress", "mexpress, queries"
"""The default call; and with the points that are asked for, in rows with gaps."""

FIXED = "best fixed setting"
CLOSE, FAR = 1.03, 10.0
"""Times the best's error: what counts as equal, and where the plot ends."""

LOOKS = {
    "homography": ("s", "#777777"),
    "plane": ("s", "#777777"),
    "affine map": ("p", "#777777"),
    "scikit-image TPS": ("v", "#56B4E9"),
    "scipy RBF leave-one-out": ("^", "#0072B2"),
    "scipy RBF 10-fold": ("d", "#0072B2"),
    "treverhines-rbf auto": ("D", "#009E73"),
    FIXED: ("|", "black"),
    "mexpress smoothing=0": ("P", "#E69F00"),
    "mexpress bspline": ("h", "#E69F00"),
    "mexpress affine": ("X", "#E69F00"),
    "mexpress CMPRESS": ("*", "#E69F00"),
    OURS: ("o", "#D55E00"),
    ASKED: ("o", "#CC79A7"),
}
"""Marker and colour; methods of a row are drawn from above to below in this order."""

OTHERS = methods.ONLY_WARPS | methods.ONLY_SURFACES | methods.SPLINES


@dataclass(frozen=True)
class Table:
    """Rows with the methods that are compared in them, and how many draws of each row there are."""

    title: str
    draws: dict[str, int]
    methods: list[str]

    @property
    def ours(self):
        """The method of ours that is judged."""
        return ASKED if ASKED in self.methods else OURS

    @property
    def others(self):
        """The methods of other libraries."""
        return [name for name in self.methods if name in OTHERS]


def draws_of(title, row, quick):
    """Return how many draws of a row there are."""
    if quick:
        return FEW
    measured = ("hulk", "kinectpaper", "boat", "adam", "sheet in space")
    if row.startswith(measured) or title == problems.FEW:
        return MANY
    return IN_GAPS if title in problems.GAPS else DRAWS


def methods_of(title):
    """Return the names of the methods that are compared in a table."""
    plain = methods.ONLY_WARPS if "Warps" in title else methods.ONLY_SURFACES
    ours = methods.IN_GAPS if title in problems.GAPS else methods.OTHERWISE
    return [*plain, *methods.SPLINES, FIXED, *methods.DEFAULT, *ours]


def containing(texts, names):
    """Return the names that contain any of the texts."""
    return [name for name in names if any(text in name for text in texts.split(","))]


def tables_of(options):
    """Return the tables of the rows and methods that are wished."""
    tables = []
    for title, rows in problems.TABLES.items():
        draws = {
            row: draws_of(title, row, options.quick) for row in containing(options.rows, rows(options.data))
        }
        names = containing(options.methods, methods_of(title))
        if draws and names:
            tables.append(Table(title, draws, names))
    return tables


def judge(data, row, draw, names):
    """Return {method: (error, seconds)} for a draw of a row."""
    problem, results = problems.drawn(data, row, draw), {}
    for name in names:
        start = time.perf_counter()
        if name == FIXED:
            errors = fixed.fixed_errors(problem)
            seconds = (time.perf_counter() - start) / len(errors)
            results |= {setting: (error, seconds) for setting, error in errors.items()}
        else:
            error = methods.error(problem, methods.METHODS[name])
            results[name] = error, time.perf_counter() - start
    return results


def compute(options, records, tables):
    """Compute the errors that are missing, the first draws of all rows first."""
    wanted = []
    for draw in range(MANY):
        for table in tables:
            for row in (row for row, draws in table.draws.items() if draw < draws):
                keys = {name: fixed.SETTINGS[0] if name == FIXED else name for name in table.methods}
                names = [
                    name for name, key in keys.items() if options.again or (row, draw, key) not in records
                ]
                if names:
                    wanted.append((options.data, row, draw, names))
    print(f"{len(wanted)} draws to compute", file=sys.stderr)

    def keep(index, results):
        records.keep(*wanted[index][1:3], results)

    mx.map_problems(judge, wanted, progress=True, on_result=keep)


def drawn(records, row, name, draws):
    """Return a method's errors in a row, a draw each; of the fixed settings, those of the best median."""
    if name != FIXED:
        return records.drawn(row, name, draws)
    every = np.array([records.drawn(row, setting, draws) for setting in fixed.SETTINGS])
    return every[np.median(every, axis=1).argmin()]


def medians(records, table, names):
    """Return the median error of every row and method; NaN unless all draws are there."""
    return np.array(
        [
            [np.median(drawn(records, row, name, draws)) for name in names]
            for row, draws in table.draws.items()
        ]
    )


def errors_table(records, table):
    """Return the lines of a Markdown table: medians, bold if equal to the best, and the worst draws in brackets."""
    lines = ["| | " + " | ".join(table.methods) + " |", "|---" * (len(table.methods) + 1) + "|"]
    middle = medians(records, table, table.methods)
    for (row, draws), errors in zip(table.draws.items(), middle, strict=True):
        best, cells = CLOSE * np.nanmin(errors), []
        for name, typical in zip(table.methods, errors, strict=True):
            mark, worst = "**" if typical <= best else "", drawn(records, row, name, draws).max()
            cells.append("" if np.isnan(typical) else f"{mark}{typical:.3g}{mark} ({worst:.3g})")
        lines.append(f"| {row} | " + " | ".join(cells) + " |")
    return lines


def verdicts(records, table):
    """Return the lines of a Markdown table: how ours compares to the best of the others in every row."""
    lines = [
        "| | best of the others | ours to it | ours to the best fixed setting | draws won |",
        "|---" * 5 + "|",
    ]
    middle = medians(records, table, table.others)
    ratios = ratios_of(records, table)
    for (row, draws), errors, to in zip(table.draws.items(), middle, ratios, strict=True):
        best = table.others[np.nanargmin(errors)]
        ours, theirs = (drawn(records, row, name, draws) for name in (table.ours, best))
        won = f"{(ours < theirs).sum()} of {draws}"
        lines.append(f"| {row} | {best} | {to[0]:.3f} | {to[1]:.3f} | {won} |")
    for name, mean in (("geometric mean", geometric_mean), ("median", np.median), ("worst", np.max)):
        lines.append(f"| {name} | | {mean(ratios[:, 0]):.3f} | {mean(ratios[:, 1]):.3f} | |")
    return [*lines, "", *summary(ratios)]


def ratios_of(records, table):
    """Return ours to the best of the others and to the best fixed setting, (rows, 2)."""
    ours = medians(records, table, [table.ours])
    others = np.nanmin(medians(records, table, table.others), axis=1, keepdims=True)
    return ours / np.hstack([others, medians(records, table, [FIXED])])


def geometric_mean(ratios):
    """Return the geometric mean."""
    return np.exp(np.log(ratios).mean())


def summary(ratios):
    """Return the line that says how ours compares to the best of all, in all rows of a table."""
    worse = ratios.max(axis=1)
    within = (worse <= CLOSE).sum()
    return [
        f"Ours over the best of the others and the best fixed setting: geometric mean {geometric_mean(worse):.3f}, "
        f"median {np.median(worse):.3f}; within {100 * (CLOSE - 1):.0f} % in {within} of {len(worse)} rows."
    ]


def draw_ratios(records, tables, path):
    """Plot every method's median error relative to the best one's, a panel for each table and a line for each row."""
    heights = [len(table.draws) for table in tables]
    size = 10, 1.5 + 0.36 * sum(heights) + 0.6 * len(tables)
    figure = Figure(figsize=size, layout="constrained", dpi=110)
    panels = figure.subplots(len(tables), sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    for table, axes in zip(tables, panels, strict=True):
        draw_panel(records, table, axes)
    panels[-1].set_xlabel("median error relative to the best method of the row")
    labels = {}
    for axes in panels:
        labels |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    shown = [name for name in LOOKS if name in labels]
    figure.legend([labels[name] for name in shown], shown, loc="outside upper center", ncols=4, frameon=False)
    figure.savefig(path)


def draw_panel(records, table, axes):
    """Plot the rows of a table."""
    order = [name for name in LOOKS if name in table.methods]
    middle = medians(records, table, order)
    ratios = (middle / np.nanmin(middle, axis=1, keepdims=True)).clip(max=FAR)
    rows = list(table.draws)
    axes.axvspan(1, CLOSE, color="#009E73", alpha=0.2, lw=0)
    for k, (name, across) in enumerate(zip(order, ratios.T, strict=True)):
        marker, colour = LOOKS[name]
        below = np.arange(len(rows)) + 0.7 * ((k + 0.5) / len(order) - 0.5)
        size = 9 if name in {table.ours, FIXED} else 6
        edge = {"mec": "white", "mew": 0.6} if marker != "|" else {"mew": 2}
        axes.plot(across, below, marker, color=colour, ms=size, label=name, clip_on=False, zorder=3, **edge)
    axes.hlines(np.arange(1, len(rows)) - 0.5, 0.97, FAR, color="#DDDDDD", lw=0.8)
    axes.set_title(table.title, loc="left", fontsize=11)
    axes.set(xscale="log", xlim=(0.97, FAR), ylim=(len(rows) - 0.5, -0.5))
    axes.set_xticks([1, 1.2, 1.5, 2, 3, 5, 10], ["1", "1.2", "1.5", "2", "3", "5", "10 or more"])
    axes.set_xticks([], minor=True)
    axes.set_yticks(range(len(rows)), rows)
    axes.grid(axis="x", alpha=0.3)


def arguments():
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add = parser.add_argument
    add("data", metavar="DATA", type=Path, help="directory; what it lacks is left out")
    add("--out", metavar="DIR", type=Path, required=True, help="made if it does not exist")
    add("--quick", action="store_true", help=f"{FEW} draws a row instead of {DRAWS}, {IN_GAPS} or {MANY}")
    add("--rows", default="", metavar="A,B", help="only those whose name contains one of these texts")
    add("--methods", default="", metavar="A,B", help="only those whose name contains one of these texts")
    add("--again", action="store_true", help="compute these rows and methods anew")
    return parser.parse_args()


def run(options):
    """Compute, and write the tables and the plot."""
    options.out.mkdir(parents=True, exist_ok=True)
    tables = tables_of(options)
    if not tables:
        sys.exit(f"No row and method have such names; methods are {', '.join(LOOKS)}.")
    with Errors(options.out / "errors.csv") as records:
        compute(options, records, tables)
        lines = []
        for table in tables:
            lines += [f"### {table.title}", "", *errors_table(records, table), ""]
            if {table.ours, FIXED, *table.others} <= {*table.methods} and table.others:
                lines += [*verdicts(records, table), ""]
        (options.out / "models.md").write_text("\n".join(lines), encoding="utf-8")
        print("\n".join(lines))
        draw_ratios(records, tables, options.out / "models.png")


if __name__ == "__main__":
    run(arguments())
