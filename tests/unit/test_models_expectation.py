import copy
import math
import pickle

import numpy as np
import pytest
from error_coverage import judge
from inputs import refused
from scipy.spatial import Delaunay
from sklearn.isotonic import IsotonicRegression

import mexpress as mx
from mexpress.geometry import Region
from mexpress.liftings import LIFTINGS
from mexpress.models import ErrorCurve, ErrorCurves, Observations
from mexpress.models import error_curves as curves_module
from mexpress.models.error_curves import increasing

RANDOM = np.random.default_rng(0)
POINTS = RANDOM.uniform(0, 640, (120, 2))
HOLE = np.array([320.0, 320.0])
HOLED = POINTS[np.hypot(*(POINTS - HOLE).T) > 100]
DEPTH = np.sin(HOLED[:, 0] / 60) + RANDOM.normal(0, 0.05, len(HOLED))
TARGET = (HOLED + 10 * np.sin(HOLED[:, ::-1] / 90)) / (1 + HOLED @ [[0.001], [0.002]])
WEIGHTS = RANDOM.uniform(0.1, 5, len(HOLED))
CENTRES = HOLED[::3]

SURFACE = mx.fit_surface(HOLED, DEPTH, CENTRES, smoothing=1.0)


def reweighted(model):
    design = model._design(model.data).weighted(WEIGHTS)
    return design.model(design.fit(1.0).coefficients, smoothing=1.0)


MODELS = {
    "surface": SURFACE,
    "embedding": mx.fit_surface(HOLED, np.column_stack([HOLED, DEPTH]), CENTRES, smoothing=1.0),
    "warp": mx.fit_warp(HOLED, TARGET, CENTRES[::3]),
    "linear warp": mx.fit_warp(HOLED, TARGET, CENTRES, fractional=False, smoothing=1.0),
    "b-splines": mx.fit_warp(
        HOLED, TARGET, np.mgrid[0:640:5j, 0:640:5j].reshape(2, -1).T, "bspline", smoothing=1.0
    ),
    "nested": mx.select_warp(HOLED, TARGET, smoothing="auto", counts=[3, 30]).warp,
    "weighted": reweighted(SURFACE),
}
EVERY = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS.keys())


def without_data(model):
    return type(model)(model.lifting, model.parameters, model.domain, model.smoothing)


# Beyond the horizon


@pytest.mark.parametrize("lifting", LIFTINGS)
def test_where_a_warp_has_no_value_it_has_no_error_interval_or_slope(lifting):
    source = RANDOM.uniform(0, 400, (150, 2))
    target = source * [0.5, 0.8] / (1 - source[:, :1] / 600) + RANDOM.normal(0, 0.1, source.shape)
    warp = mx.fit_warp(source, target, LIFTINGS[lifting].place(source, 4), lifting, smoothing=1e-3)
    points = np.array([[200.0, 200], [np.nan, 0], [450, 100], [900, 200], [2000, -100], [100, 300]])
    beyond = np.isnan(warp(points)).any(axis=1)
    np.testing.assert_array_equal(
        beyond[[0, 1, 4, 5]], [False, True, True, False]
    )  # far off, liftings differ
    interval = warp.interval(points)
    for values in (warp.error(points), interval.lower, interval.upper, warp.jacobian(points)):
        everywhere = np.isnan(values.reshape(len(points), -1))
        np.testing.assert_array_equal(everywhere, np.broadcast_to(beyond[:, None], everywhere.shape))
    np.testing.assert_array_equal(warp.covers(points), [True, False, False, False, False, True])
    assert np.isfinite(warp.denominator(points[[0, 2, 3, 4, 5]])).all()
    near = warp.jacobian(points[:1])[0]
    steps = np.array([[1e-4, 0], [0, 1e-4]])
    np.testing.assert_allclose(
        near.T, (warp(points[0] + steps) - warp(points[0] - steps)) / 2e-4, rtol=1e-5, atol=1e-6
    )


# The data


@EVERY
def test_a_model_solves_the_problem_of_its_data(model):
    # Or errors and intervals would be those of another model.
    design = model._design(model.data)
    again = design.model(design.fit(model.smoothing).coefficients, smoothing=model.smoothing)
    np.testing.assert_allclose(again(POINTS), model(POINTS), rtol=1e-6, atol=1e-7)


