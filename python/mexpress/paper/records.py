"""Rows of a long run in a file that grows as results come, so that an interrupted run continues where it stopped.

Examples
--------
>>> import tempfile
>>> columns = {"n": int, "count": int, "FIT": float}
>>> with tempfile.TemporaryDirectory() as folder:
...     path = Path(f"{folder}/rows.csv")
...     with Records(path, {"experiment": "trial", "seed": 0}, columns, key=1) as records:
...         records.add([(15, 3, 0.5), (15, 4, 0.25)])
...     with Records(path, {"experiment": "trial", "seed": 0}, columns, key=1) as records:
...         (15,) in records, (30,) in records, records.table()["FIT"]
(True, False, array([0.5 , 0.25]))
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn, Self, TextIO, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress.cli import report as reports
from mexpress.models import files
from mexpress.paper.locks import Lock

__all__ = ["Records"]

Row: TypeAlias = tuple[Any, ...]
Key: TypeAlias = tuple[Any, ...]

_MARK = "# mexpress records: "
_SIZE = "rows_of_task"
"""Name of the column that tells how many rows a task has, and so whether they are all there."""


class Records:
    """A CSV file of the rows of tasks, to be opened in a ``with`` statement.

    A task's rows are written and flushed at once. Opening a file that exists keeps the tasks that are complete
    and drops what a crash tore; a file that is whole is not touched until a task is added. The first line, a
    comment, says what run the rows are of. As long as it is open, a file beside it, ``.lock``, keeps others out.

    Parameters
    ----------
    path : Path
        Of the file, made if there is none.
    run : mapping of str to str, int, float or bool
        What the rows depend on, such as the seed; the version of mexpress is added.
    columns : mapping of str to type
        Names and types (int, float or str) of the columns, in order.
    key : int
        How many of the first columns name the task.

    Raises
    ------
    ValueError
        If the file is none of records, or of another run or with other columns: rows are never mixed. If
        somebody else has opened it and would write over what we add.
    OSError
        If the file cannot be read or written.

    Examples
    --------
    See the module.
    """

    def __init__(
        self,
        path: Path,
        run: Mapping[str, Any],
        columns: Mapping[str, type[int] | type[float] | type[str]],
        key: int,
    ) -> None:
        self._path, self._columns, self._width = path, dict(columns), key
        run = {**run, "mexpress": reports.versions()["mexpress"]}
        self._head = [_MARK + json.dumps(run), ",".join([*columns, _SIZE])]
        self._tasks: dict[Key, list[Row]] = {}
        self._file: TextIO | None = None
        try:
            self._lock = Lock(path.with_name(f"{path.name}.lock"))
        except BlockingIOError:
            rule = "One run at a time can write there: wait for the other, or choose another directory."
            check.refuse("out", rule, f"{path}, which another run has opened")
        try:
            self._tasks, whole = self._read(run) if path.exists() else ({}, False)
            if not whole:
                self._rewrite(self._tasks)
        except BaseException:
            self._lock.release()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __contains__(self, key: Key) -> bool:
        """Whether the task's rows are there."""
        return key in self._tasks

    def __len__(self) -> int:
        """Return the number of tasks."""
        return len(self._tasks)

    def add(self, rows: Iterable[Sequence[Any]]) -> None:
        """Append all rows of one task.

        Parameters
        ----------
        rows : iterable of sequences
            One or more, a cell for each column; they share the key. NaN is a value like any other.

        Examples
        --------
        See the module.
        """
        added = [tuple(row) for row in rows]
        key = added[0][: self._width] if added else ()
        if not added or any(len(row) != len(self._columns) or row[: self._width] != key for row in added):
            rule = f"They must have the columns {', '.join(self._columns)}, and one task's key."
            check.refuse("rows", rule, check.describe(added))
        if self._file is None:
            self._file = self._path.open("a", encoding="utf-8", newline="")
        self._file.write(_text(added))
        self._file.flush()
        self._tasks[key] = added

    def table(self) -> dict[str, NDArray[Any]]:
        """Return the columns, tasks in the order of their keys whatever the order they were added in.

        Returns
        -------
        dict of str to (rows,) array
            By name; int64, float64 or str.

        Examples
        --------
        See the module.
        """
        rows = [row for key in sorted(self._tasks) for row in self._tasks[key]]
        cells = zip(*rows, strict=True) if rows else iter([()] * len(self._columns))
        kinds = {int: np.int64, float: np.float64, str: np.str_}
        return {
            name: np.array(column, dtype=kinds[kind])
            for (name, kind), column in zip(self._columns.items(), cells, strict=True)
        }

    def close(self) -> None:
        """Close the file, its tasks in the order of their keys: the same run leaves the same bytes.

        Examples
        --------
        See the module.
        """
        try:
            if self._file is not None:
                self._file.close()
            if list(self._tasks) != sorted(self._tasks):
                self._tasks = dict(sorted(self._tasks.items()))
                self._rewrite(self._tasks)
        finally:
            self._lock.release()

    def _rewrite(self, tasks: Mapping[Key, list[Row]]) -> None:
        with files.replacing(self._path) as file:
            file.write("".join(line + "\n" for line in self._head).encode())
            file.writelines(_text(rows).encode() for rows in tasks.values())

    def _read(self, run: Mapping[str, Any]) -> tuple[dict[Key, list[Row]], bool]:
        """Return the tasks that are complete, and whether the file holds nothing else."""
        try:
            text = self._path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            self._refuse("which is no text")
        lines = text.split("\n")[:-1]  # what follows the last line's end is torn
        if not text.startswith(_MARK[: len(text)]):
            self._refuse("which holds something else")
        if len(lines) < len(self._head):  # killed while it was made
            return {}, False
        self._check_run(lines[0].removeprefix(_MARK), run)
        if lines[1] != self._head[1]:
            self._refuse("whose columns are others")
        tasks = dict(self._complete(lines[2:]))
        whole = len(self._head) + sum(map(len, tasks.values())) == len(lines) and text.endswith("\n")
        return tasks, whole

    def _check_run(self, text: str, run: Mapping[str, Any]) -> None:
        try:
            found = dict(json.loads(text))
        except (TypeError, ValueError):
            self._refuse("whose first line is damaged")
        if found != run:
            other = (name for name in {**found, **run} if found.get(name) != run.get(name))
            told = ", ".join(f"{name} {found.get(name)!r}, not {run.get(name)!r}" for name in other)
            self._refuse(f"which is of another run ({told})")

    def _complete(self, lines: Sequence[str]) -> Iterator[tuple[Key, list[Row]]]:
        """Yield tasks all of whose rows follow each other."""
        kinds = [*self._columns.values(), int]
        rows: list[Row] = []
        for number, cells in enumerate(csv.reader(lines), start=len(self._head) + 1):
            try:
                *row, size = (kind(cell) for kind, cell in zip(kinds, cells, strict=True))
            except ValueError:
                self._refuse(f"whose line {number} is damaged")
            if rows and tuple(row[: self._width]) != rows[0][: self._width]:
                rows = []
            rows.append(tuple(row))
            if len(rows) == size:
                yield rows[0][: self._width], rows
                rows = []

    def _refuse(self, what: str) -> NoReturn:
        rule = "Its records must be of this run: choose another directory, or remove the file."
        check.refuse("out", rule, f"{self._path}, {what}")


def _text(rows: Sequence[Row]) -> str:
    """Lines of a task; a float as the shortest text that reads back as the same."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows([*map(_plain, row), len(rows)] for row in rows)
    return text.getvalue()


def _plain(cell: Any) -> Any:
    return cell.item() if isinstance(cell, np.generic) else cell
