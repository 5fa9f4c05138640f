"""Rows of dask arrays: they stay where the cluster has them, and the work comes to them.

A piece of work has some rows of several blocks. Each is cut out where its block is, so that no more than these rows
travel to where the work is done; a worker that is killed is Dask's affair, which makes again what was lost. All goes
through `dask.compute`, so that threads, processes and clusters do alike.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.caching import cached_property
from mexpress.leastsquares.cells import merged, reduced
from mexpress.leastsquares.leads import Leads
from mexpress.leastsquares.rows import Rows, bounded, weighted

_TOGETHER = 64
"""Pieces of work that are asked for at once, if the arrays have no more blocks: what these need is in memory here."""

_BRANCHES = 8
"""Triangles that are merged at once."""


@dataclass(frozen=True, eq=False)
class DaskRows(Rows):
    """Rows of which the design is a dask array; the responses may be one, or an array in memory.

    Examples
    --------
    >>> import dask.array as da
    >>> rows = DaskRows.checked((da.ones((4, 2), chunks=(3, 1)), np.arange(4.0)), 1)
    >>> rows.take(np.array([3, 1]))
    array([[1., 1., 3.],
           [1., 1., 1.]])
    >>> [len(some) for some in rows.blocks()]
    [3, 1]
    """

    A: Any
    b: Any

    @staticmethod
    def have(blocks: Any) -> bool:
        """Whether the design is a dask array."""
        return isinstance(blocks, tuple) and bool(blocks) and _of_dask(blocks[0])

    @classmethod
    def checked(cls, block: Any, coupling: int) -> Self:
        """Rows of ``(A, b)`` or ``(A, b, weights)``, if their shapes fit, in blocks of whole rows, none empty."""
        rows = super().checked(block, coupling)
        A = rows.A.rechunk({0: tuple(length for length in rows.A.chunks[0] if length), 1: -1})
        b = rows.b.rechunk({0: A.chunks[0]} | ({1: -1} if rows.b.ndim == 2 else {}))
        return replace(rows, A=A, b=b)

    @staticmethod
    def array(given: Any) -> Any:
        """A design or responses, if they are real numbers, in blocks of known lengths."""
        import dask.array as da  # noqa: PLC0415  an extra, which whoever has such an array has

        array: Any = given if _of_dask(given) else da.from_array(Rows.array(given))  # type: ignore[no-untyped-call]
        rule = "Dask arrays must be of real numbers, in blocks of numpy's arrays of known lengths."
        if array.dtype.kind not in "biuf" or type(array._meta) is not np.ndarray:
            kind = f"{check.describe(array)}, {array.dtype} in {type(array._meta).__name__}"
            check.refuse("blocks", rule, kind, TypeError)
        if np.isnan(array.shape).any():
            check.refuse("blocks", f"{rule} compute_chunk_sizes() finds them.", check.describe(array))
        return array

    @staticmethod
    def threads(given: Any) -> int:
        """Threads of a piece of work: one, as others run beside it, unless more are asked for."""
        return 1 if given is None else check.threads(given)

    def take(self, rows: Integers) -> Floats:
        """Return some weighted rows of ``[A, b]``, (k, p + r)."""
        (taken,) = self.each(_same, [(rows,)])
        return np.asarray(taken)

    def blocks(self) -> Iterator[Integers]:
        """Rows of each block."""
        return (np.arange(*ends) for ends in zip(self._ends[:-1], self._ends[1:], strict=True))

    def together(self, numbers: int) -> int:
        """How many rows are best read at once: blocks are cut evenly, unless they are small."""
        q, length = self.columns + self.responses, max(self.A.chunks[0])
        cuts = round(length * q / numbers)
        return length // cuts if cuts else numbers // q

    def each(self, work: Callable[..., Any], calls: Iterable[tuple[Any, ...]]) -> Iterator[Any]:
        """Do some work on weighted rows of ``[A, b]``, time after time: a call is ``(rows, *further arguments)``."""
        left, together = iter(calls), max(_TOGETHER, len(self._blocks))
        while tasks := [self._task(work, *call) for call in islice(left, together)]:
            yield from _computed(tasks)

    def triangle(self, threads: int) -> Floats:
        """Return the triangle of all weighted rows ``[A, b]``, (p + r, p + r): those of blocks, merged in a tree."""
        from dask.delayed import delayed  # noqa: PLC0415  an extra

        triangles = [
            delayed(_triangle)(*block, self.roots(rows), threads)
            for block, rows in zip(self._blocks, self.blocks(), strict=True)
        ]
        while len(triangles) > 1:
            firsts = range(0, len(triangles), _BRANCHES)
            triangles = [delayed(_merged)(triangles[k : k + _BRANCHES], threads) for k in firsts]
        return np.asarray(_computed(triangles)[0])

    def _task(self, work: Callable[..., Any], rows: Integers, *others: Any) -> Any:
        """Return a piece of work, to be computed."""
        from dask.delayed import delayed  # noqa: PLC0415  an extra

        blocks = np.searchsorted(self._ends, rows, side="right") - 1
        order = np.argsort(blocks, kind="stable")
        numbers, firsts = np.unique(blocks[order], return_index=True)
        pieces = [
            delayed(_taken)(*self._blocks[k], rows[some] - self._ends[k], self.leads)
            for k, some in zip(numbers, np.split(order, firsts[1:]), strict=True)
        ]
        return delayed(_done)(pieces, order, self.roots(rows), work, others)

    @cached_property
    def _ends(self) -> Integers:
        """Where blocks begin, and where the last one ends."""
        return np.cumsum([0, *self.A.chunks[0]])

    @cached_property
    def _blocks(self) -> list[tuple[Any, Any]]:
        """Design and responses of each block, to be computed."""
        return [*zip(self.A.to_delayed().ravel(), self.b.to_delayed().ravel(), strict=True)]


def _of_dask(array: Any) -> bool:
    return hasattr(array, "__dask_graph__") and hasattr(array, "rechunk")


def _computed(tasks: list[Any]) -> tuple[Any, ...]:
    """Return what tasks give."""
    from dask.base import compute  # noqa: PLC0415  an extra

    with warnings.catch_warnings():  # the rows of a task are told by their numbers
        warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
        return tuple(compute(*tasks))  # type: ignore[no-untyped-call]


def _taken(A: NDArray[Any], b: NDArray[Any], rows: Integers, leads: Leads | None = None) -> Floats:
    """Some rows of a block."""
    return Rows(A, b, None, 1, leads).take(rows)


def _done(
    pieces: list[Floats],
    order: Integers,
    roots: Floats | None,
    work: Callable[..., Any],
    others: tuple[Any, ...],
) -> Any:
    """Put pieces together in their order, and do the work."""
    rows = np.empty((len(order), pieces[0].shape[1]))
    rows[order] = np.concatenate(pieces)
    return work(weighted(rows, roots), *others)


def _triangle(A: NDArray[Any], b: NDArray[Any], roots: Floats | None, threads: int) -> Floats:
    """The triangle of a block."""
    rows = bounded(_taken(A, b, np.arange(len(A))), A.shape[1])
    return reduced(weighted(rows, roots), threads)


def _merged(triangles: list[Floats], threads: int) -> Floats:
    return merged(np.concatenate(triangles), threads)


def _same(rows: Floats) -> Floats:
    return rows
