"""How much is lost by what a criterion selects: error over that of the best of the models it chose from.

Usage: ``python examples/compare_criteria.py --out DIR [--quick]``; needs matplotlib. Random surfaces are
sampled with noise in three ways (`comparison.fields`): every datum with noise of its own, with noise that neighbours
share, and few data in clusters. The models are those of `mexpress.select_surface`, a number of control points each; the
error is the root mean square distance to the surface itself over the whole square.

DIR/criteria.csv keeps the losses, so what is there is not computed again; DIR gets criteria.md and criteria.png too.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from comparison.fields import sample
from comparison.records import Records
from demo_surface import true_errors
from matplotlib.figure import Figure

import mexpress as mx

KINDS = {
    "independent": "noise of its own",
    "correlated": "noise shared by neighbours",
    "clustered": "few data, in clusters",
}
CRITERIA = ("CMPRESS", "KF10", "GCV", "AIC", "BIC", "ER01", "ER05", "ER10", "NN01PCT", "NN05PCT", "NN10PCT")
DRAWS, FEW = 40, 6
LARGEST = 175
MOST = 300.0
"""Where the plot ends, in per cent."""


def losses(kind, draw, names):
    """Return {criterion: (loss in per cent, seconds)} for a draw."""
    data, start = sample(kind, draw), time.perf_counter()
    largest = min(LARGEST, len(data.points) // 2)
    selection = mx.select_surface(data.points, data.values, "FIT", names, max_count=largest)
    seconds = (time.perf_counter() - start) / len(names)
    errors = true_errors(selection, selection.control_points, data.grid, data.truth)
    found = {}
    for name in names:
        count = selection.selected[name]
        chosen = np.inf if count is None else errors[selection.counts == count][0]
        found[name] = float(100 * (chosen / errors.min() - 1)), seconds
    return found


def compute(records, draws):
    """Compute the losses that are missing."""
    wanted = [
        (kind, draw, names)
        for draw in range(draws)
        for kind in KINDS
        if (names := [name for name in CRITERIA if not records.has(kind, draw, name)])
    ]
    mx.map_problems(
        losses, wanted, progress=True, on_result=lambda k, found: records.add(*wanted[k][:2], found)
    )


def table(records, draws):
    """Return the lines of a Markdown table: the median loss and the 90th percentile."""
    lines = ["| criterion | " + " | ".join(KINDS.values()) + " |", "|---" * (len(KINDS) + 1) + "|"]
    for name in CRITERIA:
        cells = (np.percentile(records.drawn(kind, name, draws), [50, 90]) for kind in KINDS)
        lines.append(
            f"| {name} | " + " | ".join(f"{middle:.0f} ({high:.0f})" for middle, high in cells) + " |"
        )
    return lines


def draw_losses(records, draws, path):
    """Plot the loss of every surface, a line for each criterion, with the median and the 90th percentile."""
    figure = Figure(figsize=(11, 1.4 + 0.3 * len(CRITERIA)), layout="constrained", dpi=120)
    for axes, (kind, title) in zip(figure.subplots(1, len(KINDS), sharey=True), KINDS.items(), strict=True):
        for height, name in enumerate(reversed(CRITERIA)):
            found = records.drawn(kind, name, draws).clip(max=MOST)
            middle, high = np.percentile(found, [50, 90])
            axes.plot(found, np.full(draws, height), "o", color="#0072B2", alpha=0.35, ms=4, mew=0)
            axes.plot([middle, high], [height, height], color="#D55E00", lw=2)
            axes.plot(middle, height, "o", color="#D55E00", ms=8, mec="white")
        axes.set_xscale("symlog", linthresh=10)
        axes.set(
            title=title, xlim=(-0.5, MOST), yticks=range(len(CRITERIA)), xlabel="error over the best (%)"
        )
        axes.set_yticklabels(CRITERIA[::-1])
        ticks = [0, 5, 10, 30, 100, 300]
        axes.set_xticks(ticks, ticks)
        axes.set_xticks([], minor=True)
        axes.grid(alpha=0.25)
    figure.savefig(path)


def arguments():
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add = parser.add_argument
    add("--out", metavar="DIR", type=Path, required=True, help="made if it does not exist")
    add("--quick", action="store_true", help=f"{FEW} surfaces instead of {DRAWS}")
    return parser.parse_args()


def run(options):
    """Compute, and write the table and the plot."""
    options.out.mkdir(parents=True, exist_ok=True)
    records, draws = Records(options.out / "criteria.csv"), FEW if options.quick else DRAWS
    compute(records, draws)
    lines = "\n".join(table(records, draws))
    (options.out / "criteria.md").write_text(f"{lines}\n", encoding="utf-8")
    print(lines)
    draw_losses(records, draws, options.out / "criteria.png")


if __name__ == "__main__":
    run(arguments())
