"""PLY files whose bytes are laid out here, one number after the other."""

import struct

import numpy as np
import pytest

from mexpress.io.ply import read_vertices

XYZ = [(0.1, 5e5 + 1 / 3, -1e-30), (1.5, -2.5, 3e20), (7.0, 8.0, 9.0)]
DOUBLES = ["property double x", "property double y", "property double z"]
BINARY = {"binary_little_endian": "<", "binary_big_endian": ">"}


def header(kind, *lines, newline="\n"):
    return newline.join(["ply", f"format {kind} 1.0", *lines, "end_header", ""]).encode()


def read(tmp_path, content):
    (tmp_path / "a.ply").write_bytes(content)
    return {name: column.tolist() for name, column in read_vertices(tmp_path / "a.ply", "cloud").items()}


def columns(rows, names="xyz"):
    return {name: [row[k] for row in rows] for k, name in enumerate(names)}


@pytest.mark.parametrize(("kind", "order"), BINARY.items())
@pytest.mark.parametrize(
    ("words", "code", "values"),
    [
        (("char", "int8"), "b", (-128, 127)),
        (("uchar", "uint8"), "B", (200, 255)),
        (("short", "int16"), "h", (-30000, 258)),
        (("ushort", "uint16"), "H", (60000, 258)),
        (("int", "int32"), "i", (-(2**31), 66051)),
        (("uint", "uint32"), "I", (2**32 - 1, 66051)),
        (("int64", "int64"), "q", (-(2**50), 66051)),
        (("uint64", "uint64"), "Q", (2**50, 66051)),
        (("float", "float32"), "f", (0.15625, -3e38)),
        (("double", "float64"), "d", (0.1, -1e300)),
    ],
)
def test_every_type_in_either_order_of_bytes(tmp_path, kind, order, words, code, values):
    for word in words:
        head = header(
            kind, "element vertex 2", "property uchar red", f"property {word} w", "property short s"
        )
        body = b"".join(struct.pack(f"{order}B{code}h", 9, value, -5) for value in values)
        expected = [struct.unpack(code, struct.pack(code, value))[0] for value in values]
        assert read(tmp_path, head + body) == {"red": [9, 9], "w": expected, "s": [-5, -5]}


def test_text_keeps_its_digits(tmp_path):
    names = ["property uchar red", "property float z", "property float x"]
    head = header("ascii", "comment element vertex 7", "obj_info by hand", "element vertex 3", *names)
    body = b"1 512345.678 -1e-3\n2 nan +.5\n  3\t-inf 7.\n"
    found = read(tmp_path, head + body)
    assert str(found) == "{'red': [1.0, 2.0, 3.0], 'z': [512345.678, nan, -inf], 'x': [-0.001, 0.5, 7.0]}"


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize(("kind", "order"), [("ascii", ""), *BINARY.items()])
def test_every_end_of_lines(tmp_path, newline, kind, order):
    rows = [
        (10.0, 13.0, 1.5),
        (struct.unpack("<d", b"\n\r\n\r\n\r\n\r")[0], 2.0, 3.0),
    ]  # bytes that look like ends
    head = header(kind, "element vertex 2", *DOUBLES, newline=newline)
    if kind == "ascii":
        body = newline.join(" ".join(map(repr, row)) for row in rows).encode()
    else:
        body = b"".join(struct.pack(f"{order}3d", *row) for row in rows)
    assert read(tmp_path, head + body) == columns(rows)


FACES = [
    (0, 1, 2),
    (2, 1, 0),
    (0, 1, 2, 2),
    (1,),
    (),
    (1, 2, 0),
    (0, 1, 2),
    (0, 2, 1),
    (0, 2, 1),
    (0, 1),
    (0, 1),
]


