import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial import ConvexHull

from mexpress.geometry import moments
from mexpress.liftings import ThinPlateSpline
from mexpress.placement import covered_region, lattice, lloyd, thinness

SQUARE = np.array([[0.0, 0.0], [400.0, 0.0], [400.0, 400.0], [0.0, 400.0]])
coordinates = st.integers(-50, 50).map(float)


def inside(corners, points, slack=1e-9):
    edges = np.roll(corners, -1, axis=0) - corners
    offsets = points[:, None] - corners
    turn = edges[:, 0] * offsets[:, :, 1] - edges[:, 1] * offsets[:, :, 0]
    return (turn >= -slack * np.abs(edges).max() ** 2).all(axis=1)


def assignment(samples, centres):
    return ((samples[:, None] - centres) ** 2).sum(axis=2).argmin(axis=1)


@given(arrays(float, st.tuples(st.integers(3, 60), st.just(2)), elements=coordinates))
def test_the_region_is_the_convex_hull(points):
    centred = points - points[0]
    assume(np.linalg.matrix_rank(centred) == 2)
    hull = ConvexHull(points)
    corners = covered_region(points)
    assert {tuple(c) for c in corners} == {tuple(points[v]) for v in hull.vertices}
    x, y = corners.T
    assert 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) == pytest.approx(hull.volume)
    np.testing.assert_array_equal(covered_region(corners), corners)


@pytest.mark.parametrize("cells", [3, 30, 10_000])
@pytest.mark.parametrize("number", [51, 400, 5000])
def test_the_region_of_many_points_is_the_convex_hull(number, cells):
    points = np.random.default_rng(number).integers(0, cells, (number, 2)).astype(float)
    assert {tuple(c) for c in covered_region(points)} == {
        tuple(points[v]) for v in ConvexHull(points).vertices
    }


@pytest.mark.parametrize(
    "points",
    [
        [],
        [[1, 2]],
        [[1, 2], [3, 4]],
        [[1, 2]] * 5,
        [[1, 2], [3, 4]] * 3,
        [[0, 0], [1, 1], [2, 2], [3, 3]],
        [[5, 0], [5, 1], [5, 9]],
        np.column_stack([np.linspace(0, 1, 50), np.linspace(0, 1, 50) * np.pi]) * 1e4 + 1e5,
    ],
)
@pytest.mark.parametrize("function", [covered_region, lambda p: lloyd(p, 3)])
def test_points_on_a_line_are_an_error(function, points):
    with pytest.raises(ValueError, match=r"Invalid points\. .* Given "):
        function(points)


@pytest.mark.parametrize(
    "points", [[[0, 0], [1, 0], [0, np.nan]], [[0, 0], [np.inf, 0], [0, 1]], "abc", [[1, 2, 3]], None]
)
def test_points_that_are_none_are_refused(points):
    with pytest.raises((ValueError, TypeError), match=r"Invalid points\. .* Given "):
        lloyd(points, 3)


@pytest.mark.parametrize("count", [2, 0, -1, 3.5, "4", None])
def test_counts_that_are_none_are_refused(count):
    with pytest.raises((ValueError, TypeError), match=r"Invalid count\. .* Given "):
        lloyd(SQUARE, count)


@pytest.mark.parametrize("threads", [0, -1, 1.5, "2"])
def test_threads_that_are_none_are_refused(threads):
    with pytest.raises((ValueError, TypeError), match=r"Invalid threads\. .* Given "):
        lloyd(SQUARE, 5, threads=threads)


def test_the_number_of_threads_changes_nothing():
    np.testing.assert_array_equal(lloyd(SQUARE, 30, threads=1), lloyd(SQUARE, 30, threads=2))


@pytest.mark.parametrize("seed", [-1, 0.5, "x"])
def test_seeds_that_are_none_are_refused(seed):
    with pytest.raises((ValueError, TypeError), match=r"Invalid seed\. .* Given "):
        lloyd(SQUARE, 5, seed=seed)


def test_thinness_is_a_ratio():
    points = np.random.default_rng(0).normal(size=(50, 2))
    rotation = np.array([[0.6, -0.8], [0.8, 0.6]])
    assert thinness(1e-3 * points @ rotation + 5) == pytest.approx(thinness(points))
    assert thinness(points * [1e3, 0]) == 0
    assert thinness(SQUARE) == pytest.approx(1)


def test_moments_are_those_of_the_area():
    rectangle = np.array([[10.0, 5.0], [16.0, 5.0], [16.0, 8.0], [10.0, 8.0]])
    centroid, factor, area = moments(rectangle)
    np.testing.assert_allclose(centroid, [13, 6.5])
    np.testing.assert_allclose(factor @ factor.T, np.diag([6**2, 3**2]) / 12, atol=1e-12)
    assert area == pytest.approx(18)
    triangle = np.array([[0.0, 0.0], [5.0, 1.0], [2.0, 7.0]])
    centroid, factor, area = moments(triangle)
    about = triangle - triangle.mean(axis=0)
    np.testing.assert_allclose(centroid, triangle.mean(axis=0))
    np.testing.assert_allclose(factor @ factor.T, about.T @ about / 12)
    assert area == pytest.approx(16.5)


