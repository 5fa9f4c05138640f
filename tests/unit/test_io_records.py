"""Rows of a long run: kept whatever ends it, for one run at a time, and written as a table."""

import csv
import math
import re
import sqlite3
import subprocess
import sys

import numpy as np
import pytest
from inputs import refused

from mexpress.io.records import Records

COLUMNS = {"n": int, "name": str, "count": int, "FIT": float}
RUN = {"experiment": "trial", "seed": 0, "quick": False}
TASKS = {
    (30, "b"): [(30, "b", 3, 1 / 3), (30, "b", 4, math.nan)],
    (15, 'a, "quoted"'): [(15, 'a, "quoted"', 3, 1e-300)],
    (15, "a"): [(15, "a", 3, -math.inf), (15, "a", 4, 2.0), (15, "a", 5, 0.1 + 0.2), (15, "a", 6, -0.0)],
}


def opened(path, run=RUN, columns=COLUMNS, key=2):
    return Records(path, run, columns, key)


def files(path):
    return sorted(file.name for file in path.parent.iterdir())


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "rows.csv"
    with opened(path) as records:
        for rows in TASKS.values():
            records.add(rows)
    return path


@pytest.fixture
def database(path):
    return path.with_suffix(".sqlite")


def test_records_return_what_was_added_in_the_order_of_the_keys(path):
    with opened(path) as records:
        assert all(key in records for key in TASKS)
        assert (15, "b") not in records
        assert records[30, "b"][0] == (30, "b", 3, 1 / 3)
        table = records.table()
    rows = [row for key in sorted(TASKS) for row in TASKS[key]]
    for k, (name, kind) in enumerate(COLUMNS.items()):
        assert table[name].dtype.kind == {int: "i", str: "U", float: "f"}[kind]
        assert [*map(repr, table[name].tolist())] == [repr(row[k]) for row in rows]  # bit for bit, and NaN


def test_records_are_a_table_that_others_read(path):
    with path.open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    assert list(rows[0]) == list(COLUMNS)
    assert [row["name"] for row in rows] == ["a"] * 4 + ['a, "quoted"'] + ["b"] * 2
    assert [float(row["FIT"]) for row in rows[:3]] == [-math.inf, 2.0, 0.1 + 0.2]


def test_records_do_not_depend_on_the_order_they_came_in(path, tmp_path):
    other = tmp_path / "other.csv"
    with opened(other) as records:
        for key in sorted(TASKS, reverse=True):
            records.add([tuple(np.array([cell])[0] for cell in row) for row in TASKS[key]])  # numpy's types
    assert other.read_bytes() == path.read_bytes()


def test_an_interrupted_run_leaves_the_same_table_as_one_that_was_not(path, tmp_path):
    whole, parts = path.read_bytes(), tmp_path / "parts.csv"
    for key, rows in TASKS.items():
        with opened(parts) as records:
            assert key not in records
            records.add(rows)
    assert parts.read_bytes() == whole


def test_a_task_that_comes_again_replaces_its_rows(path):
    for _ in range(2):
        with opened(path) as records:
            records.add([(15, "a", 3, 1.0)])
    with opened(path) as records:
        assert records[15, "a"] == [(15, "a", 3, 1.0)]
        assert len(records.table()["n"]) == 4
    assert len(path.read_text().splitlines()) == 2 + 4


def test_records_that_are_whole_are_only_read(path, database):
    before = [file.stat() for file in (path, database)]
    with opened(path) as records:
        assert (15, "a") in records
    after = [file.stat() for file in (path, database)]
    assert [(s.st_ino, s.st_mtime_ns) for s in after] == [(s.st_ino, s.st_mtime_ns) for s in before]


def test_a_table_that_is_gone_is_written_again(path):
    whole = path.read_bytes()
    path.unlink()
    opened(path).close()
    assert path.read_bytes() == whole


def test_one_run_at_a_time_has_the_records(path):
    before = path.read_bytes()
    with opened(path) as records:
        assert "another run has opened" in refused(lambda: opened(path), "out", ValueError)
        records.add([(15, "b", 3, 1.0)])
        assert "another run has opened" in refused(lambda: opened(path), "out", ValueError)
        assert path.read_bytes() == before
    assert files(path) == ["rows.csv", "rows.sqlite"]
    with opened(path) as records:
        assert (15, "b") in records


SCRIPT = """
import itertools, sys
from pathlib import Path
from mexpress.io.records import Records
path, size = Path(sys.argv[1]), int(sys.argv[2])
run = {"experiment": "trial", "seed": 0, "quick": False}
records = Records(path, run, {"n": int, "name": str, "count": int, "FIT": float}, 2)
print("open", flush=True)
for k in itertools.count():
    records.add([(k, "c", count, 0.5) for count in range(size)])
    print(k, flush=True)
"""


