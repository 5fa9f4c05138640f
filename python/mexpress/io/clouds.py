"""Depth maps and point clouds as people have them: images, numpy's archives, text, PLY, OBJ.

Examples
--------
>>> import tempfile
>>> with tempfile.TemporaryDirectory() as folder:
...     np.save(f"{folder}/depth.npy", np.ones((6, 8)))
...     read_cloud(f"{folder}/depth.npy")
Cloud(48 of 48 data, depth, 8 x 6 pixels)
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.io.archives import ARCHIVES, read_data
from mexpress.io.depth import DepthMap, depth_of_array, depth_of_raster
from mexpress.io.grids import is_grid
from mexpress.io.images import read_raster
from mexpress.io.labelled import is_labelled, read_labelled
from mexpress.io.landmarks import out_of_use
from mexpress.io.matches import WEIGHT_ARRAY, WEIGHT_COLUMN, named_weights
from mexpress.io.missing import Missing
from mexpress.io.obj import read_obj_vertices
from mexpress.io.placeholders import note_placeholders
from mexpress.io.ply import read_vertices
from mexpress.io.sources import Source, expect_source, is_frame, read_table, where
from mexpress.io.tables import UVXYZ, XYZ, ArrayTable, Table, choose, complete

_IMAGES = {".png", ".tif", ".tiff", ".pgm", ".pnm", ".ppm", ".pfm"}
_PAIRS = (("points", "values"), ("uv", "points3d"))
_SMALLEST_MAP, _WIDEST_TABLE, _NARROW = 6, 10, 4
"""Arrays with fewer rows or columns, or with at most so many columns and so many times more rows, are tables of points;
depth maps of such a shape must be called so."""

_FEWEST = 4


@dataclass(frozen=True, eq=False, repr=False)
class Cloud:
    """Data that a surface can be fitted to.

    Parameters
    ----------
    points : array_like, (n, 2)
        Where the data are in the domain: pixels (column, row) of a depth map, else x, y or u, v.
    values : array_like, (n,) or (n, d)
        Depths, or points that the surface passes by.
    image_size : (width, height) or None
        Of the depth map in pixels.
    n_valid : int
        Number of data in the file, of which these are all or a sample.
    n_missing : int
        Number of pixels or points in the file that had no measurement.
    weights : (n,) array or None
        Weights of the data, if there are some.
    unit : str or None
        What the values are in, if the file or a scale tells: "m".
    axes : (str, str) or None
        What x and y are called where they come from, such as ("lon", "lat"), if they have names.

    Raises
    ------
    ValueError, TypeError
        If the shapes do not fit, or an entry is not finite.

    Examples
    --------
    >>> Cloud([[0, 0], [1, 0], [0, 1], [1, 1]], [1.0, 2.0, 3.0, 4.0], None, 100)
    Cloud(4 of 100 data, depth)
    """

    points: Floats
    values: Floats
    image_size: tuple[float, float] | None
    n_valid: int
    n_missing: int = 0
    weights: Floats | None = None
    unit: str | None = None
    axes: tuple[str, str] | None = None

    def __post_init__(self) -> None:
        points = check.points(self.points, "points")
        checked = {
            "points": points,
            "values": check.columns(self.values, "values", len(points)),
            "image_size": check.image_size(self.image_size),
            "n_valid": check.count(self.n_valid, "n_valid", len(points)),
            "n_missing": check.count(self.n_missing, "n_missing", 0),
            "weights": None if self.weights is None else _checked_weights(self.weights, len(points)),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        kind = "depth" if self.values.ndim == 1 else f"values in R^{self.values.shape[1]}"
        size = "" if self.image_size is None else ", {:.0f} x {:.0f} pixels".format(*self.image_size)
        return f"Cloud({len(self.points)} of {self.n_valid} data, {kind}{size})"


def _checked_weights(weights: ArrayLike, n: int) -> Floats:
    checked = check.finite(check.real(weights, "weights"), "weights")
    if checked.shape != (n,):
        check.refuse("weights", f"They must be {n} numbers, one for each datum.", f"shape {checked.shape}")
    return checked


class _Points(NamedTuple):
    """Points of the domain and their values, not finite where missing."""

    points: Floats
    values: Floats
    missing: Missing = Missing()
    image_size: None = None
    unit: str | None = None
    weights: Floats | None = None
    axes: tuple[str, str] | None = None

    @property
    def total(self) -> int:
        return len(self.points)

    def valid(self) -> Integers:
        absent = self.missing.marks(self.values)
        known = np.isfinite(self.points).all(axis=1) & ~(absent if absent.ndim == 1 else absent.any(axis=1))
        return np.flatnonzero(known & _have_weight(self.weights))

    def numbers(self, chosen: Integers) -> Floats:
        return self.values[chosen]

    def data(self, chosen: Integers) -> tuple[Floats, Floats]:
        return self.points[chosen], self.values[chosen]


class _Told(NamedTuple):
    """What the caller tells of a table: the names or numbers of its columns and of the weights, what means no data."""

    columns: Sequence[str | int] | None
    weights: str | int | None
    missing: Missing


def read_cloud(
    path: Source,
    scale: float | None = None,
    intrinsics: Sequence[float] | None = None,
    max_data: int | None = 10_000,
    seed: int | np.random.Generator | None = 0,
    weights: str | int | None = None,
    *,
    columns: Sequence[str | int] | None = None,
    missing: Any = None,
) -> Cloud:
    """Read a depth map or a point cloud.

    Parameters
    ----------
    path : path, frame or DataArray
        The ending tells what it is.

        * `.png`, `.tif`, `.tiff`, `.pgm`, `.pnm`, `.pfm`, and `.asc` if it is ESRI's grid: a depth map, a number per
          pixel, as it stands in the file, or as the scale and the offset of GDAL's metadata in a TIFF say. Its rows are
          numbered from the top, wherever on earth they are, after the image is turned as EXIF data and TIFF tags say.
        * `.npy`: an array with 3 to 5 columns, or with at most 10 and four times as many rows, is a table of points,
          like one with fields; another 2-D array, from 6 x 6 on, is a depth map.
        * `.npz`: arrays `points` (n, 2) and `values`, (n,) or (n, d), or `uv` and `points3d`; or a depth map
          called `depth`; or one array as in `.npy`, called `points` if there are others besides single numbers.
        * `.ply`, `.obj`: the vertices' x y z, whatever else there is.
        * A DataArray of xarray with two dimensions: its coordinates are x and y, and its attribute `units` is the unit.
        * `.parquet`, frames of pandas and polars, and any other ending, which is text: a table, a datum per row, as
          `mexpress.io.matches.read_matches` reads it.

        A table has columns x y z or u v x y z if its header names them, in any order and among others; for x y, also
        u v, lon lat, easting northing or col row, and for z depth, height, elevation or value. Without such names three
        columns are x y z, and so are the first three of more in an `.xyz`; others need `columns`, since six may be
        x y z with a colour or a normal, or u v x y z with a weight.

        A depth map gives data at its pixels, x the column and y the row, from 0; x y z is a depth z at x, y;
        u v x y z is a point of space for each point of the domain.

        Missing are NaN and infinite numbers, what the file itself says means no data (GeoTIFF's tag 42113, NODATA_value
        of ESRI's grids), and 0 in a depth map of whole numbers; not, however, in images whose numbers have a sign,
        which have a place on earth or a scale, or which say what means no data. In one of floats 0 is a value, since
        NaN can say that there is none, unless there are intrinsics: no camera sees a point at its own centre.
    scale : float, optional
        Units of a depth map's numbers per metre, or per the unit that is wanted: 5000 for the TUM sets. By
        default 1000 for images of whole numbers, which mostly have millimetres, unless they have a sign, a place on
        earth, or a scale of the file's own, which comes first; otherwise 1.
    intrinsics : (fx, fy, cx, cy), optional
        Focal lengths and principal point, in pixels, of the camera that took the depth map. The values are
        then the (n, 3) points of space in the camera's frame; the domain is still the image.
    max_data : int or None
        Largest number of data; of more, so many are drawn, all alike likely, and kept in their order. None
        keeps all.
    seed : int, Generator or None
        Of the draw: the same number gives the same data, None fresh ones.
    weights : str, optional
        Name of the weights: a column that the first line of a text names, an array in an `.npz`, as large as the depth
        map or (n,), or a property of a `.ply`'s vertices. By default they are called `weight`, and `weights` in an
        `.npz`, and a file need not have any. Data whose weight is NaN or infinite are missing. In a table also the
        number of the column, from 1.
    columns : sequence of str or int, optional
        The columns x y z or u v x y z of a table, by name or by number from 1.
    missing : float, or sequence of float, optional
        Numbers that mean no data, as they stand in the file, besides all that are missing anyway and cells that are
        empty or NA.

    Returns
    -------
    Cloud
        Four data or more. A `UserWarning` says if numbers were taken for millimetres without being told, and if one
        constant lies so far outside of all other values that it seems to mean no data.

    Raises
    ------
    ValueError, TypeError
        If the file is damaged or no such data, fewer than four are valid, or an option is wrong.
    ImportError
        If the file needs an extra that is not installed.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     depth = np.full((6, 8), 2000, np.uint16)
    ...     depth[0] = 0
    ...     np.savez(f"{folder}/scan.npz", depth=depth)
    ...     cloud = read_cloud(f"{folder}/scan.npz", scale=1000, intrinsics=(4, 4, 3.5, 2.5), max_data=30)
    >>> cloud, cloud.n_missing
    (Cloud(30 of 40 data, values in R^3, 8 x 6 pixels), 8)
    >>> cloud.points[:1], cloud.values[:1]
    (array([[0., 1.]]), array([[-1.75, -0.75,  2.  ]]))
    """
    told = _Told(columns, weights, Missing.of(missing))
    scale = None if scale is None else check.positive(scale, "scale")
    camera = check.intrinsics(intrinsics)
    most = None if max_data is None else check.count(max_data, "max_data", _FEWEST)
    random = check.generator(seed)
    source = _calibrated(_read(path, told), scale, camera, told.missing, where(path))
    valid = source.valid()
    if len(valid) < _FEWEST:
        rule = f"It must have {_FEWEST} data or more that are not missing."
        given = f"{len(valid)} of {source.total}" if source.total else "no rows"
        check.refuse("cloud", rule, f"{given} in {where(path)}")
    chosen = valid
    if most is not None and most < len(valid):
        chosen = np.sort(random.choice(valid, most, replace=False, shuffle=False))
    shares = None if source.weights is None else source.weights[chosen]
    n_missing = source.total - len(valid)
    axes = None if isinstance(source, DepthMap) else source.axes
    cloud = Cloud(*source.data(chosen), source.image_size, len(valid), n_missing, shares, source.unit, axes)
    for note in _guesses(source, valid, scale, where(path)):
        warnings.warn(note, stacklevel=2)
    return cloud


def _guesses(source: DepthMap | _Points, valid: Integers, scale: float | None, place: str) -> list[str]:
    """Return what the numbers were taken for, or seem to be, without being told."""
    notes = note_placeholders(source.numbers(valid), place)
    if scale is not None or source.unit is None or not isinstance(source, DepthMap):
        return notes
    return [
        f"{place} has whole numbers in a unit that it does not say: they were taken for millimetres, and divided "
        "by 1000. If that is right, say scale=1000; scale=1 keeps them.",
        *notes,
    ]


def _calibrated(
    source: DepthMap | _Points,
    scale: float | None,
    intrinsics: tuple[float, float, float, float] | None,
    absent: Missing,
    place: str,
) -> DepthMap | _Points:
    if isinstance(source, DepthMap):
        told = source if scale is None else source._replace(scale=scale, unit="m")
        every = Missing(source.missing.values + absent.values)
        return told._replace(missing=every, intrinsics=intrinsics)
    for name, value in (("scale", scale), ("intrinsics", intrinsics)):
        if value is not None:
            check.refuse(name, "It belongs to a depth map.", f"{value} for the points in {place}")
    return source._replace(missing=absent)


def _read(path: Source, told: _Told) -> DepthMap | _Points:
    if is_labelled(path):
        return _from_labelled(path, told)
    expect_source(path, "cloud")
    source, weights = _with_weights(path, told)
    named_weights(weights, told.weights, where(path))
    if weights is None:
        return source
    rule = "There must be a weight for every datum."
    shares = check.real(weights, "weights")
    if shares.size != source.total or (shares.ndim > 1 and source.image_size != shares.shape[::-1]):
        check.refuse("weights", rule, f"shape {shares.shape} in {where(path)}")
    return source._replace(weights=shares.ravel())


def _with_weights(source: Source, told: _Told) -> tuple[DepthMap | _Points, Any]:
    """Read data, and their weights, or None if the file does not have the column."""
    ending = "" if is_frame(source) else Path(source).suffix.lower()
    if ending in _IMAGES or (ending == ".asc" and is_grid(Path(source).read_bytes())):
        path = _without_columns(source, told)
        return depth_of_raster(read_raster(path, "cloud"), path.name), None
    if ending == ".ply":
        path = _without_columns(source, told)
        table, weights = _read_ply(path, str(told.weights or WEIGHT_COLUMN))
        return _Points(table[:, :2], table[:, 2]), weights
    if ending == ".obj":
        return _read_obj(_without_columns(source, told)), None
    if ending in ARCHIVES:
        arrays = read_data(Path(source), "cloud")
        weights = arrays.pop(str(told.weights or WEIGHT_ARRAY), None)
        points, shares = _from_archive(arrays, Path(source), told)
        return points, shares if weights is None else weights
    return _from_table(read_table(source, "cloud"), told, first=ending == ".xyz")


def _from_labelled(array: Any, told: _Told) -> _Points:
    for name, value in (("columns", told.columns), ("weights", told.weights)):
        if value is not None:
            check.refuse(name, "They belong to a file or a frame.", f"{value!r} for a DataArray")
    points, values, unit, axes = read_labelled(array)
    return _Points(points, values, unit=unit, axes=axes)


def _without_columns(source: Source, told: _Told) -> Path:
    if told.columns is not None:
        check.refuse("columns", "They belong to a table.", f"{told.columns} for {where(source)}")
    return Path(source)


def _from_table(table: Table, told: _Told, *, first: bool = False, more: str = "") -> tuple[_Points, Any]:
    weight = WEIGHT_COLUMN if told.weights is None else told.weights
    choice = choose(table, [UVXYZ, XYZ], told.columns, weight, first=first, more=more)
    numbers, _ = complete(table, choice.all, Missing(told.missing.values, keep=True), out_of_use(table))
    d = len(choice.columns)
    axes = (table.names[choice.columns[0]], table.names[choice.columns[1]]) if table.names else None
    points = _Points(numbers[:, :2], numbers[:, 2] if d == 3 else numbers[:, 2:d], axes=axes)
    return points, None if choice.weight is None else numbers[:, d]


def _have_weight(weights: Floats | None) -> NDArray[np.bool_] | bool:
    return True if weights is None else np.isfinite(weights)


def _from_archive(arrays: dict[str, NDArray[Any]], path: Path, told: _Told) -> tuple[DepthMap | _Points, Any]:
    if arrays.keys() & {"depth", "values", "points3d"}:
        _without_columns(path, told)
    for points, values in _PAIRS:
        if {points, values} <= arrays.keys():
            return _pair(arrays[points], arrays[values], points, values), None
    if "depth" in arrays:
        return depth_of_array(arrays["depth"], path.name), None
    if "points" in arrays:
        return _from_table(ArrayTable.of(arrays["points"], path.name, "cloud"), told)
    several = [array for array in arrays.values() if array.ndim > 0]
    if len(several) != 1:
        rule = "An archive must hold points and values, depth, or one array of x y z or u v x y z."
        there = ", ".join(f"{key} {arrays[key].shape}" for key in arrays) or "no arrays"
        check.refuse("cloud", rule, f"{there} in {path.name}")
    (array,) = several
    if told.columns is None and not _is_table(array):
        return depth_of_array(array, path.name), None
    more = " A depth map of this shape must be called depth, in an .npz."
    return _from_table(ArrayTable.of(array, path.name, "cloud"), told, more=more)


def _is_table(array: NDArray[Any]) -> bool:
    if array.ndim != 2:
        return bool(array.dtype.names)
    rows, columns = map(int, array.shape)
    return min(rows, columns) < _SMALLEST_MAP or (columns <= _WIDEST_TABLE and rows >= _NARROW * columns)


def _pair(points: NDArray[Any], values: NDArray[Any], points_name: str, values_name: str) -> _Points:
    points, values = check.real(points, points_name), check.real(values, values_name)
    if points.ndim != 2 or points.shape[1] != 2:
        check.refuse(points_name, "It must be points of shape (n, 2).", f"shape {points.shape}")
    if values.ndim not in (1, 2) or len(values) != len(points) or 0 in values.shape[1:]:
        rule = f"It must have shape ({len(points)},) or ({len(points)}, d)."
        check.refuse(values_name, rule, f"shape {values.shape}")
    return _Points(points, values)


def _read_obj(path: Path) -> _Points:
    try:
        vertices = read_obj_vertices(path.read_bytes())
    except ValueError as error:
        check.refuse("cloud", "It must be an OBJ file.", f"{path.name}: {error}")
    return _Points(vertices[:, :2], vertices[:, 2])


def _read_ply(path: Path, weight: str) -> tuple[Floats, Any]:
    vertices = read_vertices(path, "cloud")
    if not set("xyz") <= vertices.keys():
        rule = "A PLY file must have vertices with numbers x, y and z."
        check.refuse("cloud", rule, f"{', '.join(vertices) or 'no vertices'} in {path.name}")
    return np.column_stack([check.real(vertices[name], name) for name in "xyz"]), vertices.get(weight)
