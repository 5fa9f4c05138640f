"""Arrays on their way to a worker: they lie in memory that both see, and that is used again and again.

Through a connection they would be copied six times, each time into new memory, which costs more than a small problem:
the system clears it page by page.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from mmap import mmap
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mexpress.batch.spool import mapped

ROOM = 1 << 22
_LINE = 64


@dataclass(frozen=True)
class Lying:
    """An array on a tray, as it is told to a worker."""

    path: Path
    start: int
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    def array(self) -> NDArray[Any]:
        """Return the array, where it lies."""
        return np.ndarray(self.shape, self.dtype, _seen(self.path), self.start)


class Tray:
    """Memory for the arrays of one parcel."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.end = 0

    @cached_property
    def memory(self) -> mmap | None:
        """What is there from the first array on, if there is room for it."""
        return mapped(self.path, ROOM)

    def clear(self) -> None:
        """Make room for another parcel."""
        self.end = 0

    def stacked(self, column: Sequence[NDArray[Any]]) -> Lying | None:
        """Take arrays of one shape and type, and return the array of all; None if there is no room.

        Examples
        --------
        >>> from tempfile import TemporaryDirectory
        >>> with TemporaryDirectory() as folder:
        ...     tray = Tray(Path(folder, "tray"))
        ...     lying = tray.stacked([np.arange(3), np.arange(3) + 7])
        ...     lying.array().tolist(), tray.stacked([np.zeros(ROOM)])
        ([[0, 1, 2], [7, 8, 9]], None)
        """
        first, start = column[0], self.end
        nbytes = len(column) * first.nbytes
        if nbytes == 0 or start + nbytes > ROOM or self.memory is None:
            return None
        shape = (len(column), *first.shape)
        stack: NDArray[Any] = np.ndarray(shape, first.dtype, self.memory, start)
        np.concatenate(column, out=stack.reshape(len(column) * first.shape[0], *first.shape[1:]))
        self.end = -(-(start + nbytes) // _LINE) * _LINE
        return Lying(self.path, start, shape, first.dtype)


@cache
def _seen(path: Path) -> NDArray[np.uint8]:
    """Return the memory of a tray in another process, which uses the same few for ever."""
    return np.memmap(path, np.uint8, "r").view(np.ndarray)
