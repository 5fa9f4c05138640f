"""What the numbers of depth maps mean: units, 0, and what stands for no data, in files laid out byte by byte."""

import contextlib
import io
import json
import struct
import warnings

import numpy as np
import PIL.Image
import pytest
from rasters import png, tiff

from mexpress.cli import main
from mexpress.io.clouds import read_cloud
from mexpress.io.raster import Raster

RANDOM = np.random.default_rng(0)
COUNTS = RANDOM.integers(1500, 1595, (48, 64)).astype(np.uint16)
HEIGHTS = RANDOM.uniform(200, 300, (48, 64))
EARTH = [(33550, 12, [30.0, 30.0, 0.0]), (33922, 12, [0, 0, 0, 5e5, 5.3e6, 0])]
MILLIMETRES = r"^d\.\w+ has whole numbers in a unit that it does not say: they were taken for millimetres"


def with_holes(array, *constants):
    """The array with some of its numbers replaced, and where it is still itself."""
    holed, hole = array.copy(), np.zeros(array.shape, bool)
    for k, constant in enumerate(constants):
        holed[3 + k, 5:20] = constant
        hole[3 + k, 5:20] = True
    return holed, ~hole


def read(tmp_path, ending, content, note=None, **options):
    """Read bytes, all data; there is a note of this kind, or none."""
    path = tmp_path / f"d.{ending}"
    path.write_bytes(content)
    with pytest.warns(UserWarning, match=note) if note else contextlib.nullcontext():
        return read_cloud(path, max_data=None, **options)


def holds(cloud, array, valid=None):
    """The cloud has the numbers of the array where they are valid, at their pixels."""
    row, column = np.nonzero(np.ones(array.shape, bool) if valid is None else valid)
    np.testing.assert_array_equal(cloud.points, np.column_stack([column, row]))
    np.testing.assert_array_equal(cloud.values, array[row, column].astype(np.float64))
    assert cloud.image_size == array.shape[::-1]
    assert cloud.n_missing == array.size - len(row)


@pytest.mark.parametrize("kind", ["P2", "P5"])
def test_a_graymap_of_twelve_bits(tmp_path, kind):
    flat = COUNTS.ravel().tolist()
    samples = " ".join(map(str, flat)).encode() if kind == "P2" else struct.pack(f">{len(flat)}H", *flat)
    content = f"{kind} 64 48 4095\n".encode() + samples
    cloud = read(tmp_path, "pgm", content, MILLIMETRES)
    holds(cloud, COUNTS / 1000)
    assert (cloud.values.min(), cloud.values.max(), cloud.unit) == (1.5, 1.594, "m")
    holds(read(tmp_path, "pgm", content, scale=1), COUNTS)


@pytest.mark.parametrize(
    ("ending", "content"),
    [
        ("png", png(COUNTS)),
        ("tif", tiff(COUNTS)),
        ("tif", tiff(COUNTS, ">", 5, 2)),
        ("tif", tiff(COUNTS, compression=8)),
    ],
)
def test_whole_numbers_without_a_sign_are_taken_for_millimetres(tmp_path, ending, content):
    cloud = read(tmp_path, ending, content, MILLIMETRES)
    holds(cloud, COUNTS / 1000)
    assert cloud.unit == "m"


@pytest.mark.parametrize("dtype", [np.int8, np.int16, np.int32])
def test_whole_numbers_with_a_sign_are_what_they_are(tmp_path, dtype):
    array = RANDOM.integers(-9, 99, (48, 64)).astype(dtype)
    cloud = read(tmp_path, "tif", tiff(array))
    holds(cloud, array)
    assert cloud.unit is None
    holds(read(tmp_path, "tif", tiff(array), scale=100), array / 100)


@pytest.mark.parametrize("tag", [EARTH[0], (34264, 12, [1.0] * 16), (34735, 3, [1, 1, 0, 0])])
def test_whole_numbers_with_a_place_on_earth_are_what_they_are(tmp_path, tag):
    array = RANDOM.integers(0, 99, (48, 64)).astype(np.uint16)
    cloud = read(tmp_path, "tif", tiff(array, tags=[tag]))
    holds(cloud, array)
    assert cloud.unit is None


