"""The error to expect of a model, all over a map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mexpress._validation import Floats
from mexpress.geometry import grid_points, lattice, nearest
from mexpress.models import FittedModel
from mexpress.plotting.figures import percentile
from mexpress.report.curves import Curves
from mexpress.report.maps import FIELD, Map, colour_bar, colours_of, dots

_CELLS = 180
"""Cells along the longer side of a map."""

_PLACES, _DISTANCES = 1000, 60
"""Places of the region that tell how far it is from the data, and distances along the curves."""

_DOTS = 1500
"""Of more data some are shown."""


def error_figure(model: FittedModel, y_down: bool, names: tuple[str, str], unit: str) -> str:
    """Return the map of the error to expect; hatched where it has not been tested.

    Examples
    --------
    >>> import mexpress as mx
    >>> points = np.random.default_rng(0).uniform(0, 9, (60, 2))
    >>> surface = mx.fit_surface(points, np.sin(points[:, 0]), points[:9])
    >>> error_figure(surface, False, ("x", "y"), "m").count("<figure")
    1
    """
    area = Map.over(model.domain, y_down)
    x, y = area.cells(_CELLS)
    points = grid_points(x, y)
    shape = len(y), len(x)
    errors, covered = model.error(points).reshape(shape), model.covers(points).reshape(shape)
    smallest, largest = (
        percentile(errors[covered], 0.5),
        percentile(errors[covered], 99.5) or percentile(errors, 95),
    )
    if not largest > smallest:
        smallest, largest = 0.0, largest or 1.0
    pixels = painted(errors, smallest, largest)
    row, column = np.indices(shape)
    pixels[~covered & ((row + column) % 6 < 2), 3] = 0
    pixels[~covered, 3] = np.minimum(pixels[~covered, 3], 110)
    assert model.data is not None  # or there is no error
    some = model.data.points[:: -(-len(model.data.points) // _DOTS)]
    drawn = [area.field(pixels), f'<g class="data">{"".join(_plain(area, some))}</g>']
    caption = (
        "How far off predictions are: by how much held-out data were missed that were as far from the others. "
        "Hatched: not tested, outside of the data or in gaps wider than could be tried. Dots: data."
    )
    bar = colour_bar(smallest, largest, FIELD, f"error to expect ({unit})")
    return area.figure("Error to expect", drawn, bar, caption, names, errors, unit)


def _plain(area: Map, points: Floats) -> list[str]:
    return [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.4"/>' for x, y in area.places(points)]


def distance_figure(model: FittedModel, unit: str) -> str:
    """Return the curves of the error to expect against the distance to the nearest datum.

    Examples
    --------
    >>> import mexpress as mx
    >>> points = np.random.default_rng(0).uniform(0, 9, (60, 2))
    >>> distance_figure(mx.fit_surface(points, np.sin(points[:, 0]), points[:9]), "m").count("<li")
    2
    """
    curves = model.error_curves
    assert model.data is not None  # or there is no error
    reach = nearest(lattice(model.domain, _PLACES), model.data.points)[1]
    far = 1.05 * max(float(reach.max()), min(curves.inside.reach, 3 * float(reach.max())))
    distances = np.linspace(0, far, _DISTANCES)
    scores = {}
    for name, where in (("inside the region of the data", True), ("outside of it", False)):
        errors = curves(distances, np.full(_DISTANCES, where))
        scores[name] = np.where(np.isfinite(errors), errors, np.nan).tolist()
    usual = int(np.searchsorted(distances, np.median(reach)))
    share = [float(np.mean(reach <= distance)) for distance in distances]
    words = [
        f"at distance {distance:.3g}; {100 * part:.0f} % of the region are nearer"
        for distance, part in zip(distances.tolist(), share, strict=True)
    ]
    return Curves(
        criterion="",
        x=distances.tolist(),
        names=words,
        ticks=[],
        scores=scores,
        best=dict.fromkeys(scores),
        axis="distance to the nearest datum",
        unit=f"error to expect ({unit})",
        chosen=usual,
        title="Error to expect by distance",
    ).figure()


def painted(values: Floats, low: float, high: float) -> NDArray[np.uint8]:
    """Return values (rows, columns) as pixels, which are clear where a value is NaN.

    Examples
    --------
    >>> painted(np.array([[np.nan, 1.0]]), 0, 1)[0, :, 3].tolist()
    [0, 255]
    """
    pixels = np.empty((*values.shape, 4), np.uint8)
    pixels[..., :3] = colours_of(values, low, high, FIELD)
    pixels[..., 3] = np.where(np.isnan(values), 0, 255)
    return pixels


def residual_dots(
    area: Map, points: Floats, sizes: Floats, colours: list[str], words: list[str], most: int
) -> tuple[list[str], int]:
    """Return dots of the data, the largest on top, and how many are not shown: of many the smallest are thinned out.

    Parameters
    ----------
    area : Map
        The map.
    points : (n, 2) array
        Where the data are.
    sizes : (n,) array
        How large their residuals are.
    colours, words : list of str
        Of each.
    most : int
        So many are shown.

    Examples
    --------
    >>> area = Map.over(np.array([[0.0, 0.0], [9.0, 9.0]]), True)
    >>> drawn, hidden = residual_dots(area, np.eye(2), np.array([1.0, 2.0]), ["#000000"] * 2, ["0", "1"], 1)
    >>> len(drawn), hidden
    (1, 1)
    """
    order = np.argsort(np.nan_to_num(sizes, nan=np.inf, posinf=np.inf), kind="stable")
    if len(order) > most:
        large, small = order[-(most // 2 or 1) :], order[: -(most // 2 or 1)]
        kept = np.linspace(0, len(small) - 1, most - len(large)).round().astype(int)
        order = np.concatenate([small[kept], large])
    places = area.places(points[order])
    size = float(np.clip(60 / np.sqrt(len(order)), 1.6, 4.5))
    drawn = dots(places, [colours[k] for k in order], [words[k] for k in order], size)
    return drawn, len(sizes) - len(order)
