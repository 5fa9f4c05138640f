"""What smoothing as a second axis costs, and nested placement against Lloyd's.

Run ``python benches/smoothing.py map`` (60 counts x 20 weights of 2,000 matches against one sweep without smoothing),
``python benches/smoothing.py auto`` (the time and the memory of smoothing="auto"), ``python benches/smoothing.py caps``
(true errors and times by the largest number of control points), or ``python benches/smoothing.py placement [N]`` (true
errors on N simulated sheets).
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable

import numpy as np
from tables import show

import mexpress as mx
from mexpress import simulation
from mexpress.selection.weights import smoothing_weights

COUNTS = range(3, 63)
CAPS = (150, 200, 250, 300)
CRITERIA = ["FIT", "CMPRESS"]


def timed(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def bent(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Matches of a gently bent sheet seen in perspective, with noise of 1 px."""
    random = np.random.default_rng(seed)
    source = random.uniform(0, 1, (n, 2)) * [640, 480]
    x, y = source.T
    target = source + 12 * np.column_stack([np.sin(x / 90 + y / 150), np.cos(y / 110)])
    return source, target / (1 + 4e-4 * x)[:, None] + random.normal(0, 1, source.shape)


def time_map() -> None:
    source, target = bent(2000)
    weights = smoothing_weights("auto", len(source), 640.0 * 480.0, COUNTS[-1])

    def sweep(**options: object) -> Callable[[], object]:
        return lambda: mx.select_warp(
            source, target, criteria=CRITERIA, counts=COUNTS, image_size=(640, 480), **options
        )

    before = [timed(sweep(placement="nested", smoothing=0)) for _ in range(3)]
    whole = timed(sweep(placement="nested", smoothing=weights))
    plain = float(np.median(before + [timed(sweep(placement="nested", smoothing=0)) for _ in range(3)]))
    lloyd = timed(sweep(placement="lloyd", smoothing=0))
    rows = [
        ["nested placement", f"{plain:.2f}", "1.0"],
        [f"... x {len(weights)} weights", f"{whole:.2f}", f"{whole / plain:.1f}"],
        ["Lloyd's placement", f"{lloyd:.2f}", f"{lloyd / plain:.1f}"],
    ]
    show(f"{len(COUNTS)} counts, {len(source):,} matches", ["", "seconds", "plain sweeps"], rows)


def time_auto() -> None:
    rows = []
    for n in (50, 150, 300, 1000, 2000, 10_000):
        source, target = bent(n)
        seconds = timed(lambda s=source, t=target: mx.select_warp(s, t, smoothing="auto"))
        depth = timed(lambda s=source, t=target: mx.select_surface(s, t[:, 0], smoothing="auto"))
        peak = (
            resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
            >> 20
        )
        rows.append([f"{n:,}", f"{seconds:.2f}", f"{depth:.2f}", str(peak)])
    show('smoothing="auto"', ["n", "warp, s", "surface, s", "peak so far, MiB"], rows)


def waves(length: float, random: np.random.Generator) -> Callable[[np.ndarray], np.ndarray]:
    """A random field over the plane with this correlation length, and a standard deviation of one."""
    frequencies = random.normal(size=(200, 2)) / length
    phases = random.uniform(0, 2 * np.pi, 200)
    return lambda points: np.cos(points @ frequencies.T + phases).sum(axis=1) / 10


def compare_caps() -> None:
    """True errors and CPU seconds in rough fields, medians of three draws: 20 px of bending, noise of 0.5 px."""
    table = []
    for n in (400, 2000):
        for length in (300.0, 150.0, 80.0):
            rows = []
            for seed in range(3):
                random = np.random.default_rng(seed)
                bend = [waves(length, random) for _ in "xy"]
                source, unseen = random.uniform(0, 1000, (n, 2)), random.uniform(20, 980, (3000, 2))
                moved = [p + 20 * np.column_stack([f(p) for f in bend]) for p in (source, unseen)]
                target = moved[0] + random.normal(0, 0.5, source.shape)
                for most in CAPS:
                    start = time.process_time()
                    warp = mx.select_warp(source, target, criteria=[], counts=[3, most]).warp
                    seconds = time.process_time() - start
                    rows.append((np.sqrt(((warp(unseen) - moved[1]) ** 2).sum(1).mean()), seconds))
            middle = np.median(np.reshape(rows, (3, len(CAPS), 2)), axis=0)
            cells = [f"{error:.2f} px, {seconds:.1f} s" for error, seconds in middle]
            table.append([f"{n:,}", f"{length:g} px", *cells])
    show("True error and CPU seconds by the most control points", ["n", "length", *map(str, CAPS)], table)


def compare_placements(number: int) -> None:
    """True errors and times on simulated sheets, of plain and of smoothed models."""
    every = simulation.configurations()
    chosen = np.random.default_rng(0).choice(len(every), number, replace=False)
    rows = []
    for n in (50, 150):
        data = [simulation.correspondences(every[k], n, noise=1.0, seed=int(k)) for k in chosen]
        smoothed = {"smoothing": "auto", "criterion": "CMPRESS"}
        settings = {
            "no smoothing, Lloyd": {"criterion": "CMPRESS", "placement": "lloyd", "smoothing": 0},
            "no smoothing, nested": {"criterion": "CMPRESS", "placement": "nested", "smoothing": 0},
            "smoothing auto, Lloyd": {**smoothed, "placement": "lloyd"},
            "smoothing auto, nested": smoothed,
            "smoothing auto, nested, every count": {**smoothed, "counts": range(3, n + 1)},
        }
        for label, options in settings.items():
            errors, start = [], time.perf_counter()
            for one in data:
                warp = mx.select_warp(one.source, one.target, image_size=one.image_size, **options).warp
                errors.append(np.sqrt(((warp(one.dense_source) - one.dense_target) ** 2).sum(1).mean()))
            seconds = (time.perf_counter() - start) / number
            rows.append([str(n), label, f"{np.median(errors):.1f}", f"{seconds:.2f}"])
    show("Placements, with one thread", ["n", "", "median true error, px", "seconds"], rows)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["map"]:
            time_map()
        case ["auto"]:
            time_auto()
        case ["caps"]:
            compare_caps()
        case ["placement", *number]:
            compare_placements(int(number[0]) if number else 20)
        case _:
            sys.exit(__doc__)
