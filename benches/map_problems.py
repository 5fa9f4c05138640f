"""Time `map_problems` on problems of several sizes against a loop, and against other pools of processes.

Usage: ``python benches/map_problems.py [--rounds 3]``.

A problem is a fit and its leave-one-out score: 60 data by 6 functions, 300 by 20, and 1,000 by 60; the problems of one
size are parts of one stack. Those that share have one array of 100,000 x 100, 80 MB, and multiply it with a vector of
their own. All ways take turns, with one thread a process, and must give the same results to the last bit, except for
`cross_validate_batch`, which takes the whole stack in one call with two threads. The table has the least times.

The clock starts when all processes are there, and stops with the last result: those of `map_problems`, which come and
go with every call (a second or two in all, as they import this script), make a call and wait for each other first;
others have theirs from the beginning, and make some calls before. `concurrent.futures` gets 24 chunks; joblib chooses
itself. Memory is the most that this process has beyond what it had before.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import joblib
import numpy as np
from memory import Memory
from threadpoolctl import threadpool_limits
from versus import show

import mexpress as mx

SIZES = {"60 x 6": (20_000, 60, 6), "300 x 20": (2000, 300, 20), "1,000 x 60": (100, 1000, 60)}
SHARED = 48


def score(A: np.ndarray, b: np.ndarray) -> float:
    model = mx.LeastSquares(A, b, threads=1)
    return model.cross_validate(mx.schemes.leave_one_out(len(b)), threads=1).score


def products(A: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(A @ b))


def star(function: Callable, problem: tuple) -> float:
    return function(*problem)


def together(
    A: np.ndarray | None, b: np.ndarray | int, function: Callable, first: tuple, folder: Path, workers: int
) -> float:
    """A call; without A, make the first one, and wait until all workers have made theirs."""
    if A is not None:
        return function(A, b)
    function(*first)  # which imports what it needs
    (folder / str(b)).touch()
    while len(list(folder.iterdir())) < workers:
        time.sleep(0.001)
    return 0.0


@contextmanager
def by_map_problems(workers: int) -> Iterator[Callable]:
    def run(function, some):
        with TemporaryDirectory() as folder:
            A, b = some[0]
            first = A[:1000].copy(), b.copy()  # no part of what problems share
            options = {"function": function, "first": first, "folder": Path(folder), "workers": workers}
            call = partial(together, **options)
            waiting = [(None, number) for number in range(workers)]
            begun, ended, found = None, 0.0, {}
            for index, result in mx.iterate_problems(call, waiting + some, workers=workers):
                ended = time.perf_counter()
                begun = begun or ended
                found[index] = result
            return ended - begun, [found[i + workers] for i in range(len(some))]

    yield run


def timed(results: Callable) -> tuple[float, list]:
    start = time.perf_counter()
    found = list(results())
    return time.perf_counter() - start, found


@contextmanager
def by_executor() -> Iterator[Callable]:
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:

        def run(function, some):
            call, size = partial(star, function), max(1, len(some) // 24)
            list(pool.map(call, some[:2] * 2))
            return timed(lambda: pool.map(call, some, chunksize=size))

        yield run


@contextmanager
def by_joblib() -> Iterator[Callable]:
    delayed = joblib.delayed
    with joblib.Parallel(2) as pool:

        def run(function, some):
            pool([delayed(function)(*problem) for problem in some[:2] * 2])
            return timed(lambda: pool(delayed(function)(*problem) for problem in some))

        yield run


@contextmanager
def by_loop() -> Iterator[Callable]:
    yield lambda function, some: timed(lambda: [function(*problem) for problem in some])


WAYS = {
    "a loop": by_loop,
    "map_problems, 1 worker": partial(by_map_problems, 1),
    "map_problems, 2 workers": partial(by_map_problems, 2),
    "concurrent.futures, 2 processes": by_executor,
    f"joblib {joblib.__version__}, 2 processes": by_joblib,
}


def race(
    name: str, function: Callable, some: list[tuple], rounds: int, more: dict[str, Callable]
) -> list[list[str]]:
    """Rows of a table: all ways in turns."""
    seconds, memory, expected = {}, {}, None
    with ExitStack() as stack:
        runs = {way: stack.enter_context(make()) for way, make in (WAYS | more).items()}
        for _ in range(rounds):
            for way, run in runs.items():
                with Memory() as used:
                    taken, found = run(function, some)
                expected = expected or found
                np.testing.assert_allclose(found, expected, rtol=1e-10)
                seconds.setdefault(way, []).append(taken)
                memory[way] = max(memory.get(way, 0), 1024 * used.more)
    least = {way: min(taken) for way, taken in seconds.items()}
    return [
        [
            f"{name}, {len(some)}" if way == "a loop" else "",
            way,
            f"{taken:.3f}",
            f"{least['a loop'] / taken:.2f}",
            f"{1e6 * taken / len(some):.1f}",
            f"{memory[way]:.0f}",
        ]
        for way, taken in least.items()
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description="Time map_problems against other pools of processes.")
    parser.add_argument("--rounds", type=int, default=3)
    rounds = parser.parse_args().rounds
    rng = np.random.default_rng(0)
    table = []
    with threadpool_limits(1):
        for name, (number, m, p) in SIZES.items():
            A, b = rng.standard_normal((number, m, p)), rng.standard_normal((number, m))

            @contextmanager
            def batch(A=A, b=b):
                scheme = mx.schemes.leave_one_out(b.shape[1])
                yield lambda *_: timed(lambda: mx.cross_validate_batch(A, b, scheme, threads=2).scores)

            more = {"cross_validate_batch, 2 threads": batch}
            table += race(name, score, list(zip(A, b, strict=True)), rounds, more)
            del A, b, more, batch
        design = rng.standard_normal((100_000, 100))
        some = [(design, row) for row in rng.standard_normal((SHARED, 100))]
        table += race("shared array", products, some, rounds, {})
    head = ["problems", "", "running, s", "times as fast as a loop", "us a problem", "more memory here, MiB"]
    show("Leave-one-out scores; products with a shared array", head, table)


if __name__ == "__main__":
    main()
