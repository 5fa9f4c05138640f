"""The surfaces that criteria select, side by side with the data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from mexpress._validation import Floats
from mexpress.models.surface import Surface
from mexpress.paper.surface_data import Subject
from mexpress.plotting.figures import PathLike, frame, new_figure, percentile, saved, with_unit
from mexpress.plotting.solids import Solid, View, draw_solid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ALIKE = 0.08
"""Surfaces whose numbers of control points differ by less than this fraction look the same: one of them is drawn."""

_COLUMNS = 4
"""Most panels in a row."""

_WIDTH = 3.6
"""Of a panel in inches."""

_SAMPLES = 30_000
"""Of a surface that is shown as an image."""

_STEEP = 0.35
"""How high a depth map's relief stands when it is shaded: depths span this fraction of the longer side."""

_LINE = 34
"""Letters in a line of a title."""

_MORE = 0.4
"""How much higher than its map a panel is, in inches."""

_SOLID = 0.72
"""Height of a panel in space, as a fraction of its width."""

_BAR = 0.05
"""Width of a colour bar, as a fraction of a panel's."""

_ZOOM = 1.2
"""Of surfaces in space, which have no numbers at their axes."""


@dataclass(frozen=True, eq=False)
class PanelFit:
    """The surface that some criteria select.

    Parameters
    ----------
    names : tuple of str
        The criteria.
    count : int
        Their number of control points.
    rms : float
        Root mean square residual, in the unit of the values.
    truth : float
        Root mean square error; NaN if the truth is not known.
    surface : Surface
        The surface.

    Examples
    --------
    >>> import mexpress as mx
    >>> corners = [[0, 0], [1, 0], [0, 1]]
    >>> PanelFit(("ER10",), 3, 0.0, float("nan"), mx.fit_surface(corners, [1, 2, 3], corners))
    PanelFit(names=('ER10',), count=3, rms=0.0, truth=nan, surface=Surface(depth, tps, 3 control points))
    """

    names: tuple[str, ...]
    count: int
    rms: float
    truth: float
    surface: Surface


Group = Sequence[PanelFit]


def grouped(fits: Iterable[PanelFit]) -> list[list[PanelFit]]:
    """Put surfaces together that look the same, those with the fewest control points first.

    Parameters
    ----------
    fits : iterable of PanelFit
        In any order.

    Returns
    -------
    list of list of PanelFit
        In each, numbers of control points that exceed the first one by less than `ALIKE`.

    Examples
    --------
    >>> import mexpress as mx
    >>> corners = [[0, 0], [1, 0], [0, 1]]
    >>> plane = mx.fit_surface(corners, [1, 2, 3], corners)
    >>> fits = [PanelFit((name,), count, 0.0, 0.0, plane) for name, count in (("FIT", 27), ("ER05", 26), ("ER10", 9))]
    >>> [[fit.count for fit in group] for group in grouped(fits)]
    [[9], [26, 27]]
    """
    groups: list[list[PanelFit]] = []
    for fit in sorted(fits, key=lambda fit: fit.count):
        if groups and fit.count < (1 + ALIKE) * groups[-1][0].count:
            groups[-1].append(fit)
        else:
            groups.append([fit])
    return groups


