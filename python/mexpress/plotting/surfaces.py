"""Surfaces with the data that they were fitted to."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.geometry import area
from mexpress.models.surface import Surface
from mexpress.plotting.figures import (
    BLUE,
    FEW,
    RED,
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
    with_unit,
)
from mexpress.plotting.solids import Solid, draw_solid
from mexpress.plotting.subjects import SurfaceSelectionLike

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

_LAST = 10
"""Control points that came last, as in the paper's figure 7."""

_NUMBERED = 9
"""About so many control points are numbered."""

_WIDTH = 7.0
"""Inches along the longer side of a map."""

_FEW, _CELLS = 2000, 600
"""So many data are dots; an image of more has at most so many cells along a side."""

_SAMPLES = 40_000
"""Samples of a surface that is shown as an image."""

_LIGHT, _DARKEST, _SLOPE = np.array([-0.5, 0.5, 0.7071]), 0.35, 0.7
"""Towards the light, how light a surface is that it only touches, and the slope of what is steep."""

ImageSize = tuple[float, float] | None


def plot_surface(
    surface: Surface,
    points: ArrayLike,
    values: ArrayLike,
    path: PathLike | None = None,
    *,
    ax: Axes | None = None,
    image_size: ImageSize = None,
    unit: str | None = None,
) -> Figure:
    """Plot a surface together with the data.

    Of depths: the data and the surface as maps of the same colours, the latter lit from the upper left, and the
    surface in space, shaded, with data as dots. Of points in space: the shaded surface with the data from two sides.
    Data on the far side of the surface are hidden by it; if there are many, some are shown.

    Parameters
    ----------
    surface : Surface
        With one value or three.
    points : array_like, (n, 2)
        Where the data are.
    values : array_like, (n,) or (n, 3)
        The data. Rows in which something is NaN, of data that were missing, are not drawn.
    path : str or path, optional
        Where to save the figure.
    ax : matplotlib.axes.Axes, optional
        Where to draw one panel alone, in place of a figure of its own: the surface in space in axes made with
        ``projection="3d"``, a depth's map in others.
    image_size : (width, height), optional
        Of the depth map in pixels, if the points are its pixels: y then points down, and the view is the
        camera's, from a little aside. Otherwise a depth is shown as a height over the plane.
    unit : str, optional
        Of the values.

    Returns
    -------
    matplotlib.figure.Figure
        That of `ax`, or a new one, which notebooks show.

    Raises
    ------
    ImportError
        Without matplotlib.
    ValueError
        If the surface has neither one value nor three, or the data do not fit it.

    Examples
    --------
    >>> import mexpress as mx
    >>> points = np.random.default_rng(0).uniform(0, 9, (50, 2))
    >>> depth = np.sin(points[:, 0])
    >>> plot_surface(mx.fit_surface(points, depth, points[:9]), points, depth)
    <Figure size ...>
    """
    where, measured, _ = _data(surface, points, values)
    if measured.ndim == 2 and measured.shape[1] != 3:
        rule = "It must have one value, a depth, or three, a point in space, to be drawn."
        check.refuse("surface", rule, f"{measured.shape[1]} values")
    size, flat = check.image_size(image_size), measured.ndim == 1
    axes = None if ax is None else given_axes(ax, ("3d", "rectilinear") if flat else ("3d",))
    if axes is not None and axes.name != "3d":
        colours = _draw_surface(axes, surface, measured, size)
        colour_bar(axes, colours, _quantity(size, unit), "both")
        _set_frame(axes, where, size)
        return saved(figure_of(axes), path)
    if flat:
        solid = Solid.of_depths(surface, where, measured, image_size=size, unit=unit)
    else:
        solid = Solid.of_points(surface, measured, in_camera=size is not None, unit=unit)
    if axes is not None:
        draw_solid(axes, solid, solid.views[0])
        return saved(figure_of(axes), path)
    if flat:
        return saved(_depth_figure(surface, where, measured, size, unit, solid), path)
    figure = new_figure(12.0, 5.6)
    figure.set_layout_engine("none")
    for left, view in zip((0.0, 0.5), solid.views, strict=True):
        draw_solid(figure.add_axes((left, 0.03, 0.47, 0.91), projection="3d"), solid, view)
    figure.suptitle(f"{_title(surface)}, with the data, from two sides")
    return saved(figure, path)


