"""What all figures share."""

from __future__ import annotations

import io
import os
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.extras import required

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

# Okabe and Ito's colours, told apart by the colour-blind too.
BLUE, SKY, GREEN, YELLOW = "#0072B2", "#56B4E9", "#009E73", "#F0E442"
ORANGE, RED, GRAY = "#E69F00", "#D55E00", "#777777"

PathLike = str | os.PathLike[str]


FEW = 60
"""So many control points stand out; more would hide the data."""


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure that a notebook shows without pyplot; sizes in inches."""
    matplotlib = required("matplotlib.figure", "Plots need matplotlib", "plot")
    return _class_of_figures(matplotlib.Figure)(figsize=(width, height), dpi=110, layout="constrained")


@cache
def _class_of_figures(plain: type[Figure]) -> type[Figure]:
    def savefig(figure: Figure, *arguments: Any, **options: Any) -> None:
        figure.draw_without_rendering()  # the layout finds room for all labels at the second drawing only
        plain.savefig(figure, *arguments, **options)

    def png(figure: Figure) -> bytes:
        file = io.BytesIO()
        figure.savefig(file, format="png")
        return file.getvalue()

    def reduced(figure: Figure) -> tuple[Any, ...]:  # no pickle finds a class that was made here
        return plain.__new__, (plain,), figure.__getstate__()

    return type("Figure", (plain,), {"savefig": savefig, "_repr_png_": png, "__reduce__": reduced})


def figure_of(axes: Axes) -> Figure:
    """Return the figure that axes are in, if need be in a part of it."""
    figure: Figure = axes.figure.canvas.figure
    return figure


def given_axes(ax: Any, kinds: tuple[str, ...] = ("rectilinear",)) -> Axes:
    """Return a caller's axes, if they are of a kind that can be drawn into."""
    if getattr(ax, "name", None) not in kinds or not hasattr(ax, "transData"):
        several = " or ".join("3d" if kind == "3d" else "plain" for kind in kinds)
        check.refuse("ax", f"It must be {several} axes of matplotlib.", check.describe(ax), TypeError)
    axes: Axes = ax
    return axes


def colour_bar(axes: Axes, colours: ScalarMappable, label: str, extend: str) -> None:
    """Draw a colour bar beside axes, as tall as they are; in their place if no layout makes room beside them."""
    figure = figure_of(axes)
    room: dict[str, Any] = {"ax": axes}
    if figure.get_layout_engine() is not None:
        room = {"cax": axes.inset_axes((1.02, 0, 0.025, 1))}
    figure.colorbar(colours, label=label, extend=extend, **room)


def legend_below(figure: Figure) -> None:
    """Write one legend for all panels below them, each label once."""
    entries = (axes.get_legend_handles_labels() for axes in figure.axes)
    handles = {label: handle for entry in entries for handle, label in zip(*entry, strict=True)}
    if handles:
        figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=4, frameon=False)


def mark_control_points(axes: Axes, points: Floats, colour: str) -> None:
    """Mark control points: crosses that stand out if they are few, small dots on top of the data if they are many."""
    look: dict[str, Any] = {"marker": "P", "ms": 7, "mec": "white", "mew": 0.8}
    if len(points) > FEW:
        look = {"marker": "o", "ms": 2.4, "mew": 0}
    axes.plot(*points.T, ls="none", color=colour, zorder=4, label=f"{len(points)} control points", **look)


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