@pytest.mark.parametrize("last", [b"open", b"0", b"25"])
def test_a_run_that_is_killed_has_what_it_added_and_the_next_one_continues(path, last):
    size = 2000  # so many that a task is seldom complete when the process ends
    command = [sys.executable, "-c", SCRIPT, path, str(size)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline().strip() == b"open"
        assert "another run has opened" in refused(lambda: opened(path), "out", ValueError)
        while last != b"open" and process.stdout.readline().strip() != last:
            pass
        process.kill()
    with opened(path) as records:
        assert all(key in records for key in TASKS)
        table = records.table()
        numbers, counts = np.unique(table["n"][table["name"] == "c"], return_counts=True)
        assert set(counts) <= {size}
        np.testing.assert_array_equal(numbers, np.arange(len(numbers)))
        assert len(numbers) >= (0 if last == b"open" else int(last) + 1)
        records.add([(len(numbers), "c", 0, 0.5)])
    assert files(path) == ["rows.csv", "rows.sqlite"]


def test_rows_that_cannot_all_be_written_are_not_written(path, database):
    with opened(path) as records:
        records._connection.execute(
            "CREATE TEMP TRIGGER full BEFORE INSERT ON rows WHEN NEW.count = 4 "
            "BEGIN SELECT RAISE(ABORT, 'disk is full'); END"
        )
        with pytest.raises(OSError, match="disk is full"):
            records.add([(15, "b", 3, 1.0), (15, "b", 4, 1.0)])
        assert (15, "b") not in records
    with sqlite3.connect(database) as connection:
        assert connection.execute("SELECT count(*) FROM rows").fetchone() == (7,)
    connection.close()


def test_records_that_are_refused_stay_free(path):
    refused(lambda: opened(path, run={**RUN, "seed": 1}), "out", ValueError)
    with opened(path) as records:
        assert (15, "a") in records


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"run": {**RUN, "seed": 1}}, r"another run \(seed 0, not 1\)"),
        ({"run": {**RUN, "quick": True}}, r"another run \(quick False, not True\)"),
        ({"run": {"experiment": "trial", "seed": 0}}, r"another run \(quick False, not None\)"),
        ({"columns": {**COLUMNS, "more": int}}, "whose columns are others"),
    ],
)
def test_records_of_another_run_are_not_mixed(path, database, options, words):
    before = path.read_bytes(), database.read_bytes()
    text = refused(lambda: opened(path, **options), "out", ValueError)
    assert re.search(words, text), text
    assert (path.read_bytes(), database.read_bytes()) == before


def test_records_of_another_version_are_not_mixed(path, monkeypatch):
    monkeypatch.setattr("mexpress.io.records.version", lambda _: "99")
    assert "another run (mexpress '" in refused(lambda: opened(path), "out", ValueError)


def test_a_table_without_a_database_is_not_touched(tmp_path):
    path = tmp_path / "rows.csv"
    path.write_bytes(b"x,y\n1,2\n")
    assert "no database beside it" in refused(lambda: opened(path), "out", ValueError)
    assert path.read_bytes() == b"x,y\n1,2\n"
    assert files(path) == ["rows.csv"]


@pytest.mark.parametrize("content", [b"x,y\n1,2\n", b"\xff\xfe\x00" * 400])
def test_what_is_no_database_is_not_touched(path, database, content):
    database.write_bytes(content)
    assert "damaged or holds something else" in refused(lambda: opened(path), "out", ValueError)
    assert database.read_bytes() == content


def test_a_database_of_others_is_not_touched(path, database):
    database.unlink()
    with sqlite3.connect(database) as connection:
        connection.execute("CREATE TABLE songs (title)")
    connection.close()
    before = database.read_bytes()
    assert "holds something else" in refused(lambda: opened(path), "out", ValueError)
    assert database.read_bytes() == before


def test_a_damaged_database_is_told(path, database):
    whole = database.read_bytes()
    for damaged in (whole[: len(whole) // 2], whole[:4096] + bytes(len(whole) - 4096)):
        database.write_bytes(damaged)
        assert "damaged" in refused(lambda: opened(path), "out", ValueError)
        assert database.read_bytes() == damaged


def test_a_directory_that_is_not_there_is_an_error_of_the_system(tmp_path):
    with pytest.raises(OSError, match="unable to open"):
        opened(tmp_path / "absent" / "rows.csv")


@pytest.mark.parametrize(
    "rows", [[], [(15, "c", 3)], [(15, "c", 3, 1.0), (30, "c", 3, 1.0)], [(15, "c", 3, 1.0, 2)]]
)
def test_rows_that_are_no_task_are_refused(path, rows):
    with opened(path) as records:
        refused(lambda: records.add(rows), "rows", ValueError)
        assert len(records.table()["n"]) == 7