def plot_fits(subject: Subject, fits: Sequence[PanelFit], path: PathLike | None = None) -> Figure:
    """Plot the surfaces that criteria select, one panel for those that look alike.

    Of surfaces whose numbers of control points differ by less than 8 % the one with the fewest is drawn; the title says
    what each criterion selects.

    Of depths: the data and the surfaces as maps of the same colours, shaded by a light from the upper left. Of points
    in space: every surface from the same side, with the data as dots. Below each surface are its residuals, data
    minus surface or their distance, of the same colours too.

    Parameters
    ----------
    subject : Subject
        The data: depths, or points in space.
    fits : sequence of PanelFit
        What to draw, in that order.
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
    >>> from mexpress.paper.surface_data import simulated_embedding
    >>> sheet = simulated_embedding(200, seed=0)
    >>> surface = mx.fit_surface(sheet.points, sheet.values, sheet.points[:9])
    >>> plot_fits(sheet, [PanelFit(("CMPRESS", "ER10"), 9, 0.03, 0.02, surface)])
    <Figure size ...>
    """
    groups = grouped(fits)
    depths = subject.dimension == 1
    panels: list[Group | None] = [None, *groups] if depths else list(groups)
    rows = -(-len(panels) // _COLUMNS)
    columns = -(-len(panels) // rows)
    wide, high = _extent(subject)
    height = _WIDTH * float(np.clip(high / wide, 0.3, 2.0))
    heights = (height if depths else _SOLID * _WIDTH, height)
    figure = new_figure(columns * _WIDTH + 1.2, rows * (sum(heights) + _MORE))
    # All panels in one grid have the same size; what the colours mean stands once, beside them.
    ratios = {"width_ratios": [1.0] * columns + [_BAR], "height_ratios": heights * rows}
    grid = figure.add_gridspec(2 * rows, columns + 1, **ratios)
    scales = _Scales.of(subject, groups)
    for k, group in enumerate(panels):
        row, column = divmod(k, columns)
        above, below = grid[2 * row, column], grid[2 * row + 1, column]
        if group is None:
            _draw_data(figure.add_subplot(above), subject, scales)
            _draw_note(figure.add_subplot(below))
        else:
            axes: Any = figure.add_subplot(above, projection=None if depths else "3d")
            _draw_surface(axes, subject, group[0], scales)
            axes.set_title(_title(group, subject.unit), loc="left", fontsize=9)
            _draw_residuals(figure.add_subplot(below), subject, group[0], scales)
    if depths:
        name = "value" if subject.image_size is None else "depth"
        _colour_bar(figure.add_subplot(grid[:rows, -1]), with_unit(name, subject.unit), scales.value_look)
    name = "data minus surface" if depths else "distance"
    bar = figure.add_subplot(grid[rows:, -1])
    _colour_bar(bar, with_unit(name, subject.unit), scales.residual_look)
    return saved(figure, path)


def _extent(subject: Subject) -> tuple[float, float]:
    wide, high = np.ptp(subject.points, axis=0) if subject.image_size is None else subject.image_size
    return float(wide), float(high)


@dataclass(frozen=True)
class _Scales:
    """What all panels have in common."""

    values: tuple[float, float]
    residual: float
    view: View | None

    @classmethod
    def of(cls, subject: Subject, groups: Sequence[Group]) -> Self:
        # Of the surface nearest to the data: one far from them would hide the differences of the others.
        size = 1.5 * percentile(np.abs(_residuals(subject, groups[-1][-1])), 95)
        view = None if subject.dimension == 1 else _solid(subject, groups[-1][0]).views[0]
        values = (percentile(subject.values, 4), percentile(subject.values, 96))
        return cls(values, size or 1.0, view)

    @property
    def value_look(self) -> dict[str, Any]:
        return {"cmap": "viridis", "vmin": self.values[0], "vmax": self.values[1]}

    @property
    def residual_look(self) -> dict[str, Any]:
        """Differences of depths have a sign, distances in space have none."""
        if self.view is None:
            return {"cmap": "RdBu_r", "vmin": -self.residual, "vmax": self.residual}
        return {"cmap": "viridis", "vmin": 0.0, "vmax": self.residual}


def _residuals(subject: Subject, fit: PanelFit) -> Floats:
    """Return data minus surface of depths, the distances of points in space."""
    residuals = subject.values - fit.surface(subject.points)
    return residuals if residuals.ndim == 1 else np.linalg.norm(residuals, axis=1)


def _solid(subject: Subject, fit: PanelFit) -> Solid:
    return Solid.of_points(fit.surface, subject.values, subject.image_size is not None, subject.unit)


def _title(group: Group, unit: str | None) -> str:
    """Say what each criterion selects, in as many lines as it takes, and how good the surface is that is drawn."""
    lines = [""]
    for text in (f"{name} {fit.count}" for fit in group for name in fit.names):
        longer = f"{lines[-1]}, {text}" if lines[-1] else text
        if len(longer) > _LINE:
            lines.append(text)
        else:
            lines[-1] = longer
    drawn = group[0]
    truth = "" if np.isnan(drawn.truth) else f", true RMS {drawn.truth:.3g}"
    which = f"with {drawn.count}: " if len(group) > 1 else ""
    return "\n".join([*lines, f"{which}FIT {drawn.rms:.3g}{truth}" + (f" {unit}" if unit else "")])


def _draw_data(axes: Axes, subject: Subject, scales: _Scales) -> None:
    _frame(axes, subject)
    _dots(axes, subject, subject.values, **scales.value_look)
    axes.set_title(f"{subject.name}\n{len(subject.points)} data", loc="left", fontsize=9)


def _draw_note(axes: Axes) -> None:
    """Say below the data what is below the surfaces."""
    axes.set_axis_off()
    note = "Below each surface:\nthe data minus the surface."
    axes.text(0.97, 0.5, note, ha="right", va="center", fontsize=9, transform=axes.transAxes)


def _draw_residuals(axes: Axes, subject: Subject, fit: PanelFit, scales: _Scales) -> None:
    _frame(axes, subject)
    _dots(axes, subject, _residuals(subject, fit), **scales.residual_look)


def _draw_surface(axes: Any, subject: Subject, fit: PanelFit, scales: _Scales) -> None:
    if scales.view is None:
        # What is nearer to a camera stands higher.
        _draw_relief(axes, fit.surface, scales.values, 1.0 if subject.image_size is None else -1.0)
        _frame(axes, subject)
        return
    draw_solid(axes, replace(_solid(subject, fit), labels=("", "", "")), scales.view, _ZOOM)
    axes.set(xticklabels=[], yticklabels=[], zticklabels=[])


def _colour_bar(axes: Axes, label: str, look: Mapping[str, Any]) -> None:
    from matplotlib.cm import ScalarMappable  # noqa: PLC0415  an extra, imported where used
    from matplotlib.colors import Normalize  # noqa: PLC0415

    colours = ScalarMappable(Normalize(look["vmin"], look["vmax"]), look["cmap"])
    extend = "both" if look["vmin"] else "max"
    axes.figure.colorbar(colours, cax=axes, label=label, extend=extend)


def _frame(axes: Axes, subject: Subject) -> None:
    """Show the axes without numbers: all panels have the same."""
    axes.set(xticks=[], yticks=[])
    frame(axes, subject.points, y_down=subject.image_size is not None)


def _dots(axes: Axes, subject: Subject, colours: Floats, **look: Any) -> None:
    """Draw numbers where the data are, as squares that nearly touch."""
    wide, high = np.ptp(subject.points, axis=0)
    area = (72 * _WIDTH) ** 2 * float(min(high / wide, wide / high)) / len(subject.points)
    x, y = subject.points.T
    axes.scatter(x, y, c=colours, s=float(np.clip(0.7 * area, 0.5, 40)), marker="s", linewidths=0, **look)


def _draw_relief(axes: Axes, surface: Surface, limits: tuple[float, float], sign: float) -> None:
    from matplotlib import colormaps  # noqa: PLC0415  an extra, imported where used

    low, high = surface.domain.min(axis=0), surface.domain.max(axis=0)
    step = float(np.sqrt(np.prod(high - low) / _SAMPLES))
    grid = surface.grid(step=step)
    span = (limits[1] - limits[0]) or 1.0
    shades = colormaps["viridis"]((np.nan_to_num(grid.values) - limits[0]) / span)
    raised = grid.values * (sign * _STEEP * float((high - low).max()) / span)
    shades[..., :3] = np.clip(shades[..., :3] * _lit(raised, step)[..., None], 0, 1)
    shades[..., 3] = grid.inside
    half = step / 2
    extent = (grid.x[0] - half, grid.x[-1] + half, grid.y[0] - half, grid.y[-1] + half)
    axes.imshow(shades, extent=extent, origin="lower", interpolation="nearest")


def _lit(heights: Floats, step: float) -> Floats:
    """Return how bright a relief is in the light from the upper left: 1 where it is level or unknown."""
    down, right = np.gradient(heights, step)
    normals = np.stack([-right, -down, np.ones_like(heights)], axis=-1)
    cosine = (normals @ [-0.5, -0.5, 1.0]) / np.linalg.norm(normals, axis=-1)
    return np.asarray(np.nan_to_num(np.clip(0.4 + 0.6 * cosine, 0.4, 1.4), nan=1.0))
