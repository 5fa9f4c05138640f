"""How far from held-out points warps and surfaces are, of mexpress and of other libraries.

Usage: ``python experiments/compare_models.py DATA --out DIR [--quick] [--rows A,B] [--methods A,B] [--again]``; needs
scikit-image, scipy, matplotlib and treverhines-rbf. DATA is a directory with any of

sheets/NAME.npz   image_points (views, n, 2) of a sheet that deforms: hulk and kinectpaper
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
from pathlib import Path

import numpy as np
from comparison import problems
from comparison.errors import Errors
from comparison.methods import SURFACES, WARPS, error
from matplotlib.figure import Figure

import mexpress as mx

DRAWS, FEW = 12, 4
MANY = 48
"""Draws of two views of a tracked sheet, which differ more than other draws do."""

OURS = "mexpress tps auto"
CLOSE, FAR = 1.03, 10.0
"""Times the best's error: what counts as equal, and where the plot ends."""

TOO_LONG = {
    (row, name)
    for row in ("homography (300)", "TUM (1000)", "PrimeSense (1000)", "Jacksboro (1000)")
    for name in ("mexpress bspline", "mexpress affine")
}
"""Up to minutes a draw, so left out: what is held out often leaves cells without data, and such fits are repeated."""

LOOKS = {
    "homography": ("s", "#777777"),
    "plane": ("s", "#777777"),
    "scikit-image TPS": ("v", "#56B4E9"),
    "scipy RBF leave-one-out": ("^", "#0072B2"),
    "scipy RBF 10-fold": ("d", "#0072B2"),
    "treverhines-rbf auto": ("D", "#009E73"),
    "mexpress affine": ("X", "#E69F00"),
    "mexpress bspline": ("P", "#E69F00"),
    "mexpress tps": ("o", "#E69F00"),
    "mexpress affine auto": ("X", "#D55E00"),
    "mexpress bspline auto": ("P", "#D55E00"),
    "mexpress tps auto": ("o", "#D55E00"),
}
"""Marker and colour; methods of a row are drawn from above to below in this order."""


def judge(data, row, draw, names):
    """Return {method: (error, seconds)} for a draw of a row."""
    problem = (problems.warps(data) | problems.surfaces(data))[row](draw)
    results = {}
    for name in names:
        start = time.perf_counter()
        results[name] = error(problem, (WARPS | SURFACES)[name]), time.perf_counter() - start
    return results


def containing(texts, names):
    """Return the names that contain any of the texts."""
    return [name for name in names if any(text in name for text in texts)]


def needed(options, records, key):
    """Tell whether the error of a row, draw and method is to be computed."""
    row, _, name = key
    return (row, name) not in TOO_LONG and (options.again or key not in records)


def draws_of(row, quick):
    """Return how many draws of a row there are."""
    return FEW if quick else MANY if row.startswith(("hulk", "kinectpaper")) else DRAWS


def compute(options, records, tables, draws):
    """Compute the errors that are missing, the first draws of all rows first."""
    wanted = [
        (options.data, row, draw, names)
        for draw in range(max(draws.values()))
        for rows, methods in tables
        for row in rows
        if draw < draws[row]
        if (names := [name for name in methods if needed(options, records, (row, draw, name))])
    ]
    print(f"{len(wanted)} draws to compute", file=sys.stderr)

    def keep(index, results):
        records.keep(*wanted[index][1:3], results)

    mx.map_problems(judge, wanted, progress=True, on_result=keep)


def medians(records, rows, methods, draws):
    """Return the median error of every row and method; NaN unless all draws are there."""
    return np.array([[np.median(records.drawn(row, name, draws[row])) for name in methods] for row in rows])


def table(records, rows, methods, draws):
    """Return the lines of a Markdown table: medians, bold if equal to the best, and the worst draws in brackets."""
    middle = medians(records, rows, methods, draws)
    lines = ["| | " + " | ".join(methods) + " |", "|---" * (len(methods) + 1) + "|"]
    for row, errors in zip(rows, middle, strict=True):
        best, cells = CLOSE * np.nanmin(errors), []
        for name, typical in zip(methods, errors, strict=True):
            mark, worst = "**" if typical <= best else "", records.drawn(row, name, draws[row]).max()
            cells.append("" if np.isnan(typical) else f"{mark}{typical:.3g}{mark} ({worst:.3g})")
        lines.append(f"| {row} | " + " | ".join(cells) + " |")
    return lines


