"""Plots: criteria against the number of control points, and what a warp does to points and images.

Figures are made without pyplot: nothing is shown, and neither the backend nor the current figure changes.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.reports import UNITLESS
from mexpress.selection import Selection, WarpSelection

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    from mexpress.warps import Warp

__all__ = ["plot_registration", "plot_selection", "plot_warp"]

# Okabe and Ito's colours, told apart by the colour-blind too; vermilion is kept for the chosen criterion.
_CHOSEN = "#D55E00"
_FIXED = {"FIT": "#777777", "PRESS": "#56B4E9", "CMPRESS": "#0072B2"}
_OTHERS = ("#009E73", "#CC79A7", "#E69F00", "#000000", "#5B3A9B", "#8C6D1F")
_STYLES = ("-", "--", "-.", ":")

_BLUE, _ORANGE, _YELLOW = "#0072B2", "#E69F00", "#F0E442"
_DISPLAYED = 1000
"""Pixels along the longer side of a displayed image."""

_GRID, _CELLS = 16, 200
"""Lines of a warped grid, and samples of where a warp fails, along the longer side."""

PathLike = str | os.PathLike[str]
Extent = tuple[float, float, float, float]


def plot_selection(selection: Selection, path: PathLike | None = None) -> Figure:
    """Plot every criterion against the number of control points, and what each would select.

    AIC and BIC have no unit: they are shifted and scaled onto FIT (or the chosen criterion, if there is no
    FIT) by least squares, which moves no minimum.

    Parameters
    ----------
    selection : Selection
        Result of a sweep, such as `select_warp`.
    path : str or path, optional
        Where to save the figure; the suffix says how (.png, .pdf, .svg).

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
    >>> target = source + np.sin(source / 20)
    >>> plot_selection(mx.select_warp(source, target, counts=range(3, 12)))
    <Figure size ...>
    """
    figure = _figure(8.0, 4.8)
    axes = figure.subplots()
    curves, anchor = _on_one_axis(selection.curves, selection.criterion)
    colours = _colours(list(curves), selection.criterion)
    for number, (name, curve) in enumerate(curves.items()):
        style = "-" if name == selection.criterion else _STYLES[number % len(_STYLES)]
        lines = axes.plot(
            selection.counts, curve, style, color=colours[name], label=_label(selection, name, anchor)
        )
        _emphasise(axes, lines[0], selection.selected[name], name == selection.criterion)
    _set_scale(axes, curves, selection.criterion)
    axes.set_xlabel("number of control points")
    unit = "pixels of the target image" if isinstance(selection, WarpSelection) else "unit of the data"
    axes.set_ylabel(f"criterion ({unit})")
    axes.set_title(f"{selection.criterion} selects {selection.count} control points", loc="left")
    axes.grid(alpha=0.25, lw=0.6)
    figure.legend(loc="outside right upper", frameon=False, title="criterion: what it selects")
    return _saved(figure, path)


def _label(selection: Selection, name: str, anchor: str) -> str:
    best = selection.selected[name]
    note = f" (scaled onto {anchor})" if name in UNITLESS and anchor != name else ""
    note = " (per row)" if name == "PRESS" else note
    return f"{name}: {'none' if best is None else best}{note}"


def _emphasise(axes: Axes, line: Line2D, best: int | None, chosen: bool) -> None:
    """Mark what a curve selects, and make the chosen criterion's stand out."""
    line.set(linewidth=2.6 if chosen else 1.4, zorder=4 if chosen else 3)
    if best is None:
        return
    counts, values = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    colour, size = line.get_color(), 10 if chosen else 7
    axes.plot(best, values[counts == best], "o", color=colour, ms=size, mec="white", zorder=6)
    if chosen:
        axes.axvline(best, color=colour, lw=1, alpha=0.4, zorder=1)


def _on_one_axis(curves: Mapping[str, Floats], criterion: str) -> tuple[dict[str, Floats], str]:
    """Bring curves without a unit onto one that has one, whose name is returned too."""
    candidates = ["FIT", criterion, *curves]
    anchor = next((n for n in candidates if n in curves and n not in UNITLESS), criterion)
    onto = np.asarray(curves[anchor], dtype=np.float64)
    moved = {
        name: _rescaled(curve, onto) if name in UNITLESS and name != anchor else np.asarray(curve)
        for name, curve in curves.items()
    }
    return moved, anchor


