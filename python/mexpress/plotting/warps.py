"""What a warp does to points and images."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.geometry import diagonal
from mexpress.plotting import rasters
from mexpress.plotting.figures import (
    BLUE,
    ORANGE,
    RED,
    YELLOW,
    Aside,
    PathLike,
    frame,
    known_rows,
    new_figure,
    saved,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from mexpress.models.warp import Warp

_GRID, _CELLS = 16, 200
"""Lines of a warped grid, and samples of where a warp fails, along the longer side."""


def plot_warp(
    warp: Warp,
    source: ArrayLike,
    target: ArrayLike,
    path: PathLike | None = None,
    *,
    aside: Aside | None = None,
) -> Figure:
    """Plot how a warp bends a square grid, and its errors at matches as arrows.

    Parameters
    ----------
    warp : Warp
        From the source image to the target image.
    source, target : array_like, (n, 2)
        Matches. Arrows lead from where the warp puts a source point towards its target point, magnified. Rows of NaN
        are matches that were missing, and are not drawn.
    path : str or path, optional
        Where to save the figure.
    aside : Aside, optional
        Matches that are not in the fit: they have other marks, and no arrows.

    Returns
    -------
    matplotlib.figure.Figure
        Not shown.

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
    predicted, lines = warp(source), _grid_lines(warp)
    wide, high = np.ptp(source, axis=0)
    figure = new_figure(12.0, float(np.clip(5.6 * high / (wide or np.inf) + 1.1, 3.0, 10.0)))
    left, right = figure.subplots(1, 2)
    for axes, curves, points in ((left, lines, source), (right, [warp(line) for line in lines], target)):
        for curve in curves:
            axes.plot(*curve.T, color="#999999", lw=0.8, zorder=1)
        frame(axes, points)
    left.plot(*source.T, ".", color=BLUE, ms=3, label=f"{len(source)} matches")
    left.plot(*warp.control_points.T, "P", color=RED, ms=8, mec="white", label=_control_points(warp))
    aside.draw(left, every)
    left.set_title("source image", loc="left")
    figure.legend(loc="outside lower left", ncols=4, frameon=False)
    factor = _draw_errors(right, predicted, target)
    squared = ((target - predicted) ** 2).sum(axis=1)
    rms = float(np.sqrt(np.where(np.isnan(squared), np.inf, squared).mean()))  # NaN is beyond the horizon
    right.set_title("target image, with the warped grid", loc="left")
    size = "in their true length" if factor == 1 else f"{factor:g} times as long"
    right.set_xlabel(f"arrows: errors at the matches, {size}; RMS {rms:.3g} pixels")
    return saved(figure, path)


def plot_registration(
    warp: Warp,
    source_image: ArrayLike,
    target_image: ArrayLike,
    source: ArrayLike | None = None,
    target: ArrayLike | None = None,
    *,
    path: PathLike | None = None,
    aside: Aside | None = None,
) -> Figure:
    """Plot how well a warp registers two images, in the frame of the source image.

    Three panels: the source image with matches and control points; the target image pulled into its frame;
    both laid over each other, source in magenta and target in green, so that what is registered is gray.
    Where the warp folds or vanishes is painted over; a dashed line encloses the matches, outside of which the
    warp extrapolates.

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
    aside : Aside, optional
        Matches that are not in the fit, which have other marks.

    Returns
    -------
    matplotlib.figure.Figure
        Not shown.

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
    pulled = rasters.sampled(second, (mapped - (target_step - 1) / 2) / target_step).reshape(
        first.shape[:2] + second.shape[2:]
    )
    figure = new_figure(15.0, min(4.3 * first.shape[0] / first.shape[1] + 1.0, 15.0))
    panels = figure.subplots(1, 3, sharey=True)
    shown = (rasters.gray_behind(first), rasters.gray_behind(pulled), rasters.blended(first, pulled))
    names = ("source", "target, pulled into the source's frame", "source magenta, target green")
    extent = rasters.extent(first, step)
    for axes, image, name in zip(panels, shown, names, strict=True):
        axes.imshow(image, extent=extent, interpolation="nearest", vmin=0, vmax=1, cmap="gray")
        axes.plot(*np.vstack([warp.domain, warp.domain[:1]]).T, "--", color=YELLOW, lw=1.2)
        axes.set_title(name, loc="left")
        axes.set(xlim=extent[:2], ylim=extent[2:])
    _draw_matches(panels[0], warp, source, target, aside)
    for axes in panels[1:]:
        _paint_failures(axes, warp, extent)
    _legend_below(figure)
    return saved(figure, path)


def _draw_matches(
    axes: Axes, warp: Warp, source: ArrayLike | None, target: ArrayLike | None, aside: Aside | None
) -> None:
    if source is not None and target is not None:
        every, target, aside = _known(source, target, aside)
        aside.draw(axes, every)
        kept = aside.kept(len(every))
        source, target = every[kept], target[kept]
        errors = np.hypot(*(target - warp(source)).T)
        known = errors[np.isfinite(errors)]
        top = float(np.percentile(known, 98)) if known.size else 0.0
        dots = axes.scatter(source[:, 0], source[:, 1], c=errors, s=7, cmap="viridis", vmin=0, vmax=top or 1)
        # An inset is as tall as the image, which a colour bar with axes of its own is not.
        beside = axes.inset_axes((1.015, 0, 0.025, 1))
        axes.figure.colorbar(dots, cax=beside, label="error (pixels)", extend="max")
    axes.plot(*warp.control_points.T, "P", color=RED, ms=6, mec="white", mew=0.7, label=_control_points(warp))


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
    axes.plot([], [], "--", color=YELLOW, lw=1.5, label="region of the matches")


def _legend_below(figure: Figure) -> None:
    """One legend for all panels, each label once."""
    entries = (axes.get_legend_handles_labels() for axes in figure.axes)
    handles = {label: handle for entry in entries for handle, label in zip(*entry, strict=True)}
    legend = figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=4)
    legend.get_frame().set(facecolor="0.8", edgecolor="none")  # on white, yellow is not seen


def _control_points(warp: Warp) -> str:
    return f"{len(warp.control_points)} control points"


def _grid_lines(warp: Warp) -> list[Floats]:
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


def _draw_errors(axes: Axes, predicted: Floats, target: Floats) -> float:
    """Draw errors as arrows, and return how much longer than the errors they are."""
    known = np.isfinite(predicted).all(axis=1)
    errors, predicted = (target - predicted)[known], predicted[known]
    usual = float(np.percentile(np.hypot(*errors.T), 90)) if known.any() else 0.0
    size = diagonal(target)
    # Rounding errors are not worth magnifying.
    factor = _round_number(0.03 * size / usual) if usual > 1e-9 * size else 1.0
    axes.quiver(
        *predicted.T, *(factor * errors).T, angles="xy", scale_units="xy", scale=1, color=BLUE, width=0.0016
    )
    return factor


def _round_number(value: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above a value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(part for part in (1, 2, 5) if part * power <= value * (1 + 1e-9)))