def verdicts(records, rows, methods, draws):
    """Return the lines of a Markdown table: how ours compares to the best of the others in every row."""
    lines = ["| | best of the others | ours to it | draws won |", "|---|---|---|---|"]
    others = [name for name in methods if not name.startswith("mexpress")]
    middle = medians(records, rows, others, draws)
    for row, errors in zip(rows, middle, strict=True):
        best = others[np.nanargmin(errors)]
        ours, theirs = (records.drawn(row, name, draws[row]) for name in (OURS, best))
        won = f"{(ours < theirs).sum()} of {draws[row]}"
        lines.append(f"| {row} | {best} | {np.median(ours) / np.median(theirs):.3f} | {won} |")
    return lines


def draw_ratios(records, tables, draws, path):
    """Plot every method's median error relative to the best one's, a line for each row of the tables."""
    rows = [row for some, _ in tables for row in some]
    figure = Figure(figsize=(10, 1.3 + 0.5 * len(rows)), layout="constrained", dpi=120)
    axes = figure.subplots()
    axes.axvspan(1, CLOSE, color="#009E73", alpha=0.2, lw=0)
    shown = [name for name in LOOKS if any(name in methods for _, methods in tables)]
    for some, methods in tables:
        order = [name for name in LOOKS if name in methods]
        middle = medians(records, some, methods, draws)
        ratios = middle / np.nanmin(middle, axis=1, keepdims=True)
        for name, across in zip(methods, ratios.T, strict=True):
            marker, colour = LOOKS[name]
            place = (order.index(name) + 0.5) / len(order)
            below = [rows.index(row) + 0.7 * (place - 0.5) for row in some]
            size = 10 if name == OURS else 6.5
            look = {"color": colour, "mec": "white", "mew": 0.6, "clip_on": False, "zorder": 3}
            axes.plot(across.clip(max=FAR), below, marker, ms=size, label=name, **look)
    axes.hlines(np.arange(1, len(rows)) - 0.5, 0.97, FAR, color="#DDDDDD", lw=0.8)
    axes.set(xscale="log", xlim=(0.97, FAR), xlabel="median error relative to the best method of the row")
    axes.set_xticks([1, 1.2, 1.5, 2, 3, 5, 10], ["1", "1.2", "1.5", "2", "3", "5", "10 or more"])
    axes.set_xticks([], minor=True)
    axes.set(ylim=(len(rows) - 0.5, -0.5))
    axes.set_yticks(range(len(rows)), rows)
    axes.grid(axis="x", alpha=0.3)
    labels = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    shown = [name for name in shown if name in labels]
    figure.legend([labels[name] for name in shown], shown, loc="outside right upper", frameon=False)
    figure.savefig(path)


def arguments():
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add = parser.add_argument
    add("data", metavar="DATA", type=Path, help="directory; what it lacks is left out")
    add("--out", metavar="DIR", type=Path, required=True, help="made if it does not exist")
    add("--quick", action="store_true", help=f"{FEW} draws a row instead of {DRAWS} or {MANY}")
    add("--rows", default="", metavar="A,B", help="only those whose name contains one of these texts")
    add("--methods", default="", metavar="A,B", help="only those whose name contains one of these texts")
    add("--again", action="store_true", help="compute these rows and methods anew")
    return parser.parse_args()


def run(options):
    """Compute, and write the tables and the plot."""
    options.out.mkdir(parents=True, exist_ok=True)
    tables = []
    for drawn, named in (problems.warps(options.data), WARPS), (problems.surfaces(options.data), SURFACES):
        rows = containing(options.rows.split(","), drawn)
        methods = containing(options.methods.split(","), named)
        if rows and methods:
            tables.append((rows, methods))
    if not tables:
        sys.exit(f"No row and method have such names; methods are {', '.join(LOOKS)}.")
    draws = {row: draws_of(row, options.quick) for rows, _ in tables for row in rows}
    with Errors(options.out / "errors.csv") as records:
        compute(options, records, tables, draws)
        lines = []
        for rows, methods in tables:
            lines += [*table(records, rows, methods, draws), ""]
            if OURS in methods:
                lines += [*verdicts(records, rows, methods, draws), ""]
        (options.out / "models.md").write_text("\n".join(lines), encoding="utf-8")
        print("\n".join(lines))
        draw_ratios(records, tables, draws, options.out / "models.png")


if __name__ == "__main__":
    run(arguments())
