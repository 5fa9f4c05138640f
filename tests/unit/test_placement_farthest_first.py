"""Data in an order of which every leading part is spread evenly."""

import time

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from mexpress.placement import farthest_first

POINTS = np.random.default_rng(0).uniform(0, 1, (200, 2)) * [640, 480]


def clouds():
    rng = np.random.default_rng(1)
    yield "uniform", POINTS
    yield "clustered", np.vstack([rng.normal(0, 1, (100, 2)), rng.normal(50, 3, (100, 2))])
    yield "thin", rng.uniform(0, 1, (200, 2)) @ [[1000.0, 500.0], [0.0, 0.1]]
    yield "grid", np.stack(np.meshgrid(np.arange(15.0), np.arange(12.0)), axis=-1).reshape(-1, 2)


CLOUDS = [pytest.param(points, id=name) for name, points in clouds()]


@pytest.mark.parametrize("points", CLOUDS)
def test_each_is_what_the_definition_says(points):
    chosen = farthest_first(points, 60)
    assert len(set(chosen.tolist())) == 60
    mean = points.mean(axis=0)
    far = np.linalg.norm(points - mean, axis=1)
    assert far[chosen[0]] == pytest.approx(far.max(), rel=1e-12)
    far = np.linalg.norm(points - points[chosen[0]], axis=1)
    assert far[chosen[1]] == pytest.approx(far.max(), rel=1e-12)
    (a, b), (c, d) = (points - points[chosen[0]]).T, points[chosen[1]] - points[chosen[0]]
    areas = np.abs(a * d - b * c)
    assert areas[chosen[2]] == pytest.approx(areas.max(), rel=1e-12)
    for k in range(3, 60):
        nearest = cdist(points, points[chosen[:k]]).min(axis=1)
        assert nearest[chosen[k]] == pytest.approx(nearest.max(), rel=1e-12)


@pytest.mark.parametrize("points", CLOUDS)
def test_fewer_are_the_first_of_more(points):
    chosen = farthest_first(points, 50)
    for count in (3, 4, 5, 17, 49):
        np.testing.assert_array_equal(farthest_first(points, count), chosen[:count])


def test_all_data_come_in_turn():
    chosen = farthest_first(POINTS, 10_000)
    assert sorted(chosen.tolist()) == list(range(200))


@pytest.mark.parametrize("apart", [0.0, 1e-7])
def test_data_that_coincide_are_taken_once(apart):
    points = np.vstack([POINTS[:20], POINTS[:20] + apart, POINTS[:20] - apart])
    chosen = farthest_first(points, 60)
    assert len(chosen) == 20
    assert set((chosen % 20).tolist()) == set(range(20))


def test_a_tie_goes_to_the_smallest_index():
    square = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    chosen = farthest_first(np.vstack([square, square]), 8)
    assert chosen.tolist() == [0, 2, 1, 3]


@pytest.mark.parametrize(("scale", "shift"), [(2.0**-40, 0.0), (2.0**40, 0.0), (1.0, 2.0**20)])
def test_the_unit_and_the_place_do_not_matter(scale, shift):
    points = np.round(POINTS, 3)
    np.testing.assert_array_equal(farthest_first(scale * points + shift, 40), farthest_first(points, 40))


def test_many_data_take_no_long():
    points = np.random.default_rng(2).uniform(0, 1, (300_000, 2))
    start = time.process_time()
    chosen = farthest_first(points, 300)
    assert time.process_time() - start < 10
    assert len(chosen) == 300
    nearest = cdist(points[chosen], points[chosen])[np.triu_indices(300, 1)].min()
    # A hexagonal packing of so many points is 0.062 apart, and the greedy one is at least half as good.
    assert nearest > 0.031


@pytest.mark.parametrize(
    ("points", "count", "error"),
    [
        ([[0, 0], [1, 1], [2, 2]], 3, ValueError),
        (np.ones((9, 2)), 3, ValueError),
        (POINTS, 2, ValueError),
        (POINTS, 3.5, (TypeError, ValueError)),
        (np.where(np.arange(400).reshape(200, 2) == 7, np.nan, POINTS), 5, ValueError),
        ("points", 3, (TypeError, ValueError)),
    ],
    ids=["line", "one place", "two", "fraction", "nan", "string"],
)
def test_bad_input_is_refused(points, count, error):
    with pytest.raises(error, match=r"^Invalid (points|max_count)\. .* Given .*\.$"):
        farthest_first(points, count)
