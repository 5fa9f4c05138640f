"""Threads, forks, signals: what surrounds the mathematics."""

import math
import multiprocessing
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

import mexpress as mx

posix = pytest.mark.skipif(os.name != "posix", reason="signals and fork are those of POSIX")


def build(seed=0, m=3000, p=20, threads=None):
    rng = np.random.default_rng(seed)
    return mx.LeastSquares(rng.normal(size=(m, p)), rng.normal(size=m), threads=threads)


def scheme(m=3000, size=40, count=300):
    rng = np.random.default_rng(1)
    return mx.schemes.from_sets([rng.choice(m, size, replace=False) for _ in range(count)], n=m)


def work(threads=3):
    """Use threads everywhere, and return bytes."""
    model = build(threads=threads)
    cv = model.cross_validate(scheme(), threads=threads)
    near = mx.schemes.nearest(np.random.default_rng(0).uniform(size=(2000, 2)), 5, threads=threads)
    points = np.random.default_rng(0).uniform(size=(300, 2))
    surface = mx.select_surface(points, np.sin(9 * points[:, 0]), max_count=12, threads=threads, smoothing=0)
    arrays = (cv.residuals, model.coefficients, near.held_out.indices, *surface.curves.values())
    return b"".join(array.tobytes() for array in (*arrays, surface.surface.parameters))


def child(connection):
    connection.send_bytes(work())
    connection.close()


def in_process(method):
    context = multiprocessing.get_context(method)
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=child, args=(sender,))
    process.start()
    sender.close()
    try:
        assert receiver.poll(30), "the child hangs"
        return receiver.recv_bytes()
    finally:
        process.join(5)
        if process.is_alive():
            process.kill()
            process.join()
        assert process.exitcode == 0


# Python 3.12 warns of any fork while threads exist; that it works is what this is about.
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*:DeprecationWarning")
@posix
def test_a_forked_child_computes_the_same():
    expected = work()
    for _ in range(3):
        assert in_process("fork") == expected
    assert work() == expected


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*:DeprecationWarning")
@posix
def test_a_fork_during_the_work_of_another_thread():
    expected = work()
    stop = threading.Event()

    def busy():
        while not stop.is_set():
            work()

    thread = threading.Thread(target=busy)
    thread.start()
    try:
        for _ in range(5):
            assert in_process("fork") == expected
    finally:
        stop.set()
        thread.join()


def test_a_spawned_child_computes_the_same():
    assert in_process("spawn") == work()


def test_one_model_serves_several_threads_of_python():
    model, pairs = build(), scheme()
    expected = model.cross_validate(pairs, threads=1).residuals
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda i: model.cross_validate(pairs, threads=1 + i % 3).residuals, range(40)))
    for residuals in found:
        np.testing.assert_array_equal(residuals, expected)


def test_the_interpreter_lock_is_released():
    model = build(m=4000, p=60)
    pairs = scheme(m=4000, size=300, count=2000)
    ticks = []
    stop = threading.Event()

    def tick():
        while not stop.is_set():
            ticks.append(time.perf_counter())
            time.sleep(0.001)

    thread = threading.Thread(target=tick)
    thread.start()
    try:
        start = time.perf_counter()
        model.cross_validate(pairs, threads=1)
        end = time.perf_counter()
    finally:
        stop.set()
        thread.join()
    inside = [t for t in ticks if start < t < end]
    assert end - start > 0.1, "too short to tell"
    longest = np.diff([start, *inside, end]).max()
    assert longest < 0.5 * (end - start)


# ------------------------------------------------------------------------------------------ MEXPRESS_NUM_THREADS


TASKS = Path("/proc/self/task")


def own_threads():
    return sum(task.read_text().startswith("mexpress") for task in TASKS.glob("*/comm"))


@pytest.mark.skipif(not TASKS.is_dir(), reason="needs /proc")
@pytest.mark.parametrize("value", ["1", "3", " 2 "])
def test_the_variable_limits_the_threads(value):
    code = f"""
        import sys
        sys.path = {sys.path}
        import test_process as t
        t.work(None)
        print(t.own_threads())
    """
    environment = {**os.environ, "MEXPRESS_NUM_THREADS": value}
    out = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert int(out) <= int(value)
    assert (int(out) > 0) == (value != "1")  # one thread is that of the caller


