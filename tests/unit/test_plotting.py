import dataclasses
import io
import pickle
import sys
from functools import partial

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from scipy.ndimage import uniform_filter

import mexpress as mx
from mexpress import plotting
from mexpress.liftings import ThinPlateSpline
from mexpress.models.warp import Warp
from mexpress.plotting import curves, rasters
from mexpress.plotting.figures import Aside

WIDTH, HEIGHT = 160, 100
RNG = np.random.default_rng(0)
SOURCE = RNG.uniform(0, 1, (60, 2)) * [WIDTH, HEIGHT]
TARGET = SOURCE + 4 * np.sin(SOURCE[:, ::-1] / 30) + RNG.normal(0, 0.2, SOURCE.shape)
GRAY = RNG.random((HEIGHT, WIDTH))


@pytest.fixture(scope="module")
def selection():
    return mx.select_warp(
        SOURCE, TARGET, criteria=["FIT", "CMPRESS", "AIC", "BIC"], counts=range(3, 20), smoothing=0
    )


def is_drawn(path):
    image = imread(path)
    return image.shape[0] > 200 and image[..., :3].std() > 0.02


def labels(figure):
    """Return the legend's entries."""
    return [text.get_text() for text in figure.legends[0].get_texts()]


def curve_labels(figure):
    """Return what is written beside the curves, from the lowest to the highest."""
    header, *texts = figure.axes[0].texts
    assert header.get_text() == "criterion: what it selects"
    return [text.get_text() for text in sorted(texts, key=lambda text: text.get_position()[1])]


def made_up(curves):
    """Return a selection by the first of the curves."""
    counts = np.arange(3, 3 + len(next(iter(curves.values()))))
    curves = {name: np.asarray(curve, dtype=float) for name, curve in curves.items()}
    return mx.Selection(next(iter(curves)), counts, curves, {})


def test_selection_is_drawn_with_what_each_criterion_selects(selection, tmp_path):
    figure = selection.plot(tmp_path / "curves.png")
    assert is_drawn(tmp_path / "curves.png")
    assert f"ER10: {selection.count}" in curve_labels(figure)
    assert f"BIC (rescaled): {selection.selected['BIC']}" in curve_labels(figure)
    drawn = [line.get_ydata() for line in figure.axes[0].lines]
    assert any(np.array_equal(selection.curves["ER10"], y) for y in drawn)
    assert "pixels" in figure.axes[0].get_ylabel()


def test_many_labels_stand_apart_in_the_order_of_the_curves():
    names = [f"ER{k}" for k in range(1, 13)]
    figure = plotting.plot_selection(made_up({n: [1, 2 + k / 100] for k, n in enumerate(names)}), unit="m")
    assert curve_labels(figure) == [f"{name}: 3" for name in names]
    heights = sorted(text.get_position()[1] for text in figure.axes[0].texts[1:])
    assert np.diff(heights).min() > 0.04
    assert heights[0] >= 0
    assert heights[-1] <= 1
    assert figure.axes[0].get_ylabel() == "criterion (m)"


def test_labels_are_moved_as_little_as_possible():
    np.testing.assert_allclose(curves._apart(np.array([0.5, 0.1, 0.9]), 0.05), [0.5, 0.1, 0.9])
    np.testing.assert_allclose(curves._apart(np.array([0.5, 0.5, 0.5]), 0.1), [0.4, 0.5, 0.6])
    np.testing.assert_allclose(curves._apart(np.array([0.0, 1.0, 0.0, 1.0]), 0.1), [0.0, 0.9, 0.1, 1.0])


def test_families_share_a_colour_from_light_to_dark():
    looks = curves._looks(["ER10", "NN5PCT", "ER1", "ER5", "NN1PCT", "mine", "FIT"])
    brightness = {name: sum(bytes.fromhex(colour[1:])) for name, (colour, _) in looks.items()}
    assert brightness["ER1"] > brightness["ER5"] > brightness["ER10"]
    assert brightness["NN1PCT"] > brightness["NN5PCT"]
    assert {looks[name][1] for name in ("ER1", "ER5", "ER10")} == {"-"}
    assert len({colour for colour, _ in looks.values()}) == len(looks)


def test_curves_that_coincide_share_a_line():
    selection = made_up({"CMPRESS": [3, 1, 2], "PRESS": [3, 1, 2], "FIT": [3, 2, 1]})
    assert curve_labels(plotting.plot_selection(selection)) == ["FIT: 5", "CMPRESS = PRESS: 4"]


