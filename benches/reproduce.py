"""Time table 1's problems and where their time goes, and threads against processes for many of them.

Usage: ``python benches/reproduce.py [problems] [batches] [--rounds 3] [--small]``; both parts if none is named.

``problems`` measures simulated pairs of images with one thread, as each worker does: all 13 criteria and TEST for every
number of control points. As in a run, where a configuration's sizes are one task, only the largest pays for what they
share. Stages are timed where they are called; the rest is what is between. The last column is what the
450 problems of that size, and all 1,800, take on all cores if these keep each other busy.

``batches`` runs `select_warp` on many problems of one size: one after the other with one thread and with all of them,
by as many threads of Python with one thread each, and by `map_problems`, whose processes have one thread each. The
time that processes take to start is in theirs.
"""

import argparse
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

import numpy as np
from threadpoolctl import threadpool_limits
from versus import CORES, REST, show, span

import mexpress as mx
from mexpress import simulation
from mexpress.criteria import Scorer
from mexpress.liftings import tps
from mexpress.models import design
from mexpress.paper import table1
from mexpress.paper.published import CRITERIA, SIZES
from mexpress.selection import candidates, data

STAGES: dict[str, list[tuple[Any, str]]] = {
    "simulation": [(simulation, "correspondences")],
    "placement": [(data, "hull"), (tps, "lloyd")],
    "design": [(data.Matches, "design")],
    "factor": [(design, "LeastSquares")],
    "criteria": [(candidates.CriteriaRequest, "scorer"), (Scorer, "scores")],
    "TEST": [(table1, "_test_errors")],
}
"""The functions of every stage, and where they are called from."""


@dataclass(frozen=True)
class Setting:
    """How many problems of every size are timed, and how often."""

    rounds: int
    problems: dict[int, int]
    stride: int
    batches: dict[int, int]


class Clock:
    """Adds up the seconds that functions take."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(STAGES, 0.0)

    def timed(self, stage: str, function: Callable[..., object]) -> Callable[..., object]:
        """The function, its time entered under the stage."""

        def call(*args: object, **kwargs: object) -> object:
            start = time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                self.seconds[stage] += time.perf_counter() - start

        return call


def stages(n: int, number: int, stride: int) -> tuple[float, dict[str, float]]:
    """Seconds a problem takes, and each stage of it; means over some problems."""
    every = simulation.configurations()
    some = every[:: len(every) // number][:number]
    clock, total, prepared = Clock(), 0.0, simulation.correspondences
    with ExitStack() as stack:
        for stage, functions in STAGES.items():
            for where, name in functions:
                stack.enter_context(patch.object(where, name, clock.timed(stage, getattr(where, name))))
        for configuration in some:
            if n < max(SIZES):
                prepared(configuration, n, setting=table1._SETTING)
            start = time.perf_counter()
            table1.measure(configuration, n, stride)
            total += time.perf_counter() - start
    return total / number, {stage: seconds / number for stage, seconds in clock.seconds.items()}


def problems(setting: Setting) -> None:
    """Where the time goes."""
    rows, whole = [], 0.0
    for n in SIZES:
        number = setting.problems[n]
        stages(n, 1, setting.stride)  # to warm up
        with threadpool_limits(1):
            total, parts = stages(n, number, setting.stride)
        parts["the rest"] = total - sum(parts.values())
        minutes = 450 * total / CORES / 60
        whole += minutes
        cells = [f"{1e3 * seconds:.1f}" for seconds in (total, *parts.values())]
        rows.append([str(n), str(number), *cells, f"{minutes:.1f}"])
    rows.append(["all", *[""] * (len(rows[0]) - 2), f"{whole:.1f}"])
    head = ["n", "timed", "total", *STAGES, "the rest", "450 in min"]
    show(f"Milliseconds a problem of table 1, every {setting.stride} count(s), one thread", head, rows)


def pair(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Matches of a simulated pair of images."""
    every = simulation.configurations()
    matches = simulation.correspondences(every[seed % len(every)], n)
    return matches.source, matches.target


def batches(setting: Setting) -> None:
    """Who keeps the cores busy."""
    options = {
        "criterion": "ER10",
        "criteria": ["FIT", *CRITERIA],
        "image_size": simulation.cameras.IMAGE_SIZE,
    }

    def alone(pairs: list[tuple[np.ndarray, ...]], threads: int) -> list[mx.WarpSelection]:
        return [mx.select_warp(*matches, **options, threads=threads, smoothing=0) for matches in pairs]

    def by_threads(pairs: list[tuple[np.ndarray, ...]]) -> list[mx.WarpSelection]:
        with ThreadPoolExecutor(CORES) as pool:
            return list(
                pool.map(lambda matches: mx.select_warp(*matches, **options, threads=1, smoothing=0), pairs)
            )

    ways: dict[str, Callable[[list[tuple[np.ndarray, ...]]], list[mx.WarpSelection]]] = {
        "one thread": lambda pairs: alone(pairs, 1),
        f"{CORES} threads inside": lambda pairs: alone(pairs, CORES),
        f"{CORES} threads of Python": by_threads,
        f"map_problems, {CORES} processes": lambda pairs: mx.map_problems(
            mx.select_warp,
            pairs,
            CORES,
            **options,
            smoothing=0,
        ),
    }
    rows = []
    for n, number in setting.batches.items():
        pairs = [pair(n, 37 * k) for k in range(number)]
        taken: dict[str, list[float]] = {name: [] for name in ways}
        expected = None
        for _ in range(setting.rounds):
            for name, way in ways.items():
                time.sleep(REST)
                with threadpool_limits(1):
                    start = time.perf_counter()
                    found = way(pairs)
                    taken[name].append(time.perf_counter() - start)
                counts = [one.selected for one in found]
                expected = expected or counts
                if counts != expected:
                    raise AssertionError(f"{name} selects others")
        base = np.median(taken["one thread"])
        for name, seconds in taken.items():
            speedup = f"{base / np.median(seconds):.2f}"
            rows.append([str(n), str(number), name, span(seconds, 1.0), speedup])
    head = ["n", "problems", "way", "seconds", "times as fast"]
    show("Many problems: all criteria, every count", head, rows)


def main() -> None:
    parts = {"problems": problems, "batches": batches}
    parser = argparse.ArgumentParser(description="Time table 1's problems.")
    parser.add_argument("parts", nargs="*", help=", ".join(parts))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--small", action="store_true", help="a try, in seconds")
    given = parser.parse_args()
    if unknown := set(given.parts) - set(parts):
        parser.error(f"no such part: {', '.join(sorted(unknown))}")
    setting = Setting(given.rounds, {15: 40, 30: 20, 150: 6, 500: 3}, 1, {60: 200, 150: 40, 500: 8})
    if given.small:
        setting = Setting(1, {15: 4, 30: 2, 150: 1, 500: 1}, 16, {60: 16})
    for name in given.parts or parts:
        parts[name](setting)


if __name__ == "__main__":
    main()
