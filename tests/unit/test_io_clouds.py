import contextlib
import io
import re
import struct
import sys
from pathlib import Path

import matplotlib.cbook
import numpy as np
import pytest
import scipy.stats
from hypothesis import example, given
from hypothesis import strategies as st
from rasters import png, tiff

from mexpress.io import text as tables
from mexpress.io.clouds import Cloud, read_cloud
from mexpress.io.tables import XYZ as XYZ_LAYOUT
from mexpress.io.tables import choose

SHARED = Path(__file__).parents[3] / "shared" / "data"
RNG = np.random.default_rng(0)
FORM = re.compile(r"^Invalid [\w\[\]]+\. .+ Given .*\.$", re.DOTALL)

DEPTH = RNG.integers(500, 60_000, (9, 12)).astype(np.uint16)
DEPTH[2, 3] = DEPTH[0, 0] = DEPTH[8, 11] = 0
ROW, COLUMN = np.nonzero(DEPTH)
XYZ = RNG.normal(size=(7, 3))
UVXYZ = RNG.normal(size=(7, 5))


def save(path, array):
    """Write an array as the ending says."""
    if path.suffix == ".npy":
        np.save(path, array)
    else:
        path.write_bytes((tiff if path.suffix == ".tif" else png)(array))
    return path


def refused(call, says):
    with pytest.raises((ValueError, TypeError), match=says) as caught:
        call()
    assert type(caught.value) in (ValueError, TypeError)
    assert FORM.match(str(caught.value)), caught.value


def lines(table, separator=","):
    return "".join(separator.join(map(repr, row)) + "\n" for row in table.tolist())


# Depth maps


@pytest.mark.parametrize(
    ("name", "dtype", "units"),
    [
        ("d.png", np.uint16, 1000),
        ("D.PNG", np.uint16, 1000),
        ("d.tif", np.uint16, 1000),
        ("d.tif", np.uint32, 1000),
        ("d.npy", np.uint16, 1),
        ("d.npy", ">u2", 1),
        ("d.npy", np.int64, 1),
    ],
)
@pytest.mark.parametrize("scale", [None, 1, 5000, 0.25])
def test_a_depth_map_of_whole_numbers(tmp_path, name, dtype, units, scale):
    path = save((tmp_path / name.lower()), DEPTH.astype(dtype)).rename(tmp_path / name)
    guessed = scale is None and units == 1000
    says = rf"^{name} has whole numbers in a unit that .* divided by 1000\..* say scale=1000; scale=1 keeps them\.$"
    with pytest.warns(UserWarning, match=says) if guessed else contextlib.nullcontext():
        cloud = read_cloud(path, scale=scale)
    np.testing.assert_array_equal(cloud.points, np.column_stack([COLUMN, ROW]))
    np.testing.assert_array_equal(cloud.values, DEPTH[ROW, COLUMN] / (scale or units))
    assert cloud.unit == (None if scale is None and units == 1 else "m")
    assert (cloud.image_size, cloud.n_valid, cloud.n_missing) == ((12, 9), 105, 3)
    assert cloud.points.dtype == cloud.values.dtype == np.float64


def test_eight_bits_are_few_but_whole_numbers(tmp_path):
    gray = np.array([[0, 1, 2], [3, 254, 255]], dtype=np.uint8)
    cloud = read_cloud(save(tmp_path / "d.png", gray), scale=100)
    np.testing.assert_array_equal(cloud.values, [0.01, 0.02, 0.03, 2.54, 2.55])
    np.testing.assert_array_equal(cloud.points, [[1, 0], [2, 0], [0, 1], [1, 1], [2, 1]])


@pytest.mark.parametrize("name", ["d.npy", "d.tif"])
@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_in_a_depth_map_of_floats_zero_is_a_value_except_for_a_camera(tmp_path, name, dtype):
    depth = RNG.uniform(-1, 1, (6, 7)).astype(dtype)
    depth[0, :3] = 0, np.nan, np.inf
    depth[5, 6] = -np.inf
    path = save(tmp_path / name, depth)
    plain = read_cloud(path)
    np.testing.assert_array_equal(plain.values, depth[np.isfinite(depth)].astype(float))
    assert (plain.values[0], plain.n_valid, plain.n_missing) == (0, 39, 3)
    np.testing.assert_array_equal(read_cloud(path, scale=4).values, plain.values / 4)
    seen = read_cloud(path, intrinsics=(1, 1, 0, 0))
    np.testing.assert_array_equal(seen.values[:, 2], plain.values[1:])
    assert (seen.n_valid, seen.n_missing) == (38, 4)


