"""Depth maps and point clouds as people have them: images, numpy's archives, text, PLY.

Examples
--------
>>> import tempfile
>>> with tempfile.TemporaryDirectory() as folder:
...     np.save(f"{folder}/depth.npy", np.ones((6, 8)))
...     read_cloud(f"{folder}/depth.npy")
Cloud(48 of 48 data, depth, 8 x 6 pixels)
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.io.archives import ARCHIVES, read_arrays
from mexpress.io.images import read_image
from mexpress.io.matches import WEIGHT_ARRAY, WEIGHT_COLUMN, named_weights
from mexpress.io.missing import Missing
from mexpress.io.ply import read_vertices
from mexpress.io.sources import Source, is_frame, read_table, where
from mexpress.io.tables import UVXYZ, XYZ, ArrayTable, Table, choose, complete

_IMAGES = {".png", ".tif", ".tiff", ".pgm"}
_UNITS_PER_METRE = 1000.0
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


class _Map(NamedTuple):
    """A depth map, of whole numbers or not, and what its numbers mean."""

    raw: NDArray[Any]
    scale: float
    intrinsics: tuple[float, float, float, float] | None = None
    weights: Floats | None = None

    @property
    def total(self) -> int:
        return self.raw.size

    @property
    def image_size(self) -> tuple[float, float]:
        return self.raw.shape[1], self.raw.shape[0]

    def valid(self) -> Integers:
        raw = self.raw.ravel()
        known = np.isfinite(raw) & ((raw != 0) | (raw.dtype.kind == "f" and self.intrinsics is None))
        return np.flatnonzero(known & _have_weight(self.weights))

    def data(self, chosen: Integers) -> tuple[Floats, Floats]:
        row, column = np.divmod(chosen, self.raw.shape[1])
        points = np.column_stack([column, row]).astype(np.float64)
        with np.errstate(over="ignore"):
            depth = self.raw.ravel()[chosen].astype(np.float64) / self.scale
            if self.intrinsics is None:
                return points, depth
            fx, fy, cx, cy = self.intrinsics
            return points, np.column_stack([(column - cx) / fx * depth, (row - cy) / fy * depth, depth])


class _Points(NamedTuple):
    """Points of the domain and their values, not finite where missing."""

    points: Floats
    values: Floats
    image_size: None = None
    weights: Floats | None = None

    @property
    def total(self) -> int:
        return len(self.points)

    def valid(self) -> Integers:
        known = np.isfinite(np.column_stack([self.points, self.values])).all(axis=1)
        return np.flatnonzero(known & _have_weight(self.weights))

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
    path : path or frame
        The ending tells what it is.

        * `.png`, `.tif`, `.tiff`, `.pgm`: a depth map, a number per pixel.
        * `.npy`: an array with 3 to 5 columns, or with at most 10 and four times as many rows, is a table of points,
          like one with fields; another 2-D array, from 6 x 6 on, is a depth map.
        * `.npz`: arrays `points` (n, 2) and `values`, (n,) or (n, d), or `uv` and `points3d`; or a depth map
          called `depth`; or one array as in `.npy`, called `points` if there are others besides single numbers.
        * `.ply`: the vertices' x y z, whatever else there is.
        * `.parquet`, frames of pandas and polars, and any other ending, which is text: a table, a datum per row, as
          `mexpress.io.matches.read_matches` reads it.

        A table has columns x y z or u v x y z if its header names them, in any order and among others; for x y, also
        u v, lon lat, easting northing or col row, and for z depth, height, elevation or value. Without such names three
        columns are x y z, and so are the first three of more in an `.xyz`; others need `columns`, since six may be
        x y z with a colour or a normal, or u v x y z with a weight.

        A depth map gives data at its pixels, x the column and y the row, from 0; x y z is a depth z at x, y;
        u v x y z is a point of space for each point of the domain.

        Missing are NaN and infinite numbers, and 0 in a depth map of whole numbers. In one of floats 0 is a
        value, since NaN can say that there is none (``np.where(depth == 0, np.nan, depth)``), unless there are
        intrinsics: no camera sees a point at its own centre.
    scale : float, optional
        Units of a depth map's numbers per metre, or per the unit that is wanted: 5000 for the TUM sets. By
        default 1000 for images of whole numbers, which mostly have millimetres, otherwise 1.
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
        Numbers that mean no data, besides those that are not finite and cells that are empty or NA.

    Returns
    -------
    Cloud
        Four data or more.

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
    source = _calibrated(_read(path, told), scale, camera, where(path))
    valid = source.valid()
    if len(valid) < _FEWEST:
        rule = f"It must have {_FEWEST} data or more that are not missing."
        check.refuse("cloud", rule, f"{len(valid)} of {source.total} in {where(path)}")
    chosen = valid
    if most is not None and most < len(valid):
        chosen = np.sort(random.choice(valid, most, replace=False, shuffle=False))
    shares = None if source.weights is None else source.weights[chosen]
    return Cloud(*source.data(chosen), source.image_size, len(valid), source.total - len(valid), shares)


def _calibrated(
    source: _Map | _Points,
    scale: float | None,
    intrinsics: tuple[float, float, float, float] | None,
    place: str,
) -> _Map | _Points:
    if isinstance(source, _Map):
        return source._replace(scale=scale or source.scale, intrinsics=intrinsics)
    for name, value in (("scale", scale), ("intrinsics", intrinsics)):
        if value is not None:
            check.refuse(name, "It belongs to a depth map.", f"{value} for the points in {place}")
    return source


def _read(path: Source, told: _Told) -> _Map | _Points:
    source, weights = _with_weights(path, told)
    named_weights(weights, told.weights, where(path))
    if weights is None:
        return source
    rule = "There must be a weight for every datum."
    shares = check.real(weights, "weights")
    if shares.size != source.total or (shares.ndim > 1 and source.image_size != shares.shape[::-1]):
        check.refuse("weights", rule, f"shape {shares.shape} in {where(path)}")
    return source._replace(weights=shares.ravel())


def _with_weights(source: Source, told: _Told) -> tuple[_Map | _Points, Any]:
    """Read data, and their weights, or None if the file does not have the column."""
    ending = "" if is_frame(source) else Path(source).suffix.lower()
    if ending in _IMAGES:
        path = _without_columns(source, told)
        return _depth_map(read_image(path, "cloud"), path, _UNITS_PER_METRE), None
    if ending == ".ply":
        path = _without_columns(source, told)
        table, weights = _read_ply(path, str(told.weights or WEIGHT_COLUMN))
        return _Points(table[:, :2], table[:, 2]), weights
    if ending in ARCHIVES:
        arrays = read_arrays(Path(source), "cloud")
        weights = arrays.pop(str(told.weights or WEIGHT_ARRAY), None)
        points, shares = _from_archive(arrays, Path(source), told)
        return points, shares if weights is None else weights
    return _from_table(read_table(source, "cloud"), told, first=ending == ".xyz")


def _without_columns(source: Source, told: _Told) -> Path:
    if told.columns is not None:
        check.refuse("columns", "They belong to a table.", f"{told.columns} for {where(source)}")
    return Path(source)


def _from_table(table: Table, told: _Told, *, first: bool = False, more: str = "") -> tuple[_Points, Any]:
    weight = WEIGHT_COLUMN if told.weights is None else told.weights
    choice = choose(table, [UVXYZ, XYZ], told.columns, weight, first=first, more=more)
    numbers, _ = complete(table, choice.all, Missing(told.missing.values, keep=True))
    d = len(choice.columns)
    points = _Points(numbers[:, :2], numbers[:, 2] if d == 3 else numbers[:, 2:d])
    return points, None if choice.weight is None else numbers[:, d]


def _have_weight(weights: Floats | None) -> NDArray[np.bool_] | bool:
    return True if weights is None else np.isfinite(weights)


def _depth_map(raw: NDArray[Any], path: Path, units: float = 1.0) -> _Map:
    rule = "A depth map must have rows and columns, with a real number at each pixel."
    raw = check.array(raw, "cloud", rule, "iuf")
    if raw.ndim != 2:
        check.refuse("cloud", rule, f"shape {raw.shape} in {path.name}")
    return _Map(raw, 1.0 if raw.dtype.kind == "f" else units)


def _from_archive(arrays: dict[str, NDArray[Any]], path: Path, told: _Told) -> tuple[_Map | _Points, Any]:
    if arrays.keys() & {"depth", "values", "points3d"}:
        _without_columns(path, told)
    for points, values in _PAIRS:
        if {points, values} <= arrays.keys():
            return _pair(arrays[points], arrays[values], points, values), None
    if "depth" in arrays:
        return _depth_map(arrays["depth"], path), None
    if "points" in arrays:
        return _from_table(ArrayTable.of(arrays["points"], path.name, "cloud"), told)
    several = [array for array in arrays.values() if array.ndim > 0]
    if len(several) != 1:
        rule = "An archive must hold points and values, depth, or one array of x y z or u v x y z."
        there = ", ".join(f"{key} {arrays[key].shape}" for key in arrays) or "no arrays"
        check.refuse("cloud", rule, f"{there} in {path.name}")
    (array,) = several
    if told.columns is None and not _is_table(array):
        return _depth_map(array, path), None
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


def _read_ply(path: Path, weight: str) -> tuple[Floats, Any]:
    vertices = read_vertices(path, "cloud")
    if not set("xyz") <= vertices.keys():
        rule, there = "A PLY file must have vertices with numbers x, y and z.", ", ".join(vertices) or "no vertices"
        check.refuse("cloud", rule, f"{there} in {path.name}")
    return np.column_stack([check.real(vertices[name], name) for name in "xyz"]), vertices.get(weight)
