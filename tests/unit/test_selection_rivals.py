"""Models beside the grid: plain maps, and piecewise affine ones where queries are far. Weights of the data."""

import numpy as np
import pytest

import mexpress as mx
from mexpress.liftings import PiecewiseAffine
from mexpress.placement import farthest_first
from mexpress.schemes import Places
from mexpress.selection.candidates import CriteriaRequest
from mexpress.selection.data import Matches, Samples
from mexpress.selection.queries import Queries
from mexpress.selection.rivals import Entrant

RNG = np.random.default_rng(7)
N = 24
SOURCE = RNG.uniform(0, 1, (N, 2)) * [640, 480]
NOISE = RNG.normal(size=(N, 2))
AFFINE = SOURCE @ np.array([[1.2, 0.1], [-0.2, 0.9]]) + [30, -5]
SIDEWAYS = np.column_stack([1 + SOURCE[:, 0] / 400, np.ones(N)]).prod(axis=1)[:, None]


def squares(points, values, surface, scheme):
    """Squared held-out errors of a surface, from a refit for every datum."""
    basis = surface.lifting.basis(points)
    rows = np.sqrt(surface.smoothing) * surface.lifting.bending()
    errors = np.empty(len(points))
    for held, (i,) in zip(scheme.held_out, scheme.validated, strict=True):
        rest = np.setdiff1d(np.arange(len(points)), held)
        A, b = np.vstack([basis[rest], rows]), np.concatenate([values[rest], np.zeros(len(rows))])
        errors[i] = values[i] - basis[i] @ np.linalg.lstsq(A, b, rcond=None)[0]
    return errors**2


def test_few_affine_matches_get_an_affine_map():
    selection = mx.select_warp(SOURCE, AFFINE + NOISE)
    assert selection.rival == "affine map"
    assert (selection.count, selection.smoothing, selection.effective_parameters) == (
        3,
        0.0,
        pytest.approx(6),
    )
    assert not selection.warp.fractional
    assert repr(selection).startswith(
        "WarpSelection(MATCHED chooses the affine map before 3 to 24 control points"
    )
    design = np.column_stack([SOURCE, np.ones(N)])
    by_refits = []
    for i in range(N):
        rest = np.delete(np.arange(N), i)
        x = np.linalg.lstsq(design[rest], (AFFINE + NOISE)[rest], rcond=None)[0]
        by_refits.append((AFFINE + NOISE)[i] - design[i] @ x)
    expected = np.sqrt((np.array(by_refits) ** 2).sum(axis=1).mean())
    assert selection.rivals["affine map"].curves["CMPRESS"][0] == pytest.approx(expected, rel=1e-9)
    x = np.linalg.lstsq(design, AFFINE + NOISE, rcond=None)[0]
    np.testing.assert_allclose(selection.warp(SOURCE), design @ x, rtol=1e-9)
    assert selection.least_squares().fit_rms == pytest.approx(selection.rivals["affine map"].curves["FIT"][0])


def test_perspective_is_no_affine_map():
    selection = mx.select_warp(SOURCE, (AFFINE + 0.1 * NOISE) / SIDEWAYS)
    assert selection.rival is None
    assert selection.warp.fractional
    assert selection.score < selection.rivals["affine map"].score / 5


@pytest.mark.parametrize("lifting", ["bspline", "affine"])
def test_other_liftings_have_both_plain_maps(lifting):
    flat = mx.select_warp(SOURCE, (AFFINE + 0.1 * NOISE) / SIDEWAYS, lifting=lifting)
    assert set(flat.rivals) == {"affine map", "homography"}
    assert flat.rivals["homography"].score < flat.rivals["affine map"].score / 5
    plane = mx.select_surface(SOURCE, AFFINE[:, 0] + NOISE[:, 0], lifting=lifting)
    assert set(plane.rivals) == {"plane"}
    assert plane.rival == "plane"
    assert len(plane.control_points) == 3


@pytest.mark.parametrize("options", [{"smoothing": 0}, {"smoothing": [0.0, 1e5]}, {"counts": [5, 9]}])
def test_what_is_asked_for_has_no_rivals(options):
    selection = mx.select_warp(SOURCE, AFFINE + NOISE, **options)
    assert (selection.rivals, selection.rival) == ({}, None)


def test_without_perspective_the_grid_has_the_affine_map():
    selection = mx.select_warp(SOURCE, AFFINE + NOISE, fractional=False)
    assert selection.rivals == {}
    assert selection.count == 3


