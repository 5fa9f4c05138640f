"""Ground control points, as GDAL (by rasterio) and we ourselves read them."""

import shlex

import numpy as np
import pytest
import rasterio
from inputs import refused
from rasterio.control import GroundControlPoint
from rasterio.transform import GCPTransformer

import mexpress as mx

RNG = np.random.default_rng(8)
PIXELS = RNG.uniform(0, 1, (60, 2)) * [640, 480]
NORTH_UP = np.array([[0.5, 0.02], [0.03, -0.5]])
MAP = PIXELS @ NORTH_UP + [500_000, 4_650_000]
BENT = MAP + 4 * np.sin(PIXELS[:, ::-1] / 90)
WKT = 'PROJCRS["WGS 84 / UTM zone 33N",\n  ID["EPSG",32633]]'


def options_of(path):
    """Return arguments as GDAL splits a file of options."""
    return [word for line in path.read_text().splitlines() for word in shlex.split(line)]


def points_of(path):
    words = options_of(path)
    starts = [k for k, word in enumerate(words) if word == "-gcp"]
    rows = [tuple(map(float, words[k + 1 : k + 5])) for k in starts]
    return [GroundControlPoint(row=line, col=pixel, x=x, y=y) for pixel, line, x, y in rows]


def mapped(transformer, pixels):
    """Return where GDAL has the centres of pixels; rasterio adds the half from their corners."""
    return np.column_stack(transformer.xy(pixels[:, 1], pixels[:, 0], offset="center"))


def test_qgis_reads_back(tmp_path):
    pixels = np.round(PIXELS * 8) / 8  # half a pixel is added and taken off again without rounding
    mx.io.write_landmarks(tmp_path / "scan.points", pixels, MAP, crs="EPSG:32633")
    text = (tmp_path / "scan.points").read_text().splitlines()
    assert text[:2] == ["#CRS: EPSG:32633", "mapX,mapY,sourceX,sourceY,enable,dX,dY,residual"]
    x, y, column, line, *rest = map(float, text[2].split(","))
    np.testing.assert_allclose([x, y, column, -line], [*MAP[0], *pixels[0] + 0.5], rtol=1e-15)
    assert rest == [1, 0, 0, 0]
    source, target = mx.io.read_matches(tmp_path / "scan.points")
    np.testing.assert_array_equal(source, pixels)
    np.testing.assert_array_equal(target, MAP)


def test_gdal_maps_pixels_as_an_affine_warp_does(tmp_path):
    mx.io.write_landmarks(tmp_path / "gcps.txt", PIXELS, MAP)
    warp = mx.fit_warp(PIXELS, MAP, PIXELS[:3], fractional=False)
    with GCPTransformer(
        points_of(tmp_path / "gcps.txt")[:3]
    ) as transformer:  # three points: GDAL's first order
        np.testing.assert_allclose(mapped(transformer, PIXELS), warp(PIXELS), rtol=0, atol=1e-6)


def test_gdal_s_spline_through_control_points_is_the_warp(tmp_path):
    warp = mx.fit_warp(PIXELS, BENT, PIXELS, fractional=False, smoothing="auto")
    assert np.abs(warp(PIXELS) - MAP).max() > 1  # it bends
    mx.io.write_landmarks(tmp_path / "gcps.txt", warp.control_points, warp(warp.control_points))
    queries = RNG.uniform(0, 1, (200, 2)) * [640, 480]
    # rasterio has GDAL fit the spline from the map to the image, gdalwarp the one from the image: with sides exchanged.
    exchanged = [
        GroundControlPoint(row=p.y, col=p.x, x=p.col, y=p.row) for p in points_of(tmp_path / "gcps.txt")
    ]
    with GCPTransformer(exchanged, tps=True) as transformer:
        y, x = transformer.rowcol(*(queries + 0.5).T, op=lambda coordinate: coordinate)
    np.testing.assert_allclose(np.column_stack([x, y]), warp(queries), rtol=0, atol=1e-6)


def test_gdal_keeps_the_points_in_an_image(tmp_path):
    mx.io.write_landmarks(tmp_path / "gcps.txt", PIXELS, BENT, crs="EPSG:32633")
    assert options_of(tmp_path / "gcps.txt")[:2] == ["-a_srs", "EPSG:32633"]
    gcps = points_of(tmp_path / "gcps.txt")
    profile = {"driver": "GTiff", "width": 640, "height": 480, "count": 1, "dtype": "uint8"}
    with rasterio.open(tmp_path / "photo.tif", "w", gcps=gcps, crs="EPSG:32633", **profile) as image:
        image.write(np.zeros((1, 480, 640), np.uint8))
    with rasterio.open(tmp_path / "photo.tif") as image:
        found, system = image.gcps
    assert system.to_epsg() == 32633
    np.testing.assert_allclose([(p.col - 0.5, p.row - 0.5) for p in found], PIXELS, rtol=0, atol=1e-9)
    np.testing.assert_array_equal([(p.x, p.y) for p in found], BENT)


def test_wkt_is_one_line_for_either_program(tmp_path):
    one = 'PROJCRS["WGS 84 / UTM zone 33N", ID["EPSG",32633]]'
    for ending in ("txt", "points"):
        mx.io.write_landmarks(tmp_path / f"gcps.{ending}", PIXELS, MAP, crs=WKT)
    assert options_of(tmp_path / "gcps.txt")[:2] == ["-a_srs", one]
    assert (tmp_path / "gcps.points").read_text().splitlines()[0] == f"#CRS: {one}"
    mx.io.read_matches(tmp_path / "gcps.points")


@pytest.mark.parametrize("name", ["gcps", "gcps.csv", "gcps.tif"])
def test_other_endings_are_refused(tmp_path, name):
    refused(lambda: mx.io.write_landmarks(tmp_path / name, PIXELS, MAP), "path", ValueError)
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize("crs", ["", "  ", 32633, b"EPSG:1", ["EPSG:1"]])
def test_what_is_no_reference_system(tmp_path, crs):
    refused(lambda: mx.io.write_landmarks(tmp_path / "g.txt", PIXELS, MAP, crs=crs), "crs")


def test_points_above_the_image_are_not_for_qgis(tmp_path):
    above = np.vstack([PIXELS, [[3, -0.6]]]), np.vstack([MAP, MAP[:1]])
    said = refused(lambda: mx.io.write_landmarks(tmp_path / "g.points", *above), "source", ValueError)
    assert said.endswith("Given -0.6.")
    mx.io.write_landmarks(tmp_path / "g.txt", *above)
    above[0][-1, 1] = -0.5
    mx.io.write_landmarks(tmp_path / "g.points", *above)
    np.testing.assert_array_equal(mx.io.read_matches(tmp_path / "g.points")[0], above[0])


def test_points_come_in_pairs(tmp_path):
    refused(lambda: mx.io.write_landmarks(tmp_path / "g.txt", PIXELS, MAP[:-1]), "target", ValueError)
    refused(lambda: mx.io.write_landmarks(tmp_path / "g.txt", PIXELS[:, :1], MAP), "source", ValueError)
    refused(lambda: mx.io.write_landmarks(tmp_path / "g.txt", PIXELS, MAP * np.nan), "target", ValueError)
