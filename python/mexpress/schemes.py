"""Schemes: lists of (held out, validated) pairs of sets of data.

A datum is one physical item (a match, a point, a pixel) with one or more rows of the design. Every builder returns a
`Scheme` for `LeastSquares.cross_validate`.

Examples
--------
>>> import mexpress as mx
>>> scheme = mx.schemes.from_sets([[0, 1, 2], [3, 4]], validated=[[1], [3, 4]])
>>> mx.LeastSquares([[1.0]] * 5, [1.0, 2.0, 3.0, 4.0, 5.0]).cross_validate(scheme).residuals
array([-2.5,  2. ,  3. ])
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _core
from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.caching import cached_property
from mexpress.index_sets import CoreSets, IndexSets, checked, compress, contained, packed, singletons

__all__ = [
    "IndexSets",
    "Scheme",
    "buffered",
    "delaunay",
    "exclusion_radius",
    "from_distance",
    "from_sets",
    "from_splits",
    "k_fold",
    "leave_one_out",
    "leave_p_out",
    "matched",
    "nearest",
    "random_sampling",
]


def __dir__() -> list[str]:
    return sorted(__all__)


# A list of more indices than this is probably a mistake.
MOST_INDICES = 100_000_000

_MOST_LISTED = 10_000_000
"""Members of neighbourhoods above which these are found when needed: a list takes as long to make as to use."""

_CELLS = 65_534
"""Cells along the largest extent of data, which are put in order by them; 65,536 at most."""

_ROUNDING = 4e-13
"""Fraction of a radius by which rounding may move a distance: data on a grid are often just at a radius."""

SHARE_RULE = "It must be a share above 0 and at most 1."


@dataclass(frozen=True, eq=False, repr=False)
class Scheme:
    """Pairs of held-out and validated data.

    Parameters
    ----------
    n_data : int
        Number of data.
    held_out : IndexSets
        Data of each pair that are left out of the fit.
    validated : IndexSets
        Data of each pair whose prediction is scored: a subset of the held-out data.
    order : (k,) int array, optional
        An order of the pairs in which successive pairs share most held-out data. It saves time with large
        neighbourhoods and does not change the result.

    Raises
    ------
    ValueError, TypeError
        If an index is not below n_data, a set does not increase, a validated datum is not held out, or the order is
        not an order of the pairs.

    Examples
    --------
    >>> import mexpress as mx
    >>> mx.schemes.k_fold(10, 5, seed=0)
    Scheme(5 pairs over 10 data, 2 held out)
    """

    n_data: int
    held_out: IndexSets
    validated: IndexSets
    order: Integers | None = None

    def __post_init__(self) -> None:
        n = check.count(self.n_data, "n_data", 1)
        held = validated = checked(self.held_out, "held_out", n)
        if self.validated is not self.held_out:
            validated = checked(self.validated, "validated", n)
            if len(held) != len(validated):
                rule = f"It must have one set for each of the {len(held)} that are held out."
                check.refuse("validated", rule, f"{len(validated)} sets")
            _expect_held(held, validated)
        order = self.order
        if order is not None:
            order = check.indices(order, "order", len(held))
            if len(order) != len(held):
                check.refuse("order", f"It must have all {len(held)} pairs.", f"{len(order)} of them")
        vars(self).update(n_data=n, held_out=held, validated=validated, order=order)

    @classmethod
    def _of(cls, n: int, held: IndexSets, validated: IndexSets, order: Integers | None = None) -> Scheme:
        """The scheme that a builder has made: right by construction, so that nothing is checked."""
        scheme = object.__new__(cls)
        vars(scheme).update(n_data=n, held_out=held, validated=validated, order=order)
        return scheme

    @property
    def sets(self) -> tuple[CoreSets, CoreSets] | _core.LazyNeighbourhoods:
        """Argument for the core: what is held out, and what is validated."""
        held = self.held_out.arrays
        return held, held if self.validated is self.held_out else self.validated.arrays

    @property
    def arguments(
        self,
    ) -> tuple[tuple[CoreSets, CoreSets] | _core.LazyNeighbourhoods, NDArray[np.uintp] | None]:
        """Arguments for the core: `sets`, and the order if one is known."""
        return self.sets, None if self.order is None else self.order.view(np.uintp)

    @property
    def visiting_order(self) -> Integers:
        """The order of the pairs, by default that of the list, (k,)."""
        return np.arange(len(self)) if self.order is None else self.order

    def __len__(self) -> int:
        return len(self.held_out)

    def __repr__(self) -> str:
        sizes = self.held_out.sizes
        low, high = (int(sizes.min()), int(sizes.max())) if len(self) else (0, 0)
        span = f"{low}" if low == high else f"{low} to {high}"
        return f"Scheme({len(self)} pairs over {self.n_data} data, {span} held out)"

    def split(self, X: Any = None, y: Any = None, groups: Any = None) -> Iterator[tuple[Integers, Integers]]:
        """Yield (train, test) for each pair, as the splitters of scikit-learn do: a scheme is a `cv` for any estimator.

        Test data are those that the pair validates. What it holds out beyond them, such as a neighbourhood, is in
        neither set.

        Parameters
        ----------
        X : (n, ...) array, optional
            Its number of data is checked.
        y, groups
            Ignored; scikit-learn passes them.

        Raises
        ------
        ValueError
            If X has not the scheme's number of data.

        Examples
        --------
        >>> import mexpress as mx
        >>> scheme = mx.schemes.exclusion_radius([[0.0], [1.0], [3.0]], radius=1.5)
        >>> [(train.tolist(), test.tolist()) for train, test in scheme.split()]
        [([2], [0]), ([2], [1]), ([0, 1], [2])]
        """
        n = self.n_data if X is None else _length(X)
        if n != self.n_data:
            check.refuse("X", f"It must have the scheme's {self.n_data} data.", f"{n} data")
        return (
            (_complement(held, n), test) for held, test in zip(self.held_out, self.validated, strict=True)
        )

    def get_n_splits(self, X: Any = None, y: Any = None, groups: Any = None) -> int:
        """Return the number of pairs, as the splitters of scikit-learn do.

        Examples
        --------
        >>> import mexpress as mx
        >>> mx.schemes.k_fold(10, 5).get_n_splits()
        5
        """
        return len(self)

    def restricted(self, some: Integers) -> Scheme:
        """Return the scheme over some of its data, (k,), increasing: the others are neither held out nor validated.

        Examples
        --------
        >>> import mexpress as mx
        >>> scheme = mx.schemes.from_sets([[0, 1, 2], [1, 3]]).restricted(np.array([1, 2, 3]))
        >>> list(scheme.held_out)
        [array([0, 1]), array([0, 2])]
        """
        held = self.held_out.restricted(some, self.n_data)
        same = self.validated is self.held_out
        return Scheme(
            len(some), held, held if same else self.validated.restricted(some, self.n_data), self.order
        )


class LazyNeighbourhoods(Scheme):
    """A scheme that validates each datum with its neighbourhood held out, without a list of the neighbourhoods.

    They are found when they are needed: the lists of a million data with a thousand around each take 8 GB. They are
    listed only if `held_out` is asked for.

    Parameters
    ----------
    places : Places
        Positions of the data.
    how : str
        The method of `Places` that lists the neighbourhoods, "within" or "nearest".
    reach : float
        Its argument, the radius or the number of data.

    Examples
    --------
    >>> import numpy as np
    >>> scheme = Places(np.array([[0.0, 0.0], [1.0, 0.0], [3.0, 0.0]])).lazily_within(1.5)
    >>> scheme
    LazyNeighbourhoods(3 data, about 2 held out)
    >>> scheme.held_out[0]
    array([0, 1])
    """

    order: Integers
    places: Places
    how: str
    reach: float
    search: _core.LazyNeighbourhoods

    def __init__(self, places: Places, how: str, reach: float) -> None:
        find = getattr(_core.LazyNeighbourhoods, how)
        n, workers = len(places.points), check.threads(places.threads)
        search = find(places.points, checked_radius(reach) if how == "within" else reach, workers)
        alone = singletons(n)
        found = {"n_data": n, "validated": alone, "order": places.order, "search": search}
        vars(self).update(found, places=places, how=how, reach=reach)

    @cached_property
    def held_out(self) -> IndexSets:
        """The neighbourhoods as a list."""
        listed: Scheme = getattr(self.places, self.how)(self.reach)
        return listed.held_out

    @property
    def sets(self) -> _core.LazyNeighbourhoods:
        """Argument for the core."""
        return self.search

    def __len__(self) -> int:
        return self.n_data

    def __repr__(self) -> str:
        return f"LazyNeighbourhoods({self.n_data} data, about {self.search.mean:.0f} held out)"

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.places, self.how, self.reach)


@dataclass(frozen=True, eq=False, repr=False)
class Places:
    """Positions of the data, (n, d) with d from 1 to 3, checked and sorted once for all searches of neighbours."""

    points: Floats
    threads: int | None = None
    """Largest number of threads that search."""

    @classmethod
    def of(cls, points: ArrayLike, threads: int | None = None) -> Places:
        """Check points of one to three coordinates."""
        return cls(check.points(points, "points", dimension=None), threads)

    @cached_property
    def order(self) -> Integers:
        """An order of the data in which successive data are near each other."""
        offsets = self.points - self.points.min(axis=0)
        # A little more than the cells of the curve, lest in some units points of a grid fall below the edges of theirs.
        return _core.hilbert_order(
            np.floor(offsets / (offsets.max() or 1.0) * _CELLS + 1e-6), check.threads(self.threads)
        )

    def within(self, radius: float) -> Scheme:
        """List the neighbourhoods of `exclusion_radius`."""
        reach, workers = checked_radius(radius), check.threads(self.threads)
        return self._listed(lambda: _core.neighbours_within(self.points, reach, workers))

    def nearest(self, k: int) -> Scheme:
        """List the neighbourhoods of `nearest`."""
        k, workers = check.count(k, "k", 1, len(self.points)), check.threads(self.threads)
        return self._listed(lambda: _core.neighbours_nearest(self.points, k, workers))

    def neighbours(self, k: int) -> Integers:
        """Return the k nearest data of each datum with itself, (n, k), in the order of their indices."""
        return self.nearest(k).held_out.indices.reshape(-1, k)

    def spacing(self) -> Floats:
        """Return the distance of each datum to the nearest other one, (n,); zero if there is only one."""
        if len(self.points) < 2:
            return np.zeros(1)
        pairs = self.points[self.neighbours(2)]
        # hypot, since squares of tiny or huge distances are not numbers
        return np.asarray(np.hypot.reduce(pairs[:, 0] - pairs[:, 1], axis=1))

    def matched(self, queries: Floats, min_train: float = 0.5) -> Scheme:
        """List the neighbourhoods of `matched`."""
        share = check.number(min_train, "min_train", SHARE_RULE, 0.0, strict=True)
        if share > 1:
            check.refuse("min_train", SHARE_RULE, check.describe(min_train))
        n, workers = len(self.points), check.threads(self.threads)
        most = max(0, n - 1 - max(1, math.floor(share * n + 1e-9)))
        return self._listed(lambda: _core.neighbours_matched(self.points, queries, most, workers))

    def delaunay(self) -> Scheme:
        """List the neighbourhoods of `delaunay`."""
        return self._listed(lambda: _core.neighbours_delaunay(self.points))

    def lazily_within(self, radius: float) -> LazyNeighbourhoods:
        """Return the neighbourhoods of `exclusion_radius` without a list."""
        return LazyNeighbourhoods(self, "within", radius)

    def lazily_nearest(self, k: int) -> LazyNeighbourhoods:
        """Return the neighbourhoods of `nearest` without a list."""
        return LazyNeighbourhoods(self, "nearest", check.count(k, "k", 1, len(self.points)))

    def listed_if_few(self, lazy: LazyNeighbourhoods) -> Scheme:
        """Return the neighbourhoods as a list, which several calls share, unless they are many."""
        if lazy.search.mean * lazy.n_data > _MOST_LISTED:
            return lazy
        listed: Scheme = getattr(self, lazy.how)(lazy.reach)
        return listed

    def _listed(self, search: Callable[[], tuple[Integers, Integers]]) -> Scheme:
        """Validate each datum with its neighbourhood held out."""
        n = len(self.points)
        try:
            neighbourhoods = IndexSets(*search())
        except ValueError as error:
            rule = "Their neighbourhoods must fit in memory: hold out fewer."
            check.refuse("points", rule, f"{n} points with {error}")
        return Scheme._of(n, neighbourhoods, singletons(n), self.order)


def checked_radius(radius: float) -> float:
    return (1 + _ROUNDING) * check.number(radius, "radius", "It must be a number of at least 0.", 0.0)


def _expect_held(held: IndexSets, validated: IndexSets) -> None:
    """Refuse validated data that are not held out."""
    inside = contained(held, validated)
    if not inside.all():
        i = int(inside.argmin())
        number = np.searchsorted(validated.offsets, i, side="right") - 1
        given = f"datum {validated.indices[i]} in set {number}"
        check.refuse("validated", "Validated data must be held out.", given)


def leave_one_out(n: int) -> Scheme:
    """Hold out each datum alone: CMPRESS, equation (8).

    Parameters
    ----------
    n : int
        Number of data, at least 1.

    Examples
    --------
    >>> import mexpress as mx
    >>> mx.schemes.leave_one_out(3)
    Scheme(3 pairs over 3 data, 1 held out)
    """
    n = check.count(n, "n", 1)
    sets = singletons(n)
    return Scheme._of(n, sets, sets)


def k_fold(n: int, k: int, seed: Any = None) -> Scheme:
    """Split the data at random into k folds of nearly equal size, and hold out each: equation (9).

    Parameters
    ----------
    n : int
        Number of data.
    k : int
        Number of folds, from 2 to n.
    seed : int or numpy Generator, optional
        Seed or generator; None draws fresh numbers.

    Examples
    --------
    >>> import mexpress as mx
    >>> mx.schemes.k_fold(11, 3, seed=0)
    Scheme(3 pairs over 11 data, 3 to 4 held out)
    """
    n = check.count(n, "n", 2)
    k = check.count(k, "k", 2, n)
    sets = compress(np.array_split(check.generator(seed).permutation(n), k))
    return Scheme._of(n, sets, sets)


def exclusion_radius(points: ArrayLike, radius: float, threads: int | None = None) -> Scheme:
    """Local exclusion: validate each datum with all data within a radius held out, equations (12, 13).

    Parameters
    ----------
    points : (n, d) array, d from 1 to 3
        Positions of the data.
    radius : float
        Distance up to which data are held out (d <= radius, to within 4e-13 of it because of rounding), in the unit of
        the points; 0 holds out the datum and data that coincide with it. The paper advises 5 to 10 % of the domain's
        diagonal.
    threads : int, optional
        Largest number of threads.

    Examples
    --------
    >>> import mexpress as mx
    >>> scheme = mx.schemes.exclusion_radius([[0, 0], [1, 0], [3, 0]], radius=1.5)
    >>> list(scheme.held_out)
    [array([0, 1]), array([0, 1]), array([2])]
    """
    places = Places.of(points, threads)
    return places.listed_if_few(places.lazily_within(radius))


def nearest(points: ArrayLike, k: int, threads: int | None = None) -> Scheme:
    """Validate each datum with its k nearest data held out, including itself.

    Parameters
    ----------
    points : (n, d) array, d from 1 to 3
        Positions of the data.
    k : int
        Number of held-out data, from 1 (leave-one-out) to n. At equal distance, the smaller index is nearer.
    threads : int, optional
        Largest number of threads.

    Examples
    --------
    >>> import mexpress as mx
    >>> list(mx.schemes.nearest([[0, 0], [1, 0], [3, 0]], k=2).held_out)
    [array([0, 1]), array([0, 1]), array([1, 2])]
    """
    places = Places.of(points, threads)
    return places.listed_if_few(places.lazily_nearest(k))


def matched(
    points: ArrayLike, queries: ArrayLike, min_train: float = 0.5, threads: int | None = None
) -> Scheme:
    """Validate each datum with just enough nearest data held out that it is as far from its training data as a query.

    Nearest-neighbour distance matching: distances from validated data to their nearest training data are distributed
    like distances from queries to their nearest data. This is leave-one-out for data as dense as the queries need,
    and local exclusion for data that crowd far from the queries.

    Parameters
    ----------
    points : (n, d) array, d from 1 to 3
        Positions of the data.
    queries : (q, d) array
        Positions where the model will be used, or a sample of them: a few hundred at least.
    min_train : float, default 0.5
        Smallest share of training data, above 0 and at most 1: a datum that reaches it holds out no more data. At
        least one training datum remains.
    threads : int, optional
        Largest number of threads.

    Raises
    ------
    ValueError
        If the points and the queries have different numbers of coordinates.

    Notes
    -----
    This is the algorithm of the R package CAST (nndm with phi="max"), whose `min_train` has the same default. Data are
    visited in the order of the distance r to their nearest training datum, then by index. F(r) is the share of queries
    with a datum within r. If more than 1 + n F(r) data have a distance of at most r, the nearest training datum is
    also held out; otherwise the datum is done. Distances only grow, so queries that are nearer to the data than the
    data are to each other give leave-one-out. At equal distance, the smallest index is held out first. (If a datum
    reaches `min_train`, CAST stops at all data with the same distance; here, the other data go on.)

    References
    ----------
    C. Mila, J. Mateu, E. Pebesma, H. Meyer, "Nearest neighbour distance matching leave-one-out cross-validation
    for map validation", Methods in Ecology and Evolution, 2022.

    Examples
    --------
    >>> import mexpress as mx
    >>> crowded = [[0.0], [0.1], [0.2], [5.0], [5.1], [5.2]]
    >>> list(mx.schemes.matched(crowded, queries=[[2.0], [3.0], [7.0]]).held_out)[:2]
    [array([0, 1, 2]), array([0, 1, 2])]
    >>> mx.schemes.matched(crowded, queries=crowded)
    Scheme(6 pairs over 6 data, 1 held out)
    """
    places = Places.of(points, threads)
    asked = check.points(queries, "queries", dimension=places.points.shape[1])
    return places.matched(asked, min_train)


def delaunay(points: ArrayLike) -> Scheme:
    """Validate each datum with its neighbours in the Delaunay triangulation held out.

    Parameters
    ----------
    points : (n, 2) array
        Positions of the data. Coincident data share their neighbours. On a line, the neighbours are the adjacent data.

    Examples
    --------
    >>> import mexpress as mx
    >>> list(mx.schemes.delaunay([[0, 0], [1, 0], [2, 0]]).held_out)
    [array([0, 1]), array([0, 1, 2]), array([1, 2])]
    """
    return Places(check.points(points, "points")).delaunay()


def buffered(scheme: Scheme, points: ArrayLike, radius: float, threads: int | None = None) -> Scheme:
    """Hold out with every pair of a scheme also all data within a radius of those that it validates.

    Blocks or folds in space are next to their training data at their edges. With a buffer, every validated datum is
    farther than the radius from what predicts it, as with `exclusion_radius`, for as few pairs as there are folds.

    Parameters
    ----------
    scheme : Scheme
        What is held out and validated, such as `k_fold`, or the folds of a splitter by `from_splits`.
    points : (n, d) array, d from 1 to 3
        Positions of the data.
    radius : float
        Width of the buffer, in the unit of the points.
    threads : int, optional
        Largest number of threads.

    Examples
    --------
    >>> import mexpress as mx
    >>> points = [[0.0], [1.0], [2.0], [3.0], [4.0], [5.0]]
    >>> halves = mx.schemes.from_sets([[0, 1, 2], [3, 4, 5]])
    >>> list(mx.schemes.buffered(halves, points, radius=1).held_out)
    [array([0, 1, 2, 3]), array([2, 3, 4, 5])]
    """
    expect_scheme(scheme, "k_fold(n, 5)")
    places = Places.of(points, threads)
    if len(places.points) != scheme.n_data:
        check.refuse(
            "points", f"It must have the scheme's {scheme.n_data} data.", f"{len(places.points)} points"
        )
    near = places.within(radius).held_out
    wide = (
        _union(out, [near[i] for i in validated], scheme.n_data)
        for out, validated in zip(scheme.held_out, scheme.validated, strict=True)
    )
    held = _compress_few(wide, "radius", radius, f"{len(scheme)} pairs")
    return Scheme(scheme.n_data, held, scheme.validated, scheme.order)


def _union(some: Integers, others: Iterable[Integers], n: int) -> Integers:
    member = np.zeros(n, dtype=np.bool_)
    member[some] = True
    for each in others:
        member[each] = True
    return np.flatnonzero(member)


def _compress_few(sets: Iterable[Integers], name: str, value: float, of: str) -> IndexSets:
    """Index sets of arrays that increase, as long as they fit; the argument `name` makes them large."""
    listed: list[Integers] = []
    total = 0
    for each in sets:
        listed.append(each)
        total += len(each)
        if total > MOST_INDICES:
            rule = f"The sets must fit in {MOST_INDICES} indices: take less."
            check.refuse(name, rule, f"{value}, with more than that for {len(listed)} of {of}")
    return packed(listed)


def expect_scheme(scheme: Any, example: str) -> None:
    """Refuse what is no scheme; the message has an example of one.

    Examples
    --------
    >>> expect_scheme("folds", "k_fold(9, 3)")
    Traceback (most recent call last):
    TypeError: Invalid scheme. It must come from mexpress.schemes, such as k_fold(9, 3). Given 'folds'.
    """
    if not isinstance(scheme, Scheme):
        rule = f"It must come from mexpress.schemes, such as {example}."
        check.refuse("scheme", rule, check.describe(scheme), TypeError)


def from_distance(delta: ArrayLike | Callable[[int], ArrayLike], tau: float, n: int | None = None) -> Scheme:
    """Local exclusion by any distance: validate each datum with all data within tau held out, equation (12).

    Parameters
    ----------
    delta : (n, n) array, or callable
        ``delta[i, j]``, or ``delta(i)[j]``: distance of datum j from datum i in any unit, for instance along a surface,
        in time, or between images. It need not be symmetric; data at infinity are never held out. A callable returns
        the distances of one datum to all n data, and avoids an n x n matrix.
    tau : float
        Distance up to which data are held out; the datum itself always is.
    n : int, optional
        Number of data; needed with a callable.

    Raises
    ------
    ValueError, TypeError
        If the distances of a datum are not n numbers, or one is NaN.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> hour = np.array([0.0, 8.0, 23.0])
    >>> around_the_clock = lambda i: np.minimum(abs(hour - hour[i]), 24 - abs(hour - hour[i]))
    >>> list(mx.schemes.from_distance(around_the_clock, tau=2, n=3).held_out)
    [array([0, 2]), array([1]), array([0, 2])]
    """
    reach = check.number(tau, "tau", "It must be a number of at least 0.", 0.0)
    if callable(delta):
        rows, count = delta, check.count(n, "n", 1)
    else:
        rows, count = _matrix_rows(delta, n)
    sets = (_near(_distances(rows(i), i, count), reach, i) for i in range(count))
    return Scheme._of(count, _compress_few(sets, "tau", tau, f"{count} data"), singletons(count))


def _near(distances: Floats, reach: float, i: int) -> Integers:
    near = distances <= reach
    near[i] = True
    return np.flatnonzero(near)


def _matrix_rows(delta: ArrayLike, n: int | None) -> tuple[Callable[[int], ArrayLike], int]:
    """A function from datum to row of a distance matrix, and the number of rows."""
    matrix = check.real(delta, "delta")
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or matrix.size == 0:
        check.refuse("delta", "It must have shape (n, n), or be callable.", f"shape {matrix.shape}")
    if n is not None and check.count(n, "n", 1) != len(matrix):
        check.refuse("n", f"It must be the {len(matrix)} data of delta.", f"{n}")
    return matrix.__getitem__, len(matrix)


def _distances(row: ArrayLike, i: int, n: int) -> Floats:
    """Distances of datum i, checked."""
    distances = check.real(row, "delta")
    if distances.shape != (n,):
        check.refuse(
            "delta", f"It must give {n} distances a datum.", f"shape {distances.shape} for datum {i}"
        )
    missing = np.isnan(distances)
    if missing.any():
        check.refuse("delta", "Distances must not be NaN.", f"that from datum {i} to {missing.argmax()}")
    return distances


def leave_p_out(n: int, p: int, max_sets: int | None = None, seed: Any = None) -> Scheme:
    """Hold out every set of p data, or a random choice of the sets.

    Parameters
    ----------
    n : int
        Number of data.
    p : int
        Size of the sets, from 1 to n.
    max_sets : int, optional
        If there are more sets, this number of different sets is drawn at random.
    seed : int or numpy Generator, optional
        Seed or generator; None draws fresh numbers.

    Raises
    ------
    ValueError
        If there are too many sets to list, and `max_sets` is not given.

    Examples
    --------
    >>> import mexpress as mx
    >>> mx.schemes.leave_p_out(5, 2)
    Scheme(10 pairs over 5 data, 2 held out)
    >>> mx.schemes.leave_p_out(100, 5, max_sets=20, seed=0)
    Scheme(20 pairs over 100 data, 5 held out)
    """
    n = check.count(n, "n", 1)
    p = check.count(p, "p", 1, n)
    total = math.comb(n, p)
    wanted = total if max_sets is None else min(total, check.count(max_sets, "max_sets", 1))
    if wanted * p > MOST_INDICES:
        rule = f"The sets must fit in {MOST_INDICES} indices: limit them with max_sets."
        check.refuse("p", rule, f"{wanted} sets of {p}")
    rng = check.generator(seed)
    if 2 * wanted > total:
        every = np.fromiter(chain.from_iterable(combinations(range(n), p)), np.int64, total * p)
        sets = every.reshape(total, p)[np.sort(rng.choice(total, wanted, replace=False))]
    else:
        drawn: dict[tuple[int, ...], None] = {}
        while len(drawn) < wanted:
            drawn[tuple(sorted(rng.choice(n, p, replace=False).tolist()))] = None
        sets = np.array(list(drawn), dtype=np.int64)
    compressed = IndexSets(np.arange(wanted + 1) * p, sets.ravel())
    return Scheme._of(n, compressed, compressed)


def random_sampling(n: int, size: int, repeats: int, seed: Any = None) -> Scheme:
    """Hold out random sets of one size.

    Parameters
    ----------
    n : int
        Number of data.
    size : int
        Number of held-out data in a set, from 1 to n.
    repeats : int
        Number of sets.
    seed : int or numpy Generator, optional
        Seed or generator; None draws fresh numbers.

    Examples
    --------
    >>> import mexpress as mx
    >>> mx.schemes.random_sampling(50, 10, repeats=3, seed=0)
    Scheme(3 pairs over 50 data, 10 held out)
    """
    n = check.count(n, "n", 1)
    size = check.count(size, "size", 1, n)
    repeats = check.count(repeats, "repeats", 1)
    rng = check.generator(seed)
    sets = compress(rng.choice(n, size, replace=False) for _ in range(repeats))
    return Scheme._of(n, sets, sets)


def from_sets(
    held_out: Iterable[ArrayLike], validated: Iterable[ArrayLike] | None = None, n: int | None = None
) -> Scheme:
    """Build a scheme from any sets of data.

    Parameters
    ----------
    held_out : iterable of index arrays
        Data of each pair that are left out of the fit; indices from 0, in any order.
    validated : iterable of index arrays, optional
        Data of each pair whose prediction is scored; all held-out data by default.
    n : int, optional
        Number of data; one more than the largest index by default.

    Raises
    ------
    ValueError
        If an index repeats, is negative or not below n, or is validated but not held out.

    Examples
    --------
    >>> import mexpress as mx
    >>> mx.schemes.from_sets([[0, 1, 2], [7, 8]], validated=[[1], [7]])
    Scheme(2 pairs over 9 data, 2 to 3 held out)
    """
    bound = None if n is None else check.count(n, "n", 1)
    held = _listed(held_out, "held_out", bound)
    scored = held if validated is None else _listed(validated, "validated", bound)
    return Scheme(_number(held, scored) if bound is None else bound, held, scored)


def _listed(sets: Iterable[ArrayLike], name: str, bound: int | None) -> IndexSets:
    """Index sets of the lists of users, with indices in any order."""
    rule = "It must be a list of distinct indices."
    items = enumerate(check.items(sets, name, "It must be a list of index arrays."))
    return checked(compress(check.integers(s, f"{name}[{i}]", rule) for i, s in items), name, bound)


def _number(*sets: IndexSets) -> int:
    """One more than the largest index."""
    return 1 + max(int(s.indices.max(initial=0)) for s in sets)


def from_splits(splits: Iterable[tuple[ArrayLike, ArrayLike]], n: int | None = None) -> Scheme:
    """Build a scheme from (train, test) index pairs, as the splitters of scikit-learn and verde yield them.

    The test data are validated. All data outside the training data are held out, so a splitter's gap around its test
    data is kept.

    Parameters
    ----------
    splits : iterable of (train, test)
        Index arrays, for instance ``KFold(5).split(X)``.
    n : int, optional
        Number of data; one more than the largest index by default.

    Raises
    ------
    ValueError, TypeError
        If a split is no pair of distinct indices, or trains on what it tests, or if all that is held out exceeds
        100,000,000 indices.

    Examples
    --------
    >>> import mexpress as mx
    >>> mx.schemes.from_splits([([0, 1], [2]), ([2], [0])])
    Scheme(2 pairs over 3 data, 1 to 2 held out)
    """
    return scheme_of_splits(splits, None if n is None else check.count(n, "n", 1), "splits")


def scheme_of_splits(splits: Iterable[tuple[ArrayLike, ArrayLike]], n: int | None, name: str) -> Scheme:
    """Return the scheme of `from_splits`; messages call the splits by a name.

    Splits are taken one by one, and what they train on is not kept: thousands of long lists need not fit in memory.

    Examples
    --------
    >>> scheme_of_splits([([0, 0], [1])], None, "cv")
    Traceback (most recent call last):
    ValueError: Invalid cv[0]. ... a bootstrap, which repeats some, is no hold-out. Given datum 0, 2 times.
    """
    parts: list[tuple[Integers, int]] = []  # what is held out, of how many data
    tests: list[Integers] = []
    total, trained = n or 1, 0
    for i, split in enumerate(_iterated(splits, name)):
        train, test = _train_and_test(split, f"{name}[{i}]", n)
        if n is None:
            total = max(total, 1 + int(train.max(initial=0)), 1 + int(test.max(initial=0)))
        trained += len(train)
        left = (i + 1) * total - trained
        if left > MOST_INDICES:
            rule = f"The data that are not trained on must fit in {MOST_INDICES} indices."
            check.refuse(name, rule, f"{left}, in {i + 1} splits of {total} data")
        out = _not_trained(train, test, f"{name}[{i}]", total)
        parts.append((out, total))
        tests.append(out if len(out) == len(test) else test)
    # What is known of later splits only is held out by the earlier ones, too.
    held = packed(out if known == total else np.append(out, np.arange(known, total)) for out, known in parts)
    return Scheme._of(total, held, held if sum(map(len, tests)) == len(held.indices) else packed(tests))


def _iterated(splits: Any, name: str) -> Iterator[Any]:
    rule = "It must be a list of (train, test) index arrays."
    if isinstance(splits, str | bytes):
        check.refuse(name, rule, check.describe(splits), TypeError)
    try:
        return iter(splits)
    except TypeError:
        check.refuse(name, rule, check.describe(splits), TypeError)


def _train_and_test(split: Any, name: str, bound: int | None) -> tuple[Integers, Integers]:
    """Training data in any order, and test data, increasing."""
    try:
        train, test = split
    except (TypeError, ValueError):
        check.refuse(name, "It must be a pair, (train, test).", check.describe(split), TypeError)
    train = check.integers(train, name, "Its training data must be a list of distinct indices.")
    test = check.indices(test, name, bound, "Its test data must be a list of distinct indices.")
    return check.from_zero(train, name, bound), np.sort(test)


def _not_trained(train: Integers, test: Integers, name: str, n: int) -> Integers:
    """Which of n data are not trained on; test data must be among them."""
    others = np.ones(n, dtype=np.bool_)
    others[train] = False
    if not others[test].all():
        check.refuse(
            name, "Test data must not be trained on.", f"datum {test[others[test].argmin()]} in both"
        )
    out = np.flatnonzero(others)
    if len(out) + len(train) > n:
        rule = "It must train on distinct data: a bootstrap, which repeats some, is no hold-out."
        times = np.bincount(train)
        check.refuse(name, rule, f"datum {times.argmax()}, {times.max()} times")
    return out


def _length(X: Any) -> int:
    """Number of rows of an array, a frame, or a sparse matrix, which has no len."""
    shape = getattr(X, "shape", None)
    try:
        return int(shape[0]) if shape else len(X)
    except TypeError:
        check.refuse("X", "It must be an array with a row for each datum.", check.describe(X), TypeError)


def _complement(some: Integers, n: int) -> Integers:
    others = np.ones(n, dtype=np.bool_)
    others[some] = False
    return np.flatnonzero(others)
