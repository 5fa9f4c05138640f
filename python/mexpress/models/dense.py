"""A map of the plane at every pixel of an image: interpolated where that is exact enough, evaluated elsewhere.

The image is cut into square blocks. In a block the map is interpolated bicubically from 4 x 4 places, and compared with
its exact values at 5 x 5 others. Where they differ by more than a third of the tolerance, the block is cut in four, and
pixels of the smallest blocks are evaluated one by one: at folds, kinks, and where the map ends.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mexpress._validation import Floats, Integers

_SIDES = (128, 64, 32, 16)
"""Pixels along the side of a block: larger ones save little, and smaller ones have few more pixels than places."""

_EMPTY = 16
"""Largest side of a block that is believed to have no value, since it has none at any place: an edge may cut it."""

_DETAILS = 4
"""A block with more details of the map than that is cut in any case: places do not tell what is between them."""

_SAFETY = 1 / 3
"""Part of the tolerance that may be seen at the places that are checked, since the worst one is hardly among them: at
kinks the error was up to 2.5 times as large."""

_AT_ONCE = 1 << 18
"""Positions that are evaluated at once, and pixels that are interpolated at once."""

_NODES = np.cos((2 * np.arange(4) + 1) * np.pi / 8)
_CHECKED = np.cos(np.arange(5) * np.pi / 4)


def dense(
    function: Callable[[Floats], Floats],
    width: int,
    height: int,
    tolerance: float,
    details: Floats,
    dtype: type[np.floating],
) -> NDArray[np.floating]:
    """Return a map of the plane at every pixel of an image.

    Parameters
    ----------
    function : callable
        The map, of positions (k, 2) to values (k, 2); NaN where it has none.
    width, height : int
        Size of the image; the centre of the first pixel is (0, 0).
    tolerance : float
        Largest distance of a value from the exact one; with 0, every pixel is evaluated.
    details : ndarray, (l, 2)
        Places around which the map varies; between them it is smooth.
    dtype : type
        float32 or float64.

    Returns
    -------
    ndarray, (2, height, width)
        First values, then second ones.

    Examples
    --------
    >>> positions = dense(lambda points: 1e-3 * points**2, 300, 200, 0.01, np.empty((0, 2)), np.float64)
    >>> positions[:, 150, 250].round(1)
    array([62.5, 22.5])
    """
    sides = [side for side in _SIDES if side <= max(width, height)] if tolerance else []
    side = sides[0] if sides else 1
    rows, columns = -(-height // side), -(-width // side)
    values = np.empty((2, side * rows, side * columns), dtype)
    cells = np.column_stack([part.ravel() for part in np.indices((rows, columns))])
    for side, smaller in pairwise([*sides, 1]):
        cells = _cut(_interpolated(values, function, cells, side, tolerance, details), side // smaller)
        cells = cells[(cells * smaller < (height, width)).all(axis=1)]
    for some in _chunks(cells, 1):
        values[:, some[:, 0], some[:, 1]] = function(some[:, ::-1].astype(np.float64)).T
    positions = np.empty((2, height, width), dtype)
    for lines in _chunks(np.arange(height), width):  # one copy of all would not hear Ctrl-C
        part = slice(lines[0], lines[-1] + 1)
        positions[:, part] = values[:, part, :width]
    return positions


def _interpolated(
    values: NDArray[np.floating],
    function: Callable[[Floats], Floats],
    cells: Integers,
    side: int,
    tolerance: float,
    details: Floats,
) -> Integers:
    """Fill the blocks, (b, 2) as row and column, where interpolation is good enough, and return the others."""
    blocks = values.reshape(2, values.shape[1] // side, side, values.shape[2] // side, side).swapaxes(2, 3)
    plain = cells[~_crowded(cells, side, details)]
    rest = [cells[_crowded(cells, side, details)]]
    for some in _chunks(plain, len(_NODES) ** 2 + len(_CHECKED) ** 2):
        nodes, known = _at(function, some, side, _NODES), _at(function, some, side, _CHECKED)
        with np.errstate(invalid="ignore"):
            error = np.hypot(*np.moveaxis(_between(nodes, _CHECKED) - known, 1, 0)).max(axis=(1, 2))
        good = error <= _SAFETY * tolerance  # not where one of them is NaN
        for most in _chunks(np.flatnonzero(good), side**2):
            row, column = some[most].T
            blocks[:, row, column] = np.moveaxis(_between(nodes[most], _pixels(side)), 1, 0)
        if side <= _EMPTY:
            empty = np.isnan(nodes).all(axis=(1, 2, 3)) & np.isnan(known).all(axis=(1, 2, 3))
            blocks[:, *some[empty].T] = np.nan
            good |= empty
        rest.append(some[~good])
    return np.concatenate(rest)


def _at(function: Callable[[Floats], Floats], cells: Integers, side: int, places: Floats) -> Floats:
    """Return the function at places of blocks that are from -1 to 1 across them, (b, 2, rows, columns)."""
    along = (side - 1) / 2 * (places + 1)
    y, x = (side * cells[:, axis, None] + along for axis in (0, 1))
    shape = len(cells), len(places), len(places)
    points = np.stack([np.broadcast_to(x[:, None, :], shape), np.broadcast_to(y[:, :, None], shape)], axis=-1)
    return np.moveaxis(function(points.reshape(-1, 2)).reshape(*shape, 2), 3, 1)


def _between(nodes: Floats, places: Floats) -> Floats:
    """Return the bicubic polynomials of values at the nodes, (b, 2, 4, 4), at other places, (b, 2, rows, columns)."""
    shares = np.stack(
        [np.prod((places[:, None] - others) / (node - others), axis=1) for node, others in _PAIRS]
    )
    return np.asarray(shares.T @ (nodes @ shares))


_PAIRS = [(node, np.delete(_NODES, k)) for k, node in enumerate(_NODES)]


def _pixels(side: int) -> Floats:
    return np.linspace(-1, 1, side)


def _crowded(cells: Integers, side: int, details: Floats) -> NDArray[np.bool_]:
    """Return which blocks have too many details."""
    if not len(cells):
        return np.zeros(0, dtype=np.bool_)
    shape = cells.max(axis=0) + 1
    with np.errstate(invalid="ignore"):
        place = np.floor((details[:, ::-1] + 0.5) / side)
        place = place[((place >= 0) & (place < shape)).all(axis=1)].astype(np.int64)
    number = np.bincount(np.ravel_multi_index(tuple(place.T), tuple(shape)), minlength=shape.prod())
    return np.asarray(number[np.ravel_multi_index(tuple(cells.T), tuple(shape))] > _DETAILS)


def _cut(cells: Integers, number: int) -> Integers:
    """Return the parts of blocks of which each is cut into so many along both axes."""
    parts = np.column_stack([part.ravel() for part in np.indices((number, number))])
    return (number * cells[:, None] + parts).reshape(-1, 2)


def _chunks(array: Integers, size: int) -> list[Integers]:
    """Return parts of an array of rows that mean so many positions each."""
    step = max(1, _AT_ONCE // size)
    return [array[first : first + step] for first in range(0, len(array), step)]
