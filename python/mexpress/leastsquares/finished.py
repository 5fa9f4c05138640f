"""Parts of long work that are finished, in a file: the work goes on after them when it is started again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check

Arrays = tuple[NDArray[Any], ...]


@dataclass(frozen=True, eq=False)
class Finished:
    """Arrays of finished parts, each after its number; a part that was being written is dropped.

    Parameters
    ----------
    path : Path or None
        The file; nothing is kept if it is None.
    key : (k,) array
        Numbers that tell the work from other work, whose file is refused.
    count : int
        Arrays of a part.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     finished = Finished(Path(folder) / "parts", np.arange(3.0), 1)
    ...     before = dict(finished.read())
    ...     finished.add(7, np.ones(2))
    ...     before, dict(finished.read())
    ({}, {7: (array([1., 1.]),)})
    """

    path: Path | None
    key: NDArray[Any]
    count: int

    def read(self) -> Iterator[tuple[int, Arrays]]:
        """Yield the number and the arrays of each part; then the file is ready for more."""
        if self.path is None:
            return
        if not self.path.exists() or self.path.stat().st_size == 0:
            with self.path.open("wb") as file:
                np.save(file, self.key)
            return
        with self.path.open("r+b") as file:
            key, end = _next(file), file.tell()
            if key is None or not np.array_equal(key, self.key):
                rule = "It must be the file of the same data and the same scheme, or of none yet."
                check.refuse("resume", rule, str(self.path))
            while (part := [_next(file) for _ in range(1 + self.count)])[-1] is not None:
                number, *arrays = part
                yield int(number), tuple(arrays)  # type: ignore[arg-type]  # none of them is None, as the last is not
                end = file.tell()
            file.truncate(end)

    def add(self, number: int, *arrays: NDArray[Any]) -> None:
        """Keep the arrays of a part."""
        if self.path is not None:
            with self.path.open("ab") as file:
                for array in (np.array(number), *arrays):
                    np.save(file, array)


def _next(file: BinaryIO) -> NDArray[Any] | None:
    """The next array of a file; None at its end, or if it is not whole."""
    try:
        return np.asarray(np.load(file))
    except (EOFError, ValueError, OSError):
        return None
