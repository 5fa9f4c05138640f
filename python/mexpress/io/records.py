"""Rows of a long run in a database that grows as results come, so that an interrupted run continues where it stopped.

Examples
--------
>>> import tempfile
>>> with tempfile.TemporaryDirectory() as folder:
...     path = Path(f"{folder}/rows.csv")
...     for n in (30, 15):
...         with Records(path, {"seed": 0}, {"n": int, "FIT": float}, key=1) as records:
...             records.add([(n, 0.5), (n, 0.25)])
...     path.read_text().splitlines()[1:]
['n,FIT', '15,0.5', '15,0.25', '30,0.5', '30,0.25']
"""

import csv
import io
import json
import math
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any, NoReturn, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress.io.archives import replacing

Row: TypeAlias = tuple[Any, ...]


class Records:
    """The rows of tasks, to be opened in a ``with`` statement.

    All rows of a task or none are written, whatever ends the run, to a database beside the CSV file, ``.sqlite``. The
    CSV file, whose first line is a comment that says what run it is of, is written when the records are closed, tasks
    in the order of their keys: the same run leaves the same bytes. As long as they are open nobody else can open them.

    Parameters
    ----------
    path : Path
        Of the CSV file.
    run : mapping of str to str, int, float or bool
        What the rows depend on, such as the seed; the version of mexpress is added.
    columns : mapping of str to type
        Names and types (int, float or str) of the columns, in order.
    key : int
        How many of the first columns name the task.

    Raises
    ------
    ValueError
        If the files hold something else, or rows of another run or with other columns: rows are never mixed. If
        somebody else has opened them.
    OSError
        If a file cannot be read or written.
    """

    def __init__(
        self,
        path: Path,
        run: Mapping[str, Any],
        columns: Mapping[str, type[int] | type[float] | type[str]],
        key: int,
    ) -> None:
        self._path, self._database = path, path.with_suffix(".sqlite")
        self._run = {**run, "mexpress": version("mexpress")}
        self._columns, self._key = dict(columns), key
        self._tasks: dict[Row, list[Row]] = {}
        self._exported = path.exists()
        if self._exported and not self._database.exists():
            self._refuse("which has no database beside it")
        with self._refusals(), ExitStack() as stack:
            connection = stack.enter_context(closing(sqlite3.connect(self._database, timeout=0)))
            self._read(connection)
            self._connection, self._close = connection, stack.pop_all().close

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __contains__(self, key: Row) -> bool:
        """Whether the task's rows are there."""
        return key in self._tasks

    def __getitem__(self, key: Row) -> list[Row]:
        """Return the task's rows."""
        return self._tasks[key]

    def add(self, rows: Iterable[Sequence[Any]]) -> None:
        """Write all rows of one task, in place of those that it may have.

        Parameters
        ----------
        rows : iterable of sequences
            One or more, a cell for each column; they share the key. NaN is a value like any other.
        """
        rows, kinds = list(rows), self._columns.values()
        fitting = all(len(row) == len(kinds) for row in rows)
        task = [tuple(kind(cell) for kind, cell in zip(kinds, row, strict=True)) for row in rows if fitting]
        if len({row[: self._key] for row in task}) != 1:
            rule = f"They must have the columns {', '.join(self._columns)}, and one task's key."
            check.refuse("rows", rule, check.describe(rows))
        key = task[0][: self._key]
        same = " AND ".join(f'"{name}" = ?' for name in list(self._columns)[: self._key])
        with self._refusals(), self._connection as connection:
            connection.execute(f"DELETE FROM rows WHERE {same}", key)
            connection.executemany(f"INSERT INTO rows VALUES ({', '.join('?' * len(kinds))})", task)
        self._tasks[key], self._exported = task, False

    def table(self) -> dict[str, NDArray[Any]]:
        """Return the columns, tasks in the order of their keys whatever the order they were added in.

        Returns
        -------
        dict of str to (rows,) array
            By name; int64, float64 or str.
        """
        rows, dtypes = self._sorted(), {int: np.int64, float: np.float64, str: np.str_}
        return {
            name: np.array([row[k] for row in rows], dtype=dtypes[kind])
            for k, (name, kind) in enumerate(self._columns.items())
        }

    def close(self) -> None:
        """Write the CSV file, unless nothing was added, and let others in."""
        try:
            if not self._exported:
                text = io.StringIO()
                text.write(f"# mexpress records: {json.dumps(self._run)}\n")
                csv.writer(text, lineterminator="\n").writerows([self._columns, *self._sorted()])
                with replacing(self._path) as file:
                    file.write(text.getvalue().encode())
        finally:
            self._close()

    def _sorted(self) -> list[Row]:
        return [row for key in sorted(self._tasks) for row in self._tasks[key]]

    def _read(self, connection: sqlite3.Connection) -> None:
        """Take the database for us alone, make it if it is new, and read it."""
        execute = connection.execute
        # The system takes such a lock back when its process ends, however it ends: none is ever stale.
        execute("PRAGMA locking_mode = EXCLUSIVE")
        with connection:
            execute("BEGIN EXCLUSIVE")
            if execute("SELECT count(*) FROM sqlite_master").fetchone() == (0,):
                execute("CREATE TABLE run (description)")
                execute("INSERT INTO run VALUES (?)", (json.dumps(self._run),))
                # Without types: a float stays what it is to the last bit, and -0.0 is not 0.
                names = ", ".join(f'"{name}"' for name in self._columns)
                execute(f"CREATE TABLE rows ({names})")
        run = json.loads(*execute("SELECT description FROM run").fetchone())
        others = [name for name in {**run, **self._run} if run.get(name) != self._run.get(name)]
        if others:
            differences = (f"{name} {run.get(name)!r}, not {self._run.get(name)!r}" for name in others)
            self._refuse(f"which is of another run ({', '.join(differences)})")
        rows = execute("SELECT * FROM rows ORDER BY rowid")
        if [name for name, *_ in rows.description] != list(self._columns):
            self._refuse("whose columns are others")
        for row in rows:
            cells = tuple(math.nan if cell is None else cell for cell in row)  # SQLite has no NaN
            self._tasks.setdefault(cells[: self._key], []).append(cells)

    @contextmanager
    def _refusals(self) -> Iterator[None]:
        """Say in our words what the database refuses."""
        try:
            yield
        except sqlite3.Error as error:
            if error.sqlite_errorname.startswith("SQLITE_BUSY"):
                rule = "One run at a time can write there: wait for the other, or choose another directory."
                check.refuse("out", rule, f"{self._path}, which another run has opened")
            if error.sqlite_errorname.startswith(("SQLITE_NOTADB", "SQLITE_CORRUPT", "SQLITE_ERROR")):
                self._refuse("whose database is damaged or holds something else")
            raise OSError(f"{self._database}: {error}") from error

    def _refuse(self, what: str) -> NoReturn:
        names = f"{self._path.name} and {self._database.name}"
        rule = f"Its records must be of this run: choose another directory, or remove {names}."
        check.refuse("out", rule, f"{self._path}, {what}")
