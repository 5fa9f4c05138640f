import numpy as np
import pytest

from mexpress.io.meshes import write_obj, write_ply

VERTICES = np.array([[5e6, 0, 1], [5e6 + 1, 0, 1.25], [5e6, 1, -3], [5e6 + 1, 1, 1 / 3]])
TRIANGLES = np.array([[0, 1, 2], [1, 3, 2]])
NORMALS = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0], [0.6, 0, 0.8]])
TEXTURE = np.array([[0, 0], [1, 0], [0, 1], [1, 0.1]])


def read_obj(path):
    """Numbers by word, and faces as (t, 3, 3) indices of vertex, texture and normal; -1 where there is none."""
    numbers, faces = {"v": [], "vt": [], "vn": []}, []
    for line in path.read_text().splitlines():
        word, *rest = line.split()
        if word == "f":
            corners = [[*corner.split("/"), "", ""][:3] for corner in rest]
            faces.append([[int(name or 0) - 1 for name in corner] for corner in corners])
        else:
            numbers[word].append([float(number) for number in rest])
    return {word: np.array(rows) for word, rows in numbers.items()}, np.array(faces)


def read_ply(path):
    """Columns of the vertices by name, and triangles, of a file as `write_ply` writes it."""
    header, _, body = path.read_bytes().partition(b"end_header\n")
    lines = [line.split() for line in header.decode().splitlines()]
    assert lines[:2] == [["ply"], ["format", "binary_little_endian", "1.0"]]
    vertices, faces = (int(words[-1]) for words in lines if words[0] == "element")
    types = {"double": "<f8", "float": "<f4"}
    columns = [(rest[-1], types[rest[0]]) for word, *rest in lines if word == "property" and rest[0] in types]
    assert lines[-1] == ["property", "list", "uchar", "int", "vertex_indices"]
    table = np.frombuffer(body, columns, vertices)
    corners = np.frombuffer(body[table.nbytes :], [("count", "u1"), ("indices", "<i4", 3)])
    assert len(corners) == faces
    assert (corners["count"] == 3).all()
    return {name: table[name] for name in table.dtype.names}, corners["indices"]


@pytest.mark.parametrize("normals", [None, NORMALS])
def test_ply_has_every_digit_and_counts_from_zero(normals, tmp_path):
    write_ply(tmp_path / "a.ply", VERTICES, TRIANGLES, normals)
    vertex, triangles = read_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(np.column_stack([vertex[name] for name in "xyz"]), VERTICES)
    np.testing.assert_array_equal(triangles, TRIANGLES)
    assert list(vertex) == ["x", "y", "z", *([] if normals is None else ["nx", "ny", "nz"])]
    if normals is not None:
        found = np.column_stack([vertex[name] for name in ("nx", "ny", "nz")])
        np.testing.assert_array_equal(found, normals.astype(np.float32))


@pytest.mark.parametrize("normals", [None, NORMALS])
@pytest.mark.parametrize("texture", [None, TEXTURE])
def test_obj_has_every_digit_and_counts_from_one(normals, texture, tmp_path):
    write_obj(tmp_path / "a.obj", VERTICES, TRIANGLES, normals, texture)
    numbers, faces = read_obj(tmp_path / "a.obj")
    np.testing.assert_array_equal(numbers["v"], VERTICES)
    np.testing.assert_array_equal(faces[:, :, 0], TRIANGLES)
    for word, given, column in (("vt", texture, 1), ("vn", normals, 2)):
        np.testing.assert_array_equal(numbers[word], [] if given is None else given)
        np.testing.assert_array_equal(faces[:, :, column], -1 if given is None else TRIANGLES)


@pytest.mark.parametrize("write", [write_ply, write_obj])
def test_points_without_triangles_are_a_mesh_too(write, tmp_path):
    write(tmp_path / "a", VERTICES, [])
    write(tmp_path / "b", VERTICES, np.empty((0, 3), dtype=int))
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@pytest.mark.parametrize("write", [write_ply, write_obj])
def test_every_layout_of_the_same_numbers_gives_the_same_file(write, tmp_path):
    write(tmp_path / "a", VERTICES.round(), TRIANGLES, NORMALS)
    read_only = np.asfortranarray(VERTICES.round())
    read_only.flags.writeable = False
    for faces in (TRIANGLES.tolist(), TRIANGLES.astype(np.uint8), np.asfortranarray(TRIANGLES)):
        write(tmp_path / "b", read_only, faces, NORMALS.tolist())
        assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@pytest.mark.parametrize("write", [write_ply, write_obj])
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("vertices", np.ones((4, 2))),
        ("vertices", []),
        ("vertices", np.full((4, 3), np.nan)),
        ("vertices", "abc"),
        ("triangles", [[0, 1, 4]]),
        ("triangles", [[0, -1, 2]]),
        ("triangles", [[0, 1]]),
        ("triangles", [0, 1, 2]),
        ("triangles", [[0.0, 1.0, 2.0]]),
        ("triangles", [[2**64 - 1, 0, 1]]),
        ("triangles", None),
        ("normals", NORMALS[:2]),
        ("normals", NORMALS[:, :2]),
        ("normals", np.full((4, 3), np.inf)),
    ],
)
def test_parts_that_make_no_mesh_are_refused_and_write_nothing(write, name, value, tmp_path):
    arguments = {"vertices": VERTICES, "triangles": TRIANGLES, "normals": NORMALS, name: value}
    with pytest.raises((ValueError, TypeError), match=rf"Invalid {name}\. .* Given "):
        write(tmp_path / "a", **arguments)
    assert not list(tmp_path.iterdir())


def test_a_texture_of_another_shape_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"Invalid texture\. .* Given "):
        write_obj(tmp_path / "a", VERTICES, TRIANGLES, texture=NORMALS)


@pytest.mark.parametrize("write", [write_ply, write_obj])
def test_a_mesh_that_cannot_be_written_leaves_nothing(write, tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "kept").touch()
    with pytest.raises(OSError, match="directory"):
        write(tmp_path / "folder", VERTICES, TRIANGLES)
    with pytest.raises(FileNotFoundError):
        write(tmp_path / "none" / "a.ply", VERTICES, TRIANGLES)
    assert [entry.name for entry in tmp_path.rglob("*")] == ["folder", "kept"]
