"""The error that is to be expected of a model: where, and how far from the data."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mexpress import _validation as check
from mexpress.geometry import lattice, nearest
from mexpress.models.expectation import FittedModel
from mexpress.models.warp import Warp
from mexpress.plotting.figures import (
    BLUE,
    GRAY,
    RED,
    PathLike,
    colour_bar,
    figure_of,
    frame,
    given_axes,
    new_figure,
    percentile,
    saved,
    with_unit,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_CELLS = 200
"""Cells along the longer side of the map."""

_QUERIES = 1000
"""Places of the domain whose distances to the nearest datum are shown."""

_FEW = 1000
"""So many dots are drawn as lines are; more are pixels in files of lines too."""


def plot_error(
    model: FittedModel,
    path: PathLike | None = None,
    *,
    ax: Axes | None = None,
    image_size: tuple[float, float] | None = None,
    unit: str | None = None,
) -> Figure:
    """Plot the error to expect of a warp or a surface, over its domain and against the distance to the data.

    Hatched is what `covers` excludes: outside the region of the data, and gaps wider than could be tested. In the
    second panel the dots are averages of prediction errors; beyond the last one, the error is a guess.

    Parameters
    ----------
    model : Warp or Surface
        A model with its data.
    path : str or path, optional
        Where to save the figure; the suffix says how (.png, .pdf, .svg).
    ax : matplotlib.axes.Axes, optional
        Where to draw the map alone, in place of a figure of its own.
    image_size : (width, height), optional
        Of a depth map in pixels, if a surface's points are its pixels: y then points down, as it does for warps.
    unit : str, optional
        Of the error.

    Returns
    -------
    matplotlib.figure.Figure
        That of `ax`, or a new one, which notebooks show.

    Raises
    ------
    ImportError
        Without matplotlib.
    ValueError
        If the model has no data.

    Examples
    --------
    >>> import mexpress as mx
    >>> points = np.random.default_rng(0).uniform(0, 9, (60, 2))
    >>> plot_error(mx.fit_surface(points, np.sin(points[:, 0]), points[:9]))
    <Figure size ...>
    """
    y_down = check.image_size(image_size) is not None or isinstance(model, Warp)
    if ax is not None:
        _draw_map(given_axes(ax), model, y_down, unit)
        return saved(figure_of(ax), path)
    wide, high = np.ptp(model.domain, axis=0)
    figure = new_figure(12.0, float(np.clip(1.0 + 5.2 * high / wide, 4.0, 9.0)))
    left, right = figure.subplots(1, 2, width_ratios=[1.25, 1])
    _draw_map(left, model, y_down, unit)
    _draw_curves(right, model, unit)
    return saved(figure, path)


def _draw_map(axes: Axes, model: FittedModel, y_down: bool, unit: str | None) -> None:
    low, high = model.domain.min(axis=0), model.domain.max(axis=0)
    margin = 0.04 * float((high - low).max())
    low, high = low - margin, high + margin
    columns, rows = np.maximum(2, np.rint(_CELLS * (high - low) / (high - low).max())).astype(int)
    x, y = np.linspace(low[0], high[0], columns), np.linspace(low[1], high[1], rows)
    points = np.column_stack([np.tile(x, rows), np.repeat(y, columns)])
    errors, covered = model.error(points), model.covers(points)
    shown = np.where(np.isfinite(errors), errors, np.nan).reshape(rows, columns)
    largest = percentile(errors[covered], 100) or percentile(errors, 95) or 1.0
    colours = axes.pcolormesh(x, y, shown, cmap="viridis", vmin=0, vmax=largest, rasterized=True)
    if not covered.all():
        untested = np.where(covered, 0.0, 1.0).reshape(rows, columns)
        axes.contourf(x, y, untested, [0.5, 1.5], colors=["#ffffff80"], hatches=["///"])
    assert model.data is not None  # or there is no error
    n = len(model.data.points)
    size = float(np.clip(80 / np.sqrt(n), 0.6, 2.5))  # so that dots never cover more than a part of the map
    axes.plot(*model.data.points.T, "o", color=RED, ms=size, mew=0, rasterized=n > _FEW)
    frame(axes, model.domain, y_down)
    axes.set_title("error to expect; hatched: not tested", loc="left")
    colour_bar(axes, colours, with_unit("error", unit), "max")


def _draw_curves(axes: Axes, model: FittedModel, unit: str | None) -> None:
    curves = model.error_curves
    assert model.data is not None
    reach = np.sort(nearest(lattice(model.domain, _QUERIES), model.data.points)[1])
    far = 1.05 * max(reach[-1], min(curves.inside.reach, 3 * reach[-1]))
    distance = np.linspace(0, far, 200)
    for name, colour in (("inside", BLUE), ("outside", RED)):
        curve, within = getattr(curves, name), np.full(len(distance), name == "inside")
        errors = curves(distance, within)
        tested = distance <= curve.reach
        label = f"{name} the region of the data"
        axes.plot(distance[tested], errors[tested], color=colour, label=label)
        axes.plot(distance[~tested], errors[~tested], color=colour, ls=":")
        knots = curve.distances[curve.distances <= far]
        axes.plot(knots, curve.errors[: len(knots)], "o", color=colour, ms=3)
    axes.set(xlim=(0, far), xlabel="distance to the nearest datum", ylabel=with_unit("error", unit))
    axes.set_ylim(bottom=0)
    for share, style in ((50, ":"), (95, "--")):
        label = f"{share} % of the domain is nearer"
        axes.axvline(np.percentile(reach, share), color=GRAY, lw=1, ls=style, label=label)
    axes.grid(alpha=0.25, lw=0.6)
    axes.legend(loc="upper left", framealpha=0.9, edgecolor="none")
