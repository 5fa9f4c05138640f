"""What a warp does, in pictures of a page: registered images, displacements, errors at matches, the error to expect."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mexpress._validation import Floats, Integers
from mexpress.geometry import diagonal, grid_points
from mexpress.models import Warp
from mexpress.plotting.figures import percentile
from mexpress.plotting.warps import grid_lines
from mexpress.report.drawing import line
from mexpress.report.errors import distance_figure, error_figure, painted, residual_dots
from mexpress.report.images import compared_images
from mexpress.report.maps import FIELD, HEAT, Map, colour_bar, colours_of, crosses, hexadecimal

_CELLS, _ARROWS, _MOST = 180, 13, 2500
"""Cells and arrows along the longer side of a map, and matches that are shown at most."""

_UNIT = "pixels"


def warp_figures(
    warp: Warp,
    source: Floats,
    target: Floats,
    kept: Integers,
    left_out: Integers,
    images: tuple[ArrayLike, ArrayLike] | None = None,
) -> list[str]:
    """Return the figures of a warp, as HTML.

    Parameters
    ----------
    warp : Warp
        The warp.
    source, target : (n, 2) array
        All matches.
    kept, left_out : integer array
        Indices of those that are in the fit, and of those that are not because they look wrong.
    images : tuple of array_like, optional
        The source image and the target image.

    Examples
    --------
    >>> import mexpress as mx
    >>> source = np.random.default_rng(0).uniform(0, 100, (40, 2))
    >>> warp = mx.fit_warp(source, source + 3, source[:4])
    >>> len(warp_figures(warp, source, source + 3, np.arange(40), np.arange(0)))
    4
    """
    figures = [] if images is None else [compared_images(warp, *images)]
    names = "x (pixels of the source image)", "y"
    figures.append(_displacements(warp, names))
    figures.append(_residuals(warp, source, target, kept, left_out))
    return [*figures, error_figure(warp, True, names, _UNIT), distance_figure(warp, _UNIT)]


def _displacements(warp: Warp, names: tuple[str, str]) -> str:
    area = Map.over(warp.domain, y_down=True)
    x, y = area.cells(_CELLS)
    lengths = np.hypot(*_moves(warp, x, y).T).reshape(len(y), len(x))
    low, high = percentile(lengths, 1), percentile(lengths, 99)
    if not high > low:
        low, high = 0.0, high or 1.0
    x, y = area.cells(_ARROWS)
    drawn = [area.field(painted(lengths, low, high)), _arrows(area, grid_points(x, y), _moves(warp, x, y))]
    caption = "Colours: how far the warp moves points of the source image. Arrows: where to, not to scale."
    bar = colour_bar(low, high, FIELD, f"displacement ({_UNIT})")
    return area.figure("Displacement", drawn, bar, caption, names, lengths, _UNIT)


def _moves(warp: Warp, x: Floats, y: Floats) -> Floats:
    """Return the displacements of the points of a grid; NaN outside of the domain."""
    points = grid_points(x, y)
    return np.asarray(warp(points, outside="nan") - points)


def _arrows(area: Map, points: Floats, moves: Floats) -> str:
    """Return arrows of displacements, of which the usual large one is as long as their distance."""
    usual = percentile(np.hypot(*moves.T), 95)
    step = abs(area.x.stop - area.x.start) / (area.x.high - area.x.low)
    apart = abs(area.x(points[1, 0]) - area.x(points[0, 0]))
    if usual * step < 1e-6:
        return ""
    known = np.isfinite(moves).all(axis=1)
    places, upward = area.places(points[known]), -1 if area.y.start > area.y.stop else 1
    along = moves[known] * [1, upward] * 0.9 * apart / usual
    arrows = [_arrow(x, y, dx, dy) for (x, y), (dx, dy) in zip(places, along.tolist(), strict=True)]
    return f'<g class="arrows">{"".join(arrows)}</g>'


def _arrow(x: float, y: float, dx: float, dy: float) -> str:
    """Return an arrow of which a place is the middle."""
    x, y = x - dx / 2, y - dy / 2
    head = [(-0.3 * dx - 0.18 * dy, -0.3 * dy + 0.18 * dx), (-0.3 * dx + 0.18 * dy, -0.3 * dy - 0.18 * dx)]
    tip = x + dx, y + dy
    first, second = ((tip[0] + a, tip[1] + b) for a, b in head)
    return line([(x, y), tip, (np.nan, 0), first, tip, second], 'class="arrow"')


def _residuals(warp: Warp, source: Floats, target: Floats, kept: Integers, left_out: Integers) -> str:
    """Return the matches in the target image, coloured by how far the warp misses them, over the warped grid."""
    area = Map.over(target[kept], y_down=True)
    sizes = warp.residuals(source[kept], target[kept])
    largest = percentile(sizes, 98) or 1.0
    colours = hexadecimal(colours_of(sizes, 0.0, largest, HEAT))
    words = [f"match {k}: {size:.3g} pixels" for k, size in zip(kept.tolist(), sizes.tolist(), strict=True)]
    dots, hidden = residual_dots(area, target[kept], sizes, colours, words, _MOST)
    lost = warp.residuals(source[left_out], target[left_out]).tolist()
    wrong = [
        f"match {k}: {size:.3g} pixels, left out" for k, size in zip(left_out.tolist(), lost, strict=True)
    ]
    arrows, factor = _misses(area, warp(source[kept]), target[kept])
    drawn = [
        *(line(area.places(warp(grid)), 'class="grid"') for grid in grid_lines(warp)),
        *arrows,
        *dots,
        *crosses(area.places(target[left_out]), wrong),
    ]
    rms = float(np.sqrt(np.mean(sizes**2)))
    caption = f"Matches in the target image, by how far the warp misses them: RMS {rms:.3g} pixels. "
    caption += f"Lines lead from each to where the warp puts it, {factor:g} times as long. " if arrows else ""
    caption += "Gray: a square grid of the source image, warped."
    outside = len(left_out) - sum(area.has(target[left_out]))
    caption += f" Crosses: {len(left_out)} left out as wrong." if len(left_out) else ""
    caption += f" Outside of the picture: {outside} of them." if outside else ""
    caption += f" {hidden} matches of small errors are not shown." if hidden else ""
    bar = colour_bar(0.0, largest, HEAT, f"error at the match ({_UNIT})")
    names = "x (pixels of the target image)", "y"
    return area.figure("Errors at the matches", drawn, bar, caption, names)


def _misses(area: Map, predicted: Floats, target: Floats) -> tuple[list[str], float]:
    """Return lines from matches towards where they are predicted, and how much longer than the errors they are."""
    known = np.isfinite(predicted).all(axis=1)
    errors, places = (predicted - target)[known], target[known]
    usual, extent = percentile(np.hypot(*errors.T), 90), diagonal(target)
    if not usual > 1e-9 * extent or len(places) > _MOST:
        return [], 1.0
    power = 10.0 ** np.floor(np.log10(0.03 * extent / usual))
    factor = float(
        power * max(part for part in (1, 2, 5) if part * power <= 0.03 * extent / usual * (1 + 1e-9))
    )
    ends = zip(area.places(places), area.places(places + factor * errors), strict=True)
    return [line(pair, 'class="miss"') for pair in ends], factor
