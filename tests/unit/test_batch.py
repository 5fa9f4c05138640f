"""Many problems at once: who computes them does not matter, whatever happens to whom."""

import os
import select
import signal
import subprocess
import sys
import textwrap
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from inputs import in_form, refused
from threadpoolctl import threadpool_limits

import mexpress as mx

posix = pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
RNG = np.random.default_rng(0)
CRITERIA = ["FIT", "PRESS", "KF05", "ER05", "NN05PTS"]


def problem(n):
    source = RNG.uniform(0, 1, (n, 2)) * [640, 480]
    return source, 0.9 * source + 9 * np.sin(source[:, ::-1] / 90) + RNG.normal(0, 0.5, source.shape)


PROBLEMS = [problem(n) for n in (150, 20, 60, 12, 30, 25)]


# What workers are given must be importable.


def nap(seconds, value):
    time.sleep(seconds)
    return value


def surroundings(index):
    time.sleep(0.2)
    names = ("MEXPRESS_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    return os.getpid(), [os.environ.get(name) for name in names]


class OddError(Exception):
    """Its arguments are not those that it was made of."""

    def __init__(self, first, second):  # cannot be unpickled
        super().__init__(first + second)


def fail(delay, error, *message):
    time.sleep(delay)
    if error is not None:
        raise error(*message)
    return delay


def die(index, how):
    if index == 1:
        if how == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        os._exit(3)
    time.sleep(0.1)
    return index


def family(index):
    return os.getpid(), set(mx.map_problems(surroundings_alone, [(0,), (1,)], workers=2))


def surroundings_alone(_):
    return os.getpid()


def unpicklable(_):
    return threading.Lock()


def assert_equal(found, expected):
    assert found.selected == expected.selected
    for name, curve in expected.curves.items():
        np.testing.assert_array_equal(found.curves[name], curve)
    np.testing.assert_array_equal(found.warp.parameters, expected.warp.parameters)


OPTIONS = {"criterion": "ER10", "criteria": CRITERIA, "image_size": (640, 480)}


@pytest.fixture(scope="module")
def expected():
    # The last bits of numpy's products depend on the number of its BLAS's threads, and workers have one.
    with threadpool_limits(1, "blas"):
        yield [mx.select_warp(*matches, **OPTIONS, smoothing=0) for matches in PROBLEMS]


@pytest.mark.parametrize("workers", [1, 2, pytest.param(3, marks=pytest.mark.slow)])
def test_results_are_those_of_a_loop_bit_for_bit(expected, workers):
    problems = [PROBLEMS[0], *({"source": a, "target": b} for a, b in PROBLEMS[1:4]), *PROBLEMS[4:]]
    found = mx.map_problems(mx.select_warp, iter(problems), workers=workers, **OPTIONS, smoothing=0)
    for one, other in zip(found, expected, strict=True):
        assert_equal(one, other)


def test_results_come_in_any_order_and_are_returned_in_theirs():
    seen = []
    problems = [(2.0, "a"), *((0.0, value) for value in "bcdefg")]
    found = mx.map_problems(nap, problems, workers=2, on_result=lambda *result: seen.append(result))
    assert found == list("abcdefg")
    assert seen[-1] == (0, "a")
    assert sorted(seen) == list(enumerate("abcdefg"))


def test_every_worker_has_one_thread_and_the_parent_is_as_before():
    before = dict(os.environ)
    found = mx.map_problems(surroundings, [(i,) for i in range(6)], workers=2)
    assert len({pid for pid, _ in found}) == 2
    assert os.getpid() not in {pid for pid, _ in found}
    assert all(variables == ["1"] * 4 for _, variables in found)
    assert dict(os.environ) == before


@pytest.mark.slow
def test_the_number_of_workers_is_that_of_threads(monkeypatch):
    monkeypatch.setenv("MEXPRESS_NUM_THREADS", "3")
    assert len({pid for pid, _ in mx.map_problems(surroundings, [(i,) for i in range(9)])}) == 3
    monkeypatch.setenv("MEXPRESS_NUM_THREADS", "1")
    assert {pid for pid, _ in mx.map_problems(surroundings, [(0,), (1,)])} == {os.getpid()}


def test_options_are_for_every_call_and_a_problem_comes_first():
    def name(a, b=0, c=0):
        return a, b, c

    assert mx.map_problems(name, [(1,), {"a": 2, "b": 3}], workers=1, b=8, c=9) == [(1, 8, 9), (2, 3, 9)]


def test_no_problems_no_results():
    assert mx.map_problems(nap, []) == []
    assert mx.map_problems(nap, (), client=ThreadPoolExecutor(1), progress=True) == []


def test_one_worker_takes_what_cannot_be_pickled():
    assert mx.map_problems(lambda x: x() + 1, [(lambda: 1,)], workers=1) == [2]


def test_a_worker_does_not_start_workers():
    for pid, children in mx.map_problems(family, [(0,), (1,)], workers=2):
        assert children == {pid}


# -------------------------------------------------------------------------------------------------- wrong input


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("problems", [None, 3, "ab", b"ab", nap])
def test_problems_that_are_none(problems, workers):
    refused(lambda: mx.map_problems(nap, problems, workers=workers), "problems", TypeError)


@pytest.mark.parametrize("wrong", [3, "ab", None, [1, 2], {1: 2}, np.zeros(2)])
def test_a_problem_that_is_no_tuple_nor_mapping(wrong):
    text = refused(lambda: mx.map_problems(nap, [(0, 1), wrong]), "problems", TypeError)
    assert text.startswith("Invalid problems[1]. It must be a tuple")


def test_what_cannot_be_called():
    refused(lambda: mx.map_problems(None, []), "function", TypeError)
    refused(lambda: mx.map_problems(nap, [], on_result=3), "on_result", TypeError)
    refused(lambda: mx.map_problems(nap, [], progress="yes"), "progress", TypeError)


@pytest.mark.parametrize("wrong", [lambda: None, lambda result: None, lambda a, b, c: None])
def test_what_cannot_be_told_of_a_result_is_refused_before_the_work(wrong):
    text = refused(lambda: mx.map_problems(fail, [(0, KeyError)], on_result=wrong), "on_result", TypeError)
    assert "two arguments, an index and a result" in text


def test_an_error_of_on_result_says_where():
    with pytest.raises(TypeError) as caught:  # int takes a text and its base
        mx.map_problems(pow, [(2, 3)], workers=1, on_result=int)
    assert caught.value.__notes__ == ["on_result raised this for problem 0 (from 0)."]


@pytest.mark.parametrize("name", ["map_problems", "iterate_problems"])
@pytest.mark.parametrize(
    ("argument", "wrong"),
    [
        *[("on_error", wrong) for wrong in (None, True, "Raise", "ignore", 1, ["raise"], np.zeros(2))],
        *[("timeout", wrong) for wrong in (0, -1, np.nan, np.inf, "5", True, [1.0])],
        *[("retries", wrong) for wrong in (-1, 1.5, "1", None, True)],
        *[("resume", wrong) for wrong in (3, "", b"\0", [1])],
    ],
)
def test_wrong_options_are_refused_before_the_work(name, argument, wrong):
    refused(lambda: getattr(mx, name)(fail, [(0, KeyError)], workers=1, **{argument: wrong}), argument)


def test_what_cannot_be_pickled(monkeypatch):
    monkeypatch.setitem(sys.modules, "cloudpickle", None)
    text = refused(lambda: mx.map_problems(lambda x: x, [(1,), (2,)], workers=2), "function", TypeError)
    assert "workers=1" in text
    assert "mexpress[notebook]" in text
    problems = [(0.0, 1), (0.0, 2), (0.0, threading.Lock())]
    with pytest.raises(TypeError, match="pickle") as caught:
        mx.map_problems(nap, problems, workers=2)
    assert caught.value.__notes__ == ["This was problem 2 (from 0) of 3."]


def test_a_result_that_cannot_be_pickled():
    with pytest.raises(TypeError, match="pickle") as caught:
        mx.map_problems(unpicklable, [(0,), (1,)], workers=2)
    assert caught.value.__notes__ == ["This was problem 0 (from 0) of 2."]


# ------------------------------------------------------------------------------------------------------- errors


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_is_raised_as_it_is_and_says_where(workers):
    problems = [PROBLEMS[1], PROBLEMS[3], (PROBLEMS[1][0], PROBLEMS[1][1] * np.nan), PROBLEMS[4]]
    with pytest.raises(ValueError, match=r"^Invalid target\. ") as caught:
        mx.map_problems(mx.select_warp, problems, workers=workers, smoothing=0)
    in_form(caught.value)
    assert caught.value.__notes__ == ["This was problem 2 (from 0) of 4."]
    if workers == 2:
        assert "in select_warp" in str(caught.value.__cause__)
    else:
        assert caught.traceback[-1].path.name == "_validation.py"


@pytest.mark.parametrize("workers", [1, 2, pytest.param(3, marks=pytest.mark.slow)])
def test_the_first_failing_problem_is_raised_whichever_fails_first(workers):
    seen = []
    problems = [(0.3, None), (1.0, KeyError, "first"), (0.0, IndexError, "second"), (0.0, OSError, "third")]
    problems += [(0.0, None)] * 40
    with pytest.raises(KeyError) as caught:
        mx.map_problems(fail, problems, workers=workers, on_result=lambda i, _: seen.append(i))
    assert caught.value.args == ("first",)
    assert "problem 1 " in caught.value.__notes__[0]
    assert 0 in seen  # begun, and not lost
    assert len(seen) < 15  # most of the rest is not begun


def test_an_error_that_cannot_be_pickled_arrives_as_text():
    with pytest.raises(RuntimeError, match=r"OddError\('spam eggs'\)"):
        mx.map_problems(fail, [(0, OddError, "spam ", "eggs"), (0, None)], workers=2)


@posix
@pytest.mark.parametrize("how", ["kill", "exit"])
def test_a_worker_that_dies_is_told(how):
    code = -9 if how == "kill" else 3
    with pytest.raises(
        RuntimeError, match=rf"process ended, with exit code {code}: .* ran out of memory"
    ) as caught:
        mx.map_problems(die, [(i,) for i in range(20)], workers=2, how=how)
    assert caught.value.__notes__ == ["This was problem 1 (from 0) of 20."]


def test_an_error_of_on_result_ends_all():
    def refuse(index, result):
        raise LookupError(index)

    start = time.monotonic()
    with pytest.raises(LookupError):
        mx.map_problems(nap, [(0, 1), *[(60, 2)] * 8], workers=2, on_result=refuse)
    assert time.monotonic() - start < 20


# ------------------------------------------------------------------------------------------ scripts and signals


def script(tmp_path, code):
    path = tmp_path / "script.py"
    path.write_text(textwrap.dedent(code))
    return subprocess.run([sys.executable, path], capture_output=True, text=True, timeout=60, check=False)


OWN = """
    import mexpress as mx
    class Pair:
        def __init__(self, value):
            self.value = value
    def double(pair):
        return Pair(2 * pair.value)
    {guard}
        print([pair.value for pair in mx.map_problems(double, [(Pair(1),), (Pair(2),)], workers=2)])
"""


@pytest.mark.slow
def test_a_script_needs_a_guard(tmp_path):
    done = script(tmp_path, OWN.format(guard='if __name__ == "__main__":'))
    assert (done.stdout, done.stderr) == ("[2, 4]\n", "")
    done = script(tmp_path, OWN.format(guard="if True:"))
    assert done.returncode == 1
    assert done.stdout == ""
    # Python's resource tracker, a process of its own, may add what a worker that was ended left behind.
    said = [line for line in done.stderr.splitlines() if "resource_tracker" not in line]
    assert "a script calls this under if __name__ == '__main__'" in said[-1]


BUSY = """
    import os, sys, time
    sys.path = {path}
    import mexpress as mx
    import test_batch as t
    try:
        mx.map_problems(t.{what}, [(i,) for i in range(8)], workers=2, on_result=lambda *_: print("one", flush=True))
    except KeyboardInterrupt:
        print("interrupted", time.monotonic(), flush=True)
"""


def sleep(index):
    os.write(2, f"{os.getpid()}\n".encode())
    time.sleep(0 if index == 0 else 100)


def compute(index):
    os.write(2, f"{os.getpid()}\n".encode())
    if index:
        mx.select_warp(*problem(3000), threads=1, smoothing=0)


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


@posix
@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
@pytest.mark.parametrize("what", ["sleep", "compute"])
@pytest.mark.parametrize("how", ["parent", "group", "kill"])
def test_workers_end_with_their_parent(what, how, tmp_path):
    code = textwrap.dedent(BUSY.format(path=sys.path, what=what))
    with subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=os.environ | {"TMPDIR": str(tmp_path)},
    ) as process:
        try:
            pids = {int(process.stderr.readline()) for _ in range(3)}  # two of them work on what takes long
            assert process.stdout.readline() == "one\n"
            time.sleep(0.3)
            sent = time.monotonic()
            if how == "kill":
                process.kill()
            else:
                (os.killpg if how == "group" else os.kill)(process.pid, signal.SIGINT)
                assert select.select([process.stdout], [], [], 10)[0]
                word, when = process.stdout.readline().split()
                assert word == "interrupted"
                assert float(when) - sent < 2
            process.wait(10)
            while any(map(alive, pids)) and time.monotonic() < sent + 5:
                time.sleep(0.05)
            assert not any(map(alive, pids))
            assert process.stderr.read() == ""
            assert list(tmp_path.iterdir()) == []  # the folder of the run
        finally:
            process.kill()
    assert len(pids) == 2


