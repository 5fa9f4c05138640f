import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mexpress.liftings import ThinPlateSpline
from mexpress.placement import SPACING, by_residual, thinness

coordinates = st.integers(-50, 50).map(float)


def diagonal(points):
    return np.hypot(*np.ptp(points, axis=0))


def distances(points, others):
    return np.hypot(*(points[:, None] - others).T).T


def oracle(points, values, first, max_count, distance):
    """Refit by numpy at every step, with the cardinal splines of the control points so far."""
    points, values = np.asarray(points, float), np.asarray(values, float).reshape(len(points), -1)
    chosen = list(first)
    while len(chosen) < max_count:
        design = ThinPlateSpline(points[chosen]).basis(points)
        norms = np.linalg.norm(values - design @ np.linalg.lstsq(design, values, rcond=None)[0], axis=1)
        norms[(distances(points, points[chosen]) <= distance).any(axis=1)] = 0
        if norms.max() <= 1e-12 * np.abs(values).max():
            break
        chosen.append(int(np.argmax(norms >= norms.max() * (1 - 1e-9))))
    return chosen


def surface(n, outputs=1, seed=0):
    random = np.random.default_rng(seed)
    points = random.uniform(0, 1, (n, 2)) * [640, 480]
    waves = np.sin(points @ random.normal(0, 0.02, (2, outputs)) + random.uniform(0, 6, outputs))
    return points, waves + 0.05 * random.normal(size=(n, outputs))


def grid(width, height, step=1.0):
    x, y = np.meshgrid(np.arange(width) * step, np.arange(height) * step)
    return np.column_stack([x.ravel(), y.ravel()])


@pytest.mark.parametrize("outputs", [1, 2, 3])
@pytest.mark.parametrize("n", [40, 300, 1500])
def test_every_step_is_what_a_refit_says(n, outputs):
    points, values = surface(n, outputs, seed=n)
    chosen = by_residual(points, values, 40)
    distance = SPACING * diagonal(points)
    assert chosen.tolist() == oracle(points, values, chosen[:3], 40, distance)


@given(
    arrays(float, st.tuples(st.integers(4, 40), st.just(2)), elements=coordinates),
    st.integers(0, 3),
    st.floats(0.02, 0.3),
)
def test_points_on_a_grid_with_copies_and_ties(points, seed, part):
    assume(np.linalg.matrix_rank(points - points[0]) == 2)
    values = np.random.default_rng(seed).integers(-2, 3, len(points)).astype(float)
    distance = part * diagonal(points)
    chosen = by_residual(points, values, 25, min_distance=distance, seed=seed)
    assert thinness(points[chosen[:3]]) > 0
    assert chosen.tolist() == oracle(points, values, chosen[:3], 25, distance)


def test_symmetric_ties_go_to_the_smallest_index():
    points = grid(9, 9)
    values = ((points - 4) ** 2).sum(axis=1)
    chosen = by_residual(points, values, 30, min_distance=1.5)
    assert chosen.tolist() == oracle(points, values, chosen[:3], 30, 1.5)


def test_real_depth_has_steps_and_ties():
    depth = np.round(500 + 40 * np.hypot(*(grid(60, 40) - [25, 13]).T)) + 300 * (grid(60, 40)[:, 0] > 35)
    chosen = by_residual(grid(60, 40), depth, 60)
    assert chosen.tolist() == oracle(grid(60, 40), depth, chosen[:3], 60, SPACING * np.hypot(59, 39))


@pytest.mark.parametrize("n", [100, 600, 5000])
def test_the_number_of_threads_changes_nothing(n):
    points, values = surface(n, 2)
    one, two, three = (by_residual(points, values, 60, threads=threads) for threads in (1, 2, 3))
    np.testing.assert_array_equal(one, two)
    np.testing.assert_array_equal(one, three)


def test_shorter_placements_are_the_start_of_longer_ones():
    points, values = surface(500)
    longest = by_residual(points, values, 50)
    for count in (3, 4, 17):
        np.testing.assert_array_equal(by_residual(points, values, count), longest[:count])


