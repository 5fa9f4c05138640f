"""Surfaces in space, shaded, with data as dots: what is behind is hidden by what is before it.

matplotlib sorts the polygons of one collection by their distance from the eye, but draws one collection after
the other. The dots are therefore small squares that face the eye, among the surface's triangles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from mexpress._validation import Floats, Integers
from mexpress.models.surface import Surface
from mexpress.plotting.figures import percentile, with_unit

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d.axes3d import Axes3D  # type: ignore[import-untyped]

_DOTS = 2000
"""About so many data are drawn."""

_DOT, _LIFT = 0.0035, 0.012
"""Half the side of a dot, and how far it is before its place, as fractions of the box."""

_LABELS = np.array([1.1, 0.8])
"""Inches beside the box, and above and below it, for what is written there."""

_BOX = 1.06
"""Diagonal of the box as matplotlib draws it, as a fraction of the smaller side of its axes."""

_UPRIGHT = [0, 2, 1]
"""The order of an image's axes in the box: x to the right, depth away from the eye, y upright."""

View = tuple[float, float]
"""Elevation and azimuth of the eye in degrees."""


@dataclass(frozen=True)
class Solid:
    """A surface in a box, ready to be drawn.

    Parameters
    ----------
    vertices, triangles : ndarray, (k, 3) and (t, 3)
        The surface.
    shades : ndarray, (k,) or (0,)
        Colours of the vertices, from 0 to 1; none if it is empty.
    dots : ndarray, (m, 3)
        The data.
    low, high : ndarray, (3,)
        Opposite corners of the box; an axis on which low is above high points down.
    aspect : ndarray, (3,)
        Lengths of the box's sides as drawn.
    labels : sequence of str
        Of the axes.
    views : sequence of View
        From where to look, the best one first.
    """

    vertices: Floats
    triangles: Integers
    shades: Floats
    dots: Floats
    low: Floats
    high: Floats
    aspect: Floats
    labels: tuple[str, str, str]
    views: tuple[View, ...]

    @classmethod
    def of_depths(
        cls,
        surface: Surface,
        points: Floats,
        depths: Floats,
        image_size: tuple[float, float] | None,
        unit: str | None,
    ) -> Self:
        """Return a depth over the plane: an image stands upright before the eye, else the plane lies flat."""
        grid, triangles = _sampled(surface)
        least, most = percentile(depths, 1), percentile(depths, 99)
        shades = (grid[:, 2] - least) / ((most - least) or 1.0)
        low = np.append(points.min(axis=0), min(least, grid[:, 2].min()))
        high = np.append(points.max(axis=0), max(most, grid[:, 2].max()))
        low, high = _opened(low, high)
        aspect = np.append(np.ptp(points, axis=0) / np.ptp(points, axis=0).max(), 0.4)
        dots = _some(np.column_stack([points, depths]), low, high)
        if image_size is None:
            labels = ("x", "y", with_unit("value", unit))
            return cls(grid, triangles, shades, dots, low, high, aspect, labels, ((35, -60),))
        low[1], high[1] = high[1], low[1]
        aspect[2] = 0.8
        grid, dots, low, high, aspect = (array[..., _UPRIGHT] for array in (grid, dots, low, high, aspect))
        labels = ("x (pixels)", with_unit("depth", unit), "y (pixels)")
        return cls(grid, triangles, shades, dots, low, high, aspect, labels, ((20, -60),))

    @classmethod
    def of_points(cls, surface: Surface, values: Floats, in_camera: bool, unit: str | None) -> Self:
        """Return a surface in space, in its own proportions; a camera's y points down and its z away."""
        grid, triangles = _sampled(surface)
        vertices = grid[:, 2:]
        low = np.minimum(vertices.min(axis=0), np.percentile(values, 1, axis=0))
        high = np.maximum(vertices.max(axis=0), np.percentile(values, 99, axis=0))
        low, high = _opened(low, high)
        dots, names = _some(values, low, high), [with_unit(axis, unit) if unit else axis for axis in "xyz"]
        views = _views(vertices, triangles)
        if in_camera:
            low[1], high[1] = high[1], low[1]
            vertices, dots, low, high = (array[..., _UPRIGHT] for array in (vertices, dots, low, high))
            names, views = [names[k] for k in _UPRIGHT], ((15, -70), (35, -110))
        size = np.abs(high - low)
        aspect = np.maximum(size / size.max(), 0.05)
        labels = (names[0], names[1], names[2])
        return cls(vertices, triangles, np.zeros(0), dots, low, high, aspect, labels, views)


def _sampled(surface: Surface) -> tuple[Floats, Integers]:
    """Return samples (k, 2 + d) inside the domain, their places first, and triangles."""
    grid = surface.grid()
    used, triangles = np.unique(grid.triangles, return_inverse=True)
    values = grid.values.reshape(grid.inside.size, -1)
    return np.column_stack([grid.points, values])[used], triangles.reshape(-1, 3)


