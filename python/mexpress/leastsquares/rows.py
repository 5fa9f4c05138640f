"""Rows of a problem that need not fit in memory: of memory-mapped arrays, or of blocks that are kept in a file."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.leastsquares.leads import Leads
from mexpress.leastsquares.problem import expect_weights, weight_exponents

_NUMBERS = 1 << 22
"""Numbers that are read at once: 32 MiB."""

_GATHERED = 1 << 16
"""Numbers of blocks that are reduced together: small ones would take longer each than the work on them."""

_RULE = "It must be (A, b) or (A, b, weights), or yield such tuples: (m, p), (m,) or (m, r), and (n,) arrays."


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of a design and of responses, and the weights of its data.

    Parameters
    ----------
    A : (m, p) array
        Design, as a rule in a file.
    b : (m,) or (m, r) array
        Responses.
    weights : (n,) array or None
        Weights of the data, near one: fits and scores depend on their ratios alone.
    coupling : int
        Rows of a datum.
    leads : Leads or None
        What is taken of the responses when they are read.

    Examples
    --------
    >>> Rows(np.ones((4, 1)), np.arange(4.0), np.array([1.0, 4.0]), 2).take(np.array([1, 2]))
    array([[1., 1.],
           [2., 4.]])
    """

    A: NDArray[Any]
    b: NDArray[Any]
    weights: Floats | None
    coupling: int
    leads: Leads | None = None

    @classmethod
    def checked(cls, block: Any, coupling: int) -> Self:
        """Rows of ``(A, b)`` or ``(A, b, weights)``, if their shapes fit."""
        if not isinstance(block, tuple) or len(block) not in (2, 3):
            check.refuse("blocks", _RULE, check.describe(block), TypeError)
        A, b = (cls.array(each) for each in block[:2])
        if A.ndim != 2 or b.ndim not in (1, 2) or len(A) != len(b) or not A.size or not b.size:
            check.refuse("blocks", _RULE, f"shapes {A.shape} and {b.shape}")
        if len(A) % coupling:
            check.refuse("coupling", f"It must divide the {len(A)} rows of a block.", str(coupling))
        if len(block) == 2 or block[2] is None:
            return cls(A, b, None, coupling)
        return cls(A, b, expect_weights(block[2], len(A) // coupling), coupling)

    @staticmethod
    def array(given: Any) -> Any:
        """A design or responses, if they are real numbers."""
        return check.array(given, "blocks", _RULE, "biuf")

    @property
    def columns(self) -> int:
        """Number of columns of the design."""
        return int(self.A.shape[1])

    @property
    def responses(self) -> int:
        """Number of responses."""
        return 1 if self.b.ndim == 1 else int(self.b.shape[1])

    @property
    def n_data(self) -> int:
        """Number of data."""
        return len(self.A) // self.coupling

    def of(self, data: Integers) -> Integers:
        """Rows of some data."""
        return (data[:, None] * self.coupling + np.arange(self.coupling)).ravel()

    def roots(self, rows: Integers) -> Floats | None:
        """Roots of the weights of some rows, (k, 1); None if there are no weights."""
        return None if self.weights is None else np.sqrt(self.weights[rows // self.coupling, None])

    def weighing(self, like: Floats | None) -> Self:
        """With weights over a power of four near some, so that their roots times rows neither over- nor underflow."""
        if self.weights is None or like is None:
            return self
        return replace(self, weights=np.ldexp(self.weights, -2 * weight_exponents(like)))

    def take(self, rows: Integers) -> Floats:
        """Return some weighted rows of ``[A, b]``, (k, p + r)."""
        return weighted(replace(self, A=self.A[rows], b=self.b[rows]).plain(), self.roots(rows))

    def plain(self) -> Floats:
        """Return a copy of ``[A, b]``, (m, p + r), without weights."""
        together = np.empty((len(self.A), self.columns + self.responses))
        together[:, : self.columns] = self.A
        together[:, self.columns :] = self.b.reshape(len(self.A), self.responses)
        if self.leads is not None:
            together[:, self.columns :] = self.leads.left(together)
        return together

    def blocks(self) -> Iterator[Integers]:
        """Successive rows that are read at once."""
        size = max(1, _NUMBERS // (self.columns + self.responses))
        return (np.arange(first, min(first + size, len(self.A))) for first in range(0, len(self.A), size))

    def together(self, numbers: int) -> int:
        """How many rows are best read at once, of about so many numbers."""
        return numbers // (self.columns + self.responses)

    def each(self, work: Callable[..., Any], calls: Iterable[tuple[Any, ...]]) -> Iterator[Any]:
        """Do some work on weighted rows of ``[A, b]``, time after time: a call is ``(rows, *further arguments)``."""
        return (work(self.take(rows), *others) for rows, *others in calls)

    @staticmethod
    def threads(given: Any) -> int:
        """Threads of such work."""
        return check.threads(given)


def rows_of(blocks: Any, coupling: int, directory: Any, each: Callable[[Floats], None]) -> Rows:
    """Read all rows once: those of arrays stay where they are, those of an iterable are written to a file.

    Parameters
    ----------
    blocks : tuple of arrays, or iterable of such tuples
        ``(A, b)`` or ``(A, b, weights)``.
    coupling : int
        Rows of a datum.
    directory : str or Path, optional
        Where the file is; where the system has temporary files by default. It has no name, and ends with the process.
    each : callable
        Called with weighted rows, (k, p + r).
    """
    if isinstance(blocks, tuple):
        rows = Rows.checked(blocks, coupling)
        rows = rows.weighing(rows.weights)
        for some in rows.blocks():
            each(bounded(rows.take(some), rows.columns))
        return rows
    if isinstance(blocks, str | bytes) or not isinstance(blocks, Iterable):
        check.refuse("blocks", _RULE, check.describe(blocks), TypeError)
    _expect_folder(directory)
    with tempfile.TemporaryFile(dir=directory) as file:  # its pages stay as long as they are mapped
        first, weights = _written(blocks, coupling, file, each)
        together = np.memmap(file, np.float64, "r").reshape(-1, first.columns + first.responses)
    b = together[:, first.columns] if first.b.ndim == 1 else together[:, first.columns :]
    shares = expect_weights(np.concatenate(weights), len(b) // coupling) if weights else None
    return Rows(together[:, : first.columns], b, shares, coupling).weighing(first.weights)


def _expect_folder(directory: Any) -> None:
    rule = "It must be the name of a folder, as a str or a Path."
    try:
        if directory is None or Path(directory).is_dir():
            return
    except TypeError:
        check.refuse("directory", rule, check.describe(directory), TypeError)
    check.refuse("directory", rule, repr(str(directory)))


def _written(
    blocks: Iterable[Any], g: int, file: BinaryIO, each: Callable[[Floats], None]
) -> tuple[Rows, list[Floats]]:
    """Write all blocks to a file, and return the first of them and all weights."""
    weights: list[Floats] = []
    waiting: list[Floats] = []
    first = None

    def reduce() -> None:
        if waiting:
            plain, roots = np.concatenate(waiting), None
            if weights:
                shares = np.concatenate(weights[-len(waiting) :])
                roots = Rows(plain, plain, shares, g).weighing(weights[0]).roots(np.arange(len(plain)))
            file.write(plain.data)
            each(weighted(plain, roots))
            waiting.clear()

    numbers = 0
    for given in blocks:
        if _is_empty(given):
            continue
        rows = Rows.checked(given, g)
        if first is None:  # the memory of a block may serve for the next one
            first = replace(rows, weights=None if rows.weights is None else rows.weights.copy())
        alike = rows.A.shape[1:] == first.A.shape[1:] and rows.b.shape[1:] == first.b.shape[1:]
        if not alike or (rows.weights is None) != (first.weights is None):
            rule = "All must be of as many columns and responses, with weights or without."
            check.refuse("blocks", rule, f"shapes {rows.A.shape} and {rows.b.shape}")
        plain = bounded(rows.plain(), rows.columns)
        waiting.append(plain)
        weights += [] if rows.weights is None else [rows.weights.copy()]
        numbers += plain.size
        if numbers >= _GATHERED:
            reduce()
            numbers = 0
    if first is None:
        check.refuse("blocks", _RULE, "none that has rows")
    reduce()
    file.flush()
    return first, weights


def _is_empty(block: Any) -> bool:
    """Whether a block has no rows, and as many responses."""
    return (
        isinstance(block, tuple) and len(block) > 1 and all(np.shape(each)[:1] == (0,) for each in block[:2])
    )


def weighted(rows: Floats, roots: Floats | None) -> Floats:
    """Rows times the roots of their weights, if they have any."""
    return rows if roots is None else rows * roots


def read_only(array: Floats) -> Floats:
    """The array itself, which nobody may change."""
    array.flags.writeable = False
    return array


def bounded(rows: Floats, p: int) -> Floats:
    """Rows ``[A, b]``, if they are finite, and responses within the limit."""
    largest = np.abs(check.finite(rows, "blocks")[:, p:]).max()
    if largest > check.LARGEST_RESPONSE:
        check.refuse("blocks", f"Responses must not exceed {check.LARGEST_RESPONSE:g}.", f"{largest:g}")
    return rows
