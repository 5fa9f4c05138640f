"""Surfaces: smooth functions, fitted to depths or to points in space, over a region of the plane."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress import notebook
from mexpress._validation import Floats, Integers
from mexpress.caching import cached_property
from mexpress.geometry import Region, area, grid_points, inside
from mexpress.io import meshes
from mexpress.io.labelled import import_xarray
from mexpress.models.base import nearest_constant, row_by_row
from mexpress.models.design import CardinalBasis, Design, linear_design
from mexpress.models.expectation import EXTRAPOLATE, NAN, FittedModel, check_outside
from mexpress.models.observations import Observations
from mexpress.models.sampling import Box, Sheet, like_another, named, names_of, regular, unit_of

if TYPE_CHECKING:
    import xarray as xr

_ERROR = "error"
"""What the error to expect is called in a Dataset."""

_FROM_A_SIDE = np.array([[0.87, 0.29], [0.5, -0.5], [0.0, -0.82]])
"""Where x, y and z are in a picture, to the right and down, seen from 35 degrees above."""

_RELIEF = 0.3
"""Range of depths in a small picture, as a fraction of the domain's longer side."""


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceGrid:
    """A surface sampled on a regular grid inside its domain.

    Attributes
    ----------
    x : ndarray, (columns,)
        Positions along x, increasing.
    y : ndarray, (rows,)
        Positions along y, increasing.
    values : ndarray, (rows, columns) or (rows, columns, d)
        The surface at every sample; NaN outside the domain.
    inside : ndarray of bool, (rows, columns)
        True for samples inside the domain or on its edge.
    triangles : ndarray of int, (t, 3)
        Triangles inside the domain, counter-clockwise; sample (row, column) has index row * columns + column.
    surface : Surface
        The surface that is sampled.

    Examples
    --------
    >>> import mexpress as mx
    >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
    >>> grid = mx.fit_surface(square, [0, 2, 2, 4], square).grid(step=1)
    >>> grid
    SurfaceGrid(3 x 3, 9 inside, 8 triangles)
    >>> grid.values.round(6) + 0.0
    array([[0., 1., 2.],
           [1., 2., 3.],
           [2., 3., 4.]])
    >>> grid.points[:4]
    array([[0., 0.], [1., 0.], [2., 0.], [0., 1.]])
    """

    x: Floats
    y: Floats
    values: Floats
    inside: NDArray[np.bool_]
    triangles: Integers
    surface: Surface

    def __repr__(self) -> str:
        rows, columns = self.inside.shape
        return f"SurfaceGrid({rows} x {columns}, {self.inside.sum()} inside, {len(self.triangles)} triangles)"

    @property
    def points(self) -> Floats:
        """Positions of all samples, row after row, (rows * columns, 2)."""
        return grid_points(self.x, self.y)

    @cached_property
    def error(self) -> Floats:
        """Error to expect at every sample, (rows, columns), see `Surface.error`; NaN outside the domain.

        The values of depths with 1.96 times the error to either side are a band for measurements.

        Raises
        ------
        ValueError
            If the surface has no data.

        Examples
        --------
        >>> import mexpress as mx
        >>> points = np.random.default_rng(0).uniform(0, 6, (300, 2))
        >>> grid = mx.fit_surface(points, np.sin(points[:, 0]), points[:50]).grid()
        >>> band = grid.values - 1.96 * grid.error, grid.values + 1.96 * grid.error
        >>> truth = np.sin(grid.x)
        >>> bool(np.mean((band[0] < truth) & (truth < band[1]), where=grid.inside) > 0.9)
        True
        """
        return self.surface._over(self.surface.error, self.x, self.y, self.inside)


