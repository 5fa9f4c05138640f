"""Selections over counts and weights of smoothing, against a plain refit for every entry of their maps."""

import math
import weakref

import numpy as np
import pytest
from designs import nested_warp_design, surface_design, warp_design
from refits import Problem

import mexpress as mx
from mexpress.leastsquares.model import LeastSquares
from mexpress.liftings import ThinPlateSpline, lifting_named
from mexpress.placement import area, covered_region, farthest_first, lloyd
from mexpress.selection.weights import smoothing_weights

RNG = np.random.default_rng(0)
N = 30
SOURCE = RNG.uniform(0, 1, (N, 2)) * [640, 480]
BEND = 20 * np.column_stack([np.sin(SOURCE[:, 0] / 120), np.cos(SOURCE[:, 1] / 150)])
TARGET = 1.3 * SOURCE + 50 + BEND + RNG.normal(size=(N, 2))
DEPTH = np.sin(SOURCE[:, 0] / 120) + 0.1 * RNG.normal(size=N)
NAMES = ["FIT", "CMPRESS", "ER10", "KF5", "GCV", "AIC"]
REGION = covered_region(SOURCE)
UNIT = N * area(REGION)
WEIGHTS = [0.0, *(UNIT * np.array([1e-6, 1e-3, 1.0, 100.0]))]


def schemes():
    diagonal = float(np.hypot(*np.ptp(SOURCE, axis=0)))
    return {
        "CMPRESS": mx.schemes.leave_one_out(N),
        "ER10": mx.schemes.exclusion_radius(SOURCE, 0.1 * diagonal),
        "KF5": mx.schemes.k_fold(N, 5, 0),
    }


def refit(design, weight):
    """Every criterion of one model, from its definition, its trace(H), and its solution; None if it has none."""
    Z = math.sqrt(weight) * design.bending()
    labels = np.repeat(np.arange(N), design.coupling)
    problem = Problem(design.A, design.b, labels, penalty=Z)
    if problem.rank < design.A.shape[1]:
        return None, math.nan, None
    m, r = len(design.A), design.b.size // len(design.A)
    scale = np.linalg.norm(np.vstack([design.A, Z]), axis=0)
    inverse = np.linalg.pinv(np.vstack([design.A, Z]) / scale)[:, :m]
    x = ((inverse @ design.b).T / scale).T
    used = r * np.trace(design.A / scale @ inverse)
    rss = ((design.b - design.A @ x) ** 2).sum()
    found = {name: problem.score(scheme) for name, scheme in schemes().items()}
    found["FIT"] = math.sqrt(rss / N)
    found["GCV"] = math.sqrt(rss / N) / (1 - used / (r * m))
    found["AIC"] = r * m * math.log(rss / (r * m)) + 2 * used
    return found, used, x


def check_maps(selection, design_of, where):
    """Every entry of the maps is that of a refit."""
    assert set(selection.maps) == set(NAMES)
    for k, count in enumerate(selection.counts.tolist()):
        design = design_of(count)
        for w, weight in enumerate(selection.weights.tolist()):
            expected, used, _ = refit(design, weight)
            if expected is None:
                assert np.isnan(selection.parameters[k, w])
                assert all(np.isnan(found[k, w]) for found in selection.maps.values())
                continue
            assert selection.parameters[k, w] == pytest.approx(used, rel=1e-9), (count, weight)
            for name, value in expected.items():
                got = selection.maps[name][k, w]
                assert got == pytest.approx(value, rel=1e-9, nan_ok=True), (name, count, weight)
    k, w = selection.place
    _, _, x = refit(design_of(selection.count), selection.smoothing)
    model = design_of(selection.count).model(x)
    got = selection.warp if hasattr(selection, "warp") else selection.surface
    assert got.smoothing == selection.smoothing == selection.weights[w]
    np.testing.assert_allclose(got(where), model(where), rtol=1e-8)
    own = selection.least_squares()
    for name, scheme in schemes().items():
        assert own.cross_validate(scheme).score == pytest.approx(selection.maps[name][k, w], rel=1e-9)


