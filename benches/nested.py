"""Time nested models: every size of a model against one model, and a surface's whole sweep against other ways to it.

Usage: ``python benches/nested.py [models] [surface] [--rounds 5] [--small] [--data DEPTH]``; both parts if none is
named.

``models`` cross-validates the 118 leading models of 4,000 x 120 designs with a radius of 10 %, and the largest of them
on its own, factorisations included, in turns.

``surface`` is the paper's figure 7: 10,000 data, 3 to 175 control points, all of PRESS, ER01, ER05, ER10, NN01PCT,
NN05PCT, NN10PCT, AIC and BIC, in a process of its own that also tells its peak memory; in turns with numpy's product of
two 1500 x 1500 matrices on as many threads. Its multiply-adds are counted from the sets that are held out. For q rows
that are held out and p columns, all models at once take, triangular solves of p^2 left aside::

    afresh                    q p^2 / 2 + p^3 / 6    a Gram matrix and its Cholesky factor
    or by columns             q^2 p, if less         the dual of small sets, an update a column
    ring by ring              only rows that the next smaller set around the same datum lacks count in q
    or from the set before    only rows that differ from the set of the datum before, if less, on a curve through all

A product of two s x s matrices takes s^3. "Times the product's time" divides the sweep's time by what numpy's product
takes for so many multiply-adds. PRESS holds out one row at a time.

What takes hours is timed on some data and sizes and extrapolated to all of them, as the table says. Other ways are
given the control points and the sets; mexpress finds both within its time. They use threads in the way that is faster
for them: a BLAS of all threads, or data of their own for each thread and a BLAS of one.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from machine import CORES
from peers import numpy_nested
from tables import show
from threadpoolctl import threadpool_limits
from versus import REST, THREADS, MatrixProduct, span

import mexpress as mx
from mexpress.criteria import Scorer
from mexpress.io.clouds import read_cloud
from mexpress.models import NestedBasis
from mexpress.selection.data import Samples

LOCAL = ("ER01", "ER05", "ER10", "NN01PCT", "NN05PCT", "NN10PCT")
CRITERIA = ("ER10", "ER01", "ER05", "NN01PCT", "NN05PCT", "NN10PCT", "PRESS", "AIC", "BIC")


@dataclass(frozen=True)
class Setting:
    """How large the problems are, and on how many data the others are timed."""

    rounds: int
    data: Path | None = None
    model_shape: tuple[int, int] = (4000, 120)
    n: int = 10_000
    most: int = 175
    few: int = 8
    sizes: int = 4


def clocked(task: Callable[[], object], blas: int = 1) -> tuple[float, object]:
    """Seconds, and what the task found."""
    time.sleep(REST)
    with threadpool_limits(blas):
        start = time.perf_counter()
        found = task()
        return time.perf_counter() - start, found


def difference(found: np.ndarray, expected: np.ndarray, who: str, tolerance: float = 1e-8) -> float:
    """The largest, relative to what is expected; an error if it is larger than rounding explains."""
    worst = float(np.max(np.abs(np.divide(found, expected) - 1)))
    if not worst < tolerance:
        raise AssertionError(f"{who} differs by {worst}")
    return worst


def depth_like(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Depths at n pixels of 640 x 480, in metres: a curved wall, things that stand before it, and noise."""
    rng = np.random.default_rng(seed)
    row, column = np.divmod(rng.choice(640 * 480, n, replace=False), 640)
    points = np.column_stack([column, row]).astype(np.float64)
    x, y = points.T / 640
    depth = 2.5 + 0.4 * np.sin(5 * x) * np.cos(4 * y) + 0.3 * x + 0.1 * np.cos(17 * x * y)
    depth -= 0.5 * ((x > 0.2) & (x < 0.45) & (y > 0.3)) + 0.8 * (np.hypot(x - 0.7, y - 0.4) < 0.15)
    return points, depth + rng.normal(0, 0.01, n)


def models(setting: Setting) -> None:
    """All leading models against the largest one."""
    n, p = setting.model_shape
    rng = np.random.default_rng(0)
    points = rng.random((n, 2))
    b = np.sin(5 * points[:, 0]) * np.cos(4 * points[:, 1]) + 0.1 * rng.standard_normal(n)
    scheme = mx.schemes.exclusion_radius(points, 0.1 * np.sqrt(2))
    control_points = mx.select_surface(points, b, "FIT", ["FIT"], p, smoothing=0).control_points
    designs = {
        "random": rng.standard_normal((n, p)),
        "thin-plate spline": Samples.of(points, b).design(NestedBasis(control_points)).A,
    }
    rows = [
        row
        for name, A in designs.items()
        for threads in THREADS
        for row in compare_models(name, A, b, scheme, threads, setting.rounds)
    ]
    held = scheme.held_out.sizes.mean()
    show(
        f"{p - 2} nested models: n = {n:,}, p = 3 .. {p}, a radius of 10 % of the diagonal ({held:.0f} data)",
        ["design", "", "threads", "fit and cross-validate, ms", "times one model, best", "median"],
        rows,
    )
    print("The aim is at most 3 times one model. One by one: every model factored and cross-validated, once.")


