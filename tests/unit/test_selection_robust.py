import warnings
from statistics import NormalDist

import numpy as np
import pytest

import mexpress as mx
from mexpress.selection.data import Matches, Samples
from mexpress.selection.robust import FEWEST, Surroundings, agreeing, beyond_gaps, find_wrong
from mexpress.suspicion import SuspicionWarning, chi_square_quantile

SIZE = (640.0, 480.0)


def bent(points, seed):
    """Return a smooth warp of an image, with perspective."""
    x, y = points.T / 500
    a, b = np.random.default_rng(seed).uniform(0, 6, 2)
    wave = 20 * np.column_stack([np.sin(3 * y + a), np.cos(4 * x + b)])
    return (1.1 * points + wave) / (1 + 0.2 * x + 0.1 * y)[:, None]


def matches(seed, n=120, noise=0.5):
    """Return matches of a bent sheet, in pixels."""
    random = np.random.default_rng(seed)
    source = random.uniform(0, SIZE, (n, 2))
    return source, bent(source, seed) + random.normal(0, noise, (n, 2))


def room(seed, n=300, noise=0.01):
    """Return depths of a wavy wall with a box before it: edges."""
    random = np.random.default_rng(seed)
    points = random.uniform(0, SIZE, (n, 2))
    x, y = points.T
    box = (np.abs(x - 300) < 120) & (np.abs(y - 240) < 100)
    depth = 3 + 0.3 * np.sin(x / 100) * np.cos(y / 80) - 1.0 * box
    return points, depth + random.normal(0, noise, n)


def planted(points, values, how, share, seed):
    """Return the data with a share of wrong ones, and which these are."""
    random, n = np.random.default_rng([seed, 1]), len(points)
    wrong = np.sort(random.choice(n, round(share * n), replace=False))
    points, values = points.copy(), values.copy()
    low, high = values.min(axis=0), values.max(axis=0)
    if how == "target":
        values[wrong] = random.uniform(low, high, values[wrong].shape)
    elif how == "permuted":
        values[wrong] = np.roll(values[wrong], 1, axis=0)
    elif how == "placeholder":
        values[wrong] = -9999
    elif how == "huge":
        values[wrong] = 1e6
    elif how == "source":
        points[wrong] = random.uniform(0, SIZE, (len(wrong), 2))
    elif how == "far source":
        points[wrong] = random.uniform(2, 5, (len(wrong), 2)) * SIZE
    elif how == "shifted":
        values[wrong] += random.choice([-1, 1], len(wrong)) * random.uniform(3, 6, len(wrong)) * values.std()
    return points, values, wrong


def wrong_matches(source, target, **settings):
    """Find the wrong ones of matches."""
    found = find_wrong(
        Matches.of(source, target),
        lambda some: mx.select_warp(source[some], target[some], criteria=[]),
        **settings,
    )
    return np.sort(found.indices)


def wrong_samples(points, values, **settings):
    """Find the wrong ones of samples."""
    found = find_wrong(
        Samples.of(points, values),
        lambda some: mx.select_surface(points[some], values[some], criteria=[]),
        **settings,
    )
    return np.sort(found.indices)


@pytest.mark.parametrize("share", [0.01, 0.1, 0.2, 0.3])
@pytest.mark.parametrize(
    "how", ["target", "permuted", "placeholder", "huge", "source", "far source", "shifted"]
)
def test_wrong_matches_are_found_and_no_others(how, share):
    if how == "shifted":
        source, target, wrong = planted(*matches(3), "target", share, 4)
    else:
        source, target, wrong = planted(*matches(2), how, share if how != "permuted" else max(share, 0.02), 2)
    away = np.hypot(*(target - bent(source, 3 if how == "shifted" else 2)).T)
    found = wrong_matches(source, target)
    assert len(np.setdiff1d(found, wrong)) == 0
    missed = np.setdiff1d(wrong, found)
    assert (away[missed] < 15).all()  # a random place may be about right
    assert len(missed) <= 1