def test_a_portable_graymap_of_two_bytes_a_pixel(tmp_path):
    (tmp_path / "d.pgm").write_bytes(b"P5 12 9 65535\n" + DEPTH.astype(">u2").tobytes())
    np.testing.assert_array_equal(
        read_cloud(tmp_path / "d.pgm", scale=1000).values, DEPTH[ROW, COLUMN] / 1000
    )


def test_points_in_space_project_onto_their_pixels(tmp_path):
    fx, fy, cx, cy = 525.0, 500.0, 5.5, 4.25
    path = save(tmp_path / "d.png", DEPTH)
    plain, cloud = read_cloud(path, 5000), read_cloud(path, 5000, (fx, fy, cx, cy))
    np.testing.assert_array_equal(cloud.points, plain.points)
    X, Y, Z = cloud.values.T
    np.testing.assert_array_equal(Z, plain.values)
    np.testing.assert_allclose(
        np.column_stack([fx * X / Z + cx, fy * Y / Z + cy]), cloud.points, rtol=0, atol=1e-12
    )
    np.testing.assert_array_equal(read_cloud(path, 5000, np.array([fx, fy, cx, cy])).values, cloud.values)


def test_the_elevation_map_that_matplotlib_ships():
    path = matplotlib.cbook.get_sample_data("jacksboro_fault_dem.npz", asfileobj=False)
    with np.load(path) as arrays:
        elevation = arrays["elevation"]
    cloud = read_cloud(path, max_data=None)
    assert (cloud.image_size, cloud.n_valid, cloud.n_missing) == ((403, 344), 344 * 403, 0)
    np.testing.assert_array_equal(cloud.values.reshape(344, 403), elevation)
    column, row = cloud.points.T.astype(int)
    np.testing.assert_array_equal(cloud.values, elevation[row, column])
    assert len(read_cloud(path).points) == 10_000


@pytest.mark.parametrize(
    ("name", "array", "says"),
    [
        ("d.png", np.ones((6, 7, 3), np.uint8), r"shape \(6, 7, 3\) in d\.png"),
        ("d.png", np.ones((6, 7, 4), np.uint8), r"shape \(6, 7, 4\)"),
        ("d.npy", np.ones((6, 7, 3)), r"shape \(6, 7, 3\)"),
        ("d.npy", np.ones(12), r"shape \(12,\)"),
        ("d.npy", np.ones((6, 7), complex), "complex"),
        ("d.npy", np.full((6, 7), "1"), "<U1"),
        ("d.npy", np.ones((6, 7), bool), "bool"),
        ("d.npy", np.ones((6, 7), [("z", float)]), "real number"),
        ("d.npy", np.float64(3), r"cloud \(\) in d\.npy"),
        ("d.png", np.zeros((6, 7), np.uint16), r"0 of 42 in d\.png"),
        ("d.npy", np.full((6, 7), np.nan), "0 of 42"),
        ("d.npy", np.zeros((0, 6)), "columns"),
        ("d.npy", np.ones((6, 0)), "columns"),
        ("d.npy", np.where(np.arange(42).reshape(6, 7) < 3, 1.0, np.nan), "3 of 42"),
        ("d.npy", np.full((6, 7), 1e305), "1e.303"),
    ],
)
def test_depth_maps_that_are_refused(tmp_path, name, array, says):
    refused(lambda: read_cloud(save(tmp_path / name, array)), says)


def test_an_image_of_single_bits_is_a_mask(tmp_path):
    (tmp_path / "d.png").write_bytes(png(np.eye(8, dtype=np.uint8), bits=1))
    refused(lambda: read_cloud(tmp_path / "d.png"), "real number.*bool")


def test_four_data_are_enough(tmp_path):
    depth = np.zeros((6, 7), np.uint16)
    depth[:2, :2] = 1
    assert read_cloud(save(tmp_path / "d.png", depth), scale=1000).n_valid == 4


# Arrays


@pytest.mark.parametrize(
    ("arrays", "points", "values"),
    [
        ({"any": XYZ}, XYZ[:, :2], XYZ[:, 2]),
        ({"points": XYZ, "colours": XYZ}, XYZ[:, :2], XYZ[:, 2]),
        ({"points": XYZ, "date": np.array("today")}, XYZ[:, :2], XYZ[:, 2]),
        ({"any": XYZ, "step": np.array(0.5)}, XYZ[:, :2], XYZ[:, 2]),
        ({"points": XYZ[:, :2], "values": XYZ[:, 2]}, XYZ[:, :2], XYZ[:, 2]),
        ({"points": XYZ[:, :2], "values": UVXYZ[:, :4], "n": XYZ}, XYZ[:, :2], UVXYZ[:, :4]),
        ({"uv": XYZ[:, :2], "points3d": UVXYZ[:, 2:], "corners_uv": XYZ}, XYZ[:, :2], UVXYZ[:, 2:]),
        ({"any": XYZ[:5]}, XYZ[:5, :2], XYZ[:5, 2]),
        ({"points": np.asfortranarray(XYZ.astype(np.float32))}, *np.split(XYZ.astype("f4"), [2], 1)),
        ({"points": np.arange(12).reshape(4, 3)}, [[0, 1], [3, 4], [6, 7], [9, 10]], [2, 5, 8, 11]),
    ],
)
def test_archives(tmp_path, arrays, points, values):
    np.savez(tmp_path / "c.npz", **arrays)
    cloud = read_cloud(tmp_path / "c.npz")
    np.testing.assert_array_equal(cloud.points, points)
    np.testing.assert_array_equal(cloud.values, np.squeeze(values))
    assert (cloud.image_size, cloud.n_valid, cloud.n_missing) == (None, len(points), 0)