def entrant(squares, parameters, **more):
    errors = {name: np.sqrt(each) for name, each in {"MATCHED": squares, **more}.items()}
    return Entrant(None, float(np.sqrt(squares.mean())), parameters, None, errors)


def requested(weights=None):
    return CriteriaRequest("MATCHED", ["MATCHED"], Samples.of(POINTS, POINTS[:, 0], weights))


POINTS = RNG.uniform(0, 1, (100, 2))
STEPS = np.where(np.arange(100) % 2, 1.0, -1.0)  # with a mean of zero and a standard error of 0.1


def test_a_flexible_model_must_be_better_by_its_standard_error():
    old, request = entrant(np.full(100, 10.0), 9), requested()
    assert entrant(10 - 0.101 + STEPS, 9).surely_better_than(old, request)
    assert not entrant(10 - 0.099 + STEPS, 9).surely_better_than(old, request)
    assert not old.surely_better_than(old, request)


def test_a_simple_model_may_be_worse_by_half_its_standard_error():
    other = np.full(100, 5.0)
    old, request = entrant(np.full(100, 10.0), 9, CMPRESS=other), requested()
    assert entrant(10 + 0.049 + STEPS, 6, CMPRESS=other).may_replace(old, request)
    assert not entrant(10 + 0.051 + STEPS, 6, CMPRESS=other).may_replace(old, request)
    assert not entrant(10 + 0.049 + STEPS, 10, CMPRESS=other).may_replace(old, request)


def test_leave_one_out_has_a_say():
    old, request = entrant(np.full(100, 10.0), 9, CMPRESS=np.full(100, 5.0)), requested()
    for worse, replaces in ((0.049, True), (0.051, False)):
        assert entrant(9 + STEPS, 6, CMPRESS=5 + worse + STEPS).may_replace(old, request) == replaces


def test_differences_are_weighted():
    weights = np.where(np.arange(100) < 50, 1.0, 3.0)
    change = np.where(np.arange(100) < 50, 2.0, -1.0)
    old = entrant(np.full(100, 10.0), 9)
    assert not entrant(10 + change, 9).surely_better_than(old, requested())
    assert entrant(10 + change, 9).surely_better_than(old, requested(weights)) == (
        np.mean(change * weights / 2) + np.std(change * weights / 2) / 10 < 0
    )


def test_what_is_shown_does_not_matter():
    bent = AFFINE + 5 * np.sin(SOURCE / 90) + NOISE
    shown = mx.select_warp(SOURCE, bent, criteria=["CMPRESS", "ER10"])
    bare = mx.select_warp(SOURCE, bent, criteria=[])
    assert set(bare.maps) == {"MATCHED"}
    assert set(bare.rivals["affine map"].maps) == {"MATCHED"}
    assert (bare.rival, bare.place) == (shown.rival, shown.place)


# Queries


def test_queries_between_the_data_change_nothing():
    points = RNG.uniform(0, 100, (80, 2))
    values = np.sin(points[:, 0] / 12) + 0.05 * RNG.normal(size=80)
    plain = mx.select_surface(points, values)
    near = mx.select_surface(points, values, queries=RNG.uniform(10, 90, (500, 2)))
    for name, scores in plain.maps.items():
        np.testing.assert_array_equal(near.maps[name], scores)
    assert near.rivals == {}


def gap():
    """Waves with a disc cut out, and places in the disc."""
    points = RNG.uniform(0, 100, (260, 2))
    points = points[np.hypot(*(points - 50).T) > 25]
    values = np.sin(points[:, 0] / 9) * np.cos(points[:, 1] / 11) + 0.02 * RNG.normal(size=len(points))
    inside = RNG.uniform(25, 75, (600, 2))
    return points, values, inside[np.hypot(*(inside - 50).T) < 22]


def test_far_queries_are_matched_to():
    points, values, places = gap()
    selection = mx.select_surface(points, values, queries=places)
    scheme = mx.schemes.matched(points, places)
    fit = selection.least_squares()
    assert selection.score == pytest.approx(fit.cross_validate(scheme).score, rel=1e-9)
    assert scheme.held_out.sizes.mean() > 5
    assert set(selection.rivals) == {"piecewise affine"}
    assert selection.score > 1.5 * mx.select_surface(points, values).score