@pytest.mark.parametrize("seed", range(3))
def test_no_alarm_on_clean_data(seed):
    assert wrong_matches(*matches(seed)).tolist() == []
    points, depth = room(seed)
    wall = 0.3 * np.sin(points[:, 0] / 100)
    assert wrong_samples(points, wall + np.random.default_rng(seed).normal(0, 0.01, 300)).tolist() == []
    assert len(wrong_samples(points, depth)) <= 5  # corners of the box, which few data show


@pytest.mark.parametrize(
    ("how", "share"), [("shifted", 0.06), ("shifted", 0.2), ("placeholder", 0.2), ("huge", 0.01)]
)
def test_gross_depths_are_found_beside_edges(how, share):
    points, depth, wrong = planted(*room(5), how, share, 5)
    found = wrong_samples(points, depth)
    assert len(np.setdiff1d(wrong, found)) <= len(wrong) // 50
    assert len(np.setdiff1d(found, wrong)) <= 5


@pytest.mark.parametrize("place", [(3000.0, 3000.0), (1e6, 1e6), (-1e6, 50.0)])
def test_a_far_source_point_is_found_and_leaves_no_trace(place):
    source, target = matches(7)
    without = np.delete(np.arange(len(source)), 11)
    source[11] = place
    assert wrong_matches(source, target).tolist() == [11]
    points, depth = room(7)
    points[11] = place
    found = wrong_samples(points, depth)
    assert 11 in found
    assert len(found) <= 6
    again, expected = (
        mx.select_warp(source, target).again(without),
        mx.select_warp(source[without], target[without]),
    )
    np.testing.assert_array_equal(again.warp(source[without]), expected.warp(source[without]))
    assert again.data.diagonal < 1000  # neither scale nor region know it
    assert again.warp.domain.max() < 700


def test_sixty_gross_errors_of_a_thousand_depths_are_found():
    points, depth, wrong = planted(*room(6, 1000), "shifted", 0.06, 6)
    found = wrong_samples(points, depth)
    assert np.setdiff1d(wrong, found).tolist() == []
    assert len(np.setdiff1d(found, wrong)) <= 5


def test_suspects_repeat_the_selection_with_its_own_settings():
    source, target, wrong = planted(*matches(8), "target", 0.1, 8)
    target[wrong] += 40
    settings = {"smoothing": 0, "counts": range(3, 20), "criterion": "ER05", "lifting": "tps"}
    selection = mx.select_warp(source, target, **settings)
    found = selection.suspects()
    assert np.sort(found.indices).tolist() == wrong.tolist()
    again = selection.again(np.delete(np.arange(120), wrong))
    expected = mx.select_warp(np.delete(source, wrong, axis=0), np.delete(target, wrong, axis=0), **settings)
    assert again.criterion == "ER05"
    assert again.count == expected.count
    np.testing.assert_array_equal(again.warp(source), expected.warp(source))


def test_suspects_score_only_data_that_are_present():
    source, target = matches(9)
    target[20] += 50
    weights = np.where(np.arange(120) == 5, 0.0, 1.0)
    found = mx.select_warp(source, target, weights=weights).suspects()
    assert found.indices.tolist() == [20]
    assert np.flatnonzero(np.isnan(found.scores)).tolist() == [5]


def test_threads_and_seeds():
    points, depth, _ = planted(*room(1), "shifted", 0.1, 1)
    data = Samples.of(points, depth)

    def scores(threads, seed):
        found = find_wrong(
            data,
            lambda some: mx.select_surface(points[some], depth[some], criteria=[], threads=threads),
            seed=seed,
            threads=threads,
        )
        return found.scores, found.indices

    (one, which), (many, same), (_, other) = scores(1, 0), scores(3, 0), scores(1, 1)
    np.testing.assert_array_equal(one, many)
    assert which.tolist() == same.tolist()
    assert np.setxor1d(which, other).size <= 2