WHERE = np.random.default_rng(1).uniform(-20, 500, (40, 2))


@pytest.mark.parametrize("fractional", [True, False])
@pytest.mark.parametrize("counts", [[3, 6, 9], [3, 4, 6, 8, 9]], ids=["one by one", "together"])
@pytest.mark.parametrize("placement", ["lloyd", "nested"])
def test_maps_of_warps_are_refits(placement, counts, fractional):
    selection = mx.select_warp(
        SOURCE,
        TARGET,
        "CMPRESS",
        NAMES,
        fractional=fractional,
        counts=counts,
        placement=placement,
        smoothing=WEIGHTS,
    )
    np.testing.assert_array_equal(selection.counts, counts)
    np.testing.assert_array_equal(selection.weights, WEIGHTS)
    ordered = SOURCE[farthest_first(SOURCE, 9)]

    def design(count):
        points = lloyd(SOURCE, count, 0) if placement == "lloyd" else ordered[:count]
        return warp_design(ThinPlateSpline(points), SOURCE, TARGET, fractional, placement == "nested")

    check_maps(selection, design, WHERE)


@pytest.mark.parametrize("fractional", [True, False])
@pytest.mark.parametrize("lifting", ["bspline", "affine"])
def test_maps_of_warps_on_grids_are_refits(lifting, fractional):
    functions = lifting_named(lifting)
    selection = mx.select_warp(
        SOURCE, TARGET, "CMPRESS", NAMES, lifting, fractional, counts=[16, 20], smoothing=WEIGHTS[1:]
    )

    def design(count):
        return warp_design(functions(functions.place(REGION, count)), SOURCE, TARGET, fractional)

    check_maps(selection, design, WHERE)


@pytest.mark.parametrize("values", [DEPTH, np.column_stack([SOURCE, DEPTH])], ids=["depth", "space"])
@pytest.mark.parametrize("placement", ["residual", "nested", "lloyd"])
def test_maps_of_surfaces_are_refits(placement, values):
    selection = mx.select_surface(
        SOURCE, values, "CMPRESS", NAMES, max_count=9, placement=placement, smoothing=WEIGHTS
    )
    assert selection.counts.tolist() == list(range(3, 10))

    def design(count):
        points = lloyd(SOURCE, count, 0) if placement == "lloyd" else selection.control_points[:count]
        return surface_design(ThinPlateSpline(points), SOURCE, values)

    if placement == "nested":
        np.testing.assert_array_equal(selection.control_points, SOURCE[farthest_first(SOURCE, 9)])
    check_maps(selection, design, WHERE)


@pytest.mark.parametrize("lifting", ["bspline", "affine"])
def test_maps_of_surfaces_on_grids_are_refits(lifting):
    functions = lifting_named(lifting)
    selection = mx.select_surface(
        SOURCE, DEPTH, "CMPRESS", NAMES, max_count=20, lifting=lifting, smoothing=WEIGHTS[1:]
    )
    assert selection.counts.tolist() == functions.counts(REGION, 20)

    def design(count):
        return surface_design(functions(functions.place(REGION, count)), SOURCE, DEPTH)

    check_maps(selection, design, WHERE)


# Nested placement


@pytest.mark.parametrize("fractional", [True, False])
def test_leading_parts_of_nested_warps_are_the_warps_of_their_control_points(fractional):
    ordered = SOURCE[farthest_first(SOURCE, 9)]
    nested = nested_warp_design(SOURCE, TARGET, ordered, fractional)
    for count in range(3, 10):
        single = warp_design(ThinPlateSpline(ordered[:count]), SOURCE, TARGET, fractional, over_data=True)
        columns = nested.columns(count)
        assert columns == single.A.shape[1]
        for weight in (0.0, 1e-4 * UNIT, UNIT):
            Z = math.sqrt(weight) * nested.bending()[:, :columns]
            part = mx.LeastSquares(nested.A[:, :columns], nested.b, nested.coupling, penalty=Z)
            whole = mx.LeastSquares(
                single.A, single.b, single.coupling, penalty=math.sqrt(weight) * single.bending()
            )
            size = np.abs(single.b).max()
            np.testing.assert_allclose(part.residuals, whole.residuals, rtol=0, atol=1e-9 * size)
            one, two = (
                nested.model(part.coefficients, count, weight),
                single.model(whole.coefficients, smoothing=weight),
            )
            np.testing.assert_allclose(one(WHERE), two(WHERE), rtol=1e-9)
            assert one.smoothing == two.smoothing == weight