@dataclass(frozen=True, eq=False, repr=False)
class Surface(FittedModel):
    """A smooth map from points of the plane to depths, or to points in space.

    Value a at a point q is nu(q) . p_a, with the lifting nu and column p_a of the parameters.

    Parameters
    ----------
    lifting : Lifting
        A lifting with l control points.
    parameters : array_like, (l,) or (l, d)
        With most liftings, the values at the control points. With (l,) the surface has values (k,), with (l, d)
        values (k, d).
    domain : array_like, (k, 2), or Region
        Points of the fit, or the region that they cover. The surface keeps their convex hull and extrapolates outside
        it.
    smoothing : float
        Weight of the bending energy in its fit.
    data : Observations, optional
        The data of its fit, for `error`, `covers` and `interval`.

    Raises
    ------
    TypeError
        If the lifting is not a `Lifting`.
    ValueError
        If the shapes do not fit, a number is not finite, or the domain has no area.

    Examples
    --------
    >>> import mexpress as mx
    >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
    >>> surface = mx.fit_surface(square, [[0, 0, 1], [3, 0, 1], [0, 3, 1], [3, 3, 2]], square)
    >>> surface
    Surface(3 values, tps, 4 control points)
    >>> surface([[1, 1]]).round(6)
    array([[1.5 , 1.5 , 1.25]])
    >>> surface.normals([[1, 1]]).round(3)
    array([[-0.162, -0.162,  0.973]])
    """

    kind: ClassVar[str] = "surface"

    def _checked_parameters(self) -> Floats:
        return check.columns(self.parameters, "parameters", len(self.control_points), check.LARGEST_PARAMETER)

    def __repr__(self) -> str:
        what = "depth" if self._dimension == 1 else f"{self._dimension} values"
        return f"Surface({what}, {self._description()})"

    def _form(self) -> str:
        return "a depth" if self._dimension == 1 else f"{self._dimension} values at every point"

    def _picture(self) -> str:
        """The surface in space, seen from above and from a side; nothing if it has no place there."""
        if self._dimension not in {1, 3}:
            return ""
        lines = self._lines()
        solid = [self(line, outside="nan").reshape(len(line), -1) for line in lines]
        if self._dimension == 1:
            heights = np.vstack(solid)
            heights = heights[np.isfinite(heights)]
            # A flat surface is flat, whatever rounding makes of it.
            size = max(np.ptp(heights), 1e-9 * np.abs(heights).max()) if heights.size else 0.0
            steep = _RELIEF * np.ptp(self.domain, axis=0).max() / (size or 1.0)
            solid = [np.hstack([line, steep * height]) for line, height in zip(lines, solid, strict=True)]
        seen = [line @ _FROM_A_SIDE for line in solid]
        return notebook.wires("the surface", [[(float(x), float(y)) for x, y in line] for line in seen])

    def __call__(self, points: ArrayLike, *, outside: str = EXTRAPOLATE) -> Floats:
        """Return the surface's values.

        Parameters
        ----------
        points : array_like, (k, 2)
            Positions, in the unit of the control points.
        outside : {"extrapolate", "nan"}
            What to return outside the domain, the convex hull of the data.

        Returns
        -------
        ndarray, (k,) or (k, d)
            In the unit of the data's values; NaN where a position is not known: NaN, infinite or beyond 1e100.

        Examples
        --------
        >>> import mexpress as mx
        >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
        >>> mx.fit_surface(square, [0, 2, 2, 5], square)([[2, 2], [1, 1]]).round(6)
        array([5.  , 2.25])
        >>> mx.fit_surface(square, [0, 2, 2, 5], square)([[2, 2], [9, 9]], outside="nan").round(6)
        array([ 5., nan])
        """
        centre, about = self._centred
        queries = check.queries(points, "points")
        values = self._valued(queries, lambda known: centre + self.lifting.values(known, about), outside)
        return values.reshape(len(values), *self.parameters.shape[1:])

    def derivatives(self, points: ArrayLike) -> Floats:
        """Return the derivatives of the surface's values along x and y.

        Parameters
        ----------
        points : array_like, (k, 2)
            Positions, in the unit of the control points.

        Returns
        -------
        ndarray, (k, 2) or (k, d, 2)
            The last index is the axis, x or y. NaN where a position is not known.

        Examples
        --------
        >>> import mexpress as mx
        >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
        >>> mx.fit_surface(square, [0, 2, 4, 6], square).derivatives([[1, 1]]).round(6)
        array([[1., 2.]])
        """
        about = self._centred[1]
        values = row_by_row(check.queries(points, "points"), lambda known: self.lifting.slopes(known, about))
        return values.reshape(len(values), *self.parameters.shape[1:], 2)

    def normals(self, points: ArrayLike) -> Floats:
        """Return the unit normals of the surface in space.

        Parameters
        ----------
        points : array_like, (k, 2)
            Positions, in the unit of the control points.

        Returns
        -------
        ndarray, (k, 3)
            For a depth f: (-f_x, -f_y, 1), normalised. For points in space: f_x x f_y, normalised; NaN where
            f_x and f_y are parallel. NaN where a position is not known.

        Raises
        ------
        ValueError
            If the surface does not have one or three values.

        Examples
        --------
        >>> import mexpress as mx
        >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
        >>> mx.fit_surface(square, [0, 2, 0, 2], square).normals([[1, 1]]).round(3) + 0.0
        array([[-0.707,  0.   ,  0.707]])
        """
        self._check_space("have normals")
        derivatives = self.derivatives(points)
        if self._dimension == 1:
            slope = derivatives.reshape(-1, 2)
            return _unit(np.column_stack([-slope, np.ones(len(slope))]))
        return _unit(np.cross(_unit(derivatives[:, :, 0]), _unit(derivatives[:, :, 1])))

    def grid(self, step: float | None = None, shape: tuple[int, int] | None = None) -> SurfaceGrid:
        """Sample the surface on a regular grid inside its domain.

        The grid starts at the lower left corner of the domain's bounding box.

        Parameters
        ----------
        step : float, optional
            Distance of neighbouring samples, in the unit of the points; by default it gives about 10,000 samples
            inside.
        shape : tuple of int, optional
            Numbers of rows and columns that fill the bounding box, each 2 or more, instead of a step.

        Returns
        -------
        SurfaceGrid
            Positions, values and triangles.

        Raises
        ------
        ValueError
            If the grid has more than 10^7 samples, or both a step and a shape are given.

        Examples
        --------
        >>> import mexpress as mx
        >>> triangle = [[0, 0], [4, 0], [0, 4]]
        >>> grid = mx.fit_surface(triangle, [0, 4, 4], triangle).grid(step=2)
        >>> grid.values.round(6) + 0.0
        array([[ 0.,  2.,  4.],
               [ 2.,  4., nan],
               [ 4., nan, nan]])
        >>> grid.triangles
        array([[0, 1, 4], [0, 4, 3], [1, 2, 4], [3, 4, 6]])
        """
        x, y = regular(self._box, step, shape)
        within = inside(self.domain, x, y[:, None])
        return SurfaceGrid(x, y, self._over(self, x, y, within), within, _triangles(within), self)

    def to_xarray(
        self,
        region: ArrayLike | None = None,
        spacing: float | None = None,
        shape: tuple[int, int] | None = None,
        like: Any = None,
        *,
        names: str | Sequence[str] | None = None,
        dims: tuple[str, str] | None = None,
        units: str | None = None,
        xy_units: str | None = None,
        error: bool = True,
        outside: str = NAN,
    ) -> xr.Dataset:
        """Sample the surface on a grid, as a Dataset of xarray with its coordinates (extra ``xarray``).

        Parameters
        ----------
        region : (west, east, south, north), optional
            What the grid covers, in the order that verde and GMT have; by default the bounding box of the domain.
        spacing : float, optional
            Distance of neighbouring samples, from the south-west corner on; by default it gives about 10,000 samples.
        shape : tuple of int, optional
            Numbers of rows (along y) and columns that fill the region, each 2 or more, instead of a spacing.
        like : DataArray, Dataset or SurfaceGrid, optional
            A grid whose coordinates are taken, with all that belongs to them: names, attributes, direction, and
            coordinates without a dimension such as rioxarray's `spatial_ref`. It takes the place of region, spacing,
            shape, dims and xy_units.
        names : str or sequence of str, optional
            What the values are called, a name for each; "value" by default, of several "value_0", "value_1" and so on.
        dims : tuple of str, optional
            Names of the dimensions, y first; ("y", "x") by default.
        units, xy_units : str, optional
            Units of the values and the error, and of the coordinates, for their attributes: "m".
        error : bool
            Whether to compute the error to expect at every sample.
        outside : {"nan", "extrapolate"}
            What to return outside the domain, the convex hull of the data.

        Returns
        -------
        xarray.Dataset
            A variable of (rows, columns) for each value, and `error`, see `Surface.error`; of several values it is the
            norm of the difference.

        Raises
        ------
        ValueError, TypeError
            If the grid has more than 10^7 samples or no region, arguments contradict each other, or names are the same.
            If an error is wanted, and the surface has no data.
        ImportError
            If xarray is not installed.

        Examples
        --------
        >>> import mexpress as mx
        >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
        >>> surface = mx.fit_surface(square, [0, 2, 2, 4], square)
        >>> grid = surface.to_xarray(region=(0, 2, 0, 1), spacing=1, names="depth", units="m", error=False)
        >>> grid["depth"].dims, grid["depth"].units, grid["x"].values
        (('y', 'x'), 'm', array([0., 1., 2.]))
        >>> grid["depth"].values.round(6) + 0.0
        array([[0., 1., 2.],
               [1., 2., 3.]])
        """
        xarray = import_xarray()
        own = {"region": region, "spacing": spacing, "shape": shape, "dims": dims, "xy_units": xy_units}
        if like is None:
            box = self._box if region is None else Box.of(region)
            x, y = regular(box, spacing, shape, "spacing")
            grid = named(x, y, ("y", "x") if dims is None else dims, unit_of(xy_units, "xy_units"))
        else:
            for argument, value in own.items():
                if value is not None:
                    rule = "It must be None when there is a grid to be like."
                    check.refuse(argument, rule, check.describe(value))
            grid = like_another(like)
        called, unit = self._names(names, grid, check.flag(error, "error")), unit_of(units, "units")
        within = inside(self.domain, grid.x, grid.y[:, None])
        wanted = within if check_outside(outside) else np.ones_like(within)
        layers = self._over(self, grid.x, grid.y, wanted).reshape(*wanted.shape, -1)
        attributes = {} if unit is None else {"units": unit}
        variables = {name: (grid.dims, layers[..., k], attributes) for k, name in enumerate(called)}
        if error:
            told = {"long_name": "error to expect", **attributes}
            variables[_ERROR] = grid.dims, self._over(self.error, grid.x, grid.y, wanted), told
        dataset: xr.Dataset = xarray.Dataset(variables, grid.coordinates, {"source": f"mexpress: {self!r}"})
        return dataset

    def _names(self, names: str | Sequence[str] | None, grid: Sheet, error: bool) -> list[str]:
        """Return what the values are called on a grid."""
        d = self._dimension
        usual = ["value"] if d == 1 else [f"value_{k}" for k in range(d)]
        which = "It must be one name" if d == 1 else f"They must be {d} names"
        rule = f"{which} that no coordinate of the grid has{', nor the error' if error else ''}."
        called = names_of(usual if names is None else names, "names", d, rule)
        if taken := set(called) & {*grid.dims, *grid.coordinates, *([_ERROR] if error else [])}:
            given = ", ".join(sorted(map(repr, map(str, taken))))
            check.refuse("names", rule, f"{given}, the default" if names is None else given)
        return called

    def write_mesh(
        self,
        path: str | os.PathLike[str],
        step: float | None = None,
        shape: tuple[int, int] | None = None,
    ) -> None:
        """Write the surface inside its domain as a triangle mesh with normals, for 3D programs.

        The vertices are (x, y, f) for a depth f, and f for points in space. Undefined normals are zeros. An OBJ of
        points in space has texture coordinates for an image of the domain's bounding box with y down.

        Parameters
        ----------
        path : str or path
            Name of the file, ending in .ply (binary) or .obj. An existing file is replaced once the new one is
            complete.
        step, shape
            As for `grid`.

        Raises
        ------
        ValueError
            If the surface does not have one or three values, the path has another ending, or no triangle of the grid is
            inside the domain.
        OSError
            If the file cannot be written; an existing file is then unchanged.

        Examples
        --------
        >>> import mexpress as mx
        >>> import tempfile
        >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     mx.fit_surface(square, [0, 2, 2, 5], square).write_mesh(f"{folder}/surface.ply")
        ...     os.listdir(folder)
        ['surface.ply']
        """
        self._check_space("become a mesh")
        ending = check.path(path).suffix.lower()
        if ending not in {".ply", ".obj"}:
            check.refuse("path", "It must end in .ply or .obj.", check.describe(os.fspath(path)))
        grid = self.grid(step, shape)
        if not len(grid.triangles):
            name, rule = ("shape", "larger") if shape is not None else ("step", "smaller")
            check.refuse(name, f"It must be {rule}: no triangle is inside the domain.", f"{grid!r}")
        used, triangles = np.unique(grid.triangles, return_inverse=True)
        points, triangles = grid.points[used], triangles.reshape(-1, 3)
        values, normals = grid.values.reshape(grid.inside.size, -1)[used], np.nan_to_num(self.normals(points))
        vertices = np.column_stack([points, values]) if self._dimension == 1 else values
        if ending == ".ply":
            meshes.write_ply(path, vertices, triangles, normals)
        else:
            texture = self._texture(points) if self._dimension == 3 else None
            meshes.write_obj(path, vertices, triangles, normals, texture)

    def _design(self, data: Observations) -> Design[Self]:
        functions = CardinalBasis(self.lifting)
        design = linear_design(functions, data.points, data.values, Region(self.domain), type(self))
        return design.weighted(data.weights)

    def _units(self, points: Floats) -> Floats:
        return np.ones(len(points))

    @cached_property
    def _centred(self) -> tuple[Floats, Floats]:
        """Return a constant near the values, (d,), and the parameters of what is left, (l, d)."""
        columns = self.parameters.reshape(len(self.parameters), -1)
        centre = nearest_constant(columns, np.ones((len(columns), 1)))
        return centre, columns - centre

    @property
    def _dimension(self) -> int:
        return self.parameters.size // len(self.parameters)

    def _check_space(self, purpose: str) -> None:
        if self._dimension not in {1, 3}:
            rule = f"It must have one value, a depth, or three, a point in space, to {purpose}."
            check.refuse("surface", rule, f"{self._dimension} values")

    @property
    def _box(self) -> Box:
        return Box(self.domain.min(axis=0), np.ptp(self.domain, axis=0), area(self.domain))

    def _over(
        self, function: Callable[[Floats], Floats], x: Floats, y: Floats, wanted: NDArray[np.bool_]
    ) -> Floats:
        """Return values of a function at the samples of a grid that are wanted, (rows, columns, ...), NaN at others."""
        found = function(grid_points(x, y)[wanted.ravel()])
        values = np.full((*wanted.shape, *found.shape[1:]), np.nan)
        values[wanted] = found
        return values

    def _texture(self, points: Floats) -> Floats:
        right, up = ((points - self.domain.min(axis=0)) / np.ptp(self.domain, axis=0)).T
        return np.column_stack([right, 1 - up])


def _triangles(inside: NDArray[np.bool_]) -> Integers:
    """Return two triangles for every cell with all corners inside, and one for every cell with one corner outside."""
    index = np.arange(inside.size, dtype=np.int64).reshape(inside.shape)
    cells = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], axis=-1).reshape(-1, 4)
    a, b, c, d = inside.ravel()[cells].T
    halves = [
        ([0, 1, 2], a & b & c),
        ([0, 2, 3], a & c & d),
        ([0, 1, 3], a & b & d & ~c),
        ([1, 2, 3], b & c & d & ~a),
    ]
    return np.concatenate([cells[within][:, corners] for corners, within in halves])


def _unit(vectors: Floats) -> Floats:
    """Return vectors of length one, even if their squares overflow; NaN for zero vectors."""
    with np.errstate(divide="ignore", invalid="ignore"):
        moderate = vectors / np.abs(vectors).max(axis=1, keepdims=True)
        return np.asarray(moderate / np.linalg.norm(moderate, axis=1, keepdims=True))
