"""Sets of indices in compressed rows: held-out data, validated data, or the rows of each datum."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress._validation import Integers

CoreSets: TypeAlias = tuple[NDArray[np.uintp], NDArray[np.uintp]]


@dataclass(frozen=True, eq=False, repr=False)
class IndexSets(Sequence[Integers]):
    """Sets of indices in compressed rows: a sequence of int64 arrays.

    `Scheme` and `LeastSquares.hat_blocks` check them.

    Parameters
    ----------
    offsets : (k + 1,) int64 array
        Set s is ``indices[offsets[s]:offsets[s + 1]]``.
    indices : (t,) int64 array
        Members of the sets, set after set, increasing in each set.

    Examples
    --------
    >>> import mexpress as mx
    >>> sets = mx.schemes.from_sets([[0, 1], [2]]).held_out
    >>> len(sets), sets[0], sets.sizes
    (2, array([0, 1]), array([2, 1]))
    """

    offsets: Integers
    indices: Integers

    @property
    def sizes(self) -> Integers:
        """Number of members of each set, (k,)."""
        return np.diff(self.offsets)

    @property
    def arrays(self) -> CoreSets:
        """Arguments for the core: (offsets, indices)."""
        return self.offsets.view(np.uintp), self.indices.view(np.uintp)

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def __getitem__(self, s: Any) -> Any:
        if isinstance(s, slice):
            return [self[i] for i in range(*s.indices(len(self)))]
        i = s + len(self) if s < 0 else s
        if not 0 <= i < len(self):
            raise IndexError(s)
        return self.indices[self.offsets[i] : self.offsets[i + 1]]

    def __iter__(self) -> Iterator[Integers]:
        return iter(np.split(self.indices, self.offsets[1:-1])) if len(self) else iter(())

    def __repr__(self) -> str:
        return f"IndexSets({len(self)} sets, {len(self.indices)} indices)"

    def some(self, which: Integers) -> IndexSets:
        """Some of the sets, in the order in which they are listed.

        Examples
        --------
        >>> list(packed([np.array([4, 6]), np.array([1]), np.array([0, 2, 3])]).some(np.array([2, 0])))
        [array([0, 2, 3]), array([4, 6])]
        """
        sizes = self.sizes[which]
        ends = np.concatenate([[0], np.cumsum(sizes)])
        members = np.repeat(self.offsets[which] - ends[:-1], sizes) + np.arange(ends[-1])
        return IndexSets(ends, self.indices[members])

    def restricted(self, some: Integers, n: int) -> IndexSets:
        """Sets of places among some of n indices, which increase; other indices are no members."""
        places = np.full(n, -1)
        places[some] = np.arange(len(some))
        members = places[self.indices]
        counts = np.concatenate([[0], np.cumsum(members >= 0)])
        return IndexSets(counts[self.offsets], members[members >= 0])


def compress(sets: Iterable[Integers]) -> IndexSets:
    """Index sets of index arrays; each is sorted."""
    return packed(np.sort(s) for s in sets)


def packed(sets: Iterable[Integers]) -> IndexSets:
    """Index sets of index arrays that increase."""
    arrays = list(sets)
    offsets = np.cumsum([0, *map(len, arrays)], dtype=np.int64)
    return IndexSets(offsets, np.concatenate([np.zeros(0, dtype=np.int64), *arrays]))


def singletons(n: int) -> IndexSets:
    """One set for each of n indices."""
    steps = np.arange(n + 1)
    return IndexSets(steps, steps[:-1])


def checked(sets: Any, name: str, bound: int | None = None) -> IndexSets:
    """Index sets from users, with indices from 0 to bound - 1."""
    if not isinstance(sets, IndexSets):
        check.refuse(name, "It must be IndexSets, as a scheme has them.", check.describe(sets), TypeError)
    return IndexSets(*check.sets(sets.offsets, sets.indices, name, bound))


def contained(sets: IndexSets, others: IndexSets) -> NDArray[np.bool_]:
    """Whether each index of the others, in order, is in the set with the same number."""
    last = max(len(sets.indices) - 1, 0)
    first, count = (np.repeat(each, others.sizes) for each in (sets.offsets[:-1], sets.sizes))
    end = first + count
    while count.any():  # bisection in all sets at once
        half = count // 2
        below = (count > 0) & (sets.indices[np.minimum(first + half, last)] < others.indices)
        first, count = np.where(below, first + half + 1, first), np.where(below, count - half - 1, half)
    found = first < end
    found[found] = sets.indices[first[found]] == others.indices[found]
    return found