@pytest.mark.parametrize("kind", ["fractional", "not", "surface"])
def test_counts_together_and_one_by_one_are_the_same(kind):
    # Three counts are judged one by one, four together.
    def select(counts):
        options = {"placement": "nested", "smoothing": WEIGHTS}
        if kind == "surface":
            return mx.select_surface(SOURCE, DEPTH, "ER10", NAMES, max_count=counts[-1], **options)
        return mx.select_warp(
            SOURCE, TARGET, "ER10", NAMES, fractional=kind == "fractional", counts=counts, **options
        )

    few, many = select([3, 4, 5]), select(range(3, 10))
    for name, found in few.maps.items():
        np.testing.assert_allclose(many.maps[name][:3], found, rtol=1e-9, err_msg=name)
    np.testing.assert_allclose(many.parameters[:3], few.parameters, rtol=1e-9)
    np.testing.assert_array_equal(few.weights, many.weights)


# What is selected


def by_hand(parameters, slack=0.0, name="GCV"):
    scores = np.array([[4.0, 3.0, 3.05], [3.1, 2.95, 3.3], [np.nan, 3.2, 2.9]])
    weights = np.array([0.0, 1.0, 10.0])
    return mx.Selection(
        name, np.array([3, 5, 9]), {name: scores}, {}, weights=weights, parameters=parameters, slack=slack
    )


PARAMETERS = np.array([[6.0, 5.0, 4.0], [10.0, 7.0, 4.5], [np.nan, 8.0, 9.0]])


def test_the_smallest_score_of_all_counts_and_weights_is_selected():
    found = by_hand(PARAMETERS)
    assert (found.count, found.smoothing, found.score, found.place) == (9, 10.0, 2.9, (2, 2))
    assert found.selected == {"GCV": 9}
    assert found.selected_smoothing == {"GCV": 10.0}
    np.testing.assert_array_equal(found.curves["GCV"], [3.0, 2.95, 2.9])
    assert [found.best_weight(k) for k in range(3)] == [1, 1, 2]


@pytest.mark.parametrize(
    ("slack", "place"), [(0.001, (2, 2)), (0.02, (1, 1)), (0.04, (0, 1)), (0.06, (0, 2)), (0.5, (0, 2))]
)
def test_of_scores_within_the_slack_the_fewest_parameters_are_selected(slack, place):
    found = by_hand(PARAMETERS, slack)
    assert found.place == place
    assert found.best_weight(place[0]) == place[1]
    # Information criteria have no zero: a fraction of them means nothing.
    assert by_hand(PARAMETERS, slack, "AIC").place == (2, 2)
    assert by_hand(None, slack).place == (2, 2)


@pytest.mark.parametrize("smoothing", [WEIGHTS, "auto"])
@pytest.mark.parametrize("kind", ["warp", "surface"])
def test_selections_keep_the_rule(kind, smoothing):
    options = {"criteria": NAMES, "smoothing": smoothing}
    found = (
        mx.select_warp(SOURCE, TARGET, **options)
        if kind == "warp"
        else mx.select_surface(SOURCE, DEPTH, **options)
    )
    auto = smoothing == "auto"
    assert found.criterion == ("MATCHED" if auto else "ER10")
    assert found.slack == (math.sqrt(1 + 1 / N) - 1 if auto else 0)
    for name, scores in found.maps.items():
        if name in {"AIC", "BIC"} or not auto:
            k, w = np.unravel_index(np.nanargmin(scores), scores.shape)
        else:
            # One datum's share of the sum of squares.
            near = scores**2 <= np.nanmin(scores) ** 2 * (1 + 1 / N) * (1 + 1e-12)
            k, w = np.unravel_index(np.nanargmin(np.where(near, found.parameters, np.nan)), scores.shape)
        assert (found.selected[name], found.selected_smoothing[name]) == (found.counts[k], found.weights[w])
    model = found.warp if kind == "warp" else found.surface
    assert len(model.control_points) == found.count == found.selected[found.criterion]
    assert model.smoothing == found.smoothing == found.selected_smoothing[found.criterion]