def _depth_figure(
    surface: Surface, points: Floats, depths: Floats, size: ImageSize, unit: str | None, solid: Solid
) -> Figure:
    """Draw the data, the surface and the solid in a row."""
    wide, high = _shape(points, size)
    figure = new_figure(15.0, float(np.clip(4.0 * high / wide + 0.8, 3.4, 8.0)))
    maps, space = figure.subfigures(1, 2, squeeze=False, width_ratios=(1.8, 1))[0]
    left, middle = maps.subplots(1, 2)
    colours = _draw_surface(middle, surface, depths, size)
    _draw_data(left, surface, points, depths, norm=colours.norm)
    colour_bar(middle, colours, _quantity(size, unit), "both")
    for axes, title in ((left, f"{len(points)} data"), (middle, _title(surface))):
        _set_frame(axes, points, size)
        axes.set_title(title, loc="left")
    middle.set(ylabel="", yticklabels=[])
    draw_solid(space.add_axes((0.0, 0.04, 0.94, 0.96), projection="3d"), solid, solid.views[0])
    return figure


def _quantity(size: ImageSize, unit: str | None) -> str:
    return with_unit("value" if size is None else "depth", unit)


def _draw_surface(axes: Axes, surface: Surface, depths: Floats, size: ImageSize) -> ScalarMappable:
    """Draw a depth as an image of its colours, lit from the upper left; return the colours of the depths."""
    from matplotlib.cm import ScalarMappable  # noqa: PLC0415  an extra, imported where used
    from matplotlib.colors import Normalize  # noqa: PLC0415  an extra, imported where used

    colours = ScalarMappable(Normalize(percentile(depths, 1), percentile(depths, 99)), "viridis")
    wide, high = np.ptp(surface.domain, axis=0)
    grid = surface.grid(step=float(np.sqrt(wide * high / _SAMPLES)))
    shown = grid.values.reshape(len(grid.y), len(grid.x))
    light = _relief(shown, grid.x, grid.y, towards_eye=size is None)
    pixels = colours.to_rgba(np.ma.masked_invalid(shown))
    pixels[..., :3] *= light[..., None]
    axes.pcolormesh(grid.x, grid.y, pixels, shading="nearest", rasterized=True)
    return colours


def _relief(values: Floats, x: Floats, y: Floats, towards_eye: bool) -> Floats:
    """Return how light a surface is, from 0 to 1; exaggerated until what is steep is seen."""
    down, right = np.gradient(values, y, x)
    steep = (percentile(np.hypot(right, down), 95) or 1.0) / _SLOPE
    # Heights grow towards the eye, and y points up; depths grow away from it, and y points down.
    across, upwards = (right, down) if towards_eye else (-right, down)
    slopes = np.stack([-across / steep, -upwards / steep, np.ones_like(values)])
    lit = np.tensordot(_LIGHT, slopes / np.linalg.norm(slopes, axis=0), axes=1)
    light = np.clip(_DARKEST + (1 - _DARKEST) * lit / _LIGHT[2], _DARKEST / 2, 1.0)
    return np.asarray(np.nan_to_num(light, nan=1.0))


def plot_residuals(
    surface: Surface,
    points: ArrayLike,
    values: ArrayLike,
    path: PathLike | None = None,
    *,
    ax: Axes | None = None,
    image_size: ImageSize = None,
    unit: str | None = None,
    aside: Aside | None = None,
) -> Figure:
    """Plot the residuals of a surface where the data are.

    Of depths they have a sign, data minus surface; of several values their norm is shown. The colours end at
    the 98th percentile of their sizes, so that a few wrong data do not hide the others.

    Parameters
    ----------
    surface : Surface
        The surface.
    points : array_like, (n, 2)
        Where the data are.
    values : array_like, (n,) or (n, d)
        The data. Rows in which something is NaN, of data that were missing, are not drawn.
    path : str or path, optional
        Where to save the figure.
    ax : matplotlib.axes.Axes, optional
        Where to draw, in place of a figure of its own.
    image_size : (width, height), optional
        Of the depth map in pixels, if the points are its pixels: y then points down.
    unit : str, optional
        Of the values.
    aside : Aside, optional
        Data that are not in the fit: they have other marks, and no residuals.

    Returns
    -------
    matplotlib.figure.Figure
        That of `ax`, or a new one, which notebooks show.

    Raises
    ------
    ImportError
        Without matplotlib.
    ValueError
        If the data do not fit the surface.

    Examples
    --------
    >>> import mexpress as mx
    >>> points = np.random.default_rng(0).uniform(0, 9, (50, 2))
    >>> depth = np.sin(points[:, 0])
    >>> plot_residuals(mx.fit_surface(points, depth, points[:9]), points, depth)
    <Figure size ...>
    """
    every, measured, aside = _data(surface, points, values, aside)
    kept = aside.kept(len(every))
    where, size = every[kept], check.image_size(image_size)
    residuals = measured[kept] - surface(where).reshape(measured[kept].shape)
    sizes = np.abs(residuals) if residuals.ndim == 1 else np.linalg.norm(residuals, axis=1)
    limit = percentile(sizes, 98) or 1.0
    axes = _map_axes(where, size) if ax is None else given_axes(ax)
    if residuals.ndim == 1:
        look: dict[str, Any] = {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit}
        name, colours, extend = "data minus surface", residuals, "both"
    else:
        look = {"cmap": "viridis", "vmin": 0, "vmax": limit}
        name, colours, extend = "distance of the data from the surface", sizes, "max"
    dots = _draw_data(axes, surface, where, colours, **look)
    if (
        len(surface.control_points) <= FEW or len(where) > _FEW
    ):  # or they would hide the colours of single dots
        mark_control_points(axes, surface.control_points, "black")
    aside.draw(axes, every)
    _set_frame(axes, where, size, residuals.ndim == 1)
    colour_bar(axes, dots, with_unit(name, unit), extend)
    rms, median = float(np.sqrt((sizes**2).mean())), float(np.median(sizes))
    figures = f"RMS {rms:.3g}, median {median:.3g}" + (f" {unit}" if unit else "")
    axes.set_title(f"residuals of the {_title(surface)}: {figures}", loc="left")
    return _finished(axes, ax is None, path)