def test_reweighted_still_works_and_is_deprecated():
    source, target = matches(10)
    target[7] += 40
    selection = mx.select_warp(source, target)
    with pytest.warns(DeprecationWarning, match="reweighted"):
        warp = selection.reweighted(selection.suspects().weights)
    assert np.hypot(*(warp(source) - bent(source, 10)).T).max() < 10


def test_few_data_have_no_verdict():
    source = np.random.default_rng(0).uniform(0, 9, (FEWEST - 1, 2))
    found = find_wrong(Matches.of(source, source[::-1]), lambda some: pytest.fail("no selection is needed"))
    assert found.indices.tolist() == []
    assert len(found.scores) == FEWEST - 1


def test_it_says_so_when_half_of_the_data_are_wrong():
    source, target, _ = planted(*matches(4), "target", 0.5, 4)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", SuspicionWarning)
        wrong_matches(source, target)
    assert len(caught) <= 1  # found or not, it is said once


def test_neighbours_on_a_line_and_in_one_place_give_a_verdict():
    x = np.repeat(np.arange(30.0), 2)
    points = np.column_stack([x, np.repeat([0.0, 100.0], 30)])
    depth = 0.1 * x
    depth[13] = 90.0
    kept, _ = agreeing(Samples.of(points, depth), Surroundings.of(points, None), 0)
    assert np.flatnonzero(~kept).tolist() == [13]


def test_a_second_group_of_many_is_not_beyond_a_gap():
    random = np.random.default_rng(0)
    near, far = random.uniform(0, 1, (60, 2)), random.uniform(50, 80, (40, 2))
    assert not beyond_gaps(np.vstack([near, far])).any()
    assert np.flatnonzero(beyond_gaps(np.vstack([near, far[:5]]))).tolist() == [60, 61, 62, 63, 64]
    assert np.flatnonzero(beyond_gaps(np.vstack([near, -far[:5]]))).tolist() == [60, 61, 62, 63, 64]


def test_neighbours_are_the_nearest_that_are_kept():
    points = np.random.default_rng(3).uniform(0, 1, (50, 2))
    kept = np.arange(50) % 3 > 0
    chosen, valid = Surroundings.of(points, None).kept(kept, 6)
    assert valid.all()
    for i, own in enumerate(chosen):
        distances = np.where(kept & (np.arange(50) != i), np.hypot(*(points - points[i]).T), np.inf)
        assert own.tolist() == np.argsort(distances)[:6].tolist()


@pytest.mark.parametrize("share", [0.5, 0.75, 0.95])
def test_quantiles_of_chi_squares(share):
    two = -2 * np.log(1 - share)
    one = NormalDist().inv_cdf((1 + share) / 2) ** 2
    np.testing.assert_allclose(chi_square_quantile(share, np.array([1, 2])), [one, two], rtol=0.04)


# The one call


@pytest.mark.parametrize("place", [(3000.0, 3000.0), (1e6, 1e6), (-1e6, 50.0)])
def test_one_far_source_point_leaves_no_trace(place):
    random = np.random.default_rng(3)
    source = random.uniform(0, 1, (80, 2)) * [640, 480]
    target = source + 8 * np.sin(source / 90) + random.normal(0, 0.3, source.shape)
    clean = np.delete(np.arange(80), 17)
    source[17] = place
    selection = mx.select_warp(source, target, robust=True)
    assert selection.left_out.tolist() == [17]
    alone = mx.select_warp(source[clean], target[clean])
    np.testing.assert_array_equal(selection.weights, alone.weights)
    np.testing.assert_array_equal(selection.warp.parameters, alone.warp.parameters)
    np.testing.assert_array_equal(selection.warp.domain, alone.warp.domain)
    for name, scores in alone.maps.items():
        np.testing.assert_array_equal(selection.maps[name], scores)
    assert selection.least_squares().n_data == 79


