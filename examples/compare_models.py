"""How far from held-out points warps and surfaces are, of mexpress and of other libraries.

Usage: ``python examples/compare_models.py DATA --out DIR [--quick] [--rows A,B] [--methods A,B] [--again]``; needs
scikit-image, scipy, matplotlib and treverhines-rbf. DATA is a directory with any of

sheets/NAME.npz   image_points (views, n, 2) of a sheet that deforms: hulk and kinectpaper
depth/TUM_depth.png, depth_00000.png   depth maps

Of a row of the table problems are drawn at random, always the same ones. Every method is used in one way in all rows. What
counts is the median over the draws of the root mean square error: a draw in which a model folds, or the best is found
by luck, has no more weight than another. The worst draw stands beside it.

DIR/errors.csv keeps all errors, so what is there is not computed again; DIR gets models.md and models.png too.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from comparison import problems
from comparison.methods import SURFACES, WARPS, error
from comparison.records import Records
from matplotlib.figure import Figure

import mexpress as mx

DRAWS, FEW = 24, 4
OURS = "mexpress tps auto"
CLOSE = 1.03
METHODS = WARPS | SURFACES


def judge(data, row, draw, names):
    """Return {method: (error, seconds)} for a draw of a row."""
    problem = (problems.warps(data) | problems.surfaces(data))[row](draw)
    found = {}
    for name in names:
        start = time.perf_counter()
        found[name] = error(problem, METHODS[name]), time.perf_counter() - start
    return found


def containing(texts, names):
    """Return the names that contain any of the texts."""
    return [name for name in names if any(text in name for text in texts)]


def compute(options, records, tables, draws):
    """Compute the errors that are missing, the first draws of all rows first."""
    wanted = [
        (options.data, row, draw, names)
        for draw in range(draws)
        for rows, methods in tables
        for row in rows
        if (names := [name for name in methods if options.again or not records.has(row, draw, name)])
    ]
    print(f"{len(wanted)} draws to compute", file=sys.stderr)

    def keep(index, results):
        records.add(*wanted[index][1:3], results)

    mx.map_problems(judge, wanted, progress=True, on_result=keep)


def summary(errors):
    """Return what counts of the errors of some draws, and the worst of them."""
    return float(np.median(errors)), float(errors.max())


def arguments():
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add = parser.add_argument
    add("data", metavar="DATA", type=Path, help="directory; what it lacks is left out")
    add("--out", metavar="DIR", type=Path, required=True, help="made if it does not exist")
    add("--quick", action="store_true", help=f"{FEW} draws a row instead of {DRAWS}")
    add("--rows", default="", metavar="A,B", help="only those whose name contains one of these texts")
    add("--methods", default="", metavar="A,B", help="only those whose name contains one of these texts")
    add("--again", action="store_true", help="compute these rows and methods anew")
    return parser.parse_args()


def run(options):
    """Compute, and write the tables and the plot."""
    options.out.mkdir(parents=True, exist_ok=True)
    records = Records(options.out / "errors.csv")
    rows, methods = options.rows.split(","), options.methods.split(",")
    tables = [
        (containing(rows, draw), containing(methods, named))
        for draw, named in ((problems.warps(options.data), WARPS), (problems.surfaces(options.data), SURFACES))
    ]
    compute(options, records, tables, FEW if options.quick else DRAWS)


if __name__ == "__main__":
    run(arguments())
