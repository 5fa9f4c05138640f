import math

import numpy as np
import pytest
from designs import warp_design
from hypothesis import given
from hypothesis import strategies as st
from refits import Problem

import mexpress as mx
from mexpress.liftings import make_lifting
from mexpress.placement import lloyd

SIZE = (640, 480)


def planted(count, fractional=True, n=120, noise=0.05, seed=0):
    """Matches of a warp with so many control points, where the selection will place its own."""
    rng = np.random.default_rng(seed)
    source = rng.uniform(0, 1, (n, 2)) * SIZE
    points = lloyd(source, count, 0)
    depth = 1 + 0.0003 * (points[:, :1] - 320) + 0.05 * rng.normal(size=(count, 1)) * (count > 3)
    values = 1.3 * points + 50 + rng.normal(0, 20, (count, 2))
    parameters = np.column_stack([values * depth, depth]) if fractional else values
    target = mx.Warp(make_lifting("tps", points), parameters, source)(source)
    return source, target + rng.normal(0, noise, (n, 2))


@pytest.mark.parametrize("criterion", ["CMPRESS", "PRESS", "ER05", "NN05PTS", "KF10", "DELAUNAY", "BIC"])
@pytest.mark.parametrize("fractional", [True, False])
@pytest.mark.parametrize("count", [4, 6, 9])
def test_a_planted_number_of_control_points_is_found(count, fractional, criterion):
    # Not three: whatever three can do, four can.
    source, target = planted(count, fractional)
    options = {"criterion": criterion, "fractional": fractional, "image_size": SIZE}
    selection = mx.select_warp(source, target, counts=range(3, 13), **options, smoothing=0)
    assert selection.count == count
    assert selection.selected[selection.criterion] == count
    # Noise of 0.05 px in each coordinate.
    assert selection.curves[selection.criterion][count - 3] < 0.1
    assert selection.warp.control_points.shape == (count, 2)
    assert np.linalg.norm(selection.warp(source) - target, axis=1).max() < 0.3


def test_the_fitting_error_prefers_more():
    source, target = planted(3, n=60, noise=2)
    selection = mx.select_warp(source, target, counts=[3, 5, 9, 17], image_size=SIZE, smoothing=0)
    assert selection.selected["FIT"] == 17
    assert selection.count in (3, 5)


@pytest.mark.parametrize("fractional", [True, False])
@pytest.mark.parametrize("count", [3, 6, 11])
def test_curves_are_those_of_refits(count, fractional):
    source, target = planted(6, fractional, n=50, noise=2)
    own = {"mine": mx.schemes.from_sets([[0, 1, 2, 3], [7, 9]], [[0, 3], [7]], n=50)}
    selection = mx.select_warp(
        source,
        target,
        "ER15",
        criteria=own,
        fractional=fractional,
        counts=[count],
        image_size=SIZE,
        smoothing=0,
    )
    points = lloyd(source, count, 0)
    design = warp_design(make_lifting("tps", points), source, target, fractional)
    m, p = design.A.shape
    assert (m, p) == ((100, 3 * count - 1) if fractional else (50, count))
    labels = np.repeat(np.arange(50), design.coupling)
    problem = Problem(design.A, design.b, labels)
    x = np.linalg.lstsq(design.A, design.b, rcond=None)[0]
    s = mx.schemes
    expected = {
        "FIT": math.sqrt(((design.b - design.A @ x) ** 2).sum() / 50),
        "PRESS": Problem(design.A, design.b, np.arange(m)).score(s.leave_one_out(m)),
        "CMPRESS": problem.score(s.leave_one_out(50)),
        "ER15": problem.score(s.exclusion_radius(source, 0.15 * math.hypot(*SIZE))),
        "mine": problem.score(own["mine"]),
    }
    assert selection.curves.keys() == expected.keys()
    for name, value in expected.items():
        assert selection.curves[name][0] == pytest.approx(value, rel=1e-9), name
    alone = mx.fit_warp(source, target, points, fractional=fractional)
    np.testing.assert_allclose(selection.warp(source), alone(source), rtol=1e-10)


def test_the_fitting_error_is_close_to_the_transfer_error():
    source, target = planted(5, noise=1)
    selection = mx.select_warp(source, target, counts=[5, 6], smoothing=0)
    transfer = np.sqrt((np.linalg.norm(selection.warps[5](source) - target, axis=1) ** 2).mean())
    assert selection.curves["FIT"][0] == pytest.approx(transfer, rel=0.1)


