"""What a warp does to points and images."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.geometry import diagonal
from mexpress.plotting import rasters
from mexpress.plotting.figures import (
    BLUE,
    FEW,
    ORANGE,
    RED,
    YELLOW,
    Aside,
    PathLike,
    colour_bar,
    figure_of,
    frame,
    given_axes,
    known_rows,
    legend_below,
    mark_control_points,
    new_figure,
    percentile,
    saved,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from mexpress.models.warp import Warp

_GRID, _CELLS, _FINE = 16, 200, 400
"""Lines of a warped grid, and samples of where a warp fails and of displacements, along the longer side."""

_ARROWS = 150
"""Arrows of errors; of more matches some have one."""

_FADED = 0.45
"""How dark an image is behind marks."""


def plot_warp(
    warp: Warp,
    source: ArrayLike,
    target: ArrayLike,
    path: PathLike | None = None,
    *,
    ax: Axes | None = None,
    aside: Aside | None = None,
) -> Figure:
    """Plot how far a warp moves points, how it bends a square grid, and its errors at matches.

    Two panels. In the source image colours say how far points move, and arrows where to. In the target image is the
    warped grid, and the colour of a match is its error; arrows lead from where the warp puts a source point towards
    its target point, magnified. Of more than 150 matches every second, third, ... has an arrow.

    Parameters
    ----------
    warp : Warp
        From the source image to the target image.
    source, target : array_like, (n, 2)
        Matches. Rows of NaN are matches that were missing, and are not drawn.
    path : str or path, optional
        Where to save the figure.
    ax : matplotlib.axes.Axes, optional
        Where to draw the panel of the target image alone, in place of a figure of its own.
    aside : Aside, optional
        Matches that are not in the fit: they have other marks, and no arrows.

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
    >>> import mexpress as mx
    >>> source = np.random.default_rng(0).uniform(0, 100, (40, 2))
    >>> plot_warp(mx.fit_warp(source, source + 3, source[:4]), source, source + 3)
    <Figure size ...>
    """
    every, target, aside = _known(source, target, aside)
    kept = aside.kept(len(every))
    source, target = every[kept], target[kept]
    if ax is not None:
        _draw_target(given_axes(ax), warp, source, target)
        return saved(figure_of(ax), path)
    wide, high = np.ptp(source, axis=0)
    figure = new_figure(13.5, float(np.clip(5.6 * high / (wide or np.inf) + 1.5, 3.4, 10.0)))
    left, right = figure.subplots(1, 2)
    _draw_displacements(left, warp, source)
    mark_control_points(left, warp.control_points, RED)
    aside.draw(left, every)
    _draw_target(right, warp, source, target)
    legend_below(figure)
    return saved(figure, path)


def _draw_displacements(axes: Axes, warp: Warp, source: Floats) -> None:
    """Draw how far points of the source image move as colours, and where to as a few arrows."""
    extent = float(np.ptp(warp.domain, axis=0).max())
    x, y, moves = _moves(warp, extent / _FINE)
    lengths = np.hypot(*np.moveaxis(moves, -1, 0))
    limits: dict[str, Any] = {"vmin": percentile(lengths, 1), "vmax": percentile(lengths, 99)}
    colours = axes.pcolormesh(x, y, lengths, cmap="viridis", rasterized=True, zorder=0, **limits)
    colour_bar(axes, colours, "displacement (pixels)", "both")
    step = extent / _GRID
    x, y, moves = _moves(warp, step)
    usual = percentile(np.hypot(*np.moveaxis(moves, -1, 0)), 95)
    look: dict[str, Any] = {"color": "white", "edgecolor": "black", "linewidth": 0.4, "width": 0.0035}
    if usual > 1e-9 * step:
        along = np.moveaxis(moves * step / usual, -1, 0)
        axes.quiver(x, y, *along, angles="xy", scale_units="xy", scale=1.1, pivot="mid", **look, zorder=2)
    axes.plot(*source.T, "o", color="black", ms=1.8, mew=0, zorder=3)
    frame(axes, np.vstack([source, warp.domain]))
    axes.set_title("source image: displacement, colours and arrows", loc="left")


def _moves(warp: Warp, step: float) -> tuple[Floats, Floats, Floats]:
    """Return places along x and y of the domain, and displacements there, (y, x, 2); NaN outside the domain."""
    low, size = warp.domain.min(axis=0), np.ptp(warp.domain, axis=0)
    x, y = (low[k] + step * (np.arange(max(2, round(size[k] / step))) + 0.5) for k in (0, 1))
    points = np.stack(np.meshgrid(x, y), axis=-1)
    moved = warp(points.reshape(-1, 2), outside="nan").reshape(points.shape)
    return x, y, moved - points


def _draw_target(axes: Axes, warp: Warp, source: Floats, target: Floats) -> None:
    """Draw the warped grid, and errors at matches as colours and as arrows."""
    for line in grid_lines(warp):
        axes.plot(*warp(line).T, color="#999999", lw=0.8, zorder=1)
    predicted = warp(source)
    errors = np.hypot(*(target - predicted).T)
    _draw_sizes(axes, target, errors, 9)
    factor, every = _draw_errors(axes, predicted, target)
    rms = float(np.sqrt(np.where(np.isnan(errors), np.inf, errors**2).mean()))  # NaN is beyond the horizon
    frame(axes, target)
    axes.set_title(f"target image: warped grid, and errors; RMS {rms:.3g} pixels", loc="left")
    size = "in their true length" if factor == 1 else f"{factor:g} times as long"
    axes.set_xlabel(f"arrows: errors{_at_some(every)}, {size}")


def _at_some(every: int) -> str:
    return "" if every == 1 else f" at one match in {every}"


def _draw_sizes(axes: Axes, places: Floats, errors: Floats, size: float) -> None:
    """Draw matches in the colours of their errors, large errors on top."""
    order = np.argsort(np.nan_to_num(errors, nan=np.inf, posinf=np.inf), kind="stable")
    places, errors = places[order], errors[order]
    look: dict[str, Any] = {"cmap": "plasma_r", "vmin": 0, "vmax": percentile(errors, 98) or 1.0}
    look |= {"s": size, "edgecolors": "black", "linewidths": 0.2, "zorder": 3}
    dots = axes.scatter(places[:, 0], places[:, 1], c=errors, label=f"{len(places)} matches", **look)
    colour_bar(axes, dots, "error (pixels)", "max")


def plot_registration(
    warp: Warp,
    source_image: ArrayLike,
    target_image: ArrayLike,
    source: ArrayLike | None = None,
    target: ArrayLike | None = None,
    *,
    path: PathLike | None = None,
    ax: Axes | None = None,
    aside: Aside | None = None,
) -> Figure:
    """Plot how well a warp registers two images, in the frame of the source image.

    Three panels: the source image, faded behind the matches; the target image pulled into its frame;
    both laid over each other, source in magenta and target in green, so that what is registered is gray:
    the target has the light of the source around each pixel.
    Where the warp folds or vanishes is painted over; a dashed line encloses the matches, outside of which the
    warp extrapolates. Control points are shown if they are few.

    Parameters
    ----------
    warp : Warp
        From the source image to the target image.
    source_image, target_image : array_like, (height, width) or (height, width, 3 or 4)
        Gray or colour; integers, or floating point numbers, which are stretched to their range if they are
        not from 0 to 1. Their sizes may differ.
    source, target : array_like, (n, 2), optional
        Matches; the colours of their marks then tell the error at each. Rows of NaN are not drawn.
    path : str or path, optional
        Where to save the figure.
    ax : matplotlib.axes.Axes, optional
        Where to draw the last panel alone, in place of a figure of its own.
    aside : Aside, optional
        Matches that are not in the fit, which have other marks.

    Returns
    -------
    matplotlib.figure.Figure
        That of `ax`, or a new one, which notebooks show.

    Raises
    ------
    ImportError
        Without matplotlib.
    ValueError, TypeError
        If an argument is no image.

    Examples
    --------
    >>> import mexpress as mx
    >>> image = np.random.default_rng(0).uniform(size=(60, 80))
    >>> corners = [[5, 5], [70, 5], [70, 50], [5, 50]]
    >>> plot_registration(mx.fit_warp(corners, corners, corners[:3]), image, image)
    <Figure size ...>
    """
    first, step = rasters.reduced(rasters.as_image(source_image, "source_image"))
    second, target_step = rasters.reduced(rasters.as_image(target_image, "target_image"))
    positions = rasters.pixel_centres(first, step)
    mapped = warp(positions)
    pulled = rasters.pulled(second, target_step, mapped, first)
    overlay = rasters.blended(first, pulled)
    extent = rasters.extent(first, step)
    if ax is not None:
        _draw_image(given_axes(ax), warp, overlay, extent, _OVERLAY)
        _paint_failures(ax, warp, extent)
        return saved(figure_of(ax), path)
    figure = new_figure(16.0, min(4.9 * first.shape[0] / first.shape[1] + 1.1, 15.0))
    panels = figure.subplots(1, 3, sharey=True)
    matched = source is not None and target is not None
    behind = 1 - _FADED * (1 - (first if first.ndim == 2 else first.mean(axis=2))) if matched else first
    names = (
        "source, and errors at the matches" if matched else "source",
        "target, pulled into the source's frame",
    )
    for axes, image, name in zip(
        panels, (behind, rasters.gray_behind(pulled), overlay), (*names, _OVERLAY), strict=True
    ):
        _draw_image(axes, warp, image, extent, name)
    if source is not None and target is not None:
        _draw_matches(panels[0], warp, source, target, aside)
    if len(warp.control_points) <= FEW:
        mark_control_points(panels[0], warp.control_points, RED)
    for axes in panels[1:]:
        _paint_failures(axes, warp, extent)
    legend_below(figure)
    return saved(figure, path)


_OVERLAY = "source magenta, target green"


def _draw_image(axes: Axes, warp: Warp, image: Floats, extent: rasters.Extent, name: str) -> None:
    axes.imshow(image, extent=extent, interpolation="nearest", vmin=0, vmax=1, cmap="gray")
    look: dict[str, Any] = {"color": YELLOW, "gapcolor": "0.2", "lw": 1.4, "label": "region of the matches"}
    axes.plot(*np.vstack([warp.domain, warp.domain[:1]]).T, "--", **look)
    axes.set_title(name, loc="left")
    axes.set(xlim=extent[:2], ylim=extent[2:])


def _draw_matches(axes: Axes, warp: Warp, source: ArrayLike, target: ArrayLike, aside: Aside | None) -> None:
    every, target, aside = _known(source, target, aside)
    kept = aside.kept(len(every))
    _draw_sizes(axes, every[kept], np.hypot(*(target[kept] - warp(every[kept])).T), 14)
    aside.draw(axes, every)


def _known(source: ArrayLike, target: ArrayLike, aside: Aside | None) -> tuple[Floats, Floats, Aside]:
    """Return the matches that are not missing, and which of them are not in the fit."""
    (first, second), rest = known_rows(aside, source=source, target=target)
    return check.points(first, "source"), check.points(second, "target"), rest


def _paint_failures(axes: Axes, warp: Warp, extent: rasters.Extent) -> None:
    """Paint where the warp vanishes, and where it folds elsewhere."""
    left, right, bottom, top = extent
    wide, high = right - left, bottom - top
    cell = max(wide, high) / _CELLS
    x = left + (np.arange(max(1, round(wide / cell))) + 0.5) * cell
    y = top + (np.arange(max(1, round(high / cell))) + 0.5) * cell
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    vanishes = warp.vanishes(points)
    for mask, colour, name in (
        (vanishes, BLUE, "the denominator vanishes"),
        (warp.folds(points) & ~vanishes, ORANGE, "the warp folds"),
    ):
        if mask.any():
            layer = np.zeros((len(y), len(x), 4))
            layer[..., :3] = np.frombuffer(bytes.fromhex(colour[1:]), np.uint8) / 255
            layer[..., 3] = 0.6 * mask.reshape(len(y), len(x))
            axes.imshow(layer, extent=extent, interpolation="nearest")
            axes.plot([], [], "s", color=colour, alpha=0.6, label=name)


def grid_lines(warp: Warp) -> list[Floats]:
    """Return the lines of a square grid inside the warp's domain."""
    corners = np.vstack([warp.domain, warp.domain[:1]])
    low, size = corners.min(axis=0), np.ptp(corners, axis=0)
    cell = size.max() / _GRID
    lines = []
    for along in (0, 1):
        across = 1 - along
        for at in low[across] + np.arange(0.5 * cell, size[across], cell):
            start, stop = _crossings(corners, across, at)
            line = np.empty((200, 2))
            line[:, along], line[:, across] = np.linspace(start, stop, 200), at
            lines.append(line)
    return lines


