"""Each note appears with data that cause it, with its numbers, and not with data that do not."""

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.cbook import get_sample_data

import mexpress as mx
from mexpress.leastsquares.model import datum_of_row
from mexpress.selection.notes import failures

SIZE = (640, 480)
DATA = Path(__file__).parents[3] / "shared" / "data"


def matches(n=60, noise=0.3, seed=0):
    rng = np.random.default_rng(seed)
    source = rng.uniform(0, 1, (n, 2)) * SIZE
    target = 0.9 * source + 8 * np.sin(source[:, ::-1] / 120) + rng.normal(0, noise, source.shape)
    return source, target


def depths(n=300, noise=0.02, seed=0, waves=6.0):
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 1, (n, 2))
    return points, np.sin(waves * points[:, 0]) * np.cos(waves * points[:, 1]) + rng.normal(0, noise, n)


def rough(n=400):
    """Terrain: waves that are short beside a tenth of the diagonal, and hardly any noise."""
    return depths(n, noise=0.01, waves=25.0)


def about(selection, words):
    """Return the only note that has these words, or None."""
    found = [note for note in selection.notes if words in note]
    assert len(found) <= 1
    return found[0] if found else None


def numbers_in(note):
    words = (word.strip(",.:;()") for word in note.split())
    return [float(word) for word in words if word.replace(".", "", 1).isdigit()]


@pytest.mark.parametrize("seed", range(3))
def test_clean_data_have_no_notes(seed):
    assert mx.select_warp(*matches(seed=seed), image_size=SIZE).notes == ()
    assert mx.select_surface(*depths(seed=seed)).notes == ()
    source, _ = matches(seed=seed)
    assert mx.select_warp(source, 1.1 * source + 3).notes == ()  # exact, and a plain map


@pytest.mark.parametrize("sheet", ["hulk", "kinectpaper"])
def test_tracked_sheets_have_no_notes(sheet):
    if not DATA.is_dir():
        pytest.skip("there is no folder ('shared', 'data') beside the checkout")
    with np.load(DATA / "sheets" / f"{sheet}.npz") as arrays:
        first, second = arrays["image_points"][[0, 5]]
    assert mx.select_warp(first, second).notes == ()


def test_notes_are_the_same_every_time():
    first, second = (mx.select_surface(*rough(), smoothing=0) for _ in range(2))
    assert first.notes
    assert first.notes == second.notes
    assert first.notes is first.notes


def test_criteria_that_disagree_about_counts():
    selection = mx.select_surface(*rough(), smoothing=0)
    note = about(selection, "ER10 selects")
    other = selection.selected["CMPRESS"]
    assert selection.count < other / 2
    at = selection.counts.tolist().index(selection.count)
    own, best = selection.curves["CMPRESS"][at], selection.curves["CMPRESS"].min()
    assert f"ER10 selects {selection.count} control points, CMPRESS {other}," in note
    assert f"by CMPRESS the error is {own:.3g} instead of {best:.3g}." in note
    assert 'smoothing="auto"' in note
    smooth = mx.select_surface(*depths(waves=2.0), criterion="ER05", smoothing=0)
    assert about(smooth, "selects") is None


def test_terrain_of_the_demo_is_not_passed_over():
    with get_sample_data("jacksboro_fault_dem.npz") as archive:
        elevation = archive["elevation"].astype(float)
    at = np.random.default_rng(0).choice(elevation.size, 1500, replace=False)
    points = np.column_stack(np.unravel_index(at, elevation.shape)[::-1]).astype(float)
    selection = mx.select_surface(points, elevation.ravel()[at], "ER10", ["CMPRESS"], smoothing=0)
    note = about(selection, "ER10 selects")
    assert f"CMPRESS {selection.selected['CMPRESS']}" in note
    assert 'smoothing="auto"' in note
    assert 'criteria=["ER01", "ER05", "ER10"]' in note


def test_criteria_that_disagree_about_weights():
    points, values = rough()
    selection = mx.select_surface(points, values, "ER10", ["CMPRESS"], smoothing="auto")
    note = about(selection, "ER10 selects")
    assert f"ER10 selects {selection.effective_parameters:.0f} effective parameters, CMPRESS" in note
    assert 'criterion="CMPRESS" follows the other' in note
    assert about(mx.select_surface(*rough(), smoothing="auto"), "selects") is None


def test_criteria_without_held_out_data_have_no_say():
    """With few matches AIC selects far more than leave-one-out does, as is known."""
    selection = mx.select_surface(*rough(), "CMPRESS", ["FIT", "PRESS", "AIC", "GCV", "BIC"], smoothing=0)
    assert about(selection, "selects") is None
    assert about(mx.select_surface(*rough(), "FIT", ["ER10"], smoothing=0, max_count=30), "instead") is None