def test_undefined_counts_are_nan_and_named():
    rng = np.random.default_rng(0)
    source = np.vstack([rng.uniform(0, 20, (4, 2)), rng.uniform([300, 0], [350, 50], (10, 2))])
    target = 2 * source + rng.normal(0, 1, source.shape)
    selection = mx.select_warp(source, target, "NN08PTS", counts=range(3, 10), fractional=False, smoothing=0)
    curve = selection.curves["NN08PTS"]
    assert np.isfinite(curve[:4]).all()
    assert np.isnan(curve[4:]).all()  # 6 training data for 7 unknowns and more
    assert np.isfinite(selection.curves["FIT"]).all()
    assert selection.undefined["NN08PTS"].keys() == {7, 8, 9}
    for data in selection.undefined["NN08PTS"].values():
        assert data.tolist() == list(range(14))
    assert selection.count in range(3, 7)
    assert selection.selected["FIT"] == 9


def test_only_the_data_concerned_are_named():
    source, target = planted(3, n=30)
    own = {"mine": mx.schemes.from_sets([range(24), [5], [4, 6], range(25)], [[3, 2], [5], [4], [9]], n=30)}
    selection = mx.select_warp(source, target, "mine", criteria=own, counts=[3, 5], smoothing=0)
    # 5 control points: 14 unknowns, while 12 rows are left in the first pair, 10 in the last; 3 of them: 8 unknowns.
    assert selection.undefined["mine"].keys() == {5}
    assert selection.undefined["mine"][5].tolist() == [2, 3, 9]


@pytest.mark.parametrize("placement", ["nested", "lloyd"])
def test_matches_are_named_of_which_one_row_is_indispensable(placement):
    # 5 control points: 14 unknowns and as many rows, two for each match; 6 of them are not determined at all.
    source, target = planted(3, n=7)
    selection = mx.select_warp(source, target, "FIT", counts=[3, 4, 5, 6], placement=placement, smoothing=0)
    assert {count: data.tolist() for count, data in selection.undefined["PRESS"].items()} == {
        5: list(range(7)),
        6: list(range(7)),
    }


@given(seed=st.integers(0, 1000))
def test_selected_is_the_smallest_score(seed):
    source, target = planted(5, n=25, noise=3, seed=seed)
    names = ["FIT", "PRESS", "CMPRESS", "NN15PTS", "AIC", "BIC", "GCV"]
    selection = mx.select_warp(source, target, "ER20", names, counts=range(3, 10), smoothing=0)
    assert list(selection.curves) == [*names, "ER20"]
    for name, curve in selection.curves.items():
        if np.isnan(curve).all():
            assert selection.selected[name] is None
        else:
            assert selection.selected[name] == selection.counts[np.nanargmin(curve)]
    assert selection.count == selection.selected["ER20"]


def test_a_criterion_without_any_score_is_an_error():
    source, target = planted(3, n=20)
    for criterion in ("ER100", "NN20PTS"):
        with pytest.raises(ValueError, match=rf"^Invalid criterion\. .* Given {criterion}, .*\.$"):
            mx.select_warp(source, target, criterion, image_size=SIZE, counts=[3, 4], smoothing=0)


def test_another_criterion_without_any_score_selects_nothing():
    source, target = planted(3, n=20)
    selection = mx.select_warp(source, target, "ER05", ["NN20PTS"], counts=[3, 4], smoothing=0)
    assert selection.selected["NN20PTS"] is None
    assert np.isnan(selection.curves["NN20PTS"]).all()


def test_a_count_that_the_data_do_not_determine_has_no_warp():
    source, target = planted(3, n=12)
    selection = mx.select_warp(source, target, "CMPRESS", counts=[3, 9], fractional=True, smoothing=0)
    assert np.isnan(selection.curves["FIT"][1])  # 26 unknowns, 24 rows
    assert selection.warps.keys() == {3}
    assert selection.undefined["FIT"][9].tolist() == list(range(12))


def same(one, two):
    assert one.curves.keys() == two.curves.keys()
    for name, curve in one.curves.items():
        np.testing.assert_array_equal(curve, two.curves[name])
    assert one.selected == two.selected
    np.testing.assert_array_equal(one.warp.parameters, two.warp.parameters)


