"""A model's score against the radius within which data are held out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mexpress.plotting.figures import (
    BLUE,
    GRAY,
    ORANGE,
    RED,
    PathLike,
    figure_of,
    given_axes,
    new_figure,
    saved,
    with_unit,
)
from mexpress.radii import RadiusCurve

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ADVICE, _PARTS = (5.0, 10.0), (50, 95)
_RADIUS = "radius (% of the diagonal)"
_SMALL: dict[str, Any] = {"color": GRAY, "fontsize": 8}


def plot_radii(
    curve: RadiusCurve, path: PathLike | None = None, *, ax: Axes | None = None, unit: str | None = None
) -> Figure:
    """Plot the score against the exclusion radius, over the distances at which the model will be used.

    Above, the score; below, how much of the region that the data cover is within a distance of a datum. Where
    the lower curve has risen to most of the domain, larger radii ask more of the model than its use within
    this region does. The band is the paper's advice, 5 to 10 % of the diagonal.

    Parameters
    ----------
    curve : RadiusCurve
        From `mexpress.radii.score_by_radius`.
    path : str or path, optional
        Where to save the figure; the suffix says how (.png, .pdf, .svg).
    ax : matplotlib.axes.Axes, optional
        Where to draw the upper panel alone, in place of a figure of its own.
    unit : str, optional
        Of the score.

    Returns
    -------
    matplotlib.figure.Figure
        That of `ax`, or a new one, which notebooks show.

    Raises
    ------
    ImportError
        Without matplotlib.

    Examples
    --------
    >>> from mexpress.radii import RadiusCurve
    >>> reach = np.linspace(0, 4, 50)
    >>> plot_radii(RadiusCurve(np.array([0.0, 5.0]), np.array([1.0, 1.5]), np.array([1.0, 9.0]), reach))
    <Figure size ...>
    """
    if ax is not None:
        _draw_scores(given_axes(ax), curve, unit)
        ax.set_xlabel(_RADIUS)
        return saved(figure_of(ax), path)
    figure = new_figure(7.2, 5.4)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[2.4, 1])
    _draw_scores(above, curve, unit)
    _draw_reach(below, curve)
    return saved(figure, path)


def _draw_scores(axes: Axes, curve: RadiusCurve, unit: str | None) -> None:
    axes.plot(curve.percents, curve.scores, "o-", color=RED, ms=5)
    for percent, score, held in zip(curve.percents, curve.scores, curve.held, strict=True):
        if np.isfinite(score):
            number = f"{held:.1f}" if held < 10 else f"{held:.0f}"
            axes.annotate(number, (percent, score), (0, 8), textcoords="offset points", ha="center", **_SMALL)
    axes.set_ylabel(with_unit("prediction error", unit))
    axes.set_title("Prediction error against exclusion radius", loc="left")
    axes.margins(y=0.16)
    note = "small numbers: mean number of data held out"
    axes.text(0.99, 0.04, note, transform=axes.transAxes, ha="right", **_SMALL)
    _draw_guides(axes, curve)


def _draw_reach(axes: Axes, curve: RadiusCurve) -> None:
    share = 100 * np.arange(1, len(curve.reach) + 1) / len(curve.reach)
    axes.plot(np.append(0, curve.reach), np.append(0, share), color=BLUE)
    axes.set(ylim=(0, 105), xlabel=_RADIUS, ylabel="% of the domain\nwithin the radius")
    _draw_guides(axes, curve)
    for part in _PARTS:
        place = float(np.percentile(curve.reach, part))
        look: dict[str, Any] = {"textcoords": "offset points", "va": "top", "color": BLUE, "fontsize": 8}
        axes.annotate(f"{part} %: {place:.2g}", (place, part), (6, -4), **look)
    axes.text(sum(_ADVICE) / 2, 12, "the paper's advice", ha="center", **_SMALL)


def _draw_guides(axes: Axes, curve: RadiusCurve) -> None:
    axes.axvspan(*_ADVICE, color=ORANGE, alpha=0.15, lw=0)
    for part in _PARTS:
        axes.axvline(np.percentile(curve.reach, part), color=BLUE, lw=0.8, ls=":")
    axes.grid(alpha=0.25, lw=0.6)
