"""Surfaces sampled as Datasets of xarray, against the surface itself, verde's grids, and what writes and reads them."""

import sys

import numpy as np
import pytest
import verde
import xarray as xr
from inputs import refused

import mexpress as mx

RNG = np.random.default_rng(3)
POINTS = RNG.uniform(0, 1, (120, 2)) * [40, 25] + [1000, -50]
HEIGHT = np.sin(POINTS[:, 0] / 9) + POINTS[:, 1] / 20
SURFACE = mx.fit_surface(POINTS, HEIGHT, POINTS[:30], smoothing=0.1)
FLOW = mx.fit_surface(POINTS, np.column_stack([HEIGHT, -HEIGHT]), POINTS[:30])
REGION = (1005.0, 1030.0, -45.0, -30.0)
FIRST = mx.Surface(SURFACE.lifting, SURFACE.parameters, SURFACE.domain)


def asked(surface, grid):
    """Return what a surface has at the samples of a grid, row after row."""
    x, y = np.meshgrid(grid["x"], grid["y"])
    return surface(np.column_stack([x.ravel(), y.ravel()]), outside="nan")


def test_by_default_it_is_the_grid():
    grid, found = SURFACE.grid(), SURFACE.to_xarray()
    assert (found["value"].dims, set(found.data_vars)) == (("y", "x"), {"value", "error"})
    for name, expected in {"x": grid.x, "y": grid.y, "value": grid.values, "error": grid.error}.items():
        np.testing.assert_array_equal(found[name], expected)
    assert np.isnan(found["value"]).any()  # outside the hull


@pytest.mark.parametrize("options", [{"shape": (7, 9)}, {"spacing": 2.5}, {}])
def test_a_region_is_west_east_south_north(options):
    found = SURFACE.to_xarray(REGION, **options)
    west, east, south, north = REGION
    assert (found["x"][0], found["y"][0]) == (west, south)
    assert east - 2.5 < found["x"][-1] <= east
    assert north - 2.5 < found["y"][-1] <= north
    np.testing.assert_array_equal(found["value"].values.ravel(), asked(SURFACE, found))
    assert found["value"].size > 9000 or options


def test_verde_has_the_same_places():
    for options in ({"shape": (7, 9)}, {"spacing": 2.5}):  # which divides the region
        x, y = verde.grid_coordinates(REGION, **options)
        found = SURFACE.to_xarray(REGION, **options, error=False)
        np.testing.assert_allclose(found["x"], x[0], rtol=1e-15)
        np.testing.assert_allclose(found["y"], y[:, 0], rtol=1e-15)


def test_a_grid_like_another():
    y = np.array([-30.0, -37, -41])  # a raster's rows run south
    other = xr.DataArray(
        np.zeros((2, 3, 4)),
        {"northing": ("northing", y, {"units": "m"}), "easting": [1005.0, 1009, 1020, 1030], "time": [1, 2]},
        ("time", "northing", "easting"),
    ).assign_coords(spatial_ref=0, zone=("easting", list("abcd")), clock=("time", [5, 6]))
    found = SURFACE.to_xarray(like=other)
    assert found["value"].dims == ("northing", "easting")
    assert set(found.coords) == {"northing", "easting", "spatial_ref", "zone"}
    assert found["northing"].attrs == {"units": "m"}
    renamed = found.rename(northing="y", easting="x")
    np.testing.assert_array_equal(found["value"].values.ravel(), asked(SURFACE, renamed))
    difference = found["value"] - other.isel(time=0)  # aligned: no sample is lost
    assert difference.shape == (3, 4)
    turned = SURFACE.to_xarray(like=other.transpose("easting", "time", "northing").to_dataset(name="z"))
    xr.testing.assert_equal(turned, found)


def test_a_grid_like_one_of_ours():
    grid = SURFACE.grid(shape=(5, 6))
    np.testing.assert_array_equal(
        FLOW.to_xarray(like=grid)["value_1"], FLOW.grid(shape=(5, 6)).values[..., 1]
    )


def test_pixels_without_coordinates_are_counted():
    surface = mx.fit_surface(POINTS - [1000, -50], HEIGHT, POINTS[:9] - [1000, -50])
    found = surface.to_xarray(like=xr.DataArray(np.zeros((20, 30)), dims=("row", "column")))
    assert not found.coords
    np.testing.assert_array_equal(found["value"][5, 7], surface([[7, 5]])[0])


def test_several_values_are_several_variables():
    found = FLOW.to_xarray(REGION, shape=(4, 5), names=["east", "north"], units="m/s")
    assert set(found.data_vars) == {"east", "north", "error"}
    np.testing.assert_array_equal(
        np.stack([found["east"], found["north"]], axis=-1).reshape(-1, 2), asked(FLOW, found)
    )
    assert {found[name].attrs["units"] for name in found.data_vars} == {"m/s"}
    assert set(FLOW.to_xarray(shape=(2, 2), error=False).data_vars) == {"value_0", "value_1"}