def test_a_model_that_is_too_stiff():
    points, values = rough(2000)
    selection = mx.select_surface(points, values, smoothing=0, max_count=10)
    note = about(selection, "too stiff")
    size, noise = numbers_in(note)
    assert size == pytest.approx(np.median(np.abs(values - selection.surface(points))), rel=0.01)
    assert 0.01 < noise < size / 3
    assert note.endswith('Try smoothing="auto".')
    assert about(mx.select_surface(*rough(), smoothing=0), "too stiff") is None  # neighbours are far apart
    assert about(mx.select_surface(*depths(2000, noise=1.0), smoothing=0, max_count=10), "too stiff") is None


def test_what_looser_means_with_weights():
    points, values = rough(1500)
    capped = mx.select_surface(points, values, "FIT", smoothing=[1e-9, 1e-6], max_count=10)
    assert about(capped, "too stiff").endswith("Try more control points, max_count=N and min_distance=D.")
    loose = mx.select_surface(points, values, "ER20", smoothing="auto")
    assert about(loose, "too stiff").endswith('Try criterion="CMPRESS".')


def test_the_ends_of_counts():
    points, values = rough()
    most = mx.select_surface(points, values, "FIT", smoothing=0, max_count=10)
    assert about(most, "10 control points are selected, the largest number tried").endswith(
        "see max_count=N and min_distance=D."
    )
    source, target = matches()
    most = mx.select_warp(source, target, "FIT", smoothing=0, counts=[3, 5])
    assert about(most, "largest number").endswith("see counts=COUNTS.")
    least = mx.select_warp(source, 1.1 * source + np.random.default_rng(1).normal(size=source.shape), "BIC",
                           smoothing=0, counts=[9, 12])  # fmt: skip
    assert about(least, "9 control points are selected, the smallest number tried")
    every = mx.select_warp(source, target, "FIT", smoothing=0, counts=[3, 60], fractional=False)
    assert about(every, "number tried") is None  # there are no more matches
    one = mx.select_warp(source, target, "FIT", smoothing=0, counts=[5])
    assert about(one, "tried") is None
    plain = mx.select_warp(*matches(noise=50), "BIC", smoothing=0, counts=[3, 4])
    assert plain.count == 3
    assert about(plain, "tried") is None


def test_the_ends_of_weights():
    source, target = matches()
    little = mx.select_warp(source, target, "FIT", smoothing=[3000.0, 1e5], counts=[12, 60])
    assert little.count == 60
    assert about(little, "Smoothing 3e+03 is selected, the smallest tried").endswith("see smoothing=W.")
    noisy = matches(noise=20)
    much = mx.select_warp(*noisy, "CMPRESS", smoothing=[0.01, 0.1], counts=[20])
    assert about(much, "Smoothing 0.1 is selected, the largest tried").endswith("see smoothing=W.")
    plain = mx.select_warp(*noisy, "CMPRESS", smoothing=[0.01, 1e12], counts=[20])
    assert plain.smoothing == 1e12
    assert about(plain, "tried") is None  # a homography is the stiffest warp
    zero = mx.select_warp(source, target, "FIT", smoothing=[0.0, 1.0], counts=[60], fractional=False)
    assert zero.smoothing == 0
    assert about(zero, "tried") is None  # nothing is looser than an interpolant


def test_the_end_of_counts_and_of_weights():
    points, values = depths(500, waves=10.0)
    selection = mx.select_surface(points, values, "FIT", smoothing=[0.01, 10.0], max_count=12)
    note = about(selection, "largest number and the smallest weight")
    assert note.startswith(f"12 control points and smoothing {selection.smoothing:.3g} are selected")
    assert note.endswith("see max_count=N and min_distance=D.")
    assert about(mx.select_surface(points, values), "tried") is None


def folded():
    """Matches of which one is pulled over its neighbours."""
    source, target = matches(200, noise=0.1)
    middle = np.hypot(*(source - [320, 240]).T).argmin()
    target[middle] += [150, 0]
    return source, target


def test_a_warp_that_folds():
    selection = mx.select_warp(*folded(), "FIT", smoothing=0, counts=[100], fractional=False)
    share, _ = failures(selection.warp)
    note = about(selection, "folds over")
    assert f"folds over {100 * share:.2g} % of the region" in note
    assert 'Try smoothing="auto", or robust=True if matches may be wrong.' in note
    assert about(mx.select_warp(*matches()), "folds") is None
    searched = dataclasses.replace(selection, searched=True)
    assert "robust" not in about(searched, "folds over")


