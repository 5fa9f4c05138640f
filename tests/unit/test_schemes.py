import pickle
import tracemalloc
from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest
import verde
from hypothesis import given
from hypothesis import strategies as st
from refits import every_scheme
from scipy.sparse import coo_array
from scipy.spatial import Delaunay
from sklearn.model_selection import (
    GroupKFold,
    KFold,
    LeaveOneGroupOut,
    ShuffleSplit,
    TimeSeriesSplit,
    cross_val_predict,
)
from sklearn.neighbors import KNeighborsRegressor

import mexpress as mx

s = mx.schemes


def lists(sets):
    return [x.tolist() for x in sets]


def exact_squares(points):
    """Squared distances without rounding."""
    rows = [[Fraction(float(x)) for x in point] for point in np.asarray(points)]
    return [[sum((a - b) ** 2 for a, b in zip(p, q, strict=True)) for q in rows] for p in rows]


def check_around(scheme, n):
    """Datum i alone is validated in pair i, and is held out."""
    assert scheme.n_data == n
    assert lists(scheme.validated) == [[i] for i in range(n)]
    for i, held in enumerate(scheme.held_out):
        assert i in held
        assert (np.diff(held) > 0).all()
        assert held.dtype == np.int64


grid_points = st.integers(1, 3).flatmap(
    lambda d: st.lists(st.lists(st.integers(-4, 4), min_size=d, max_size=d), min_size=1, max_size=25)
)


# -------------------------------------------------------------------------------------------- leave-one-out


@pytest.mark.parametrize("n", [1, 2, 17])
def test_leave_one_out(n):
    scheme = s.leave_one_out(n)
    check_around(scheme, n)
    assert lists(scheme.held_out) == [[i] for i in range(n)]


# --------------------------------------------------------------------------------------------------- k-fold


@given(n=st.integers(2, 60), data=st.data(), seed=st.integers(0, 100))
def test_folds_are_a_partition_of_nearly_equal_sizes(n, data, seed):
    k = data.draw(st.integers(2, n))
    scheme = s.k_fold(n, k, seed)
    assert len(scheme) == k
    assert lists(scheme.held_out) == lists(scheme.validated)
    sizes = scheme.held_out.sizes
    assert sizes.max() - sizes.min() <= 1
    assert sorted(np.concatenate(list(scheme.held_out)).tolist()) == list(range(n))
    assert lists(s.k_fold(n, k, seed).held_out) == lists(scheme.held_out)


@pytest.mark.parametrize(
    "build",
    [
        lambda seed: s.k_fold(40, 5, seed),
        lambda seed: s.leave_p_out(40, 3, 12, seed),
        lambda seed: s.random_sampling(40, 9, 12, seed),
    ],
)
def test_seeds(build):
    one = lists(build(3).held_out)
    assert lists(build(3).held_out) == one
    assert lists(build(4).held_out) != one
    assert lists(build(np.random.default_rng(3)).held_out) == one
    assert lists(build(None).held_out) != lists(build(None).held_out)
    generator = np.random.default_rng(3)
    assert lists(build(generator).held_out) != lists(build(generator).held_out)


# ----------------------------------------------------------------------------------------- exclusion radius


@given(points=grid_points, radius=st.sampled_from([0, 1, 2, 5, 0.5, 1.42, 2.3, 100]))
def test_exclusion_radius_on_grids(points, radius):
    scheme = s.exclusion_radius(points, radius)
    check_around(scheme, len(points))
    squares, limit = exact_squares(points), Fraction(radius) ** 2
    assert lists(scheme.held_out) == [[j for j, d in enumerate(row) if d <= limit] for row in squares]


@given(
    n=st.integers(1, 60),
    dimension=st.integers(1, 3),
    radius=st.floats(0, 2),
    shift=st.sampled_from([0, 1e3, -1e6]),
    seed=st.integers(0, 999),
)
def test_exclusion_radius_anywhere(n, dimension, radius, shift, seed):
    points = np.random.default_rng(seed).uniform(size=(n, dimension)) + shift
    squares, limit = exact_squares(points), Fraction(radius) ** 2
    for i, held in enumerate(s.exclusion_radius(points, radius).held_out):
        # Rounding may decide, at distances that differ from the radius by rounding.
        unsure = [j for j, d in enumerate(squares[i]) if abs(d - limit) <= Fraction(1e-14) * limit]
        sure = {j for j, d in enumerate(squares[i]) if d <= limit} - set(unsure)
        assert sure <= set(held.tolist()) <= sure | set(unsure)