@pytest.mark.parametrize("flat", [False, True])
def test_piecewise_affine_models_win_where_they_are_surely_better(flat):
    points, values, places = gap()
    x, y = points.T
    # Splines overshoot beside a fold into the gap.
    depth = np.abs(x - 50) + np.abs(y - 45) + 0.1 * values if flat else values
    selection = mx.select_surface(points, depth, queries=places)
    scheme = mx.schemes.matched(points, places)
    k, w = selection.place
    centres = points[farthest_first(points, int(selection.counts[k]))]
    spline = mx.fit_surface(points, depth, centres, smoothing=float(selection.weights[w]))
    rival = selection.rivals["piecewise affine"]
    a, v = rival.place
    grid = PiecewiseAffine.place_over(Samples.of(points, depth).domain, int(rival.counts[a]), 0, 1)
    pieces = mx.fit_surface(points, depth, grid, "affine", smoothing=float(rival.weights[v]))
    old, new = (squares(points, depth, each, scheme) for each in (spline, pieces))
    assert np.sqrt(old.mean()) == pytest.approx(selection.maps["MATCHED"][k, w], rel=1e-8)
    assert np.sqrt(new.mean()) == pytest.approx(rival.score, rel=1e-8)
    d = new - old
    better = d.mean() + d.std() / np.sqrt(len(d)) < 0
    assert better == flat
    assert selection.rival == ("piecewise affine" if better else None)
    chosen = pieces if better else spline
    np.testing.assert_allclose(selection.surface(places), chosen(places), atol=1e-8 * np.ptp(depth))


def test_queries_are_points_a_rectangle_or_the_image():
    matches = Matches.of(SOURCE, AFFINE, (640, 480))
    everywhere = Queries.of("image", matches)
    rectangle = Queries.of((0, 0, 640, 480), matches)
    np.testing.assert_array_equal(everywhere.points, rectangle.points)
    assert len(everywhere.points) == pytest.approx(2000, rel=0.05)
    assert (everywhere.points.min(axis=0) > 0).all()
    assert (everywhere.points.max(axis=0) < [640, 480]).all()
    assert Queries.of([[5000, 5000]], matches).far
    assert not Queries.of(SOURCE, matches).far


@pytest.mark.parametrize(("away", "far"), [(1.4, False), (1.6, True)])
def test_near_ends_at_one_and_a_half_times_the_usual_distance(away, far):
    x, y = np.meshgrid(np.arange(10.0), np.arange(10.0))
    grid = np.column_stack([x.ravel(), y.ravel()])
    below = np.column_stack([np.arange(10.0), np.full(10, -away)])
    assert Queries.of(below, Samples.of(grid, grid[:, 0])).far == far
    tail = np.vstack([np.repeat(grid, 2, axis=0)[:80], below])  # only the farthest tenth is far
    assert Queries.of(tail, Samples.of(grid, grid[:, 0])).far == far


@pytest.mark.parametrize(
    "wrong",
    [
        "everywhere",
        [1.0, 2.0],
        (5, 0, 1, 3),
        np.zeros((0, 2)),
        np.zeros((3, 3)),
        [[np.nan, 1.0]],
        3.0,
        {1: 2},
    ],
)
def test_other_queries_are_refused(wrong):
    with pytest.raises((ValueError, TypeError), match=r"^Invalid queries\. "):
        mx.select_warp(SOURCE, AFFINE, queries=wrong)


def test_a_surface_has_no_image():
    with pytest.raises(ValueError, match=r"^Invalid queries\. "):
        mx.select_surface(SOURCE, AFFINE[:, 0], queries="image")


# Weights


@pytest.mark.parametrize("options", [{}, {"smoothing": 0}, {"smoothing": 0, "placement": "nested"}])
def test_a_weight_of_zero_is_absence(options):
    target = AFFINE + 20 * np.sin(SOURCE / 90) + NOISE
    weights = np.ones(N)
    weights[[3, 8]] = 0
    moved, places = target.copy(), SOURCE.copy()
    moved[3], places[8] = [1e6, -1e6], [-4000, 9000]
    whole = mx.select_warp(places, moved, weights=weights, **options)
    kept = np.flatnonzero(weights)
    part = mx.select_warp(SOURCE[kept], target[kept], weights=weights[kept], **options)
    assert whole.counts.tolist() == part.counts.tolist()
    for name, scores in part.maps.items():
        np.testing.assert_array_equal(whole.maps[name], scores)
    np.testing.assert_array_equal(whole.warp.parameters, part.warp.parameters)
    assert whole.least_squares().n_data == N - 2
    assert len(whole.source) == N
    for name, by_count in part.undefined.items():
        for count, lost in by_count.items():
            np.testing.assert_array_equal(whole.undefined[name][count], kept[lost])