@pytest.mark.parametrize("faces", [FACES, FACES[:2], FACES[3:4], []])
@pytest.mark.parametrize("before", [True, False])
@pytest.mark.parametrize(("kind", "order"), [("ascii", ""), *BINARY.items()])
def test_other_elements_and_lists_are_stepped_over(tmp_path, kind, order, before, faces):
    vertex = ["element vertex 3", "property list short double s", *DOUBLES]
    face = [f"element face {len(faces)}", "property float area", "property list uchar int vertex_indices"]
    strips = [(), (0.5,), (1.0, 2.0, 3.0)]
    head = header(kind, *(face + vertex if before else vertex + face), "element nothing 5")
    if kind == "ascii":
        parts = [
            "".join(
                " ".join(map(repr, [len(s), *s, *row])) + "\n" for s, row in zip(strips, XYZ, strict=True)
            ),
            "".join(" ".join(map(repr, [0.25, len(face), *face])) + "\n" for face in faces),
        ]
        body = "".join(parts[::-1] if before else parts).encode()
    else:
        parts = [
            b"".join(
                struct.pack(f"{order}h{len(s)}d3d", len(s), *s, *row)
                for s, row in zip(strips, XYZ, strict=True)
            ),
            b"".join(struct.pack(f"{order}fB{len(face)}i", 0.25, len(face), *face) for face in faces),
        ]
        body = b"".join(parts[::-1] if before else parts)
    assert read(tmp_path, head + body) == columns(XYZ)
    whole = head + body
    # What is left of a text that ends within a line may be right: its last word is a number still.
    cuts = (
        range(len(whole)) if order else [k for k, byte in enumerate(whole[:-1], start=1) if byte == ord("\n")]
    )
    for size in cuts:
        with pytest.raises(ValueError, match=r"^Invalid cloud\. .* PLY .*a\.ply: its? "):
            read(tmp_path, whole[:size])


def test_many_faces_of_both_kinds(tmp_path):
    random = np.random.default_rng(0)
    faces = [range(3 + quad) for quad in np.repeat(random.integers(0, 2, 60), random.integers(1, 40, 60))]
    head = header(
        "binary_little_endian",
        f"element face {len(faces)}",
        "property list uchar int i",
        "element vertex 3",
        *DOUBLES,
    )
    body = b"".join(struct.pack(f"<B{len(face)}i", len(face), *face) for face in faces)
    body += b"".join(struct.pack("<3d", *row) for row in XYZ)
    assert read(tmp_path, head + body) == columns(XYZ)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "its first line is not ply"),
        (b"plywood\n", "its first line is not ply"),
        (b"ply\nformat ascii 1.0\n", "its header has no end"),
        (b"ply\nend_header\n", "names no format"),
        (header("ascii", "element vertex -1"), "its header has the line 'element vertex -1'"),
        (header("ascii", "element vertex many"), "'element vertex many'"),
        (header("ascii", "property float x"), "'property float x'"),
        (header("ascii", "element vertex 1", "property half x"), "'property half x'"),
        (header("ascii", "element vertex 1", "property list uchar x"), "'property list uchar x'"),
        (header("binary_middle_endian"), "'format binary_middle_endian 1.0'"),
        (b"ply\nformat ascii 2.0\nend_header\n", "'format ascii 2.0'"),
        (header("binary_little_endian", "element vertex 99999999999999999999", *DOUBLES), "it ends before"),
        (header("ascii", "element vertex 99999999999999999999", *DOUBLES), "it ends before"),
        (
            header("binary_little_endian", "element face 1", "property list char int i") + b"\xff",
            "a list of i has -1 entries",
        ),
        (
            header("binary_little_endian", "element face 1", "property list uint double i") + b"\xff" * 99,
            "it ends before|C int",
        ),
        (
            header("ascii", "element face 1", "property list char int i") + b"-1\n",
            "a list of i has '-1' entries",
        ),
        (header("ascii", "element vertex 1", "property float x") + b"1_0\n", "'1_0' is no number"),
        (header("ascii", "element vertex 1", "property float x") + b"\xff\n", "is no number"),
        (
            header("binary_little_endian", "element vertex 1", "property char x", "property char x") + b"12",
            "occurs more than once",
        ),
    ],
)
def test_what_is_refused(tmp_path, content, says):
    with pytest.raises(
        ValueError, match=rf"^Invalid cloud\. It must be a PLY file\. Given a\.ply: .*({says}).*\.$"
    ):
        read(tmp_path, content)
