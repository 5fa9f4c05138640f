"""Triangle meshes in files that every 3D program reads.

Examples
--------
>>> import tempfile
>>> from pathlib import Path
>>> with tempfile.TemporaryDirectory() as folder:
...     write_obj(f"{folder}/a.obj", [[0, 0, 1], [1, 0, 1], [0, 1, 1]], [[0, 1, 2]])
...     print(Path(f"{folder}/a.obj").read_text().splitlines()[-1])
f 1 2 3
"""

import os

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.io.archives import replacing

_MOST_VERTICES = 2**31 - 1
"""PLY counts vertices in 32 bits."""


def write_ply(
    path: str | os.PathLike[str], vertices: ArrayLike, triangles: ArrayLike, normals: ArrayLike | None = None
) -> None:
    """Write a mesh as binary PLY.

    Parameters
    ----------
    path : str or path
        Name of the file, taken as it is. A file of this name is replaced once the new one is complete.
    vertices : array_like, (n, 3)
        Positions; kept as 64-bit numbers, for which coordinates of maps are not too large.
    triangles : array_like of int, (t, 3)
        Indices of vertices, counter-clockwise seen from outside.
    normals : array_like, (n, 3), optional
        Unit normals at the vertices; kept as 32-bit numbers.

    Raises
    ------
    ValueError
        If the shapes do not fit, a number is not finite, or a triangle has no such vertex.
    OSError
        If the file cannot be written; an older file of this name is then untouched.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_ply(f"{folder}/a.ply", [[0, 0, 1], [1, 0, 1], [0, 1, 1]], [[0, 1, 2]])
    ...     print(Path(f"{folder}/a.ply").read_bytes()[:36].decode())
    ply
    format binary_little_endian 1.0
    """
    points, faces = _checked(vertices, triangles)
    columns = [(name, "<f8", "double", points[:, k]) for k, name in enumerate("xyz")]
    if normals is not None:
        directions = _of_vertices(normals, "normals", len(points), 3)
        columns += [(f"n{name}", "<f4", "float", directions[:, k]) for k, name in enumerate("xyz")]
    rows = np.empty(len(points), dtype=[(name, kind) for name, kind, _, _ in columns])
    for name, _, _, column in columns:
        rows[name] = column
    corners = np.empty(len(faces), dtype=[("count", "u1"), ("indices", "<i4", 3)])
    corners["count"], corners["indices"] = 3, faces
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(points)}",
        *(f"property {word} {name}" for name, _, word, _ in columns),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header\n",
    ]
    with replacing(path) as file:
        file.writelines(["\n".join(header).encode(), rows.tobytes(), corners.tobytes()])


def write_obj(
    path: str | os.PathLike[str],
    vertices: ArrayLike,
    triangles: ArrayLike,
    normals: ArrayLike | None = None,
    texture: ArrayLike | None = None,
) -> None:
    """Write a mesh as Wavefront OBJ.

    Parameters
    ----------
    path, vertices, triangles, normals
        As for `write_ply`; numbers are written with all their digits.
    texture : array_like, (n, 2), optional
        Positions of the vertices in a picture: (0, 0) is its lower left, (1, 1) its upper right corner.

    Raises
    ------
    ValueError
        If the shapes do not fit, a number is not finite, or a triangle has no such vertex.
    OSError
        If the file cannot be written; an older file of this name is then untouched.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_obj(f"{folder}/a.obj", [[0, 0, 1], [1, 0, 1], [0, 1, 1]], [[0, 1, 2]], normals=[[0, 0, 1]] * 3)
    ...     print(Path(f"{folder}/a.obj").read_text().splitlines()[-1])
    f 1//1 2//2 3//3
    """
    points, faces = _checked(vertices, triangles)
    lines, corner = _lines("v", points), "{0}"
    if texture is not None:
        lines += _lines("vt", _of_vertices(texture, "texture", len(points), 2))
        corner = "{0}/{0}"
    if normals is not None:
        lines += _lines("vn", _of_vertices(normals, "normals", len(points), 3))
        corner = "{0}/{0}/{0}" if texture is not None else "{0}//{0}"
    names = [corner.format(k) for k in range(1, len(points) + 1)]
    lines += [f"f {names[a]} {names[b]} {names[c]}\n" for a, b, c in faces.tolist()]
    with replacing(path) as file:
        file.write("".join(lines).encode())


def _checked(vertices: ArrayLike, triangles: ArrayLike) -> tuple[Floats, Integers]:
    points = check.matrix(vertices, "vertices")
    if points.shape[1] != 3 or len(points) > _MOST_VERTICES:
        check.refuse("vertices", "They must have shape (n, 3).", f"shape {points.shape}")
    rule = f"They must be rows of three indices from 0 to {len(points) - 1}."
    faces = check.array(triangles, "triangles", rule, "iu")
    if faces.size == 0:
        return points, np.empty((0, 3), dtype=np.int64)
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.min() < 0 or faces.max() >= len(points):
        check.refuse("triangles", rule, check.describe(triangles))
    return points, faces.astype(np.int64)


def _of_vertices(value: ArrayLike, name: str, count: int, width: int) -> Floats:
    array = check.matrix(value, name)
    if array.shape != (count, width):
        check.refuse(name, f"They must have shape ({count}, {width}).", f"shape {array.shape}")
    return array


def _lines(word: str, rows: Floats) -> list[str]:
    return [f"{word} {' '.join(map(repr, row))}\n" for row in rows.tolist()]