def test_the_radius_belongs_to_the_excluded():
    # d <= tau: 3, 4, 5 and 5, 12, 13 are exact.
    scheme = s.exclusion_radius([[0, 0], [3, 4], [-5, 12], [0, 5.000001]], 5)
    assert lists(scheme.held_out)[0] == [0, 1]
    assert lists(s.exclusion_radius([[0, 0], [3, 4], [-5, 12]], 13).held_out)[0] == [0, 1, 2]


def test_radius_zero_holds_out_what_coincides():
    assert lists(s.exclusion_radius([[1, 1], [2, 2], [1, 1]], 0).held_out) == [[0, 2], [1], [0, 2]]


# -------------------------------------------------------------------------------------------------- nearest


@given(points=grid_points, data=st.data())
def test_nearest_on_grids_breaks_ties_by_index(points, data):
    n = len(points)
    k = data.draw(st.integers(1, n))
    scheme = s.nearest(points, k)
    check_around(scheme, n)
    for i, row in enumerate(exact_squares(points)):
        others = sorted((d, j) for j, d in enumerate(row) if j != i)
        assert scheme.held_out[i].tolist() == sorted([i] + [j for _, j in others[: k - 1]])


@given(n=st.integers(1, 80), dimension=st.integers(1, 3), seed=st.integers(0, 999), data=st.data())
def test_nearest_anywhere(n, dimension, seed, data):
    points = np.random.default_rng(seed).normal(size=(n, dimension)) * 1e4
    k = data.draw(st.integers(1, n))
    distances = np.linalg.norm(points[:, None] - points, axis=2)
    expected = np.sort(np.argsort(distances, axis=1)[:, :k], axis=1)
    np.testing.assert_array_equal(list(s.nearest(points, k).held_out), expected)


def test_nearest_of_size_one_is_leave_one_out_and_of_size_two_one_neighbour():
    points = np.random.default_rng(0).uniform(size=(30, 2))
    assert lists(s.nearest(points, 1).held_out) == [[i] for i in range(30)]
    assert set(s.nearest(points, 2).held_out.sizes.tolist()) == {2}
    assert set(s.nearest(points, 30).held_out.sizes.tolist()) == {30}


def test_many_data_in_one_place():
    # More than a query keeps at once: the smaller indices, and the datum itself.
    points = np.zeros((1000, 2))
    scheme = s.nearest(points, 3)
    assert lists(scheme.held_out)[:4] == [[0, 1, 2], [0, 1, 2], [0, 1, 2], [0, 1, 3]]
    assert scheme.held_out[999].tolist() == [0, 1, 999]
    assert set(s.exclusion_radius(points, 0).held_out.sizes.tolist()) == {1000}


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_threads_do_not_matter(threads):
    x, y = np.meshgrid(np.arange(40.0), np.arange(30.0))
    points = np.column_stack([x.ravel(), y.ravel()])
    for build in (
        lambda t: s.exclusion_radius(points, 3, threads=t),
        lambda t: s.nearest(points, 9, threads=t),
    ):
        one, many = build(1).held_out, build(threads).held_out
        np.testing.assert_array_equal(one.offsets, many.offsets)
        np.testing.assert_array_equal(one.indices, many.indices)


@pytest.mark.parametrize("scale", [1e-300, 1e-150, 1e-9, 1e9, 1e90])
def test_neighbourhoods_do_not_depend_on_the_unit(scale):
    points = np.random.default_rng(0).integers(0, 6, (40, 2)).astype(float)
    for build in (
        lambda c: s.exclusion_radius(points * c, 1.5 * c),
        lambda c: s.nearest(points * c, 5),
        lambda c: s.delaunay(points * c),
    ):
        power = 2.0 ** np.round(np.log2(scale))  # exact
        assert lists(build(power).held_out) == lists(build(1.0).held_out)


