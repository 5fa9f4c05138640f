"""The error that is to be expected of a model: where, and how far from the data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

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
    frame,
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
"""So many data are dots; more are fainter."""


def plot_error(
    model: FittedModel,
    path: PathLike | None = None,
    *,
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
    image_size : (width, height), optional
        Of a depth map in pixels, if a surface's points are its pixels: y then points down, as it does for warps.
    unit : str, optional
        Of the error.

    Returns
    -------
    matplotlib.figure.Figure
        Not shown.

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
    wide, high = np.ptp(model.domain, axis=0)
    figure = new_figure(12.0, float(np.clip(1.0 + 5.2 * high / wide, 4.0, 9.0)))
    left, right = figure.subplots(1, 2, width_ratios=[1.25, 1])
    colours = _draw_map(left, model)
    frame(left, model.domain, y_down)
    left.set_title("error to expect; hatched: not tested", loc="left")
    figure.colorbar(colours, ax=left, label=with_unit("error", unit), extend="max", aspect=30, pad=0.02)
    _draw_curves(right, model, unit)
    return saved(figure, path)


def _draw_map(axes: Axes, model: FittedModel) -> Any:
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
    dots: dict[str, Any] = {"color": RED, "ms": 2.5, "mew": 0}
    many = len(model.data.points) > _FEW
    axes.plot(*model.data.points.T, "o", **dots, alpha=0.4 if many else 0.9, rasterized=many)
    return colours


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
    places = np.percentile(reach, (50, 95))
    for place in places:
        axes.axvline(place, color=GRAY, lw=0.8, ls="--")
    above = axes.secondary_xaxis("top")
    above.set_xticks(places, ["50 %", "95 %"])
    above.set_xlabel("of the domain is nearer to a datum")
    axes.grid(alpha=0.25, lw=0.6)
    axes.legend(loc="upper left", frameon=False)
