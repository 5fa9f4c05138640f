"""Time public calls with one thread and with all, on uniform and on clustered points, and against other versions.

Usage: ``python benches/calls.py [NAME ...] [--rounds 3] [--against FOLDER ...]``; all calls if none is named. A folder
to compare with holds another build of the package ``mexpress``.

Every call runs in a process of its own for each version and number of threads (its own and its BLAS's), in turns. The
table shows the least time, and the largest memory of a process beyond that before the call. "Products" are those of two
1500 x 1500 matrices by numpy on as many threads, timed in the same processes: each takes 6.75 Gflop.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from tables import show
from versus import REST, THREADS, MatrixProduct, waves

import mexpress as mx

Call = Callable[[], object]
SIZE = (640.0, 480.0)


def uniform(n: int, seed: int = 0) -> np.ndarray:
    """Points all over an image."""
    return np.random.default_rng(seed).uniform(0, 1, (n, 2)) * SIZE


def clustered(n: int, seed: int = 0) -> np.ndarray:
    """Points as detectors of corners find them: five of six in clusters of a dozen, some pixels wide."""
    rng = np.random.default_rng(seed)
    alone = n // 6
    centres = rng.uniform(0.05, 0.95, (max(n // 14, 1), 2)) * SIZE
    some = centres[rng.integers(len(centres), size=n - alone)] + rng.normal(0, 6, (n - alone, 2))
    return np.concatenate([uniform(alone, seed + 1), some])


def bent(source: np.ndarray, seed: int = 0) -> np.ndarray:
    """Where points of a bent sheet are seen in another view, with noise of a pixel."""
    x, y = source.T
    target = source + 12 * np.column_stack([np.sin(x / 90 + y / 150), np.cos(y / 110)])
    return target / (1 + 4e-4 * x)[:, None] + np.random.default_rng(seed).normal(0, 1, source.shape)


def heights(points: np.ndarray, seed: int = 0) -> np.ndarray:
    """Heights of a hilly ground, with noise."""
    x, y = points.T
    hills = 20 * np.sin(x / 80) * np.cos(y / 60) + 8 * np.cos(x * y / 2e4)
    return hills + np.random.default_rng(seed).normal(0, 1, len(points))


def regression(n: int, p: int, places: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """A design, and responses; of places, smooth."""
    rng = np.random.default_rng(0)
    A = rng.standard_normal((n, p)) if places is None else waves(places / SIZE, p)
    return A, A @ rng.standard_normal(p) + rng.standard_normal(n)


def local_exclusion(points: np.ndarray, p: int, q: int) -> Call:
    model = mx.LeastSquares(*regression(len(points), p, points))
    scheme = mx.schemes.nearest(points, q)
    return lambda: model.cross_validate(scheme)


def leading_models(points: np.ndarray, p: int) -> Call:
    A, b = regression(len(points), p, points)
    scheme = mx.schemes.exclusion_radius(points, 80.0)
    return lambda: mx.cross_validate_nested(A, b, range(3, p + 1), {"": scheme})


def fit(n: int, p: int) -> Call:
    A, b = regression(n, p)
    return lambda: mx.LeastSquares(A, b)


def folds(n: int, p: int, k: int | None) -> Call:
    """Fit and predictions of k folds, or of each datum alone."""
    A, b = regression(n, p)
    scheme = mx.schemes.k_fold(n, k, seed=0) if k else mx.schemes.leave_one_out(n)
    return lambda: mx.LeastSquares(A, b).cross_validate(scheme)


def warp(source: np.ndarray, **options: object) -> Call:
    target = bent(source)
    return lambda: mx.select_warp(source, target, image_size=SIZE, **options)


def surface(points: np.ndarray, **options: object) -> Call:
    values = heights(points)
    return lambda: mx.select_surface(points, values, **options)


def evaluation(lifting: str, count: int, n: int) -> Call:
    source = uniform(4 * count)
    columns = round(np.sqrt(count))
    x, y = np.meshgrid(np.linspace(0, SIZE[0], columns), np.linspace(0, SIZE[1], count // columns))
    model = mx.fit_warp(
        source, bent(source), np.column_stack([x.ravel(), y.ravel()]), lifting, fractional=False
    )
    places = uniform(n, 1)
    return lambda: model(places)


PLACEMENTS = {"placement": "lloyd", "smoothing": 0, "max_count": 60}
NESTED = {"placement": "nested", "smoothing": 0}
CALLS: dict[str, tuple[str, Callable[[], Call]]] = {
    "local": (
        "local exclusion, 20,000 x 60, 101 held out",
        lambda: local_exclusion(uniform(20_000), 60, 101),
    ),
    "local-clustered": ("the same, clustered", lambda: local_exclusion(clustered(20_000), 60, 101)),
    "nested": (
        "118 leading models, 4,000 data, a radius of 10 %",
        lambda: leading_models(uniform(4000), 120),
    ),
    "fit": ("fit, 2,000,000 x 50", lambda: fit(2_000_000, 50)),
    "folds": ("fit and 10 folds, 100,000 x 40", lambda: folds(100_000, 40, 10)),
    "alone": ("fit and leave-one-out, 1,000,000 x 40", lambda: folds(1_000_000, 40, None)),
    "warp": ("select_warp, 2,000 matches", lambda: warp(uniform(2000))),
    "warp-clustered": ("the same, clustered", lambda: warp(clustered(2000))),
    "surface": ("select_surface, 1,000 data", lambda: surface(uniform(1000))),
    "surface-clustered": ("the same, clustered", lambda: surface(clustered(1000))),
    "warp150": ("select_warp, smoothing=0, nested, 150 matches", lambda: warp(uniform(150), **NESTED)),
    "warp150-clustered": ("the same, clustered", lambda: warp(clustered(150), **NESTED)),
    "warp262": ("select_warp, smoothing=0, nested, 262 matches", lambda: warp(uniform(262), **NESTED)),
    "warp262-clustered": ("the same, clustered", lambda: warp(clustered(262), **NESTED)),
    "lloyd": (
        "select_surface, ER10, Lloyd, 2,000 data",
        lambda: surface(uniform(2000), criterion="ER10", **PLACEMENTS),
    ),
    "radius": (
        "exclusion_radius, 1,000,000 points, 100 around each",
        lambda: neighbours("exclusion_radius", 3.13),
    ),
    "nearest": ("nearest, 1,000,000 points, 100", lambda: neighbours("nearest", 100)),
    "tps": ("1,000,000 points, 500 control points", lambda: evaluation("tps", 500, 1_000_000)),
    "bspline": (
        "1,000,000 points, 500 control points, B-spline",
        lambda: evaluation("bspline", 500, 1_000_000),
    ),
}


def neighbours(scheme: str, size: float) -> Call:
    points = uniform(1_000_000)
    return lambda: getattr(mx.schemes, scheme)(points, size)


def time_here(name: str) -> None:
    """Times one call, again and again for a second, and prints what it took at best."""
    call = CALLS[name][1]()
    matrix = MatrixProduct().a
    products, calls = [], []
    for _ in range(3):
        start = time.perf_counter()
        matrix @ matrix
        products.append(time.perf_counter() - start)
    time.sleep(REST)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    while sum(calls) < 1:
        start = time.perf_counter()
        call()
        calls.append(time.perf_counter() - start)
    beyond = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    print(json.dumps({"product": min(products), "seconds": min(calls), "MiB": beyond / 1024}))


def timed(name: str, folder: Path | None, threads: int) -> dict[str, float]:
    """What a process of its own found."""
    count = str(threads)
    environment = os.environ | {"MEXPRESS_NUM_THREADS": count, "OPENBLAS_NUM_THREADS": count}
    if folder:
        environment["PYTHONPATH"] = str(folder)
    command = [sys.executable, __file__, "--here", name]
    found = subprocess.run(command, check=True, capture_output=True, env=environment)
    return json.loads(found.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description="Time public calls.")
    parser.add_argument("names", nargs="*", help=", ".join(CALLS))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--against", type=Path, nargs="*", default=[], help="folders of other builds")
    parser.add_argument("--here", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if unknown := set(given.names) - set(CALLS):
        parser.error(f"no such call: {', '.join(sorted(unknown))}")
    if given.here:
        return time_here(given.here)
    rows = []
    for name in given.names or CALLS:
        print(name, file=sys.stderr, flush=True)
        ways = [(folder, threads) for threads in THREADS for folder in (None, *given.against)]
        found = {way: [] for way in ways}
        for _ in range(given.rounds):
            for way in ways:
                found[way].append(timed(name, *way))
        best = {way: min(times["seconds"] for times in runs) for way, runs in found.items()}
        for threads in THREADS:
            own = best[None, threads]
            product = min(times["product"] for times in found[None, threads])
            rows.append(
                [
                    CALLS[name][0] if threads == 1 else "",
                    str(threads),
                    f"{own:.3g}",
                    f"{own / product:.3g}",
                    f"{best[None, 1] / own:.2f}",
                    f"{max(times['MiB'] for times in found[None, threads]):.0f}",
                    *(f"{best[folder, threads] / own:.2f}" for folder in given.against),
                ]
            )
    head = ["", "threads", "seconds", "products", "times as fast as one", "MiB"]
    show("Public calls", [*head, *(f"{folder} takes times" for folder in given.against)], rows)
    return None


if __name__ == "__main__":
    main()
