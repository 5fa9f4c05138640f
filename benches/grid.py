"""Time mexpress beside its peers over a grid of sizes, on uniform and on clustered points.

    python benches/grid.py TASK ... [--rounds 3]

The tasks are at the end, in `TASKS`; "memory" is one more. Everyone gets the same data and held-out sets, and must
give the same prediction residuals before it is timed: to 1e-8 of the largest, or to the accuracy in `TASKS`.

A time is that of the fit and of all predictions on one thread, the shortest of some rounds in turns. Where a peer
predicts pair after pair, and all would take longer than `BUDGET`, some are timed, spread over all, and multiplied (~).
The peers that are not much slower than the fastest one are timed on clustered points, and on all threads, as well.
"""

import argparse
import ctypes
import importlib
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial
from importlib import metadata
from itertools import product
from pathlib import Path

import numpy as np
from machine import CORES
from peers.tall import peak_bytes
from tables import show
from threadpoolctl import threadpool_limits

import mexpress as mx

BUDGET = 0.25
"""Seconds of a call for which a peer gets as many pairs."""

LONG = 1.0
"""A call of more seconds is timed once."""

SHORT = 3e-3
"""Shorter calls are repeated until they take so many seconds."""

NEAR = 2.5
"""Peers that take up to so many times as long as the fastest one are timed on clustered points, and on all threads."""

REST = 0.1
"""Threads of a BLAS that have finished spin for so many seconds, and would slow down whoever is next."""


@dataclass(frozen=True)
class Cell:
    """Sizes of a problem: n data, p columns, and q that are held out around each, or folds, or ridges."""

    n: int
    p: int
    q: int


@dataclass(frozen=True)
class Problem:
    """What adapters are made of, what is held out, and what mexpress does with so many threads."""

    data: tuple
    scheme: mx.schemes.Scheme
    own: Callable[[int], np.ndarray]

    @cached_property
    def pairs(self) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """What is held out and validated, as lists."""
        return list(self.scheme.held_out), list(self.scheme.validated)


@dataclass(frozen=True)
class Way:
    """A peer's way to the residuals.

    Parameters
    ----------
    name : str
        Column of the table; the faster of two ways with one name is shown.
    adapter : str
        Module and class in `peers`.
    library : str
        It comes from.
    brings : str
        What brings the library.
    apart : bool
        Whether it predicts pair after pair, so that some of them tell how long all take.
    shares : bool
        Whether it takes `workers`, threads that share the pairs.
    fits : callable
        Whether it can do a cell, in less than minutes and gigabytes.
    accuracy : float
        Largest difference from mexpress, as a part of the largest residual.
    told : callable
        What it tells of the residuals.
    options : dict
        Of the adapter.
    """

    name: str
    adapter: str
    library: str = "numpy"
    brings: str = "pip install --group bench"
    apart: bool = False
    shares: bool = False
    fits: Callable[[Cell], bool] = lambda cell: True
    accuracy: float = 1e-8
    told: Callable[[np.ndarray], np.ndarray] = np.asarray
    options: dict = field(default_factory=dict)

    def load(self) -> Callable:
        """The adapter's class; `ModuleNotFoundError` where its library is missing."""
        module, name = self.adapter.split(".")
        return partial(getattr(importlib.import_module(f"peers.{module}"), name), **self.options)

    def is_absent(self) -> bool:
        """Whether its library cannot be had here."""
        try:
            self.version()
        except ModuleNotFoundError:
            return True
        return False

    def version(self) -> str:
        """Its library's name and version."""
        adapter = self.load().func
        if hasattr(adapter, "start"):
            return adapter.start().version
        return f"{self.library} {metadata.version(self.library)}"


@dataclass(eq=False)
class Runner:
    """A call to time, which gives its seconds and residuals, and threads of the BLAS; `whole` if of all pairs.

    If it `rests`, it waits first, as threads of others may still spin.
    """

    name: str
    call: Callable[[], tuple[float, np.ndarray]]
    blas: int
    whole: bool = True
    rests: bool = False
    repeats: int = 1
    best: float = np.inf

    def run(self) -> np.ndarray:
        """Call once, or some times if that is short, and keep the shortest time."""
        with threadpool_limits(self.blas):
            time.sleep(REST * self.rests)
            found = [self.call() for _ in range(self.repeats)]
        self.best = min(self.best, sum(seconds for seconds, _ in found) / self.repeats)
        return found[0][1]