def _crossings(corners: Floats, across: int, at: float) -> tuple[float, float]:
    """Return where a line parallel to an axis enters and leaves a convex polygon."""
    first, second = corners[:-1], corners[1:]
    crossed = (first[:, across] <= at) != (second[:, across] <= at)
    first, second = first[crossed], second[crossed]
    share = (at - first[:, across]) / (second[:, across] - first[:, across])
    where = first[:, 1 - across] + share * (second[:, 1 - across] - first[:, 1 - across])
    return float(where.min()), float(where.max())


def _draw_errors(axes: Axes, predicted: Floats, target: Floats) -> tuple[float, int]:
    """Draw errors as arrows, and return how much longer than the errors they are, and which part of them has one."""
    known = np.isfinite(predicted).all(axis=1)
    errors, predicted = (target - predicted)[known], predicted[known]
    usual = float(np.percentile(np.hypot(*errors.T), 90)) if known.any() else 0.0
    size, every = diagonal(target), -(-len(errors) // _ARROWS) or 1
    # Rounding errors are not worth magnifying.
    factor = _round_number(0.03 * size / usual) if usual > 1e-9 * size else 1.0
    look: dict[str, Any] = {"color": BLUE, "width": 0.0022, "zorder": 2}
    some = slice(None, None, every)
    axes.quiver(
        *predicted[some].T, *(factor * errors[some]).T, angles="xy", scale_units="xy", scale=1, **look
    )
    return factor, every


def _round_number(value: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above a value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(part for part in (1, 2, 5) if part * power <= value * (1 + 1e-9)))