@pytest.mark.parametrize("value", ["0", "-1", "two", "1.5", "1e3", "٣", "²", "0x2"])
def test_a_bad_variable_is_an_error(monkeypatch, value):
    monkeypatch.setenv("MEXPRESS_NUM_THREADS", value)
    with pytest.raises(ValueError, match=r"^Invalid MEXPRESS_NUM_THREADS\. .* Given .*\.$"):
        build()
    build(threads=1)  # the argument comes first


@pytest.mark.parametrize("value", ["", " ", "5000", "99999999999999999999"])
def test_a_strange_variable_is_no_error(monkeypatch, value):
    monkeypatch.setenv("MEXPRESS_NUM_THREADS", value)
    assert mx.LeastSquares(np.ones((3, 1)), np.arange(3.0)).rank == 1


# ------------------------------------------------------------------------------------------- threads of NumPy's BLAS

# Criterion FIT selects the most control points: all of the linear algebra is large.
SELECTIONS = {
    "a warp": "mx.select_warp(source, target, threads=2)",
    "a warp of many points": "mx.select_warp(source, target, 'FIT', counts=[5, 120], smoothing=0, threads=2)",
    "a warp of B-splines": "mx.select_warp(source, target, lifting='bspline', counts=[144], threads=2)",
    "a surface": "mx.select_surface(source, depth, threads=2)",
    "a map of weights": "mx.select_surface(source, depth, 'ER5', max_count=120, smoothing=[0.1, 1], threads=2)",
}

DIGESTS = """
import hashlib
import numpy as np
import mexpress as mx
rng = np.random.default_rng(0)
source = rng.uniform(0, 1000, (400, 2))
target = 1.1 * source + 30 * np.sin(source / 150) + rng.normal(size=(400, 2))
depth = target[:, 0] - source[:, 0]
found = {selection}
model = found.warp if hasattr(found, "warp") else found.surface
print(hashlib.sha256(b"".join(x.tobytes() for x in (model.parameters, *found.curves.values()))).hexdigest())
"""


INTERVALS = """
import hashlib
import numpy as np
import mexpress as mx
from mexpress.models.nested_errors import nested_errors
rng = np.random.default_rng(0)
source, places = rng.uniform(0, 1000, (1200, 2)), rng.uniform(0, 1000, (300, 2))
target = 1.1 * source + 30 * np.sin(source / 150) + rng.normal(size=(1200, 2))
found = []
for model in (mx.fit_warp(source, target, source[:150]), mx.fit_surface(source, target, source[:200], smoothing=10.0)):
    interval = model.interval(places)
    found += [interval.lower, interval.upper]
found.append(nested_errors(source, target, source[:200], places, 1.1 * places))
print(hashlib.sha256(b"".join(x.tobytes() for x in found)).hexdigest())
"""


def output_by_threads_of_blas(code):
    def output(threads):
        names = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
        environment = {**os.environ, **dict.fromkeys(names, str(threads))}
        command = [sys.executable, "-c", code]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout

    return {output(1), output(2)}


@pytest.mark.parametrize("what", SELECTIONS)
def test_no_bit_depends_on_the_threads_of_blas(what):
    assert len(output_by_threads_of_blas(DIGESTS.format(selection=SELECTIONS[what]))) == 1


def test_no_bit_of_intervals_depends_on_the_threads_of_blas():
    assert len(output_by_threads_of_blas(INTERVALS)) == 1


# ------------------------------------------------------------------------------------------------------ Ctrl-C

FIRST_CALL = """
import ctypes, functools, operator, signal
import numpy as np
from mexpress import _core
points = np.arange(12.0).reshape(6, 2)
# No bytecode runs between the two calls: the signal waits when the core is entered for the first time.
interrupt = functools.partial(ctypes.CDLL(None)["raise"], signal.SIGINT)
call = functools.partial(_core.{call})
try:
    list(map(operator.call, (interrupt, call)))
except KeyboardInterrupt:
    print("interrupted")
"""


@posix
@pytest.mark.parametrize("call", ["largest, points.ravel()", "hilbert_order, points, 1"])
def test_ctrl_c_at_the_first_call_of_the_core(call):
    command = [sys.executable, "-c", FIRST_CALL.format(call=call)]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "interrupted\n"


