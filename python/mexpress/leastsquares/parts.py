"""Pairs in parts whose held-out data are near each other, so that few rows are read for a part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mexpress import _core
from mexpress._validation import Floats, Integers
from mexpress.caching import cached_property
from mexpress.index_sets import CoreSets, IndexSets
from mexpress.leastsquares.cells import Cells
from mexpress.schemes import LazyNeighbourhoods, Scheme, checked_radius


@dataclass(frozen=True, eq=False)
class Around:
    """Each pair holds out all data within a distance of one, which it validates.

    Parameters
    ----------
    points : (d, k) array
        Positions of the data.
    centres : (t,) uintp array
        The data that are validated.
    reach : float
        The distance.
    """

    points: Floats
    centres: NDArray[np.uintp]
    reach: float

    def search(self, threads: int) -> _core.LazyNeighbourhoods:
        """Return what finds them for the core."""
        return _core.LazyNeighbourhoods.within(self.points, self.reach, threads, self.centres)


Held: TypeAlias = Around | tuple[CoreSets, CoreSets]
"""What each pair holds out and validates."""


@dataclass(frozen=True, eq=False)
class Part:
    """Some pairs of a scheme, and the data that are read for them.

    Parameters
    ----------
    pairs : (k,) int64 array
        The pairs.
    cells : (c,) int64 array
        Cells that have all data that the pairs hold out.
    data : (d,) int64 array
        The data of these cells, in their order.
    held : Held
        What each pair holds out and validates, over these data.
    """

    pairs: Integers
    cells: Integers
    data: Integers
    held: Held


def predicted(
    block: Floats,
    rest: Floats,
    pairs: Integers,
    held: Held,
    coupling: int,
    columns: int,
    counted: int,
    threads: int,
) -> tuple[Floats, Integers]:
    """Weighted prediction residuals of the validated rows of a part, (t, r), and the pairs that lose rank.

    Parameters
    ----------
    block : (k, p + r) array
        Weighted rows ``[A, b]`` of the data of the part.
    rest : (q, p + r) array
        The triangle of all other rows.
    pairs, held
        Those of the part.
    coupling, columns, counted, threads : int
        Rows of a datum, p, all rows, and the largest number of threads.
    """
    rows = np.concatenate([block, rest[rest.any(axis=1)]])
    design, responses = (np.ascontiguousarray(each) for each in np.split(rows, [columns], axis=1))
    ends = np.concatenate([np.arange(0, len(block), coupling), np.arange(len(block), len(rows) + 1)])
    factor = _core.Factor((design, responses, None, np.zeros((0, columns))), threads, counted)
    order = np.arange(len(pairs)).view(np.uintp)
    data = IndexSets(ends, np.arange(len(rows)))
    sets = held.search(threads) if isinstance(held, Around) else held
    ((_, residuals, _, _, undefined),) = factor.predict([(sets, order)], data.arrays, threads)
    return residuals, pairs[undefined]


@dataclass(frozen=True, eq=False)
class Parts:
    """All pairs of a scheme in parts.

    Parameters
    ----------
    scheme : Scheme
        What is held out.
    cells : Cells
        Data in the order of `data_order`.
    together : int
        Cells of a part, but for those that are near it.
    threads : int
        Largest number of threads.
    """

    scheme: Scheme
    cells: Cells
    together: int
    threads: int

    @cached_property
    def pairs(self) -> list[Integers]:
        """The pairs of each part."""
        order = self.scheme.visiting_order
        if isinstance(self.scheme, LazyNeighbourhoods):
            size = self.together * self.cells.size
            return [order[first : first + size] for first in range(0, len(order), size)]
        held, validated = self.scheme.held_out, self.scheme.validated
        order = order[held.sizes[order] > 0]
        # By a datum in the middle, as a rule: pairs of a part then reach as far as they must, and no farther.
        alone = validated.sizes[order] == 0
        datum = held.indices[held.offsets[order]]
        datum[~alone] = validated.indices[validated.offsets[order[~alone]]]
        group = self.cells.having(datum) // self.together
        by_group = np.argsort(group, kind="stable")
        return np.split(order[by_group], np.flatnonzero(np.diff(group[by_group])) + 1) if len(order) else []

    def __len__(self) -> int:
        return len(self.pairs)

    def __getitem__(self, k: int) -> Part:
        scheme, pairs = self.scheme, self.pairs[k]
        if isinstance(scheme, LazyNeighbourhoods):
            return self._within(scheme, pairs) if scheme.how == "within" else self._nearest(scheme, pairs)
        out = scheme.held_out.some(pairs)
        validated = out if scheme.validated is scheme.held_out else scheme.validated.some(pairs)
        return self._listed(pairs, out, validated)

    def _within(self, scheme: LazyNeighbourhoods, own: Integers) -> Part:
        points, reach = scheme.places.points, checked_radius(scheme.reach)
        near = _near(points[own], reach, self._corners)
        data = self.cells.data(near)
        centres = self.cells.places(near, own).view(np.uintp)
        return Part(own, near, data, Around(points[data], centres, reach))

    def _nearest(self, scheme: LazyNeighbourhoods, own: Integers) -> Part:
        out = IndexSets(*scheme.search.listed(own.view(np.uintp), self.threads))
        return self._listed(own, out, IndexSets(np.arange(len(own) + 1), own))

    def _listed(self, pairs: Integers, out: IndexSets, validated: IndexSets) -> Part:
        near = np.unique(self.cells.having(out.indices))
        data = self.cells.data(near)
        held, scored = (
            IndexSets(some.offsets, self.cells.places(near, some.indices)).arrays for some in (out, validated)
        )
        return Part(pairs, near, data, (held, scored))

    @cached_property
    def _corners(self) -> tuple[Floats, Floats]:
        """Lowest and highest coordinates in each cell, (cells, d)."""
        assert isinstance(self.scheme, LazyNeighbourhoods)
        points = self.scheme.places.points[self.cells.order]
        firsts = np.arange(0, len(points), self.cells.size)
        return np.minimum.reduceat(points, firsts), np.maximum.reduceat(points, firsts)


def data_order(scheme: Scheme) -> Integers:
    """An order of the data in which those of a pair are near each other, (n,): that in which pairs hold them out."""
    if isinstance(scheme, LazyNeighbourhoods):
        return scheme.order
    held = scheme.held_out.some(scheme.visiting_order).indices
    known, first = np.unique(held, return_index=True)
    others = np.ones(scheme.n_data, dtype=np.bool_)
    others[known] = False
    return np.concatenate([known[np.argsort(first)], np.flatnonzero(others)])


def _near(points: Floats, reach: float, corners: tuple[Floats, Floats]) -> Integers:
    """Cells that may have a point within a distance of some points."""
    low, high = corners
    reach *= 1 + 1e-9  # rounding must leave out no cell
    meets = (high >= points.min(axis=0) - reach) & (low <= points.max(axis=0) + reach)
    return np.flatnonzero(meets.all(axis=1))
