"""Parts of long work that are finished, in a file: the work goes on after them when it is started again."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mexpress.records import Records

Arrays = tuple[NDArray[Any], ...]

_RULE = "It must be the file of the same data and the same scheme, or of none yet."


class Finished:
    """Arrays of finished parts, each after its number.

    Parameters
    ----------
    path : Path or None
        The file; nothing is kept if it is None.
    key : str
        What tells the work from other work, whose file is refused.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     finished = Finished(Path(folder) / "parts", "ones")
    ...     finished.add(7, np.ones(2))
    ...     dict(finished.read())
    {7: (array([1., 1.]),)}
    """

    def __init__(self, path: Path | None, key: str) -> None:
        self.records = None if path is None else Records(path, f"mexpress: parts of {key}\n".encode(), _RULE)

    def read(self) -> Iterator[tuple[int, Arrays]]:
        """Yield the number and the arrays of each part."""
        for record in self.records or ():
            file = io.BytesIO(record)
            number, *arrays = (np.load(file) for _ in range(int(np.load(file))))
            yield int(number), tuple(arrays)

    def add(self, number: int, *arrays: NDArray[Any]) -> None:
        """Keep the arrays of a part."""
        if self.records:
            file = io.BytesIO()
            for array in (np.array(1 + len(arrays)), np.array(number), *arrays):
                np.save(file, array)
            self.records.add([file.getvalue()])
