import dataclasses
import sys

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.image import imread

import mexpress as mx
from mexpress import plotting
from mexpress.liftings import ThinPlateSpline
from mexpress.warps import Warp

WIDTH, HEIGHT = 160, 100
RNG = np.random.default_rng(0)
SOURCE = RNG.uniform(0, 1, (60, 2)) * [WIDTH, HEIGHT]
TARGET = SOURCE + 4 * np.sin(SOURCE[:, ::-1] / 30) + RNG.normal(0, 0.2, SOURCE.shape)
GRAY = RNG.random((HEIGHT, WIDTH))


@pytest.fixture(scope="module")
def selection():
    return mx.select_warp(SOURCE, TARGET, criteria=["FIT", "CMPRESS", "AIC", "BIC"], counts=range(3, 20))


def is_drawn(path):
    image = imread(path)
    return image.shape[0] > 200 and image[..., :3].std() > 0.02


def labels(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_selection_is_drawn_with_what_each_criterion_selects(selection, tmp_path):
    figure = selection.plot(tmp_path / "curves.png")
    assert is_drawn(tmp_path / "curves.png")
    assert f"ER10: {selection.count}" in labels(figure)
    assert f"BIC: {selection.selected['BIC']} (scaled onto FIT)" in labels(figure)
    drawn = {line.get_label(): line for line in figure.axes[0].lines}
    np.testing.assert_array_equal(drawn[f"ER10: {selection.count}"].get_ydata(), selection.curves["ER10"])


def test_rescaling_keeps_what_is_selected_and_stays_on_the_axis(selection):
    curves, anchor = plotting._on_one_axis(selection.curves, "ER10")
    assert anchor == "FIT"
    for name in ("AIC", "BIC"):
        moved = curves[name]
        assert np.argmin(moved) == np.argmin(selection.curves[name])
        assert (moved > 0).all()
        assert (np.argsort(moved) == np.argsort(selection.curves[name])).all()


def test_rescaling_never_turns_a_curve_over():
    falling, rising = np.array([4.0, 2.0, 1.0]), np.array([1.0, 2.0, 3.0])
    assert (np.diff(plotting._rescaled(rising, falling)) > 0).all()


def test_undefined_and_infinite_values_are_left_out(selection, tmp_path):
    curves = dict(selection.curves)
    curves["PRESS"] = np.full(len(selection.counts), np.nan)
    curves["CMPRESS"] = np.where(np.arange(len(selection.counts)) % 2, np.nan, curves["CMPRESS"])
    curves["AIC"] = np.where(selection.counts == 19, -np.inf, curves["AIC"])
    changed = dataclasses.replace(selection, curves=curves)
    figure = plotting.plot_selection(changed, tmp_path / "curves.png")
    assert "PRESS: none (per row)" in labels(figure)
    assert is_drawn(tmp_path / "curves.png")


@pytest.mark.parametrize("criteria", [["AIC"], ["FIT"]])
def test_one_curve_at_one_count(criteria, tmp_path):
    selection = mx.select_warp(SOURCE, TARGET, criterion=criteria[0], criteria=criteria, counts=[5])
    selection.plot(tmp_path / "curves.svg")
    assert (tmp_path / "curves.svg").read_text().endswith("</svg>\n")


def test_perfect_matches(tmp_path):
    selection = mx.select_warp(SOURCE, SOURCE, criteria=["FIT", "AIC"], counts=range(3, 6))
    selection.plot(tmp_path / "curves.png")
    plotting.plot_warp(selection.warp, SOURCE, SOURCE, tmp_path / "warp.png")
    assert is_drawn(tmp_path / "curves.png")
    assert is_drawn(tmp_path / "warp.png")


def test_neither_backend_nor_current_figure_changes(selection):
    backend, figures = mpl.get_backend(), plt.get_fignums()
    selection.plot()
    plotting.plot_warp(selection.warp, SOURCE, TARGET)
    assert mpl.get_backend() == backend
    assert plt.get_fignums() == figures


def test_warped_grid(selection, tmp_path):
    figure = plotting.plot_warp(selection.warp, SOURCE, TARGET, tmp_path / "warp.png")
    assert is_drawn(tmp_path / "warp.png")
    assert "times as long" in figure.axes[1].get_xlabel()


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (GRAY, GRAY),
        ((255 * GRAY).astype(np.uint8), np.dstack([GRAY] * 3)),
        (np.dstack([GRAY] * 4), (65535 * GRAY[:70, :90]).astype(np.uint16)),
        (GRAY > 0.5, 300 * GRAY - 100),
        (GRAY[..., None], np.full((40, 50), np.nan)),
        (np.kron(GRAY, np.ones((9, 9))), np.ones((1, 1))),
    ],
)
def test_images_of_all_kinds(selection, tmp_path, first, second):
    figure = plotting.plot_registration(
        selection.warp, first, second, SOURCE, TARGET, path=tmp_path / "r.png"
    )
    assert is_drawn(tmp_path / "r.png")
    left, right, bottom, top = figure.axes[0].images[0].get_extent()
    assert abs(right - left - first.shape[1]) < 2
    assert abs(bottom - top - first.shape[0]) < 2


def test_a_shift_is_undone():
    shift = mx.fit_warp(SOURCE, SOURCE + np.array([7, 3]), SOURCE[:3], fractional=False)
    figure = plotting.plot_registration(shift, GRAY, np.pad(GRAY, ((3, 0), (7, 0))))
    pulled = figure.axes[1].images[0].get_array()
    # But for the borders, where rounding decides what is outside.
    np.testing.assert_allclose(pulled[1:-1, 1:-1], GRAY[1:-1, 1:-1], atol=1e-9)
    source, target, same = np.moveaxis(figure.axes[2].images[0].get_array(), -1, 0)
    np.testing.assert_array_equal(source, same)
    np.testing.assert_allclose(source[1:-1, 1:-1], target[1:-1, 1:-1], atol=0.01)


def test_large_images_are_reduced_without_a_shift():
    large = np.kron(GRAY, np.ones((10, 10)))
    reduced, step = plotting._reduced(large)
    assert max(reduced.shape) <= 1000
    centres = plotting._pixel_centres(reduced, step)
    np.testing.assert_allclose(centres.mean(axis=0), (np.array(large.shape[::-1]) - 1) / 2, atol=step)
    np.testing.assert_allclose(reduced.mean(), large.mean(), rtol=1e-2)


def test_where_a_warp_fails_is_painted():
    corners = np.array(
        [[0, 0], [WIDTH, 0], [WIDTH, HEIGHT], [0, HEIGHT], [WIDTH / 2, HEIGHT / 2]], dtype=float
    )
    target = np.column_stack([corners, [1.0, 1.0, 1.0, 1.0, -1.0]])
    warp = Warp(ThinPlateSpline(corners), target, corners[:4])
    figure = plotting.plot_registration(warp, GRAY, GRAY)
    assert "the denominator vanishes" in labels(figure)


@pytest.mark.parametrize(
    ("image", "error"),
    [
        (np.zeros((3, 4, 5)), ValueError),
        (np.zeros(7), ValueError),
        (np.zeros((0, 4)), ValueError),
        (np.zeros((3, 4), dtype=complex), TypeError),
        ("left.png", ValueError),
    ],
)
def test_what_is_no_image(selection, image, error):
    with pytest.raises(error, match=r"^Invalid source_image\."):
        plotting.plot_registration(selection.warp, image, GRAY)


def test_the_missing_extra_is_named(selection, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ImportError, match=r"pip install 'mexpress\[plot\]'"):
        selection.plot()