def plot_control_points(
    selection: SurfaceSelectionLike,
    path: PathLike | None = None,
    *,
    ax: Axes | None = None,
    image_size: ImageSize = None,
    unit: str | None = None,
) -> Figure:
    """Plot the control points over the data, numbered in the order in which they came.

    As in the paper's figure 7 the last ten are red and those before them blue. Filled are those of the selected
    surface. Behind them are the data, in gray. Only placement by residual puts control points where the surface is
    wrong: of another placement the order tells nothing, and they are plain marks.

    Parameters
    ----------
    selection : SurfaceSelection
        Result of `select_surface`.
    path : str or path, optional
        Where to save the figure.
    ax : matplotlib.axes.Axes, optional
        Where to draw, in place of a figure of its own.
    image_size : (width, height), optional
        Of the depth map in pixels, if the points are its pixels: y then points down.
    unit : str, optional
        Of the values.

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
    >>> points = np.random.default_rng(0).uniform(0, 9, (200, 2))
    >>> plot_control_points(mx.select_surface(points, np.sin(points[:, 0]), max_count=20))
    <Figure size ...>
    """
    (where, values), _ = known_rows(None, points=selection.points, values=selection.values)
    size = check.image_size(image_size)
    axes = _map_axes(where, size) if ax is None else given_axes(ax)
    if values.ndim == 1:
        # No shade is so dark that marks and numbers are not seen on it.
        look = {"vmin": percentile(values, 1), "vmax": percentile(values, 99)}
        dots = _draw_data(axes, selection.surface, where, values, cmap=_shades(), **look)
        colour_bar(axes, dots, _quantity(size, unit), "both")
    else:
        axes.plot(*where.T, "s", color="0.7", ms=3, label="data")
    number, count = len(selection.control_points), selection.count
    if selection.placement == "residual":
        _mark_in_order(axes, selection.control_points, count)
        chosen = f"{selection.criterion} selects {'all' if count == number else f'the first {count}'}"
        title = f"{number} control points in the order in which they came; {chosen}"
    else:
        mark_control_points(axes, selection.surface.control_points, BLUE)
        title = f"{selection.criterion} selects {count} control points, spread evenly"
    _set_frame(axes, where, size, values.ndim == 1)
    axes.set_title(title, loc="left")
    return _finished(axes, ax is None, path)


def _finished(axes: Axes, own: bool, path: PathLike | None) -> Figure:
    """Add the legend, below a figure of our own or inside a caller's axes, and save the figure."""
    figure = figure_of(axes)
    if own:
        legend_below(figure)
    elif axes.get_legend_handles_labels()[0]:
        axes.legend()
    return saved(figure, path)


def _shades() -> Any:
    from matplotlib.colors import LinearSegmentedColormap  # noqa: PLC0415  an extra, imported where used

    return LinearSegmentedColormap.from_list("shades", ["0.4", "1.0"])