# ------------------------------------------------------------------------------------------------- Delaunay


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("n", [4, 10, 100, 400])
def test_delaunay_is_that_of_scipy(seed, n):
    points = np.random.default_rng(seed).uniform(0, 1000, (n, 2))
    offsets, neighbours = Delaunay(points).vertex_neighbor_vertices
    expected = [sorted([i, *neighbours[offsets[i] : offsets[i + 1]].tolist()]) for i in range(n)]
    scheme = s.delaunay(points)
    check_around(scheme, n)
    assert lists(scheme.held_out) == expected


def test_delaunay_of_repeated_points():
    points = np.random.default_rng(0).uniform(size=(30, 2))
    repeated = np.vstack([points, points[:10]])
    once, twice = s.delaunay(points).held_out, s.delaunay(repeated).held_out
    for i in range(30):
        expected = set(once[i].tolist()) | {j + 30 for j in once[i].tolist() if j < 10}
        assert set(twice[i].tolist()) == expected
    for i in range(10):
        assert twice[30 + i].tolist() == twice[i].tolist()


@pytest.mark.parametrize("shape", [(2, 2), (3, 5), (20, 30)])
def test_delaunay_of_a_grid_joins_what_is_beside(shape):
    height, width = shape
    y, x = (z.ravel() for z in np.mgrid[:height, :width])
    held = s.delaunay(np.column_stack([x, y])).held_out
    for i, neighbours in enumerate(held):
        steps = np.abs(x[neighbours] - x[i]) + 1j * np.abs(y[neighbours] - y[i])
        assert set(steps) <= {0, 1, 1j, 1 + 1j}
        inner = [x[i] > 0, x[i] < width - 1, y[i] > 0, y[i] < height - 1]
        assert sum(abs(steps) == 1) == sum(map(int, inner))
        assert all(i in held[j] for j in neighbours)


@pytest.mark.parametrize("points", [[[0, 0]], [[0, 0], [0, 0]], [[1, 1], [0, 0], [2, 2], [3, 3]]])
def test_delaunay_without_a_triangle(points):
    expected = {1: [[0]], 2: [[0, 1]] * 2, 4: [[0, 1, 2], [0, 1], [0, 2, 3], [2, 3]]}[len(points)]
    assert lists(s.delaunay(points).held_out) == expected


# -------------------------------------------------------------------------------------------------- matched


def matched_step_by_step(points, queries, min_train, cast=False):
    """One distance matrix, one removal at a time: literally what CAST does, or as it is with a limit that binds."""
    n = len(points)
    distance = np.sqrt(((points[:, None] - points) ** 2).sum(axis=2))
    np.fill_diagonal(distance, np.inf)
    asked = np.sqrt(((points[:, None] - queries) ** 2).sum(axis=2)).min(axis=0)
    left = distance.min(axis=1)
    r = left.min()
    while True:
        too_many = ((left <= r).sum() - 1) / n >= (asked <= r).mean()
        there = np.flatnonzero(left == r)
        free = there[np.isfinite(distance[there]).sum(axis=1) / n > min_train]
        if too_many and len(free) and (not cast or free[0] == there[0]):
            nearest = np.flatnonzero(distance[free[0]] == r)
            distance[free[0], nearest if cast else nearest[0]] = np.inf
            left = distance.min(axis=1)
            r = left[left >= r].min()
        elif (left > r).any():
            r = left[left > r].min()
        else:
            return [np.flatnonzero(np.isinf(row)).tolist() for row in distance]


def kolmogorov(a, b):
    both = np.concatenate([a, b])
    return max(abs((a <= x).mean() - (b <= x).mean()) for x in both)


def distances_left(scheme, points):
    """From each datum to the nearest one that is not held out with it."""
    every = np.hypot.reduce(points[:, None] - points, axis=2)
    for i, held in enumerate(scheme.held_out):
        every[i, held] = np.inf
    return every.min(axis=1)


def crowds(rng, n, d):
    return rng.uniform(0, 1, (6, d))[rng.integers(6, size=n)] + rng.normal(0, 0.03, (n, d))


