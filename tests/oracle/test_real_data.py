"""Real matches, a real homography and real surfaces; the folder is not part of the project, so these tests may skip."""

import xml.etree.ElementTree as ET
from pathlib import Path

import cv2
import numpy as np
import pytest
from designs import nested_surface_design

import mexpress as mx
from mexpress.io.clouds import read_cloud

DATA = Path(__file__).parents[3] / "shared" / "data"
FLAT = DATA / "flat"

pytestmark = pytest.mark.skipif(
    not DATA.is_dir(), reason=f"there is no folder {DATA.parts[-2:]} beside the checkout"
)

GRAF = (800, 640)


def graf_matches(seed, n=100):
    """Points of the first graffiti image that the third one shows, with 1 px of noise in either."""
    numbers = ET.parse(FLAT / "H1to3p.xml").find("H13/data").text.split()
    H = np.array(numbers, dtype=float).reshape(1, 3, 3)[0]
    rng = np.random.default_rng(seed)
    source = np.zeros((0, 2))
    while len(source) < n:
        more = rng.uniform(0, 1, (n, 2)) * GRAF
        seen = cv2.perspectiveTransform(more[None], H)[0]
        source = np.vstack([source, more[((seen >= 0) & (seen < GRAF)).all(axis=1)]])[:n]
    target = cv2.perspectiveTransform(source[None], H)[0]
    return source + rng.normal(size=(n, 2)), target + rng.normal(size=(n, 2))


def test_a_flat_scene_under_perspective_takes_three_or_four_control_points():
    chosen = [
        mx.select_warp(*graf_matches(seed), "ER10", counts=range(3, 21), image_size=GRAF, smoothing=0).count
        for seed in range(30)
    ]
    print("control points chosen:", dict(zip(*np.unique(chosen, return_counts=True), strict=True)))
    assert sum(count in (3, 4) for count in chosen) >= 27


@pytest.mark.parametrize("seed", [0, 1])
def test_a_flat_scene_with_all_counts_that_are_tried_by_default(seed):
    selection = mx.select_warp(*graf_matches(seed), "ER10", image_size=GRAF, smoothing=0)
    assert selection.counts.tolist() == list(range(3, 51))
    assert selection.count in (3, 4)
    assert selection.selected["FIT"] > 20


def test_without_perspective_the_flat_scene_takes_more():
    source, target = graf_matches(0)
    fractional, plain = (
        mx.select_warp(
            source, target, "ER10", counts=range(3, 21), image_size=GRAF, fractional=form, smoothing=0
        )
        for form in (True, False)
    )
    assert plain.count > fractional.count
    assert np.nanmin(plain.curves["ER10"]) > np.nanmin(fractional.curves["ER10"])


@pytest.mark.parametrize("method", ["RANSAC", "USAC_MAGSAC"])
@pytest.mark.parametrize("name", ["adam", "boat"])
def test_hand_marked_points_transfer_as_well_as_by_a_homography(name, method):
    arrays = np.load(FLAT / f"{name}_matches.npz")
    tentative, validation = arrays["tentative"], arrays["validation"]
    cv2.setRNGSeed(0)
    H, mask = cv2.findHomography(tentative[:, :2], tentative[:, 2:], getattr(cv2, method), 3.0)
    inliers = tentative[mask.ravel().astype(bool)]
    source, target = inliers[:, :2], inliers[:, 2:]
    height, width = cv2.imread(str(FLAT / f"{name}A.png")).shape[:2]
    selection = mx.select_warp(source, target, "ER10", image_size=(width, height), smoothing=0)
    ours = np.linalg.norm(selection.warp(validation[:, :2]) - validation[:, 2:], axis=1)
    mapped = cv2.perspectiveTransform(validation[None, :, :2], H)[0]
    theirs = np.linalg.norm(mapped - validation[:, 2:], axis=1)
    rms = [float(np.sqrt((e**2).mean())) for e in (ours, theirs)]
    print(f"{name} {method}: {len(inliers)} inliers, {selection.count} control points,", end=" ")
    print(
        f"rms {rms[0]:.2f} px, homography {rms[1]:.2f} px; medians {np.median(ours):.2f}, {np.median(theirs):.2f}"
    )
    assert rms[0] < 1.5 * rms[1]
    assert not selection.warp.folds(validation[:, :2]).any()


@pytest.mark.parametrize(
    ("file", "scale", "n_valid"),
    [
        ("depth/TUM_depth.png", 5000, 248250),
        ("depth/depth_00000.png", 1000, 267129),
        ("sheets/bent_paper_239.npz", None, 239),
    ],
)
def test_surfaces_of_real_data(file, scale, n_valid):
    cloud = read_cloud(DATA / file, scale, max_data=2000)
    assert (len(cloud.points), cloud.n_valid) == (min(n_valid, 2000), n_valid)
    criteria = ["FIT", "PRESS", "CMPRESS", "ER05", "AIC", "BIC", "GCV"]
    selection = mx.select_surface(cloud.points, cloud.values, "ER05", criteria, max_count=40, smoothing=0)
    print(f"{file}: {selection.selected}")
    assert selection.counts.tolist() == list(range(3, 41))
    assert not selection.undefined
    assert all(np.isfinite(curve).all() for curve in selection.curves.values())
    fit, press = selection.curves["FIT"], selection.curves["PRESS"]
    assert (np.diff(fit) <= 1e-9 * fit[0]).all()
    assert (press > fit).all()
    np.testing.assert_allclose(selection.curves["CMPRESS"], press, rtol=1e-9)  # one row to a datum
    design = nested_surface_design(cloud.points, cloud.values, selection.control_points)
    radius = 0.05 * np.hypot(*np.ptp(cloud.points, axis=0))
    scheme = mx.schemes.exclusion_radius(cloud.points, radius)
    for count in (3, 20, 40):
        plain = mx.LeastSquares(design.A[:, :count], design.b).cross_validate(scheme)
        np.testing.assert_allclose(selection.curves["ER05"][count - 3], plain.score, rtol=1e-8)