SURFACE = """
        from mexpress.criteria import Scorer
        from mexpress.leastsquares.nested import Nested
        from mexpress.models import NestedBasis
        from mexpress.selection.data import Samples
        points = rng.uniform(0, 1000, (60_000, 2))
        values = np.sin(points[:, 0] / 100) + 0.1 * rng.normal(size=60_000)
"""

LONG = {
    "many small pairs": """
        model = mx.LeastSquares(rng.normal(size=(100_000, 160)), rng.normal(size=100_000), threads=2)
        pairs = mx.schemes.nearest(rng.uniform(size=(100_000, 2)), 70)
        call = lambda: model.cross_validate(pairs, threads=2)
    """,
    "few large pairs": """
        model = mx.LeastSquares(rng.normal(size=(20_000, 500)), rng.normal(size=20_000), threads=2)
        pairs = mx.schemes.from_sets([rng.choice(20_000, 9_000, replace=False) for _ in range(60)], n=20_000)
        call = lambda: model.cross_validate(pairs, threads=2)
    """,
    "pairs that lose rank": """
        A = rng.normal(size=(20_000, 200))
        A[:, 100:] = 0
        A[np.arange(100), np.arange(100, 200)] = 1
        model = mx.LeastSquares(A, rng.normal(size=20_000), threads=2)
        pairs = mx.schemes.from_sets([[i, i + j] for j in range(1, 4) for i in range(100)], n=20_000)
        call = lambda: model.cross_validate(pairs, threads=2)
    """,
    "pairs close to rank loss": """
        A = rng.normal(size=(20_000, 200))
        A[:, 100:] *= 1e-7
        A[np.arange(100), np.arange(100, 200)] = 1
        model = mx.LeastSquares(A, rng.normal(size=20_000), threads=2)
        pairs = mx.schemes.from_sets([[i, i + j] for j in range(1, 16) for i in range(100)], n=20_000)
        call = lambda: model.cross_validate(pairs, threads=2)
    """,
    "a tall design": """
        A, b = rng.normal(size=(150_000, 400)), rng.normal(size=150_000)
        call = lambda: mx.LeastSquares(A, b, threads=2)
    """,
    "a wide design": """
        A, b = rng.normal(size=(6_000, 2_000)), rng.normal(size=6_000)
        call = lambda: mx.LeastSquares(A, b, threads=2)
    """,
    "a design that lacks rank": """
        A, b = rng.normal(size=(3_000, 1_500)), rng.normal(size=3_000)
        A[:, 7] = A[:, 8]
        call = lambda: mx.LeastSquares(A, b, threads=2)
    """,
    "many penalty rows": """
        A, b, Z = rng.normal(size=(200, 400)), rng.normal(size=200), rng.normal(size=(150_000, 400))
        call = lambda: mx.LeastSquares(A, b, penalty=Z, threads=2)
    """,
    "all weights of a penalty": """
        from mexpress.leastsquares.penalty_path import PenaltyPath
        A, b, Z = rng.normal(size=(4_000, 1_200)), rng.normal(size=4_000), rng.normal(size=(1_200, 1_200))
        call = lambda: PenaltyPath(A, b, 1, Z, threads=2)
    """,
    "a triangulation": """
        points = rng.uniform(size=(800_000, 2))
        call = lambda: mx.schemes.delaunay(points)
    """,
    "many neighbours": """
        points = rng.uniform(size=(1_000_000, 2))
        scheme = mx.schemes.exclusion_radius(points, 0.006, threads=2)
        call = lambda: scheme.held_out  # above ten million members they are listed when asked for
    """,
    "the hull of many points": """
        points = rng.uniform(size=(2_000_000, 2))
        call = lambda: mx.placement.farthest_first(points, 1000)
    """,
    "a selection": """
        points = rng.uniform(0, 1000, (800, 2))
        target = points + 30 * np.sin(points / 100)
        call = lambda: mx.select_warp(points, target, threads=2)
    """,
    "nested models": """
        A, b = rng.normal(size=(20_000, 250)), rng.normal(size=20_000)
        pairs = {"near": mx.schemes.nearest(rng.uniform(size=(20_000, 2)), 700)}
        call = lambda: mx.cross_validate_nested(A, b, range(1, 251), pairs, threads=2)
    """,
    "a surface's control points": f"""
        {SURFACE}
        call = lambda: mx.select_surface(points, values, max_count=300, min_distance=1, placement="residual", threads=2)
    """,
    "a surface's neighbourhoods": f"""
        {SURFACE}
        design = Samples.of(points, values).design(NestedBasis(points[:150]))
        nested = Nested(design.A, design.b, threads=2)
        scorer = Scorer.of(["ER20", "NN25PCT"], points, nested=True)
        call = lambda: scorer.curves(nested, np.arange(3, 151), 2)
    """,
    "a surface's folds": f"""
        {SURFACE}
        design = Samples.of(points, values).design(NestedBasis(points[:450]))
        nested = Nested(design.A, design.b, threads=2)
        scorer = Scorer.of(["KF500", "KF1000", "KF2000", "PRESS"], points, nested=True)
        call = lambda: scorer.curves(nested, np.arange(3, 451), 2)
    """,
    "a factorisation for nested models": """
        A, b = rng.normal(size=(150_000, 400)), rng.normal(size=150_000)
        call = lambda: mx.cross_validate_nested(A, b, [5, 400], {}, threads=2)
    """,
}