def compare_models(
    name: str, A: np.ndarray, b: np.ndarray, scheme: mx.schemes.Scheme, threads: int, rounds: int
) -> list[list[str]]:
    """Rows of the table for one design and number of threads."""
    sizes = range(3, A.shape[1] + 1)

    def one(size: int) -> float:
        model = mx.LeastSquares(A[:, :size], b, threads=threads)
        return model.cross_validate(scheme, threads=threads).score

    def nested() -> np.ndarray:
        return mx.cross_validate_nested(A, b, sizes, {"": scheme}, threads=threads)[""]

    separate, expected = clocked(lambda: [one(size) for size in sizes])
    difference(nested(), expected, "the sweep")
    tasks = {"one model": lambda: one(sizes[-1]), f"all {len(sizes)}, nested": nested}
    times: dict[str, list[float]] = {who: [] for who in tasks}
    for _ in range(rounds):
        for who, task in tasks.items():
            times[who].append(clocked(task)[0])
    times[f"all {len(sizes)}, one by one"] = [separate]
    base = times["one model"]
    return [
        [
            name,
            who,
            str(threads),
            span(seconds),
            f"{min(seconds) / min(base):.2f}",
            f"{np.median(seconds) / np.median(base):.2f}",
        ]
        for who, seconds in times.items()
    ]


def surface(setting: Setting) -> None:
    """Figure 7 of the paper."""
    if setting.data:
        cloud = read_cloud(setting.data, max_data=setting.n)
        points, values, source = cloud.points, cloud.values, setting.data.name
    else:
        points, values = depth_like(setting.n)
        source = "simulated depth"
    product = MatrixProduct()
    runs = run_sweeps(points, values, setting, product)
    counts = runs[CORES][0]["counts"]
    show_sweeps(f"{source}, n = {len(points):,}, l = {counts[0]} .. {counts[-1]}", runs, product)
    schemes = Scorer.of(LOCAL, points).schemes
    show_work(schemes, counts[-1], len(points), runs, product)
    control_points = mx.select_surface(
        points, values, "FIT", ["FIT"], setting.most, smoothing=0
    ).control_points
    A = Samples.of(points, values).design(NestedBasis(control_points)).A
    # In a hole of the training rows, predictions of the largest models have fewer digits; real data have such holes.
    problem = Problem(A, values, schemes, np.array(counts), 1e-4 if setting.data else 1e-7)
    show_others(problem, runs, setting)


def run_sweeps(
    points: np.ndarray, values: np.ndarray, setting: Setting, product: MatrixProduct
) -> dict[int, list[dict]]:
    """Sweeps in processes of their own, by threads, in turns with the product of matrices."""
    script = Path(__file__).parent / "peers" / "surface.py"
    runs: dict[int, list[dict]] = {threads: [] for threads in THREADS}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "data.npz"
        np.savez(path, points=points, values=values)
        for _ in range(setting.rounds):
            for threads, results in runs.items():
                product.run()
                command = [sys.executable, script, path, setting.most, threads, *CRITERIA]
                done = subprocess.run([str(part) for part in command], check=True, stdout=subprocess.PIPE)
                results.append(json.loads(done.stdout))
    return runs


def seconds(runs: list[dict]) -> list[float]:
    return [run["seconds"] for run in runs]


def show_sweeps(title: str, runs: dict[int, list[dict]], product: MatrixProduct) -> None:
    rows = []
    for threads, results in runs.items():
        times, base = seconds(results), product.times[threads]
        rows.append(
            [
                str(threads),
                span(times, 1),
                span(base),
                f"{min(times) / min(base):.0f}",
                f"{np.median(times) / np.median(base):.0f}",
                f"{max(run['peak'] for run in results) / 2**20:.0f}",
                f"{max(run['peak'] - run['before'] for run in results) / 2**20:.0f}",
            ]
        )
    show(
        f"A surface's sweep: {title}, {', '.join(sorted(CRITERIA))}",
        [
            "threads",
            "sweep, s",
            "1500^2 product, ms",
            "products, best",
            "median",
            "peak memory, MiB",
            "beyond data and imports",
        ],
        rows,
    )
    chosen = ", ".join(f"{name} {count}" for name, count in runs[CORES][0]["selected"].items())
    print(f"The aim is under 100 products on two threads. Selected: {chosen}")


