import math

import numpy as np
import pytest

import mexpress as mx
from mexpress.criteria import Scorer
from mexpress.suspicion import LEFT_OUT, Suspects, SuspicionWarning, studentised_lengths, suspects

rng = np.random.default_rng(0)
POINTS = rng.uniform(size=(40, 2))
DESIGN = rng.normal(size=(80, 6))
PENALTY = rng.normal(size=(3, 6))
RADII = [0.0, 0.15, 0.45]  # the last holds out more rows than there are columns


def balls(points, radius):
    return mx.schemes.exclusion_radius(points, radius)


def by_coupling(coupling):
    """The rows of each datum."""
    labels = np.arange(80) // coupling if isinstance(coupling, int) else coupling
    return [np.flatnonzero(labels == datum) for datum in range(labels.max() + 1)]


# ------------------------------------------------------------------------------------------------- the spread


@pytest.mark.parametrize("radius", RADII)
@pytest.mark.parametrize("penalty", [None, PENALTY])
@pytest.mark.parametrize("coupling", [2, np.sort(np.arange(80) % 40)])
def test_spread_is_that_of_refits_on_noise(radius, penalty, coupling):
    """C = I + X_T (X_-K^T X_-K + Z^T Z)^-1 X_T^T: without a penalty the covariance of e_(T) under unit noise."""
    model = mx.LeastSquares(DESIGN, np.zeros(80), coupling, penalty=penalty)
    scheme, rows = balls(POINTS, radius), by_coupling(coupling)
    for datum, (held, c) in enumerate(
        zip(scheme.held_out, model.prediction_spread(scheme, threads=2), strict=True)
    ):
        kept = np.delete(DESIGN, np.concatenate([rows[k] for k in held]), axis=0)
        kept = kept if penalty is None else np.vstack([kept, penalty])
        own = DESIGN[rows[datum]]
        expected = np.eye(len(own)) + own @ np.linalg.solve(kept.T @ kept, own.T)
        np.testing.assert_allclose(c, expected, rtol=1e-10, atol=1e-12)


def test_spread_of_data_of_unlike_sizes_and_of_several_validated():
    coupling = np.sort(np.concatenate([np.arange(30), rng.integers(30, size=50)]))
    model, rows = mx.LeastSquares(DESIGN, np.zeros(80), coupling), by_coupling(coupling)
    scheme = mx.schemes.from_sets([[0, 3, 9], [5], [7, 8], []], validated=[[0, 9], [5], [], []], n=30)
    found = model.prediction_spread(scheme)
    for held, validated, c in zip(scheme.held_out, scheme.validated, found, strict=True):
        out, own = (
            np.concatenate([np.zeros(0, dtype=int), *(rows[k] for k in some)]) for some in (held, validated)
        )
        kept = np.delete(DESIGN, out, axis=0)
        expected = np.eye(len(own)) + DESIGN[own] @ np.linalg.solve(kept.T @ kept, DESIGN[own].T)
        np.testing.assert_allclose(c, expected, rtol=1e-10, atol=1e-12)


def test_spread_is_nan_where_rank_is_lost():
    model = mx.LeastSquares([[1.0, 0.0], [1.0, 0.0], [1.0, 1.0]], [1.0, 2.0, 6.0])
    spread = model.prediction_spread(mx.schemes.leave_one_out(3))
    assert [bool(np.isnan(c).all()) for c in spread] == [False, False, True]
    np.testing.assert_allclose(spread[0], 2.0)


def test_spread_does_not_depend_on_threads():
    model, scheme = mx.LeastSquares(DESIGN, np.zeros(80), 2), balls(POINTS, 0.3)
    one, many = (np.array(model.prediction_spread(scheme, threads)) for threads in (1, 3))
    np.testing.assert_array_equal(one, many)


def test_spread_refuses_what_is_no_scheme_of_its_data():
    model = mx.LeastSquares(DESIGN, np.zeros(80), 2)
    for scheme, error in [("near", TypeError), (mx.schemes.leave_one_out(39), ValueError)]:
        with pytest.raises(error, match=r"^Invalid scheme\."):
            model.prediction_spread(scheme)


# ------------------------------------------------------------------------------------------- studentised squares