def test_models_of_a_selection_share_the_data():
    selection = mx.select_warp(HOLED, TARGET, counts=[3, 5, 7])
    for warp in selection.warps.values():
        assert warp.data.points is selection.source
        assert warp.data.values is selection.target
    weights = np.ones(len(HOLED))
    with pytest.warns(DeprecationWarning, match="robust=True"):
        again = selection.reweighted(weights)
    assert again.data.weights is weights


@pytest.mark.parametrize("ask", ["error", "covers", "interval"])
@EVERY
def test_without_data_a_model_knows_no_error(model, ask):
    text = refused(lambda: getattr(without_data(model), ask)(POINTS), "model", ValueError)
    assert "data" in text


def test_without_data_neither_does_a_grid():
    grid = without_data(SURFACE).grid(step=100)
    refused(lambda: grid.error, "model", ValueError)


@pytest.mark.parametrize("computed", [False, True])
@EVERY
def test_files_pickles_and_copies_keep_data_and_curves(model, computed, tmp_path, monkeypatch):
    model = copy.deepcopy(model)
    vars(model).pop("error_curves", None)
    expected = model.error(POINTS)
    if not computed:
        del vars(model)["error_curves"]
    model.save(tmp_path / "model.npz")
    others = [
        mx.load(tmp_path / "model.npz"),
        pickle.loads(pickle.dumps(model)),
        copy.copy(model),
        copy.deepcopy(model),
    ]
    if computed:
        monkeypatch.setattr(ErrorCurves, "of", None)
    for other in others:
        for name in ("points", "values", "weights"):
            np.testing.assert_array_equal(getattr(other.data, name), getattr(model.data, name))
        assert other.data.over_data is model.data.over_data
        np.testing.assert_array_equal(other.error(POINTS), expected)
        np.testing.assert_array_equal(other.interval(POINTS).lower, model.interval(POINTS).lower)


@EVERY
def test_files_without_data_are_read(model, tmp_path):
    # As 0.1.0 wrote them.
    arrays = {
        name: array
        for name, array in model.to_arrays().items()
        if name in ("lifting", "control_points", "parameters", "domain", "smoothing")
    }
    header = {"format": "mexpress model", "version": 1, "kind": model.kind}
    np.savez(tmp_path / "old.npz", **header, **arrays)
    old = mx.load(tmp_path / "old.npz")
    assert old.data is None
    np.testing.assert_array_equal(old(POINTS), model(POINTS))
    old.save(tmp_path / "new.npz")
    assert mx.load(tmp_path / "new.npz").data is None


DAMAGE = {
    "points": [HOLED[:, :1], HOLED[0], HOLED + np.nan, HOLED[:5]],
    "values": [DEPTH[:5], DEPTH + np.inf, DEPTH.astype(str)],
    "weights": [WEIGHTS[:5], -WEIGHTS, WEIGHTS + np.nan, WEIGHTS[:, None]],
}


@pytest.mark.parametrize(
    ("name", "array"), [(name, array) for name, some in DAMAGE.items() for array in some]
)
def test_files_with_damaged_data_are_refused(name, array, tmp_path):
    header = {"format": "mexpress model", "version": 1, "kind": "surface"}
    np.savez(tmp_path / "m.npz", **header, **{**MODELS["weighted"].to_arrays(), name: array})
    with pytest.raises(ValueError, match=rf"cannot be rebuilt: Invalid ({name}|values|weights)"):
        mx.load(tmp_path / "m.npz")


# Curves


def neighbourhoods(points):
    return list(curves_module._neighbourhoods(points, Region.of(points), 100))


@pytest.mark.parametrize("points", [POINTS, HOLED, np.repeat(POINTS[:20], 3, axis=0), POINTS.round(-2)])
def test_neighbourhoods_are_what_they_say(points):
    gaps = neighbourhoods(points)
    assert any(gap.outside.any() for gap in gaps)
    assert max(len(gap.held_out) for gap in gaps) > 0.3 * len(points)
    for held_out, predicted, distances, outside in gaps:
        assert len(held_out) <= max(1, len(points) / 2)
        assert np.isin(predicted, held_out).all()
        others = np.delete(points, held_out, axis=0)
        expected = np.hypot(*(points[predicted][:, None] - others).transpose(2, 0, 1)).min(axis=1)
        np.testing.assert_allclose(distances, expected, rtol=1e-9)
        if np.linalg.matrix_rank(others - others[0]) < 2:
            assert outside.all()
            continue
        # On the edge, rounding decides.
        hull = Delaunay(others)
        centre = others.mean(axis=0)
        deeper, higher = (centre + (points[predicted] - centre) * factor for factor in (1 - 1e-6, 1 + 1e-6))
        assert (outside >= (hull.find_simplex(deeper) < 0)).all()
        assert (outside <= (hull.find_simplex(higher) < 0)).all()


