"""Problems that fail, take too long, or kill their process: everything else is done, and done once."""

import logging
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import nbclient
import nbformat
import numpy as np
import pytest

import mexpress as mx
from mexpress.batch.spool import Spool, kept

posix = pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")


# What workers are given must be importable.


def note(folder, index):
    """Say in a file that a problem was done, after all else."""
    with (folder / "done").open("a") as file:
        file.write(f"{index}\n")


def done(folder):
    return Counter(map(int, (folder / "done").read_text().split()))


def root(index, folder):
    note(folder, index)
    if index % 5 == 3:
        raise ValueError(f"no root of {-index}")
    return index**0.5


def die_once(index, folder, seconds=0.0, at=1, size=3):
    """Kill the process in the midst of a problem, the first time."""
    time.sleep(seconds)
    if index == at and not (folder / "killed").exists():
        (folder / "killed").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    note(folder, index)
    return index, np.full(size, index)


def die_always(index, at):
    if index == at:
        os.kill(os.getpid(), signal.SIGKILL)
    return index


def sleep(index, at, seconds=30):
    time.sleep(seconds if index in at else 0.0)
    return index


def fail_at_first(index, folder, times):
    with (folder / str(index)).open("a") as file:
        file.write("x")
    if (folder / str(index)).stat().st_size <= times:
        raise OSError(f"of {index}")
    return index


# ------------------------------------------------------------------------------------------------------ failures


@pytest.mark.parametrize(("workers", "number"), [(1, 12), (2, 12), (2, 400)])
def test_a_failure_is_a_value_with_its_index_and_error(workers, number, tmp_path):
    seen = {}
    found = mx.map_problems(
        root,
        [(i,) for i in range(number)],
        workers,
        on_error="return",
        on_result=seen.__setitem__,
        folder=tmp_path,
    )
    assert found == [seen[i] for i in range(number)]
    for index, result in enumerate(found):
        if index % 5 == 3:
            assert isinstance(result, mx.Failure)
            assert result.index == index
            assert isinstance(result.error, ValueError)
            assert result.error.args == (f"no root of {-index}",)
            assert "in root" in result.traceback
        else:
            assert result == index**0.5
    assert done(tmp_path) == Counter(range(number))


@pytest.mark.parametrize("workers", [1, 2])
def test_results_come_one_by_one_until_an_error(workers, tmp_path):
    found = []
    stream = mx.iterate_problems(root, [(i,) for i in range(12)], workers, folder=tmp_path)
    with pytest.raises(ValueError, match="no root of -3"):
        found.extend(stream)
    assert {(0, 0.0), (1, 1.0), (2, 2**0.5)} <= set(found)
    assert 3 not in dict(found)


def test_nothing_begins_before_the_first_result_is_asked_for_and_all_ends_with_the_last(tmp_path):
    stream = mx.iterate_problems(root, [(0,), (1,)], workers=1, folder=tmp_path)
    assert list(tmp_path.iterdir()) == []
    assert next(stream) == (0, 0.0)
    assert done(tmp_path) == {0: 1}
    stream = mx.iterate_problems(sleep, [(0,), *[(1,)] * 5], workers=2, at=[1])
    assert next(stream) == (0, 0)
    start = time.monotonic()
    stream.close()
    assert time.monotonic() - start < 5


@pytest.mark.parametrize("workers", [1, 2])
def test_what_fails_is_tried_again(workers, tmp_path, caplog):
    problems = [(i,) for i in range(4)]
    with caplog.at_level(logging.INFO, "mexpress"):
        assert mx.map_problems(fail_at_first, problems, workers, retries=2, folder=tmp_path, times=2) == [
            *range(4)
        ]
    told = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert sorted(told) == sorted(
        f"Try {k} of 3 of problem {i}: OSError('of {i}')" for i in range(4) for k in (1, 2)
    )
    assert caplog.messages[0] == "Calling fail_at_first on 4 problems."
    assert caplog.messages[-1].endswith("0 failures.")
    for file in tmp_path.iterdir():
        file.unlink()
    found = mx.map_problems(
        fail_at_first, problems, workers, on_error="return", retries=1, folder=tmp_path, times=2
    )
    assert [failure.error.args for failure in found] == [(f"of {i}",) for i in range(4)]


