"""A warp between the two images of a stereo pair, and how far it is from the truth.

It needs scikit-image and scipy, as `make demo` installs them. The motorcycle (Middlebury 2014) comes inside
scikit-image's wheel, nothing is downloaded, and its true disparity is known: a pixel at x of the left image is
at x - disparity of the right one. That judges the warps where no match was found, which no criterion sees.

The scene is hard on purpose. Depth jumps at its edges, where no smooth warp can be right: the root mean square
cannot be small, the median can. The command line gives the warp that predicts held-out matches best. The method of the
paper, which chooses the number of control points alone, comes second (`smoothing=0`): no radius of exclusion is right
for every scene, and 10 % of the diagonal, 89 pixels, is wider than most of the things in this one, so ER10 finds that
nothing beats a homography.
"""

import sys
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial import Delaunay, KDTree
from skimage.color import rgb2gray
from skimage.data import stereo_motorcycle
from skimage.feature import SIFT, match_descriptors
from skimage.io import imsave
from skimage.measure import ransac
from skimage.transform import FundamentalMatrixTransform

import mexpress as mx
from mexpress.cli import main
from mexpress.io.matches import write_matches

OUT = Path("demo-output/stereo")
CRITERIA = ["FIT", "AIC", "BIC", "PRESS", "CMPRESS", "ER2", "ER5", "ER10"]
STEP = 3  # every third pixel is judged, in both directions
NEAR_A_MATCH = 5.0  # pixels: nearer pixels are not judged


def find_matches(left, right):
    """SIFT, matches that are mutual and unambiguous, and of these what agrees with one epipolar geometry."""
    first, second = SIFT(), SIFT()
    first.detect_and_extract(rgb2gray(left))
    second.detect_and_extract(rgb2gray(right))
    pairs = match_descriptors(first.descriptors, second.descriptors, cross_check=True, max_ratio=0.8)
    # `positions`, not `keypoints`, which are rounded to pixels; (row, column) becomes (x, y).
    source, target = first.positions[pairs[:, 0], ::-1], second.positions[pairs[:, 1], ::-1]
    geometry = {"min_samples": 8, "residual_threshold": 1.0, "max_trials": 2000, "rng": 0}
    _, good = ransac((source, target), FundamentalMatrixTransform, **geometry)
    # A position with several orientations is several keypoints: one match counts once.
    matches = np.unique(np.column_stack([source, target])[good].round(2), axis=0)
    print(f"{len(pairs)} mutual matches of SIFT, {good.sum()} of them after RANSAC, {len(matches)} distinct")
    return matches[:, :2], matches[:, 2:]


def select(source, target, left, right):
    """Write the files that the command line reads, run it, and return the warp that it selected."""
    imsave(OUT / "left.png", left)
    imsave(OUT / "right.png", right)
    write_matches(OUT / "matches.csv", source, target)
    command = ["warp", f"{OUT}/matches.csv", "--out", f"{OUT}"]
    command += ["--source-image", f"{OUT}/left.png", "--target-image", f"{OUT}/right.png"]
    print("\n$ mexpress", *command, "\n", flush=True)
    if main(command):
        sys.exit(2)
    return mx.load(OUT / "warp.npz")


def without_match(disparity, source):
    """Return which pixels to judge: the disparity is known, and they are amid the matches but near none."""
    y, x = np.mgrid[: disparity.shape[0] : STEP, : disparity.shape[1] : STEP]
    points = np.stack([x, y], axis=-1).astype(float)
    amid = Delaunay(source).find_simplex(points) >= 0
    lonely = KDTree(source).query(points)[0] > NEAR_A_MATCH
    shift = disparity[::STEP, ::STEP].astype(float)
    judged = np.isfinite(shift) & amid & lonely
    return points, np.stack([x - shift, y], axis=-1), judged


def errors_of(warp, points, truth, judged):
    """Return the distances in pixels to the true positions, (h, w), NaN where not judged."""
    errors = np.full(judged.shape, np.nan)
    errors[judged] = np.hypot(*(warp(points[judged]) - truth[judged]).T)
    return errors


def print_errors(errors, judged, vanishing):
    """Print a line for each warp."""
    print(f"\nError against the true disparity at {judged.sum()} pixels without a match, in pixels")
    print("(vanishes: share of them where the denominator does, so that the warp flies off)\n")
    print(f"{'median':>9}{'90 %':>9}{'RMS':>10}{'vanishes':>11}  warp")
    for name, values in errors.items():
        median, ninety = np.nanpercentile(values, [50, 90])
        rms = np.sqrt(np.nanmean(values**2))
        share = f"{100 * vanishing[name]:.1f} %"
        print(f"{median:9.2f}{ninety:9.2f}{rms:10.2f}{share:>11}  {name}")


def draw_errors(errors, shape):
    """Plot where the errors are."""
    figure = Figure(figsize=(15, 3.7), layout="constrained", dpi=110)
    panels = figure.subplots(1, len(errors), sharey=True)
    for axes, (name, values) in zip(panels, errors.items(), strict=True):
        extent = (-0.5, shape[1] - 0.5, shape[0] - 0.5, -0.5)
        drawn = axes.imshow(values, extent=extent, vmin=0, vmax=20, interpolation="nearest")
        axes.set_facecolor("0.85")
        axes.set_title(f"{name}: median {np.nanmedian(values):.1f} pixels", loc="left")
    panels[1].set_xlabel(
        "gray: not judged, for there is a match, or the truth is not known, or no match around"
    )
    figure.colorbar(drawn, ax=panels, label="error (pixels)", extend="max", aspect=30, pad=0.01)
    figure.savefig(OUT / "errors.png")


def run():
    """Find matches, select a warp, judge it by the truth, and compare it with the method of the paper."""
    OUT.mkdir(parents=True, exist_ok=True)
    left, right, disparity = stereo_motorcycle()
    source, target = find_matches(left, right)
    selected = select(source, target, left, right)

    size = left.shape[1::-1]
    paper = mx.select_warp(source, target, "ER10", CRITERIA, smoothing=0, image_size=size, progress=True)
    warps = {'smoothing="auto"': selected}
    for count in sorted(set(paper.selected.values())):
        by = ", ".join(name for name, chosen in paper.selected.items() if chosen == count)
        warps[f"{count} control points ({by})" if count > 3 else f"a homography ({by})"] = paper.warps[count]
    points, truth, judged = without_match(disparity, source)
    errors = {name: errors_of(warp, points, truth, judged) for name, warp in warps.items()}
    print_errors(errors, judged, {name: warp.vanishes(points[judged]).mean() for name, warp in warps.items()})
    shown = {
        'smoothing="auto"': errors['smoothing="auto"'],
        f"smoothing=0, ER5: {paper.selected['ER5']} points": errors_of(
            paper.warps[paper.selected["ER5"]], points, truth, judged
        ),
        f"FIT: {paper.selected['FIT']} points": errors_of(
            paper.warps[paper.selected["FIT"]], points, truth, judged
        ),
    }
    draw_errors(shown, disparity.shape)


if __name__ == "__main__":
    start = time.perf_counter()
    run()
    print(f"\n{OUT}: also errors.png, matches.csv; {time.perf_counter() - start:.0f} s in all")