@pytest.mark.parametrize("d", [1, 2, 3])
def test_matched_is_the_published_algorithm(d):
    rng = np.random.default_rng(d)
    for points in (rng.uniform(size=(60, d)), crowds(rng, 80, d)):
        for queries in (
            rng.uniform(size=(150, d)),
            rng.uniform(-0.2, 1.2, (31, d)),
            points[:9] + 0.01,
            points,
        ):
            scheme = s.matched(points, queries, min_train=1e-9)
            check_around(scheme, len(points))
            assert lists(scheme.held_out) == matched_step_by_step(points, queries, 0.01, cast=True)


@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("min_train", [0.1, 0.5, 0.9])
def test_matched_leaves_what_it_must_and_lets_the_others_go_on(d, min_train):
    rng = np.random.default_rng(d)
    for points in (rng.uniform(size=(60, d)), crowds(rng, 80, d), rng.uniform(size=(20, d))):
        for queries in (rng.uniform(size=(150, d)), rng.uniform(1, 1.5, (31, d)), points[:9] + 0.01):
            scheme = s.matched(points, queries, min_train)
            assert lists(scheme.held_out) == matched_step_by_step(points, queries, min_train)


@given(grid_points, st.integers(0, 9), st.sampled_from([0.1, 0.5]), st.randoms(use_true_random=False))
def test_matched_with_ties_and_duplicates(points, shift, min_train, random):
    points = np.array(points * 2, dtype=float)[: max(len(points), 11)]
    queries = np.array([[random.randint(-4, 4) + shift for _ in points[0]] for _ in range(7)], dtype=float)
    scheme = s.matched(points, queries, min_train)
    check_around(scheme, len(points))
    if min_train * len(points) >= 1:  # or one is left all the same
        assert lists(scheme.held_out) == matched_step_by_step(points, queries, min_train)


def test_matched_distances_follow_those_of_the_queries():
    rng = np.random.default_rng(1)
    points, queries = rng.uniform(size=(400, 2)) ** 3, rng.uniform(size=(2000, 2))
    asked = np.hypot.reduce(queries[:, None] - points, axis=2).min(axis=1)
    alone, matched = (distances_left(x, points) for x in (s.leave_one_out(400), s.matched(points, queries)))
    assert kolmogorov(alone, asked) > 0.3
    assert kolmogorov(matched, asked) < 0.02


def test_matched_to_queries_among_the_data_is_leave_one_out():
    rng = np.random.default_rng(2)
    points = rng.uniform(size=(300, 2))
    dense = np.repeat(points, 5, axis=0) + rng.normal(0, 1e-5, (1500, 2))
    assert lists(s.matched(points, dense).held_out) == [[i] for i in range(300)]


@pytest.mark.parametrize(("n", "min_train", "held"), [(1, 0.5, 1), (2, 0.5, 1), (3, 0.5, 2), (100, 0.5, 50)])
@pytest.mark.parametrize("place", [1e3, 1e90])
def test_matched_to_queries_far_away_leaves_what_it_must(n, min_train, held, place):
    points = np.random.default_rng(3).uniform(size=(n, 2))
    scheme = s.matched(points, [[place, place]], min_train)
    assert scheme.held_out.sizes.tolist() == [held] * n
    assert lists(scheme.held_out) == lists(s.nearest(points, held).held_out)
    assert sorted(scheme.order.tolist()) == list(range(n))


def test_matched_leaves_the_share_that_is_asked_for():
    points = np.random.default_rng(4).uniform(size=(40, 2))
    for share, held in [(1.0, 1), (0.9, 4), (0.25, 30), (1e-9, 39)]:
        assert set(s.matched(points, [[9.0, 9.0]], share).held_out.sizes) == {held}


@pytest.mark.slow
def test_matched_on_a_grid_with_ties_everywhere():
    grid = np.stack(np.meshgrid(np.arange(20.0), np.arange(15.0)), -1).reshape(-1, 2)
    queries = np.random.default_rng(5).uniform(-8, 28, (500, 2))
    scheme = s.matched(grid, queries, min_train=0.2)
    assert lists(scheme.held_out) == matched_step_by_step(grid, queries, 0.2)
    assert scheme.held_out.sizes.max() == 240
    many = s.matched(grid, queries, min_train=0.2, threads=3)
    assert lists(many.held_out) == lists(scheme.held_out)


