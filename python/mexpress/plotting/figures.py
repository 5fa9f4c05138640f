"""What all figures share."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np

from mexpress._validation import Floats

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
        figure.savefig(path)
    return figure


def frame(axes: Axes, points: Floats, y_down: bool = True) -> None:
    """Show the points with a margin, y downwards as an image has them or upwards as a map."""
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.04 * float((high - low).max())
    y = (high[1] + margin, low[1] - margin) if y_down else (low[1] - margin, high[1] + margin)
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=y)
    axes.set_aspect("equal")


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
