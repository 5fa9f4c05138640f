"""What all figures share."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress._validation import Floats, Integers

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, told apart by the colour-blind too.
BLUE, SKY, GREEN, YELLOW = "#0072B2", "#56B4E9", "#009E73", "#F0E442"
ORANGE, RED, GRAY = "#E69F00", "#D55E00", "#777777"

PathLike = str | os.PathLike[str]


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure; sizes in inches."""
    try:
        from matplotlib.figure import Figure  # noqa: PLC0415  an extra, imported where used
    except ImportError as error:
        message = "Plots need matplotlib: pip install 'mexpress[plot]'"
        raise ImportError(message) from error
    return Figure(figsize=(width, height), dpi=110, layout="constrained")


def saved(figure: Figure, path: PathLike | None) -> Figure:
    """Return the figure, saved if there is a path."""
    if path is not None:
        file = check.path(path)
        known = figure.canvas.get_supported_filetypes()
        if file.suffix[1:].lower() not in known:
            check.refuse("path", f"It must end in one of .{', .'.join(sorted(known))}.", repr(str(file)))
        figure.savefig(file)
    return figure


def frame(axes: Axes, points: Floats, y_down: bool = True) -> None:
    """Show the points with a margin, y downwards as an image has them or upwards as a map."""
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.04 * float((high - low).max())
    y = (high[1] + margin, low[1] - margin) if y_down else (low[1] - margin, high[1] + margin)
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=y)
    axes.set_aspect("equal")


def known_rows(aside: Aside | None, **arrays: ArrayLike) -> tuple[list[Floats], Aside]:
    """Return the rows of arrays that are finite in all of them, and which of these rows are not in a fit."""
    tables = {name: check.as_rows(check.real(array, name)) for name, array in arrays.items()}
    n = np.atleast_1d(next(iter(tables.values()))).shape[0]
    for name, table in tables.items():
        if table.shape[:1] != (n,):
            check.refuse(name, f"It must have {n} rows, one for each datum.", f"shape {table.shape}")
    known = check.whole_rows(**tables)
    return [table[known] for table in tables.values()], (aside or Aside()).among(known)


@dataclass(frozen=True)
class Aside:
    """Data that are not in a fit: left out as wrong, or absent because their weight is 0; indices of each."""

    left_out: ArrayLike = ()
    absent: ArrayLike = ()

    def kept(self, n: int) -> Integers:
        """Return the indices of the others."""
        return np.setdiff1d(np.arange(n), np.union1d(self.left_out, self.absent))

    def among(self, known: NDArray[np.bool_]) -> Aside:
        """Return the same data by their indices among those of all that are known."""
        rank = np.cumsum(known) - 1
        every = [check.indices(some, "aside", len(known)) for some in (self.left_out, self.absent)]
        return Aside(*(rank[some[known[some]]] for some in every))

    def draw(self, axes: Axes, points: Floats) -> None:
        """Mark data that were left out by crosses, and absent ones by rings."""
        for some, marker, colour, name in (
            (self.left_out, "x", "black", "left out"),
            (self.absent, "o", GRAY, "absent"),
        ):
            if np.size(some):
                where = points[np.asarray(some)]
                label = f"{len(where)} {name}"
                axes.plot(*where.T, marker, color=colour, mfc="none", ms=6, mew=1.4, label=label, zorder=5)


def logarithmic(axes: Axes) -> None:
    """Make the y axis logarithmic, with plain numbers and enough of them."""
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    axes.set_yscale("log", subs=(2, 5) if high < 1000 * low else ())
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("{x:g}")


def with_unit(name: str, unit: str | None) -> str:
    """Return a label with its unit."""
    return f"{name} ({unit or 'unit of the data'})"


def percentile(values: Floats, percent: float) -> float:
    """Return a percentile of what is finite, or 0."""
    known = values[np.isfinite(values)]
    return float(np.percentile(known, percent)) if known.size else 0.0
