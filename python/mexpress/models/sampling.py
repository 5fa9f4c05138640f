"""Where surfaces are sampled: the coordinates of a regular grid over a box, or those of another grid.

Examples
--------
>>> x, y = regular(Box(np.zeros(2), np.array([4.0, 2.0]), 8.0), step=2)
>>> x, y
(array([0., 2., 4.]), array([0., 2.]))
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Any, NamedTuple

import numpy as np

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.geometry import EDGE
from mexpress.io.labelled import coordinates, is_labelled, plane_of

_SAMPLES = 10_000
"""Default number of samples of a grid inside the domain, approximately."""

_MOST_SAMPLES = 10**7
"""Largest number of samples of a grid, inside the domain or not; more are refused as a mistake."""


class Box(NamedTuple):
    """A rectangle: its lower left corner, its extent along x and y, and the area in it that is to be sampled."""

    low: Floats
    extent: Floats
    area: float

    @classmethod
    def of(cls, region: Any) -> Box:
        """Return the box of (west, east, south, north)."""
        rule = "It must be (west, east, south, north), west below east and south below north."
        sides = check.items(region, "region", rule)
        if len(sides) != 4:
            check.refuse("region", rule, check.describe(region))
        west, east, south, north = (
            check.number(side, "region", rule, -check.LARGEST_COORDINATE) for side in sides
        )
        if not (west < east and south < north) or max(east, north) > check.LARGEST_COORDINATE:
            check.refuse("region", rule, check.describe(region))
        extent = np.array([east - west, north - south])
        return cls(np.array([west, south]), extent, float(extent.prod()))

    @property
    def usual_step(self) -> float:
        """The step that gives about 10,000 samples in the area, within the limit on all samples."""
        return float(np.sqrt(max(self.area / _SAMPLES, self.extent.prod() / (100 * _SAMPLES))))


def regular(
    box: Box, step: float | None = None, shape: Any = None, name: str = "step"
) -> tuple[Floats, Floats]:
    """Return x and y of a grid that starts at the lower left corner of a box, or fills it if it has a shape.

    Raises
    ------
    ValueError
        If the grid has more than 10^7 samples, both a step, called by its name, and a shape are given, or the step is
        longer than the box is wide or high.
    """
    low, extent = box.low, box.extent
    if shape is not None:
        if step is not None:
            check.refuse("shape", f"It must be None when there is a {name}.", check.describe(shape))
        rows, columns = _grid_shape(shape)
        _check_samples(rows * columns, "shape", check.describe(shape))
        return low[0] + np.linspace(0, extent[0], columns), low[1] + np.linspace(0, extent[1], rows)
    spacing = box.usual_step if step is None else check.positive(step, name)
    if step is not None and spacing * (1 - EDGE) > extent.min():
        rule = f"It must not exceed {extent.min():g}, so that there are two rows and two columns."
        check.refuse(name, rule, f"{spacing:g}")
    with np.errstate(over="ignore"):
        columns, rows = np.floor(extent / spacing + EDGE) + 1
    _check_samples(columns * rows, name, f"{spacing:g}")
    return low[0] + spacing * np.arange(columns), low[1] + spacing * np.arange(rows)


class Sheet(NamedTuple):
    """x and y of a grid, the names of its dimensions, y first, and coordinates as a Dataset has them."""

    x: Floats
    y: Floats
    dims: tuple[Hashable, Hashable]
    coordinates: Mapping[Hashable, Any]


def like_another(grid: Any) -> Sheet:
    """Return where another grid has its samples: a SurfaceGrid, a DataArray or a Dataset.

    Of the latter two, all coordinates are taken that need no third dimension, with their attributes.

    Raises
    ------
    ValueError, TypeError
        If it is none of these, its dimensions are not x and y, or it has no samples, or more than 10^7.

    Examples
    --------
    >>> import xarray as xr
    >>> like_another(xr.DataArray(np.zeros((2, 3)), {"lat": [8, 7]}, dims=["lat", "lon"])).y
    array([8., 7.])
    """
    if is_labelled(grid):
        dims = plane_of(grid, "like")
        y, x = (coordinates(grid, dim) for dim in dims)
        taken = {name: grid.coords[name] for name in grid.coords if set(grid.coords[name].dims) <= set(dims)}
        sheet = Sheet(x, y, dims, taken)
    else:
        found = getattr(grid, "x", None), getattr(grid, "y", None)
        if not all(isinstance(axis, np.ndarray) and axis.ndim == 1 for axis in found):
            rule = "It must be a DataArray or a Dataset of xarray, or a SurfaceGrid."
            check.refuse("like", rule, check.describe(grid), TypeError)
        x, y = (check.finite(check.real(axis, "like"), "like") for axis in found if axis is not None)
        sheet = named(x, y, ("y", "x"), None)
    if not len(x) * len(y):
        check.refuse("like", "It must have samples.", f"shape ({len(y)}, {len(x)})")
    _check_samples(len(x) * len(y), "like", f"shape ({len(y)}, {len(x)})")
    return sheet


def named(x: Floats, y: Floats, dims: Any, units: str | None) -> Sheet:
    """Return a grid with names for its dimensions, y first, and the unit of both."""
    rule = 'They must be two names, y first, such as ("northing", "easting").'
    up, across = names_of(dims, "dims", 2, rule)
    unit = {} if units is None else {"units": units}
    return Sheet(
        x, y, (up, across), {up: (up, y, {"axis": "Y", **unit}), across: (across, x, {"axis": "X", **unit})}
    )


def names_of(names: Any, argument: str, number: int, rule: str) -> list[str]:
    """Return a number of names, all different; one may be given by itself.

    Examples
    --------
    >>> names_of("height", "names", 1, "")
    ['height']
    """
    given = [names] if isinstance(names, str) else check.items(names, argument, rule)
    if not all(isinstance(name, str) for name in given):
        check.refuse(argument, rule, check.describe(names), TypeError)
    if len(given) != number or len(set(given)) < number or "" in given:
        check.refuse(argument, rule, check.describe(names))
    return given


def unit_of(unit: Any, name: str) -> str | None:
    """Return the name of a unit, or None."""
    if not (unit is None or isinstance(unit, str)):
        check.refuse(name, 'It must be the name of a unit, such as "m".', check.describe(unit), TypeError)
    return unit


def _grid_shape(shape: Any) -> tuple[int, int]:
    rule = "It must be (rows, columns)."
    sizes = check.items(shape, "shape", rule)
    if len(sizes) != 2:
        check.refuse("shape", rule, check.describe(shape))
    rows, columns = (check.count(sizes[k], f"shape[{k}]", 2, _MOST_SAMPLES) for k in range(2))
    return rows, columns


def _check_samples(number: float, name: str, given: str) -> None:
    if number > _MOST_SAMPLES:
        check.refuse(name, f"A grid must have at most {_MOST_SAMPLES} samples.", f"{given}, hence {number:g}")
