import numpy as np
import pytest
from scipy.spatial import cKDTree

import mexpress as mx
from mexpress.placement import covered_region, lattice
from mexpress.plotting import plot_radii
from mexpress.radii import score_by_radius


def model_of(points, noise=0.1, seed=0):
    x, y = np.asarray(points, dtype=float).T
    design = np.column_stack([x**i * y**j for i in range(3) for j in range(3)])
    return mx.LeastSquares(design, np.sin(4 * x) + y + np.random.default_rng(seed).normal(0, noise, len(x)))


POINTS = np.random.default_rng(1).uniform(size=(150, 2))


def test_scores_are_those_of_exclusion_radii():
    model = model_of(POINTS)
    curve = score_by_radius(model, POINTS, diagonal=2.0, percents=[0, 2.5, 10], threads=1)
    assert curve.percents.tolist() == [0, 2.5, 10]
    for percent, score, held in zip(curve.percents, curve.scores, curve.held, strict=True):
        scheme = mx.schemes.exclusion_radius(POINTS, percent / 100 * 2.0)
        assert score == model.cross_validate(scheme).score
        assert held == scheme.held_out.sizes.mean()
    assert curve.scores[0] == model.cross_validate(mx.schemes.leave_one_out(150)).score


def test_reach_is_how_far_the_domain_is_from_the_data():
    crowded = np.vstack([POINTS * 0.1, [[0, 1], [1, 0], [1, 1]]])
    even, uneven = (score_by_radius(model_of(p), p, percents=[0]).reach for p in (POINTS, crowded))
    assert (np.diff(even) >= 0).all()
    assert len(even) >= 950
    assert np.median(even) < 5
    assert 20 < np.median(uneven) < 50
    diagonal = np.hypot(*np.ptp(crowded, axis=0))
    middle = np.hypot(*(crowded - 0.55).T).min() / diagonal * 100
    assert uneven.max() == pytest.approx(middle, rel=0.3)


def test_reach_of_many_data():
    # Distances are taken to some thousand data at a time; the last few are in a corner.
    points = np.random.default_rng(0).uniform(size=(9000, 2))
    points = points[np.argsort(points.max(axis=1))]
    curve = score_by_radius(model_of(points), points, diagonal=100.0, percents=[0])
    queries = lattice(covered_region(points), 1000)
    np.testing.assert_allclose(curve.reach, np.sort(cKDTree(points).query(queries)[0]), rtol=1e-12)


def test_the_default_diagonal_is_that_of_the_bounding_box():
    model = model_of(POINTS)
    box = float(np.hypot(*np.ptp(POINTS, axis=0)))
    ours, given = score_by_radius(model, POINTS), score_by_radius(model, POINTS.tolist(), box)
    np.testing.assert_array_equal(ours.scores, given.scores)
    assert ours.percents[[0, -1]].tolist() == [0, 20]


def test_a_radius_that_leaves_too_few_has_no_score_and_the_plot_copes(tmp_path):
    curve = score_by_radius(model_of(POINTS), POINTS, percents=[0, 5, 90])
    assert np.isfinite(curve.scores).tolist() == [True, True, False]
    figure = plot_radii(curve, tmp_path / "radii.png", unit="m")
    assert (tmp_path / "radii.png").stat().st_size > 10_000
    above, below = figure.axes
    np.testing.assert_array_equal(above.lines[0].get_ydata(), curve.scores)
    assert above.get_ylabel() == "prediction error (m)"
    assert below.get_xlabel() == "radius (% of the diagonal)"
    assert "RadiusCurve(" in repr(curve)


@pytest.mark.parametrize("percents", [[], [1, 1], [2, 1], [-1, 2], [np.nan], 5, "many", [[1, 2]], [np.inf]])
def test_percents_must_increase(percents):
    with pytest.raises((ValueError, TypeError), match=r"^Invalid percents\."):
        score_by_radius(model_of(POINTS), POINTS, percents=percents)


def test_points_must_be_those_of_the_model_and_cover_a_region():
    model = model_of(POINTS)
    for points in (POINTS[:-1], np.column_stack([np.arange(150.0)] * 2)):
        with pytest.raises(ValueError, match=r"^Invalid points\."):
            score_by_radius(model, points)
    for diagonal in (0, -1, np.nan, "wide"):
        with pytest.raises((ValueError, TypeError), match=r"^Invalid diagonal\."):
            score_by_radius(model, POINTS, diagonal)