@pytest.mark.parametrize("queries", [[], [[0.0]], [[0.0, np.nan]], "all", [[0.0, np.inf]], [[1e200, 0.0]]])
def test_matched_refuses_bad_queries(queries):
    with pytest.raises((ValueError, TypeError), match="Invalid queries"):
        s.matched([[0.0, 0.0], [1.0, 0.0]], queries)


@pytest.mark.parametrize("share", [0, -1, 1.5, np.nan, "half", True])
def test_matched_refuses_a_share_that_is_none(share):
    with pytest.raises((ValueError, TypeError), match="Invalid min_train"):
        s.matched([[0.0, 0.0], [1.0, 0.0]], [[0.0, 0.0]], share)


# ------------------------------------------------------------------------------------------- any distance


def test_from_distance_is_an_exclusion_radius_if_distances_are_euclidean():
    points = np.random.default_rng(6).uniform(size=(50, 2))
    matrix = np.hypot.reduce(points[:, None] - points, axis=2)
    near = lists(s.exclusion_radius(points, 0.3).held_out)
    for delta, n in [(matrix, None), (matrix.tolist(), 50), (np.asfortranarray(matrix), None)]:
        scheme = s.from_distance(delta, 0.3, n)
        check_around(scheme, 50)
        assert lists(scheme.held_out) == near
    rows = s.from_distance(
        lambda i: np.hypot.reduce(points - points[i], axis=1).astype(np.float32), 0.3, n=50
    )
    assert lists(rows.held_out) == near


def test_from_distance_takes_rows_from_datum_to_others_and_always_the_datum():
    delta = np.array([[9.0, 1.0, np.inf], [3.0, 9.0, 1.0], [-1.0, 2.0, 9.0]])
    assert lists(s.from_distance(delta, 1).held_out) == [[0, 1], [1, 2], [0, 2]]
    assert lists(s.from_distance(lambda i: delta[i], 1, n=3).held_out) == [[0, 1], [1, 2], [0, 2]]


@pytest.mark.parametrize(
    ("delta", "tau", "n", "name"),
    [
        (np.ones((2, 3)), 1, None, "delta"),
        (np.ones(3), 1, None, "delta"),
        ([], 1, None, "delta"),
        ("near", 1, None, "delta"),
        ([[0.0, np.nan], [1.0, 0.0]], 1, None, "delta"),
        (np.eye(2), -1, None, "tau"),
        (np.eye(2), np.nan, None, "tau"),
        (np.eye(2), 1, 3, "n"),
        (lambda i: [0.0, 1.0], 1, None, "n"),
        (lambda i: [0.0, 1.0], 1, 3, "delta"),
        (lambda i: 0.0, 1, 1, "delta"),
        (lambda i: "near", 1, 2, "delta"),
    ],
)
def test_from_distance_refuses(delta, tau, n, name):
    with pytest.raises((ValueError, TypeError), match=f"Invalid {name}\\."):
        s.from_distance(delta, tau, n)


# ---------------------------------------------------------------------------------------------- leave-p-out


@pytest.mark.parametrize(("n", "p"), [(1, 1), (5, 1), (5, 2), (6, 3), (6, 6)])
def test_leave_p_out_is_every_set(n, p):
    scheme = s.leave_p_out(n, p)
    assert lists(scheme.held_out) == [list(c) for c in combinations(range(n), p)]
    assert lists(scheme.validated) == lists(scheme.held_out)


@given(n=st.integers(1, 12), data=st.data(), seed=st.integers(0, 99))
def test_sampled_sets_are_distinct(n, data, seed):
    p = data.draw(st.integers(1, n))
    most = data.draw(st.integers(1, 60))
    scheme = s.leave_p_out(n, p, most, seed)
    every = set(combinations(range(n), p))
    drawn = [tuple(x) for x in lists(scheme.held_out)]
    assert len(drawn) == min(most, len(every))
    assert len(set(drawn)) == len(drawn)
    assert set(drawn) <= every


