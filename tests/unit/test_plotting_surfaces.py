import sys

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

import mexpress as mx
from mexpress import plotting
from mexpress.plotting import solids, surfaces

RNG = np.random.default_rng(3)
POINTS = RNG.uniform(0, 1, (300, 2)) * [160, 120]
DEPTH = 2 + 0.3 * np.sin(POINTS[:, 0] / 25) + RNG.normal(0, 0.02, 300)
SHEET = np.column_stack([POINTS, 30 * np.cos(POINTS[:, 0] / 60)])
IMAGE = {"image_size": (160, 120), "unit": "m"}


@pytest.fixture(scope="module")
def selection():
    return mx.select_surface(POINTS, DEPTH, criterion="ER5", max_count=30, smoothing=0)


@pytest.fixture(scope="module")
def surface(selection):
    return selection.surface


def is_drawn(path):
    image = imread(path)
    return image.shape[0] > 200 and image[..., :3].std() > 0.02


def colour_bar_labels(figure):
    return [beside.get_ylabel() for axes in figure.axes for beside in axes.child_axes]


@pytest.mark.parametrize("more", [{}, IMAGE])
def test_a_depth_is_drawn_beside_the_data_in_the_same_colours(surface, tmp_path, more):
    figure = plotting.plot_surface(surface, POINTS, DEPTH, tmp_path / "surface.png", **more)
    assert is_drawn(tmp_path / "surface.png")
    data, fitted = (axes.collections[0] for axes in figure.axes[:2])
    grid = surface.grid(step=np.sqrt(np.prod(np.ptp(surface.domain, axis=0)) / 40_000))
    colours = data.to_rgba(grid.values[grid.inside])[:, :3]
    lit = np.asarray(fitted.get_facecolor())[grid.inside.ravel(), :3]
    light = (lit / colours).max(axis=1, keepdims=True)
    np.testing.assert_allclose(lit, light * colours, atol=1e-3)
    assert 0.1 < light.min() < 0.8 < light.max() <= 1 + 1e-9
    assert colour_bar_labels(figure) == ["depth (m)" if more else "value (unit of the data)"]
    assert figure.axes[0].yaxis_inverted() == bool(more)


def test_a_column_of_depths_is_drawn_as_depths():
    column = mx.fit_surface(POINTS, DEPTH[:, None], POINTS[:12])
    plain = mx.fit_surface(POINTS, DEPTH, POINTS[:12])
    for plot in (plotting.plot_surface, plotting.plot_residuals):
        drawn, expected = plot(column, POINTS, DEPTH[:, None]), plot(plain, POINTS, DEPTH)
        assert [axes.get_title(loc="left") for axes in drawn.axes] == [
            axes.get_title(loc="left") for axes in expected.axes
        ]
        for one, other in zip(drawn.axes[0].collections, expected.axes[0].collections, strict=True):
            np.testing.assert_array_equal(one.get_array(), other.get_array())


def test_points_in_space_are_drawn_from_two_sides(tmp_path):
    sheet = mx.fit_surface(POINTS, SHEET, POINTS[:12])
    for more in ({}, IMAGE):
        figure = plotting.plot_surface(sheet, POINTS, SHEET, tmp_path / "surface.png", **more)
        assert is_drawn(tmp_path / "surface.png")
        first, second = figure.axes
        assert (first.elev, first.azim) != (second.elev, second.azim)
        assert (first.get_zlabel() == "y (m)") == bool(more)  # a camera's y points down


def test_data_behind_the_surface_are_hidden(tmp_path):
    flat = mx.fit_surface(POINTS, 0 * DEPTH, POINTS[:4])
    dark = []
    for depths in (0 * DEPTH + 1, 0 * DEPTH - 1):
        figure = Figure()
        axes = figure.add_subplot(projection="3d")
        solids.draw_solid(axes, solids.Solid.of_depths(flat, POINTS, depths, None, None), (90.0, -90.0))
        axes.set_axis_off()
        figure.savefig(tmp_path / "above.png")
        dark.append((imread(tmp_path / "above.png")[..., :3].max(axis=2) < 0.2).sum())
    assert dark[0] > 300
    assert dark[1] == 0


def test_squares_face_the_eye():
    scale, view = np.array([2.0, -3.0, 5.0]), (20.0, -60.0)
    square = solids._squares(np.zeros((1, 3)), scale, view)[0] / scale
    towards, _, _ = solids._eye(view)
    np.testing.assert_allclose(square @ towards, solids._LIFT)
    np.testing.assert_allclose(np.linalg.norm(np.diff(square, axis=0), axis=1), 2 * solids._DOT)


