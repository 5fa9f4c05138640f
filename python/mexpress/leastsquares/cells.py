"""Data in cells: a cell is read as a whole, and known to the others as the triangle of its rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mexpress import _core
from mexpress._validation import Floats, Integers
from mexpress.caching import cached_property
from mexpress.leastsquares.rows import Rows


@dataclass(frozen=True, eq=False)
class Cells:
    """Data in some order, cut into cells of equal size; their triangles are merged two by two, and so on: a tree.

    Parameters
    ----------
    order : (n,) int64 array
        The data.
    size : int
        Data of a cell; the last may have fewer.
    triangles : (cells, q, q) array
        The triangle of the rows ``[A, b]`` of each cell.
    threads : int
        Largest number of threads.

    Examples
    --------
    >>> rows = Rows(np.arange(6.0)[:, None], np.ones(6), None, 1)
    >>> cells = Cells.of(rows, np.arange(6)[::-1], 2, 2, 1, lambda: None)
    >>> cells.data(np.array([0, 2]))
    array([5, 4, 1, 0])
    >>> cells.places(np.array([0, 2]), np.array([1, 5]))
    array([2, 0])
    >>> rest = cells.rest(np.array([0, 2]))
    >>> (rest.T @ rest).round(6)
    array([[13.,  5.],
           [ 5.,  2.]])
    """

    order: Integers
    size: int
    triangles: Floats
    threads: int

    @classmethod
    def of(
        cls,
        rows: Rows,
        order: Integers,
        size: int,
        together: int,
        threads: int,
        on_step: Callable[[], None],
    ) -> Cells:
        """Read all rows, some cells together, and reduce them to triangles; `on_step` is called each time."""
        q = rows.columns + rows.responses
        triangles = np.empty((-(-len(order) // size), q, q))
        firsts = range(0, len(triangles), together)
        calls = (
            (rows.of(order[first * size : (first + together) * size]), size * rows.coupling, threads)
            for first in firsts
        )
        for first, found in zip(firsts, rows.each(_core.triangles, calls), strict=True):
            triangles[first : first + together] = found
            on_step()
        return cls(order, size, triangles, threads)

    def __len__(self) -> int:
        return len(self.triangles)

    def having(self, data: Integers) -> Integers:
        """The cells of some data."""
        return self._places[data] // self.size

    def data(self, some: Integers) -> Integers:
        """Data of some cells, cell after cell: neighbours in this order are neighbours in memory."""
        return np.concatenate([self.order[k * self.size : (k + 1) * self.size] for k in some])

    def places(self, some: Integers, data: Integers) -> Integers:
        """Where some data are among those of some cells, which increase."""
        cells, within = np.divmod(self._places[data], self.size)
        return np.searchsorted(some, cells) * self.size + within

    @cached_property
    def _places(self) -> Integers:
        """Where each datum is in the order, (n,)."""
        places = np.empty_like(self.order)
        places[self.order] = np.arange(len(self.order))
        return places

    def rest(self, some: Integers) -> Floats:
        """Return the triangle of the rows of all other cells, (q, q), from the largest branches without these."""
        without: NDArray[np.bool_] = np.ones(len(self), dtype=np.bool_)
        without[some] = False
        branches = []
        for level in self._tree:
            pairs = np.append(without, [True] * (len(without) % 2)).reshape(-1, 2)
            above = np.asarray(pairs.all(axis=1) & (len(level) > 1))
            branches.append(level[without & ~np.repeat(above, 2)[: len(without)]])
            without = above
        stack = np.concatenate(branches).reshape(-1, self.triangles.shape[2])
        return merged(stack, self.threads)

    @cached_property
    def _tree(self) -> list[Floats]:
        """Triangles of cells, of pairs of cells, of pairs of pairs, and so on up to the one of all."""
        levels = [self.triangles]
        while len(levels[-1]) > 1:
            q = self.triangles.shape[2]
            levels.append(_core.triangles(levels[-1].reshape(-1, q), 2 * q, self.threads))
        return levels


def merged(stack: Floats, threads: int) -> Floats:
    """The triangle of rows, (q, q); of no rows, zeros."""
    q = stack.shape[1]
    return _core.triangles(stack, len(stack), threads)[0] if len(stack) else np.zeros((q, q))


def reduced(rows: Floats, threads: int) -> Floats:
    """The triangle of many rows, (q, q)."""
    return merged(_core.triangles(rows, 4096, threads).reshape(-1, rows.shape[1]), threads)