def test_sampled_sets_are_spread_over_all():
    counts = np.zeros(10)
    for seed in range(200):
        for held in s.leave_p_out(10, 2, 9, seed).held_out:
            counts[held] += 1
    assert counts.sum() == 3600
    assert np.abs(counts - 360).max() < 5 * np.sqrt(360)


def test_too_many_sets_are_refused_before_they_are_made():
    with pytest.raises(ValueError, match=r"^Invalid p\. .*max_sets"):
        s.leave_p_out(100, 10)
    assert len(s.leave_p_out(1000, 500, max_sets=3, seed=0)) == 3


def test_random_sampling():
    scheme = s.random_sampling(20, 6, 50, seed=0)
    assert len(scheme) == 50
    assert lists(scheme.held_out) == lists(scheme.validated)
    assert set(scheme.held_out.sizes.tolist()) == {6}
    assert all((np.diff(held) > 0).all() for held in scheme.held_out)
    assert set(np.concatenate(list(scheme.held_out)).tolist()) == set(range(20))


# --------------------------------------------------------------------------------------------- sets, splits


def test_sets_of_any_order_and_kind():
    held = [[3, 1], np.array([2, 0], dtype=np.uint8), range(4), (5,), []]
    scheme = s.from_sets(iter(held), [[1], [0], (2, 3), [], []])
    assert scheme.n_data == 6
    assert lists(scheme.held_out) == [[1, 3], [0, 2], [0, 1, 2, 3], [5], []]
    assert lists(scheme.validated) == [[1], [0], [2, 3], [], []]
    assert s.from_sets(held, n=9).n_data == 9


@pytest.mark.parametrize(
    ("held", "validated", "options"),
    [
        ([[0, 0]], None, {}),
        ([[-1]], None, {}),
        ([[3]], None, {"n": 3}),
        ([[0]], [[1]], {}),
        ([[0]], [[0], [0]], {}),
        ([[0]], [[0, 0]], {}),
    ],
)
def test_bad_sets(held, validated, options):
    with pytest.raises(ValueError, match=r"^Invalid (held_out|validated)(\[0\])?\. .* Given .*\.$"):
        s.from_sets(held, validated, **options)


def test_splits_hold_out_all_that_is_not_trained_on():
    scheme = s.from_splits([([0, 1], [4]), ([4], [0, 2])], n=6)
    assert lists(scheme.held_out) == [[2, 3, 4, 5], [0, 1, 2, 3, 5]]
    assert lists(scheme.validated) == [[4], [0, 2]]


def test_splits_must_not_train_on_what_they_test():
    with pytest.raises(ValueError, match=r"^Invalid splits\[1\]\. .*datum 1 in both\.$"):
        s.from_splits([([0], [1]), ([0, 1], [1])])


def test_splits_must_not_repeat_what_they_train_on():
    with pytest.raises(ValueError, match=r"^Invalid splits\[1\]\. .*bootstrap.* Given datum 2, 3 times\.$"):
        s.from_splits([([0], [1]), ([0, 2, 2, 2], [1])])


def test_later_splits_may_have_more_data():
    scheme = s.from_splits(iter([([1], [0]), ([0, 1, 3], [2, 4]), ([0], [3])]))
    assert scheme.n_data == 5
    assert lists(scheme.held_out) == [[0, 2, 3, 4], [2, 4], [1, 2, 3, 4]]
    assert lists(scheme.validated) == [[0], [2, 4], [3]]


@pytest.mark.parametrize("n", [2000, None])
def test_training_data_of_many_splits_are_not_kept(n):
    n_splits, data, few = 1000, np.arange(2000), 20
    drawn = (np.roll(data, few * i) for i in range(n_splits))
    tracemalloc.start()
    scheme = s.from_splits(((order[few:], order[:few]) for order in drawn), n)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(scheme) == n_splits
    assert peak < 2e6  # what they train on takes 16 MB


def test_splits_are_refused_as_soon_as_they_are_too_many(monkeypatch):
    monkeypatch.setattr(s, "MOST_INDICES", 100)

    for n in (50, 51):
        rule = r"^Invalid splits\. .*must fit in 100 indices\. Given 1\d\d, in 3 splits of 5\d data\.$"
        with pytest.raises(ValueError, match=rule):
            s.from_splits([([0], [1])] * 1000, n)