def _rescaled(curve: Floats, onto: Floats) -> Floats:
    """Return a curve + b that is nearest to another curve, a > 0.

    Logarithms of the other curve are approached: AIC and BIC are logarithms too, and the result is positive.
    """
    usable = np.isfinite(curve) & np.isfinite(onto) & (onto > 0)
    if not usable.any():
        return np.full_like(curve, np.nan)
    x, y = curve[usable], np.log(onto[usable])
    spread = float(np.std(x)) or 1.0
    about = (x - x.mean()) / spread
    slope = float((about * y).mean())
    if slope <= 0:  # would turn the curve over, its minimum into a maximum
        slope = float(np.std(y))
    return np.asarray(np.exp(y.mean() + slope * (curve - x.mean()) / spread))


def _colours(names: list[str], criterion: str) -> dict[str, str]:
    others = [name for name in names if name not in _FIXED and name != criterion]
    colours = _FIXED | {name: _OTHERS[k % len(_OTHERS)] for k, name in enumerate(others)}
    return colours | {criterion: _CHOSEN}


def _set_scale(axes: Axes, curves: Mapping[str, Floats], criterion: str) -> None:
    """Logarithms when the values span much; values far above the selected one leave the frame."""
    defined = {name: curve[np.isfinite(curve)] for name, curve in curves.items()}
    values = np.concatenate(list(defined.values()))
    low, high = float(values.min()), float(values.max())
    if low <= 0 or high < 5 * low:
        return
    first = max(float(curve[0]) for curve in defined.values() if curve.size)
    top = max(1.5 * first, 10 * float(defined[criterion].min()))
    axes.set_yscale("log", subs=(2, 5) if top < 1000 * low else ())
    axes.set_ylim(low / 1.3, min(top, 1.3 * high))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("{x:g}")


def plot_warp(warp: Warp, source: ArrayLike, target: ArrayLike, path: PathLike | None = None) -> Figure:
    """Plot how a warp bends a square grid, and its errors at matches as arrows.

    Parameters
    ----------
    warp : Warp
        From the source image to the target image.
    source, target : array_like, (n, 2)
        Matches. Arrows lead from where the warp puts a source point towards its target point, magnified.
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

    Examples
    --------
    >>> import mexpress as mx
    >>> source = np.random.default_rng(0).uniform(0, 100, (40, 2))
    >>> plot_warp(mx.fit_warp(source, source + 3, source[:4]), source, source + 3)
    <Figure size ...>
    """
    source, target = check.points(source, "source"), check.points(target, "target")
    predicted, lines = warp(source), _grid_lines(warp)
    wide, high = np.ptp(source, axis=0)
    figure = _figure(12.0, float(np.clip(5.6 * high / max(wide, 1e-9) + 1.1, 3.0, 10.0)))
    left, right = figure.subplots(1, 2)
    for axes, curves, points in ((left, lines, source), (right, [warp(line) for line in lines], target)):
        for curve in curves:
            axes.plot(*curve.T, color="#999999", lw=0.8, zorder=1)
        _frame(axes, points)
    left.plot(*source.T, ".", color=_BLUE, ms=3, label=f"{len(source)} matches")
    left.plot(*warp.control_points.T, "P", color=_CHOSEN, ms=8, mec="white", label=_control_points(warp))
    left.set_title("source image", loc="left")
    figure.legend(loc="outside lower left", ncols=2, frameon=False)
    factor = _draw_errors(right, predicted, target)
    rms = float(np.sqrt(((target - predicted) ** 2).sum(axis=1).mean()))
    right.set_title("target image, with the warped grid", loc="left")
    size = "in their true length" if factor == 1 else f"{factor:g} times as long"
    right.set_xlabel(f"arrows: errors at the matches, {size}; RMS {rms:.3g} pixels")
    return _saved(figure, path)