@pytest.mark.parametrize("responses", [(), (3,)])
@pytest.mark.parametrize("penalty", [None, PENALTY])
def test_squares_are_those_of_refits_whether_a_datum_counts_or_not(responses, penalty):
    b = rng.normal(size=(80, *responses))
    weights = np.where(np.arange(40) % 4 == 1, LEFT_OUT, 1.0)
    model = mx.LeastSquares(DESIGN, b, 2, weights, penalty)
    scheme, rows = balls(POINTS, 0.3), by_coupling(2)
    lengths, freedom = studentised_lengths(model, scheme, weights)
    squares = lengths**2
    assert (freedom == 2 * math.prod(responses)).all()
    for datum, held in enumerate(scheme.held_out):
        training = [k for k in range(40) if k not in held and weights[k] == 1]
        kept = DESIGN[np.concatenate([rows[k] for k in training])]
        values = b[np.concatenate([rows[k] for k in training])]
        system = kept.T @ kept + (0 if penalty is None else penalty.T @ penalty)
        own = DESIGN[rows[datum]]
        e = b[rows[datum]] - own @ np.linalg.solve(system, kept.T @ values)
        c = np.eye(2) + own @ np.linalg.solve(system, own.T)
        np.testing.assert_allclose(squares[datum], (e * np.linalg.solve(c, e)).sum(), rtol=1e-5)


# ----------------------------------------------------------------------------------------------------- suspects


def smooth_map(seed, n=150, noise=0.5, wrong=0):
    """A smooth map of the unit square, in pixels, some of its values replaced at random; which."""
    random = np.random.default_rng(seed)
    points = random.uniform(size=(n, 2))
    x, y = points.T
    clean = 200 * np.column_stack([x + 0.1 * np.sin(3 * y), y + 0.1 * np.cos(4 * x)])
    values = clean + random.normal(0, noise, (n, 2))
    which = np.sort(random.choice(n, wrong, replace=False))
    values[which] = random.uniform(0, 200, (wrong, 2))
    return points, values, which


class Polynomials:
    """Chooses a degree by ER10, given weights."""

    def __init__(self, points, values):
        x, y = 2 * points.T - 1
        self.designs = [
            np.column_stack([x**i * y**j for i in range(d + 1) for j in range(d + 1 - i)])
            for d in range(1, 7)
        ]
        self.values = values
        self.scorer = Scorer.of(["ER10"], points)

    def __call__(self, weights):
        """Return the model of the chosen degree."""
        models = [mx.LeastSquares(design, self.values, weights=weights) for design in self.designs]
        return models[int(np.nanargmin([self.scorer.scores(model)["ER10"].value for model in models]))]


@pytest.mark.parametrize("share", [0.05, 0.1, 0.2, 0.3])
@pytest.mark.parametrize("seed", range(3))
def test_planted_errors_are_found_and_nothing_else(seed, share):
    points, values, wrong = smooth_map(seed, wrong=round(150 * share))
    found = suspects(Polynomials(points, values), balls(points, 0.07), values)
    hits = np.intersect1d(found.indices, wrong)
    assert len(hits) >= 0.95 * len(wrong)  # a random value may happen to be about right
    assert len(found.indices) - len(hits) <= 1
    assert not found.doubtful
    assert 0.4 < found.sigma < 1.0
    assert (np.diff(found.scores[found.indices]) <= 0).all()


def test_clean_gaussian_data_score_as_their_chi_squares_do():
    scores = []
    for seed in range(10):
        points, values, _ = smooth_map(seed)
        found = suspects(Polynomials(points, values), balls(points, 0.07), values, threshold=3.0)
        assert not found.doubtful
        scores.append(found.scores)
    scores = np.concatenate(scores)
    for limit in (0.5, 1.0, 1.5, 2.0):  # t^2 of two measurements: P(t > c) = exp(-c^2)
        assert (scores > limit).mean() == pytest.approx(math.exp(-(limit**2)), rel=0.25, abs=0.01)
    assert (scores > 3.0).mean() < 0.003
    assert (scores > 5.0).sum() == 0