def test_the_seed_decides_and_threads_do_not():
    source, target = planted(5, n=60, noise=1)
    names = ["KF05", "LPO03", "RS20PCT", "DELAUNAY"]
    runs = [
        mx.select_warp(
            source, target, "ER10", names, counts=range(3, 12), seed=seed, threads=threads, smoothing=0
        )
        for seed, threads in [(0, 1), (0, 2), (0, 3), (1, 1)]
    ]
    same(runs[0], runs[1])
    same(runs[0], runs[2])
    assert any((runs[0].curves[name] != runs[3].curves[name]).any() for name in ("KF05", "LPO03", "RS20PCT"))


def test_inputs_stay_as_they_are():
    source, target = planted(3, n=20)
    before = source.copy(), target.copy()
    mx.select_warp(source, target, counts=[3, 4], criterion="CMPRESS", smoothing=0)
    np.testing.assert_array_equal(source, before[0])
    np.testing.assert_array_equal(target, before[1])


def test_default_counts_and_criteria():
    source, target = planted(3, n=15)
    selection = mx.select_warp(source, target, "CMPRESS", smoothing=0)
    assert selection.counts.tolist() == [3, 4, 5, 6, 7]
    assert list(selection.curves) == ["FIT", "PRESS", "CMPRESS"]
    selection = mx.select_warp(source, target, "NN02PTS", counts=[5, 3], smoothing=0)
    assert selection.counts.tolist() == [3, 5]
    assert list(selection.curves) == ["FIT", "PRESS", "CMPRESS", "NN02PTS"]


def test_image_size_sets_the_radius():
    # To rounding: schemes that are judged together share factorisations.
    source, target = planted(5, n=60, noise=1)
    small = mx.select_warp(source, target, "ER10", image_size=(300, 400), counts=[4, 5], smoothing=0)
    scheme = {"mine": mx.schemes.exclusion_radius(source, 50)}
    own = mx.select_warp(source, target, "mine", criteria=scheme, counts=[4, 5], smoothing=0)
    np.testing.assert_allclose(small.curves["ER10"], own.curves["mine"], rtol=1e-13)
    box = mx.select_warp(source, target, "ER10", counts=[4, 5], smoothing=0)
    scheme = {"mine": mx.schemes.exclusion_radius(source, 0.1 * np.hypot(*np.ptp(source, axis=0)))}
    own = mx.select_warp(source, target, "mine", criteria=scheme, counts=[4, 5], smoothing=0)
    np.testing.assert_allclose(box.curves["ER10"], own.curves["mine"], rtol=1e-13)


@pytest.mark.parametrize("angle", [0.5, 2])
def test_a_similarity_of_the_target_scales_the_scores(angle):
    source, target = planted(5, n=60, noise=1)
    turn = 3 * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    options = {"criterion": "ER10", "counts": range(3, 9)}
    one = mx.select_warp(source, target, **options, smoothing=0)
    two = mx.select_warp(source, target @ turn.T + [1e3, -7], **options, smoothing=0)
    for name, curve in one.curves.items():
        if name != "PRESS":  # row by row, hence with the axes
            np.testing.assert_allclose(two.curves[name], 3 * curve, rtol=1e-8)


def test_smoothing_is_a_penalty_on_bending():
    rng = np.random.default_rng(5)
    source = rng.uniform(0, 500, (40, 2))
    target = source + 20 * np.sin(source / 80) + rng.normal(size=source.shape)
    for fractional in (True, False):
        selection = mx.select_warp(source, target, counts=[3, 12], fractional=fractional, smoothing=7.0)
        warp = selection.warps[12]
        design = warp_design(warp.lifting, source, target, fractional)
        Z = np.sqrt(7.0) * design.bending()
        model = mx.LeastSquares(design.A, design.b, design.coupling, penalty=Z)
        assert selection.curves["FIT"][1] == pytest.approx(model.fit_rms, rel=1e-12)
        np.testing.assert_allclose(warp(source), design.model(model.coefficients)(source))
        bending = [np.linalg.norm(design.bending() @ x) for x in (model.coefficients, _free(design))]
        assert bending[0] < bending[1]
        stiff = mx.select_warp(source, target, counts=[12], fractional=fractional, smoothing=1e15)
        straight = mx.select_warp(source, target, counts=[3], fractional=fractional, smoothing=0)
        np.testing.assert_allclose(stiff.curves["FIT"], straight.curves["FIT"], rtol=0.02)


def _free(design):
    return mx.LeastSquares(design.A, design.b, design.coupling).coefficients