def mexpress(problem: Problem, threads: int) -> Runner:
    """Mexpress, with so many threads."""

    def call() -> tuple[float, np.ndarray]:
        start = time.perf_counter()
        found = problem.own(threads)
        return time.perf_counter() - start, found

    return Runner("mexpress", call, threads)


def fitting(model: object, seconds: float) -> float:
    """Seconds of a fit: those of the clock here, unless an adapter tells those of another process."""
    return getattr(model, "seconds", (seconds, seconds))[0]


def predicting(model: object, seconds: float) -> float:
    """Seconds of predictions."""
    return getattr(model, "seconds", (seconds, seconds))[1]


def enough(way: Way, problem: Problem) -> np.ndarray:
    """The pairs that a peer gets: all, or as many as the budget has time for."""
    total = len(problem.scheme)
    if not way.apart:
        return np.arange(total)
    few = np.linspace(0, total - 1, min(total, 4)).astype(int)
    held, validated = ([sets[i] for i in few] for sets in problem.pairs)
    with threadpool_limits(1):
        model, seconds = way.load()(*problem.data), np.inf
        for _ in range(2):
            start = time.perf_counter()
            model.residuals(held, validated)
            seconds = min(seconds, predicting(model, time.perf_counter() - start))
    count = int(np.clip(BUDGET * len(few) / seconds, len(few), total))
    return np.linspace(0, total - 1, count).astype(int)


def peer(way: Way, problem: Problem, some: np.ndarray, blas: int = 1, workers: int = 1) -> Runner:
    """A peer that predicts some pairs."""
    make = way.load()
    if workers > 1:
        make = partial(make, workers=workers)
    held, validated = ([sets[i] for i in some] for sets in problem.pairs)
    share = len(problem.scheme) / len(some)

    def call() -> tuple[float, np.ndarray]:
        start = time.perf_counter()
        model = make(*problem.data)
        middle = time.perf_counter()
        found = model.residuals(held, validated)
        end = time.perf_counter()
        predictions = predicting(model, end - middle)
        return fitting(model, middle - start) + share * predictions, found

    return Runner(way.name, call, blas, whole=share == 1)


def check(runner: Runner, way: Way, problem: Problem, some: np.ndarray, expected: np.ndarray) -> None:
    """Raise an error if a peer predicts anything else than mexpress."""
    ends = problem.scheme.validated.offsets
    mine = way.told(np.concatenate([expected[ends[i] : ends[i + 1]] for i in some]))
    error = float(np.abs(runner.run() - mine).max() / np.abs(mine).max())
    if not error < way.accuracy:
        raise AssertionError(f"{runner.name} differs by {error:.1e} of the largest residual")


def compete(problem: Problem, ways: list[Way], rounds: int, threads: int = 1) -> list[Runner]:
    """Mexpress and its peers in turns, once they agree; with several threads, peers use them as suits them best."""
    runners = [mexpress(problem, threads)]
    runners[0].run()
    expected = runners[0].run()
    for way in ways:
        some = enough(way, problem)
        runners.append(peer(way, problem, some, threads))
        check(runners[-1], way, problem, some, expected)
        if threads > 1 and way.shares:
            runners.append(peer(way, problem, some, 1, threads))
            check(runners[-1], way, problem, some, expected)
    for runner in runners:
        runner.rests = threads > 1
        runner.repeats = max(1, round(SHORT / runner.best))
        if runner.best < LONG:
            runner.best = np.inf
    for _ in range(rounds):
        for runner in runners:
            if runner.best < LONG or runner.best == np.inf:
                runner.run()
    return runners