def plot_registration(
    warp: Warp,
    source_image: ArrayLike,
    target_image: ArrayLike,
    source: ArrayLike | None = None,
    target: ArrayLike | None = None,
    *,
    path: PathLike | None = None,
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
        Matches; the colours of their marks then tell the error at each.
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
    first, step = _reduced(_image(source_image, "source_image"))
    second, target_step = _reduced(_image(target_image, "target_image"))
    positions = _pixel_centres(first, step)
    with np.errstate(invalid="ignore"):
        found = warp(positions)
    found[warp.vanishes(positions)] = np.nan
    pulled = _sampled(second, (found - (target_step - 1) / 2) / target_step).reshape(
        first.shape[:2] + second.shape[2:]
    )
    figure = _figure(15.0, min(4.3 * first.shape[0] / first.shape[1] + 1.0, 15.0))
    panels = figure.subplots(1, 3, sharey=True)
    shown = (_gray_behind(first), _gray_behind(pulled), _blended(first, pulled))
    names = ("source", "target, pulled into the source's frame", "source magenta, target green")
    extent = _extent(first, step)
    for axes, image, name in zip(panels, shown, names, strict=True):
        axes.imshow(image, extent=extent, interpolation="nearest", vmin=0, vmax=1, cmap="gray")
        axes.plot(*np.vstack([warp.domain, warp.domain[:1]]).T, "--", color=_YELLOW, lw=1.2)
        axes.set_title(name, loc="left")
        axes.set(xlim=extent[:2], ylim=extent[2:])
    _draw_matches(panels[0], warp, source, target)
    for axes in panels[1:]:
        _paint_failures(axes, warp, extent)
    _legend_below(figure)
    return _saved(figure, path)


def _draw_matches(axes: Axes, warp: Warp, source: ArrayLike | None, target: ArrayLike | None) -> None:
    if source is not None and target is not None:
        source, target = check.points(source, "source"), check.points(target, "target")
        errors = np.hypot(*(target - warp(source)).T)
        known = errors[np.isfinite(errors)]
        top = float(np.percentile(known, 98)) if known.size else 0.0
        dots = axes.scatter(source[:, 0], source[:, 1], c=errors, s=7, cmap="viridis", vmin=0, vmax=top or 1)
        # An inset is as tall as the image, which a colour bar with axes of its own is not.
        beside = axes.inset_axes((1.015, 0, 0.025, 1))
        axes.figure.colorbar(dots, cax=beside, label="error (pixels)", extend="max")
    axes.plot(
        *warp.control_points.T, "P", color=_CHOSEN, ms=6, mec="white", mew=0.7, label=_control_points(warp)
    )


def _paint_failures(axes: Axes, warp: Warp, extent: Extent) -> None:
    """Paint where the warp vanishes, and where it folds elsewhere."""
    left, right, bottom, top = extent
    wide, high = right - left, bottom - top
    cell = max(wide, high) / _CELLS
    x = left + (np.arange(max(1, round(wide / cell))) + 0.5) * cell
    y = top + (np.arange(max(1, round(high / cell))) + 0.5) * cell
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    vanishes = warp.vanishes(points)
    for mask, colour, name in (
        (vanishes, _BLUE, "the denominator vanishes"),
        (warp.folds(points) & ~vanishes, _ORANGE, "the warp folds"),
    ):
        if mask.any():
            layer = np.zeros((len(y), len(x), 4))
            layer[..., :3] = np.frombuffer(bytes.fromhex(colour[1:]), np.uint8) / 255
            layer[..., 3] = 0.6 * mask.reshape(len(y), len(x))
            axes.imshow(layer, extent=extent, interpolation="nearest")
            axes.plot([], [], "s", color=colour, alpha=0.6, label=name)
    axes.plot([], [], "--", color=_YELLOW, lw=1.5, label="region of the matches")


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
    size = float(np.hypot(*np.ptp(target, axis=0)))
    # Rounding errors are not worth magnifying.
    factor = _round_number(0.03 * size / usual) if usual > 1e-9 * size else 1.0
    axes.quiver(
        *predicted.T, *(factor * errors).T, angles="xy", scale_units="xy", scale=1, color=_BLUE, width=0.0016
    )
    return factor


def _round_number(value: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above a value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(part for part in (1, 2, 5) if part * power <= value * (1 + 1e-9)))


def _frame(axes: Axes, points: Floats) -> None:
    """Show the points as an image has them, y downwards, with a margin."""
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.04 * float((high - low).max())
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(high[1] + margin, low[1] - margin))
    axes.set_aspect("equal")