def test_auto_tries_two_counts_and_twenty_weights():
    found = mx.select_warp(SOURCE, TARGET, smoothing="auto")
    assert found.counts.tolist() == [3, N]
    assert found.placement == "nested"
    np.testing.assert_array_equal(found.weights, smoothing_weights("auto", N, area(REGION), N))
    assert (np.diff(found.weights) > 0).all()
    assert found.weights[[0, -1]] == pytest.approx([1e-3 * UNIT / N**2, 100 * UNIT])
    # Nothing to gain at the ends: there the map is flat.
    scores = found.maps["CMPRESS"][1]
    assert scores[-1] == pytest.approx(scores[-2], rel=0.01)
    assert np.nanmin(scores) < 0.9 * min(scores[-1], found.maps["CMPRESS"][0, 0])


def test_a_list_of_weights_is_sorted_and_without_repetitions():
    found = mx.select_warp(SOURCE, TARGET, "CMPRESS", counts=[3, 6], smoothing=[1e5, 0, 10, 10.0])
    assert found.weights.tolist() == [0, 10, 1e5]


@pytest.mark.parametrize("placement", ["lloyd", "nested"])
def test_one_weight_alone_is_that_weight_among_others(placement):
    options = {"criterion": "CMPRESS", "counts": [3, 6, 9], "placement": placement}
    found = mx.select_warp(SOURCE, TARGET, smoothing=WEIGHTS, **options)
    for w, weight in enumerate(WEIGHTS):
        alone = mx.select_warp(SOURCE, TARGET, smoothing=weight, **options)
        assert alone.weights.tolist() == [weight]
        for name, curve in alone.curves.items():
            np.testing.assert_allclose(found.maps[name][:, w], curve, rtol=1e-9)


# Units, seeds and threads


@pytest.mark.parametrize(("scale", "shift"), [(1000.0, 0.0), (1e-3, 0.0), (1.0, 1e5), (2.0**20, -3e7)])
@pytest.mark.parametrize("fractional", [True, False])
def test_units_and_places_of_pixels_do_not_matter_to_auto(fractional, scale, shift):
    options = {"fractional": fractional, "smoothing": "auto"}
    plain = mx.select_warp(SOURCE, TARGET, **options)
    moved = mx.select_warp(scale * SOURCE + shift, scale * TARGET - shift, **options)
    assert moved.place == plain.place
    assert moved.selected == plain.selected
    np.testing.assert_allclose(moved.weights, scale**2 * plain.weights, rtol=1e-9)
    for name, found in plain.maps.items():
        np.testing.assert_allclose(moved.maps[name] / scale, found, rtol=1e-6, err_msg=name)
    expected = scale * plain.warp(WHERE) - shift
    np.testing.assert_allclose(moved.warp(scale * WHERE + shift), expected, rtol=1e-6, atol=1e-6 * scale)


@pytest.mark.parametrize(("scale", "unit"), [(1000.0, 1.0), (1.0, 1e-6), (1e-3, 1e6)])
def test_units_do_not_matter_to_auto_for_surfaces(scale, unit):
    plain = mx.select_surface(SOURCE, DEPTH, smoothing="auto")
    moved = mx.select_surface(scale * SOURCE, unit * DEPTH, smoothing="auto")
    assert moved.place == plain.place
    np.testing.assert_allclose(
        moved.surface(scale * WHERE), unit * plain.surface(WHERE), rtol=1e-8, atol=1e-8 * unit
    )