def test_rescaling_keeps_what_is_selected_and_stays_on_the_axis(selection):
    moved, names = curves._on_one_axis(selection.curves, "ER10")
    assert names == {"AIC", "BIC"}
    for name in names:
        assert np.argmin(moved[name]) == np.argmin(selection.curves[name])
        assert (moved[name] > 0).all()
        assert (np.argsort(moved[name]) == np.argsort(selection.curves[name])).all()
    np.testing.assert_array_equal(moved["ER10"], selection.curves["ER10"])


def test_rescaling_is_by_least_squares():
    onto = np.array([9.0, 7.0, 6.5, 5.0])
    curve = np.array([-20.0, -50.0, -80.0, -90.0])
    scale, offset = np.polyfit(curve, onto, 1)
    np.testing.assert_allclose(curves._rescaled(curve, onto), scale * curve + offset)
    # Values that are not known on both curves have no say.
    longer = curves._rescaled(np.append(curve, -np.inf), np.append(onto, 1.0))
    np.testing.assert_allclose(longer, np.append(scale * curve + offset, -np.inf))


def test_rescaling_never_turns_a_curve_over():
    falling, rising = np.array([4.0, 2.0, 1.0]), np.array([1.0, 2.0, 3.0])
    moved = curves._rescaled(rising, falling)
    assert (np.diff(moved) > 0).all()
    np.testing.assert_allclose([moved.mean(), moved.std()], [falling.mean(), falling.std()])


def test_rescaling_stays_above_half_of_the_smallest_value():
    curve, onto = np.linspace(0, -10, 9), 4.0 ** -np.arange(9)
    moved = curves._rescaled(curve, onto)
    assert moved.min() == pytest.approx(onto.min() / 2)
    above = curve - curve.min()
    best = min(np.linspace(0, 1, 10001), key=lambda a: ((onto.min() / 2 + a * above - onto) ** 2).sum())
    np.testing.assert_allclose(moved, onto.min() / 2 + best * above, atol=1e-3)


def test_undefined_and_infinite_values_are_left_out(selection, tmp_path):
    changed = dict(selection.curves)
    changed["PRESS"] = np.full(len(selection.counts), np.nan)
    changed["CMPRESS"] = np.where(np.arange(len(selection.counts)) % 2, np.nan, changed["CMPRESS"])
    changed["AIC"] = np.where(selection.counts == 19, -np.inf, changed["AIC"])
    figure = plotting.plot_selection(dataclasses.replace(selection, maps=changed), tmp_path / "curves.png")
    assert "PRESS (per row): none" in curve_labels(figure)
    assert is_drawn(tmp_path / "curves.png")


@pytest.mark.parametrize("criteria", [["AIC"], ["FIT"]])
def test_one_curve_at_one_count(criteria, tmp_path):
    selection = mx.select_warp(
        SOURCE, TARGET, criterion=criteria[0], criteria=criteria, counts=[5], smoothing=0
    )
    selection.plot(tmp_path / "curves.svg")
    assert (tmp_path / "curves.svg").read_text().endswith("</svg>\n")


def test_perfect_matches(tmp_path):
    selection = mx.select_warp(SOURCE, SOURCE, criteria=["FIT", "AIC"], counts=range(3, 6), smoothing=0)
    selection.plot(tmp_path / "curves.png")
    plotting.plot_warp(selection.warp, SOURCE, SOURCE, tmp_path / "warp.png")
    assert is_drawn(tmp_path / "curves.png")
    assert is_drawn(tmp_path / "warp.png")


def every_plot(selection):
    """By name, all plots of a selection of warps; each takes a path and axes."""
    return {
        "plot": selection.plot,
        "plot_radii": selection.plot_radii,
        "plot_error": selection.plot_error,
        "plot_warp": selection.plot_warp,
        "plot_registration": partial(selection.plot_registration, GRAY, GRAY),
    }


def test_neither_backend_nor_current_figure_changes(selection):
    backend, figures = mpl.get_backend(), plt.get_fignums()
    for plot in every_plot(selection).values():
        plot()._repr_png_()
    assert mpl.get_backend() == backend
    assert plt.get_fignums() == figures


def test_no_plot_of_a_selection_is_forgotten(selection):
    assert set(every_plot(selection)) == {name for name in dir(selection) if name.startswith("plot")}