def test_a_denominator_that_vanishes():
    rng = np.random.default_rng(0)
    source = rng.uniform(0, 100, (60, 2))
    target = source / (source[:, :1] / 100 - 0.5)  # the horizon crosses the image
    selection = mx.select_warp(source, target, "FIT", smoothing=0, counts=[3])
    share = failures(selection.warp)[1]
    assert share > 0
    note = about(selection, "denominator that vanishes")
    assert f"vanishes over {100 * share:.2g} % of the region" in note
    assert "fractional=False" in note
    assert about(mx.select_warp(*matches()), "vanishes") is None


def with_wrong_matches():
    source, target = matches(150)
    target[[7, 30, 90]] += [[40, -60], [80, 30], [-70, 20]]
    return source, target


def test_data_that_look_wrong():
    source, target = with_wrong_matches()
    selection = mx.select_warp(source, target, smoothing=0, counts=[3, 4])
    sizes = np.hypot(*(target - selection.warp(source)).T)
    note = about(selection, "looks like wrong data")
    assert f"below {np.median(sizes):.3g} pixels, but their RMS is {np.sqrt((sizes**2).mean()):.3g}," in note
    assert f"because of 3 matches unlike their neighbours (largest {sizes.max():.3g})" in note
    assert "robust=True" in note
    assert about(dataclasses.replace(selection, searched=True), "wrong data") is None
    assert about(mx.select_warp(*matches(150), smoothing=0, counts=[3, 4]), "wrong data") is None


def test_wrong_data_that_the_model_follows():
    """The residuals of an automatic spline hardly show them, but studentised ones do."""
    source, target = with_wrong_matches()
    selection = mx.select_warp(source, target)
    assert np.hypot(*(target - selection.warp(source)).T).max() < 2
    fit = selection.least_squares()
    sizes = np.sqrt(np.bincount(datum_of_row(fit), fit.residuals**2 / (1 - fit.leverage)))
    note = about(selection, "looks like wrong data")
    assert f"below {np.median(sizes):.3g} pixels, but their RMS is {np.sqrt((sizes**2).mean()):.3g}," in note
    assert f"largest {sizes.max():.3g}" in note
    assert about(mx.select_warp(*matches(150)), "wrong data") is None


def test_an_edge_is_no_wrong_datum():
    """Depth jumps along a line, where neighbours have large residuals too."""
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 1, (800, 2))
    values = np.where(points[:, 0] > 0.5, 2.0, 1.0) + rng.normal(0, 0.002, 800)
    selection = mx.select_surface(points, values, smoothing=0, max_count=60)
    sizes = np.abs(values - selection.surface(points))
    assert np.sqrt((sizes**2).mean()) > 2 * np.median(sizes)
    assert about(selection, "wrong data") is None


def test_points_outside_of_the_image():
    source, target = matches()
    swapped = source[:, ::-1]
    note = about(mx.select_warp(swapped, target, image_size=SIZE), "outside of the image")
    outside = (swapped[:, 1] > 480 + 6.4).sum()
    assert note.startswith(f"{outside} of 60 source points are outside of the image of 640 x 480 pixels")
    assert f"largest x is {swapped[:, 0].max():.5g}, the largest y {swapped[:, 1].max():.5g}" in note
    thumbnail = about(mx.select_warp(source, target, image_size=(160, 120)), "outside of the image")
    assert f"largest x is {source[:, 0].max():.5g}" in thumbnail
    assert about(mx.select_warp(source, target, image_size=SIZE), "outside") is None
    noisy = source.copy()
    noisy[0] = [641, -1]
    assert about(mx.select_warp(noisy, target, image_size=SIZE), "outside") is None


def on_earth(names, west, east, south, north):
    points, values = depths(60)
    return pd.DataFrame(points * [east - west, north - south] + [west, south], columns=names), values


@pytest.mark.parametrize("names", [("lon", "lat"), ("Longitude [deg]", "Latitude [deg]"), ("LNG", "LAT")])
def test_degrees_are_known_by_the_names_of_columns(names):
    points, values = on_earth(names, 5, 6, 47, 48)
    note = about(mx.select_surface(points, values), "degrees")
    mean = points.to_numpy()[:, 1].mean()
    assert numbers_in(note) == [
        round(mean, 1),
        round(np.cos(np.radians(mean)), 2),
        round(np.cos(np.radians(mean)), 3),
    ]
    # Without names the same numbers may be pixels or metres.
    assert mx.select_surface(points.to_numpy(), values).notes == ()


