"""What the commands share: options, warnings, and the files of a selection."""

from __future__ import annotations

import argparse
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from mexpress._validation import Floats
from mexpress.cli import report as reports
from mexpress.geometry import inside
from mexpress.selection import Selection
from mexpress.selection.defaults import AUTO


class Parser(argparse.ArgumentParser):
    """Errors are one line, without the usage."""

    def error(self, message: str) -> NoReturn:
        """Raise `UsageError`."""
        raise UsageError(f"{message} ({self.prog} --help tells more)")


class UsageError(Exception):
    """The command line cannot be understood."""


def warn(message: str) -> None:
    """Say on standard error what the results do not."""
    print(f"mexpress: {message}", file=sys.stderr)


def add_selection(parser: Parser, placements: str) -> None:
    """Add the options that every selection has; `placements` tells of the ways to spread control points."""
    add = parser.add_argument
    add(
        "--criterion",
        help="what selects: FIT, PRESS, CMPRESS, KFkk, ERxx, ... (default: MATCHED, or ER10 without --smoothing auto)",
    )
    add("--criteria", type=_names, metavar="A,B,...", help="also shown (default: FIT,PRESS,CMPRESS)")
    add(
        "--smoothing",
        type=_smoothing,
        default=AUTO,
        metavar="W[,W...]|auto",
        help="weight of the bending energy, larger is stiffer; the best of several, or of twenty with auto; 0 is the "
        "method of the paper (default: auto)",
    )
    add("--lifting", default="tps", help="functions that bend the plane: tps, bspline, affine (default: tps)")
    add("--placement", metavar="NAME", help=f"how control points are spread: {placements}")
    add_run(parser)


def add_run(parser: Parser) -> None:
    """Add the options of every run that writes into a directory."""
    threads = "at most so many (default: MEXPRESS_NUM_THREADS, or all cores)"
    add = parser.add_argument
    add("--seed", type=int, default=0, metavar="N", help="of everything random (default: 0)")
    add("--threads", type=int, metavar="N", help=threads)
    add("--out", type=Path, required=True, metavar="DIR", help="where to write; made if it does not exist")
    add("--no-plots", dest="plots", action="store_false", help="write no PNG files")
    add("--quiet", action="store_true", help="show no progress")


def selection_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return what `select_warp` and `select_surface` both take."""
    names = "criterion", "criteria", "lifting", "placement", "smoothing", "seed", "threads"
    return {**{name: getattr(arguments, name) for name in names}, "progress": not arguments.quiet}


def _smoothing(text: str) -> float | list[float] | str:
    if text.strip().lower() == AUTO:
        return AUTO
    try:
        weights = [float(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"must be a weight, weights such as 0,10,100, or auto, not {text!r}"
        ) from None
    return weights[0] if len(weights) == 1 else weights


def _names(text: str) -> list[str]:
    return [name for name in re.split(r"[,\s]+", text) if name]


def print_selection(selection: Selection, remark: str = "") -> None:
    """Print the table, a remark on it, and what is selected."""
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    print(reports.table(selection, width=width))
    if remark:
        print(f"({remark})")
    name, smoothing = selection.criterion, ""
    if len(selection.weights) > 1:
        smoothing = f" and smoothing {selection.smoothing:.3g}"
        if selection.parameters is not None:
            smoothing += f", {selection.parameters[selection.place]:.1f} effective parameters"
    print(f"\n{name} selects {selection.count} control points{smoothing}: {name} {selection.score:.4g}.")


def warn_selection(selection: Selection, lost: str, advice: str) -> None:
    """Warn of what makes a selection doubtful.

    Parameters
    ----------
    selection : Selection
        What was selected.
    lost : str
        What is lost where a criterion is undefined, such as "the warp for match".
    advice : str
        What to do when the largest number of control points tried is the selected one.
    """
    counts = selection.counts
    weights, by_weight = selection.weights, len(selection.weights) > 1
    if selection.open.get(selection.count):
        unknowns = selection.open[selection.count]
        warn(
            f"the data leave {unknowns} unknowns open at {selection.count} control points: smoothing determines them."
        )
    if by_weight and selection.smoothing == weights[0] > 0 and selection.count > counts[0]:
        warn("the smallest smoothing tried is selected: less may be better, see --smoothing.")
    if selection.count == counts[-1] and len(counts) > 1 and not by_weight:
        warn(f"{selection.count} is the largest number tried: more may be better, see {advice}.")
    for name, by_count in selection.undefined.items():
        first = min(by_count)
        some = ", ".join(map(str, by_count[first][:5])) + (", ..." if len(by_count[first]) > 5 else "")
        if len(counts) > len(by_count) == (counts >= first).sum():
            where = f"from {first} control points on"
        else:
            where = f"at {len(by_count)} of {len(counts)} numbers of control points, first at {first}"
        warn(f"{name} has no score {where}: what it leaves does not determine {lost} {some} (from 0).")


def write_selection(arguments: argparse.Namespace, selection: Selection, more: dict[str, Any]) -> list[str]:
    """Write what every selection has; return the names of the files."""
    command = {name: _json(value) for name, value in vars(arguments).items() if name != "run"}
    reports.write_summary(
        arguments.out / "selection.json", {"command": command, **reports.summary(selection), **more}
    )
    reports.write_curves(arguments.out / "curves.csv", selection)
    return ["selection.json", "curves.csv"]


def _json(value: Any) -> Any:
    return str(value) if isinstance(value, Path) else value


def draw(arguments: argparse.Namespace, plots: dict[str, Callable[[Path], Any]]) -> list[str]:
    """Draw every plot into the file of its name, if plots are wanted and can be made; return the names."""
    if not arguments.plots:
        return []
    try:
        for name, plot in plots.items():
            plot(arguments.out / name)
    except ImportError as error:  # the numbers are worth more than the plots
        warn(f"no plots. {error}")
        return []
    return list(plots)


def sizes_summary(sizes: Floats) -> dict[str, float]:
    """Return what there is to know about the sizes (n,) of errors."""
    return {
        "rms": float(np.sqrt((sizes**2).mean())),
        "median": float(np.median(sizes)),
        "largest": float(sizes.max()),
    }


def sizes_text(sizes: dict[str, float]) -> str:
    """Return such a summary as text."""
    numbers = ((name, f"{size:.3g}" if np.isfinite(size) else "undefined") for name, size in sizes.items())
    return ", ".join(f"{name} {number}" for name, number in numbers)


def warn_outside(domain: Floats, points: Floats, total: int, region: str) -> None:
    """Warn of how many points are outside a model's domain, the corners of a convex polygon."""
    outside = len(points) - np.count_nonzero(inside(domain, *points.T))
    if outside:
        warn(f"{outside} of {total} points are outside {region} extrapolates there")