@pytest.mark.parametrize("smoothing", ["auto", 0, [0.0, 3e5]])
def test_weights_reach_the_scores(smoothing):
    values = np.sin(SOURCE[:, 0] / 90) + 0.1 * NOISE[:, 0]
    weights = RNG.uniform(0.2, 3, N)
    selection = mx.select_surface(SOURCE, values, "CMPRESS", smoothing=smoothing, weights=weights)
    basis = selection.surface.lifting.basis(SOURCE)
    rows = np.sqrt(selection.smoothing) * selection.surface.lifting.bending()
    total = 0.0
    for i in range(N):
        rest = np.delete(np.arange(N), i)
        roots = np.sqrt(weights[rest])
        A = np.vstack([roots[:, None] * basis[rest], rows])
        b = np.concatenate([roots * values[rest], np.zeros(len(rows))])
        total += weights[i] * (values[i] - basis[i] @ np.linalg.lstsq(A, b, rcond=None)[0]) ** 2
    assert selection.score == pytest.approx(np.sqrt(total / weights.sum()), rel=1e-8)


def test_the_unit_of_weights_does_not_matter():
    values = np.sin(SOURCE[:, 0] / 90) + 0.1 * NOISE[:, 0]
    weights = RNG.uniform(0.2, 3, N)
    one, other = (mx.select_surface(SOURCE, values, weights=s * weights) for s in (1.0, 1e6))
    assert one.count == other.count
    np.testing.assert_allclose(other.weights, 1e6 * one.weights)
    np.testing.assert_allclose(other.maps["MATCHED"], one.maps["MATCHED"], rtol=1e-9)
    np.testing.assert_allclose(other.surface.parameters, one.surface.parameters, rtol=1e-7)


def test_equal_weights_are_none():
    one, other = (
        mx.select_warp(SOURCE, AFFINE + 9 * np.sin(SOURCE / 90), weights=w) for w in (None, np.ones(N))
    )
    for name, scores in one.maps.items():
        np.testing.assert_allclose(other.maps[name], scores, rtol=1e-9)


def test_schemes_of_ones_own_lose_absent_data():
    weights = np.ones(N)
    weights[[0, 5]] = 0
    kept = np.flatnonzero(weights)
    target = AFFINE + 20 * np.sin(SOURCE / 90) + NOISE
    near = mx.schemes.exclusion_radius(SOURCE, 60)
    whole = mx.select_warp(SOURCE, target, "mine", {"mine": near}, weights=weights)
    scheme = mx.schemes.exclusion_radius(SOURCE[kept], 60)
    part = mx.select_warp(SOURCE[kept], target[kept], "mine", {"mine": scheme})
    np.testing.assert_allclose(whole.maps["mine"], part.maps["mine"], rtol=1e-9)


@pytest.mark.parametrize(
    "wrong", [np.zeros(N), -np.ones(N), np.ones(N - 1), np.full(N, np.nan), "abc", np.ones((N, 1))]
)
def test_other_weights_are_refused(wrong):
    for call in (
        lambda: mx.select_warp(SOURCE, AFFINE, weights=wrong),
        lambda: mx.select_surface(SOURCE, AFFINE[:, 0], weights=wrong),
        lambda: mx.fit_warp(SOURCE, AFFINE, SOURCE[:4], weights=wrong),
        lambda: mx.fit_surface(SOURCE, AFFINE, SOURCE[:4], weights=wrong),
    ):
        with pytest.raises((ValueError, TypeError), match=r"^Invalid weights\. "):
            call()


def test_fits_take_weights():
    weights = RNG.uniform(0.2, 3, N)
    weights[4] = 0
    values = np.sin(SOURCE[:, 0] / 90)
    centres = SOURCE[farthest_first(SOURCE, 6)]
    surface = mx.fit_surface(SOURCE, values, centres, weights=weights)
    basis, roots = surface.lifting.basis(SOURCE), np.sqrt(weights)
    x = np.linalg.lstsq(roots[:, None] * basis, roots * values, rcond=None)[0]
    np.testing.assert_allclose(surface.parameters, x, rtol=1e-9)
    few = mx.fit_warp(SOURCE[:8], AFFINE[:8] + NOISE[:8], SOURCE[:3], fractional=False, weights=weights[:8])
    plain = np.column_stack([SOURCE[:8], np.ones(8)])
    x = np.linalg.lstsq(roots[:8, None] * plain, roots[:8, None] * (AFFINE[:8] + NOISE[:8]), rcond=None)[0]
    np.testing.assert_allclose(few(SOURCE[:8]), plain @ x, rtol=1e-9)


