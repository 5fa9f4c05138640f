"""What the comparisons in experiments/ rest on: rivals' cross-validation, problems, records and losses."""

import sys
from functools import partial

import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator

import mexpress as mx
from mexpress.geometry import Region, hull
from mexpress.placement import farthest_order

pytest.importorskip("skimage", "0.26")

import compare_criteria
import compare_models
from comparison import fields, fixed, gaps, heights, matches, problems
from comparison.errors import Errors
from comparison.methods import METHODS, HeldOut, cross_validated_spline, error, nearest_homography, selected
from comparison.problem import Problem


@pytest.mark.parametrize("smoothing", [1e-3, 10.0, 1e6])
@pytest.mark.parametrize("folds", [10, 60])
def test_residuals_held_out_equal_those_of_scipys_splines_fitted_to_the_rest(smoothing, folds):
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 640, (60, 2))
    values = np.sin(points / 100) + rng.normal(0, 0.1, points.shape)
    parts = np.array_split(rng.permutation(60), folds)
    expected = np.empty_like(values)
    for part in parts:
        rest = np.setdiff1d(np.arange(60), part)
        spline = RBFInterpolator(points[rest], values[rest], kernel="thin_plate_spline", smoothing=smoothing)
        expected[part] = values[part] - spline(points[part])
    np.testing.assert_allclose(HeldOut(points, values)(smoothing, parts), expected, rtol=0, atol=1e-9)


def test_a_cross_validated_spline_takes_noise_away():
    rng = np.random.default_rng(1)
    points, unseen = rng.uniform(0, 640, (2, 150, 2))
    noisy = np.sin(points[:, 0] / 100) + rng.normal(0, 0.3, 150)
    problem = Problem(points, noisy, unseen, np.sin(unseen[:, 0] / 100))
    interpolant = RBFInterpolator(points, noisy, kernel="thin_plate_spline")
    for folds in (None, 10):
        smoothed = error(problem, lambda given, folds=folds: cross_validated_spline(given, folds))
        assert smoothed < 0.6 * error(problem, lambda given: interpolant(given.test_source))


def test_an_error_is_the_root_of_the_mean_squared_distance_and_a_vanished_denominator_is_infinite():
    square = np.array([[0.0, 0], [1, 0], [0, 1], [1, 1]])
    problem = Problem(square, square, square, square)
    assert error(problem, lambda given: given.test_source + np.array([3, 4])) == pytest.approx(5)
    vanished = np.where(square == [0, 1], np.nan, square)
    assert error(problem, lambda given: vanished) == np.inf
    depths = Problem(square, square[:, 0], square, square[:, 0])
    assert error(depths, lambda given: given.test_target + np.array([1, 1, 1, 5])) == pytest.approx(
        np.sqrt(7)
    )


@pytest.mark.parametrize("draw", range(5))
def test_homographies_are_strong_and_exact_where_they_judge_and_noisy_where_they_are_fitted(draw):
    drawn = matches.homography(400, draw)
    exact = Problem(drawn.test_source, drawn.test_target, drawn.test_source, drawn.test_target)
    assert error(exact, nearest_homography) < 1e-6
    assert 0.01 < error(drawn, nearest_homography) < 0.6
    truth = matches.ProjectiveTransform.from_estimate(drawn.test_source, drawn.test_target)
    assert 2 <= matches.denominators(truth, matches.rectangle(matches.SIZE)) <= 4
    apart = drawn.target - truth(drawn.source)
    assert 1 < apart.std() < 3
    again = matches.homography(400, draw)
    np.testing.assert_array_equal(again.target, drawn.target)


def test_a_denominator_that_vanishes_has_no_finite_ratio():
    below = matches.ProjectiveTransform(np.array([[1, 0, 0], [0, 1, 0], [0.01, 0, 1]]))
    assert matches.denominators(below, np.array([[0.0, 0], [100, 0]])) == pytest.approx(2)
    assert matches.denominators(below, np.array([[0.0, 0], [-200, 0]])) == np.inf


def test_what_judges_a_map_is_not_fitted():
    drawn = heights.pixels(heights.terrain, 50, 3)
    assert len(drawn.source) == 50
    assert len(drawn.test_source) == 3000
    both = np.vstack([drawn.source, drawn.test_source])
    assert len(np.unique(both, axis=0)) == 3050