def test_zero_is_missing_for_a_sensor_unless_the_file_says_what_is(tmp_path):
    holed, valid = with_holes(COUNTS, 0)
    for ending, content in (("png", png(holed)), ("tif", tiff(holed))):
        holds(read(tmp_path, ending, content, scale=1), holed, valid)
    told = tiff(holed, tags=[(42113, 2, b"65535\0")])
    holds(
        read(tmp_path, "tif", told, r"are 0, far from all others, 1500 to 1594: .*missing=\[0\]", scale=1),
        holed,
    )


@pytest.mark.parametrize(
    ("dtype", "constant", "text"),
    [
        (np.float32, -9999, b"-9999\0"),
        (np.float64, -9999, b"-9999\0"),
        (np.float32, -3.4028234663852886e38, b"-3.40282346638529011e+38\0"),
        (np.float32, 1e10, b"10000000000\0"),
        (np.int16, -32768, b"-32768\0"),
        (np.uint16, 65535, b"65535\0"),
        (np.float32, np.nan, b"nan\0"),
        (np.float32, 0, b"0\0"),
    ],
)
@pytest.mark.parametrize(
    "layout", [{}, {"compression": 5, "order": ">"}, {"compression": 8, "predictor": 2, "tile": (16, 16)}]
)
def test_what_a_geotiff_says_means_no_data(tmp_path, dtype, constant, text, layout):
    holed, valid = with_holes(HEIGHTS.astype(dtype), np.array(constant, dtype))
    cloud = read(tmp_path, "tif", tiff(holed, tags=[*EARTH, (42113, 2, text)], **layout))
    holds(cloud, holed, valid)
    assert 200 <= cloud.values.min() <= cloud.values.max() <= 300


def test_several_numbers_can_mean_no_data(tmp_path):
    holed, valid = with_holes(COUNTS, 65535, 7)
    holds(read(tmp_path, "png", png(holed), scale=1000, missing=[65535, 7]), holed / 1000, valid)
    holed, valid = with_holes(HEIGHTS, -9999, 65535, np.nan)
    holds(read(tmp_path, "tif", tiff(holed), missing=[-9999, 65535.0]), holed, valid)
    np.save(tmp_path / "d.npy", holed)
    holds(read_cloud(tmp_path / "d.npy", max_data=None, missing=(65535, -9999)), holed, valid)


def test_points_can_be_missing_too(tmp_path):
    points, values = RANDOM.uniform(0, 1, (30, 2)), RANDOM.uniform(5, 6, (30, 3))
    values[4, 1] = values[7, 2] = -9999
    np.savez(tmp_path / "c.npz", points=points, values=values)
    np.testing.assert_array_equal(
        read_cloud(tmp_path / "c.npz", missing=-9999).values, np.delete(values, [4, 7], axis=0)
    )
    head = "ply\nformat ascii 1.0\nelement vertex 30\n" + "".join(
        f"property float {name}\n" for name in "xyz"
    )
    rows = [" ".join(map(repr, row)) for row in np.column_stack([points, values[:, 1]]).tolist()]
    (tmp_path / "c.ply").write_text(head + "end_header\n" + "\n".join(rows) + "\n")
    cloud = read_cloud(tmp_path / "c.ply", missing=[-9999, 0])
    np.testing.assert_array_equal(cloud.values, np.delete(values[:, 1], 4))


@pytest.mark.parametrize(
    ("array", "constant", "says"),
    [
        (
            HEIGHTS,
            -9999,
            r"15 of 30\d\d values in d\.tif are -9999, far from all others, 20.* to 29.*: .*missing=\[-9999\]",
        ),
        (HEIGHTS.astype(np.int16), -32768, r"missing=\[-32768\]"),
        (HEIGHTS.astype(np.float32), -3.4028234663852886e38, r"missing=\[-3\.4028234663852886e\+38\]"),
        (HEIGHTS, 1e10, r"missing=\[10000000000\]"),
        (HEIGHTS.astype(np.float32), 0, r"missing=\[0\]"),
        (HEIGHTS.astype(np.int32), 0, r"missing=\[0\]"),
    ],
)
def test_a_constant_far_outside_is_noted_and_the_note_tells_what_to_say(tmp_path, array, constant, says):
    holed, valid = with_holes(array, np.array(constant, array.dtype))
    holds(read(tmp_path, "tif", tiff(holed), says), holed)
    holds(read(tmp_path, "tif", tiff(holed), missing=np.array(constant, array.dtype).item()), holed, valid)