def refitted(model, gap):
    """Return errors of the predicted data by a model that is fitted without the gap."""
    data, design = model.data, model._design(model.data)
    g = design.coupling
    rows = np.repeat(np.sqrt(np.ones(len(data.points)) if data.weights is None else data.weights), g)
    kept = np.repeat(~np.isin(np.arange(len(data.points)), gap.held_out), g)
    bending = math.sqrt(model.smoothing) * design.bending()
    right = (rows[:, None] * design.b.reshape(len(rows), -1))[kept]
    x = np.linalg.lstsq(
        np.vstack([(rows[:, None] * design.A)[kept], bending]),
        np.vstack([right, np.zeros((len(bending), right.shape[1]))]),
        rcond=None,
    )[0]
    left = design.b.reshape(len(rows), -1) - design.A @ x
    return left.reshape(len(data.points), -1)[gap.predicted]


@EVERY
def test_curves_are_averages_of_errors_of_refits(model, monkeypatch):
    data, gaps = model.data, neighbourhoods(model.data.points)[::8]
    monkeypatch.setattr(curves_module, "_neighbourhoods", lambda *_: iter(gaps))
    model = copy.deepcopy(model)
    vars(model).pop("error_curves", None)
    units = (
        np.abs(model.denominator(data.points)) if isinstance(model, mx.Warp) else np.ones(len(data.points))
    )
    predicted = np.concatenate([gap.predicted for gap in gaps])
    errors = np.concatenate([refitted(model, gap) for gap in gaps])
    sizes = np.sqrt((errors**2).sum(axis=1)) / units[predicted]
    shares = np.ones(len(predicted)) if data.weights is None else data.weights[predicted]
    distances, outside = (
        np.concatenate([getattr(gap, name) for gap in gaps]) for name in ("distances", "outside")
    )
    near, far = (ErrorCurve.through(distances[s], sizes[s], shares[s]) for s in (~outside, outside))
    np.testing.assert_allclose(model.error_curves.inside.errors, near.errors, rtol=1e-6)
    np.testing.assert_allclose(model.error_curves.outside.errors[1:], far.errors, rtol=1e-6)
    np.testing.assert_allclose(model.error_curves.outside.distances[1:], far.distances)


def test_a_curve_averages_groups_and_rises():
    # Eight groups, with weights 1 and 3 of squares that differ by 1; the first three averages are pooled.
    distances, weights = np.repeat(np.arange(8.0, 0, -1), 20), np.tile([1.0, 3.0], 80)
    squares = np.repeat([9.0, 6, 6, 6, 6, 1, 1, 4], 20) + np.tile([1.0, 0.0], 80)
    curve = ErrorCurve.through(distances, np.sqrt(squares), weights)
    np.testing.assert_allclose(curve.distances, np.arange(1, 9))
    at = np.array([0.0, 1.0, 3.0, 4.0, 7.0, 8.0, 16.0])
    np.testing.assert_allclose(curve(at) ** 2, [2.25, 2.25, 2.25, 6.25, 6.25, 9.25, 37])


@pytest.mark.parametrize("number", [1, 5, 30])
def test_a_curve_ends_where_most_is_undefined(number):
    distances = np.arange(100.0)
    errors = np.where((distances >= 50) | (distances % 5 == 0), np.nan, 1.0)
    errors[distances >= 100 - number] = 1
    curve = ErrorCurve.through(distances, errors, np.ones(100))
    assert 33 < curve.reach < 50
    np.testing.assert_allclose(curve.errors, 1)
    assert ErrorCurve.through(distances, errors + np.nan, np.ones(100)) is None


@pytest.mark.parametrize("seed", range(20))
def test_increasing_is_isotonic_regression(seed):
    random = np.random.default_rng(seed)
    values, sizes = np.arange(30) / 10 + random.normal(size=30), random.uniform(0.1, 3, 30)
    expected = IsotonicRegression().fit(np.arange(30), values, sizes).predict(np.arange(30))
    np.testing.assert_allclose(increasing(values, sizes), expected, rtol=1e-12)


