"""Numbers in the words of a text.

Examples
--------
>>> as_numbers(b"1 2.5 nan".split())
array([1. , 2.5, nan])
"""

import numpy as np

from mexpress._validation import Floats


def as_numbers(words: list[bytes]) -> Floats:
    """Return the numbers that words are.

    Raises
    ------
    ValueError
        If one is none.

    Examples
    --------
    >>> as_numbers([b"1_000"])
    Traceback (most recent call last):
        ...
    ValueError: '1_000' is no number
    """
    try:
        if not any(b"_" in word for word in words):  # which Python's own grammar allows
            return np.array(words, dtype=np.bytes_).astype(np.float64)
    except ValueError:
        pass
    raise ValueError(f"{next(filter(_is_no_number, words)).decode('latin-1')!r} is no number")


def _is_no_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return True
    return b"_" in word
