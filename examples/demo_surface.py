"""A surface for a piece of terrain, and how far it is from the truth where no datum was used.

`make demo` runs it. The elevations around the Jacksboro fault in Tennessee, 344 x 403 of them, come inside
matplotlib's wheel, nothing is downloaded. 10,000 of them, drawn at random, are the data; the others are the
truth that no criterion sees.

Every elevation that was not used has data nearby, and the terrain is rough, so more control points are better.
Criteria that hold out nothing or little besides the datum see that. Local exclusion with a large radius asks how
well a surface predicts far from all data, 2 or 4 km for ER5 and ER10, and prefers one that is much too smooth
for here. No radius is right for every use. ER1 is used; that choice was made with the truth in view, so it proves
nothing about ER1: the last table shows what every criterion would have given.
"""

import json
import sys
import time
from pathlib import Path

import numpy as np
from matplotlib.cbook import get_sample_data
from matplotlib.figure import Figure

from mexpress.cli import main
from mexpress.io.clouds import read_cloud
from mexpress.models.nested_errors import nested_errors

OUT = Path("demo-output/surface")
CRITERION = "ER1"
OTHERS = "FIT,PRESS,CMPRESS,ER5,ER10,NN1PCT,NN5PCT,NN10PCT,AIC,BIC"
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
    """Write the file that the command line reads, run it, and return what it selected and where."""
    np.savez(OUT / "jacksboro.npz", points=points, values=elevation)
    command = ["surface", f"{OUT}/jacksboro.npz", "--criterion", CRITERION, "--criteria", OTHERS]
    command += ["--unit", "m", "--out", f"{OUT}"]
    print("\n$ mexpress", *command, "\n", flush=True)
    if main(command):
        sys.exit(2)
    said = json.loads((OUT / "selection.json").read_text())
    return said, np.array(said["control_points"])


def print_errors(said, errors, unseen):
    """Print a line for each criterion."""
    print(f"\nRoot mean square error at the {unseen} elevations that were not used, in m\n")
    print(f"{'criterion':>9}{'points':>8}{'its score':>11}{'true RMS':>10}")
    for name, count in said["selected"].items():
        score = "" if name in UNITLESS else f"{said['curves'][name][count - 3]:.2f}"
        print(f"{name:>9}{count:8}{score:>11}{errors[count - 3]:10.2f}")
    print(f"{'the best':>9}{3 + errors.argmin():8}{'':11}{errors.min():10.2f}")


def draw_errors(said, errors):
    """Plot the true error against the number of control points, and what the criteria select."""
    figure = Figure(figsize=(8, 4.5), layout="constrained", dpi=110)
    axes = figure.subplots()
    axes.plot(said["counts"], errors, color="black")
    by_count = {}
    for name, count in said["selected"].items():
        by_count.setdefault(count, []).append(name)
    for count, names in by_count.items():
        axes.plot(count, errors[count - 3], "o", color="#D55E00")
        last = count > said["counts"][-1] / 2  # where there is room: above on the left, below on the right
        beside = {"ha": "right", "va": "top"} if last else {"ha": "left", "va": "bottom"}
        offset = (4, -8) if last else (6, 3)
        place = count, errors[count - 3]
        axes.annotate(", ".join(names), place, offset, textcoords="offset points", **beside)
    axes.margins(0.05, 0.12)
    axes.set(xlabel="number of control points", ylabel="RMS error at the elevations not used (m)")
    axes.set_title("the truth, and what every criterion selects", loc="left")
    axes.grid(alpha=0.25)
    figure.savefig(OUT / "truth.png")


def run():
    """Select a surface, and judge it by the truth."""
    OUT.mkdir(parents=True, exist_ok=True)
    points, elevation = read_elevations()
    said, control_points = select(points, elevation)
    cloud = read_cloud(OUT / "jacksboro.npz")  # the same draw as the command's
    unseen = ~np.isin(points @ [1, 1j], cloud.points @ [1, 1j])
    data = cloud.points, cloud.values
    errors = nested_errors(*data, control_points, points[unseen], elevation[unseen])
    print_errors(said, errors, unseen.sum())
    draw_errors(said, errors)


if __name__ == "__main__":
    start = time.perf_counter()
    run()
    print(f"\n{OUT}: also truth.png, jacksboro.npz; {time.perf_counter() - start:.0f} s in all")
