"""Arrays whose dimensions have names and coordinates, as xarray has them: which dimension is x, and which is y.

Examples
--------
>>> import xarray as xr
>>> plane_of(xr.DataArray(np.zeros((2, 3)), dims=["lon", "lat"]), "cloud")
Plane(y='lat', x='lon')
"""

from __future__ import annotations

from collections.abc import Hashable
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.extras import required
from mexpress.geometry import grid_points
from mexpress.io.tables import AXES, plain

_X = {"X", "projection_x_coordinate", "longitude", "degrees_east", *(across for across, _ in AXES)}
_Y = {"Y", "projection_y_coordinate", "latitude", "degrees_north", *(up for _, up in AXES)}
"""What attributes of the CF conventions, and names, say of the two axes."""


class Plane(NamedTuple):
    """The dimensions along y and along x."""

    y: Hashable
    x: Hashable


def import_xarray() -> ModuleType:
    """Return xarray.

    Raises
    ------
    ImportError
        If it is not installed; the message names the extra.

    Examples
    --------
    >>> import_xarray().__name__
    'xarray'
    """
    return required("xarray", "A Dataset needs xarray", "xarray")


def is_labelled(source: Any) -> bool:
    """Whether this is a DataArray or a Dataset.

    Examples
    --------
    >>> is_labelled(np.zeros((2, 3)))
    False
    """
    return hasattr(source, "dims") and hasattr(source, "coords") and hasattr(source, "sizes")


def plane_of(array: Any, name: str) -> Plane:
    """Return which dimensions are y and x: by their attributes or names, else the only two, y first.

    Parameters
    ----------
    array : DataArray or Dataset
        Of xarray.
    name : str
        What messages call it.

    Raises
    ------
    ValueError
        If neither says it.
    """
    across = [dim for dim in array.sizes if _words(array, dim) & _X]
    up = [dim for dim in array.sizes if _words(array, dim) & _Y]
    if (len(across), len(up)) == (1, 1):
        return Plane(up[0], across[0])
    if len(array.sizes) != 2 or across or up:
        rule = "It must have one dimension along x and one along y, called so or such as lon and lat."
        check.refuse(name, rule, f"dimensions {', '.join(map(str, array.sizes)) or 'none'}")
    return Plane(*array.sizes)


def coordinates(array: Any, dim: Hashable) -> Floats:
    """Return the coordinates along a dimension, (k,): those of pixels, from 0, if there are none.

    Raises
    ------
    ValueError, TypeError
        If they are not finite numbers.

    Examples
    --------
    >>> import xarray as xr
    >>> coordinates(xr.DataArray(np.zeros((2, 3)), dims=["y", "x"]), "x")
    array([0., 1., 2.])
    """
    return check.finite(check.real(array[dim].values, str(dim)), str(dim))


def axis_names(array: Any, plane: Plane) -> tuple[str, str]:
    """Return what x and y are called: longitude and latitude, if attributes say it, else their dimensions' names.

    Examples
    --------
    >>> import xarray as xr
    >>> axis_names(xr.DataArray([[1.0]], dims=["y", "x"]), Plane("y", "x"))
    ('x', 'y')
    """
    x, y = _words(array, plane.x), _words(array, plane.y)
    if x & {"longitude", "degrees_east"} and y & {"latitude", "degrees_north"}:
        return "longitude", "latitude"
    return str(plane.x), str(plane.y)


def _words(array: Any, dim: Hashable) -> set[str]:
    """What is said of a dimension."""
    attributes = array[dim].attrs
    said = {str(attributes[key]) for key in ("axis", "standard_name", "units") if key in attributes}
    return said | {plain(str(dim))}


def read_labelled(array: Any) -> tuple[Floats, Floats, str | None, tuple[str, str]]:
    """Return the points and values of a DataArray, (n, 2) and (n,), their unit, and what x and y are called.

    Parameters
    ----------
    array : DataArray
        Of two dimensions besides those of length one. Its attribute `_FillValue` means no data, which is NaN here.

    Raises
    ------
    ValueError, TypeError
        If it is none of numbers, or its dimensions are not x and y.

    Examples
    --------
    >>> import xarray as xr
    >>> points, values, unit, axes = read_labelled(xr.DataArray([[1, 2]], {"lat": [5], "lon": [7, 8]}))
    >>> points.tolist(), values.tolist(), unit, axes
    ([[7.0, 5.0], [8.0, 5.0]], [1.0, 2.0], None, ('lon', 'lat'))
    """
    if not hasattr(array, "dtype"):
        names = ", ".join(map(str, array.data_vars)) or "no variables"
        check.refuse("cloud", 'It must be one variable, dataset["name"] of a Dataset.', names)
    extra = [dim for dim, size in array.sizes.items() if size == 1][: max(array.ndim - 2, 0)]
    sheet = array.isel(dict.fromkeys(extra, 0))
    plane = plane_of(sheet, "cloud")
    if sheet.ndim != 2:
        rule = "It must have two dimensions besides those of length one: isel takes one of several layers."
        check.refuse("cloud", rule, f"dimensions {', '.join(map(str, array.dims))}")
    values = check.real(sheet.transpose(*plane).values, "cloud")
    values = np.where(values == array.attrs.get("_FillValue", np.nan), np.nan, values)
    y, x = (coordinates(sheet, dim) for dim in plane)
    points = grid_points(x, y)
    unit = array.attrs.get("units")
    return points, values.ravel(), None if unit is None else str(unit), axis_names(sheet, plane)
