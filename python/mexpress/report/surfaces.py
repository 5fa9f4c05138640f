"""A surface in pictures of a page: in space, to be turned; residuals at the data; the error to expect."""

from __future__ import annotations

import json
import math
from html import escape
from typing import Any

import numpy as np

from mexpress._validation import Floats, Integers
from mexpress.geometry import lengths_of
from mexpress.models import Surface
from mexpress.plotting.figures import percentile
from mexpress.report.errors import distance_figure, error_figure, residual_dots
from mexpress.report.maps import FIELD, HEAT, SIGNED, Map, colour_bar, colours_of, crosses, hexadecimal

_SAMPLES, _MOST = 56, 2500
"""Samples along the longer side of the surface in space, and data that are shown at most."""

_RELIEF = 0.4
"""Range of depths in space, as a fraction of the domain's longer side."""

_SHADES = 64


def surface_figures(
    surface: Surface,
    points: Floats,
    values: Floats,
    kept: Integers,
    left_out: Integers,
    *,
    names: tuple[str, str],
    y_down: bool,
    unit: str,
) -> list[str]:
    """Return the figures of a surface, as HTML.

    Parameters
    ----------
    surface : Surface
        The surface.
    points, values : array
        All data.
    kept, left_out : integer array
        Indices of those that are in the fit, and of those that are not because they look wrong.
    names : tuple of str
        What x and y are.
    y_down : bool
        Whether y points down, as in an image.
    unit : str
        Of the values.

    Examples
    --------
    >>> import mexpress as mx
    >>> points = np.random.default_rng(0).uniform(0, 9, (60, 2))
    >>> surface = mx.fit_surface(points, points[:, 0], points[:9])
    >>> look = {"names": ("x", "y"), "y_down": False, "unit": "m"}
    >>> len(surface_figures(surface, points, points[:, 0], np.arange(60), np.arange(0), **look))
    4
    """
    dimension = 1 if values.ndim == 1 else values.shape[1]
    solid = [_in_space(surface, dimension, names, y_down, unit)] if dimension in {1, 3} else []
    return [
        *solid,
        _residuals(surface, points, values, kept, left_out, names, y_down, unit),
        error_figure(surface, y_down, names, unit),
        distance_figure(surface, unit),
    ]


def _in_space(surface: Surface, dimension: int, names: tuple[str, str], y_down: bool, unit: str) -> str:
    """Return the surface as a mesh, which the script draws and turns."""
    wide, high = np.ptp(surface.domain, axis=0)
    columns, rows = (max(3, round(_SAMPLES * side / max(wide, high))) for side in (wide, high))
    grid = surface.grid(shape=(rows, columns))
    heights = grid.values.reshape(rows * columns, -1)
    vertices = np.hstack([grid.points, heights]) if dimension == 1 else heights
    vertices = np.where(grid.inside.reshape(-1, 1), vertices, np.nan)
    low, high3 = np.nanmin(vertices, axis=0), np.nanmax(vertices, axis=0)
    extent, steep = high3 - low, 1.0
    if dimension == 1:
        # A flat surface is flat, whatever rounding makes of it.
        size = max(float(extent[2]), 1e-9 * float(np.abs([low[2], high3[2]]).max()))
        steep = _RELIEF * float(extent[:2].max()) / (size or 1.0)
    scale = np.array([1.0, -1.0 if dimension == 1 and y_down else 1.0, steep])
    half = np.abs(scale) * extent / 2
    unitless = (vertices - (low + high3) / 2) * scale / (half.max() or 1.0)
    ends = [[f"{value:.3g}" for value in pair] for pair in zip(low.tolist(), high3.tolist(), strict=True)]
    if scale[1] < 0:
        ends[1].reverse()
    labels = [*(name.split(" ")[0] for name in names), "value"] if dimension == 1 else ["x", "y", "z"]
    content: dict[str, Any] = {
        "columns": columns,
        "rows": rows,
        "vertices": [
            round(value, 4) if math.isfinite(value) else None for value in unitless.ravel().tolist()
        ],
        "half": [round(value, 4) for value in (half / (half.max() or 1.0)).tolist()],
        "ends": ends,
        "names": labels,
        "colours": colours_of(np.linspace(0, 1, _SHADES), 0, 1, FIELD).tolist(),
    }
    said = f"Drag it, or move the sliders. Colours: {labels[2]}, from {ends[2][0]} to {ends[2][1]} ({escape(unit)})."
    if dimension == 1:
        said += f" A height of 1 is drawn as long as {float(f'{steep:.2g}'):g} along x and y."
    sliders = "".join(
        f'<label>{name} <input type="range" min="{least}" max="{most}" value="{value}" data-angle="{name}"></label>'
        for name, least, most, value in (("turn", -180, 180, -35), ("tilt", 0, 90, 35))
    )
    return (
        f'<figure class="solid" data-mesh="{escape(json.dumps(content, allow_nan=False))}"><h3>In space</h3>'
        f'<canvas role="img" aria-label="The surface in space"></canvas><div class="angles">{sliders}</div>'
        f"<figcaption>{said}</figcaption></figure>"
    )


def _residuals(
    surface: Surface,
    points: Floats,
    values: Floats,
    kept: Integers,
    left_out: Integers,
    names: tuple[str, str],
    y_down: bool,
    unit: str,
) -> str:
    area = Map.over(surface.domain, y_down)
    misses = values[kept] - surface(points[kept])
    signed = misses.ndim == 1
    sizes = np.abs(misses) if signed else lengths_of(misses)
    largest = percentile(sizes, 98) or 1.0
    shown, low, anchors = (misses, -largest, SIGNED) if signed else (sizes, 0.0, HEAT)
    colours = hexadecimal(colours_of(shown, low, largest, anchors))
    words = [f"datum {k}: {miss:.3g} {unit}" for k, miss in zip(kept.tolist(), shown.tolist(), strict=True)]
    dots, hidden = residual_dots(area, points[kept], sizes, colours, words, _MOST)
    lost = values[left_out] - surface(points[left_out])
    wrong = lost.tolist() if signed else lengths_of(lost).tolist()
    marks = [
        f"datum {k}: {miss:.3g} {unit}, left out" for k, miss in zip(left_out.tolist(), wrong, strict=True)
    ]
    drawn = [*dots, *crosses(area.places(points[left_out]), marks)]
    rms = float(np.sqrt(np.mean(sizes**2)))
    caption = f"Data minus surface{'' if signed else ', lengths'}: RMS {rms:.3g} {escape(unit)}."
    caption += f" Crosses: {len(left_out)} left out as wrong." if len(left_out) else ""
    caption += f" {hidden} data of small residuals are not shown." if hidden else ""
    bar = colour_bar(low, largest, anchors, f"residual ({unit})")
    return area.figure("Residuals at the data", drawn, bar, caption, names)