@dataclass(frozen=True)
class Task:
    """A table: a problem for each cell and kind of points, who competes, and the heads of the columns of sizes."""

    title: str
    heads: tuple[str, str, str]
    problem: Callable[[Cell, str], Problem]
    cells: list[Cell]
    ways: list[Way]
    clusters: bool = False

    def run(self, rounds: int) -> None:
        """Print the table, and where a peer is faster."""
        ways = [way for way in self.ways if not way.is_absent()]
        names = list(dict.fromkeys(way.name for way in self.ways))
        rows, faster = [], {}
        for cell in self.cells:
            print(self.title, cell, file=sys.stderr, flush=True)
            results = self.results(cell, [way for way in ways if way.fits(cell)], rounds)
            rows.append(row(cell, names, list(results.values())))
            for setting, (own, *others) in results.items():
                best = min(others, key=lambda runner: runner.best)
                if is_faster(best, own):
                    where = ", ".join([f"{cell.n:,} x {cell.p}", str(cell.q), *filter(None, [setting])])
                    faster.setdefault(best.name, []).append(f"{where}: {best.best / own.best:.2f}")
        heads = [*self.heads, "mexpress, ms", *names, "fastest peer"]
        for setting in self.settings:
            heads += [f"{setting}: mexpress, ms", "fastest peer"]
        show(self.title, heads, rows)
        for way in {way.name: way for way in self.ways if way.is_absent()}.values():
            print(f"Absent: {way.name} ({way.brings}).")
        print(f"Peers: {', '.join(dict.fromkeys(way.version() for way in ways))}.")
        print(f"\nA peer is faster{':' if faster else ' nowhere.'}")
        for name, places_ in faster.items():
            print(f"\n* {name}: {'; '.join(places_)}")

    @property
    def settings(self) -> list[str]:
        """Other points and threads, for the peers that are not much slower than the fastest one."""
        return ["clustered points"] * self.clusters + [f"{CORES} threads"] * (CORES > 1)

    def results(self, cell: Cell, ways: list[Way], rounds: int) -> dict[str, list[Runner]]:
        """Mexpress and its peers: on uniform points with one thread, and in the other settings."""
        problem = self.problem(cell, "uniform")
        found = {"": compete(problem, ways, rounds)}
        fastest = min(runner.best for runner in found[""][1:])
        near = {runner.name for runner in found[""][1:] if runner.best <= NEAR * fastest}
        some = [way for way in ways if way.name in near]
        for setting in self.settings:
            if setting == "clustered points":
                found[setting] = compete(self.problem(cell, "clustered"), some, rounds)
            else:
                found[setting] = compete(problem, some, rounds, CORES)
        return found


def row(cell: Cell, names: list[str], settings: list[list[Runner]]) -> list[str]:
    """A line of a table: sizes, times of mexpress, ratios of all peers in the first setting, the fastest in each."""
    (own, *others), *_ = settings
    cells = [f"{cell.n:,}", f"{cell.p:,}", str(cell.q), milliseconds(own)]
    cells += [ratio([runner for runner in others if runner.name == name], own) for name in names]
    cells.append(quickest(settings[0]))
    for runners in settings[1:]:
        cells += [milliseconds(runners[0]), quickest(runners)]
    return cells


def milliseconds(runner: Runner) -> str:
    """Its time."""
    return f"{1e3 * runner.best:,.{2 if runner.best < 1e-2 else 0}f}"


def ratio(runners: list[Runner], own: Runner) -> str:
    """Time of the fastest as a multiple of mexpress's; bold if less."""
    if not runners:
        return "-"
    fastest = min(runners, key=lambda runner: runner.best)
    times = fastest.best / own.best
    text = f"{times:,.{0 if times >= 10 else 2 if times < 1 else 1}f}"
    marked = text if fastest.whole else f"~{text}"
    return f"**{marked}**" if is_faster(fastest, own) else marked


def is_faster(peer: Runner, own: Runner) -> bool:
    """Whether a peer is faster than mexpress, by what the table shows."""
    return round(peer.best / own.best, 2) < 1


def quickest(runners: list[Runner]) -> str:
    """The fastest peer and its ratio."""
    own, *others = runners
    fastest = min(others, key=lambda runner: runner.best)
    return f"{fastest.name} {ratio([fastest], own)}"


# What is cross-validated ------------------------------------------------------------------------------------------