def _mark_in_order(axes: Axes, control_points: Floats, count: int) -> None:
    number = len(control_points)
    ranks = np.arange(1, number + 1)
    before = max(number - _LAST, min(number, 3))
    for some, colour, name in (
        (ranks <= before, BLUE, f"1 to {before}"),
        (ranks > before, RED, f"the last {number - before}"),
    ):
        looks: tuple[tuple[Any, dict[str, Any], str], ...] = (
            (some & (ranks <= count), {"mfc": colour, "mec": "white", "mew": 0.9}, "selected"),
            (some & (ranks > count), {"mfc": "none", "mec": colour, "mew": 1.6}, "not selected"),
        )
        for mask, look, what in looks:
            if mask.any():
                axes.plot(*control_points[mask].T, "o", ms=6.5, label=f"{name}, {what}", **look)
    for rank in _numbered(number, count):
        _write_number(axes, control_points[rank - 1], rank, BLUE if rank <= before else RED)


def _numbered(number: int, count: int) -> list[int]:
    """Return the ranks of the control points that are numbered: the first, some, the selected, the last."""
    some = np.linspace(3, number, _NUMBERED).round().astype(int)
    return sorted({1, 2, 3, count, number, *some.tolist()})


def _write_number(axes: Axes, place: Floats, number: int, colour: str) -> None:
    from matplotlib.patheffects import withStroke  # noqa: PLC0415  an extra, imported where used

    look: dict[str, Any] = {
        "textcoords": "offset points",
        "fontsize": 9,
        "fontweight": "bold",
        "color": colour,
    }
    halo = [withStroke(linewidth=2.5, foreground="white")]
    axes.annotate(f"{number}", (place[0], place[1]), (5, 4), path_effects=halo, **look)


def _data(
    surface: Surface, points: ArrayLike, values: ArrayLike, aside: Aside | None = None
) -> tuple[Floats, Floats, Aside]:
    """Return the data that are not missing, (n,) or (n, d) as the surface has them, and which are not in the fit."""
    (where, measured), rest = known_rows(aside, points=points, values=values)
    where = check.points(where, "points")
    measured = check.columns(measured, "values", len(where))
    width = surface.parameters.size // len(surface.parameters)
    if measured.size != width * len(where):
        rule = f"They must have shape ({len(where)}, {width}) like the surface's."
        check.refuse("values", rule, f"shape {measured.shape}")
    return where, measured.ravel() if width == 1 else measured, rest


def _title(surface: Surface) -> str:
    return f"surface with {len(surface.control_points)} control points"


def _shape(points: Floats, size: ImageSize) -> tuple[float, float]:
    wide, high = np.ptp(points, axis=0) if size is None else size
    return float(wide), float(high)


def _map_axes(points: Floats, size: ImageSize) -> Axes:
    wide, high = _shape(points, size)
    scale = min(_WIDTH / wide, _WIDTH / high)
    return new_figure(max(scale * wide + 1.9, 7.0), max(scale * high + 1.5, 3.4)).subplots()


def _draw_data(axes: Axes, surface: Surface, points: Floats, colours: Floats, **look: Any) -> ScalarMappable:
    """Draw numbers where the data are: dots if they are few, else an image that they fill."""
    if len(points) <= _FEW:
        return axes.scatter(points[:, 0], points[:, 1], c=colours, s=36, linewidths=0, **look)
    low, extent = points.min(axis=0), np.ptp(points, axis=0)
    cell = max(0.75 * float(np.sqrt(area(surface.domain) / len(points))), float(extent.max()) / _CELLS)
    columns, rows = (extent // cell).astype(int) + 1
    x, y = ((points - low) // cell).astype(int).T
    number, total = (
        np.bincount(y * columns + x, weights, rows * columns).reshape(rows, columns).astype(np.float64)
        for weights in (None, colours)
    )
    right, top = low + cell * np.array([columns, rows])
    look |= {"extent": (low[0], right, low[1], top), "origin": "lower", "interpolation": "nearest"}
    return axes.imshow(_filled(number, total), **look)


def _filled(number: Floats, total: Floats) -> Floats:
    """Return means, in cells without data those of the cells around; NaN where these have none either."""
    for _ in range(2):
        around = [sliding_window_view(np.pad(array, 1), (3, 3)).sum(axis=(2, 3)) for array in (number, total)]
        number, total = (np.where(number > 0, a, b) for a, b in zip((number, total), around, strict=True))
    with np.errstate(invalid="ignore"):
        return np.asarray(total / number)


def _set_frame(axes: Axes, points: Floats, size: ImageSize, depths: bool = True) -> None:
    """Show a depth map as an image has it, y downwards, and other data as a map."""
    if size is None:
        frame(axes, points, y_down=False)
        axes.set(xlabel="x" if depths else "u", ylabel="y" if depths else "v")
        return
    axes.set_facecolor("0.93")  # white is a shade of the data
    axes.set(xlim=(-0.5, size[0] - 0.5), ylim=(size[1] - 0.5, -0.5), aspect="equal")
    axes.set(xlabel="x (pixels)", ylabel="y (pixels)")
