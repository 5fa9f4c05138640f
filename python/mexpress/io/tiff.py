"""TIFF and GeoTIFF with plain samples: 8 to 64 bits, whole numbers or floats, in strips or tiles, each sample as it is.

Image libraries that are small change some of them: floats of 64 bits lose digits, gray that counts from white is turned
round, and signs are lost.

Examples
--------
>>> import struct
>>> entries = [(256, 4, 2), (257, 4, 1), (258, 3, 16), (259, 3, 1), (262, 3, 1), (273, 4, 8), (279, 4, 4), (339, 3, 2)]
>>> directory = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in entries)
>>> pixels = struct.pack("<2h", -7, 1500)
>>> read_tiff(struct.pack("<2sHI", b"II", 42, 12) + pixels + struct.pack("<H", 8) + directory + bytes(4)).pixels
array([[  -7, 1500]], dtype=int16)
"""

import io
import math
import re
import struct
import zlib
from collections.abc import Iterator
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mexpress.io.pillow import pillow
from mexpress.io.raster import Raster

Tags: TypeAlias = dict[int, list[Any]]

_WORDS = {1: "u1", 2: "S1", 3: "u2", 4: "u4", 13: "u4", 16: "u8"}
"""Types of entries that are wanted: whole numbers, and letters."""

_LETTERS = 2
_KINDS = {1: "u", 2: "i", 3: "f", 4: "u"}
_SAMPLES = {"u1", "u2", "u4", "u8", "i1", "i2", "i4", "i8", "f2", "f4", "f8"}
_SUBFILE, _WIDTH, _HEIGHT, _BITS, _COMPRESSION, _PHOTOMETRIC, _FILL_ORDER = 254, 256, 257, 258, 259, 262, 266
_STRIPS, _CHANNELS, _ROWS, _STRIP_SIZES, _PLANAR, _PREDICTOR = 273, 277, 278, 279, 284, 317
_TILE_WIDTH, _TILE_HEIGHT, _TILES, _TILE_SIZES, _SAMPLE_FORMAT = 322, 323, 324, 325, 339
_ORIENTATION, _GEOGRAPHY, _METADATA, _NO_DATA = 274, {33550, 34264, 34735}, 42112, 42113
_NONE, _LZW, _DEFLATE, _PACK_BITS = 1, 5, {8, 32946}, 32773
_HORIZONTAL, _FLOATING = 2, 3
_DENSEST = 3000
"""No codec makes more bytes of one."""