def test_a_depth_map_in_an_archive_is_known_by_its_name_or_alone(tmp_path):
    np.savez(tmp_path / "named.npz", depth=DEPTH, mask=DEPTH > 0, k=XYZ)
    np.savez(tmp_path / "alone.npz", z=DEPTH)
    np.savez(tmp_path / "small.npz", depth=DEPTH[:, :3])
    for name in ("named", "alone"):
        cloud = read_cloud(str(tmp_path / f"{name}.npz"), scale=10)
        np.testing.assert_array_equal(cloud.values, DEPTH[ROW, COLUMN] / 10)
    assert read_cloud(tmp_path / "small.npz").image_size == (3, 9)


def test_rows_with_something_missing_are_left_out(tmp_path):
    table = np.vstack([UVXYZ, UVXYZ])
    for k in range(5):
        table[2 * k, k] = (np.nan, np.inf, -np.inf)[k % 3]
    np.save(tmp_path / "c.npy", table)
    cloud = read_cloud(tmp_path / "c.npy", columns=[1, 2, 3, 4, 5])
    np.testing.assert_array_equal(
        np.hstack([cloud.points, cloud.values]), np.delete(table, [0, 2, 4, 6, 8], axis=0)
    )
    assert (cloud.n_valid, cloud.n_missing) == (9, 5)


@pytest.mark.parametrize(
    ("arrays", "says"),
    [
        ({}, "no arrays"),
        ({"a": XYZ, "b": XYZ}, r"a \(7, 3\), b \(7, 3\) in c\.npz"),
        ({"a": XYZ.T}, r"shape \(3, 7\)"),
        ({"a": UVXYZ.T}, r"shape \(5, 7\)"),
        ({"a": XYZ[:, :2]}, r"shape \(7, 2\)"),
        ({"a": np.ones((9, 4))}, r"shape \(9, 4\)"),
        ({"points": np.ones((9, 9))}, r"shape \(9, 9\)"),
        ({"points": XYZ[:, :2]}, r"shape \(7, 2\)"),
        ({"points": XYZ, "values": XYZ}, r"^Invalid points\. .*\(n, 2\).*\(7, 3\)"),
        ({"points": XYZ[:, :2], "values": XYZ[:4, 2]}, r"^Invalid values\. .*\(7,\).*\(4,\)"),
        ({"points": XYZ[:, :2], "values": np.ones((7, 0))}, r"^Invalid values\. .*\(7, 0\)"),
        ({"points": XYZ[:, :2], "values": np.float64(1)}, r"^Invalid values\."),
        ({"points": XYZ[:, :2], "values": np.full(7, "a")}, r"^Invalid values\. .*real"),
        ({"points": np.full((7, 3), None)}, "arrays of numbers"),
        ({"points": XYZ * 1e200}, "1e.100"),
        ({"points": XYZ[:3]}, "3 of 3"),
        ({"points": XYZ * np.nan}, "0 of 7"),
        ({"depth": DEPTH[0]}, r"shape \(12,\)"),
    ],
)
def test_archives_that_are_refused(tmp_path, arrays, says):
    np.savez(tmp_path / "c.npz", **arrays)
    refused(lambda: read_cloud(tmp_path / "c.npz"), says)


# Text