@pytest.mark.parametrize("name", ["plot", "plot_radii", "plot_error", "plot_warp", "plot_registration"])
def test_plots_go_into_axes_that_are_given(selection, tmp_path, name):
    plot = every_plot(selection)[name]
    for layout in ("constrained", None):
        figure = Figure(layout=layout)
        left, right = figure.subplots(1, 2)
        assert plot(tmp_path / "given.png", ax=right) is figure
        assert (tmp_path / "given.png").exists()
        assert right.has_data()
        assert right.get_title(loc="left")
        assert right.get_title(loc="left") in {axes.get_title(loc="left") for axes in plot().axes}
        assert not left.has_data()
    part = Figure().subfigures(1, 2)[1].subplots()
    assert type(plot(ax=part)) is Figure
    for wrong in (Figure(), "left", left.figure.subplots(2), Figure().add_subplot(projection="3d")):
        with pytest.raises(TypeError, match=r"^Invalid ax\. It must be plain axes of matplotlib\."):
            plot(ax=wrong)


def test_a_notebook_shows_figures_by_itself(selection):
    figure = selection.plot()
    width, height = (figure.get_size_inches() * figure.dpi).astype(int)
    assert imread(io.BytesIO(figure._repr_png_())).shape[:2] == (height, width)
    again = pickle.loads(pickle.dumps(figure))
    assert type(again) is Figure
    assert again.axes[0].get_title(loc="left") == figure.axes[0].get_title(loc="left")


def test_warped_grid(selection, tmp_path):
    figure = plotting.plot_warp(selection.warp, SOURCE, TARGET, tmp_path / "warp.png")
    assert is_drawn(tmp_path / "warp.png")
    assert "times as long" in figure.axes[1].get_xlabel()


def test_displacements_are_colours_and_arrows():
    shift = np.array([30.0, -40.0])
    warp = mx.fit_warp(SOURCE, SOURCE + shift, SOURCE[:3], fractional=False)
    colours, arrows = plotting.plot_warp(warp, SOURCE, SOURCE + shift).axes[0].collections[:2]
    lengths = np.ma.compressed(colours.get_array())
    np.testing.assert_allclose(lengths, 50.0)
    directions = np.column_stack([arrows.U, arrows.V])[~arrows.Umask]
    assert len(directions) > 20
    np.testing.assert_allclose(
        directions / np.hypot(*directions.T)[:, None], np.tile(shift / 50, (len(directions), 1))
    )


def test_of_many_matches_some_have_an_arrow():
    many = RNG.uniform(0, 1, (700, 2)) * [WIDTH, HEIGHT]
    target = many + RNG.normal(0, 1, many.shape)
    axes = plotting.plot_warp(mx.fit_warp(many, target, many[:9]), many, target).axes[1]
    arrows = next(each for each in axes.collections if hasattr(each, "U"))
    assert len(arrows.U) == 140
    assert "at one match in 5" in axes.get_xlabel()


@pytest.mark.parametrize(("count", "marker"), [(50, "P"), (200, "o")])
def test_many_control_points_do_not_hide_the_matches(count, marker):
    many = RNG.uniform(0, 1, (300, 2)) * [WIDTH, HEIGHT]
    warp = mx.fit_warp(many, many + 1, many[:count], smoothing=1.0)
    axes = plotting.plot_warp(warp, many, many + 1).axes[0]
    (marks,) = (line for line in axes.lines if line.get_label() == f"{count} control points")
    assert marks.get_marker() == marker
    shown = labels(plotting.plot_registration(warp, GRAY, GRAY, many, many + 1))
    assert (f"{count} control points" in shown) == (marker == "P")
    assert "300 matches" in shown


@pytest.mark.slow
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
    reduced, step = rasters.reduced(large)
    assert max(reduced.shape) <= 1000
    centres = rasters.pixel_centres(reduced, step)
    np.testing.assert_allclose(centres.mean(axis=0), (np.array(large.shape[::-1]) - 1) / 2, atol=step)
    np.testing.assert_allclose(reduced.mean(), large.mean(), rtol=1e-2)


def test_images_in_different_light_are_gray_where_they_are_registered():
    image = np.kron(np.random.default_rng(0).uniform(0.2, 0.8, (30, 40)), np.ones((4, 4)))
    shadow = np.linspace(0.2, 1, 160) * image + np.linspace(0.3, 0, 120)[:, None]
    apart = np.abs(np.diff(rasters.blended(image, shadow)[..., :2]))
    assert np.median(apart) < 0.02
    assert np.median(np.abs(np.diff(rasters.blended(image, np.roll(shadow, 4, axis=1))[..., :2]))) > 0.1