def same(one, two):
    assert one.place == two.place
    assert one.selected == two.selected
    for name, found in one.maps.items():
        np.testing.assert_array_equal(found, two.maps[name], err_msg=name)
    np.testing.assert_array_equal(one.parameters, two.parameters)


@pytest.mark.parametrize("counts", [None, [3, 4, 6, 8, 9]], ids=["one by one", "together"])
@pytest.mark.parametrize("smoothing", [WEIGHTS, "auto"])
def test_threads_do_not_matter_and_seeds_do(smoothing, counts):
    def select(seed=0, threads=1):
        options = {"smoothing": smoothing, "counts": counts, "seed": seed, "threads": threads}
        return mx.select_warp(SOURCE, TARGET, "ER10", [*NAMES, "MATCHED"], **options)

    one, two = select(), select(threads=2)
    same(one, two)
    np.testing.assert_array_equal(one.warp.parameters, two.warp.parameters)
    assert (select(seed=1).maps["KF5"] != one.maps["KF5"]).any()


def test_threads_do_not_matter_to_surfaces():
    one, two = (
        mx.select_surface(SOURCE, DEPTH, "ER10", NAMES, 9, smoothing=WEIGHTS, threads=k) for k in (1, 2)
    )
    same(one, two)
    np.testing.assert_array_equal(one.surface.parameters, two.surface.parameters)


# What the data leave open


def two_corners():
    """Matches near two opposite corners of the image: cells of a grid between them are empty."""
    rng = np.random.default_rng(3)
    source = np.vstack([rng.uniform(0, 100, (40, 2)), rng.uniform(500, 600, (40, 2))])
    return source, 1.2 * source + rng.normal(size=source.shape)


@pytest.mark.parametrize("fractional", [True, False])
def test_empty_cells_are_open_without_smoothing_and_said_to_be_with_it(fractional):
    source, target = two_corners()
    options = {"lifting": "bspline", "fractional": fractional, "counts": [49], "criteria": ["FIT", "AIC"]}
    with pytest.raises(ValueError, match=r'determine a warp of 49 control points.* smoothing="auto"'):
        mx.select_warp(source, target, "CMPRESS", smoothing=0, **options)
    found = mx.select_warp(source, target, "CMPRESS", smoothing=[0.0, 10.0], **options)
    functions = lifting_named("bspline")
    (count,) = found.counts.tolist()
    design = warp_design(
        functions(functions.place(covered_region(source), count)), source, target, fractional
    )
    missing = design.A.shape[1] - int(np.linalg.matrix_rank(design.A))
    assert missing > 0
    assert found.open == {count: missing}
    assert found.smoothing == 10
    assert found.undefined == {}
    for scores in (*found.maps.values(), found.parameters):
        assert np.isnan(scores[0, 0])
        assert np.isfinite(scores[0, 1])
    assert found.parameters[0, 1] <= 2 * np.linalg.matrix_rank(design.A)
    assert np.abs(found.warp(source) - target).max() < 5


def test_the_data_that_need_smoothing_are_said_for_surfaces_too():
    source, _ = two_corners()
    values = np.sin(source[:, 0] / 50)
    found = mx.select_surface(
        source, values, "CMPRESS", lifting="bspline", max_count=49, smoothing=[0.0, 1.0]
    )
    assert found.open
    assert set(found.open) < set(found.counts.tolist())
    functions = lifting_named("bspline")
    for count in found.counts.tolist():
        basis = functions(functions.place(covered_region(source), count)).basis(source)
        assert found.open.get(count, 0) == count - np.linalg.matrix_rank(basis)


def test_data_that_determine_everything_leave_nothing_open():
    for placement in ("lloyd", "nested"):
        found = mx.select_warp(SOURCE, TARGET, "CMPRESS", placement=placement, smoothing=WEIGHTS)
        assert found.open == {}
    # As many control points as matches: 89 unknowns, 60 equations.
    assert mx.select_warp(SOURCE, TARGET, smoothing="auto").open == {N: 29}


