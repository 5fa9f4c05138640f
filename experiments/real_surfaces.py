"""How far from the truth the surfaces are that criteria select for a depth map or a cloud of one's own.

Usage: ``python experiments/real_surfaces.py FILE [--scale S] [--data N | --all] [--max-count L] [--criteria A,B,...]``;
FILE is what `mexpress.io.clouds.read_cloud` reads. No criterion sees the truth, of which there are two kinds:

near    10,000 of the data, drawn at random, are fitted; the others are all near to some of these. With ``--all`` there
        are no others. If there are fewer data than are wanted, a fifth of them is held out.
holes   12 discs are cut out of the data before any is drawn, of 5 % of the diagonal in radius, around data drawn at
        random and apart from each other. A surface has to bridge them.

Errors and fits are root mean squares in the unit of the values, the norm where a datum has several. There is a line for
each number of control points that some criterion selects or that is in truth best.
"""

import argparse
import resource
import sys
import time
from dataclasses import dataclass

import numpy as np

import mexpress as mx
from mexpress.geometry import diagonal
from mexpress.io.clouds import read_cloud
from mexpress.models.nested_errors import nested_errors

CRITERIA = "FIT,PRESS,CMPRESS,KF10,ER01,ER05,ER10,NN01PCT,NN05PCT,NN10PCT,DELAUNAY,AIC,BIC,GCV"
HOLES = 12
RADIUS = 0.05
SHARE = 0.2
BYTES = 1 if sys.platform == "darwin" else 1024
"""Unit of the peak memory, which differs between systems."""


@dataclass
class Parts:
    """Indices of the data to be fitted and of either kind of truth, which may be empty."""

    fitted: np.ndarray
    near: np.ndarray
    holes: np.ndarray


def in_holes(points, random):
    """Return which points are in discs around some of them."""
    radius = RADIUS * diagonal(points)
    inside = np.zeros(len(points), dtype=bool)
    centres = np.empty((0, 2))
    for centre in points[random.permutation(len(points))]:
        if len(centres) == HOLES:
            break
        if not (np.hypot(*(centres - centre).T) <= 2 * radius).any():
            centres = np.vstack([centres, centre])
            inside |= np.hypot(*(points - centre).T) <= radius
    return inside


def split(points, number, seed):
    """Hold out the holes, then draw the data to be fitted; None takes all that are left."""
    random = np.random.default_rng(seed)
    inside = in_holes(points, random)
    left = np.flatnonzero(~inside)
    if number is None:
        number = len(left)
    elif number >= len(left):
        number = round((1 - SHARE) * len(left))
    mixed = random.permutation(left)
    return Parts(np.sort(mixed[:number]), np.sort(mixed[number:]), np.flatnonzero(inside))


def truth(selection, cloud, unseen):
    """Return the root mean square errors at data that were not fitted, a count each; all NaN if there are none."""
    if not len(unseen):
        return np.full(len(selection.counts), np.nan)
    known = selection.points, selection.values, selection.control_points
    return nested_errors(*known, cloud.points[unseen], cloud.values[unseen])


def show(selection, near, holes):
    """Print the table, and where criteria are undefined."""
    by_count = {}
    for name, count in selection.selected.items():
        by_count.setdefault(count, []).append(name)
    undetermined = by_count.pop(None, [])
    for kind, errors in (("near", near), ("holes", holes)):
        if not np.isnan(errors).all():
            by_count.setdefault(int(selection.counts[np.nanargmin(errors)]), []).append(f"(best: {kind})")
    print(f"{'points':>6}{'fit':>10}{'near':>10}{'holes':>10}  selected by")
    for count, names in sorted(by_count.items()):
        k = int(np.flatnonzero(selection.counts == count)[0])
        numbers = (selection.curves["FIT"][k], near[k], holes[k])
        print(f"{count:6}" + "".join(f"{number:10.4g}" for number in numbers) + f"  {', '.join(names)}")
    for name, by_size in selection.undefined.items():
        k = min(by_size)
        lost = max(len(data) for data in by_size.values())
        print(f"{name} is undefined from {k} control points on, for up to {lost} data")
    if undetermined:
        print(f"nothing is selected by {', '.join(undetermined)}")


def arguments():
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    add = parser.add_argument
    add("file", metavar="FILE", help="depth map or cloud")
    add("--scale", type=float, metavar="S", help="a depth map's units per metre (default: 1000 for images)")
    add(
        "--intrinsics", type=float, nargs=4, metavar=("FX", "FY", "CX", "CY"), help="of the camera, in pixels"
    )
    number = parser.add_mutually_exclusive_group()
    number.add_argument("--data", type=int, default=10_000, metavar="N", help="so many (default: 10000)")
    number.add_argument("--all", action="store_true", help="fit all data outside the holes")
    add("--max-count", type=int, default=175, metavar="N", help="of control points (default: 175)")
    add("--criteria", default=CRITERIA, metavar="A,B,...", help=f"default: {CRITERIA}")
    add("--seed", type=int, default=0, metavar="N", help="of everything random (default: 0)")
    return parser.parse_args()


def run(options):
    """Select surfaces for a part of the data, and judge them by the rest."""
    cloud = read_cloud(options.file, options.scale, options.intrinsics, max_data=None)
    parts = split(cloud.points, None if options.all else options.data, options.seed)
    print(
        f"{cloud}: {len(parts.fitted)} fitted, {len(parts.near)} near, {len(parts.holes)} in holes",
        flush=True,
    )
    data = cloud.points[parts.fitted], cloud.values[parts.fitted]
    start, used = time.perf_counter(), time.process_time()
    selection = mx.select_surface(
        *data,
        "FIT",
        options.criteria.split(","),
        options.max_count,
        seed=options.seed,
        progress=True,
        smoothing=0,
    )
    seconds, used = time.perf_counter() - start, time.process_time() - used
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * BYTES / 2**20
    show(selection, truth(selection, cloud, parts.near), truth(selection, cloud, parts.holes))
    counts = f"{selection.counts[0]} to {selection.counts[-1]} control points"
    print(
        f"{counts}: {seconds:.1f} s, {used:.1f} s of all cores; {memory:.0f} MiB at the peak of the process"
    )


if __name__ == "__main__":
    run(arguments())