def test_a_far_point_beside_data_of_unit_size():
    random = np.random.default_rng(3)
    points = random.uniform(0, 1, (100, 2))
    values = np.sin(3 * points[:, 0]) + random.normal(0, 0.01, 100)
    points[5] = 1e6
    assert mx.select_surface(points, values, robust=True).left_out.tolist() == [5]
    with pytest.raises(ValueError, match=r"^Invalid points\. "):
        mx.select_surface(points, values)


@pytest.mark.parametrize("smoothing", ["auto", 0])
def test_wrong_matches_are_left_out_and_absent_ones_stay_so(smoothing):
    random = np.random.default_rng(4)
    source = random.uniform(0, 1, (90, 2)) * [640, 480]
    target = source / (1 + source[:, :1] / 4000) + random.normal(0, 0.3, source.shape)
    weights = np.ones(90)
    weights[[2, 50]] = 0
    target[[7, 50, 81]] += [[90, -40], [5, 700], [-60, 60]]
    selection = mx.select_warp(source, target, "CMPRESS", smoothing=smoothing, weights=weights, robust=True)
    assert selection.left_out.tolist() == [7, 81]
    kept = np.setdiff1d(np.arange(90), [2, 7, 50, 81])
    alone = mx.select_warp(source[kept], target[kept], "CMPRESS", smoothing=smoothing, weights=weights[kept])
    np.testing.assert_array_equal(selection.warp.parameters, alone.warp.parameters)
    assert set(selection.suspects().indices) == {7, 81}


def test_clean_data_lose_nothing():
    random = np.random.default_rng(5)
    source = random.uniform(0, 1, (120, 2)) * [640, 480]
    target = source + 8 * np.sin(source / 90) + random.normal(0, 0.3, source.shape)
    plain, robust = (mx.select_warp(source, target, robust=r) for r in (False, True))
    assert robust.left_out.size == 0
    np.testing.assert_array_equal(robust.warp.parameters, plain.warp.parameters)


def test_an_error_where_none_is_expected_is_wrong_without_a_warning():
    points = np.random.default_rng(0).uniform(0, 9, (60, 2))
    flat = np.where(np.arange(60) == 7, 100.0, 0.0)
    assert mx.select_surface(points, flat, robust=True).left_out.tolist() == [7]


@pytest.mark.parametrize("wrong", [1, "yes", None, 0.5])
def test_robust_is_yes_or_no(wrong):
    points = np.random.default_rng(0).uniform(size=(20, 2))
    for select in (mx.select_warp, lambda *data, **more: mx.select_surface(data[0], data[1][:, 0], **more)):
        with pytest.raises(TypeError, match=r"^Invalid robust\. "):
            select(points, points, robust=wrong)


def test_placeholders_and_scattered_places_are_far_but_a_second_cluster_is_not():
    random = np.random.default_rng(6)
    near = random.uniform(0, 100, (70, 2))
    scattered = random.uniform(500, 3000, (12, 2))
    assert np.flatnonzero(beyond_gaps(np.vstack([near, scattered]))).tolist() == list(range(70, 82))
    placeholders = np.full((9, 2), -9999.0)
    assert np.flatnonzero(beyond_gaps(np.vstack([near, placeholders]))).tolist() == list(range(70, 79))
    cluster = 900 + random.uniform(0, 40, (15, 2))
    assert not beyond_gaps(np.vstack([near, cluster])).any()


def test_scattered_places_of_terrain_do_not_come_back():
    random = np.random.default_rng(7)
    points = random.uniform(0, 100, (200, 2))
    values = 50 * np.sin(points[:, 0] / 15) * np.cos(points[:, 1] / 11) + random.normal(0, 5, 200)
    points[:20] = random.uniform(300, 600, (20, 2))
    with pytest.warns(SuspicionWarning, match="sigma is"):  # much noise, for these elevations
        selection = mx.select_surface(points, values, robust=True)
    assert selection.left_out.tolist() == list(range(20))
