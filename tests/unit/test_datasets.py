from itertools import pairwise
from math import inf, nan

import numpy as np
import pytest
from inputs import refused
from scipy.optimize import least_squares

import mexpress as mx
from mexpress.datasets import bent_page, photography, printing, terrain
from mexpress.resampling import resampled


def distances(warp, page):
    return np.hypot(*(warp(page.dense_source) - page.dense_target).T)


def rms(values):
    return np.sqrt((values**2).mean())


def gray(image):
    return image.mean(axis=-1)


def test_the_same_arguments_give_the_same_page():
    first, again, other = bent_page(seed=3), bent_page(seed=3), bent_page(seed=4)
    for name in ("source", "target", "wrong", "dense_source", "dense_target", "page", "photo"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert not np.array_equal(first.source, other.source)
    np.testing.assert_array_equal(first.dense_target, other.dense_target)
    assert not first.page.flags.writeable
    assert not first.photo.flags.writeable


def test_noise_is_of_the_size_that_was_asked_for():
    exact, noisy = bent_page(2000, noise=0), bent_page(2000, noise=3)
    np.testing.assert_array_equal(exact.source, noisy.source)
    assert (noisy.target - exact.target).std() == pytest.approx(3, rel=0.05)
    np.testing.assert_array_equal(exact.target, photography.photographed(exact.source))


@pytest.mark.parametrize("outliers", [0, 1, 40, 100])
def test_as_many_matches_are_wrong_as_were_asked_for(outliers):
    page = bent_page(100, noise=0, outliers=outliers)
    moved = (page.target != photography.photographed(page.source)).any(axis=1)
    np.testing.assert_array_equal(moved, page.wrong)
    assert page.wrong.sum() == outliers


def test_matches_are_where_there_is_print():
    page = bent_page(500)
    assert (page.source >= -0.5).all()
    assert (page.source <= np.array(page.image_size) - 0.5).all()
    x, y = np.rint(page.source).astype(int).T
    near = np.stack([gray(page.page)[y + v, x + u] for u in (-2, 0, 2) for v in (-2, 0, 2)])
    assert (np.ptp(near, axis=0) > 1).all()


def test_the_photo_shows_the_page_where_the_truth_says():
    page = bent_page(1, noise=0)
    x, y = np.meshgrid(np.arange(66.0, 1126, 3), np.arange(60.0, 780, 3))
    places = np.column_stack([x.ravel(), y.ravel()])
    printed, flat, shifted = (
        gray(resampled(image, where.T.reshape(2, *x.shape), 0))
        for image, where in (
            (page.page, places),
            (page.photo, photography.photographed(places)),
            (page.photo, photography.photographed(places + np.array([2, 0]))),
        )
    )
    # The light varies slowly: squares of 60 pixels are compared, those with print.
    squares = [
        (slice(top, top + 20), slice(left, left + 20))
        for top in range(0, 240, 20)
        for left in range(0, 340, 20)
    ]
    squares = [square for square in squares if printed[square].std() > 20]
    right, wrong = (
        np.array([np.corrcoef(printed[square].ravel(), image[square].ravel())[0, 1] for square in squares])
        for image in (flat, shifted)
    )
    assert len(squares) > 60
    assert right.min() > 0.75
    assert np.median(right) > 0.95
    assert np.mean(right > wrong) > 0.9


def test_what_is_seen_is_where_it_is_photographed():
    dense = bent_page(1).dense_source
    seen, normals = photography.seen(photography.photographed(dense))
    np.testing.assert_allclose(seen, dense, atol=1e-9)
    sheet, camera = photography.bent()
    where = photography.on_sheet(dense)
    np.testing.assert_array_equal(normals, sheet.normals(where))
    # The whole page is seen from its front.
    assert (normals * camera.rays(sheet(where))).sum(axis=1).min() > 0.2


def test_a_camera_of_its_own_sees_the_same():
    # A pinhole camera written out anew, fitted to the positions in space: what is left is rounding.
    sheet, _ = photography.bent()
    page = bent_page(1)
    space = sheet(photography.on_sheet(page.dense_source))[::97]
    seen = page.dense_target[::97]

    def misses(unknown):
        x, y, z = (np.column_stack([space, np.ones(len(space))]) @ unknown.reshape(4, 3)).T
        return (np.column_stack([x / z, y / z]) - seen).ravel()

    start = np.zeros((4, 3))
    start[0, 0] = start[1, 1] = 500
    start[3] = 600, 350, 1
    found = least_squares(misses, start.ravel(), x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert np.abs(found.fun).max() < 1e-6


def test_no_homography_but_a_selected_warp_flattens_it():
    page = bent_page()
    size = {"image_size": page.image_size}
    auto = mx.select_warp(page.source, page.target, **size)
    paper = mx.select_warp(page.source, page.target, smoothing=0, **size)
    assert rms(distances(paper.warps[3], page)) > 25
    assert rms(distances(paper.warp, page)) < 4
    assert rms(distances(auto.warp, page)) < 2.5


def test_wrong_matches_are_found():
    page = bent_page(outliers=40)
    sel = mx.select_warp(page.source, page.target, robust=True)
    assert set(page.wrong.nonzero()[0]) <= set(sel.left_out)
    assert len(sel.left_out) <= 42
    assert rms(distances(sel.warp, page)) < 3


def test_all_letters_of_the_page_are_in_the_font():
    assert set(printing.TITLE + printing.TEXT) == printing.FONT.keys()
    assert all(len(bytes.fromhex(letter)) == 5 for letter in printing.FONT.values())


def test_lines_of_text_are_whole_words_that_fit():
    lines = printing.wrapped(printing.TEXT, 41)
    assert " ".join(lines) == printing.TEXT
    assert max(map(len, lines)) <= 41
    assert all(len(a) + 1 + len(b.split()[0]) > 41 for a, b in pairwise(lines))


def test_a_shadow_is_the_mean_of_what_covers():
    inside = np.zeros((90, 120), np.float32)
    inside[30:50, 40:70] = 1
    dark = photography.shadow(inside, reach=8)
    assert dark.shape == inside.shape
    assert dark.sum() == pytest.approx(inside.sum(), rel=1e-4)
    y, x = (np.average(place, weights=dark) for place in np.indices(dark.shape))
    # Half of the reach to the right and down.
    assert (x, y) == pytest.approx((54.5 + 4, 39.5 + 4), abs=1.01)


def test_land_is_measured_on_its_lattice():
    land = terrain(16641, noise=0)
    order = np.lexsort((land.points[:, 0], land.points[:, 1]))
    np.testing.assert_array_equal(land.points[order], land.dense_points)
    np.testing.assert_array_equal(land.values[order], land.dense_values)
    assert land.dense_values.std() == pytest.approx(60)
    assert land.dense_values.mean() == pytest.approx(0, abs=1e-9)
    np.testing.assert_array_equal(np.unique(land.dense_points[:, 0]), 10.0 * np.arange(129))


def test_land_has_noise_and_a_seed():
    exact, noisy = terrain(5000, noise=0, seed=1), terrain(5000, noise=4, seed=1)
    assert (noisy.values - exact.values).std() == pytest.approx(4, rel=0.05)
    np.testing.assert_array_equal(noisy.values, terrain(5000, noise=4, seed=1).values)
    assert not np.array_equal(exact.dense_values, terrain(5000, seed=2).dense_values)
    # Short waves are low: neighbours are alike.
    steps = np.diff(exact.dense_values.reshape(129, 129), axis=1)
    assert steps.std() < 6


@pytest.mark.parametrize("make", [bent_page, terrain])
@pytest.mark.parametrize(
    "wrong",
    [{"n": wrong} for wrong in (0, -3, 2.5, "many", None)]
    + [{"noise": wrong} for wrong in (-1, nan, inf, "low", [1, 2])]
    + [{"seed": wrong} for wrong in (-1, 1.5, "x")],
    ids=repr,
)
def test_wrong_arguments_are_refused(make, wrong):
    refused(lambda: make(**wrong), next(iter(wrong)))


@pytest.mark.parametrize("outliers", [-1, 21, 0.5, nan, "some"])
def test_a_wrong_number_of_outliers_is_refused(outliers):
    refused(lambda: bent_page(20, outliers=outliers), "outliers")


def test_more_heights_than_there_are_are_refused():
    refused(lambda: terrain(16642), "n")