def test_what_a_caller_does_to_the_arrays_later_changes_nothing():
    source, target, weights = SOURCE.copy(), AFFINE + NOISE, np.ones(N)
    selection = mx.select_warp(source, target, weights=weights)
    before = selection.warp.error(SOURCE + 5)
    other = mx.select_warp(source, target, weights=weights)
    for array in (source, target, weights):
        array[:] = 1e3
    np.testing.assert_array_equal(other.warp.error(SOURCE + 5), before)
    assert other.least_squares().fit_rms == selection.rivals["affine map"].curves["FIT"][0]


def test_press_has_no_rivals_since_it_averages_over_rows():
    selection = mx.select_warp(SOURCE, AFFINE + NOISE, "PRESS")
    assert selection.rivals == {}
    assert selection.warp.fractional


@pytest.mark.parametrize("unit", [1e-150, 1e-9, 1e9, 1e160])
def test_the_unit_of_values_does_not_matter_to_rivals(unit):
    plain = mx.select_surface(SOURCE, AFFINE[:, 0] + NOISE[:, 0], lifting="bspline")
    scaled = mx.select_surface(SOURCE, unit * (AFFINE[:, 0] + NOISE[:, 0]), lifting="bspline")
    assert (scaled.rival, scaled.count) == (plain.rival, plain.count) == ("plane", 3)


def test_counts_above_the_number_of_the_remaining_data_are_that_number():
    weights = np.r_[np.ones(15), np.zeros(N - 15)]
    for smoothing in ("auto", 0):
        selection = mx.select_warp(
            SOURCE,
            AFFINE + NOISE,
            "GCV",
            counts=[10, 20, 23],
            weights=weights,
            smoothing=smoothing,
            fractional=False,
        )
        assert selection.counts.tolist() == [10, 15]


def test_a_rival_may_be_all_that_has_a_score(tmp_path):
    few = SOURCE[:6]
    selection = mx.select_warp(few, AFFINE[:6] + NOISE[:6], queries=(0, 0, 3000, 3000))
    assert selection.rival == "affine map"
    assert selection.notes == ()
    selection.plot(tmp_path / "curves.png")


def test_many_data_are_judged_by_some_for_far_queries():
    points = RNG.uniform(0, 100, (600, 2))
    values = np.sin(points[:, 0] / 12) + 0.05 * RNG.normal(size=600)
    places = RNG.uniform([80, 0], [180, 100], (400, 2))
    selection = mx.select_surface(points, values, queries=places, max_count=40)
    whole, order = mx.schemes.matched(points, places), Places(points).order
    some = np.sort(order[np.linspace(0, 599, 90_000 // 600).round().astype(int)])
    scheme = mx.schemes.from_sets([whole.held_out[i] for i in some], [[i] for i in some], n=600)
    expected = selection.least_squares().cross_validate(scheme).score
    assert selection.score == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("size", [1e300, 1e-300])
def test_weights_beyond_all_measure_are_refused(size):
    with pytest.raises(ValueError, match=r"^Invalid weights\. Those above 0 must be from 1e-50 to 1e\+50\. "):
        mx.select_warp(SOURCE, AFFINE, weights=np.full(N, size))


def test_nested_models_list_no_neighbourhoods(monkeypatch):
    """The lists of a whole depth map do not fit in memory."""

    def listing(*_):
        raise AssertionError("neighbourhoods were listed")

    monkeypatch.setattr(Places, "_listed", listing)
    selection = mx.select_surface(SOURCE, AFFINE[:, 0] + NOISE[:, 0], "NN03PTS", ["ER05", "FIT"], smoothing=0)
    assert set(selection.maps) == {"NN03PTS", "ER05", "FIT"}


def test_a_rival_without_a_score_says_so_where_it_is_shown():
    rival = mx.Selection("CMPRESS", np.array([3, 5]), {"CMPRESS": np.full(2, np.nan)}, {})
    assert repr(rival) == "Selection(CMPRESS has no score at 3 to 5 control points)"
    assert "CMPRESS has no score" in rival._repr_html_()
    grid = mx.Selection("CMPRESS", np.array([3]), {"CMPRESS": np.array([2.0])}, {}, rivals={"plane": rival})
    assert "CMPRESS has no score" in repr(grid.rivals)
    with pytest.raises(ValueError, match="It must have a score at one count at least"):
        _ = rival.count
