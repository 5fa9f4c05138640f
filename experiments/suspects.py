"""Which wrong data are found? Some are planted in real matches and depths, and looked for.

    python experiments/suspects.py DATA [--draws N]

DATA is a folder with any of sheets/*.npz (image_points (views, n, 2), visible (views, n)), flat/boat_matches.npz
(tentative (n, 4), H_A_to_B (3, 3)) and depth/depth_00000.png; matplotlib has the elevation map. A fifth of the matches,
and all depths but 300, are never seen by a search: the error there, of the selection without what was found, is divided
by that of the selection without what was planted. Prints the table of docs/suspects.md.
"""

import argparse
import math
import warnings
from collections import defaultdict
from pathlib import Path

import numpy as np
from matplotlib.cbook import get_sample_data

import mexpress as mx
from mexpress.io.clouds import read_cloud
from mexpress.suspicion import SuspicionWarning

SHARES = (0.01, 0.05, 0.1, 0.2, 0.3)
HOW = (
    "random value",
    "swapped values",
    "value -9999",
    "value 1e6",
    "random position",
    "far position",
    "shifted",
)
SEEN = 300


def parted(points, values, count, random):
    """Return some of the data that are searched, and the others, 3,000 at most."""
    order = random.permutation(len(points))
    some, others = np.sort(order[:count]), order[count : count + 3000]
    return (points[some], values[some]), (points[others], values[others])


def sheet(path, random):
    """Return matches of two views of a sheet."""
    arrays = np.load(path)
    first, second = random.choice(len(arrays["image_points"]), 2, replace=False)
    seen = arrays["visible"][first].astype(bool) & arrays["visible"][second].astype(bool)
    source, target = (arrays["image_points"][view][seen].astype(float) for view in (first, second))
    return parted(source, target, round(0.8 * len(source)), random)


def plane(path, random):
    """Return the matches that a known homography maps to within three pixels of each other, each place once."""
    arrays = np.load(path)
    source, target = np.split(arrays["tentative"].astype(float), 2, axis=1)
    mapped = np.column_stack([source, np.ones(len(source))]) @ arrays["H_A_to_B"].T
    right = np.hypot(*(mapped[:, :2] / mapped[:, 2:] - target).T) < 3
    _, first = np.unique(source[right].round(1), axis=0, return_index=True)
    first = np.sort(first)
    return parted(source[right][first], target[right][first], round(0.8 * len(first)), random)


def depths(path, random):
    """Return a part of a depth map."""
    cloud = read_cloud(path, 1000, max_data=None)
    return parted(cloud.points, cloud.values, SEEN, random)


def terrain(_, random):
    """Return a part of an elevation map."""
    heights = get_sample_data("jacksboro_fault_dem.npz")["elevation"].astype(float)
    rows, columns = np.indices(heights.shape)
    return parted(
        np.column_stack([columns.ravel(), rows.ravel()]).astype(float), heights.ravel(), SEEN, random
    )


def sources(folder):
    """Yield name, function of a draw, its argument, and what selects."""
    for path in sorted((folder / "sheets").glob("*.npz")):
        if "image_points" in np.load(path):
            yield path.stem, sheet, path, mx.select_warp
    for path in sorted((folder / "flat").glob("boat_matches.npz")):
        yield path.stem.removesuffix("_matches"), plane, path, mx.select_warp
    for path in sorted((folder / "depth").glob("depth_00000.png")):
        yield "PrimeSense depth", depths, path, mx.select_surface
    yield "Jacksboro terrain", terrain, None, mx.select_surface


def planted(points, values, how, share, random):
    """Return the data with wrong ones among them, and which these are: one at least."""
    points, values = points.copy(), values.copy()
    number = max(round(share * len(points)), 2 if how == "swapped values" else 1)
    wrong = np.sort(random.choice(len(points), number, replace=False))
    low, size = points.min(axis=0), np.ptp(points, axis=0)
    if how == "random value":
        values[wrong] = random.uniform(values.min(axis=0), values.max(axis=0), values[wrong].shape)
    elif how == "swapped values":
        mixed = random.permutation(wrong)
        values[mixed] = values[np.roll(mixed, 1)]
    elif how.startswith("value"):
        values[wrong] = float(how.split()[1])
    elif how == "random position":
        points[wrong] = random.uniform(low, low + size, (number, 2))
    elif how == "far position":
        points[wrong] = low + size * random.uniform(3, 6, (number, 2))
    else:
        away = random.normal(size=values[wrong].shape).reshape(number, -1)
        away *= (random.uniform(3, 6, number) * values.std() / np.linalg.norm(away, axis=1))[:, None]
        values[wrong] += away.reshape(values[wrong].shape)
    return points, values, wrong


def error(select, points, values, left_out, unseen):
    """Return the root mean square error at unseen data of the selection without some data."""
    kept = np.setdiff1d(np.arange(len(points)), left_out)
    selection = select(points[kept], values[kept], criteria=[])
    model = selection.warp if select is mx.select_warp else selection.surface
    return float(np.sqrt(np.nanmean((model(unseen[0]) - unseen[1]) ** 2)))


def trial(select, seen, unseen, how, share, random):
    """Plant, search, and return recall, share of false alarms, and the ratio of errors."""
    points, values, wrong = (*seen, np.zeros(0, int)) if how is None else planted(*seen, how, share, random)
    found = select(points, values, criteria=[]).suspects().indices
    hits = len(np.intersect1d(found, wrong))
    errors = [error(select, points, values, out, unseen) for out in (found, wrong)]
    recall = hits / len(wrong) if len(wrong) else math.nan
    return recall, (len(found) - hits) / len(points), errors[0] / errors[1]


def cell(trials):
    """Return recall and median ratio of errors as text, and the mean share of false alarms."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # nothing planted, no recall
        recall, false, _ = np.nanmean(np.array(trials), axis=0)
    ratio = np.median([t[2] for t in trials])
    return f"{recall:.2f}, {ratio:.2f}".replace("nan, ", ""), false


def show(name, how, by_share):
    """Print a line: a cell for each share, and the largest share of false alarms."""
    cells, false = zip(*map(cell, by_share), strict=True)
    cells = [*cells, *[""] * (len(SHARES) - len(cells))]
    print(f"| {name} | {how or 'none'} | {' | '.join(cells)} | {100 * max(false):.1f} % |", flush=True)


def main():
    """Plant, look, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--draws", type=int, default=3)
    options = parser.parse_args()
    warnings.simplefilter("ignore", SuspicionWarning)
    print("| data | wrong | " + " | ".join(f"{100 * share:.0f} %" for share in SHARES) + " | false alarms |")
    print("|---" * (len(SHARES) + 3) + "|")
    for name, draw, path, select in sources(options.data):
        over_kinds = defaultdict(list)
        for seed in range(options.draws):
            seen, unseen = draw(path, np.random.default_rng(seed))
            over_kinds[None, 0.0].append(trial(select, seen, unseen, None, 0.0, None))
            for share in SHARES:
                for number, how in enumerate(HOW):
                    random = np.random.default_rng([seed, number, round(100 * share)])
                    over_kinds[how, share].append(trial(select, seen, unseen, how, share, random))
        for how in (None, *HOW):
            show(name, how, [over_kinds[how, share] for share in (SHARES if how else [0.0])])


if __name__ == "__main__":
    main()
