"""A warp between the two images of a stereo pair, and how far it is from the truth.

`make demo` runs it. The motorcycle (Middlebury 2014) comes inside scikit-image's wheel, nothing is downloaded,
and its true disparity is known: a pixel at x of the left image is at x - disparity of the right one. That
judges the warps where no match was found. The scene is not smooth: depth jumps at its edges, where no smooth
warp can be right, so look at the median before the root mean square.
"""

import sys
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from mexpress.cli import main
from mexpress.matches import write_matches
from mexpress.placement import lloyd
from mexpress.warps import fit_warp
from skimage.color import rgb2gray
from skimage.data import stereo_motorcycle
from skimage.feature import SIFT, match_descriptors
from skimage.io import imsave
from skimage.measure import ransac
from skimage.transform import FundamentalMatrixTransform

import mexpress as mx

OUT = Path("demo-output")
CRITERION = "ER10"
COUNTS = (3, 100)
NEAR_A_MATCH = 5.0  # pixels: nearer pixels are not judged


def find_matches(left, right):
    """SIFT, matches that are mutual and unambiguous, and those on the epipolar lines that most agree on."""
    described = []
    for image in (left, right):
        sift = SIFT()
        sift.detect_and_extract(rgb2gray(image))
        described.append(sift)
    first, second = described
    pairs = match_descriptors(first.descriptors, second.descriptors, cross_check=True, max_ratio=0.8)
    # positions, not keypoints, which are rounded to pixels; row and column to x and y
    source, target = first.positions[pairs[:, 0], ::-1], second.positions[pairs[:, 1], ::-1]
    _, good = ransac(
        (source, target),
        FundamentalMatrixTransform,
        min_samples=8,
        residual_threshold=1.0,
        max_trials=2000,
        rng=0,
    )
    # SIFT gives a position several keypoints when it has several orientations
    _, once = np.unique(np.column_stack([source, target])[good].round(2), axis=0, return_index=True)
    once.sort()
    print(f"{len(pairs)} mutual matches, {good.sum()} after RANSAC, {len(once)} distinct")
    return source[good][once], target[good][once]


def pixels_without_match(disparity, source):
    """Every third pixel, in both directions, whose disparity is known, inside the matches but near none."""
    from scipy.spatial import Delaunay, KDTree

    y, x = np.mgrid[: disparity.shape[0] : 3, : disparity.shape[1] : 3]
    points = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    shift = disparity[y.ravel(), x.ravel()].astype(float)
    keep = (
        np.isfinite(shift)
        & (Delaunay(source).find_simplex(points) >= 0)
        & (KDTree(source).query(points)[0] > NEAR_A_MATCH)
    )
    return points[keep], points[keep] - shift[keep, None] * [1, 0]


def report(warps, points, truth):
    """Print the errors of each warp, and plot where they are."""
    print(f"\nError against the true disparity at {len(points)} pixels without a match, in pixels:\n")
    print(f"{'':36}{'median':>8}{'90 %':>8}{'RMS':>8}")
    figure = Figure(figsize=(15, 4.2), layout="constrained", dpi=110)
    for axes, (name, warp) in zip(figure.subplots(1, len(warps)), warps.items(), strict=True):
        errors = np.hypot(*(warp(points) - truth).T)
        median, ninety = np.percentile(errors, [50, 90])
        print(f"{name:36}{median:8.2f}{ninety:8.2f}{np.sqrt((errors**2).mean()):8.2f}")
        dots = axes.scatter(*points.T, c=errors, s=1.2, marker="s", lw=0, cmap="viridis", vmin=0, vmax=20)
        axes.set(aspect="equal", xlim=(0, 741), ylim=(500, 0))
        axes.set_title(f"{name}: median {median:.2f}", loc="left")
    figure.colorbar(dots, ax=figure.axes, label="error (pixels)", extend="max")
    figure.savefig(OUT / "errors.png")


def run():
    """Matches, selection by the command line, and the truth."""
    OUT.mkdir(exist_ok=True)
    left, right, disparity = stereo_motorcycle()
    imsave(OUT / "left.png", left)
    imsave(OUT / "right.png", right)
    source, target = find_matches(left, right)
    write_matches(OUT / "matches.csv", source, target)

    command = ["warp", OUT / "matches.csv", "--source-image", OUT / "left.png", "--target-image", OUT / "right.png"]
    command += ["--criterion", CRITERION, "--criteria", "FIT,PRESS,CMPRESS,ER2,ER5,AIC,BIC"]
    command += ["--counts", f"{COUNTS[0]}:{COUNTS[1]}", "--out", OUT]
    command = [str(word) for word in command]
    print("\n$ mexpress", *command, "\n", flush=True)
    status = main(command)
    if status:
        return status

    selected = mx.load(OUT / "warp.npz")
    warps = {f"{count} control points": fit_warp(source, target, lloyd(source, count)) for count in COUNTS}
    homography, largest = warps.values()
    chosen = {
        "homography": homography,
        f"{len(selected.control_points)} control points, {CRITERION}'s choice": selected,
        f"{COUNTS[1]} control points, FIT's choice": largest,
    }
    report(chosen, *pixels_without_match(disparity, source))
    return 0


if __name__ == "__main__":
    start = time.perf_counter()
    status = run()
    print(f"\n{time.perf_counter() - start:.0f} s; everything is in {OUT}/")
    sys.exit(status)