@pytest.mark.parametrize("seed", range(4))
def test_it_says_so_when_half_of_the_data_are_wrong(seed):
    points, values, _ = smooth_map(seed, wrong=75)
    with pytest.warns(SuspicionWarning, match="no RANSAC") as caught:
        found = suspects(Polynomials(points, values), balls(points, 0.07), values)
    assert found.doubtful
    assert str(caught[0].message) == found.doubt
    assert "not to be trusted" in repr(found)


def test_a_model_that_is_not_chosen_anew():
    x = np.linspace(-1, 1, 80)
    y = np.sin(2 * x) + np.random.default_rng(1).normal(0, 0.01, 80)
    y[[3, 40, 41]] += 1.0
    near = mx.schemes.nearest(x[:, None], 3)
    found = suspects(lambda weights: mx.LeastSquares(np.vander(x, 6), y, weights=weights), near, y)
    assert sorted(found.indices.tolist()) == [3, 40, 41]
    assert found.share == 3 / 80
    assert found.rounds >= 3
    refit = mx.LeastSquares(np.vander(x, 6), y, weights=found.weights)
    np.testing.assert_allclose(np.vander(x, 6) @ refit.coefficients, np.sin(2 * x), atol=0.015)


def test_the_order_of_pairs_does_not_matter():
    points, values, _ = smooth_map(5, wrong=10)
    scheme = balls(points, 0.07)
    turned = mx.schemes.from_sets(list(scheme.held_out)[::-1], [[i] for i in range(150)][::-1])
    one, other = (suspects(Polynomials(points, values), s, values) for s in (scheme, turned))
    np.testing.assert_allclose(one.scores, other.scores, rtol=1e-9)


@pytest.mark.parametrize("values", [np.zeros(30), 1.0 + np.arange(30.0)])
def test_data_without_noise_are_no_suspects(values):
    x = np.arange(30.0)
    found = suspects(
        lambda w: mx.LeastSquares(np.vander(x, 3), values, weights=w), mx.schemes.leave_one_out(30), values
    )
    assert found.indices.tolist() == []
    assert not found.doubtful


def test_data_that_cannot_be_predicted_have_no_score_and_are_no_suspects():
    design = np.column_stack([np.ones(20), np.arange(20) == 7])
    values = np.random.default_rng(2).normal(5, 0.1, 20)
    found = suspects(
        lambda w: mx.LeastSquares(design, values, weights=w),
        mx.schemes.leave_one_out(20),
        values + 1e3 * np.eye(20)[3],
    )
    assert np.flatnonzero(np.isnan(found.scores)).tolist() == [7]
    assert found.weights[7] == 1
    assert found.indices.tolist() == []


def test_weights_fall_with_the_score():
    found = Suspects(np.array([0.0, 2.5, 4.99, 5.0, 80.0, np.nan]), 5.0, 1.0, 100.0, 3, True)
    assert (np.diff(found.weights[:4]) < 0).all()
    np.testing.assert_allclose(found.weights[[0, 1, 4, 5]], [1, 0.5625, LEFT_OUT, 1])


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"scheme": mx.schemes.k_fold(30, 5)}, "scheme"),
        ({"scheme": mx.schemes.from_sets([[0], [0]], n=2)}, "scheme"),
        ({"scheme": "near"}, "scheme"),
        ({"values": np.zeros(29)}, "values"),
        ({"values": "deep"}, "values"),
        ({"values": np.full(30, np.nan)}, "values"),
        ({"threshold": 0}, "threshold"),
        ({"threshold": np.nan}, "threshold"),
        ({"max_rounds": 0}, "max_rounds"),
        ({"build": lambda weights: None}, "build"),
        ({"build": lambda weights: mx.LeastSquares(np.eye(30), np.ones(30))}, "build"),
        ({"build": lambda weights: mx.LeastSquares(np.ones((29, 1)), np.ones(29))}, "scheme"),
        ({"threads": 0}, "threads"),
    ],
)
def test_what_is_refused(change, name):
    given = {
        "build": lambda weights: mx.LeastSquares(np.ones((30, 1)), np.arange(30.0), weights=weights),
        "scheme": mx.schemes.leave_one_out(30),
        "values": np.arange(30.0),
    }
    with pytest.raises((ValueError, TypeError), match=rf"^Invalid {name}\."):
        suspects(**(given | change))
