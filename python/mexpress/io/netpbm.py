"""Netpbm's images, and PFM, which is the same for floats: their samples as they stand in the file.

Image libraries stretch samples to 8 or 16 bits, by 65535 over the largest sample that the file allows.

Examples
--------
>>> read_netpbm(b"P2 3 2 4095 1500 1501 1502 0 4095 7")
array([[1500, 1501, 1502],
       [   0, 4095,    7]], dtype=uint16)
"""

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mexpress.io.words import as_numbers

_COMMENT = rb"#[^\r\n]*"
_GAP = rb"(?:\s|" + _COMMENT + rb"[\r\n])+"
_HEADER = re.compile(rb"P([2356fF])" + 2 * (_GAP + rb"(\d+)") + _GAP + rb"([^\s#]+)(?:\r\n|\s)")
_COLOUR = b"36F"


def is_netpbm(content: bytes) -> bool:
    """Tell whether a file's first bytes are those of an image that `read_netpbm` reads.

    Examples
    --------
    >>> is_netpbm(b"P5 64 48 4095 ..."), is_netpbm(b"P4 64 48 ...")
    (True, False)
    """
    return re.match(rb"P[2356fF][\s#]", content) is not None


def read_netpbm(content: bytes) -> NDArray[Any]:
    """Read a PGM, PPM or PFM file.

    Parameters
    ----------
    content : bytes
        The file: P2 or P5 (gray), P3 or P6 (colour), Pf or PF (floats, gray or colour).

    Returns
    -------
    ndarray, (height, width) or (height, width, 3)
        The samples, rows from the top: uint8 or uint16 as the file's largest sample calls for, or float32. They are
        multiplied by nothing, neither by that largest sample nor by PFM's scale, which tells the order of bytes.

    Raises
    ------
    ValueError
        If the file is damaged; the message says how.

    Examples
    --------
    >>> import struct
    >>> read_netpbm(b"Pf 1 2 -1.0 " + struct.pack("<2f", 0.25, 0.75))  # the last row comes first
    array([[0.75],
           [0.25]], dtype=float32)
    """
    header = _HEADER.match(content)
    if header is None:
        raise ValueError("its header is damaged")
    kind, width, height = header[1], int(header[2]), int(header[3])
    size, top = width * height * (3 if kind in _COLOUR else 1), float(as_numbers([header[4]])[0])
    if size == 0:
        raise ValueError(f"it has {width} x {height} pixels")
    body = content[header.end() :]
    if kind in b"fF":
        samples = _take(body, np.dtype("<f4" if top < 0 else ">f4"), size).astype(np.float32)
    elif not 1 <= top <= 65535:
        raise ValueError(f"its largest sample is {top:g}, which is not from 1 to 65535")
    elif kind in b"23":
        samples = _plain(body, size, top)
    else:
        samples = _take(body, np.dtype("u1" if top < 256 else ">u2"), size)
        samples = samples.astype(samples.dtype.newbyteorder("="))
    shape = (height, width, 3) if kind in _COLOUR else (height, width)
    return samples.reshape(shape)[:: -1 if kind in b"fF" else 1]


def netpbm_white(content: bytes) -> int | None:
    """Return the largest sample that a PGM or PPM file allows, which is white; None of floats.

    Examples
    --------
    >>> netpbm_white(b"P2 3 2 4095 1500 1501 1502 0 4095 7")
    4095
    """
    header = _HEADER.match(content)
    return None if header is None or header[1] in b"fF" else int(as_numbers([header[4]])[0])


def netpbm(pixels: NDArray[Any], white: int) -> bytes:
    """Return a PGM or PPM file.

    Parameters
    ----------
    pixels : ndarray, (height, width) or (height, width, 3)
        Whole numbers from 0 to white, as they come to stand in the file.
    white : int
        The largest sample that the file allows, at most 65535.

    Examples
    --------
    >>> netpbm(np.array([[65, 66]], np.uint8), 100).split()
    [b'P5', b'2', b'1', b'100', b'AB']
    """
    height, width = pixels.shape[:2]
    header = f"P{5 if pixels.ndim == 2 else 6}\n{width} {height}\n{white}\n"
    return header.encode() + pixels.astype("u1" if white < 256 else ">u2").tobytes()


def _take(body: bytes, kind: np.dtype[Any], count: int) -> NDArray[Any]:
    if count * kind.itemsize > len(body):
        raise ValueError(f"it has {len(body)} bytes of samples, not {count * kind.itemsize}")
    return np.frombuffer(body, kind, count)


def _plain(body: bytes, count: int, top: float) -> NDArray[Any]:
    words = re.sub(_COMMENT, b"", body).split()
    if count > len(words):
        raise ValueError(f"it has {len(words)} samples, not {count}")
    samples = as_numbers(words[:count])
    if not ((samples >= 0) & (samples <= top) & (samples == np.floor(samples))).all():
        raise ValueError(f"its samples are not all whole numbers from 0 to {top:g}")
    return samples.astype(np.uint8 if top < 256 else np.uint16)