def test_the_farthest_depth_of_a_sensor_is_noted_too(tmp_path):
    holed, _ = with_holes(COUNTS, 65535)
    holds(
        read(tmp_path, "png", png(holed), r"are 65535, far from all others, 1500 to 1594", scale=1000),
        holed / 1000,
    )


def test_no_note_on_real_numbers(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        holds(read(tmp_path, "tif", tiff(HEIGHTS)), HEIGHTS)
        holds(read(tmp_path, "png", png(COUNTS), scale=1000), COUNTS / 1000)


@pytest.mark.parametrize("order", "<>")
def test_a_portable_floatmap(tmp_path, order):
    holed, valid = with_holes(HEIGHTS.astype(np.float32), np.inf)
    rows = [struct.pack(f"{order}64f", *row) for row in holed.tolist()]
    content = f"Pf\n64 48\n{'-' if order == '<' else ''}1.0\n".encode() + b"".join(rows[::-1])
    cloud = read(tmp_path, "pfm", content)
    holds(cloud, holed, valid)
    assert cloud.unit is None


def test_a_grid_in_text_and_points_in_text_may_have_the_same_ending(tmp_path):
    holed, valid = with_holes(HEIGHTS, -32768)
    cells = "\n".join(" ".join(map(repr, row)) for row in holed.tolist())
    head = "NCOLS 64\nNROWS 48\nXLLCORNER 500000\nYLLCORNER 5300000\nCELLSIZE 30\nNODATA_value -32768\n"
    cloud = read(tmp_path, "asc", (head + cells).encode())
    holds(cloud, holed, valid)
    assert cloud.unit is None
    points = RANDOM.uniform(1, 2, (30, 3))
    text = "".join(" ".join(map(repr, row)) + "\n" for row in points.tolist())
    cloud = read(tmp_path, "asc", text.encode())
    np.testing.assert_array_equal(np.column_stack([cloud.points, cloud.values]), points)


@pytest.mark.parametrize(
    ("ending", "content", "says"),
    [
        ("png", png(COUNTS % 256, bits=8, colour=3, palette=bytes(range(256)) * 3), r"shape \(48, 64, 3\)"),
        ("png", png(np.dstack([COUNTS % 256] * 2), bits=8), r"shape \(48, 64, 2\)"),
        ("png", png(np.dstack([COUNTS] * 2)), "channels of 16 bits, which Pillow would cut"),
        ("png", png(COUNTS % 2, bits=1), "bool"),
        ("tif", tiff(np.dstack([COUNTS] * 3)), r"shape \(48, 64, 3\)"),
        ("tif", tiff(COUNTS, tags=[(262, 3, [3])]), "d.tif: "),
        ("tif", tiff(np.dstack([COUNTS.astype(np.uint8)] * 4), photometric=5), "mode CMYK"),
        ("ppm", b"P6 4 4 255\n" + bytes(48), r"shape \(4, 4, 3\)"),
        ("tif", tiff(COUNTS, tags=[(42113, 2, b"none\0")]), "tag 42113"),
        ("asc", b"ncols 4\nnrows 4\n1 2 3", "3 numbers, not 4 x 4"),
        ("pgm", b"P5 64 48 4095\n12", "2 bytes of samples, not 6144"),
    ],
)
def test_what_is_no_depth_map_is_refused(tmp_path, ending, content, says):
    with pytest.raises((ValueError, TypeError), match=rf"^Invalid cloud\. .*{says}.*\.$"):
        read(tmp_path, ending, content)


def test_the_command_line_says_what_was_guessed_and_takes_what_it_is_told(tmp_path, capsys):
    rows, columns = np.mgrid[:30, :40]
    depth = (2000 + 300 * np.sin(columns / 6) + 5 * rows + RANDOM.normal(0, 5, rows.shape)).astype(np.uint16)
    depth[:2, :9], depth[5, 3:9] = 65535, 9
    path, out = tmp_path / "d.png", tmp_path / "out"
    path.write_bytes(png(depth))
    command = ["surface", path, "--smoothing", "0", "--max-count", "9", "--no-plots", "--quiet", "--out", out]
    command = list(map(str, command))

    assert main(command) == 0
    errors = capsys.readouterr().err
    assert "mexpress: d.png has whole numbers in a unit that it does not say" in errors
    assert "If that is right, say --scale 1000; --scale 1 keeps them.\n" in errors
    assert "mexpress: 18 of 1200 values in d.png are 65535, far from all others" in errors
    assert "if it means no data, say --missing 65535.\n" in errors
    assert json.loads((out / "selection.json").read_text())["unit"] == "m"

    assert main([*command, "--scale", "1000", "--missing", "65535,9"]) == 0
    captured = capsys.readouterr()
    assert "whole numbers" not in captured.err
    assert "far from all others" not in captured.err
    assert captured.out.startswith("1176 depths (24 more are missing)")

    path.write_bytes(tiff(depth.astype(np.int16), tags=EARTH))
    assert main([*command, "--missing", "-1,9"]) == 0
    captured = capsys.readouterr()
    assert captured.out.startswith("1176 depths (24 more are missing)")
    assert "unit of the data" in captured.out


SCALED = (42112, 2, b'<GDALMetadata><Item name="SCALE" sample="0" role="scale">0.25</Item>'
          b'<Item name="OFFSET" sample="0" role="offset">-375</Item></GDALMetadata>\0')  # fmt: skip


@pytest.mark.parametrize("dtype", ["u2", "i2", "f4"])
def test_the_scale_of_the_file(tmp_path, dtype):
    holed, valid = with_holes(COUNTS.astype(dtype), 7)
    content = tiff(holed, tags=[SCALED, (42113, 2, b"7\0")])
    cloud = read(tmp_path, "tif", content)
    holds(cloud, COUNTS * 0.25 - 375, valid)
    assert cloud.unit is None
    holds(read(tmp_path, "tif", content, scale=10), (COUNTS * 0.25 - 375) / 10, valid)


def test_zero_is_a_value_beneath_a_scale_but_not_at_a_camera(tmp_path):
    holed, _ = with_holes(COUNTS, 0, 1500)  # the first is -375, the other 0
    content = tiff(holed, tags=[SCALED])
    note = r"15 of 30\d\d values in d\.tif are 0, far from all others"
    holds(read(tmp_path, "tif", content, note), holed * 0.25 - 375.0)
    cloud = read(tmp_path, "tif", content, note, intrinsics=(50, 50, 32, 24))
    depths = (holed * 0.25 - 375.0).ravel()
    np.testing.assert_array_equal(cloud.values[:, 2], depths[depths != 0])
    assert cloud.n_missing == (holed == 1500).sum() >= 15


@pytest.mark.parametrize("kind", ["tif", "png"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_depth_map_is_turned_as_photographs_are(tmp_path, kind, orientation):
    if kind == "tif":
        content = tiff(COUNTS, tags=[(274, 3, [orientation])])
    else:
        file, exif = io.BytesIO(), PIL.Image.Exif()
        exif[0x0112] = orientation
        PIL.Image.fromarray(COUNTS).save(file, "PNG", exif=exif)
        content = file.getvalue()
    seen = Raster(COUNTS, orientation=orientation).upright()
    assert seen.shape == (COUNTS.shape if orientation < 5 else COUNTS.shape[::-1])
    holds(read(tmp_path, kind, content, scale=1), seen)


@pytest.mark.parametrize("ending", [".tif", ".png"])
def test_numbers_that_packing_has_changed_are_refused(tmp_path, ending):
    pixels = np.where(np.arange(64) < 32, 50, 200) * np.ones((48, 1))
    packed = {"compression": "jpeg"} if ending == ".tif" else {}
    path = tmp_path / f"depth{ending}"
    PIL.Image.fromarray(pixels.astype(np.uint8)).save(path, "TIFF" if packed else "JPEG", **packed)
    with pytest.raises(ValueError, match=f"JPEG and the like change numbers.* Given depth{ending}"):
        read_cloud(path)