def places(n: int, kind: str) -> np.ndarray:
    """Points of the unit square: all over it, or five of six in clusters of a dozen."""
    rng = np.random.default_rng(n)
    if kind == "uniform":
        return rng.random((n, 2))
    centres = rng.random((max(n // 14, 1), 2))
    near = centres[rng.integers(len(centres), size=n - n // 6)] + rng.normal(0, 0.01, (n - n // 6, 2))
    return rng.permutation(np.concatenate([rng.random((n // 6, 2)), near]))


def regression(cell: Cell, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A constant, the places, and other covariates; responses with noise."""
    rng = np.random.default_rng(cell.p)
    A = np.column_stack([np.ones(cell.n), points, rng.standard_normal((cell.n, cell.p - 3))])
    return A, A @ rng.standard_normal(cell.p) + rng.standard_normal(cell.n)


def linear(cell: Cell, points: np.ndarray, scheme: mx.schemes.Scheme) -> Problem:
    """Ordinary least squares."""
    A, b = regression(cell, points)

    def own(threads: int) -> np.ndarray:
        return mx.LeastSquares(A, b, threads=threads).cross_validate(scheme, threads=threads).residuals

    return Problem((A, b), scheme, own)


def leave_one_out(cell: Cell, kind: str) -> Problem:
    """Each datum alone."""
    return linear(cell, places(cell.n, kind), mx.schemes.leave_one_out(cell.n))


def folds(cell: Cell, kind: str) -> Problem:
    """Folds of consecutive data, which are in no order."""
    return linear(cell, places(cell.n, kind), mx.schemes.from_sets(np.split(np.arange(cell.n), cell.q)))


def local(cell: Cell, kind: str) -> Problem:
    """Each datum with its nearest ones held out."""
    points = places(cell.n, kind)
    return linear(cell, points, mx.schemes.nearest(points, cell.q))


def ridges(cell: Cell, kind: str) -> Problem:
    """Mean squared leave-one-out errors of q ridges, of which the best is fitted; a ridge takes a pair's place."""
    from mexpress.sklearn import Ridge, RidgeCV  # noqa: PLC0415 - an extra

    A, b = regression(cell, places(cell.n, kind))
    alphas, alone = np.logspace(0, 4, cell.q), mx.schemes.leave_one_out(cell.n)

    def own(threads: int) -> np.ndarray:
        if cell.q == 1:
            predicted = Ridge(alphas[0]).cross_val_predict(A[:, 1:], b, alone, threads=threads)
            return np.mean((b - predicted) ** 2, keepdims=True)
        return -RidgeCV(alphas, threads=threads).fit(A[:, 1:], b).cv_scores_

    return Problem((A, b, alphas), mx.schemes.leave_one_out(cell.q), own)


def spline(cell: Cell, kind: str) -> Problem:
    """A smoothing thin-plate spline with a control point at each datum, and its nearest data held out."""
    points, smoothing = places(cell.n, kind), 1e-3
    x, y = points.T
    values = np.sin(5 * x) * np.cos(4 * y) + 0.1 * np.random.default_rng(0).standard_normal(cell.n)
    scheme = mx.schemes.nearest(points, cell.q)

    def own(threads: int) -> np.ndarray:
        functions = mx.liftings.make_lifting("tps", points)
        penalty = np.sqrt(smoothing) * functions.bending()
        model = mx.LeastSquares(functions.at(points), values, penalty=penalty, threads=threads)
        return model.cross_validate(scheme, threads=threads).residuals

    return Problem((points, values, smoothing), scheme, own)


# Who competes, and where ------------------------------------------------------------------------------------------

PRIMAL = Way("numpy, stacked", "numpy_stacked.Primal", apart=True, shares=True)
DUAL = Way("numpy, stacked", "numpy_stacked.Dual", apart=True, shares=True)
LOOPED = Way("numpy, looped", "numpy_stacked.Looped", apart=True, shares=True)
CVMATRIX = [
    Way("cvmatrix", "cvmatrix_folds.Folds", "cvmatrix", apart=True, shares=True, options={"stacked": stacked})
    for stacked in (False, True)
]
REFITS = Way("scikit-learn, refits", "refit.SklearnOneByOne", "scikit-learn", apart=True)
OPENTURNS = "openturns_linear.Validation"
MGCV = Way(
    "mgcv's NCV",
    "mgcv_ncv.Ncv",
    "mgcv",
    "apt-get install r-base-core r-cran-mgcv",
    apart=True,
    shares=True,
    accuracy=1e-7,
)

SIZES, COLUMNS = (200, 2000, 20_000), (10, 60, 200)


def grid(sizes: tuple, columns: tuple, held: tuple) -> list[Cell]:
    """Cells whose training data are more than the columns."""
    return [Cell(*each) for each in product(sizes, columns, held) if each[0] > each[1] + each[2]]


TASKS = {
    "leave-one-out": Task(
        "Leave-one-out: PRESS",
        ("n", "p", "held out"),
        leave_one_out,
        grid(SIZES, COLUMNS, (1,)),
        [
            Way("numpy, leverages", "numpy_stacked.Leverages"),
            Way("statsmodels", "statsmodels_press.Press", "statsmodels"),
            Way("OpenTURNS", OPENTURNS, "openturns"),
            *CVMATRIX,
            MGCV,
            REFITS,
        ],
    ),
    "folds": Task(
        "Ten folds",
        ("n", "p", "folds"),
        folds,
        [Cell(n, p, 10) for n, p in product(SIZES, COLUMNS) if n > 2 * p],
        [
            PRIMAL,
            LOOPED,
            *CVMATRIX,
            Way(
                "cvmatrix",
                "cvmatrix_folds.Folds",
                "cvmatrix",
                apart=True,
                shares=True,
                options={"centred": True},
            ),
            Way("scikit-learn, refits", "refit.Sklearn", "scikit-learn"),
            Way("OpenTURNS", OPENTURNS, "openturns", fits=lambda cell: cell.n <= 2000),
            MGCV,
        ],
    ),
    "local": Task(
        "Local exclusion",
        ("n", "p", "held out"),
        local,
        grid(SIZES, COLUMNS, (11, 101, 501)),
        [PRIMAL, DUAL, LOOPED, *CVMATRIX, MGCV, REFITS],
        clusters=True,
    ),
    "ridges": Task(
        "Leave-one-out of ridges",
        ("n", "p", "ridges"),
        ridges,
        [Cell(n, p, q) for n, p, q in product(SIZES, COLUMNS, (1, 25)) if n > p],
        [Way("scikit-learn, RidgeCV", "sklearn_ridge.LeaveOneOut", "scikit-learn")],
    ),
    "spline": Task(
        "Smoothing splines",
        ("n", "p", "held out"),
        spline,
        [Cell(n, n, q) for n, q in product((100, 400, 1000), (1, 11, 101)) if n > q],
        [
            Way("scipy, refits", "scipy_rbf.Refits", "scipy", apart=True, accuracy=1e-7),
            Way(
                "treverhines-rbf, loocv",
                "treverhines_rbf.LeaveOneOut",
                "treverhines-rbf",
                fits=lambda cell: cell.q == 1,
                accuracy=1e-7,
                told=np.linalg.norm,
            ),
        ],
        clusters=True,
    ),
}

# Memory -----------------------------------------------------------------------------------------------------------

MEMORY = [
    ("leave-one-out", Cell(20_000, 200, 1)),
    ("folds", Cell(2000, 60, 10)),
    ("folds", Cell(20_000, 200, 10)),
    ("local", Cell(20_000, 200, 501)),
    ("ridges", Cell(20_000, 60, 25)),
    ("spline", Cell(1000, 1000, 1)),
]


def memory() -> None:
    """Print what each needs in a process of its own beside its data, with one thread."""
    rows = []
    for name, cell in MEMORY:
        task, least = TASKS[name], {}
        for index, way in enumerate([None, *task.ways]):
            if way and (way is MGCV or not way.fits(cell) or way.is_absent()):
                continue
            command = [sys.executable, __file__, name, "--alone", *map(str, (cell.n, cell.p, cell.q, index))]
            found = float(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)
            who = way.name if way else "mexpress"
            least[who] = min(found, least.get(who, np.inf))
        data = 8 * cell.n * (3 if name == "spline" else cell.p + 1) / 2**20
        own = f"{least.pop('mexpress'):.0f}"
        others = [f"{who} {needed:.0f}" for who, needed in sorted(least.items(), key=lambda each: each[1])]
        sizes = [f"{cell.n:,}", f"{cell.p:,}", str(cell.q)]
        rows.append([task.title, *sizes, f"{data:.1f}", own, ", ".join(others)])
    show("Memory beyond the data, MiB", ["", "n", "p", "q", "data", "mexpress", "peers"], rows)


def alone(name: str, cell: Cell, index: int) -> None:
    """Print the MiB beyond the data that one of them needs in this process, a peer for some of the pairs."""
    task = TASKS[name]
    way = [None, *task.ways][index]
    for each in (min(task.cells, key=lambda one: (one.n, one.p, one.q)), cell):
        problem = task.problem(each, "uniform")
        total = len(problem.scheme)
        some = np.linspace(0, total - 1, min(total, 50) if way and way.apart else total).astype(int)
        runner = peer(way, problem, some) if way else mexpress(problem, 1)
        # What is loaded at the first use is no memory of the problem: the smaller one is for that.
        ctypes.CDLL(None).malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5")  # the peak is that from here on
        before = peak_bytes()
        runner.run()
        needed = peak_bytes() - before
    print(needed / 2**20)


def main() -> None:
    """Print the tables that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tasks", nargs="+", choices=[*TASKS, "memory"])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--alone", type=int, nargs=4, help=argparse.SUPPRESS)
    told = parser.parse_args()
    for name in told.tasks:
        if told.alone:
            alone(name, Cell(*told.alone[:3]), told.alone[3])
        elif name == "memory":
            memory()
        else:
            TASKS[name].run(told.rounds)


if __name__ == "__main__":
    main()