@pytest.mark.parametrize("lifting", ["bspline", "affine"])
def test_fits_that_are_not_determined_say_that_smoothing_helps(lifting):
    source, target = two_corners()
    centres = lifting_named(lifting).place(covered_region(source), 49)
    for fit, name in ((mx.fit_warp, "warp"), (mx.fit_surface, "surface")):
        with pytest.raises(
            ValueError, match=rf"^Invalid control_points\. .*determine the {name}, .*smoothing above 0"
        ):
            fit(source, target, centres, lifting)
        model = fit(source, target, centres, lifting, smoothing=1.0)
        assert model.smoothing == 1
        assert np.abs(model(source) - target).max() < 5


# Fits with control points of one's own


@pytest.mark.parametrize("smoothing", [10.0, [0.0, 10.0, 1e5], "auto"])
@pytest.mark.parametrize("fractional", [True, False])
def test_fits_choose_what_selections_choose(fractional, smoothing):
    options = {"fractional": fractional, "smoothing": smoothing, "criterion": "CMPRESS"}
    found = mx.select_warp(SOURCE, TARGET, counts=[9], placement="lloyd", **options)
    fit = mx.fit_warp(SOURCE, TARGET, lloyd(SOURCE, 9, 0), **options)
    assert fit.smoothing == found.smoothing
    np.testing.assert_allclose(fit.parameters, found.warp.parameters, rtol=1e-9)
    surface = mx.select_surface(
        SOURCE, DEPTH, "CMPRESS", lifting="bspline", max_count=16, smoothing=smoothing
    )
    fit = mx.fit_surface(
        SOURCE, DEPTH, surface.control_points, "bspline", smoothing=smoothing, criterion="CMPRESS"
    )
    assert (surface.counts.tolist(), fit.smoothing) == ([16], surface.smoothing)
    np.testing.assert_allclose(fit(WHERE), surface.surface(WHERE), rtol=1e-9)


def test_the_criterion_of_a_fit_decides_and_matched_is_the_default():
    centres = lloyd(SOURCE, 20, 0)
    chosen = {
        name: mx.fit_surface(SOURCE, DEPTH, centres, smoothing="auto", criterion=name).smoothing
        for name in (None, "MATCHED", "FIT", "ER40")
    }
    assert chosen[None] == chosen["MATCHED"]
    assert chosen["FIT"] < chosen["ER40"]


def test_a_fit_keeps_its_weight_in_its_file(tmp_path):
    warp = mx.fit_warp(SOURCE, TARGET, SOURCE[:8], smoothing="auto")
    assert warp.smoothing > 0
    warp.save(tmp_path / "warp.npz")
    assert mx.load(tmp_path / "warp.npz").smoothing == warp.smoothing


def test_the_fits_of_a_design_are_not_kept_beside_each_other(monkeypatch):
    living, most = weakref.WeakSet(), []
    made = LeastSquares._of.__func__

    def counted(*given):
        model = made(*given)
        living.add(model)
        most.append(len(living))
        return model

    monkeypatch.setattr(LeastSquares, "_of", classmethod(counted))
    mx.select_warp(SOURCE, TARGET, "CMPRESS", smoothing="auto")
    assert len(most) == 20  # of the larger design; the smaller one has nothing to bend
    assert max(most) <= 2


def test_automatic_weights_suit_the_wished_counts_of_warps_and_the_placed_ones_of_surfaces():
    source = np.vstack([SOURCE, SOURCE[:10]])
    target, n = np.vstack([TARGET, TARGET[:10] + 0.1]), N + 10
    warps, surfaces = (
        mx.select_warp(source, target, smoothing="auto"),
        mx.select_surface(source, target, smoothing="auto"),
    )
    assert warps.counts[-1] == surfaces.counts[-1] == N
    for selection, count in ((warps, n), (surfaces, N)):
        np.testing.assert_array_equal(
            selection.weights, smoothing_weights("auto", n, area(covered_region(source)), count)
        )