def test_degrees_of_a_wide_region_are_projected_not_scaled():
    points, values = on_earth(["lon", "lat"], -20, 40, 30, 60)
    note = about(mx.select_surface(points, values), "degrees")
    ratios = np.cos(np.radians(points["lat"]))
    assert f"({ratios.min():.2f} to {ratios.max():.2f} over all points)" in note
    assert "multiplying" not in note


def test_latitude_first_is_a_mirror_image():
    points, values = on_earth(["lon", "lat"], 5, 6, 47, 48)
    turned = mx.select_surface(points[["lat", "lon"]], values)
    assert about(turned, "degrees") == about(mx.select_surface(points, values), "degrees")


@pytest.mark.parametrize(
    ("names", "region"),
    [
        (["x", "y"], (5, 6, 47, 48)),
        (["col", "row"], (0, 90, 0, 90)),
        (["lon", "lat"], (500_000, 501_000, 5_200_000, 5_201_000)),  # projected, and still called so
        (["lon", "lat"], (5, 6, 1, 2)),  # where degrees are as long as each other
        (["lon", "depth"], (5, 6, 47, 48)),
    ],
)
def test_what_is_no_trouble_with_degrees(names, region):
    assert about(mx.select_surface(*on_earth(names, *region)), "degrees") is None


def test_a_radius_beyond_the_data():
    source, target = matches()
    # All matches are in a corner of a large image, whose diagonal is 5,000 pixels.
    size = (4000, 3000)
    selection = mx.select_warp(source, target, "CMPRESS", ["ER10"], smoothing=0, image_size=size)
    note = about(selection, "ER10 holds out all matches within 500")
    extent = np.hypot(*np.ptp(source, axis=0))
    assert f"extend over {extent:.4g}" in note
    assert f"Take ER{100 * extent / 5000 / 10:.2g} or less" in note
    assert about(selection, "has no score") is None  # the same cause is told once
    assert about(mx.select_warp(source, target, "ER10", smoothing=0), "holds out all") is None


def test_criteria_without_a_score():
    rng = np.random.default_rng(0)
    near = rng.uniform(0, 30, (40, 2))
    source = np.vstack([near, near + np.array([600, 440])])
    selection = mx.select_warp(source, 1.1 * source, "CMPRESS", ["ER10"], smoothing=0, counts=range(3, 30))
    note = about(selection, "ER10 has no score")
    first = min(selection.undefined["ER10"])
    assert f"{first}" in note
    lost = ", ".join(map(str, selection.undefined["ER10"][first][:5]))
    assert f"does not determine the warp for match {lost}" in note
    assert about(mx.select_warp(*matches(), smoothing=0, counts=[3, 4]), "no score") is None


def test_open_unknowns_are_no_alarm():
    """Some counts have unknowns that smoothing alone determines, as is normal."""
    source, target = matches(30)
    selection = mx.select_warp(source, target, smoothing="auto")
    assert selection.open
    assert selection.notes == ()


def test_notes_are_of_the_data_that_are_kept():
    source, target = matches()
    far = np.vstack([source, [[5000, 5000]]])
    weights = np.append(np.ones(60), 0.0)
    selection = mx.select_warp(far, np.vstack([target, [[0, 0]]]), image_size=SIZE, weights=weights)
    assert selection.notes == ()
    assert selection.kept.tolist() == list(range(60))
    every = mx.select_warp(far, np.vstack([target, [[4500, 4500]]]), image_size=SIZE)
    assert about(every, "1 of 61 source points")


def test_few_data_say_nothing_of_their_noise():
    source, target = matches(8)
    target[3] += 200
    assert about(mx.select_warp(source, target), "wrong data") is None


def test_gaps_are_why_matched_disagrees():
    """Data along lines are near each other, but far from places between the lines."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(0, 1, 300), rng.integers(0, 6, 300) / 5 + rng.normal(0, 1e-3, 300)])
    values = np.sin(25 * points[:, 0]) * np.cos(25 * points[:, 1])
    selection = mx.select_surface(points, values)
    note = about(selection, "MATCHED selects")
    assert f"MATCHED selects {selection.effective_parameters:.0f} effective parameters, CMPRESS" in note
    assert "or MATCHED judges predictions in gaps that the data leave." in note
    assert 'criterion="CMPRESS" follows the other' in note


def test_constant_data_have_no_notes():
    points = np.random.default_rng(0).uniform(0, 640, (30, 2))
    assert mx.select_surface(points, np.ones(30)).notes == ()
    assert mx.select_surface(points, np.full(30, 1234.5678)).notes == ()