@pytest.mark.parametrize("part", [0.0, 0.01, 0.1, 0.3])
@pytest.mark.parametrize("data", ["random", "grid"])
def test_control_points_keep_their_distance(part, data):
    points, values = surface(400)
    points = points if data == "random" else grid(20, 20, 5.0)
    kappa = part * diagonal(points)
    chosen = points[by_residual(points, values, 200, min_distance=kappa)]
    apart = distances(chosen, chosen)
    np.fill_diagonal(apart, np.inf)
    assert apart.min() > kappa
    ThinPlateSpline(chosen)


def test_it_ends_early_when_nobody_is_left():
    points, values = surface(400)
    kappa = 0.2 * diagonal(points)
    chosen = by_residual(points, values, 10**30, min_distance=kappa)
    assert 3 < len(chosen) < 40
    assert (distances(points, points[chosen]) <= kappa).any(axis=1).all()


def test_a_distance_on_the_grid_is_excluded_exactly():
    points = grid(30, 30, 0.5) + 5e6
    chosen = points[by_residual(points, np.random.default_rng(0).normal(size=900), 900, min_distance=2.5)]
    apart = distances(chosen, chosen)
    np.fill_diagonal(apart, np.inf)
    assert apart.min() > 2.5


@pytest.mark.parametrize("level", [0.0, 1.0, 1e6, -3e-7])
@pytest.mark.parametrize("slope", [0.0, 1e-3, 50.0])
@pytest.mark.parametrize("offset", [0.0, 5e6])
def test_planes_need_three(level, slope, offset):
    points, _ = surface(800)
    values = level + (points + offset) @ [slope, -0.3 * slope]
    assert len(by_residual(points + offset, values, 50)) == 3


def test_data_that_a_spline_interpolates_end_it():
    points, values = surface(25)
    chosen = by_residual(points, values, 100, min_distance=0)
    assert sorted(chosen.tolist()) == list(range(25))


def test_three_data():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.01]])
    assert sorted(by_residual(points, [1, 2, 3], 10).tolist()) == [0, 1, 2]


def test_copies_come_once():
    points, values = surface(60)
    chosen = by_residual(np.repeat(points, 3, axis=0), np.repeat(values, 3, axis=0), 200, min_distance=0)
    assert len(np.unique(chosen // 3)) == len(chosen) <= 60


def test_nearly_equal_points_are_control_points_once():
    points, values = surface(60)
    close = points + 1e-4 * np.random.default_rng(1).normal(size=points.shape)
    chosen = by_residual(np.vstack([points, close]), np.vstack([values, 1 - values]), 200, min_distance=0)
    assert sorted(chosen % 60) == list(range(60))


@pytest.mark.parametrize(
    "points",
    [
        np.empty((0, 2)),
        [[1.0, 2.0]],
        [[1.0, 2.0], [3.0, 4.0]],
        [[1.0, 2.0]] * 5,
        np.column_stack([np.linspace(0, 1, 50), np.linspace(0, 1, 50) * np.pi]) * 1e4 + 1e5,
        [[5.0, i] for i in range(9)],
    ],
)
def test_points_on_a_line_are_an_error(points):
    with pytest.raises(ValueError, match=r"Invalid points\. .* Given "):
        by_residual(points, np.arange(len(points)), 5)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("max_count", {"max_count": 2}),
        ("max_count", {"max_count": 4.5}),
        ("min_distance", {"min_distance": -1}),
        ("min_distance", {"min_distance": np.nan}),
        ("min_distance", {"min_distance": "far"}),
        ("seed", {"seed": -1}),
        ("threads", {"threads": 0}),
        ("values", {"values": np.zeros(7)}),
        ("values", {"values": np.full(30, np.nan)}),
        ("values", {"values": np.zeros((30, 2, 2))}),
        ("values", {"values": ["a"] * 30}),
        ("points", {"points": np.full((30, 2), np.inf)}),
    ],
)
def test_arguments_that_are_none_are_refused(name, change):
    points, values = surface(30)
    with pytest.raises((ValueError, TypeError), match=rf"Invalid {name}\. .* Given "):
        by_residual(**({"points": points, "values": values, "max_count": 9} | change))