def test_mean_and_contrast_are_those_around_each_pixel():
    rng = np.random.default_rng(0)
    first, second = rng.uniform(0.4, 0.6, (2, 50, 60))
    second[:20, 10:30] = np.nan
    known = np.isfinite(second)

    @np.errstate(divide="ignore", invalid="ignore")  # where nothing is known
    def around(image):
        share = uniform_filter(known.astype(float), 7, mode="constant")
        powers = (np.where(known, power, 0) for power in (image, image**2))
        mean, square = (uniform_filter(power, 7, mode="constant") / share for power in powers)
        return mean, np.sqrt(square - mean**2) + 0.3 * image[known].std()

    (mean, contrast), (others, others_contrast) = around(first), around(second)
    expected = (second - others) * contrast / others_contrast + mean
    found = rasters.blended(first, second)
    np.testing.assert_allclose(found[known][:, 1], np.clip(expected, 0, 1)[known], atol=1e-9)
    np.testing.assert_array_equal(found[known][:, [0, 2]], first[known][:, None].repeat(2, axis=1))
    np.testing.assert_array_equal(found[~known], 0.5 + 0.5 * first[~known][:, None].repeat(3, axis=1))


@pytest.mark.parametrize("flat", [np.zeros((5, 6)), np.full((5, 6), np.nan), np.ones((1, 1))])
def test_images_without_contrast_or_beyond_each_other_are_laid_over_each_other(flat):
    shown = rasters.blended(np.ones(flat.shape), flat)
    assert np.isfinite(shown).all()


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


WEIGHTS = [0.0, 10.0, 100.0, 1e3, 1e4]


def test_few_counts_are_drawn_against_the_weight(tmp_path):
    selection = mx.select_warp(SOURCE, TARGET, "CMPRESS", ["FIT"], counts=[3, 12], smoothing=WEIGHTS)
    figure = selection.plot(tmp_path / "curves.png")
    assert is_drawn(tmp_path / "curves.png")
    axes = figure.axes[0]
    k = selection.place[0]
    drawn = [line.get_ydata() for line in axes.lines]
    assert any(np.array_equal(selection.maps["CMPRESS"][k], y) for y in drawn)
    assert f"at {selection.count} control points" in axes.get_xlabel()
    assert f"smoothing {selection.smoothing:.3g}" in axes.get_title(loc="left")
    assert [text.get_text() for text in axes.get_xticklabels()][-1] == "0"
    (top,) = axes.child_axes
    shown = [text.get_text() for text in top.get_xticklabels()]
    assert shown == [f"{parameters:.3g}" for parameters in selection.parameters[k]]


def test_many_counts_have_a_map(tmp_path):
    selection = mx.select_warp(SOURCE, TARGET, "CMPRESS", ["FIT"], counts=range(3, 12), smoothing=WEIGHTS)
    figure = selection.plot(tmp_path / "curves.png")
    assert is_drawn(tmp_path / "curves.png")
    curves_, mapped = figure.axes[:2]
    assert any(np.array_equal(selection.curves["CMPRESS"], line.get_ydata()) for line in curves_.lines)
    shades = np.asarray(mapped.collections[0].get_array()).reshape(len(WEIGHTS), -1)
    np.testing.assert_array_equal(shades, selection.maps["CMPRESS"].T)
    marks = {text.get_text(): text.xy for text in mapped.texts}
    assert marks["CMPRESS"][0] == selection.count
    assert marks["CMPRESS"][1] == curves.weight_positions(selection.weights)[selection.place[1]]


def test_weights_and_zero_on_one_axis():
    np.testing.assert_allclose(curves.weight_positions(np.array([0.0, 1.0, 100.0])), [-2, 0, 2])
    np.testing.assert_allclose(curves.weight_positions(np.array([0.0, 10.0])), [0.5, 1])


def test_radii_of_a_selection(selection, tmp_path):
    curve = selection.radii([0, 10])
    assert curve.scores[0] == pytest.approx(selection.curves["CMPRESS"][selection.place[0]], rel=1e-9)
    assert curve.scores[1] == pytest.approx(selection.score, rel=1e-9)
    figure = selection.plot_radii(tmp_path / "radii.png")
    assert is_drawn(tmp_path / "radii.png")
    assert "pixels" in figure.axes[0].get_ylabel()