@pytest.mark.slow
@pytest.mark.parametrize("more", [{}, IMAGE])
def test_flat_surfaces(tmp_path, more):
    for values in (0 * DEPTH, 0 * DEPTH + 7, np.column_stack([POINTS, 0 * DEPTH])):
        surface = mx.fit_surface(POINTS, values, POINTS[:4])
        plotting.plot_surface(surface, POINTS, values, tmp_path / "surface.png", **more)
        assert is_drawn(tmp_path / "surface.png")


def test_what_has_no_place_in_space_is_refused():
    plane = mx.fit_surface(POINTS, POINTS, POINTS[:5])
    with pytest.raises(ValueError, match=r"^Invalid surface\. .* Given 2 values\."):
        plotting.plot_surface(plane, POINTS, POINTS)


def test_residuals_have_a_sign_and_limits_around_zero(surface, tmp_path):
    spoiled = DEPTH + np.where(np.arange(300) == 7, 1000, 0)
    figure = plotting.plot_residuals(surface, POINTS, spoiled, tmp_path / "residuals.png", **IMAGE)
    assert is_drawn(tmp_path / "residuals.png")
    drawn = figure.axes[0].collections[0]
    np.testing.assert_allclose(drawn.get_array(), spoiled - surface(POINTS))
    low, high = drawn.get_clim()
    assert low == -high
    assert high < 1  # one wrong datum does not decide
    assert colour_bar_labels(figure) == ["data minus surface (m)"]


def test_many_data_are_an_image_of_their_means():
    points = RNG.uniform(0, 1, (5000, 2)) * [40, 30]
    points = points[~((points > [10, 8]) & (points < [25, 22])).all(axis=1)]  # a hole
    depth = 3 * points[:, 0] + points[:, 1]
    surface = mx.fit_surface(points, np.zeros(len(points)), points[:5])
    image = plotting.plot_residuals(surface, points, depth).axes[0].images[0]
    left, right, bottom, top = image.get_extent()
    shown = image.get_array().filled(np.nan)
    y, x = (np.indices(shown.shape) + 0.5) * np.reshape([top - bottom, right - left], (2, 1, 1))
    x, y = x / shown.shape[1] + left, y / shown.shape[0] + bottom
    hole = (x > 12) & (x < 23) & (y > 10) & (y < 20)
    assert np.isnan(shown[hole]).all()
    away = (x < 9) | (x > 26) | (y < 7) | (y > 23)
    error = shown[away] - (3 * x + y)[away]
    assert np.isfinite(error).all()
    assert np.abs(error).max() < 6  # two cells


@pytest.mark.parametrize(("count", "data", "marked"), [(40, 300, True), (80, 300, False), (80, 2500, True)])
def test_many_control_points_do_not_hide_residuals(count, data, marked):
    points = RNG.uniform(0, 1, (data, 2))
    surface = mx.fit_surface(points, points[:, 0], points[:count], smoothing=1e-3)
    for ax in (None, Figure().subplots()):
        lines = plotting.plot_residuals(surface, points, points[:, 0], ax=ax).axes[0].lines
        assert [line.get_label() for line in lines] == [f"{count} control points"] * marked


@pytest.mark.parametrize("width", [2, 3, 4])
def test_residuals_of_several_values_are_distances(width, tmp_path):
    values = RNG.normal(size=(300, width))
    surface = mx.fit_surface(POINTS, values, POINTS[:9])
    figure = plotting.plot_residuals(surface, POINTS, values, tmp_path / "residuals.png")
    assert is_drawn(tmp_path / "residuals.png")
    expected = np.linalg.norm(values - surface(POINTS), axis=1)
    drawn = figure.axes[0].collections[0]
    np.testing.assert_allclose(drawn.get_array(), expected)
    assert drawn.get_clim()[0] == 0
    assert figure.axes[0].get_xlabel() == "u"


def test_data_without_residuals(tmp_path):
    surface = mx.fit_surface(POINTS, 2 * POINTS[:, 0], POINTS[:5])
    plotting.plot_residuals(surface, POINTS, surface(POINTS), tmp_path / "residuals.png")
    assert is_drawn(tmp_path / "residuals.png")