# ----------------------------------------------------------------------------------------- progress and clients


def test_progress_is_shown_if_wanted(capsys):
    for progress in (False, True):
        mx.map_problems(nap, [(0.6, 0)] * 3, workers=1, progress=progress)
        assert ("problems: 2 of 3" in capsys.readouterr().err) == progress


@pytest.fixture(scope="module")
def dask():
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=2, processes=False, dashboard_address=":0"
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


@pytest.fixture(params=[pytest.param("dask", marks=pytest.mark.slow), "threads"])
def client(request):
    if request.param == "dask":
        yield request.getfixturevalue("dask")
    else:
        with ThreadPoolExecutor(2) as pool:
            yield pool


def test_a_client_gives_the_same(client, expected):
    seen = []
    found = mx.map_problems(
        mx.select_warp,
        PROBLEMS,
        client=client,
        on_result=lambda i, _: seen.append(i),
        threads=1,
        **OPTIONS,
        smoothing=0,
    )
    for one, other in zip(found, expected, strict=True):
        assert_equal(one, other)
    assert sorted(seen) == list(range(len(PROBLEMS)))


def test_a_client_does_not_take_equal_calls_for_one(client):
    found = mx.map_problems(os.urandom, [(16,)] * 5, client=client)
    assert len(set(found)) == 5


def test_an_error_at_a_client(client):
    seen = []
    problems = [(0.5, KeyError, "first"), (0.0, IndexError, "second"), *[(0.0, None)] * 3]
    with pytest.raises(KeyError) as caught:
        mx.map_problems(fail, problems, client=client, on_result=lambda i, _: seen.append(i))
    assert caught.value.__notes__ == ["This was problem 0 (from 0) of 5."]


@pytest.mark.slow
def test_what_is_no_client(dask):
    refused(lambda: mx.map_problems(nap, [(0, 1)], client=3), "client", TypeError)
    text = refused(lambda: mx.map_problems(nap, [(0, 1)], client=dask, workers=2), "workers", ValueError)
    assert "client" in text
    asynchronous = type("Client", (), {"submit": len, "asynchronous": True})()
    refused(lambda: mx.map_problems(nap, [(0, 1)], client=asynchronous), "client", TypeError)