# ---------------------------------------------------------------------------------------------- killed processes


@posix
@pytest.mark.parametrize(
    ("number", "at", "seconds"), [(300, 137, 0.0), (20, 9, 0.02)], ids=["small", "large"]
)
def test_a_killed_worker_loses_nothing_and_repeats_nothing(number, at, seconds, tmp_path, caplog):
    seen = []
    found = mx.map_problems(
        die_once,
        [(i,) for i in range(number)],
        workers=2,
        on_result=lambda index, _: seen.append(index),
        folder=tmp_path,
        seconds=seconds,
        at=at,
    )
    assert (tmp_path / "killed").exists()
    assert [index for index, _ in found] == [*range(number)]
    for index, array in found:
        np.testing.assert_array_equal(array, [index] * 3)
    assert sorted(seen) == [*range(number)]
    assert done(tmp_path) == Counter(range(number))
    told = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert told[0] == "A worker process ended, with exit code -9."
    assert told[1].startswith(f"Try 1 of 3 of problem {at}: ")
    assert len(told) == 2


@posix
@pytest.mark.parametrize("size", [3, 50_000], ids=["in the spool", "too large for it"])
def test_a_killed_worker_and_a_file_of_results_lose_nothing(size, tmp_path):
    options = {"folder": tmp_path, "at": 57, "size": size, "resume": tmp_path / "results"}
    for _ in range(2):  # the second time, all are in the file
        found = mx.map_problems(die_once, [(i,) for i in range(90)], workers=2, **options)
        for i, (index, array) in enumerate(found):
            assert index == i
            np.testing.assert_array_equal(array, np.full(size, i))
        assert done(tmp_path) == Counter(range(90))
    assert (tmp_path / "killed").exists()


@posix
def test_a_problem_that_always_kills_is_a_failure_and_all_others_are_done():
    found = mx.map_problems(die_always, [(i,) for i in range(200)], workers=2, on_error="return", at=77)
    assert [result for result in found if not isinstance(result, mx.Failure)] == [*range(77), *range(78, 200)]
    assert found[77].index == 77
    assert isinstance(found[77].error, RuntimeError)
    assert "exit code -9" in str(found[77].error)


def test_what_a_spool_holds_is_read_up_to_what_was_being_written(tmp_path):
    def held():
        return [(index, bytes(packed)) for index, packed in kept(tmp_path / "spool")[1]]

    assert held() == []
    (tmp_path / "spool").write_bytes(b"\1\0\0")  # the disk was full
    assert held() == []
    spool = Spool(tmp_path / "spool")
    assert held() == []
    assert spool.keep(3, b"three")
    end = spool.end[0]
    assert spool.keep(4, b"four")
    spool.end[0] = end  # as if it had not come so far
    assert held() == [(3, b"three")]
    spool.clear()
    assert spool.keep(5, b"")
    assert held() == [(5, b"")]


# ------------------------------------------------------------------------------------------------- what takes long


@pytest.mark.parametrize("workers", [1, 2])
def test_a_call_that_takes_too_long_is_ended_and_no_other(workers):
    start = time.monotonic()
    found = mx.map_problems(
        sleep, [(i,) for i in range(30)], workers, on_error="return", timeout=0.5, at=[4, 20]
    )
    assert time.monotonic() - start < 30
    assert [i for i, result in enumerate(found) if isinstance(result, mx.Failure)] == [4, 20]
    assert isinstance(found[4].error, TimeoutError)
    assert str(found[4].error) == "The call took longer than 0.5 s."
    assert [found[i] for i in range(30) if i not in (4, 20)] == [i for i in range(30) if i not in (4, 20)]


def test_a_call_among_small_ones_that_takes_too_long_is_made_once(tmp_path):
    problems = [(i, tmp_path) for i in range(200)]
    found = mx.map_problems(note_and_sleep, problems, workers=2, on_error="return", timeout=0.5, at=[120])
    assert [i for i, result in enumerate(found) if isinstance(result, mx.Failure)] == [120]
    assert done(tmp_path) == Counter(range(200))


def note_and_sleep(index, folder, at):
    note(folder, index)
    return sleep(index, at)


def test_a_timeout_is_for_a_call_not_for_all():
    problems = [(i,) for i in range(6)]
    assert mx.map_problems(sleep, problems, workers=2, timeout=1.0, at=range(6), seconds=0.4) == [*range(6)]