@pytest.mark.parametrize("scale", [1e-90, 1e-6, 3.0, 1e90])
@pytest.mark.parametrize("offset", [0.0, 5e6])
def test_units_do_not_matter(scale, offset):
    points, values = surface(500, 2)
    expected = by_residual(points, values, 50)
    np.testing.assert_array_equal(by_residual((points + offset) * scale, values, 50), expected)
    np.testing.assert_array_equal(by_residual(points, values * scale, 50), expected)
    kappa = 0.05 * diagonal(points)
    np.testing.assert_array_equal(
        by_residual(points * scale, values, 50, min_distance=kappa * scale),
        by_residual(points, values, 50, min_distance=kappa),
    )


def test_the_seed_decides_about_the_first_three():
    points, values = surface(500)
    np.testing.assert_array_equal(by_residual(points, values, 9), by_residual(points, values, 9, seed=0))
    firsts = {tuple(by_residual(points, values, 3, seed=seed)) for seed in range(20)}
    assert len(firsts) > 15


@pytest.mark.parametrize("width", [1.0, 1e-2, 1e-5])
def test_the_first_three_are_well_spread(width):
    random = np.random.default_rng(0)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    square = random.uniform(0, 1, (400, 2))
    points = square * [1, width] @ turn
    drawn = [square[by_residual(points, np.zeros(400), 3, seed=seed)] for seed in range(50)]
    assert min(thinness(triangle) for triangle in drawn) > 0.02
    assert np.median([thinness(triangle) for triangle in drawn]) > 0.3


def test_the_first_three_avoid_crowds():
    random = np.random.default_rng(0)
    crowd = random.uniform(0, 0.01, (5000, 2))
    points = np.vstack([crowd, random.uniform(0, 1, (20, 2))])
    for seed in range(20):
        first = points[by_residual(points, np.zeros(5020), 3, seed=seed)]
        assert min(np.hypot(*(first - np.roll(first, 1, axis=0)).T)) > SPACING * diagonal(points)


def test_two_clusters_and_one_more():
    points = np.vstack([np.zeros((50, 2)), np.full((50, 2), 3.0), [[0.0, 1.0]]])
    chosen = by_residual(points, np.arange(101.0), 10)
    assert len(chosen) == 3
    assert chosen.max() == 100


def test_a_distance_that_leaves_no_room_leaves_the_widest_draw():
    points, values = surface(300)
    chosen = by_residual(points, values, 50, min_distance=2 * diagonal(points))
    assert len(chosen) == 3
    first = points[chosen]
    assert min(np.hypot(*(first - np.roll(first, 1, axis=0)).T)) > 0.4 * diagonal(points)


def test_every_layout_of_the_same_numbers_gives_the_same():
    points, values = np.round(surface(100, 2))[0], surface(100, 2)[1]
    expected = by_residual(points, values, 20)
    values.flags.writeable = False
    for same in (points.tolist(), points.astype(np.float32), np.asfortranarray(points), points.astype(int)):
        np.testing.assert_array_equal(by_residual(same, values, np.int64(20)), expected)
    np.testing.assert_array_equal(by_residual(points, np.asfortranarray(values), 20), expected)


@pytest.mark.parametrize("seed", range(12))
def test_a_strip_that_is_barely_no_line(seed):
    points = np.random.default_rng(5).uniform(size=(400, 2)) * [1.0, 3e-6]
    first = points[by_residual(points, points[:, 0] ** 2, 3, seed=seed)]
    assert thinness(first) > 1e-6


def test_three_points_that_nearly_coincide():
    with pytest.raises(ValueError, match="Invalid points"):
        by_residual([[0, 0], [1, 0], [0, 5e-6]], [0.0, 1.0, 2.0], 3)