@pytest.mark.parametrize("more", [{}, IMAGE])
def test_control_points_are_coloured_and_numbered_in_their_order(selection, tmp_path, more):
    figure = selection.plot_control_points(tmp_path / "points.png", **more)
    assert is_drawn(tmp_path / "points.png")
    axes = figure.axes[0]
    number = len(selection.control_points)
    marks = {line.get_label(): np.column_stack(line.get_data()) for line in axes.lines}
    first = np.vstack([marks[label] for label in marks if label.startswith(f"1 to {number - 10}")])
    last = np.vstack([marks[label] for label in marks if label.startswith("the last 10")])
    assert {*map(tuple, first)} == {*map(tuple, selection.control_points[:-10])}
    assert {*map(tuple, last)} == {*map(tuple, selection.control_points[-10:])}
    for text in axes.texts:
        assert text.xy == tuple(selection.control_points[int(text.get_text()) - 1])
    written = {int(text.get_text()) for text in axes.texts}
    assert {1, 2, 3, selection.count, number} <= written
    assert figure.axes[0].yaxis_inverted() == bool(more)


def test_control_points_that_are_spread_have_no_order():
    selection = mx.select_surface(POINTS, DEPTH)
    assert selection.placement != "residual"
    axes = selection.plot_control_points().axes[0]
    assert axes.get_title(loc="left") == f"MATCHED selects {selection.count} control points, spread evenly"
    assert not axes.texts
    (marks,) = axes.lines
    np.testing.assert_array_equal(marks.get_xydata(), selection.surface.control_points)


@pytest.mark.parametrize("y_down", [False, True])
def test_surfaces_are_lit_from_the_upper_left(y_down):
    x, y = np.arange(9.0), np.arange(7.0)
    up = -1.0 if y_down else 1.0
    towards_eye = -1.0 if y_down else 1.0  # heights grow towards the eye, depths away from it
    faces = {}
    for name, across, upwards in (("upper left", 1, -1), ("lower right", -1, 1), ("upper right", -1, -1)):
        heights = across * x[None, :] + upwards * up * y[:, None]
        light = surfaces._relief(towards_eye * heights, x, y, towards_eye=not y_down)
        np.testing.assert_allclose(light, light[0, 0])
        faces[name] = light[0, 0]
    assert faces["upper left"] > faces["upper right"] > faces["lower right"]
    np.testing.assert_array_equal(surfaces._relief(np.ones((7, 9)), x, y, True), 1.0)


PLOTS = ["plot_surface", "plot_residuals", "plot_control_points"]


def test_no_plot_of_a_selection_is_forgotten(selection):
    assert {*PLOTS, "plot", "plot_radii", "plot_error"} == {
        name for name in dir(selection) if name[:4] == "plot"
    }


@pytest.mark.parametrize("name", PLOTS)
def test_plots_go_into_axes_that_are_given(selection, tmp_path, name):
    for layout, more in (("constrained", IMAGE), (None, {})):
        figure = Figure(layout=layout)
        left, right = figure.subplots(1, 2)
        drawn = getattr(selection, name)(tmp_path / "given.png", ax=right, **more)
        assert drawn is figure
        assert is_drawn(tmp_path / "given.png")
        assert right.has_data()
        assert not left.has_data()
        assert right.yaxis_inverted() == bool(more)
    with pytest.raises(TypeError, match=r"^Invalid ax\. "):
        getattr(selection, name)(ax=np.array([left, right]))


def test_a_surface_in_space_goes_into_axes_that_are_given(selection, tmp_path):
    sheet = mx.select_surface(POINTS, SHEET, max_count=9)
    for each in (selection, sheet):
        figure = Figure()
        axes = figure.add_subplot(projection="3d")
        assert each.plot_surface(tmp_path / "given.png", ax=axes) is figure
        assert is_drawn(tmp_path / "given.png")
        assert axes.collections
    with pytest.raises(TypeError, match=r"^Invalid ax\. It must be 3d axes of matplotlib\."):
        sheet.plot_surface(ax=Figure().subplots())


@pytest.mark.parametrize("values", [DEPTH, SHEET])
def test_few_control_points(values, tmp_path):
    selection = mx.select_surface(POINTS, values, criterion="CMPRESS", max_count=3, smoothing=0)
    figure = plotting.plot_control_points(selection, tmp_path / "points.png")
    assert is_drawn(tmp_path / "points.png")
    assert len(figure.axes[0].texts) == 3


def test_data_of_another_shape_are_refused(surface):
    with pytest.raises(ValueError, match=r"^Invalid values\."):
        plotting.plot_surface(surface, POINTS, DEPTH[:-1])
    with pytest.raises(ValueError, match=r"^Invalid values\. They must have shape \(300, 1\)"):
        plotting.plot_residuals(surface, POINTS, SHEET)


def test_the_missing_extra_is_named(selection, surface, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    for plot in (
        lambda: plotting.plot_surface(surface, POINTS, DEPTH),
        lambda: plotting.plot_residuals(surface, POINTS, DEPTH),
        lambda: plotting.plot_control_points(selection),
    ):
        with pytest.raises(ImportError, match=r"pip install 'mexpress\[plot\]'"):
            plot()
