"""Warps of whole images: seconds, memory and errors of dense maps, inverse maps and moved images.

`python benches/images.py` takes 236 control points, over images of 600 x 400 and 4000 x 3000 pixels. Every figure is
of a process of its own; errors are against 20,000 pixels one by one.
"""

import argparse
import multiprocessing
import os
import resource
import time

import numpy as np

import mexpress as mx
from mexpress.liftings import LIFTINGS

_CONTROL_POINTS = 236
_SIZES = (600, 400), (4000, 3000)
_CHECKED = 20_000


def a_warp(lifting: str, width: int, height: int) -> mx.Warp:
    """Return a warp with waves of 3 % of the width, from noisy matches."""
    rng = np.random.default_rng(0)
    source = rng.uniform(0, 1, (6 * _CONTROL_POINTS, 2)) * (width, height)
    x, y = source.T / width
    waves = np.column_stack([np.sin(7 * y) + np.cos(9 * x), np.cos(6 * x) * np.sin(8 * y)])
    target = source + 0.03 * width * waves + rng.normal(0, 0.3, source.shape)
    return mx.fit_warp(source, target, LIFTINGS[lifting].place(source, _CONTROL_POINTS), lifting=lifting)


def peak() -> float:
    """Return the largest memory of this process so far, in MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def measured(lifting: str, size: tuple[int, int], what: str) -> tuple[float, float, float, float]:
    """Return seconds, seconds of all cores, MiB beyond what was there, and the largest error in pixels."""
    warp, photo = (
        a_warp(lifting, *size),
        np.random.default_rng(0).integers(0, 256, (*size[::-1], 3), np.uint8),
    )
    getattr(warp, "inverse" if what == "inverse_map" else "__call__")([[9, 9]])  # caches
    before, start, cores = peak(), time.perf_counter(), time.process_time()
    found = warp.remap(photo) if what == "remap" else getattr(warp, what)(*size)
    seconds, cores, more = time.perf_counter() - start, time.process_time() - cores, peak() - before
    if what == "remap":
        return seconds, cores, more, np.nan
    x, y = np.random.default_rng(1).integers(0, np.array(size)[:, None], (2, _CHECKED))
    exact = (warp.inverse if what == "inverse_map" else warp)(np.column_stack([x, y]))
    return seconds, cores, more, float(np.nanmax(np.hypot(*(found[:, y, x].T - exact).T)))


def one_by_one(lifting: str, size: tuple[int, int], what: str) -> float:
    """Return the seconds that all pixels would take one by one, from some of them."""
    warp = a_warp(lifting, *size)
    some = np.random.default_rng(2).uniform(0, 1, (_CHECKED, 2)) * size
    start = time.perf_counter()
    (warp.inverse if what == "inverse_map" else warp)(some)
    return (time.perf_counter() - start) / _CHECKED * size[0] * size[1]


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--liftings", nargs="+", default=["tps", "bspline", "affine"])
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    print(
        f"threads: {os.environ.get('MEXPRESS_NUM_THREADS', 'all')}; load when it started: {os.getloadavg()[0]:.1f}\n"
    )
    head = (
        "lifting",
        "size",
        "what",
        "best, s",
        "median, s",
        "of all cores, s",
        "one by one, s",
        "MiB",
        "error, px",
    )
    print("| " + " | ".join(head) + " |\n|" + "---|" * len(head))
    for lifting in arguments.liftings:
        for size in _SIZES:
            for what in ("dense_map", "inverse_map", "remap"):
                rounds = []
                for _ in range(arguments.rounds):
                    with multiprocessing.get_context("spawn").Pool(1) as pool:
                        rounds.append(pool.apply(measured, (lifting, size, what)))
                seconds, cores, memory, error = np.array(rounds).T
                alone = "" if what == "remap" else f"{one_by_one(lifting, size, what):.1f}"
                cells = f"{seconds.min():.2f}", f"{np.median(seconds):.2f}", f"{cores.min():.2f}", alone
                row = (
                    lifting,
                    f"{size[0]} x {size[1]}",
                    what,
                    *cells,
                    f"{memory.max():.0f}",
                    f"{error.max():.3f}",
                )
                print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
