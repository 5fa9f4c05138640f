"""A page that was photographed bent is flattened, and how far that is from the truth.

`make demo` runs it. The page, its photo and 200 noisy matches between both come from `mx.datasets.bent_page()`, which
simulates them, so that the true warp is known. It judges the warps all over the page, also where there is no match:
no criterion sees that.

A homography, all that a flat page would need, is far off. The more control points a thin-plate spline has, the
better it fits the matches, and in the end it flies off between them: the error of the fit cannot choose. Cross-
validation can. The method of the paper chooses the number of control points, by predictions with all matches
within 10 % of the diagonal held out. The command line gives the warp that predicts held-out matches best, with
a weight of the bending energy.

`examples/demo_warp.py --picture docs/bent-page.jpg` draws the picture of README alone.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.image import imsave

import mexpress as mx
from mexpress.cli import main
from mexpress.io.matches import write_matches

OUT = Path("demo-output/page")
CRITERIA = ["FIT", "AIC", "BIC", "CMPRESS", "ER5", "ER10", "ER20"]
FITTED, CHOSEN, TRUE = "#777777", "#D55E00", "#000000"


def select_by_command(bent):
    """Write the files that the command line reads, run it, and return the warp that it selected."""
    OUT.mkdir(parents=True, exist_ok=True)
    imsave(OUT / "page.png", bent.page)
    imsave(OUT / "photo.png", bent.photo)
    write_matches(OUT / "matches.csv", bent.source, bent.target)
    command = ["warp", f"{OUT}/matches.csv", "--out", f"{OUT}"]
    command += ["--source-image", f"{OUT}/page.png", "--target-image", f"{OUT}/photo.png"]
    print("\n$ mexpress", *command, "\n", flush=True)
    if main(command):
        sys.exit(2)
    return mx.load(OUT / "warp.npz")


def errors(warp, bent):
    """Return how far from the truth a warp puts the lattice, in pixels of the photo; NaN where it vanishes."""
    return np.hypot(*(warp(bent.dense_source) - bent.dense_target).T)


def print_errors(warps, bent):
    """Print a line for each warp."""
    print(
        f"\nError against the truth at {len(bent.dense_source)} places all over the page, in pixels of the photo"
    )
    print("(vanishes: share of them where the denominator does, so that the warp flies off)\n")
    print(f"{'median':>9}{'90 %':>9}{'largest':>10}{'vanishes':>11}  warp")
    for name, warp in warps.items():
        known = errors(warp, bent)
        median, ninety, largest = np.nanpercentile(known, [50, 90, 100])
        share = f"{100 * warp.vanishes(bent.dense_source).mean():.1f} %"
        print(f"{median:9.2f}{ninety:9.2f}{largest:10.1f}{share:>11}  {name}")


def draw_matches(axes, bent):
    """Show the photo, and where matches are in it."""
    axes.imshow(bent.photo)
    axes.plot(*bent.target.T, "o", ms=4, mfc="#F0E442", mec="black", mew=0.5)
    axes.set_title(f"A photo of a bent page, and {len(bent.source)} matches", loc="left")
    axes.axis("off")


def draw_counts(axes, paper, bent):
    """Plot the error of the fit, of predictions, and the true one against the number of control points."""
    true = np.array([np.median(errors(paper.warps[count], bent)) for count in paper.counts])
    lines = [
        ("error of the fit", paper.curves["FIT"], FITTED, (36, 0.45)),
        ("true error (median)", true, TRUE, (62, 3.3)),
        ("error of predictions", paper.curves["ER10"], CHOSEN, (58, 45)),
    ]
    for label, curve, colour, place in lines:
        axes.semilogy(paper.counts, curve, color=colour, lw=1.8)
        axes.text(*place, label, color=colour)
    axes.plot(paper.count, paper.curves["ER10"][paper.counts == paper.count], "o", color=CHOSEN, ms=8)
    axes.axvline(paper.count, color=CHOSEN, lw=1, alpha=0.5)
    axes.set(xlim=(0, 102), ylim=(0.08, 100), xlabel="number of control points", ylabel="pixels of the photo")
    axes.set_title(f"The fit wants all of them; ER10 selects {paper.count}", loc="left")
    axes.grid(alpha=0.25)


def draw_flat(axes, warp, bent, title):
    """Show the photo as a warp flattens it."""
    axes.imshow(warp.remap(bent.photo, bent.image_size, inverse=True))
    axes.set_title(title, loc="left")
    axes.axis("off")


def draw_picture(path, bent, selected, paper):
    """Draw the photo, two plots that tell how complex the warp should be, and three warps that flatten it."""
    figure = Figure(figsize=(14.5, 7.1), layout="constrained", dpi=110)
    figure.get_layout_engine().set(w_pad=0.08, h_pad=0.08)
    above, below = figure.subplots(2, 3, height_ratios=[1, 1.25])
    draw_matches(above[0], bent)
    draw_counts(above[1], paper, bent)
    selected.plot_radii(ax=above[2])
    above[2].set_ylabel("pixels of the photo")
    most = paper.selected["FIT"]
    flat = {
        f"A homography: {np.median(errors(paper.warps[3], bent)):.1f} pixels off": paper.warps[3],
        f"{most} control points, the best fit: it flies off": paper.warps[most],
        f"What mexpress selects: {np.median(errors(selected.warp, bent)):.1f} pixels off": selected.warp,
    }
    for axes, (title, warp) in zip(below, flat.items(), strict=True):
        draw_flat(axes, warp, bent, title)
    figure.savefig(path, pil_kwargs={"quality": 85} if path.suffix == ".jpg" else None)


def select(bent):
    """Return what mexpress selects, and what the method of the paper does, with all of its models."""
    data = {"source": bent.source, "target": bent.target, "image_size": bent.image_size}
    return mx.select_warp(**data), mx.select_warp(**data, criterion="ER10", criteria=CRITERIA, smoothing=0)


def run():
    """Select a warp, judge it by the truth, compare it with others, and show what they do."""
    bent = mx.datasets.bent_page()
    warps = {'smoothing="auto"': select_by_command(bent)}
    selected, paper = select(bent)
    for count in sorted(set(paper.selected.values()) | {3}):
        by = ", ".join(name for name, chosen in paper.selected.items() if chosen == count)
        warps[f"{count} control points ({by})" if count > 3 else "a homography"] = paper.warps[count]
    print_errors(warps, bent)
    paper.plot(OUT / "counts.png")
    selected.plot_radii(OUT / "radii.png")
    draw_picture(OUT / "flattened.png", bent, selected, paper)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw the picture of README alone")
    chosen = parser.parse_args()
    if chosen.picture:
        page = mx.datasets.bent_page()
        draw_picture(chosen.picture, page, *select(page))
    else:
        start = time.perf_counter()
        run()
        print(
            f"\n{OUT}: also counts.png, radii.png, flattened.png; {time.perf_counter() - start:.0f} s in all"
        )