@pytest.mark.parametrize(
    ("table", "header"), [(XYZ, ""), (XYZ, "# by hand\n\n"), (XYZ, "header"), (UVXYZ, "header")]
)
@pytest.mark.parametrize("separator", [",", ";", "\t", "  ", " , "])
@pytest.mark.parametrize("name", ["c.csv", "c.txt", "c.xyz", "c"])
def test_texts(tmp_path, table, separator, header, name):
    names = separator.join("uvxyz"[-table.shape[1] :]) + "\n"
    text = (names if header == "header" else header) + lines(table, separator)
    (tmp_path / name).write_text(text)
    cloud = read_cloud(tmp_path / name)
    np.testing.assert_array_equal(np.column_stack([cloud.points, cloud.values]), table)
    assert cloud.values.ndim == (1 if table is XYZ else 2)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("z,Y,x,r,g\n" + lines(UVXYZ), UVXYZ[:, [2, 1, 0]]),
        ("x,y,z,u,v\n" + lines(UVXYZ), UVXYZ[:, [3, 4, 0, 1, 2]]),
        ("easting,northing,height\n" + lines(XYZ), XYZ),
        ("x,y,z,name\n" + lines(XYZ).replace("\n", ",here\n"), XYZ),
        ("\ufeff" + lines(XYZ).replace("\n", "\r\n"), XYZ),
        (lines(XYZ) + "nan,1,2\n1,inf,2\n1,2,-Infinity\n", XYZ),
        ('"x","y","z"\n' + lines(XYZ) + '"nan","1","2"\n', XYZ),
    ],
)
def test_texts_that_people_write(tmp_path, text, expected):
    (tmp_path / "c.csv").write_text(text, encoding="utf-8")
    cloud = read_cloud(tmp_path / "c.csv")
    np.testing.assert_array_equal(np.column_stack([cloud.points, cloud.values]), expected)
    assert cloud.n_missing == text.lower().count("nan,1") + text.count("inf,") + text.count(
        '"nan"'
    ) + text.count("-Inf")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "at least one line.*which has none"),
        ("# x y z\n", "at least one line"),
        ("x,y,z\n", r"4 data or more.*Given no rows in c\.csv"),
        ("1,2\n" * 9, r"3 columns \(x, y, z\), or a header .* u, v, x, y, z .*Given 2 columns in c\.csv"),
        ("1,2,3,4\n" * 9, "Given 4 columns in"),
        (
            "1,2,3,4,5\n" * 9,
            r"columns=\[1, 2, 3\].*Given 5 columns, which may be u v x y z or x y z and others, in",
        ),
        ("1,2,3,4,5,6\n" * 9, "Given 6 columns, which may be u v x y z or x y z and others, in"),
        ("a,b,c,d\n" + "1,2,3,4\n" * 9, r"Given 4 columns \(a, b, c, d\) in"),
        ("id,x,y\n" + "1,2,3\n" * 9, r"Given 3 columns \(id, x, y\) in"),
        ("y,x,h\n" + "1,2,3\n" * 9, r"Given 3 columns \(y, x, h\), where x may be y or x, in"),
        ("1,2,3\n\n1,2,3,4,5\n", "3 columns, as the first has. Given 5 in line 3"),
        ("x,y,z,s\n1,2,3\n", "4 columns, as the first has. Given 3 in line 2"),
        ("1,2,3\n" * 9 + "1,2,three\n", "must be numbers. Given 'three' in line 10"),
        ("1,2,\n" * 9, "Given 2 columns in c.csv, besides '' in line 1"),
        ("1,2,1_000\n" * 9, "1_000"),
        ("1,2,0x10\n" * 9, "0x10"),
        ("1;2,5;3\n1;2.5;3\n", "decimal comma .* Given '2.5' in line 2"),
        ("1,2,3\n" * 3, r"3 of 3 in c\.csv"),
        ("1,2,nan\n" * 9, "0 of 9"),
        ("1e101,2,3\n" * 9, "1e.100"),
    ],
)
def test_texts_that_are_refused(tmp_path, text, says):
    (tmp_path / "c.csv").write_text(text)
    refused(lambda: read_cloud(tmp_path / "c.csv"), says)


@pytest.mark.slow
def test_long_texts_are_read_at_once(tmp_path, monkeypatch):
    table = np.random.default_rng(1).normal(size=(300_000, 3))
    table[7] = np.nan
    (tmp_path / "c.csv").write_text("x,y,z\n" + lines(table))
    monkeypatch.setattr(tables.TextTable, "_one_by_one", None)
    cloud = read_cloud(tmp_path / "c.csv", max_data=None)
    assert (cloud.n_valid, cloud.n_missing) == (299_999, 1)
    np.testing.assert_array_equal(np.column_stack([cloud.points, cloud.values]), np.delete(table, 7, axis=0))


CELLS = st.one_of(
    st.floats(width=64).map(repr),
    st.integers(-(10**30), 10**30).map(str),
    st.text("0123456789+-.eExXnaifty_ \u0663\u2028\x0b\x1c\x00#'\"", max_size=6),
)


