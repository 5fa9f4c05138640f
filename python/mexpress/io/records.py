"""Rows of a long run in a database that grows as results come, so that an interrupted run continues where it stopped.

Examples
--------
>>> import tempfile
>>> columns = {"n": int, "count": int, "FIT": float}
>>> with tempfile.TemporaryDirectory() as folder:
...     path = Path(f"{folder}/rows.csv")
...     with Records(path, {"seed": 0}, columns, key=1) as records:
...         records.add([(15, 3, 0.5), (15, 4, 0.25)])
...     with Records(path, {"seed": 0}, columns, key=1) as records:
...         print((15,) in records, (30,) in records, records.table()["FIT"])
...     path.read_text().splitlines()[1:]
True False [0.5  0.25]
['n,count,FIT', '15,3,0.5', '15,4,0.25']
"""

import csv
import io
import json
import math
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any, NoReturn, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress.io.archives import replacing

__all__ = ["Records"]

Row: TypeAlias = tuple[Any, ...]


class Records:
    """The rows of tasks, to be opened in a ``with`` statement.

    The rows of a task are written at once to a database beside the CSV file, ``.sqlite``: all or none, whatever ends
    the run. The CSV file is written when the records are closed, after a comment that says what run they are of.
    As long as they are open nobody else can open them.

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

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with Records(Path(f"{folder}/rows.csv"), {}, {"n": int, "FIT": float}, key=1) as records:
    ...         records.add([(15, 0.5)])
    ...         records[15,]
    [(15, 0.5)]
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
        self._names = [f'"{name}"' for name in columns]
        self._tasks: dict[Row, list[Row]] = {}
        self._exported = path.exists()
        if self._exported and not self._database.exists():
            self._refuse("which has no database beside it")
        with self._refusals():
            self._connection = sqlite3.connect(self._database, timeout=0)
        try:
            with self._refusals():
                self._open()
        except BaseException:
            self._connection.close()
            raise

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

        Raises
        ------
        ValueError
            If they are no rows of one task.
        OSError
            If they cannot be written.

        Examples
        --------
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     with Records(Path(f"{folder}/rows.csv"), {}, {"n": int, "FIT": float}, key=1) as records:
        ...         records.add([(15, 0.5)])
        ...         records.add([(15, 0.25)])
        ...         records[15,]
        [(15, 0.25)]
        """
        kinds = self._columns.values()
        given = list(rows)
        whole = all(len(row) == len(kinds) for row in given)
        task = [tuple(kind(cell) for kind, cell in zip(kinds, row, strict=True)) for row in given if whole]
        if len({row[: self._key] for row in task}) != 1:
            rule = f"They must have the columns {', '.join(self._columns)}, and one task's key."
            check.refuse("rows", rule, check.describe(given))
        key = task[0][: self._key]
        same = " AND ".join(f"{name} = ?" for name in self._names[: self._key])
        with self._refusals(), self._connection as connection:
            connection.execute(f"DELETE FROM rows WHERE {same}", key)
            connection.executemany(f"INSERT INTO rows VALUES ({', '.join('?' for _ in kinds)})", task)
        self._tasks[key], self._exported = task, False

    def table(self) -> dict[str, NDArray[Any]]:
        """Return the columns, tasks in the order of their keys whatever the order they were added in.

        Returns
        -------
        dict of str to (rows,) array
            By name; int64, float64 or str.

        Examples
        --------
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     with Records(Path(f"{folder}/rows.csv"), {}, {"n": int, "FIT": float}, key=1) as records:
        ...         records.add([(30, 0.5)])
        ...         records.add([(15, 0.25)])
        ...         records.table()
        {'n': array([15, 30]), 'FIT': array([0.25, 0.5 ])}
        """
        rows = list(self._sorted())
        dtypes = {int: np.int64, float: np.float64, str: np.str_}
        return {
            name: np.array([row[k] for row in rows], dtype=dtypes[kind])
            for k, (name, kind) in enumerate(self._columns.items())
        }

    def close(self) -> None:
        """Write the CSV file, tasks in the order of their keys: the same run leaves the same bytes. Let others in.

        Examples
        --------
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     Records(Path(f"{folder}/rows.csv"), {}, {"n": int, "FIT": float}, key=1).close()
        ...     sorted(path.name for path in Path(folder).iterdir())
        ['rows.csv', 'rows.sqlite']
        """
        try:
            if not self._exported:
                self._export()
        finally:
            self._connection.close()

    def _open(self) -> None:
        """Take the database for us alone, make it if it is new, and read it."""
        execute = self._connection.execute
        # The system takes such a lock back when its process ends, however it ends: none is ever stale.
        execute("PRAGMA locking_mode = EXCLUSIVE")
        with self._connection:
            execute("BEGIN EXCLUSIVE")
            if execute("SELECT count(*) FROM sqlite_master").fetchone() == (0,):
                execute("CREATE TABLE run (description)")
                execute("INSERT INTO run VALUES (?)", (json.dumps(self._run),))
                # Without types: a float stays what it is to the last bit, and -0.0 is not 0.
                execute(f"CREATE TABLE rows ({', '.join(self._names)})")
        self._check_run(json.loads(*execute("SELECT description FROM run").fetchone()))
        rows = execute("SELECT * FROM rows ORDER BY rowid")
        if [name for name, *_ in rows.description] != list(self._columns):
            self._refuse("whose columns are others")
        for row in rows:
            cells = tuple(math.nan if cell is None else cell for cell in row)  # SQLite has no NaN
            self._tasks.setdefault(cells[: self._key], []).append(cells)

    def _check_run(self, run: dict[str, Any]) -> None:
        if run != self._run:
            others = (name for name in {**run, **self._run} if run.get(name) != self._run.get(name))
            differences = (f"{name} {run.get(name)!r}, not {self._run.get(name)!r}" for name in others)
            self._refuse(f"which is of another run ({', '.join(differences)})")

    def _sorted(self) -> Iterator[Row]:
        for key in sorted(self._tasks):
            yield from self._tasks[key]

    def _export(self) -> None:
        text = io.StringIO()
        text.write(f"# mexpress records: {json.dumps(self._run)}\n")
        csv.writer(text, lineterminator="\n").writerows([self._columns, *self._sorted()])
        with replacing(self._path) as file:
            file.write(text.getvalue().encode())

    @contextmanager
    def _refusals(self) -> Iterator[None]:
        """Say in our words what the database refuses."""
        try:
            yield
        except sqlite3.Error as error:
            name = error.sqlite_errorname
            if name.startswith("SQLITE_BUSY"):
                rule = "One run at a time can write there: wait for the other, or choose another directory."
                check.refuse("out", rule, f"{self._path}, which another run has opened")
            if name.startswith(("SQLITE_NOTADB", "SQLITE_CORRUPT", "SQLITE_ERROR")):
                self._refuse("whose database is damaged or holds something else")
            raise OSError(f"{self._database}: {error}") from error

    def _refuse(self, what: str) -> NoReturn:
        names = f"{self._path.name} and {self._database.name}"
        rule = f"Its records must be of this run: choose another directory, or remove {names}."
        check.refuse("out", rule, f"{self._path}, {what}")
