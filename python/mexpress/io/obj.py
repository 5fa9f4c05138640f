r"""Vertices of Wavefront OBJ files, whatever else is in them.

Examples
--------
>>> read_obj_vertices(b"# two points\nv 0 0.5 1\nvn 0 0 1\nv 1 0.5 2 0.2 0.2 0.2\n")
array([[0. , 0.5, 1. ],
       [1. , 0.5, 2. ]])
"""

import re

from mexpress._validation import Floats
from mexpress.io.words import as_numbers

_VERTEX = b"v"


def read_obj_vertices(content: bytes) -> Floats:
    r"""Read the positions of vertices, without colours and weights.

    Parameters
    ----------
    content : bytes
        The file.

    Returns
    -------
    ndarray, (n, 3)
        In the order of the file, also of vertices that no face has; n may be 0.

    Raises
    ------
    ValueError
        If a vertex has no three numbers; the message names the line.

    Examples
    --------
    >>> read_obj_vertices(b"v 1 2\n")
    Traceback (most recent call last):
        ...
    ValueError: line 1 has a vertex of 2 numbers
    """
    numbers: list[bytes] = []
    for line, text in enumerate(re.sub(rb"\\\r?\n", b" ", content).splitlines(), start=1):
        word, *rest = text.partition(b"#")[0].split() or [b""]
        if word != _VERTEX:
            continue
        if len(rest) < 3:
            raise ValueError(f"line {line} has a vertex of {len(rest)} numbers")
        numbers += rest[:3]
    return as_numbers(numbers).reshape(-1, 3)