@given(
    st.lists(st.tuples(CELLS, CELLS, CELLS), min_size=1, max_size=4), st.sampled_from([",", " ", ";", "\t"])
)
@example([("1", "2", "1_0")], ",")
@example([("1", "2", "'3'")], ",")
@example([("1", "2", "1e999")], ",")
def test_reading_at_once_changes_nothing(tmp_path_factory, rows, separator):
    path = tmp_path_factory.mktemp("c") / "c.txt"
    path.write_text("".join(separator.join(row) + "\n" for row in rows), encoding="utf-8", newline="\n")

    def outcome():
        try:
            table = tables.read_text(path, "cloud")
            return table.numbers(choose(table, [XYZ_LAYOUT]).columns)
        except ValueError as error:
            return str(error)

    fast = outcome()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tables, "_loaded", lambda *_: None)
        slow = outcome()
    np.testing.assert_array_equal(fast, slow)


# PLY


def ply(vertices, kind="binary_little_endian", names="xyz", dtype="f4", faces=None, count=None):
    """Bytes of a PLY file, written without the package that reads it."""
    order = ">" if "big" in kind else "<"
    types = {"f4": "float", "f8": "double", "i4": "int"}
    head = ["ply", f"format {kind} 1.0", "comment by hand", f"element vertex {count or len(vertices)}"]
    head += [f"property {types[dtype]} {name}" for name in names]
    if faces is not None:
        head += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    head = "\n".join([*head, "end_header\n"]).encode()
    if kind == "ascii":
        rows = [" ".join(map(repr, row)) for row in np.asarray(vertices, dtype).tolist()]
        rows += [" ".join(map(str, [len(face), *face])) for face in faces or []]
        return head + ("\n".join(rows) + "\n").encode()
    body = np.asarray(vertices).astype(order + dtype).tobytes()
    return (
        head + body + b"".join(struct.pack(f"{order}B{len(face)}i", len(face), *face) for face in faces or [])
    )


KINDS = ["ascii", "binary_little_endian", "binary_big_endian"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dtype", ["f4", "f8"])
@pytest.mark.parametrize(
    "faces", [None, [], [(0, 1, 2), (2, 3, 4)], [(0, 1, 2, 3)], [(0, 1, 2), (0, 1, 2, 3)]]
)
def test_ply(tmp_path, kind, dtype, faces):
    (tmp_path / "c.ply").write_bytes(ply(XYZ, kind, dtype=dtype, faces=faces))
    cloud = read_cloud(tmp_path / "c.ply")
    expected = XYZ.astype(dtype)
    np.testing.assert_array_equal(np.column_stack([cloud.points, cloud.values]), expected)
    assert (cloud.n_valid, cloud.n_missing, cloud.image_size) == (7, 0, None)


@pytest.mark.parametrize("kind", KINDS)
def test_vertices_without_measurement_and_with_more_than_coordinates(tmp_path, kind):
    table = UVXYZ.copy()
    table[1, 2] = np.nan
    table[4, 0] = np.inf
    table[5, 1] = np.nan  # no coordinate: it does not matter
    (tmp_path / "c.PLY").write_bytes(ply(table, kind, names=["z", "quality", "x", "y", "nx"], dtype="f8"))
    cloud = read_cloud(tmp_path / "c.PLY")
    kept = np.delete(table, [1, 4], axis=0)
    np.testing.assert_array_equal(np.column_stack([cloud.points, cloud.values]), kept[:, [2, 3, 0]])
    assert (cloud.n_valid, cloud.n_missing) == (5, 2)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (ply(XYZ[:, :2], names="xy"), r"x, y and z\. Given x, y in c\.ply"),
        (ply(XYZ[:, :2], "ascii", names="xy"), "Given x, y in"),
        (b"ply\nformat ascii 1.0\nelement point 1\nproperty float x\nend_header\n1\n", "no vertices"),
        (b"ply\nformat ascii 1.0\nend_header\n", "no vertices"),
        (ply(XYZ[:3]), "3 of 3"),
        (ply(XYZ[:0]), "no rows"),
        (ply(XYZ * np.nan), "0 of 7"),
        (ply(XYZ, count=10**15), "PLY"),
        (ply(XYZ, "ascii", count=8), "PLY.*ends before its last element"),
        (ply(XYZ, "ascii").replace(b"-", b"?"), "PLY.*'\\?.*' is no number"),
        (ply(XYZ).replace(b"binary_little_endian", b"binary_middle_endian"), "PLY"),
        (
            b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
            b"property list uchar float z\nend_header\n" + b"1 2 1 3\n" * 4,
            "numbers x, y and z. Given x, y in",
        ),
    ],
)
def test_ply_that_is_refused(tmp_path, content, says):
    (tmp_path / "c.ply").write_bytes(content)
    refused(lambda: read_cloud(tmp_path / "c.ply"), says)


# Damage, and names that are none


def in_memory(write, array):
    file = io.BytesIO()
    write(file, array)
    return file.getvalue()


