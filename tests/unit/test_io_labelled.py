"""DataArrays read as clouds."""

import numpy as np
import pytest
import xarray as xr
from inputs import refused

import mexpress as mx

RNG = np.random.default_rng(1)
X, Y = np.array([10.0, 20.0, 30.0, 40.0]), np.array([5.0, 3.0, 1.0])
VALUES = RNG.normal(size=(3, 4))


def sheet(dims=("y", "x"), attrs=None):
    return xr.DataArray(VALUES.copy(), {dims[0]: Y, dims[1]: X}, dims, attrs=attrs or {})


def test_points_are_coordinates():
    cloud = mx.read_cloud(sheet(attrs={"units": "m"}))
    np.testing.assert_array_equal(cloud.points, [(x, y) for y in Y for x in X])
    np.testing.assert_array_equal(cloud.values, VALUES.ravel())
    assert (cloud.unit, cloud.axes, cloud.image_size) == ("m", ("x", "y"), None)


@pytest.mark.parametrize(
    "dims", [("lat", "lon"), ("northing", "easting"), ("row", "col"), ("Latitude", "Longitude"), ("a", "b")]
)
def test_names_tell_the_axes_in_any_order(dims):
    array = sheet(dims)
    expected = mx.read_cloud(sheet())
    turned = [array] if dims == ("a", "b") else [array, array.transpose()]  # a, b are y, x as they stand
    for given in turned:
        cloud = mx.read_cloud(given)
        np.testing.assert_array_equal(cloud.points, expected.points)
        np.testing.assert_array_equal(cloud.values, expected.values)
        assert [name.lower() for name in cloud.axes] == [name.lower() for name in dims[::-1]]


def test_attributes_tell_the_axes():
    array = sheet(("p", "q")).transpose()
    array["q"].attrs["axis"], array["p"].attrs["axis"] = "X", "Y"
    np.testing.assert_array_equal(mx.read_cloud(array).points, mx.read_cloud(sheet()).points)
    array["q"].attrs["units"], array["p"].attrs["units"] = "degrees_east", "degrees_north"
    assert mx.read_cloud(array).axes == ("longitude", "latitude")


def test_what_is_missing_is_left_out():
    array = sheet()
    array[0, 1] = np.nan
    array[2, 3] = -9999
    array.attrs["_FillValue"] = -9999
    cloud = mx.read_cloud(array)
    assert (len(cloud.points), cloud.n_missing) == (10, 2)
    assert mx.read_cloud(array, missing=float(VALUES[1, 1])).n_missing == 3


def test_layers_of_length_one_do_not_count():
    array = sheet().expand_dims(band=1)
    np.testing.assert_array_equal(mx.read_cloud(array).values, VALUES.ravel())
    refused(lambda: mx.read_cloud(xr.concat([array, array], "band")), "cloud", ValueError)


def test_pixels_without_coordinates_are_counted():
    cloud = mx.read_cloud(xr.DataArray(VALUES, dims=("y", "x")))
    np.testing.assert_array_equal(cloud.points[[0, -1]], [[0, 0], [3, 2]])


def test_large_arrays_are_drawn_from():
    array = xr.DataArray(np.arange(12_000.0).reshape(100, 120), dims=("y", "x"), attrs={"units": "m"})
    cloud = mx.read_cloud(array)  # whose unit is no guess, so that nothing warns
    assert (len(cloud.points), cloud.n_valid) == (10_000, 12_000)
    np.testing.assert_array_equal(cloud.values, cloud.points @ [1, 120])


def test_a_netcdf_file(tmp_path):
    xr.Dataset({"height": sheet(("lat", "lon"))}).to_netcdf(tmp_path / "grid.nc", engine="scipy")
    with xr.open_dataset(tmp_path / "grid.nc", engine="scipy") as dataset:
        np.testing.assert_array_equal(mx.read_cloud(dataset["height"]).values, VALUES.ravel())
        text = refused(lambda: mx.read_cloud(dataset), "cloud", ValueError)
        assert "height" in text
    assert 'xarray.open_dataset("grid.nc")' in refused(lambda: mx.read_cloud(tmp_path / "grid.nc"), "cloud")


@pytest.mark.parametrize(
    "array",
    [
        xr.DataArray(VALUES[0], dims=("x",)),
        xr.DataArray(VALUES, dims=("x", "time")),
        xr.DataArray(VALUES + 0j, dims=("y", "x")),
        xr.DataArray(VALUES.astype(str), dims=("y", "x")),
        xr.DataArray(VALUES, {"y": list("abc")}, dims=("y", "x")),
        xr.DataArray(VALUES, {"y": [0, np.nan, 2]}, dims=("y", "x")),
        xr.DataArray(3.0),
    ],
    ids=["a row", "time", "complex", "text", "names", "nan", "a number"],
)
def test_what_is_no_sheet(array):
    refused(lambda: mx.read_cloud(array))


@pytest.mark.parametrize("option", [{"columns": ["x", "y", "z"]}, {"weights": "w"}, {"scale": 2}])
def test_options_of_other_things(option):
    refused(lambda: mx.read_cloud(sheet(), **option), next(iter(option)), ValueError)


def test_columns_of_tables_have_names_too(tmp_path):
    (tmp_path / "p.csv").write_text("id,lat,lon,z\n" + "".join(f"{k},4{k},{k},{k}\n" for k in range(5)))
    assert mx.read_cloud(tmp_path / "p.csv").axes == ("lon", "lat")
    (tmp_path / "p.csv").write_text("".join(f"4{k},{k},{k}\n" for k in range(5)))
    assert mx.read_cloud(tmp_path / "p.csv").axes is None
