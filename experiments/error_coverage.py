"""How often 1.96 times `error` covers what is in gaps between the data, and `interval` what is like the data.

Usage: ``python experiments/error_coverage.py [DATA] [--draws N] [--rows A,B]``, or ``--times`` for what both cost;
needs matplotlib, whose sample data have the terrain. DATA is a directory with any of

sheets/NAME.npz   image_points (views, n, 2) of a sheet that deforms: hulk and kinectpaper
depth/TUM_depth.png, depth_00000.png   depth maps

Every row has a pool of points with known values. Draw k of it cuts gaps into the pool, fits a model to some of the
points outside of them, and asks for the error at points inside.

discs    four discs, of 6 to 15 % of the extent in radius
side     10 to 30 % of the extent on one side
tracks   data along 6 to 13 lines, as ships sail; the gaps are what is between them
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from comparison import fields, heights

import mexpress as mx
from mexpress.simulation import Configuration, correspondences

DRAWS = 12
DATA, ASKED = 500, 1000
"""Data of a fit, and points of every kind that are asked for, at most."""

MOST = 250
"""Largest number of control points of a surface."""

TIMED = ((300, 300), (2000, 300), (10_000, 300))
"""Data and control points, of warps half as many, that are timed."""

POOL = 30_000
LEVEL = 0.9
CUTS = ("discs", "side", "tracks")


@dataclass(frozen=True)
class Pool:
    """Points, (n, 2), their true values, and the standard deviation of the noise of a measurement."""

    points: np.ndarray
    truth: np.ndarray
    noise: float = 0.0


def simulated(draw):
    """Draw a random surface with noise."""
    random = np.random.default_rng(draw)
    surface = fields.random_surface(random, fields.log_uniform(random, *fields.LENGTHS))
    noise = fields.log_uniform(random, 0.02, fields.NOISE[1])
    points = random.uniform(0, 1, (POOL, 2))
    return Pool(points, surface(points), noise)


def pixels(read, draw):
    """Return all pixels of a map, whatever the draw."""
    return Pool(*read())


def sheet(draw):
    """Draw two images of a simulated sheet, whose points have noise of 1 px in the second one."""
    random = np.random.default_rng(draw)
    pair = random.choice(10, 2, replace=False)
    where = Configuration(int(pair[0]), int(pair[1]), int(random.integers(5)))
    matches = correspondences(where, 10, seed=draw)
    return Pool(matches.dense_source, matches.dense_target, 1.0)


def tracked(path, draw):
    """Draw two views of a sheet that deforms, as measured."""
    with np.load(path) as arrays:
        views = arrays["image_points"]
    return Pool(*views[np.random.default_rng(draw).choice(len(views), 2, replace=False)].astype(float))


def pools(folder: Path | None) -> dict[str, Callable[[int], Pool]]:
    """Return by name what draws a pool; those of surfaces first."""
    folder = folder or Path("nowhere")
    maps = {"TUM": ("TUM_depth.png", 5000.0), "PrimeSense": ("depth_00000.png", 1000.0)}
    depths = {
        name: partial(pixels, partial(heights.depth_map, folder / "depth" / file, scale))
        for name, (file, scale) in maps.items()
        if (folder / "depth" / file).exists()
    }
    sheets = {
        name: partial(tracked, folder / "sheets" / f"{name}.npz")
        for name in ("hulk", "kinectpaper")
        if (folder / "sheets" / f"{name}.npz").exists()
    }
    terrain = {"Jacksboro": partial(pixels, heights.terrain)}
    return {"simulated surfaces": simulated} | terrain | depths | {"simulated sheets": sheet} | sheets


def cut(kind, points, random):
    """Return which points may be data, and which are in gaps."""
    place = (points - points.min(axis=0)) / np.ptp(points, axis=0)
    if kind == "tracks":
        lines = random.integers(6, 14)
        away = np.abs(place[:, 1:] - (np.arange(lines) + 0.5) / lines).min(axis=1)
        return away < 0.004, away > 0.02
    if kind == "discs":
        centres, radii = random.uniform(0.15, 0.85, (4, 2)), random.uniform(0.06, 0.15, 4)
        gap = (np.linalg.norm(place[:, None] - centres, axis=2) < radii).any(axis=1)
    else:
        along = place[:, random.integers(2)]
        gap = (1 - along if random.integers(2) else along) < random.uniform(0.1, 0.3)
    return ~gap, gap


def judge(folder, name, kind, draw):
    """Return shares that are covered: of measurements and of truth in gaps, by norm, by `covers`, by `interval`."""
    pool, random = pools(folder)[name](draw), np.random.default_rng([draw, 1])
    measured = pool.truth + pool.noise * random.normal(size=pool.truth.shape)
    outside, gap = (random.permutation(np.flatnonzero(some)) for some in cut(kind, pool.points, random))
    number = min(DATA, round(0.8 * len(outside)))
    data, alike, gap = outside[:number], outside[number : number + ASKED], gap[:ASKED]
    model = fitted(pool.points[data], measured[data])
    error, predicted = model.error(pool.points[gap])[:, None], model(pool.points[gap])
    values = [(each[gap] - predicted).reshape(len(gap), -1) for each in (measured, pool.truth)]
    share = 1.96 * error / np.sqrt(values[0].shape[1])
    norms = np.linalg.norm(values[0], axis=1)
    interval = model.interval(pool.points[alike], LEVEL)
    within = (interval.lower <= measured[alike]) & (measured[alike] <= interval.upper)
    return (
        *((np.abs(each) <= share).mean() for each in values),
        (norms <= 1.96 * error[:, 0]).mean(),
        np.sqrt((error**2).mean() / (norms**2).mean()),
        within.mean(),
    )


def fitted(points, values):
    """Return the model that is selected: a surface of depths, a warp to other points."""
    if values.ndim == 1:
        return mx.select_surface(points, values, smoothing="auto", max_count=MOST).surface
    return mx.select_warp(points, values, smoothing="auto").warp


def line(name, kind, shares):
    """Return a line of the table of the shares of all draws, (draws, 5)."""
    measured, truth, norm, ratio, interval = shares.T
    cells = [f"{100 * each.mean():.0f}" for each in (measured, truth, norm)]
    worst, size = f"{100 * measured.min():.0f}", f"{np.exp(np.log(ratio).mean()):.2f}"
    return f"| {name}, {kind} | {cells[0]} ({worst}) | {cells[1]} | {cells[2]} | {size} | {100 * interval.mean():.0f} |"


def times() -> None:
    """Print the table of CPU times."""
    print("| data | control points | error | interval |", "|---|---|---|---|", sep="\n")
    for number, count in TIMED:
        random = np.random.default_rng(0)
        points, asked = random.uniform(0, 1, (number, 2)), random.uniform(0, 1, (ASKED, 2))
        depth = np.sin(6 * points[:, 0]) + random.normal(0, 0.1, number)
        surface = mx.fit_surface(points, depth, points[:count], smoothing=1e-6)
        moved = points + 0.1 * depth[:, None]
        warp = mx.fit_warp(points, moved, points[: count // 2], smoothing=1e-6)
        for model, what in ((surface, "surface"), (warp, "warp")):
            spent = []
            for ask in (model.error, model.interval):
                start = time.process_time()
                ask(asked)
                spent.append(f"{time.process_time() - start:.1f}")
            print(f"| {number} | {len(model.control_points)}, {what} | {' | '.join(spent)} |", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", nargs="?", type=Path, metavar="DATA")
    parser.add_argument("--draws", type=int, default=DRAWS, metavar="N")
    parser.add_argument(
        "--rows", type=lambda text: text.split(","), default=[""], metavar="A,B", help="parts of names"
    )
    parser.add_argument("--times", action="store_true", help="print CPU times instead")
    options = parser.parse_args()
    if options.times:
        times()
        return
    rows = [
        (name, kind)
        for name in pools(options.data)
        for kind in (CUTS[:2] if "hulk" in name or "kinect" in name else CUTS)
        if any(part in f"{name}, {kind}" for part in options.rows)
    ]
    wanted = [(options.data, *row, draw) for row in rows for draw in range(options.draws)]
    shares = np.array(list(mx.map_problems(judge, wanted, progress=True)))
    print("| | measurements | truth | norm | error / RMS | interval |", "|---|---|---|---|---|---|", sep="\n")
    for row, some in zip(rows, shares.reshape(len(rows), options.draws, -1), strict=True):
        print(line(*row, some))


if __name__ == "__main__":
    main()
