"""Vertices of PLY files, in text or binary, with any other elements around them.

Examples
--------
>>> import tempfile
>>> lines = ["ply", "format ascii 1.0", "element vertex 2", "property float x", "property uchar red", "end_header"]
>>> with tempfile.TemporaryDirectory() as folder:
...     with open(f"{folder}/a.ply", "w") as file:
...         print(*lines, "0.5 255", "1.5 128", sep=chr(10), file=file)
...     read_vertices(Path(f"{folder}/a.ply"), "cloud")
{'x': array([0.5, 1.5]), 'red': array([255., 128.])}
"""

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress.io.words import as_numbers

_TYPES = {
    **{"char": "i1", "short": "i2", "int": "i4", "uchar": "u1", "ushort": "u2", "uint": "u4"},
    **{"int8": "i1", "int16": "i2", "int32": "i4", "int64": "i8", "float": "f4", "float32": "f4"},
    **{"uint8": "u1", "uint16": "u2", "uint32": "u4", "uint64": "u8", "double": "f8", "float64": "f8"},
}
_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_ENDS_EARLY = "it ends before its last element does"
_LENGTH = "length of "


class _Property(NamedTuple):
    """A number, or a list of numbers if there is a type for its length."""

    name: str
    type: np.dtype[Any]
    length: np.dtype[Any] | None = None


class _Element(NamedTuple):
    name: str
    rows: int
    properties: list[_Property]


def read_vertices(path: Path, name: str) -> dict[str, NDArray[Any]]:
    """Read the numbers at the vertices of a PLY file.

    Parameters
    ----------
    path : path
        Name of the file.
    name : str
        What messages call it.

    Returns
    -------
    dict of str to (n,) array
        By the names of the properties, lists left out; in text 64-bit numbers with all of their digits, whatever type
        is declared. Empty if there are no vertices.

    Raises
    ------
    ValueError
        If the file is damaged or no PLY file; the message says where.
    OSError
        If it cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> from mexpress.io.meshes import write_ply
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_ply(f"{folder}/a.ply", [[0, 0, 1], [1, 0, 1], [0, 1, 2]], [[0, 1, 2]])
    ...     read_vertices(Path(f"{folder}/a.ply"), "cloud")["z"]
    array([1., 1., 2.])
    """
    content = path.read_bytes()
    try:
        kind, elements, start = _header(content)
        read = _numbers_in_text if kind == "ascii" else _numbers_in_bytes
        return read(elements, content[start:])
    except ValueError as error:
        check.refuse(name, "It must be a PLY file.", f"{path.name}: {error}")


def _header(content: bytes) -> tuple[str, list[_Element], int]:
    """Return the format, the elements, and where their numbers begin."""
    first = re.match(rb"ply[ \t]*(\r\n|\n|\r)", content)
    if first is None:
        raise ValueError("its first line is not ply")
    last = re.search(
        rb"end_header[ \t]*" + first[1], content
    )  # numbers may begin with bytes that look like an end
    if last is None:
        raise ValueError("its header has no end")
    kind, elements = "", list[_Element]()
    for line in content[first.end() : last.start()].decode("latin-1").split(first[1].decode()):
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", word, "1.0"] if word in _ORDERS:
                kind = word
            case ["element", element, count] if count.isdecimal():
                elements.append(_Element(element, int(count), []))
            case ["property", word, name] if word in _TYPES and elements:
                elements[-1].properties.append(_Property(name, _type(word, kind)))
            case ["property", "list", size, word, name] if {size, word} <= _TYPES.keys() and elements:
                elements[-1].properties.append(_Property(name, _type(word, kind), _type(size, kind)))
            case _:
                raise ValueError(f"its header has the line {line.strip()!r}")
    if not kind:
        raise ValueError("its header names no format")
    return kind, elements, last.end()


def _type(word: str, kind: str) -> np.dtype[Any]:
    return np.dtype(_ORDERS.get(kind, "=") + _TYPES[word])


