"""Time `map_problems` on small problems against a loop, and against what as many processes could do at best.

Usage: ``python benches/map_problems.py [--problems 2000 50000] [--rounds 5]``.

A problem is a fit of 60 data by 6 functions and its leave-one-out score; all are parts of one stack. The loop has one
thread. At best, two processes each do a loop over half of the problems, which they have made themselves, and nothing is
sent. The three take turns; the table has medians, of results that are equal to the last bit. "Running" is the time from
the first result to the last, as processes take time to start; for those at best, the longer of both loops. Processor
time is per problem, of all processes, without their start: what it is more than the loop's is the overhead.
"""

import argparse
import os
import time
from multiprocessing import get_context

import numpy as np
from threadpoolctl import threadpool_limits
from versus import describe_machine, show

import mexpress as mx

WORKERS = 2
LEAVE_ONE_OUT = mx.schemes.leave_one_out(60)


def score(A: np.ndarray, b: np.ndarray) -> float:
    return mx.LeastSquares(A, b, threads=1).cross_validate(LEAVE_ONE_OUT, threads=1).score


def problems(number: int) -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(0)
    return list(zip(rng.standard_normal((number, 60, 6)), rng.standard_normal((number, 60)), strict=True))


def loop(some: list[tuple[np.ndarray, np.ndarray]]) -> tuple[float, list[float]]:
    start = time.perf_counter()
    found = [score(*problem) for problem in some]
    return time.perf_counter() - start, found


def half(which: int, number: int, barrier: object, queue: object) -> None:
    """A loop of a process of its own, which waits until the others are ready."""
    some = problems(number)[which::WORKERS]
    loop(some[:10])
    barrier.wait()
    queue.put(loop(some)[0])


def at_best(number: int) -> float:
    context = get_context("spawn")
    barrier, queue = context.Barrier(WORKERS), context.Queue()
    processes = [context.Process(target=half, args=(i, number, barrier, queue)) for i in range(WORKERS)]
    for process in processes:
        process.start()
    seconds = max(queue.get() for _ in processes)
    for process in processes:
        process.join()
    return seconds


def mapped(some: list[tuple[np.ndarray, np.ndarray]]) -> tuple[float, float, float, list[float]]:
    """Seconds in all, from the first result on, and of processors; and the results."""
    start, before, first, found = time.perf_counter(), sum(os.times()[:4]), None, {}
    for index, result in mx.iterate_problems(score, some, workers=WORKERS):
        last = time.perf_counter()
        first = first or last
        found[index] = result
    seconds, used = time.perf_counter() - start, sum(os.times()[:4]) - before
    return seconds, last - first, used, [found[i] for i in range(len(some))]


def rows(number: int, rounds: int) -> list[list[str]]:
    some = problems(number)
    loops, best, runs, starts = [], [], [], []
    for _ in range(rounds):
        seconds, expected = loop(some)
        loops.append(seconds)
        best.append(at_best(number))
        starts.append(mapped(some[:WORKERS])[2])
        *times, found = mapped(some)
        assert found == expected
        runs.append(times)
    whole, running, processors = np.median(runs, axis=0)
    one, two = np.median(loops), np.median(best)
    each = 1e6 / number
    used = processors - np.median(starts)
    return [
        [f"{number}", "a loop", f"{one:.3f}", f"{one:.3f}", "1.00", f"{one * each:.1f}"],
        ["", "two processes at best", "", f"{two:.3f}", f"{one / two:.2f}", ""],
        ["", "map_problems", f"{whole:.3f}", f"{running:.3f}", f"{one / running:.2f}", f"{used * each:.1f}"],
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description="Time map_problems on small problems.")
    parser.add_argument("--problems", type=int, nargs="+", default=[2000, 50_000])
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    describe_machine()
    head = [
        "problems",
        "",
        "in all, s",
        "running, s",
        "times as fast as a loop",
        "of processors, us a problem",
    ]
    with threadpool_limits(1):
        table = [row for number in given.problems for row in rows(number, given.rounds)]
    show("Leave-one-out scores of 60 x 6, two processes", head, table)


if __name__ == "__main__":
    main()