def is_tiff(content: bytes) -> bool:
    """Tell whether a file's first bytes are those of a TIFF.

    Examples
    --------
    >>> is_tiff(b"MM" + bytes([0, 42])), is_tiff(b"MMM")
    (True, False)
    """
    return content[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def read_tiff(content: bytes) -> Raster | None:
    """Read a TIFF.

    Parameters
    ----------
    content : bytes
        The file, of one image; smaller copies of it and masks do not count.

    Returns
    -------
    Raster or None
        None if its samples are not plain: colours of a palette, single bits, JPEG and the like.

    Raises
    ------
    ValueError
        If the file is damaged, or has several images; the message says how.
    ImportError
        If it is packed by LZW or PackBits, and Pillow, which unpacks it, is not installed.

    Examples
    --------
    >>> read_tiff(b"II" + bytes([42, 0]))
    Traceback (most recent call last):
        ...
    ValueError: it ends early
    """
    order = "<" if content[:1] == b"I" else ">"
    pages = [tags for tags in _directories(content, order) if not tags.get(_SUBFILE, [0])[0] & 0b101]
    if len(pages) != 1:
        raise ValueError(f"it has {len(pages)} images")
    tags = pages[0]
    sample = _sample(tags, order)
    if sample is None:
        return None
    no_data = _no_data(tags)
    pixels, placed = _pixels(content, tags, sample, no_data), bool(_GEOGRAPHY & tags.keys())
    return Raster(pixels, no_data, placed, _orientation(tags), scaling=_scaling(tags))


def _directories(content: bytes, order: str) -> Iterator[Tags]:
    big = b"+" in content[2:4]
    count, entry, word, inline = ("Q", "HHQ", "Q", 8) if big else ("H", "HHI", "I", 4)
    at, seen = _unpack(order + word, content, 8 if big else 4)[0], set[int]()
    while at and at not in seen:
        seen.add(at)
        (number,) = _unpack(order + count, content, at)
        at += struct.calcsize("=" + count)
        tags = Tags()
        for _ in range(number):
            tag, kind, length = _unpack(order + entry, content, at)
            at += struct.calcsize("=" + entry)
            tags[tag] = [0]
            if kind in _WORDS and (kind == _LETTERS) == (tag in {_METADATA, _NO_DATA}):
                dtype = np.dtype(order + _WORDS[kind])
                where = at if dtype.itemsize * length <= inline else _unpack(order + word, content, at)[0]
                if where + dtype.itemsize * length > len(content):
                    raise ValueError("it ends early")
                tags[tag] = np.frombuffer(content, dtype, length, where).tolist() or tags[tag]
            at += inline
        yield tags
        at = _unpack(order + word, content, at)[0]


def _unpack(form: str, content: bytes, at: int) -> tuple[Any, ...]:
    if at + struct.calcsize(form) > len(content):
        raise ValueError("it ends early")
    return struct.unpack_from(form, content, at)


def _sample(tags: Tags, order: str) -> np.dtype[Any] | None:
    """Return the type of the samples, or None if they are not plain."""
    bits, kinds = set(tags.get(_BITS, [1])), set(tags.get(_SAMPLE_FORMAT, [1]))
    word = f"{_KINDS.get(min(kinds), '?')}{min(bits) // 8}"
    plain = len(bits) == len(kinds) == 1 and min(bits) % 8 == 0 and word in _SAMPLES
    plain &= tags.get(_PHOTOMETRIC, [1])[0] in {0, 1, 2} and tags.get(_FILL_ORDER, [1])[0] == 1
    plain &= tags.get(_COMPRESSION, [1])[0] in {_NONE, _LZW, *_DEFLATE, _PACK_BITS}
    return np.dtype(order + word) if plain else None


def _no_data(tags: Tags) -> tuple[float, ...]:
    """Return GDAL's tag: a number in letters."""
    text = _letters(tags, _NO_DATA).strip(b"\0 ")
    return (_number(text, _NO_DATA, "no data"),) if text else ()


def _scaling(tags: Tags) -> tuple[float, float]:
    """Return what GDAL's metadata say that samples of the first band are multiplied by, and what is then added."""
    said = {b"scale": 1.0, b"offset": 0.0}
    for head, text in re.findall(rb"<Item\s([^<>]*)>([^<]*)", _letters(tags, _METADATA)):
        words = dict(re.findall(rb"""(\w+)\s*=\s*["']([^"']*)["']""", head))
        role = words.get(b"role")
        if role in said and words.get(b"sample") == b"0":
            said[role] = _number(text, _METADATA, role.decode())
    scale, offset = said.values()
    if not (math.isfinite(scale * offset) and scale):
        raise ValueError(f"its tag {_METADATA} has a scale of {scale:g} and an offset of {offset:g}")
    return scale, offset


def _orientation(tags: Tags) -> int:
    orientation = tags.get(_ORIENTATION, [1])[0]
    return int(orientation) if orientation in range(1, 9) else 1


def _letters(tags: Tags, tag: int) -> bytes:
    return b"".join(letter for letter in tags.get(tag, []) if letter)


def _number(text: bytes, tag: int, what: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"its tag {tag} ({what}) is {text.decode('latin-1')!r}, no number") from None


class _Layout(NamedTuple):
    """How an image is cut into blocks, strips or tiles, row after row and plane after plane."""

    width: int
    height: int
    channels: int
    planes: int
    block_width: int
    block_height: int
    tiled: bool

    @classmethod
    def of(cls, tags: Tags) -> "_Layout":
        width, height = tags.get(_WIDTH, [0])[0], tags.get(_HEIGHT, [0])[0]
        channels, tiled = tags.get(_CHANNELS, [1])[0], _TILES in tags
        planes = channels if tags.get(_PLANAR, [1])[0] == 2 else 1
        block_width = tags.get(_TILE_WIDTH, [0])[0] if tiled else width
        block_height = tags.get(_TILE_HEIGHT, [0])[0] if tiled else min(tags.get(_ROWS, [height])[0], height)
        layout = cls(width, height, channels, planes, block_width, block_height, tiled)
        if min(layout[:6]) < 1:
            raise ValueError(f"it has {width} x {height} pixels in blocks of {block_width} x {block_height}")
        return layout

    def blocks(self) -> Iterator[tuple[int, int, int, int]]:
        """Yield plane, first row, first column and height of each block."""
        for plane in range(self.planes):
            for row in range(0, self.height, self.block_height):
                for column in range(0, self.width, self.block_width):
                    rows = self.block_height if self.tiled else min(self.block_height, self.height - row)
                    yield plane, row, column, rows


def _pixels(content: bytes, tags: Tags, sample: np.dtype[Any], no_data: tuple[float, ...]) -> NDArray[Any]:
    layout = _Layout.of(tags)
    starts, sizes = tags.get(_TILES, tags.get(_STRIPS, [])), tags.get(_TILE_SIZES, tags.get(_STRIP_SIZES, []))
    across, down = -(-layout.width // layout.block_width), -(-layout.height // layout.block_height)
    if not len(starts) == len(sizes) == across * down * layout.planes:
        raise ValueError(f"it has {len(starts)} of {across * down * layout.planes} blocks")
    shape = layout.height, layout.width, layout.channels
    if math.prod(shape) * sample.itemsize > _DENSEST * len(content):
        raise ValueError("it ends early")
    image = np.empty(shape, sample.newbyteorder("="))
    for (plane, row, column, rows), start, size in zip(layout.blocks(), starts, sizes, strict=True):
        depth = layout.channels // layout.planes
        if start + size > len(content):
            raise ValueError("it ends early")
        part = image[row : row + rows, column : column + layout.block_width, plane : plane + depth]
        if size == 0:  # GDAL writes no block that has no data
            part[:] = no_data[0] if no_data else 0
        else:
            block = _block(content[start : start + size], tags, sample, (rows, layout.block_width, depth))
            part[:] = block[: part.shape[0], : part.shape[1]]
    return image if layout.channels > 1 else image[:, :, 0]


def _block(data: bytes, tags: Tags, sample: np.dtype[Any], shape: tuple[int, int, int]) -> NDArray[Any]:
    """Return the samples of a block (rows, columns, channels)."""
    compression, predictor = tags.get(_COMPRESSION, [1])[0], tags.get(_PREDICTOR, [1])[0]
    rows, columns, depth = shape
    width = columns * depth * sample.itemsize
    data = _unpacked(data, compression, rows, width)
    if len(data) < rows * width:
        raise ValueError("it ends early")
    if compression in {_NONE, _PACK_BITS} or predictor not in {_HORIZONTAL, _FLOATING}:
        return np.frombuffer(data, sample, rows * columns * depth).reshape(shape)
    if predictor == _HORIZONTAL:  # of the bits, whatever they mean
        steps = np.frombuffer(data, np.dtype(f"{sample.byteorder}u{sample.itemsize}"), rows * columns * depth)
        native = steps.astype(steps.dtype.newbyteorder("=")).reshape(shape)
        return native.cumsum(axis=1, dtype=native.dtype).view(sample.newbyteorder("="))
    # Differences of bytes, after those of a row were sorted: the highest byte of every sample first.
    steps = np.frombuffer(data, np.uint8, rows * width).reshape(rows, -1, depth)
    sorted_bytes = steps.cumsum(axis=1, dtype=np.uint8).reshape(rows, sample.itemsize, -1)
    return np.ascontiguousarray(sorted_bytes.swapaxes(1, 2)).view(sample.newbyteorder(">")).reshape(shape)


def _unpacked(data: bytes, compression: int, rows: int, width: int) -> bytes:
    """Return the bytes of a block: rows of so many."""
    if compression == _NONE:
        return data
    if compression in _DEFLATE:
        try:
            return zlib.decompressobj().decompress(data, rows * width)
        except zlib.error as error:
            raise ValueError(f"a block cannot be unpacked: {error}") from None
    # To Pillow the bytes are a gray image of its own, whose samples nothing changes.
    entries = [(_WIDTH, width), (_HEIGHT, rows), (_BITS, 8), (_COMPRESSION, compression), (_PHOTOMETRIC, 1)]
    entries += [(_STRIPS, 122), (_CHANNELS, 1), (_ROWS, rows), (_STRIP_SIZES, len(data))]
    directory = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in entries)
    gray = struct.pack("<2sHIH", b"II", 42, 8, len(entries)) + directory + bytes(4) + data
    try:
        with pillow().open(io.BytesIO(gray)) as image:
            unpacked: bytes = image.tobytes()
    except (OSError, SyntaxError) as error:
        raise ValueError(f"a block cannot be unpacked: {error}") from None
    return unpacked