SCRIPT = """
import signal, sys, time
import numpy as np
import mexpress as mx
rng = np.random.default_rng(0)
{setup}
print("ready", flush=True)
try:
    call()
except KeyboardInterrupt:
    print("interrupted", time.monotonic(), flush=True)
else:
    sys.exit("finished")
# The process is usable afterwards.
small = mx.LeastSquares(rng.normal(size=(5000, 5)), rng.normal(size=5000), threads=2)
print("score", small.cross_validate(mx.schemes.k_fold(5000, 100, 0), threads=2).score > 0, flush=True)
"""


def interrupt(setup, after):
    """Latency of Ctrl-C in seconds; None if the work was done before, infinite if it takes very long."""
    code = SCRIPT.format(setup=textwrap.dedent(setup))
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "ready\n"
            time.sleep(after)
            sent = time.monotonic()
            process.send_signal(signal.SIGINT)
            if not select.select([process.stdout], [], [], 5)[0]:
                return math.inf
            answer = process.stdout.readline()
            if not answer:
                return None
            assert process.stdout.readline() == "score True\n"
        finally:
            process.kill()
    return float(answer.split()[1]) - sent


QUICK = {"many small pairs", "a triangulation", "nested models"}


@posix
@pytest.mark.parametrize(
    "what", [what if what in QUICK else pytest.param(what, marks=pytest.mark.slow) for what in LONG]
)
def test_ctrl_c_ends_long_work_at_once(what):
    latency = interrupt(LONG[what], after=0.15)
    print(f"{what}: {latency}")
    assert latency is not None, "the work was done too soon to tell"
    assert latency < 1  # 0.2 s, and room for a busy machine


SELECTION = f"""
        {SURFACE}
        call = lambda: mx.select_surface(points, values, "ER10", ["KF10", "CMPRESS"], max_count=175, threads=2)
"""


@posix
@pytest.mark.slow
@pytest.mark.parametrize("after", [0.5, 2, 5])
def test_ctrl_c_ends_the_selection_of_a_surface_at_any_stage(after):
    latency = interrupt(SELECTION, after)
    print(f"after {after}: {latency}")
    assert latency is not None, "the work was done too soon to tell"
    assert latency < 1


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*:DeprecationWarning")
@posix
@pytest.mark.slow
def test_a_forked_child_selects_a_surface_after_an_interrupt():
    code = SCRIPT.format(setup=textwrap.dedent(SELECTION)) + textwrap.dedent("""
        import os
        few, depth = points[:500], values[:500]
        expected = mx.select_surface(few, depth, max_count=20, threads=2)
        if os.fork() == 0:
            signal.alarm(20)
            found = mx.select_surface(few, depth, max_count=20, threads=2)
            equal = all((found.curves[name] == curve).all() for name, curve in expected.curves.items())
            os._exit(0 if equal else 1)
        print("child", os.waitstatus_to_exitcode(os.wait()[1]), flush=True)
    """)
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "ready\n"
            time.sleep(1)
            process.send_signal(signal.SIGINT)
            lines = []
            while select.select([process.stdout], [], [], 20)[0] and (line := process.stdout.readline()):
                lines.append(line.split()[:2])
        finally:
            process.kill()
    assert [line[0] for line in lines] == ["interrupted", "score", "child"]
    assert lines[2] == ["child", "0"]