def test_names_and_units():
    found = SURFACE.to_xarray(
        shape=(4, 5), names="height", dims=("northing", "easting"), units="cm", xy_units="km"
    )
    assert found["height"].dims == ("northing", "easting")
    assert (found["height"].units, found["error"].units) == ("cm", "cm")
    assert found["easting"].attrs == {"axis": "X", "units": "km"}
    assert found["northing"].attrs == {"axis": "Y", "units": "km"}


def test_extrapolation_is_for_the_asking():
    region = (990, 1050, -60, -10)
    found = SURFACE.to_xarray(region, shape=(6, 7), outside="extrapolate")
    assert np.isfinite(found["value"]).all()
    assert np.isfinite(found["error"]).all()
    inside = SURFACE.to_xarray(region, shape=(6, 7))
    np.testing.assert_array_equal(inside["value"], found["value"].where(np.isfinite(inside["value"])))


def test_a_grid_goes_to_netcdf_and_back_into_a_cloud(tmp_path):
    grid = SURFACE.to_xarray(REGION, shape=(8, 9), units="m")
    grid.to_netcdf(tmp_path / "grid.nc", engine="scipy")
    with xr.open_dataset(tmp_path / "grid.nc", engine="scipy") as again:
        xr.testing.assert_identical(again.load(), grid)
        cloud = mx.read_cloud(again["value"])
    assert (cloud.unit, cloud.n_valid) == ("m", int(np.isfinite(grid["value"]).sum()))
    np.testing.assert_array_equal(cloud.values, SURFACE(cloud.points))


def test_a_surface_without_data_has_no_error():
    assert set(FIRST.to_xarray(shape=(3, 3), error=False).data_vars) == {"value"}
    refused(lambda: FIRST.to_xarray(shape=(3, 3)), "model", ValueError)


@pytest.mark.parametrize(
    ("argument", "wrong"),
    [
        ("region", [(0, 1, 2), "wesn", 3, ("0", 1, 0, 1), (0, 1, 0, True), {1, 2}]),
        ("region", [(1, 1, 0, 1), (2, 1, 0, 1), (0, 1, 1, 0), (0, np.nan, 0, 1), (0, 1, 0, 1e200)]),
        ("spacing", [0, -1, np.nan, "2", 1e-9, [1, 2], True, 1e3]),
        ("shape", [(1, 5), 7, (3,), (3, 3.5), (10_000, 10_000), "ab"]),
        ("names", [["a", "b"], [], "", 3, ["x"], "y", "error", [None]]),
        ("dims", [("a",), ("a", "a"), "ab", 3, ("a", 1), ("", "x")]),
        ("units", [3, ["m"], b"m"]),
        ("xy_units", [3, ["m"], b"m"]),
        ("error", [None, 1, "yes"]),
        ("outside", [None, "fill", 0]),
        ("like", [3, "grid", np.zeros((3, 4)), xr.DataArray(3.0), xr.DataArray([1.0], dims="x"), SURFACE]),
        ("like", [xr.DataArray(np.zeros((0, 3)), dims=("y", "x")), xr.DataArray(np.zeros((2, 3)), dims=("x", "time"))]),
    ],
)  # fmt: skip
def test_what_is_refused(argument, wrong):
    for value in wrong:
        refused(lambda value=value: SURFACE.to_xarray(**{argument: value}), argument)


def test_arguments_that_contradict_each_other():
    like = xr.DataArray(np.zeros((2, 3)), dims=("y", "x"))
    for argument, value in {
        "region": REGION, "spacing": 1, "shape": (2, 2), "dims": ("y", "x"), "xy_units": "m",
    }.items():  # fmt: skip
        refused(lambda a=argument, v=value: SURFACE.to_xarray(like=like, **{a: v}), argument, ValueError)
    refused(lambda: SURFACE.to_xarray(spacing=1, shape=(2, 2)), "shape", ValueError)
    crowded = like.assign_coords(value=("x", [1, 2, 3]))
    said = refused(lambda: SURFACE.to_xarray(like=crowded), "names", ValueError)
    assert said == (
        "Invalid names. It must be one name that no coordinate of the grid has, nor the error. "
        "Given 'value', the default."
    )
    huge = xr.Dataset(coords={"y": np.arange(4000), "x": np.arange(4000)})
    refused(lambda: SURFACE.to_xarray(like=huge), "like", ValueError)


def test_without_xarray_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(ImportError, match=r"pip install 'mexpress\[xarray\]'"):
        SURFACE.to_xarray()


def test_a_spacing_may_be_as_long_as_the_region():
    assert SURFACE.to_xarray((0, 3, 0, 0.3), spacing=0.3).sizes == {"y": 2, "x": 11}
    said = refused(lambda: SURFACE.to_xarray((0, 3, 0, 0.3), spacing=0.31), "spacing", ValueError)
    assert "must not exceed 0.3" in said