@EVERY
def test_errors_rise_with_the_distance_and_outside(model):
    curves, distances = model.error_curves, np.linspace(0, 2000, 500)
    near, far = (curves(distances, np.full(500, inside)) for inside in (True, False))
    for errors in (near, far):
        assert (np.diff(errors) >= 0).all()
    assert (far >= near).all()
    assert near[0] == far[0] == curves.inside.errors[0]
    assert near[-1] == pytest.approx(curves.inside.errors[-1] * 2000 / curves.inside.reach)
    x, y = np.meshgrid(np.linspace(0, 640, 40), np.linspace(0, 640, 40))
    at = np.column_stack([x.ravel(), y.ravel()])
    distance = np.hypot(*(at[:, None] - model.data.points).transpose(2, 0, 1)).min(axis=1)
    inside = Delaunay(model.domain).find_simplex(at) >= 0
    np.testing.assert_allclose(model.error(at), curves(distance, inside))


def test_the_error_between_dense_data_is_that_of_leave_one_out():
    points = np.random.default_rng(1).uniform(0, 1, (2000, 2))
    values = np.sin(6 * points[:, 0]) + np.random.default_rng(2).normal(0, 0.3, 2000)
    surface = mx.fit_surface(points, values, points[:30])
    design = surface._design(surface.data)
    score = design.fit().cross_validate(mx.schemes.leave_one_out(2000)).score
    assert surface.error(points[:50] + 0.001) == pytest.approx(score, rel=0.1)


def test_few_data_cannot_tell():
    square = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 2.0], [2.0, 2.0]])
    exact = mx.fit_surface(square, [0, 2, 2, 5], square)
    assert (exact.error([[1, 1], [5, 5]]) == np.inf).all()
    assert not exact.covers([[1, 1]]).any()
    plane = mx.fit_surface(square, [0, 2, 2, 5], square[:3])
    assert np.isfinite(plane.error([[1, 1], [5, 5]])).all()
    triangle = mx.fit_surface(square[:3], [0, 2, 2], square[:3])
    assert (triangle.error([[1, 1]]) == np.inf).all()


def test_wide_gaps_and_places_outside_are_not_covered():
    sides = np.random.default_rng(0).uniform(0, 1, (200, 2)) * [0.1, 1] + np.array([[0, 0], [5, 0]]).repeat(
        100, 0
    )
    surface = mx.fit_surface(sides, np.sin(sides[:, 1]), sides[::20], smoothing=1e-3)
    at = [[0.05, 0.5], [2.5, 0.5], [5.05, 0.5], [0.05, 1.2]]
    np.testing.assert_array_equal(surface.covers(at), [True, False, True, False])
    np.testing.assert_array_equal(SURFACE.covers([HOLE, [-5, 300]]), [True, False])


def test_a_grid_has_errors_inside():
    grid = SURFACE.grid(step=40)
    assert np.isnan(grid.error[~grid.inside]).all()
    np.testing.assert_array_equal(grid.error[grid.inside], SURFACE.error(grid.points[grid.inside.ravel()]))


@pytest.mark.slow
def test_errors_cover_what_is_in_gaps():
    shares = np.array(
        [
            judge(None, name, "discs", k)
            for name in ("simulated surfaces", "simulated sheets")
            for k in range(4)
        ]
    )
    measured, _, _, _, interval = shares.mean(axis=0)
    assert 0.88 < measured < 0.99
    assert 0.86 < interval < 0.95


def test_results_have_one_line():
    assert repr(SURFACE.data) == f"Observations({len(HOLED)} data)"
    assert repr(Observations(HOLED, DEPTH, WEIGHTS)) == f"Observations({len(HOLED)} data, weighted)"
    assert repr(ErrorCurve(np.array([1.0, 2.0]), np.array([0.5, 4.0]))) == "ErrorCurve(0.5 at 1 to 4 at 2)"
    assert repr(SURFACE.error_curves).startswith("ErrorCurves(inside=ErrorCurve(")
    assert repr(SURFACE.interval(POINTS)).startswith("Interval(120 points, median width 0.")


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_what_could_not_be_tested_is_not_covered(unit):
    points = unit * np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 3.0], [3.0, 4.0]])
    surface = mx.fit_surface(points, [0.0, 1.0, 2.0, 4.0], points)
    assert np.isinf(surface.error(points)).all()
    assert not surface.covers([*points, points.mean(axis=0)]).any()