def image_bytes(tmp_path_factory, name):
    return save(tmp_path_factory.mktemp("image") / name, DEPTH).read_bytes()


@pytest.mark.parametrize("kind", ["npy", "npz", "png", "tif", *KINDS])
def test_a_file_cut_short_is_refused_or_loses_nothing(tmp_path, tmp_path_factory, kind):
    if kind in KINDS:
        whole, path = ply(XYZ, kind, faces=[(0, 1, 2)]), tmp_path / "c.ply"
    elif kind in ("npy", "npz"):
        whole, path = in_memory({"npy": np.save, "npz": np.savez}[kind], DEPTH), tmp_path / f"c.{kind}"
    else:
        path = tmp_path / f"c.{kind}"
        whole = image_bytes(tmp_path_factory, path.name)
    path.write_bytes(whole)
    scale = 1000 if kind in ("png", "tif") else None
    expected = read_cloud(path, scale)
    complete = 0
    for size in [*range(0, len(whole), max(1, len(whole) // 40)), len(whole) - 1]:
        path.write_bytes(whole[:size])
        with contextlib.suppress(ValueError):
            np.testing.assert_array_equal(read_cloud(path, scale).values, expected.values)
            complete += 1
    assert complete <= 4  # the end of a file may say nothing


@pytest.mark.parametrize("ending", ["png", "tif", "tiff", "pgm", "npy", "npz", "ply", "csv", "txt", ""])
@given(
    content=st.one_of(
        st.binary(max_size=60), st.binary(max_size=60).map(lambda b: b"ply\nformat ascii 1.0\n" + b)
    )
)
@example(content=b"")
@example(content=b"ply")
@example(content=b"PK\x03\x04 nonsense")
@example(content=bytes(range(256)))
def test_bytes_that_are_no_cloud(tmp_path_factory, ending, content):
    path = tmp_path_factory.getbasetemp() / f"nonsense.{ending}"
    path.write_bytes(content)
    refused(lambda: read_cloud(path), r"^Invalid cloud\.")


@pytest.mark.parametrize("ending", ["png", "tif", "npy", "npz", "ply", "csv"])
def test_names_of_no_file(tmp_path, ending):
    with pytest.raises(FileNotFoundError):
        read_cloud(tmp_path / f"absent.{ending}")
    (tmp_path / f"folder.{ending}").mkdir()
    with pytest.raises(OSError, match="folder"):
        read_cloud(tmp_path / f"folder.{ending}")


def test_without_the_extra(tmp_path, monkeypatch):
    path = save(tmp_path / "c.png", DEPTH)
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(
        ImportError, match=r"^Reading this image needs Pillow: pip install 'mexpress\[image\]'$"
    ):
        read_cloud(path)


# Options


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        *(("scale", value) for value in (0, -1, np.nan, np.inf, "1000", True, [1])),
        *(
            ("intrinsics", value)
            for value in (
                (),
                (1, 1, 0),
                (1, 1, 0, 0, 0),
                (0, 1, 0, 0),
                (1, -1, 0, 0),
                (np.inf, 1, 0, 0),
                (1, 1, np.nan, 0),
                (1, 1, 0, np.inf),
                "1100",
                ("1", 1, 0, 0),
                (1, 1, 0, None),
                5,
                np.eye(3),
                np.eye(4),
            )
        ),
        *(("max_data", value) for value in (3, 0, -1, 10.0, "10", True)),
        *(("seed", value) for value in (-1, 1.5, "a")),
        *(("missing", value) for value in ("none", np.nan, [np.inf], True, [[1]], object())),
    ],
)
def test_wrong_options(tmp_path, name, wrong):
    path = save(tmp_path / "d.png", DEPTH)
    refused(lambda: read_cloud(path, **{name: wrong}), rf"^Invalid {name}\.")


@pytest.mark.parametrize("options", [{"scale": 1000}, {"intrinsics": (1, 1, 0, 0)}])
@pytest.mark.parametrize("name", ["c.npy", "c.npz", "c.csv", "c.ply"])
def test_points_have_neither_scale_nor_camera(tmp_path, name, options):
    path = tmp_path / name
    path.write_bytes(
        {
            "c.npy": in_memory(np.save, XYZ),
            "c.npz": in_memory(np.savez, XYZ),
            "c.csv": lines(XYZ).encode(),
            "c.ply": ply(XYZ),
        }[name]
    )
    refused(lambda: read_cloud(path, **options), rf"^Invalid {next(iter(options))}\. .*depth map.*{name}")


@pytest.mark.parametrize("options", [{"scale": 1e-320}, {"intrinsics": (1e-320, 1, 0, 0)}])
def test_options_that_overflow(tmp_path, options):
    refused(lambda: read_cloud(save(tmp_path / "d.png", DEPTH), **options), "finite")


# The draw


@pytest.fixture(scope="module")
def large(tmp_path_factory):
    """Write a map of 64 x 48 whose depth tells the pixel, a quarter of it missing."""
    depth = np.arange(1, 64 * 48 + 1, dtype=np.uint16).reshape(48, 64)
    depth[::2, ::2] = 0
    return save(tmp_path_factory.mktemp("large") / "d.png", depth)


def drawn(cloud):
    """Indices of pixels."""
    index = np.round(cloud.values * 1000).astype(int) - 1
    np.testing.assert_array_equal(np.column_stack([index % 64, index // 64]), cloud.points)
    return index


@pytest.mark.parametrize("count", [4, 100, 2303])
def test_a_draw_is_of_different_valid_data_in_their_order(large, count):
    cloud = read_cloud(large, 1000, max_data=count, seed=3)
    index = drawn(cloud)
    assert len(index) == count
    assert (np.diff(index) > 0).all()
    assert (cloud.n_valid, cloud.n_missing) == (2304, 768)


def test_the_same_seed_draws_the_same_data(large):
    first, again, other = (drawn(read_cloud(large, 1000, max_data=50, seed=seed)) for seed in (7, 7, 8))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    random = np.random.default_rng(7)
    np.testing.assert_array_equal(drawn(read_cloud(large, 1000, max_data=50, seed=random)), first)
    assert not np.array_equal(drawn(read_cloud(large, 1000, max_data=50, seed=random)), first)
    fresh = [drawn(read_cloud(large, 1000, max_data=50, seed=None)) for _ in range(2)]
    assert not np.array_equal(*fresh)


@pytest.mark.parametrize("count", [None, 2304, 2305, 10**30])
def test_no_draw_when_there_is_room(large, count):
    cloud = read_cloud(large, 1000, max_data=count)
    assert len(drawn(cloud)) == cloud.n_valid == 2304


def test_a_camera_changes_no_draw(large):
    plain, seen = (
        read_cloud(large, 1000, intrinsics=camera, max_data=50) for camera in (None, (50, 50, 32, 24))
    )
    np.testing.assert_array_equal(plain.points, seen.points)
    np.testing.assert_array_equal(plain.values, seen.values[:, 2])


def test_the_draw_is_uniform_over_the_image(large):
    draws = [drawn(read_cloud(large, 1000, max_data=400, seed=seed)) for seed in range(60)]
    index = np.concatenate(draws)
    # Without replacement the counts vary less than those of a multinomial, by (n - k)/(n - 1) in variance.
    shrunk = (2304 - 400) / 2303
    measured = [i for i in range(64 * 48) if i // 64 % 2 or i % 2]
    blocks = np.bincount(index // 64 // 8 * 8 + index % 64 // 8, minlength=48)
    pixels = np.bincount(index, minlength=64 * 48)[measured]
    for counts in (blocks, pixels):
        statistic = ((counts - counts.mean()) ** 2).sum() / counts.mean() / shrunk
        assert 0.001 < scipy.stats.chi2.sf(statistic, len(counts) - 1) < 0.999


def test_points_are_drawn_too(tmp_path):
    (tmp_path / "c.csv").write_text("u,v,x,y,z\n" + lines(np.column_stack([np.arange(100)] * 5)))
    cloud = read_cloud(tmp_path / "c.csv", max_data=10)
    assert (cloud.points.shape, cloud.values.shape, cloud.n_valid) == ((10, 2), (10, 3), 100)
    np.testing.assert_array_equal(cloud.points[:, 0], cloud.values[:, 2])
    assert (np.diff(cloud.points[:, 0]) > 0).all()


# The result


def test_a_cloud_in_one_line(tmp_path):
    save(tmp_path / "d.png", DEPTH)
    assert (
        repr(read_cloud(tmp_path / "d.png", 1000, max_data=50))
        == "Cloud(50 of 105 data, depth, 12 x 9 pixels)"
    )
    np.save(tmp_path / "c.npy", UVXYZ)
    assert repr(read_cloud(tmp_path / "c.npy", columns=range(1, 6))) == "Cloud(7 of 7 data, values in R^3)"


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("points", XYZ),
        ("points", XYZ[:, :2] * np.nan),
        ("values", XYZ[:4, 0]),
        ("values", XYZ * np.inf),
        ("image_size", (0, 5)),
        ("n_valid", 6),
        ("n_valid", 7.0),
        ("n_missing", -1),
    ],
)
def test_a_cloud_is_checked(name, wrong):
    fields = {"points": XYZ[:, :2], "values": XYZ[:, 2], "image_size": None, "n_valid": 7, "n_missing": 0}
    refused(lambda: Cloud(**(fields | {name: wrong})), rf"^Invalid {name}\.")


# Real data


real_data = pytest.mark.skipif(
    not SHARED.is_dir(), reason=f"there is no folder {SHARED.parts[-2:]} beside the checkout"
)


@real_data
@pytest.mark.parametrize(
    ("name", "scale", "missing", "deepest"),
    [("TUM_depth.png", 5000, 58_950, 46_655), ("depth_00000.png", 1000, 40_071, 2702)],
)
def test_depth_maps_of_two_sensors(name, scale, missing, deepest):
    path = SHARED / "depth" / name
    every = read_cloud(path, scale, max_data=None)
    assert (every.image_size, every.n_missing) == ((640, 480), missing)
    assert every.n_valid == len(every.points) == 640 * 480 - missing
    assert every.values.max() == deepest / scale
    some = read_cloud(path, scale, (525, 525, 319.5, 239.5))
    assert (some.values.shape, some.n_valid) == ((10_000, 3), every.n_valid)
    assert abs(some.points.mean(axis=0) - every.points.mean(axis=0)).max() < 8


@real_data
def test_a_colour_image():
    refused(lambda: read_cloud(SHARED / "depth" / "TUM_color.png"), r"\(480, 640, 3\) in TUM_color")


@real_data
def test_sheets():
    cloud = read_cloud(SHARED / "sheets" / "bent_paper_239.npz")
    with np.load(SHARED / "sheets" / "bent_paper_239.npz") as arrays:
        np.testing.assert_array_equal(cloud.points, arrays["uv"])
        np.testing.assert_array_equal(cloud.values, arrays["points3d"])
    refused(lambda: read_cloud(SHARED / "sheets" / "hulk.npz"), r"points3d \(10, 73, 3\)")


def test_weights_of_points(tmp_path):
    (tmp_path / "c.csv").write_text("x,y,z,weight,sd\n" + "".join(f"{i},{i * i},1,{i},9\n" for i in range(6)))
    assert read_cloud(tmp_path / "c.csv").weights.tolist() == [0, 1, 2, 3, 4, 5]
    assert read_cloud(tmp_path / "c.csv", weights="sd").weights.tolist() == [9] * 6
    some = read_cloud(tmp_path / "c.csv", max_data=4)
    assert some.weights.tolist() == some.points[:, 0].tolist()  # drawn with their data
    (tmp_path / "c.csv").write_text(
        "weight,u,v,x,y,z\n" + "".join(f"{w},{i},{i * i},1,2,3\n" for i, w in enumerate([1, "nan", 3, 4, 5]))
    )
    cloud = read_cloud(tmp_path / "c.csv")
    assert (cloud.weights.tolist(), cloud.n_missing) == ([1, 3, 4, 5], 1)
    assert cloud.values.shape == (4, 3)
    (tmp_path / "c.csv").write_text("".join(f"{i} {i * i} 1\n" for i in range(6)))
    assert read_cloud(tmp_path / "c.csv").weights is None
    with pytest.raises(ValueError, match=r"^Invalid weights\. .*'sd', which is not in c.csv"):
        read_cloud(tmp_path / "c.csv", weights="sd")


def test_weights_of_depth_maps(tmp_path):
    depth = np.arange(48.0).reshape(6, 8)
    depth[0, 0] = np.nan
    np.savez(tmp_path / "d.npz", depth=depth, weights=2 * depth)
    cloud = read_cloud(tmp_path / "d.npz")
    np.testing.assert_array_equal(cloud.weights, 2 * cloud.values)
    for wrong in (np.ones((8, 6)), np.ones(7)):
        np.savez(tmp_path / "d.npz", depth=depth, weights=wrong)
        with pytest.raises(ValueError, match=r"^Invalid weights\. There must be a weight for every datum\."):
            read_cloud(tmp_path / "d.npz")


def test_weights_of_vertices(tmp_path):
    ply = "ply\nformat ascii 1.0\nelement vertex 4\n"
    ply += "".join(f"property float {name}\n" for name in ("x", "y", "z", "confidence")) + "end_header\n"
    (tmp_path / "c.ply").write_text(ply + "0 0 1 1\n1 0 1 2\n0 1 1 3\n1 1 1 4\n")
    assert read_cloud(tmp_path / "c.ply").weights is None
    assert read_cloud(tmp_path / "c.ply", weights="confidence").weights.tolist() == [1, 2, 3, 4]


def test_weights_of_a_cloud_are_checked():
    with pytest.raises(ValueError, match=r"^Invalid weights\. They must be 4 numbers"):
        Cloud([[0, 0], [1, 0], [0, 1], [1, 1]], np.ones(4), None, 4, weights=[1, 2])