@pytest.mark.parametrize("number", [100, 2000])
@given(arrays(float, (8, 2), elements=coordinates, unique=True))
def test_the_lattice_fills_the_region_evenly(number, points):
    corners_rank = np.linalg.matrix_rank(points - points[0])
    assume(corners_rank == 2)
    corners = covered_region(points)
    samples = lattice(corners, number)
    assert inside(corners, samples).all()
    assert abs(len(samples) - number) < 6 * np.sqrt(number)
    dense = lattice(corners, 40_000)
    size = np.ptp(corners, axis=0)
    np.testing.assert_allclose(
        samples.mean(axis=0) / size, dense.mean(axis=0) / size, atol=0.5 / np.sqrt(number)
    )


def test_a_thin_slanted_region_is_filled_as_well():
    strip = (SQUARE * [1, 1e-4]) @ np.array([[1.0, 1.0], [-1.0, 1.0]])
    samples = lattice(covered_region(strip), 2000)
    assert 1900 < len(samples) < 2100
    across = samples @ [-1.0, 1.0]
    assert len(np.unique((across / np.ptp(across)).round(6))) > 40


def test_centres_are_the_means_of_what_is_nearest_to_them():
    samples, centres = lattice(SQUARE, 5000), lloyd(SQUARE, 12)
    nearest = assignment(samples, centres)
    means = np.array([samples[nearest == k].mean(axis=0) for k in range(12)])
    np.testing.assert_allclose(centres, means, atol=4)


def test_centres_are_spread_better_than_at_random():
    samples = lattice(SQUARE, 5000)

    def energy(centres):
        return ((samples[:, None] - centres) ** 2).sum(axis=2).min(axis=1).mean()

    at_random = [energy(np.random.default_rng(s).uniform(0, 400, (20, 2))) for s in range(20)]
    assert max(energy(lloyd(SQUARE, 20, seed=s)) for s in range(5)) < 0.7 * min(at_random)


def test_cells_of_a_long_region_are_round():
    samples = lattice(SQUARE * [9, 1], 5000)
    squared = ((samples[:, None] - lloyd(SQUARE * [9, 1], 30)) ** 2).sum(axis=2).min(axis=1)
    assert squared.mean() < 0.19 * (9 * 400 * 400 / 30)  # hexagons: 0.160, squares: 0.167, 1 to 9: 0.76


def test_only_the_region_matters_not_the_density():
    crowd = np.random.default_rng(0).uniform(10, 60, (500, 2))
    np.testing.assert_array_equal(lloyd(np.vstack([SQUARE, crowd]), 7), lloyd(SQUARE, 7))


@pytest.mark.parametrize("count", [3, 20, 60])
def test_the_region_will_do_instead_of_the_points(count):
    points = np.random.default_rng(1).normal(size=(300, 2))
    np.testing.assert_array_equal(lloyd(covered_region(points), count), lloyd(points, count))


def test_the_seed_decides():
    np.testing.assert_array_equal(lloyd(SQUARE, 7, seed=3), lloyd(SQUARE, 7, seed=3))
    assert np.abs(lloyd(SQUARE, 7, seed=3) - lloyd(SQUARE, 7, seed=4)).max() > 1


@given(st.floats(1e-3, 1e3), st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.integers(3, 12))
def test_centres_move_with_the_data(scale, x, y, count):
    points = np.random.default_rng(1).uniform(0, 1, (40, 2)) * [16, 9]
    expected = lloyd(points, count)
    moved = lloyd(scale * (points + np.array([x, y])), count)
    np.testing.assert_allclose(moved / scale - [x, y], expected, atol=1e-7)


@pytest.mark.parametrize("width", [1.0, 1e-2, 1e-4])
@pytest.mark.parametrize("count", [3, 4, 8])
def test_centres_in_a_thin_strip_are_not_on_a_line(width, count):
    centres = lloyd(SQUARE * [1, width], count)
    assert thinness(centres / [1, width]) > 0.1
    ThinPlateSpline(centres)


@given(arrays(float, (6, 2), elements=coordinates, unique=True), st.integers(3, 9), st.integers(0, 5))
def test_centres_are_always_good_control_points_inside_the_region(points, count, seed):
    assume(np.linalg.matrix_rank(points - points[0]) == 2)
    centres = lloyd(points, count, seed=seed)
    assert centres.shape == (count, 2)
    assert inside(covered_region(points), centres).all()
    ThinPlateSpline(centres)


def test_every_layout_of_the_same_numbers_gives_the_same():
    expected = lloyd(SQUARE, 5)
    read_only = SQUARE.copy()
    read_only.flags.writeable = False
    for same in (
        SQUARE.tolist(),
        SQUARE.astype(np.float32),
        np.asfortranarray(SQUARE),
        read_only,
        SQUARE.astype(int),
    ):
        np.testing.assert_array_equal(lloyd(same, np.int64(5)), expected)


@pytest.mark.parametrize("exponent", [-500, -300, 300])
def test_extreme_units_change_nothing_but_the_unit(exponent):
    points, unit = np.random.default_rng(0).uniform(0, 640, (60, 2)), 2.0**exponent
    np.testing.assert_allclose(lloyd(unit * points, 8) / unit, lloyd(points, 8), rtol=1e-9)
    region = covered_region(points)
    np.testing.assert_allclose(lattice(unit * region, 100) / unit, lattice(region, 100), rtol=1e-9)