def test_a_timeout_is_raised_and_its_problem_named():
    with pytest.raises(TimeoutError, match=r"longer than 0\.2 s") as caught:
        mx.map_problems(sleep, [(0,), (1,)], workers=2, timeout=0.2, at=[1])
    assert caught.value.__notes__ == ["This was problem 1 (from 0) of 2."]


def test_a_client_does_not_wait_for_what_takes_too_long():
    with ThreadPoolExecutor(2) as pool:
        found = mx.map_problems(
            sleep, [(i,) for i in range(5)], client=pool, on_error="return", timeout=0.2, at=[2], seconds=2
        )
    assert isinstance(found[2].error, TimeoutError)
    assert [found[i] for i in (0, 1, 3, 4)] == [0, 1, 3, 4]


# -------------------------------------------------------------------------------------------------- forks, notebooks


@posix
def test_a_forked_child_leaves_the_workers_and_their_folder_alone():
    stream = mx.iterate_problems(sleep, [(i,) for i in range(40)], workers=2, at=range(1, 40), seconds=0.05)
    assert next(stream)[0] in (0, 1)
    child = os.fork()
    if child == 0:
        stream.close()
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
    assert len(list(stream)) == 39


NOTEBOOK = """
    import mexpress as mx

    class Pair:
        def __init__(self, value):
            self.value = value

    def double(pair):
        return Pair(factor * pair.value)

    factor = 2
    pairs = mx.map_problems(double, [(Pair(1),), (Pair(2),)], workers=2)
    print([isinstance(pair, Pair) and pair.value for pair in pairs])
    print(mx.map_problems(lambda x: x + factor, [(1,), (2,)], workers=2))
    def wrong(x):
        raise KeyError(x)
    print(mx.map_problems(wrong, [(1,), (2,)], workers=2, on_error="return"))
"""


def interactive(code):
    """Run code that, like a notebook's, is in no file that a worker could import."""
    command = [sys.executable, "-c", textwrap.dedent(code)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


SAID = """\
[2, 4]
[3, 4]
[Failure(index=0, error=KeyError(1)), Failure(index=1, error=KeyError(2))]
"""


def test_functions_and_classes_of_no_file_go_by_value():
    run = interactive(NOTEBOOK)
    assert (run.stdout, run.stderr) == (SAID, "")


@pytest.mark.slow
def test_a_notebook_has_its_functions_called():
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(textwrap.dedent(NOTEBOOK))])
    (cell,) = nbclient.NotebookClient(notebook, timeout=60, kernel_name="python3").execute().cells
    assert "".join(output.text for output in cell.outputs) == SAID


def test_without_cloudpickle_a_function_of_a_notebook_is_refused():
    run = interactive("import sys; sys.modules['cloudpickle'] = None\n" + textwrap.dedent(NOTEBOOK))
    said = run.stderr.splitlines()[-1]
    assert said.startswith("TypeError: Invalid function. It must be picklable: ")
    assert "mexpress[notebook]" in said


def large(index, size):
    time.sleep(0.02)
    return np.full(size, index)


def test_results_that_wait_for_a_slow_reader_are_not_late():
    some = [(index, 200_000) for index in range(6)]
    found = {}
    for index, result in mx.iterate_problems(large, some, workers=2, timeout=0.3, on_error="return"):
        time.sleep(0.4)
        found[index] = result
    assert {index: result[0] for index, result in found.items()} == {index: index for index in range(6)}


@posix
def test_without_room_for_files_the_late_one_is_told(tmp_path):
    script = """
        import resource, signal
        from test_batch_faults import nap_at
        import mexpress as mx
        if __name__ == "__main__":
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
            some = [(k, 25) for k in range(40)]
            found = mx.map_problems(nap_at, some, workers=1, timeout=0.7, on_error="return")
            print([k for k, each in enumerate(found) if each != k])
    """
    (tmp_path / "script.py").write_text(textwrap.dedent(script))
    path = os.pathsep.join([os.path.dirname(__file__), *sys.path])
    ended = subprocess.run(
        [sys.executable, tmp_path / "script.py"],
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    assert ended.stdout == "[25]\n"


def nap_at(index, at):
    time.sleep(30 if index == at else 0.002)
    return index