def held_rows(schemes: dict[str, mx.schemes.Scheme]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """By scheme and datum, how many are held out, are not in the next smaller set, differ from the set before."""
    whole = np.array([scheme.held_out.sizes for scheme in schemes.values()])
    order = np.argsort(whole, axis=0, kind="stable")
    rings = np.empty_like(whole)
    np.put_along_axis(
        rings, order, np.diff(np.take_along_axis(whole, order, axis=0), axis=0, prepend=0), axis=0
    )
    slid = whole.copy()
    for changed, scheme in zip(slid, schemes.values(), strict=True):
        inside = np.zeros(scheme.n_data, dtype=bool)
        for before, i in pairwise(scheme.visiting_order):
            last, now = scheme.held_out[before], scheme.held_out[i]
            inside[last] = True
            changed[i] = len(last) + len(now) - 2 * np.count_nonzero(inside[now])
            inside[last] = False
    return whole, rings, slid


def multiply_adds(schemes: dict[str, mx.schemes.Scheme], p: int, n: int) -> dict[str, float]:
    """Of all schemes and PRESS, by the ways in this module's docstring."""
    whole, rings, slid = held_rows(schemes)

    def primal(q: np.ndarray) -> np.ndarray:
        return q * p**2 / 2 + p**3 / 6

    dual = whole.astype(float) ** 2 * p
    nearest = np.minimum(np.minimum(rings, slid), whole)
    return {
        "afresh": primal(whole).sum() + n * primal(np.array(1)),
        "afresh, or by columns": np.minimum(primal(whole), dual).sum() + n * p,
        "ring by ring": np.minimum(primal(rings), dual).sum() + n * p,
        "or from the set before": np.minimum(primal(nearest), dual).sum() + n * p,
    }


def show_work(
    schemes: dict[str, mx.schemes.Scheme], p: int, n: int, runs: dict[int, list[dict]], product: MatrixProduct
) -> None:
    rows = []
    for way, count in multiply_adds(schemes, p, n).items():
        products = count / product.SIZE**3
        multiples = [
            min(seconds(results)) / (products * min(product.times[threads]))
            for threads, results in runs.items()
        ]
        rows.append(
            [way, f"{count / 1e9:.1f}", f"{products:.1f}", *(f"{multiple:.2f}" for multiple in multiples)]
        )
    times = [f"times the product's time, {threads} thread(s)" for threads in runs]
    show("Its multiply-adds, by ways to count them", ["", "10^9", "products of 1500^2", *times], rows)


@dataclass(frozen=True)
class Problem:
    """What the others are given."""

    A: np.ndarray
    b: np.ndarray
    schemes: dict[str, mx.schemes.Scheme]
    counts: np.ndarray
    tolerance: float

    def balls(self, i: int) -> list[np.ndarray]:
        """The sets around a datum, by scheme."""
        return [scheme.held_out[i] for scheme in self.schemes.values()]

    def sampled(self, few: int) -> list[int]:
        """Some data at random."""
        return np.random.default_rng(1).choice(len(self.b), few, replace=False).tolist()

    def some_counts(self, few: int) -> list[int]:
        """In the middle of as many equal parts: a cost that grows linearly is then averaged exactly."""
        return [int(np.median(part)) for part in np.array_split(self.counts, few)]

    def scores(self, data: list[int]) -> np.ndarray:
        """Mexpress's, of some data by all schemes and models, (schemes, counts)."""
        some = {
            name: mx.schemes.from_sets([scheme.held_out[i] for i in data], [[i] for i in data], n=len(self.b))
            for name, scheme in self.schemes.items()
        }
        return np.array(list(mx.cross_validate_nested(self.A, self.b, self.counts, some).values()))


@dataclass(frozen=True)
class Timing:
    """Another way to the same curves, timed on a share of the work."""

    name: str
    threads: int
    seconds: float
    timed: str
    share: float
    difference: float

    def row(self, sweep: float) -> list[str]:
        """A line of the table, beside mexpress's time for the same."""
        whole = self.seconds / self.share
        return [
            self.name,
            str(self.threads),
            self.timed,
            f"{self.seconds:.2f}",
            duration(whole) + (", extrapolated" if self.share < 1 else ""),
            f"{whole / sweep:,.1f}",
            f"{self.difference:.0e}",
        ]


def duration(seconds: float) -> str:
    for unit, length in (("days", 86400), ("h", 3600), ("min", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.1f} {unit}"
    return f"{seconds:.1f} s"


def show_others(problem: Problem, runs: dict[int, list[dict]], setting: Setting) -> None:
    sweep = {threads: min(seconds(results)) for threads, results in runs.items()}
    timings = [
        *time_rings(problem, runs[CORES][0]["curves"], 25 * setting.few),
        time_largest(problem, setting.few // 2),
        time_singly(
            "equation (13) for each size", numpy_nested.EachModel, problem, setting.few, setting.sizes
        ),
        time_singly(
            "a refit for each set and size", numpy_nested.Refits, problem, setting.few // 2, setting.sizes
        ),
    ]
    rows = [
        ["mexpress", str(threads), "all", f"{best:.2f}", duration(best), "1.0", ""]
        for threads, best in sweep.items()
    ]
    rows += [timing.row(sweep[timing.threads]) for timing in timings]
    show(
        "Other ways to the same curves, in numpy",
        ["", "threads", "timed on", "seconds", "whole", "times mexpress", "curves differ by"],
        rows,
    )
    print("All but mexpress without PRESS, for which equation (3) is enough.")


def fastest(
    predict: Callable[[int], object], data: list[int], threads: int, ways: str = "blas data"
) -> tuple:
    """Seconds for some data in the faster of the ways to use threads, and what was found: (data, ..)."""
    settings = {"blas": (1, threads), "data": (threads, 1)}
    taken, found = zip(
        *(
            clocked(lambda w=workers: shared_out(predict, data, w), blas)
            for workers, blas in dict.fromkeys(settings[way] for way in ways.split())
        ),
        strict=True,
    )
    return min(taken), np.array(found[0])


def shared_out(predict: Callable[[int], object], data: list[int], workers: int) -> list:
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(predict, data))


def rms(found: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(np.square(found), axis=0))


def time_rings(problem: Problem, curves: dict[str, list[float]], few: int) -> list[Timing]:
    """The nested trick in numpy: all data with all threads, whose curves mexpress must have; some with one."""
    n, peer = len(problem.b), numpy_nested.Rings(problem.A, problem.b)
    timings = []
    for threads in THREADS:
        whole = threads == CORES
        data = list(range(n)) if whole else problem.sampled(few)
        taken, found = fastest(lambda i: peer.residuals(i, problem.balls(i)), data, threads, "data")
        expected = [curves[name] for name in problem.schemes] if whole else problem.scores(data)
        name, timed = "nested trick, ring by ring", "all" if whole else f"{len(data)} data"
        error = difference(rms(found)[:, problem.counts - 1], expected, name, problem.tolerance)
        timings.append(Timing(name, threads, taken, timed, len(data) / n, error))
    return timings


def time_largest(problem: Problem, few: int) -> Timing:
    """A refit of the largest model for each set, and all models from its triangle."""
    peer, data = numpy_nested.Refits(problem.A, problem.b), problem.sampled(few)
    taken, found = fastest(lambda i: [peer.curve(i, K) for K in problem.balls(i)], data, CORES)
    name = "a refit for each set, all sizes from it"
    error = difference(rms(found)[:, problem.counts - 1], problem.scores(data), name, problem.tolerance)
    return Timing(name, CORES, taken, f"{few} data", few / len(problem.b), error)


def time_singly(name: str, make: type, problem: Problem, few: int, sizes: int) -> Timing:
    """Some data by some models, each on its own."""
    peer, data, counts = make(problem.A, problem.b), problem.sampled(few), problem.some_counts(sizes)

    def predict(i: int) -> list[list[float]]:
        return [[peer.residual(i, K, size) for size in counts] for K in problem.balls(i)]

    taken, found = fastest(predict, data, CORES)
    expected = problem.scores(data)[:, np.searchsorted(problem.counts, counts)]
    error = difference(rms(found), expected, name, problem.tolerance)
    share = few / len(problem.b) * sizes / len(problem.counts)
    return Timing(name, CORES, taken, f"{few} data, {sizes} sizes", share, error)


def main() -> None:
    parts = {"models": models, "surface": surface}
    parser = argparse.ArgumentParser(description="Time nested models.")
    parser.add_argument("parts", nargs="*", help=", ".join(parts))
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--small", action="store_true", help="a try, in seconds")
    parser.add_argument(
        "--data", type=Path, metavar="DEPTH", help="a depth map in place of the simulated one"
    )
    given = parser.parse_args()
    if unknown := set(given.parts) - set(parts):
        parser.error(f"no such part: {', '.join(sorted(unknown))}")
    setting = Setting(given.rounds, given.data)
    if given.small:
        setting = Setting(given.rounds, given.data, (800, 40), 1500, 40)
    for name in given.parts or parts:
        parts[name](setting)


if __name__ == "__main__":
    main()