def test_records_are_what_was_added_also_when_read_again(tmp_path):
    path = tmp_path / "errors.csv"
    with Errors(path) as errors:
        errors.keep("a, b", 0, {"one": (0.1234567, 1.0), "two": (np.inf, 2.0)})
        errors.keep("a, b", 1, {"one": (0.5, 1.0)})
        errors.keep("a, b", 1, {"one": (0.25, 1.0)})
    with Errors(path) as again:
        for kept in (errors, again):
            assert ("a, b", 0, "two") in kept
            assert ("a, b", 1, "two") not in kept
            np.testing.assert_allclose(kept.drawn("a, b", "one", 2), [0.1234567, 0.25])
            np.testing.assert_array_equal(kept.drawn("a, b", "two", 2), [np.inf, np.nan])


def test_only_what_is_missing_is_computed_and_the_tables_say_who_won(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(compare_models, "FEW", 2)
    arguments = ["x", str(tmp_path), "--out", str(tmp_path / "out"), "--quick", "--rows", "homography (30)"]
    for command, methods, computed in (
        ([*arguments, "--methods", "homography"], 1, 2),
        ([*arguments, "--methods", "homography,scikit"], 2, 2),
        ([*arguments, "--methods", "homography,scikit"], 2, 0),
        ([*arguments, "--methods", "scikit", "--again"], 2, 2),
    ):
        monkeypatch.setattr(sys, "argv", command)
        compare_models.run(compare_models.arguments())
        assert len((tmp_path / "out/errors.csv").read_text().splitlines()) == 2 + 2 * methods
        printed = capsys.readouterr()
        assert f"{computed} draws to compute" in printed.err
        assert "| homography (30) | **" in printed.out
    assert (tmp_path / "out/models.png").stat().st_size > 1000


def test_a_warp_is_judged_as_a_warp_and_a_map_as_a_map(tmp_path):
    found = compare_models.judge(tmp_path, "homography (30)", 0, ["homography", "mexpress smoothing=0"])
    assert found["mexpress smoothing=0"][0] < 2 * found["homography"][0]
    found = compare_models.judge(tmp_path, "Jacksboro (300)", 0, ["plane", "mexpress smoothing=0"])
    assert found["mexpress smoothing=0"][0] < found["plane"][0]


def test_a_sheet_in_space_is_judged_as_a_surface():
    points, unseen = np.random.default_rng(0).uniform(0, 1, (2, 60, 2))
    bent = lambda flat: np.column_stack([flat, flat[:, 0] ** 2])  # noqa: E731
    sheet = Problem(points, bent(points), unseen, bent(unseen))
    for name in ("plane", "scipy RBF leave-one-out", "mexpress smoothing=0"):
        assert error(sheet, METHODS[name]) < 0.2


def test_a_criterion_without_any_score_is_an_infinite_error_and_other_refusals_are_raised():
    rng = np.random.default_rng(0)
    source, unseen = rng.uniform(0, 100, (2, 12, 2))
    few = Problem(source, 2 * source, unseen, 2 * unseen)
    grid = partial(selected, lifting="bspline", smoothing=0)
    assert error(few, grid) == np.inf
    line = Problem(source * [1, 0], 2 * source, unseen, 2 * unseen)
    with pytest.raises(ValueError, match="Invalid source"):
        error(line, grid)


@pytest.mark.parametrize("cut", [gaps.discs, gaps.side])
@pytest.mark.parametrize("draw", range(3))
def test_a_gap_has_no_data_and_is_where_a_problem_is_judged(cut, draw):
    scene = partial(matches.homography, 100)
    whole, drawn = scene(draw), gaps.with_gaps(scene, cut, draw)
    lost = 100 - len(drawn.source)
    assert 10 <= lost <= 50
    assert 100 < len(drawn.test_source) < 600
    kept = (whole.source[:, None] == drawn.source).all(axis=2)
    assert kept.sum() == len(drawn.source)
    np.testing.assert_array_equal(whole.target[kept.any(axis=1)], drawn.target)
    nearest = np.sqrt(((drawn.test_source[:, None] - drawn.source) ** 2).sum(axis=2)).min(axis=1)
    everywhere = np.sqrt(((whole.test_source[:, None] - whole.source) ** 2).sum(axis=2)).min(axis=1)
    assert np.median(nearest) > 1.5 * np.median(everywhere)


def test_a_side_loses_its_share_and_a_disc_all_data_within_its_radius():
    points = np.random.default_rng(0).uniform(0, 1, (1000, 2))
    inside = gaps.side(points, np.random.default_rng(1))(points)
    assert inside.sum() == 300
    random = np.random.default_rng(1)
    centres = points[np.random.default_rng(1).choice(1000, gaps.DISCS, replace=False)]
    radius = gaps.RADIUS * np.hypot(*np.ptp(points, axis=0))
    away = np.hypot(*(points[:, None] - centres).transpose(2, 0, 1)).min(axis=1)
    np.testing.assert_array_equal(gaps.discs(points, random)(points), away < radius)


def test_clustered_matches_are_the_scenes_own_in_a_small_part_of_it():
    drawn = matches.clustered(matches.homography, 60, 0)
    crowd = matches.homography(matches.CROWD * 60, 0)
    assert (drawn.source[:, None] == crowd.source).all(axis=2).any(axis=1).all()
    spacing = [
        np.median(np.sort(np.hypot(*(p[:, None] - p).transpose(2, 0, 1)), axis=1)[:, 1])
        for p in (drawn.source, matches.homography(60, 0).source)
    ]
    assert spacing[0] < 0.5 * spacing[1]


def test_shaken_matches_have_noise_that_neighbours_share():
    drawn, plain = matches.shaken(matches.homography, 300, 0), matches.homography(300, 0)
    noise = drawn.target - plain.target
    assert 1 < noise.std() < 3
    away = np.hypot(*(drawn.source[:, None] - drawn.source).transpose(2, 0, 1)) + 1e9 * np.eye(300)
    nearest = away.argmin(axis=1)
    assert np.corrcoef(noise[:, 0], noise[nearest, 0])[0, 1] > 0.7


@pytest.mark.parametrize(("kind", "bent"), [("affine", False), ("perspective", False), ("bent", True)])
def test_an_old_map_is_of_the_kind_that_it_is_said_to_be(kind, bent):
    drawn = matches.old_map(kind, 12, 0)
    exact = Problem(drawn.test_source, drawn.test_target, drawn.test_source, drawn.test_target)
    width = matches.SIZE[0]
    assert (error(exact, METHODS["affine map"]) < 1e-6) == (kind == "affine")
    assert (error(exact, METHODS["homography"]) > 1e-3 * width) == bent


def test_soundings_are_along_lines():
    drawn = heights.tracks(heights.terrain, 200, 0)
    assert 100 < len(drawn.source) <= 200
    assert not (drawn.source[:, None] == drawn.test_source[:500]).all(axis=2).any()
    spread = np.sort(np.hypot(*(drawn.test_source[:, None] - drawn.source).transpose(2, 0, 1)), axis=1)[:, 0]
    scattered = heights.pixels(heights.terrain, 200, 0)
    nearest = np.sort(np.hypot(*(scattered.test_source[:, None] - scattered.source).transpose(2, 0, 1)))[:, 0]
    assert np.median(spread) > 2 * np.median(nearest)


def test_fixed_settings_are_the_models_that_mexpress_fits():
    drawn = matches.homography(50, 0)
    models = fixed.model_grid(drawn)
    assert list(models) == fixed.SETTINGS
    weight = 50 * Region(hull(drawn.source, "points")).area * fixed.WEIGHTS[4]
    order = drawn.source[farthest_order(drawn.source, 30)]
    expected = mx.fit_warp(drawn.source, drawn.target, order, smoothing=weight)
    found = models[fixed.SETTINGS[4]]
    np.testing.assert_allclose(found(drawn.test_source), expected(drawn.test_source), rtol=0, atol=1e-6)
    stiffest = error(drawn, lambda given: models[fixed.SETTINGS[11]](given.test_source))
    assert stiffest == pytest.approx(error(drawn, nearest_homography), rel=0.1)
    terrain = heights.pixels(heights.terrain, 40, 0)
    surface = fixed.model_grid(terrain)[fixed.SETTINGS[12]]  # the smallest weight, as many points as data
    np.testing.assert_allclose(surface(terrain.source), terrain.target, atol=0.01 * terrain.target.std())


def test_the_verdict_compares_to_the_best_of_the_others_and_to_the_best_fixed_setting(tmp_path):
    records = Errors(tmp_path / "errors.csv")
    for draw, (ours, spline, plane) in enumerate([(2, 1, 3), (1, 2, 3), (1, 2, 3)]):
        found = {compare_models.OURS: ours, "scipy RBF 10-fold": spline, "plane": plane}
        found |= {setting: 4 - 0.1 * k for k, setting in enumerate(fixed.SETTINGS)}
        records.keep("map", draw, {name: (float(value), 0.0) for name, value in found.items()})
    names = ["plane", "scipy RBF 10-fold", compare_models.FIXED, compare_models.OURS]
    table = compare_models.Table("Maps", {"map": 3}, names)
    lines = compare_models.verdicts(records, table)
    fraction = 1 / (4 - 0.1 * (len(fixed.SETTINGS) - 1))
    assert lines[2] == f"| map | scipy RBF 10-fold | 0.500 | {fraction:.3f} | 2 of 3 |"
    assert lines[3] == f"| geometric mean | | 0.500 | {fraction:.3f} | |"
    assert "geometric mean 0.588, median 0.588; within 3 % in 1 of 1 rows" in lines[-1]
    row = compare_models.errors_table(records, table)[-1]
    assert row == "| map | 3 (3) | 2 (2) | 1.7 (1.7) | **1** (2) |"
    records.close()


def test_a_row_with_gaps_is_judged_by_the_call_that_is_given_the_queries():
    for title in problems.TABLES:
        table = compare_models.Table(title, {}, compare_models.methods_of(title))
        assert table.ours == (compare_models.ASKED if title in problems.GAPS else compare_models.OURS)
        assert {*table.methods} <= {*compare_models.LOOKS}
        assert {*table.methods} - {*METHODS} == {compare_models.FIXED}


def test_shared_noise_has_the_correlation_that_it_is_said_to_have():
    points = np.random.default_rng(0).uniform(0, 1, (30, 2))
    drawn = np.array([fields.shared_noise(points, 0.2, np.random.default_rng(k)) for k in range(4000)])
    squared = ((points[:, None] - points) ** 2).sum(axis=2)
    expected = np.exp(-squared / (2 * 0.2**2))
    assert np.abs(drawn.T @ drawn / len(drawn) - expected).max() < 0.08


def test_a_surface_is_the_same_whatever_the_data():
    samples = [fields.sample(kind, 4) for kind in compare_criteria.KINDS]
    for other in samples[1:]:
        np.testing.assert_array_equal(other.truth, samples[0].truth)
    assert len(samples[2].points) < len(samples[0].points)


def refit_error(data, control_points, smoothing):
    surface = mx.fit_surface(data.points, data.values, control_points, smoothing=smoothing)
    return np.sqrt(((surface(data.grid) - data.truth) ** 2).mean())


@pytest.mark.parametrize("family", ["count", "weight"])
def test_a_loss_is_that_of_the_refitted_surfaces(family, monkeypatch):
    monkeypatch.setattr(compare_criteria, "LARGEST", 15)
    data = fields.sample("clustered", 1)
    found = compare_criteria.losses("clustered", family, 1, ["CMPRESS", "BIC"])
    smoothing = {"count": 0.0, "weight": "auto"}[family]
    selection = mx.select_surface(
        data.points, data.values, "BIC", ["CMPRESS"], max_count=15, smoothing=smoothing
    )
    models = [(int(count), float(weight)) for count in selection.counts for weight in selection.weights]
    errors = {model: refit_error(data, selection.control_points[: model[0]], model[1]) for model in models}
    assert found[compare_criteria.BEST][0] == pytest.approx(min(errors.values()), rel=1e-9)
    for name in ("CMPRESS", "BIC"):
        chosen = selection.selected[name], selection.selected_smoothing[name]
        loss = 100 * (errors[chosen] / min(errors.values()) - 1)
        assert found[name][0] == pytest.approx(loss, abs=1e-6)