def test_errors_of_a_selection(selection, tmp_path):
    figure = selection.plot_error(tmp_path / "error.png")
    assert is_drawn(tmp_path / "error.png")
    map_, by_distance = figure.axes[:2]
    low, high = map_.get_ylim()
    assert low > high  # y points down
    curve = selection.warp.error_curves.inside
    drawn = [line.get_xydata() for line in by_distance.lines]
    shown = curve.distances <= by_distance.get_xlim()[1]
    assert any(np.array_equal(xy, np.column_stack([curve.distances, curve.errors])[shown]) for xy in drawn)
    assert "pixels" in by_distance.get_ylabel()
    hatched = [artist for artist in map_.collections if getattr(artist, "hatches", None)]
    assert hatched  # the corners of the bounding box, at least
    colours = np.asarray(map_.collections[0].get_array()).ravel()
    assert np.nanmin(colours) == pytest.approx(curve.errors[0], rel=0.05)


def test_errors_of_a_surface_have_y_as_an_image_or_a_map(tmp_path):
    surface = mx.fit_surface(SOURCE, TARGET[:, 0], SOURCE[:9])
    for size, downward in ((None, False), ((WIDTH, HEIGHT), True)):
        low, high = plotting.plot_error(surface, image_size=size, unit="m").axes[0].get_ylim()
        assert (low > high) == downward


def test_unknown_errors_are_drawn_without_colours(tmp_path):
    square = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 2.0], [2.0, 2.0]])
    plotting.plot_error(mx.fit_surface(square, [0, 2, 2, 5], square), tmp_path / "error.png")
    assert (tmp_path / "error.png").exists()


def plain():
    """Matches of an affine map, which is selected before all splines."""
    rng = np.random.default_rng(0)
    source = rng.uniform(0, 1, (20, 2)) * [640, 480]
    return source, source @ [[1.1, 0.1], [-0.1, 0.9]] + rng.normal(0, 1, source.shape)


def test_a_plain_map_that_is_selected_is_a_line_across(tmp_path):
    selection = mx.select_warp(*plain())
    assert selection.rival == "affine map"
    figure = selection.plot(tmp_path / "curves.png")
    assert is_drawn(tmp_path / "curves.png")
    axes = figure.axes[0]
    assert axes.get_title(loc="left").startswith("MATCHED selects the affine map, not ")
    assert "MATCHED: affine map" in curve_labels(figure)
    across = [line for line in axes.lines if line.get_linestyle() == "--"]
    assert [list(line.get_ydata()) for line in across] == [[selection.score] * 2]
    low, high = axes.get_ylim()
    assert low < selection.score < high
    assert any(text.get_text() == f"affine map: MATCHED {selection.score:.4g}" for text in axes.texts)
    hollow = [line for line in axes.lines if line.get_markerfacecolor() == "white"]
    assert selection.maps["MATCHED"][selection.place] in [line.get_ydata()[0] for line in hollow]


def test_without_a_rival_nothing_is_hollow(selection):
    figure = selection.plot()
    assert not [line for line in figure.axes[0].lines if line.get_markerfacecolor() == "white"]
    assert not [line for line in figure.axes[0].lines if line.get_linestyle() == "--" and len(line.get_xdata()) == 2
                and line.get_ydata()[0] == selection.score]  # fmt: skip


def test_data_that_are_not_in_the_fit_have_other_marks(selection, tmp_path):
    aside = Aside(left_out=[3, 4], absent=[9])
    target = TARGET.copy()
    target[3] += 1000
    figure = plotting.plot_warp(selection.warp, SOURCE, target, tmp_path / "w.png", aside=aside)
    assert {"57 matches", "2 left out", "1 absent"} <= set(labels(figure))
    kept = np.setdiff1d(np.arange(60), [3, 4, 9])
    errors = np.hypot(*(target - selection.warp(SOURCE))[kept].T)
    assert f"RMS {np.sqrt((errors**2).mean()):.3g} pixels" in figure.axes[1].get_title(loc="left")
    np.testing.assert_array_equal(np.sort(figure.axes[1].collections[0].get_array()), np.sort(errors))
    marks = {line.get_label(): line.get_xydata() for line in figure.axes[0].lines}
    np.testing.assert_array_equal(marks["2 left out"], SOURCE[[3, 4]])
    np.testing.assert_array_equal(marks["1 absent"], SOURCE[[9]])
    figure = plotting.plot_registration(selection.warp, GRAY, GRAY, SOURCE, target, aside=aside)
    assert {"2 left out", "1 absent"} <= set(labels(figure))
    assert len(figure.axes[0].collections[0].get_offsets()) == 57
    with pytest.raises(ValueError, match=r"^Invalid aside\. "):
        plotting.plot_warp(selection.warp, SOURCE, target, aside=Aside(left_out=[60]))