def test_sets_are_a_sequence():
    sets = s.from_sets([[0, 2], [], [1]]).held_out
    assert len(sets) == 3
    assert sets[-1].tolist() == [1]
    assert lists(sets[:2]) == [[0, 2], []]
    assert lists(sets) == lists(sets[i] for i in range(3))
    assert lists(reversed(sets)) == [[1], [], [0, 2]]
    for i in (3, -4):
        with pytest.raises(IndexError):
            sets[i]
    assert list(s.from_sets([]).held_out) == []


N = 45
GROUPS = np.arange(N) % 7


def splits(points):
    return {
        "KFold": KFold(5, shuffle=True, random_state=0).split(points),
        "ShuffleSplit": ShuffleSplit(6, test_size=0.2, train_size=0.6, random_state=0).split(points),
        "TimeSeriesSplit": TimeSeriesSplit(4, gap=2).split(points),
        "GroupKFold": GroupKFold(3).split(points, groups=GROUPS),
        "LeaveOneGroupOut": LeaveOneGroupOut().split(points, groups=GROUPS),
        "BlockKFold": verde.BlockKFold(spacing=200, n_splits=4, shuffle=True, random_state=0).split(points),
        "BlockShuffleSplit": verde.BlockShuffleSplit(spacing=200, n_splits=4, random_state=0).split(points),
    }


@pytest.mark.parametrize("name", splits(np.zeros((N, 2))))
@pytest.mark.parametrize("coupling", [1, 2])
def test_splitters_equal_refits_of_their_training_data(name, coupling):
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 1000, (N, 2))
    rows = np.arange(N * coupling).reshape(N, coupling)
    A, b = rng.normal(size=(N * coupling, 4)), rng.normal(size=N * coupling)
    folds = list(splits(points)[name])
    cv = mx.LeastSquares(A, b, coupling).cross_validate(s.from_splits(folds, n=N))
    total = count = 0
    for k, (train, test) in enumerate(folds):
        kept, held = rows[train].ravel(), rows[np.sort(test)].ravel()
        expected = b[held] - A[held] @ np.linalg.lstsq(A[kept], b[kept], rcond=None)[0]
        np.testing.assert_allclose(cv.residuals[cv.pairs == k], expected, rtol=1e-9, atol=1e-9)
        total, count = total + (expected**2).sum(), count + len(test)
    assert cv.score == pytest.approx(np.sqrt(total / count))


def test_n_is_the_largest_index_and_one():
    assert s.from_splits([([0, 1], [6]), ([2], [3])]).n_data == 7
    assert s.from_splits(KFold(3).split(np.zeros(10))).n_data == 10


@pytest.mark.parametrize("name", every_scheme(np.random.default_rng(0).uniform(0, 1000, (40, 2))))
def test_every_scheme_splits_into_training_and_test_data(name):
    scheme = every_scheme(np.random.default_rng(0).uniform(0, 1000, (40, 2)))[name]
    pairs = list(scheme.split(np.zeros((40, 3)), np.zeros(40), None))
    assert len(pairs) == scheme.get_n_splits() == len(scheme)
    for (train, test), held, validated in zip(pairs, scheme.held_out, scheme.validated, strict=True):
        assert sorted([*train, *held]) == list(range(40))
        assert test.tolist() == validated.tolist()
    again = s.from_splits(pairs, 40)
    assert (lists(again.held_out), lists(again.validated)) == (
        lists(scheme.held_out),
        lists(scheme.validated),
    )


def test_a_scheme_splits_its_own_number_of_data_only():
    scheme = s.leave_one_out(3)
    assert len(list(scheme.split(coo_array((3, 2))))) == len(list(scheme.split([1, 2, 3]))) == 3
    with pytest.raises(ValueError, match=r"Invalid X\. It must have the scheme's 3 data\. Given 4 data"):
        scheme.split(np.zeros((4, 2)))