def _numbers_in_text(elements: list[_Element], body: bytes) -> dict[str, NDArray[Any]]:
    words, at, vertices = body.split(), 0, dict[str, NDArray[Any]]()
    for element in elements:
        if element.rows * len(element.properties) > len(words) - at:
            raise ValueError(_ENDS_EARLY)
        columns, at = _columns(element, words, at)
        if element.name == "vertex":
            vertices = {name: as_numbers(column) for name, column in columns.items()}
    return vertices


def _columns(element: _Element, words: list[bytes], at: int) -> tuple[dict[str, list[bytes]], int]:
    """Return the words of an element, by property and without lists, and where the next element begins."""
    names, width = [one.name for one in element.properties], len(element.properties)
    if all(one.length is None for one in element.properties):
        stop = at + width * element.rows
        return {name: words[at + k : stop : width] for k, name in enumerate(names)}, stop
    columns: dict[str, list[bytes]] = {one.name: [] for one in element.properties if one.length is None}
    for _ in range(element.rows):
        for one in element.properties:
            if at >= len(words):
                raise ValueError(_ENDS_EARLY)
            if one.length is None:
                columns[one.name].append(words[at])
                at += 1
            elif words[at].isdigit():
                at += 1 + int(words[at])
            else:
                raise ValueError(f"a list of {one.name} has {words[at].decode('latin-1')!r} entries")
    if at > len(words):
        raise ValueError(_ENDS_EARLY)
    return columns, at


def _numbers_in_bytes(elements: list[_Element], body: bytes) -> dict[str, NDArray[Any]]:
    at, vertices = 0, dict[str, NDArray[Any]]()
    for element in elements:
        runs = list(_runs(element.properties, element.rows, body, at))
        at += sum(run.nbytes for run in runs)
        if element.name == "vertex":
            names = [one.name for one in element.properties if one.length is None]
            vertices = {name: np.concatenate([np.empty(0), *(run[name] for run in runs)]) for name in names}
    return vertices


def _runs(properties: list[_Property], left: int, body: bytes, at: int) -> Iterator[NDArray[Any]]:
    """Yield the rows of an element, in arrays of rows whose lists are equally long."""
    window = 1 if any(one.length for one in properties) else left
    while left and properties:
        row = _row(tuple(properties), _lengths(properties, body, at))
        rows = _take(body, at, row, min(window, left, max(1, (len(body) - at) // row.itemsize)))
        unlike = np.zeros(len(rows), bool)
        for length in [name for name in row.names or () if name.startswith(_LENGTH)]:
            unlike |= rows[length] != rows[length][0]
        run = rows[: unlike.argmax()] if unlike.any() else rows
        yield run
        left, at = left - len(run), at + run.nbytes
        # Most faces are triangles: as long as rows are alike, twice as many are looked at.
        window = 2 * window if len(run) == window else 1


def _lengths(properties: list[_Property], body: bytes, at: int) -> tuple[int, ...]:
    """Return the lengths of a row's lists."""
    lengths = []
    for one in properties:
        size = 1
        if one.length:
            size = int(_take(body, at, one.length, 1)[0])
            if size < 0:
                raise ValueError(f"a list of {one.name} has {size} entries")
            lengths.append(size)
            at += one.length.itemsize
        at += size * one.type.itemsize
    return tuple(lengths)


@cache
def _row(properties: tuple[_Property, ...], lengths: tuple[int, ...]) -> np.dtype[Any]:
    """Return the type of a row whose lists have these lengths."""
    fields, sizes = list[Any](), iter(lengths)
    for one in properties:
        if one.length:
            fields += [(_LENGTH + one.name, one.length), (one.name, one.type, (next(sizes),))]
        else:
            fields.append((one.name, one.type))
    return np.dtype(fields)


def _take(body: bytes, at: int, kind: np.dtype[Any], count: int) -> NDArray[Any]:
    if at + count * kind.itemsize > len(body):
        raise ValueError(_ENDS_EARLY)
    return np.frombuffer(body, kind, count, at)
