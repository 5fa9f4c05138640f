"""Vertices of OBJ files of all kinds."""

import numpy as np
import pytest

from mexpress.io.clouds import read_cloud
from mexpress.io.meshes import write_obj, write_ply
from mexpress.io.obj import read_obj_vertices

RNG = np.random.default_rng(0)
VERTICES = RNG.normal(size=(50, 3)) * 10.0 ** RNG.integers(-5, 5, (50, 3))


@pytest.mark.parametrize("more", [{}, {"normals": VERTICES, "texture": VERTICES[:, :2]}])
def test_what_is_written_is_read_bit_for_bit(tmp_path, more):
    write_obj(tmp_path / "a.obj", VERTICES, [[0, 1, 2], [2, 1, 3]], **more)
    write_ply(tmp_path / "a.ply", VERTICES, [[0, 1, 2]])
    np.testing.assert_array_equal(read_obj_vertices((tmp_path / "a.obj").read_bytes()), VERTICES)
    cloud, same = (read_cloud(tmp_path / name) for name in ("a.obj", "a.ply"))
    np.testing.assert_array_equal(np.column_stack([cloud.points, cloud.values]), VERTICES)
    np.testing.assert_array_equal(cloud.values, same.values)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_what_others_write(end):
    lines = [
        "# Blender",
        "mtllib a.mtl",
        "o sheet",
        "  v 1 2 3",
        "v\t-1.5e0 0 .25 0.5 0.5 0.5 # a colour",
        "vn 0 0 1",
        "vt 0 0",
        "vp 7 7 7",
        "v 4 5 6 1.0",
        "#v 8 8 8",
        "f 1//1 2//1 3//1",
        "",
    ]
    expected = [[1, 2, 3], [-1.5, 0, 0.25], [4, 5, 6]]
    np.testing.assert_array_equal(read_obj_vertices(end.join(lines).encode()), expected)


def test_a_line_may_go_on_in_the_next():
    for end in (b"\n", b"\r\n"):
        np.testing.assert_array_equal(read_obj_vertices(b"v 1 \\" + end + b"2 3" + end), [[1, 2, 3]])


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"v 1 2 3\nv 1 2\n", "line 2 has a vertex of 2 numbers"),
        (b"v 1 2 x\n" * 4, "'x'"),
        (b"", r"Given 0|Given no rows"),
        (b"f 1 2 3\n", r"Given no rows in m\.obj"),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", r"Given 3 of 3 in m\.obj"),
    ],
)
def test_what_is_refused(tmp_path, content, says):
    (tmp_path / "m.obj").write_bytes(content)
    with pytest.raises(ValueError, match=rf"^Invalid cloud\. .*{says}"):
        read_cloud(tmp_path / "m.obj")


def test_columns_and_weights_are_of_tables(tmp_path):
    write_obj(tmp_path / "a.obj", VERTICES, [[0, 1, 2]])
    with pytest.raises(ValueError, match=r"^Invalid columns\. They belong to a table"):
        read_cloud(tmp_path / "a.obj", columns=["x", "y", "z"])
    with pytest.raises(ValueError, match=r"^Invalid weights\. "):
        read_cloud(tmp_path / "a.obj", weights="w")
