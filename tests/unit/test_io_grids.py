"""ESRI's grids in text."""

import numpy as np
import pytest

from mexpress.io.clouds import read_cloud
from mexpress.io.grids import is_grid, read_grid
from mexpress.io.matches import read_matches, read_points

CELLS = "1.5 -9999 3\n4 5e2 -6\n"
HEADER = "ncols 3\nnrows 2\nxllcorner 500000.5\nyllcorner 5300000\ncellsize 30\n"
GRID = "ncols 3\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 30\nNODATA_value -9999\n1.5 2 3\n4 5 6\n"


@pytest.mark.parametrize(
    ("text", "no_data"),
    [
        (HEADER + "NODATA_value -9999\n" + CELLS, -9999),
        (HEADER.upper() + "nodata_VALUE 0\n" + CELLS, 0),
        (HEADER + CELLS, -9999),
        (HEADER.replace("\n", "\r\n") + "NODATA_value  -1e30\r\n" + CELLS.replace("\n", "\r\n"), -1e30),
        (
            "\ufeff  NROWS 2\nNCOLS 3\nxllcenter 0\nyllcenter 0\ndx 1\ndy 2\n" + CELLS.replace("\n", " "),
            -9999,
        ),
        (HEADER + CELLS.replace(" ", "\n"), -9999),
    ],
)
def test_a_grid(text, no_data):
    content = text.encode()
    assert is_grid(content)
    raster = read_grid(content)
    np.testing.assert_array_equal(raster.pixels, [[1.5, -9999, 3], [4, 500, -6]])
    assert (raster.no_data, raster.georeferenced) == ((no_data,), True)


@pytest.mark.parametrize("content", [b"1 2 3\n", b"x y z\n", b"", b"ncolsx 3", b"// made by hand\n1 2 3"])
def test_points_are_no_grid(content):
    assert not is_grid(content)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (HEADER + "1 2 3 4 5", "it has 5 numbers, not 3 x 2"),
        (HEADER + CELLS + "7", "it has 7 numbers, not 3 x 2"),
        ("ncols 3", "it has 0 numbers, not 3 x 0"),
        ("ncols", "'ncols' is no number"),
        ("ncols three", "'three' is no number"),
        ("ncols 1.5 nrows 2 1 2 3", "it has 3 numbers, not 1.5 x 2"),
        ("ncols nan nrows 2 1 2 3", "it has 3 numbers, not nan x 2"),
        ("ncols 1e300 nrows 1e300 1", "it has 1 numbers"),
        (HEADER + CELLS.replace(".", ","), "'1,5' is no number"),
    ],
)
def test_what_is_refused(text, says):
    with pytest.raises(ValueError, match=says):
        read_grid(text.encode())


@pytest.mark.parametrize("comment", ["", "# from a survey\n# of 1998\n"])
@pytest.mark.parametrize("read", [read_cloud, read_matches, read_points])
@pytest.mark.parametrize("name", ["dem.txt", "dem.grd", "dem"])
def test_a_grid_under_another_ending_is_named(tmp_path, comment, read, name):
    (tmp_path / name).write_text(comment + GRID)
    says = rf"a grid with ncols .* in an \.asc file\. Given {name}, such a grid\.$"
    with pytest.raises(ValueError, match=rf"^Invalid (cloud|matches|points)\. .*{says}"):
        read(tmp_path / name)


@pytest.mark.parametrize("comment", ["", "# from a survey\n# of 1998\n"])
def test_comments_above_a_grid(tmp_path, comment):
    (tmp_path / "dem.asc").write_text(comment + GRID)
    cloud = read_cloud(tmp_path / "dem.asc")
    assert (cloud.values.tolist(), cloud.image_size) == ([1.5, 2, 3, 4, 5, 6], (3, 2))
