"""Regular grids of control points over the bounding box of the data, with cells as square as possible.

The first grid has one cell; each next grid has one more line, across the longer side of the cells, or across x if they
are square.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.geometry import Region, grid_points


def grid_counts(region: Floats, largest: int, ring: int = 0) -> list[int]:
    """Return the numbers of control points of the grids over a region's bounding box, up to a largest number.

    The first number is present even if it is larger. Every grid has `ring` lines outside the box on each side.

    Examples
    --------
    >>> grid_counts(np.array([[0.0, 0.0], [3.0, 1.0]]), 12)
    [4, 6, 8, 10]
    """
    counts: list[int] = []
    for columns, rows in _sizes(region, ring):
        if counts and columns * rows > largest:
            break
        counts.append(columns * rows)
    return counts


def grid(points: ArrayLike | Region, count: int, ring: int = 0) -> Floats:
    """Return the control points, (l, 2), of the grid whose number is nearest to a count, row after row.

    The grid fills the bounding box of the points, with `ring` more lines outside it on each side. The count is 3 or
    more; of two grids equally near to it, the smaller is returned.

    Examples
    --------
    >>> grid([[0, 0], [4, 0], [4, 2], [0, 2]], 5)
    array([[0., 0.], [4., 0.], [0., 2.], [4., 2.]])
    """
    corners, count = Region.of(points).corners, check.count(count, "count", 3)
    chosen = (0, 0)
    for size in _sizes(corners, ring):
        nearer = abs(size[0] * size[1] - count) < abs(chosen[0] * chosen[1] - count)
        if chosen != (0, 0) and not nearer:
            break
        chosen = size
    x, y = (_lines(corners[:, b], chosen[b], ring) for b in range(2))
    return grid_points(x, y)


def _sizes(region: Floats, ring: int) -> Iterator[tuple[int, int]]:
    """Numbers of columns and rows of one grid after another."""
    columns, rows = 1, 1
    width, height = np.ptp(region, axis=0).tolist()
    rounding = 4 * float(np.spacing(np.abs(region).max()))  # which must not decide in a square
    while True:
        yield columns + 1 + 2 * ring, rows + 1 + 2 * ring
        if height / rows > (width + rounding) / columns:
            rows += 1
        else:
            columns += 1


def _lines(coordinates: Floats, count: int, ring: int) -> Floats:
    low, high = coordinates.min(), coordinates.max()
    step = (high - low) / (count - 1 - 2 * ring)
    return np.asarray(np.linspace(low - ring * step, high + ring * step, count))
