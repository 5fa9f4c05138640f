"""A surface for a piece of terrain, and how far it is from the truth where no datum was used.

`make demo` runs it. The elevations around the Jacksboro fault in Tennessee, 344 x 403 of them, come inside
matplotlib's wheel, nothing is downloaded. 10,000 of them, drawn at random, are the data; the others are the
truth that no criterion sees.

The command line gives the surface that predicts held-out elevations best: nearly as many control points as it may
have, and a weight of the bending energy. The method of the paper, which chooses the number of control points alone,
comes second (`smoothing=0`). The terrain is rough, so more control points are better. Criteria that hold out little
besides the datum see that; local exclusion with a large radius asks how well a surface predicts far from all data, 2
or 4 km for ER5 and ER10, and prefers one that is much too smooth for here. A note says so.
"""

import sys
import time
from pathlib import Path

import numpy as np
from matplotlib.cbook import get_sample_data
from matplotlib.figure import Figure

import mexpress as mx
from mexpress.cli import main
from mexpress.io.clouds import read_cloud
from mexpress.models.nested_errors import nested_errors

OUT = Path("demo-output/surface")
CRITERIA = ["FIT", "PRESS", "CMPRESS", "ER1", "ER5", "ER10", "NN1PCT", "NN5PCT", "NN10PCT", "AIC", "BIC"]
KM_PER_DEGREE = 111.2
UNITLESS = {"AIC", "BIC"}


def read_elevations():
    """Return the positions in km, east and north of the map's corner, and the elevations in m."""
    with get_sample_data("jacksboro_fault_dem.npz") as archive:
        terrain = {name: archive[name] for name in archive.files}
    elevation = terrain["elevation"].astype(float)
    row, column = np.mgrid[: elevation.shape[0], : elevation.shape[1]]
    middle = np.radians((terrain["ymin"] + terrain["ymax"]) / 2)
    east = column * terrain["dx"] * np.cos(middle) * KM_PER_DEGREE
    north = (elevation.shape[0] - 1 - row) * terrain["dy"] * KM_PER_DEGREE
    return np.column_stack([east.ravel(), north.ravel()]), elevation.ravel()


def select(points, elevation):
    """Write the file that the command line reads, run it, and return the surface that it selected."""
    np.savez(OUT / "jacksboro.npz", points=points, values=elevation)
    command = ["surface", f"{OUT}/jacksboro.npz", "--unit", "m", "--out", f"{OUT}"]
    print("\n$ mexpress", *command, "\n", flush=True)
    if main(command):
        sys.exit(2)
    return mx.load(OUT / "surface.npz")


def print_errors(surface, error, paper, errors):
    """Print a line for the surface of the command line, and for what each criterion selects in the paper's method."""
    print(f"{'smoothing':>9}  {'criterion':<10}{'points':>7}{'its score':>11}{'true RMS':>10}")
    count = len(surface.control_points)
    print(f"{'auto':>9}  {'MATCHED':<10}{count:7}{'':11}{error:10.2f}")
    for name, count in paper.selected.items():
        score = "" if name in UNITLESS else f"{paper.curves[name][count - 3]:.2f}"
        print(f"{'0':>9}  {name:<10}{count:7}{score:>11}{errors[count - 3]:10.2f}")
    print(f"{'0':>9}  {'(the best)':<10}{3 + errors.argmin():7}{'':11}{errors.min():10.2f}")


def draw_errors(error, paper, errors):
    """Plot the true error against the number of control points, what the criteria select, and what smoothing does."""
    figure = Figure(figsize=(8, 4.5), layout="constrained", dpi=110)
    axes = figure.subplots()
    axes.axhline(error, color="#0072B2", label='smoothing="auto"')
    axes.plot(paper.counts, errors, color="black", label="smoothing=0")
    by_count = {}
    for name, count in paper.selected.items():
        by_count.setdefault(count, []).append(name)
    # There is room above the curve; on its right, where it is level, names stand one above the other.
    height = errors[paper.counts > paper.counts[-1] / 2].max()
    for count, names in sorted(by_count.items()):
        place, right = (count, errors[count - 3]), count > paper.counts[-1] / 2
        axes.plot(*place, "o", color="#D55E00", zorder=3)
        line = {"arrowstyle": "-", "color": "#D55E00", "shrinkA": 0, "relpos": (float(right), 0)}
        beside = {"ha": "right" if right else "left", "va": "bottom", "arrowprops": line}
        axes.annotate(
            f"{count}: {', '.join(names)}", place, (count, height if right else place[1] + 6), **beside
        )
        height += 7 * right
    axes.margins(0.05, 0.12)
    axes.set(xlabel="number of control points", ylabel="RMS error at the elevations not used (m)")
    axes.set_title("the truth, and what every criterion selects", loc="left")
    axes.grid(alpha=0.25)
    axes.legend(frameon=False)
    figure.savefig(OUT / "truth.png")


def run():
    """Select a surface, judge it by the truth, and compare it with the method of the paper."""
    OUT.mkdir(parents=True, exist_ok=True)
    points, elevation = read_elevations()
    surface = select(points, elevation)
    cloud = read_cloud(OUT / "jacksboro.npz")  # the same draw as the command's
    unseen = ~np.isin(points @ [1, 1j], cloud.points @ [1, 1j])
    error = np.sqrt(((surface(points[unseen]) - elevation[unseen]) ** 2).mean())
    paper = mx.select_surface(cloud.points, cloud.values, "ER10", CRITERIA, smoothing=0, progress=True)
    data = cloud.points, cloud.values, paper.control_points
    errors = nested_errors(*data, points[unseen], elevation[unseen])
    print(f"\nRoot mean square error at the {unseen.sum()} elevations that were not used, in m\n")
    print_errors(surface, error, paper, errors)
    print(*("", *paper.notes), sep="\n")
    draw_errors(error, paper, errors)


if __name__ == "__main__":
    start = time.perf_counter()
    run()
    print(f"\n{OUT}: also truth.png, jacksboro.npz; {time.perf_counter() - start:.0f} s in all")