def _opened(low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Return the corners of a box that has a volume, though the surface may be flat."""
    size = np.maximum(np.abs(low), np.abs(high))
    room = np.where(high - low <= 1e-9 * size, np.where(size > 0, 0.05 * size, 1.0), 0.0)
    return low - room, high + room


def _some(data: Floats, low: Floats, high: Floats) -> Floats:
    """Return some of the data that are in a box."""
    inside = data[((data >= np.minimum(low, high)) & (data <= np.maximum(low, high))).all(axis=1)]
    return inside[:: max(1, -(-len(inside) // _DOTS))]


def _views(vertices: Floats, triangles: Integers) -> tuple[View, View]:
    """Return views from either side of the mean normal of a surface, so that most of it is seen."""
    normal = _normals(vertices[triangles]).sum(axis=0)
    normal = normal if normal[2] >= 0 else -normal
    elevation = float(np.degrees(np.arctan2(normal[2], np.hypot(*normal[:2]))))
    azimuth = float(np.degrees(np.arctan2(normal[1], normal[0])))
    if elevation > 60:  # nearly a map: the direction of its slope means nothing
        return (35.0, -60.0), (20.0, 30.0)
    return (min(elevation + 15, 50), azimuth - 35), (max(elevation - 10, 10), azimuth + 40)


def _normals(corners: Floats) -> Floats:
    """Return the normals of triangles, as long as their areas are large."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def draw_solid(axes: Axes3D, solid: Solid, view: View, zoom: float | None = None) -> None:
    """Draw a surface and data as an eye sees them; by default the box fills the axes, but for its labels."""
    from mpl_toolkits.mplot3d.art3d import (  # type: ignore[import-untyped]  # noqa: PLC0415  an extra
        Poly3DCollection,
    )

    scale = (solid.high - solid.low) / solid.aspect
    corners = solid.vertices[solid.triangles]
    faces = _shaded(_colours(solid), corners / scale, view)
    squares = _squares(solid.dots, scale, view)
    colours = np.vstack([faces, np.tile([0.1, 0.1, 0.1, 1.0], (len(squares), 1))])
    # All with four corners: to find its limits, matplotlib reads uninitialised memory where some have fewer.
    polygons = np.concatenate([corners[:, [0, 1, 2, 2]], squares])
    look = {"facecolors": colours, "edgecolors": colours, "linewidths": 0.4}
    axes.add_collection3d(Poly3DCollection(polygons, **look, clip_on=False))
    axes.set(
        xlim=(solid.low[0], solid.high[0]),
        ylim=(solid.low[1], solid.high[1]),
        zlim=(solid.low[2], solid.high[2]),
    )
    axes.set(xlabel=solid.labels[0], ylabel=solid.labels[1], zlabel=solid.labels[2])
    axes.set_box_aspect(solid.aspect, zoom=_filling(axes, solid, view) if zoom is None else zoom)
    axes.view_init(*view)
    axes.locator_params(nbins=5)
    axes.tick_params(labelsize=8)


def _filling(axes: Axes3D, solid: Solid, view: View) -> float:
    """Return how much larger than by matplotlib's habit the box must be to fill its axes, but for the labels."""
    _, right, up = _eye(view)
    room = axes.bbox.size - _LABELS * axes.figure.dpi
    sides = _BOX * solid.aspect / np.linalg.norm(solid.aspect)
    size = np.array([np.abs(right) @ sides, np.abs(up) @ sides]) * min(axes.bbox.size)
    return float(max((room / size).min(), 0.5))


def _colours(solid: Solid) -> NDArray[np.float64]:
    """Return the colour of every triangle."""
    from matplotlib import colormaps  # noqa: PLC0415  an extra, imported where used

    if not solid.shades.size:
        return np.tile([0.62, 0.74, 0.86, 1.0], (len(solid.triangles), 1))
    return np.asarray(colormaps["viridis"](solid.shades[solid.triangles].mean(axis=1)))


def _shaded(colours: Floats, corners: Floats, view: View) -> Floats:
    """Return colours as a light beside the eye makes them, on both sides of the surface."""
    normals = _normals(corners)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    towards, right, up = _eye(view)
    light = towards - 0.5 * right + 0.6 * up
    lit = np.abs(normals @ light) / np.linalg.norm(light) / np.where(lengths > 0, lengths, 1)[:, 0]
    return np.column_stack([colours[:, :3] * (0.4 + 0.6 * lit)[:, None], colours[:, 3]])


def _squares(dots: Floats, scale: Floats, view: View) -> Floats:
    """Return small squares that face the eye, (m, 4, 3)."""
    towards, right, up = _eye(view)
    steps = [_DOT * (x * right + y * up) + _LIFT * towards for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return np.asarray(dots[:, None] + np.array(steps) * scale)


def _eye(view: View) -> tuple[Floats, Floats, Floats]:
    """Return the unit vectors towards the eye, to its right and upwards, in the drawn box."""
    elevation, azimuth = np.radians(view)
    across, along = np.sin(azimuth), np.cos(azimuth)
    towards = np.array([np.cos(elevation) * along, np.cos(elevation) * across, np.sin(elevation)])
    right = np.array([-across, along, 0.0])
    return towards, right, np.cross(towards, right)