def test_residuals_of_what_is_kept():
    values = SOURCE[:, 0] / 50
    values[3] = 1e6
    surface = mx.fit_surface(SOURCE, SOURCE[:, 0] / 50, SOURCE[:8])
    figure = plotting.plot_residuals(surface, SOURCE, values, aside=Aside(left_out=[3]))
    assert "1 left out" in labels(figure)
    rms = float(figure.axes[0].get_title(loc="left").split("RMS ")[1].split(",")[0])
    assert rms < 1e-6


def drawn(figure):
    """Everything that has coordinates in a figure's first axes, and what the legend says."""
    axes = figure.axes[0]
    points = [line.get_xydata() for line in axes.lines]
    return [*points, *(dots.get_offsets() for dots in axes.collections), np.array(labels(figure))]


def same_figures(some, others):
    for one, other in zip(drawn(some), drawn(others), strict=True):
        np.testing.assert_array_equal(one, other)


def test_data_that_are_missing_are_not_drawn():
    gaps = np.delete(np.arange(60), [2, 7, 41])
    source, target = SOURCE.copy(), TARGET.copy()
    source[[2, 41]], target[[7, 41], 1] = np.nan, np.nan
    target[30] += 40
    chosen = mx.select_warp(source, target, missing="drop", robust=True)
    assert chosen.left_out.tolist() == [30]
    # Rows of all data, and of those that are there; absent are the missing ones and one more.
    both = (source, target, Aside([30], [2, 7, 9, 41])), (source[gaps], target[gaps], Aside([28], [7]))
    figures = [plotting.plot_warp(chosen.warp, *data, aside=aside) for *data, aside in both]
    assert {"55 matches", "1 left out", "1 absent"} <= set(labels(figures[0]))
    same_figures(*figures)
    same_figures(
        *(plotting.plot_registration(chosen.warp, GRAY, GRAY, *data, aside=aside) for *data, aside in both)
    )
    same_figures(
        plotting.plot_warp(chosen.warp, chosen.source, chosen.target),
        plotting.plot_warp(chosen.warp, source[gaps], target[gaps]),
    )


@pytest.mark.parametrize("columns", [1, 3])
def test_samples_that_are_missing_are_not_drawn(columns):
    points, values = SOURCE.copy(), np.column_stack([SOURCE, TARGET])[:, :columns].squeeze().copy()
    points[4], values[5], values[6] = np.nan, np.nan, np.inf
    known = np.delete(np.arange(60), [4, 5, 6])
    chosen = mx.select_surface(points, values, missing="drop", max_count=9)
    for plot in (plotting.plot_surface, plotting.plot_residuals):
        some, others = (
            plot(chosen.surface, points, values),
            plot(chosen.surface, points[known], values[known]),
        )
        for one, other in zip(some.axes, others.axes, strict=True):
            assert one.get_title(loc="left") == other.get_title(loc="left")
            for dots, same in zip(one.collections, other.collections, strict=True):
                np.testing.assert_array_equal(dots.get_array(), same.get_array())
    plotting.plot_surface(chosen.surface, chosen.points, chosen.values)
    aside = Aside(absent=[4, 5, 6, 8])
    assert "1 absent" in labels(plotting.plot_residuals(chosen.surface, points, values, aside=aside))


@pytest.mark.parametrize(
    ("source", "target", "says"),
    [
        (SOURCE, TARGET[:-1], r"target\. It must have 60 rows, one for each datum\. Given shape \(59, 2\)"),
        (SOURCE[:-1], TARGET, r"target\. It must have 59 rows.*shape \(60, 2\)"),
        (SOURCE * np.nan, TARGET, r"source\. There must be rows that are whole\. Given 0 of 60"),
        (SOURCE[:0], TARGET[:0], r"source\. It must be points of shape"),
        (7.0, TARGET, r"source\. It must have 1 rows"),
        ("abc", TARGET, r"source\. It must be an array of real numbers"),
    ],
)
def test_matches_that_cannot_be_drawn(selection, source, target, says):
    with pytest.raises((ValueError, TypeError), match=f"^Invalid {says}"):
        plotting.plot_warp(selection.warp, source, target)
    with pytest.raises((ValueError, TypeError), match=f"^Invalid {says}"):
        plotting.plot_registration(selection.warp, GRAY, GRAY, source, target)