def _image(value: ArrayLike, name: str) -> Floats:
    """Return an image with numbers from 0 to 1, (h, w) or (h, w, 3), without transparency."""
    array = np.asarray(value)
    rule = "It must be a gray (height, width) or colour (height, width, 3 or 4) image."
    colour = array.ndim == 3 and array.shape[2] in (1, 3, 4)
    if array.size == 0 or not (array.ndim == 2 or colour):
        check.refuse(name, rule, f"shape {array.shape}")
    if array.dtype.kind not in "buif":
        check.refuse(name, rule, check.describe(array), TypeError)
    if colour:
        array = array[:, :, 0] if array.shape[2] == 1 else array[:, :, :3]
    values = array.astype(np.float64)
    if array.dtype.kind in "ui":
        return values / np.iinfo(array.dtype).max
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    if low < 0 or high > 1:
        values = (values - low) / ((high - low) or 1.0)
    return np.nan_to_num(values, nan=0.0, posinf=1.0, neginf=0.0)


def _reduced(image: Floats) -> tuple[Floats, int]:
    """Return the means of square blocks, of a size that makes the image small enough, and this size."""
    step = -(-max(image.shape[:2]) // _DISPLAYED)
    high, wide = (max(1, size // step) for size in image.shape[:2])
    blocks = image[: high * step, : wide * step]
    rows = np.add.reduceat(blocks, np.arange(0, blocks.shape[0], step), axis=0)
    sums = np.add.reduceat(rows, np.arange(0, blocks.shape[1], step), axis=1)
    return sums / (min(step, blocks.shape[0]) * min(step, blocks.shape[1])), step


def _pixel_centres(image: Floats, step: int) -> Floats:
    """Return the positions of a reduced image's pixels in the image itself, row after row."""
    high, wide = image.shape[:2]
    y, x = np.mgrid[:high, :wide] * float(step) + (step - 1) / 2
    return np.column_stack([x.ravel(), y.ravel()])


def _extent(image: Floats, step: int) -> Extent:
    """Left, right, bottom, top of a reduced image, pixel centres being whole numbers in the image itself."""
    return (-0.5, image.shape[1] * step - 0.5, image.shape[0] * step - 0.5, -0.5)


def _sampled(image: Floats, positions: Floats) -> Floats:
    """Return an image between its pixels, bilinearly; NaN outside."""
    high, wide = image.shape[:2]
    with np.errstate(invalid="ignore"):
        inside = ((positions >= 0) & (positions <= [wide - 1, high - 1])).all(axis=1)
    values = np.full((len(positions), *image.shape[2:]), np.nan)
    where = positions[inside]
    x, y = np.minimum(where, [max(wide - 2, 0), max(high - 2, 0)]).astype(int).T
    right, below = np.minimum(x + 1, wide - 1), np.minimum(y + 1, high - 1)
    u, v = (where - np.column_stack([x, y])).T.reshape((2, -1) + (1,) * (image.ndim - 2))
    values[inside] = (1 - v) * ((1 - u) * image[y, x] + u * image[y, right]) + v * (
        (1 - u) * image[below, x] + u * image[below, right]
    )
    return values


def _gray_behind(image: Floats) -> Floats:
    """Return the image with a light gray where it is NaN."""
    return np.where(np.isnan(image), 0.85, image)


def _blended(first: Floats, second: Floats) -> Floats:
    """Return source in magenta over target in green, of equal mean and contrast where both are known."""
    gray, other = (image if image.ndim == 2 else image.mean(axis=2) for image in (first, second))
    known = ~np.isnan(other)
    if known.any():
        spread = float(other[known].std()) or 1.0
        other = (other - other[known].mean()) / spread * float(gray[known].std()) + gray[known].mean()
    other = np.clip(np.where(known, other, gray), 0, 1)
    return np.where(known[..., None], np.stack([gray, other, gray], axis=-1), 0.5 + 0.5 * gray[..., None])


def _figure(width: float, height: float) -> Figure:
    try:
        from matplotlib.figure import Figure  # noqa: PLC0415  an extra, imported where used
    except ImportError as error:
        message = "Plots need matplotlib: pip install 'mexpress[plot]'"
        raise ImportError(message) from error
    return Figure(figsize=(width, height), dpi=110, layout="constrained")


def _saved(figure: Figure, path: PathLike | None) -> Figure:
    if path is not None:
        figure.savefig(path)
    return figure