def test_schemes_are_splitters_of_scikit_learn():
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 1, (60, 2))
    y = points[:, 0] + rng.normal(0, 0.1, 60)
    near = s.exclusion_radius(points, 0.2)
    predicted = cross_val_predict(KNeighborsRegressor(1), points, y, cv=near)
    for i in range(60):
        far = np.flatnonzero(np.linalg.norm(points - points[i], axis=1) > 0.2)
        assert predicted[i] == y[far[np.linalg.norm(points[far] - points[i], axis=1).argmin()]]


@pytest.mark.parametrize("radius", [0.0, 60.0, 250.0])
def test_a_buffer_is_around_all_that_is_validated(radius):
    points = np.random.default_rng(3).uniform(0, 1000, (50, 2))
    folds = s.from_splits(
        verde.BlockKFold(spacing=300, n_splits=5, shuffle=True, random_state=0).split(points), 50
    )
    wide = s.buffered(folds, points, radius)
    assert lists(wide.validated) == lists(folds.validated)
    distances = np.linalg.norm(points[:, None] - points, axis=2)
    for held, own, validated in zip(wide.held_out, folds.held_out, folds.validated, strict=True):
        assert set(held) == set(own) | set(np.flatnonzero((distances[validated] <= radius).any(axis=0)))


def test_a_buffer_of_leave_one_out_is_local_exclusion():
    points = np.random.default_rng(3).uniform(0, 1000, (50, 2))
    wide, near = s.buffered(s.leave_one_out(50), points, 200.0), s.exclusion_radius(points, 200.0)
    assert lists(wide.held_out) == lists(near.held_out)


@pytest.mark.parametrize(
    ("scheme", "points", "radius", "name"),
    [
        ("folds", np.zeros((3, 2)), 1.0, "scheme"),
        (s.leave_one_out(4), np.zeros((3, 2)), 1.0, "points"),
        (s.leave_one_out(3), np.zeros((3, 2)), -1.0, "radius"),
        (s.leave_one_out(3), [[0.0, np.nan]] * 3, 1.0, "points"),
    ],
)
def test_what_has_no_buffer(scheme, points, radius, name):
    with pytest.raises((ValueError, TypeError), match=f"^Invalid {name}\\."):
        s.buffered(scheme, points, radius)


def test_neighbourhoods_that_are_many_are_found_when_they_are_needed(monkeypatch):
    rng = np.random.default_rng(0)
    points, model = (
        rng.uniform(0, 1, (300, 2)),
        mx.LeastSquares(rng.normal(size=(300, 4)), rng.normal(size=300)),
    )
    calls = {"within": lambda: s.exclusion_radius(points, 0.1), "nearest": lambda: s.nearest(points, 9)}
    for call in calls.values():
        listed = call()
        expected = model.cross_validate(listed)
        with monkeypatch.context() as patch:
            patch.setattr(s, "_MOST_LISTED", 1000)
            lazy = call()
        assert isinstance(lazy, s.Scheme)
        assert repr(lazy).startswith("LazyNeighbourhoods(300 data, about ")
        assert len(lazy) == 300
        found = model.cross_validate(lazy)
        np.testing.assert_allclose(found.residuals, expected.residuals, rtol=1e-12)
        np.testing.assert_array_equal(found.pairs, expected.pairs)
        assert "held_out" not in vars(lazy), "they were listed"
        np.testing.assert_array_equal(lazy.held_out.indices, listed.held_out.indices)
        again = pickle.loads(pickle.dumps(lazy))
        np.testing.assert_array_equal(again.held_out.indices, listed.held_out.indices)
        np.testing.assert_array_equal(model.cross_validate(again).residuals, found.residuals)
        train, test = next(iter(lazy.split()))
        np.testing.assert_array_equal(np.union1d(train, listed.held_out[0]), np.arange(300))
        assert test.tolist() == [0]


def test_a_million_data_with_a_thousand_around_each_are_no_list():
    points = np.random.default_rng(0).uniform(0, 1, (1_000_000, 2))
    scheme = s.exclusion_radius(points, np.sqrt(1e-3 / np.pi))
    assert 900 < scheme.search.mean < 1100
    with pytest.raises(ValueError, match=r"^Invalid points\. Their neighbourhoods must fit in memory"):
        scheme.held_out  # noqa: B018 - asked for
