"""Figures 2 and 3: criteria on many simulated problems."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mexpress.paper.table1_cells import Comparison, Curves
from mexpress.plotting.figures import (
    BLUE,
    GRAY,
    GREEN,
    ORANGE,
    RED,
    SKY,
    PathLike,
    logarithmic,
    new_figure,
    saved,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_GROUPS = {
    "leave-one-out and k-fold": {"PRESS": SKY, "CMPRESS": BLUE, "KF10": "#CC79A7", "KF05": "#7B3F63"},
    "exclusion radius": {"ER01": ORANGE, "ER05": RED, "ER10": "#7A2E00"},
    "nearest neighbours, a number": {"NN02PTS": "#5CBF9F", "NN05PTS": GREEN, "NN10PTS": "#004D38"},
    "nearest neighbours, a share": {"NN01PCT": "#B9A5DB", "NN05PCT": "#5B3A9B", "NN10PCT": "#341F61"},
}
_REFERENCES = {"FIT": (GRAY, "--"), "TEST": ("black", "-")}


def plot_mean_curves(curves: Mapping[int, Curves], path: PathLike | None = None) -> Figure:
    """Plot every criterion's mean and standard deviation against the number of control points (figure 2).

    A row of panels for each number of correspondences, a column for each kind of criterion, FIT and TEST in all.
    Dots mark the smallest means. Bands of a standard deviation to either side end there, or where the deviation
    comes near the mean, as beyond it does of a few problems with enormous scores. Values far above the smallest ones
    leave the frame.

    Parameters
    ----------
    curves : dict of int to Curves
        By number of correspondences.
    path : str or path, optional
        Where to save the figure.

    Returns
    -------
    matplotlib.figure.Figure
        Not shown.

    Raises
    ------
    ImportError
        Without matplotlib.
    """
    figure = new_figure(15.0, 3.0 * len(curves) + 0.6)
    panels = figure.subplots(len(curves), len(_GROUPS), sharex="row", sharey="row", squeeze=False)
    for row, (n, of) in zip(panels, curves.items(), strict=True):
        for axes, (title, colours) in zip(row, _GROUPS.items(), strict=True):
            looks = _REFERENCES | {name: (colour, "-") for name, colour in colours.items()}
            for name, (colour, style) in looks.items():
                _draw(axes, of, name, colour, style)
            if n == next(iter(curves)):
                beneath = {"title": title, "title_fontsize": 11, "fontsize": 9, "frameon": False}
                axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, **beneath)
            axes.grid(alpha=0.25, lw=0.6)
        _set_limits(row[0], of)
        row[0].set_ylabel(f"n = {n}\n\npixels")
    for axes in panels[-1]:
        axes.set_xlabel("number of control points")
    return saved(figure, path)


def _draw(axes: Axes, curves: Curves, name: str, colour: str, style: str) -> None:
    mean, deviation = curves.mean(name)
    reference = name in _REFERENCES
    axes.plot(curves.counts, mean, style, color=colour, lw=1.3 if reference else 1.8, label=name)
    best = curves.lowest(name)
    if best is None:
        return
    narrow = (curves.counts <= best) & (deviation < 0.8 * mean)  # the axis is logarithmic
    axes.fill_between(
        curves.counts, mean - deviation, mean + deviation, narrow, color=colour, alpha=0.1, lw=0
    )
    if name != "FIT":
        at = mean[curves.counts == best]
        axes.plot(best, at, "o", color=colour, ms=5, mec="white", zorder=5)


def _set_limits(axes: Axes, curves: Curves) -> None:
    """Logarithmic, from FIT's smallest mean to thrice what TEST is with the fewest control points."""
    fit, test = curves.mean("FIT")[0], curves.mean("TEST")[0]
    axes.set_ylim(np.nanmin(fit) / 1.3, 3 * np.nanmax(test[:1]))
    logarithmic(axes)


def plot_selections(comparisons: Sequence[Comparison], path: PathLike | None = None) -> Figure:
    """Plot what every criterion selects beside the paper's table 1, mean and standard deviation (figure 3).

    The number of control points above, FIT there below; a column of panels for each number of correspondences.

    Parameters
    ----------
    comparisons : sequence of Comparison
        From `mexpress.paper.table1_cells.compared`.
    path : str or path, optional
        Where to save the figure.

    Returns
    -------
    matplotlib.figure.Figure
        Not shown.

    Raises
    ------
    ImportError
        Without matplotlib.
    """
    sizes = list(dict.fromkeys(comparison.n for comparison in comparisons))
    figure = new_figure(15.0, 9.0)
    panels = figure.subplots(2, len(sizes), sharey=True, squeeze=False)
    for n, above, below in zip(sizes, *panels, strict=True):
        cells = [comparison for comparison in comparisons if comparison.n == n]
        _spans(above, cells, "count")
        _spans(below, cells, "fit")
        above.set_title(f"n = {n}", fontsize=11)
        above.set_xlabel("selected number of control points")
        below.set_xlabel("FIT there, in the paper's unit")
        below.set_xscale("log", subs=(2, 5))
        below.xaxis.set_major_formatter("{x:g}")
        below.xaxis.set_minor_formatter("{x:g}")
    panels[0, 0].invert_yaxis()
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return saved(figure, path)


def _spans(axes: Axes, cells: Sequence[Comparison], what: str) -> None:
    """Draw means and standard deviations, a line for each criterion."""
    places = np.arange(len(cells))
    looks = (("here", "ours", BLUE, "o", -0.18), ("paper", "paper", ORANGE, "s", 0.18))
    for label, who, colour, marker, offset in looks:
        mean = np.array([getattr(getattr(cell, who), what) for cell in cells])
        deviation = np.array([getattr(getattr(cell, who), f"{what}_std") for cell in cells])
        below = np.minimum(deviation, 0.9 * mean) if what == "fit" else deviation  # the axis is logarithmic
        look: dict[str, Any] = {"fmt": marker, "color": colour, "ms": 5, "capsize": 2.5, "label": label}
        axes.errorbar(mean, places + offset, xerr=(below, deviation), **look)
    axes.set_yticks(places, [cell.name for cell in cells])
    axes.grid(alpha=0.25, lw=0.6)
