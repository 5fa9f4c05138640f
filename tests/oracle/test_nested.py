"""Every leading block of columns in one call: refits without the held-out rows, size after size, are the oracle."""

import inspect
import re
import warnings
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refits import (
    COUPLINGS,
    Problem,
    b_spline,
    barely_of_full_rank,
    every_scheme,
    label_rows,
    needs_longdouble,
    nested_refit,
    nested_refit_wide,
    nested_thin_plate,
    pairs,
    respond,
)

import mexpress as mx

s = mx.schemes
FAMILIES = ["tps", "spline", "random", "scaled"]
VARIANTS = {
    "plain": {},
    "responses and weights": {"responses": 3, "weighted": True},
    "penalty": {"penalised": True},
    "all": {"responses": 3, "weighted": True, "penalised": True},
}


def make(family, coupling=1, *, n=26, p=9, seed=0, **options):
    """Return a problem whose leading blocks are models, and where its data are, in pixels."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 1, (n, 2)) * [1920, 1080]
    labels = label_rows(coupling, n, rng)
    where = points[labels] + rng.normal(0, 20, (len(labels), 2))
    if family == "tps":
        A = nested_thin_plate(where, points[rng.choice(n, p, replace=False)])
    elif family == "spline":
        A = b_spline(where[:, 0] / 1920, p - 3)
    else:
        A = rng.normal(size=(len(labels), p))
    if family == "scaled":
        A *= 10.0 ** rng.uniform(-8, 8, p)
    return respond(A, labels, rng, **options), points


def nested(problem, sizes, schemes, **options):
    """Call what is tested; warnings are errors here, also where rank is lost."""
    options = {"weights": problem.weights, "penalty": problem.penalty} | options
    return mx.cross_validate_nested(problem.A, problem.b, sizes, schemes, problem.labels, **options)


def block_by_block(problem, sizes, schemes):
    """Return what `LeastSquares.cross_validate` says of every leading block."""
    models = [problem.leading(size).model() for size in sizes]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mx.RankLossWarning)
        return {k: np.array([m.cross_validate(v).score for m in models]) for k, v in schemes.items()}


def agree(problem, found, expected, rtol=1e-8):
    """Same names in the same order, same sizes without a score, same scores but for rounding of the responses."""
    assert list(found) == list(expected)
    for name, curve in expected.items():
        atol = 1e-13 * np.abs(problem.b).max()
        np.testing.assert_allclose(found[name], curve, rtol=rtol, atol=atol, err_msg=name)


def refitted(problem, sizes, schemes):
    return {name: problem.curve(sizes, scheme) for name, scheme in schemes.items()}


def schemes_of(points, seed=0):
    """Return schemes of every builder, small and large."""
    n, rng = len(points), np.random.default_rng(seed)
    diagonal = np.hypot(1920, 1080)
    gaps = [(np.setdiff1d(np.arange(n), range(i, i + 4)), [i + 1, i + 2]) for i in range(0, n - 4, 4)]
    several = [rng.choice(n, 6, replace=False) for _ in range(8)]
    return every_scheme(points, seed) | {
        "radius of nothing": s.exclusion_radius(points, 0.0),
        "small radius": s.exclusion_radius(points, 0.05 * diagonal),
        "large radius": s.exclusion_radius(points, 0.3 * diagonal),
        "most": s.nearest(points, n - 10),
        "small gaps": s.from_splits(gaps, n=n),
        "some validated twice": s.from_sets(several, [x[:3] for x in several], n=n),
        "each of all, by all others": s.from_sets([[i] for i in range(n)] * 2, n=n),
    }


# ------------------------------------------------------------------------------------------ equal to refits


@pytest.mark.parametrize(
    "variant", [name if name == "all" else pytest.param(name, marks=pytest.mark.slow) for name in VARIANTS]
)
@pytest.mark.parametrize("coupling", COUPLINGS)
@pytest.mark.parametrize("family", FAMILIES)
def test_every_size_of_every_scheme_equals_its_refits(family, coupling, variant):
    problem, points = make(family, coupling, seed=5, **VARIANTS[variant])
    schemes, sizes = every_scheme(points), [1, 2, 3, 5, 8, 9]
    agree(problem, nested(problem, sizes, schemes), refitted(problem, sizes, schemes))


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("coupling", COUPLINGS)
@pytest.mark.parametrize("family", FAMILIES)
def test_every_size_equals_cross_validation_of_its_block(family, coupling, variant):
    # A seed whose training rows have conditions below 1e7: what is worse, no refit knows to 1e-8.
    problem, points = make(family, coupling, n=40, p=11, seed=12, **VARIANTS[variant])
    schemes, sizes = schemes_of(points), range(1, 12)
    agree(problem, nested(problem, sizes, schemes), block_by_block(problem, sizes, schemes))


@pytest.mark.parametrize("family", FAMILIES)
def test_the_cases_have_scores_and_sizes_without(family):
    # Else the two tests above would show little.
    problem, points = make(family, 2, n=40, p=11, seed=12)
    curves = np.array(list(nested(problem, range(1, 12), schemes_of(points)).values()))
    assert np.isfinite(curves).mean() > 0.4
    if family == "spline":
        assert np.isnan(curves).any()


@pytest.mark.parametrize("sizes", [[1], [9], [4], [1, 9], [2, 5, 7], [3, 4], range(2, 9, 3), range(1, 10)])
@pytest.mark.parametrize("family", ["tps", "spline"])
def test_sizes_with_steps_are_those_of_the_whole_curve(family, sizes):
    problem, points = make(family, 2, responses=3, weighted=True, penalised=True, seed=3)
    schemes = schemes_of(points)
    whole = nested(problem, range(1, 10), schemes)
    part = {name: curve[np.array(sizes) - 1] for name, curve in whole.items()}
    agree(problem, nested(problem, sizes, schemes), part, rtol=1e-10)


def test_columns_beyond_the_last_size_do_not_matter():
    problem, points = make("random", 1, seed=2)
    schemes = schemes_of(points)
    expected = nested(problem.leading(5), [2, 5], schemes)
    problem.A[:, 5:] = problem.A[:, :4]
    problem.A[:, 8] = 1e300
    agree(problem, nested(problem, [2, 5], schemes), expected, rtol=1e-12)


def test_thin_plates_on_raw_pixels():
    problem, points = make("tps", 1, n=60, p=30, responses=3, seed=8)
    raw = Problem(problem.A * 1920.0 ** np.arange(30), problem.b, problem.labels)
    schemes = {"ER10": s.exclusion_radius(points, 220), "loo": s.leave_one_out(60)}
    sizes = [3, 10, 20, 30]
    agree(raw, nested(raw, sizes, schemes), refitted(problem, sizes, schemes))


@pytest.mark.parametrize("coupling", [1, 3])
def test_cumulative_sums_predict_every_size(coupling):
    # The mathematics alone: with M = L L^T, the prediction of model l is the sum of u_j v_j up to l.
    problem, points = make("tps", coupling, responses=3, weighted=True, penalised=True, seed=6)
    Q = np.linalg.qr(problem.whole)[0][: problem.m]
    roots = np.sqrt(problem.row_weights)[:, None]
    b = problem.b * roots
    for held in s.exclusion_radius(points, 220).held_out:
        rows = problem.rows(held)
        L = np.linalg.cholesky(np.eye(9) - Q[rows].T @ Q[rows])
        u, v = np.linalg.solve(L, Q[rows].T), np.linalg.solve(L, Q.T @ b - Q[rows].T @ b[rows])
        predicted = np.cumsum(u[:, :, None] * v[:, None], axis=0) / roots[rows]
        for size in range(1, 10):
            e = problem.leading(size).refit(rows)
            np.testing.assert_allclose(problem.b[rows] - predicted[size - 1], e, rtol=1e-8, atol=1e-8)


def by_one_factorisation(problem, sizes, scheme, predict=nested_refit):
    """Return P of the sizes of a large problem of full rank: a refit a pair."""
    at = np.array(sizes) - 1
    total, b = np.zeros(len(at)), problem.b.reshape(problem.m, -1)
    for held, validated in pairs(scheme):
        kept = np.setdiff1d(np.arange(problem.m), problem.rows(held))
        rows = problem.rows(validated)
        e = b[rows] - predict(problem.A[kept, : sizes[-1]], b[kept], problem.A[rows, : sizes[-1]])
        total += (e[at] ** 2).sum(axis=(1, 2))
    return np.sqrt(total / len(scheme.validated.indices))


@pytest.mark.parametrize("predict", [nested_refit, nested_refit_wide])
def test_the_other_oracles_are_refits_too(predict):
    problem, points = make("tps", 2, responses=3, n=40, seed=1)
    scheme, sizes = s.exclusion_radius(points, 220), [1, 3, 4, 9]
    found = by_one_factorisation(problem, sizes, scheme, predict)
    np.testing.assert_allclose(found, problem.curve(sizes, scheme), rtol=1e-10)


# ---------------------------------------------------------------------------------------------- dense data


def dense(kind, p, coupling=1, seed=0):
    """Return 600 data in shuffled order with a thin-plate spline of well-spread control points."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 1, (600, 2))
    if kind == "grid":
        points = rng.permutation(
            np.stack(np.meshgrid(np.arange(25), np.arange(24)), axis=-1).reshape(-1, 2) / 24
        )
    spread = [0]
    while len(spread) < p:
        nearest = np.linalg.norm(points[:, None] - points[spread], axis=2).min(axis=1)
        spread.append(int(nearest.argmax()))
    labels = np.repeat(np.arange(600), coupling)
    where = points[labels] + (coupling > 1) * rng.normal(0, 0.01, (len(labels), 2))
    b = np.sin(6 * where[:, 0]) * np.cos(5 * where[:, 1]) + rng.normal(0, 0.05, len(labels))
    return Problem(nested_thin_plate(where, points[spread]), b, labels), points


@pytest.mark.parametrize(
    ("kind", "p", "coupling"),
    [pytest.param("grid", 60, 1, marks=pytest.mark.slow), ("random", 30, 1), ("grid", 30, 2)],
)
def test_dense_data_whose_sets_overlap(kind, p, coupling):
    problem, points = dense(kind, p, coupling)
    schemes = {"ER10": s.exclusion_radius(points, 0.16), "KF4": s.k_fold(600, 4, seed=0)}
    assert np.median(schemes["ER10"].held_out.sizes) >= 40
    sizes = [3, 4, 11, p // 2, p]
    found = nested(problem, sizes, schemes)
    agree(problem, found, {name: by_one_factorisation(problem, sizes, x) for name, x in schemes.items()})
    schemes |= around(points) | {"ER20": s.exclusion_radius(points, 0.3)}
    agree(problem, nested(problem, sizes, schemes), block_by_block(problem, sizes, schemes))


def around(points):
    """Return schemes around the same data, some of whose sets nest."""
    return {
        "NN20": s.nearest(points, 20),
        "ER1": s.exclusion_radius(points, 0.01 * np.sqrt(2)),
        "ER10": s.exclusion_radius(points, 0.1 * np.sqrt(2)),
        "NN5": s.nearest(points, 5),
        "ER5": s.exclusion_radius(points, 0.05 * np.sqrt(2)),
    }


def identical(one, two):
    assert list(one) == list(two)
    for name, curve in one.items():
        np.testing.assert_array_equal(curve, two[name], err_msg=name)


@pytest.mark.parametrize(("kind", "p"), [("grid", 30), ("random", 45)])
def test_schemes_together_are_each_alone(kind, p):
    problem, points = dense(kind, p)
    sizes = [3, 4, 10, 20, p]
    schemes = around(points)
    mixed = schemes | {
        "again": schemes["ER10"],
        "KF5": s.k_fold(600, 5, seed=1),
        "some": s.from_sets([[1, 2, 3], [300, 4]], [[2], [4]], n=600),
        "DELAUNAY": s.delaunay(points),
        "CMPRESS": s.leave_one_out(600),
    }
    alone = {name: nested(problem, sizes, {name: x})[name] for name, x in mixed.items()}
    for together in (schemes, mixed, dict(reversed(mixed.items()))):
        expected = {name: alone[name] for name in together}
        agree(problem, nested(problem, sizes, together), expected, rtol=1e-10)


@pytest.mark.parametrize("lossy", [False, True])
def test_the_number_of_threads_changes_no_bit(lossy):
    problem, points = dense("random", 30, coupling=2)
    if lossy:
        problem.A[:, 12] *= np.linalg.norm(points[problem.labels] - 0.5, axis=1) < 0.12
        problem.A[:, 20] = problem.A[:, 2] - problem.A[:, 7]
        problem.A[100:102] *= 1e6
    sizes = [3, 4, 10, 20, 30]
    schemes = around(points) | {"KF5": s.k_fold(600, 5, seed=1)}
    found = [nested(problem, sizes, schemes, threads=threads) for threads in (1, 2, 3, None, 1)]
    for other in found[1:]:
        identical(found[0], other)
    assert np.isnan(found[0]["ER10"]).tolist() == [False] * 3 + [lossy] * 2


def test_the_order_of_the_pairs_does_not_matter():
    problem, points = dense("grid", 20)
    ball, order = s.exclusion_radius(points, 0.16), np.random.default_rng(0).permutation(600)
    mixed = s.from_sets([ball.held_out[i] for i in order], order[:, None], n=600)
    found = nested(problem, range(3, 21), {"ball": ball, "mixed": mixed})
    np.testing.assert_allclose(found["mixed"], found["ball"], rtol=1e-10)


def test_long_chains_do_not_drift():
    # Balls of 0.024 leave little of the first spline: M has an eigenvalue of 7e-6, which magnifies what has added up.
    rng = np.random.default_rng(0)
    x = rng.uniform(0, 1, 2600)
    problem = Problem(b_spline(x, 17), np.sin(20 * x) + rng.normal(0, 0.1, 2600), np.arange(2600))
    schemes = {name: s.exclusion_radius(x[:, None], r) for name, r in [("small", 0.01), ("large", 0.024)]}
    sizes = [1, 7, 20]
    found = nested(problem, sizes, schemes)
    agree(problem, found, block_by_block(problem, sizes, schemes), rtol=1e-10)
    assert np.isfinite(list(found.values())).all()


@pytest.mark.parametrize("coupling", [1, 2])
def test_models_that_nearly_interpolate(coupling):
    problem, points = make("random", coupling, n=30, p=30 * coupling - 4, responses=2, seed=3)
    schemes = {name: s.nearest(points, k) for name, k in [("NN1", 1), ("NN2", 2), ("NN4", 4)]}
    sizes = [1, 10, 20, *range(25 * coupling, 30 * coupling - 3)]
    agree(problem, nested(problem, sizes, schemes), refitted(problem, sizes, schemes))


@pytest.mark.parametrize(("noise", "mean"), [(1e-3, 0), (1e-5, 0), (1e-3, 1e3), (1, 1e6)])
def test_residuals_far_smaller_than_responses(noise, mean):
    # Every model has a constant, so that the mean changes no score, but for the digits that it takes from b.
    problem, points = dense("grid", 40)
    rng = np.random.default_rng(1)
    smooth = problem.A @ np.linalg.lstsq(problem.A, problem.b, rcond=None)[0]
    b = np.round((smooth + rng.normal(0, noise, 600)) * 2.0**30) / 2.0**30  # so that adding the mean is exact
    ball, some = s.exclusion_radius(points, 0.3), range(0, 600, 6)
    scheme = s.from_sets([ball.held_out[i] for i in some], [[i] for i in some], n=600)
    sizes = [3, 10, 30, 40]
    expected = by_one_factorisation(Problem(problem.A, b, problem.labels), sizes, scheme)
    shifted = Problem(problem.A, b + mean, problem.labels)
    np.testing.assert_allclose(by_one_factorisation(shifted, sizes, scheme), expected, rtol=1e-9)
    np.testing.assert_allclose(nested(shifted, sizes, {"": scheme})[""], expected, rtol=1e-8)


@pytest.mark.slow
def test_dense_data_with_one_of_large_leverage():
    # Where it is held out, the first column keeps a millionth of its length.
    problem, points = dense("grid", 30)
    far = int(np.linalg.norm(points - 0.5, axis=1).argmin())
    problem.A[far] *= 1e6
    ball, others = s.exclusion_radius(points, 0.16), np.delete(np.arange(600), far)
    held = [ball.held_out[i] for i in others]
    schemes = {
        "all": ball,
        "others": s.from_sets(held, others[:, None], n=600),
        "alone": s.from_sets([held[i] for i in range(0, 599, 90)], others[::90, None], n=600),
    }
    sizes = [3, 4, 17, 30]
    found = nested(problem, sizes, schemes)
    agree(problem, found, {name: by_one_factorisation(problem, sizes, x) for name, x in schemes.items()})
    agree(problem, found, block_by_block(problem, sizes, schemes))


# ------------------------------------------------------------------------------------------------ rank loss


def loss_cases():
    rng = np.random.default_rng(3)
    x = rng.normal(size=(12, 6))
    seen = lambda *rows: np.isin(np.arange(12), rows).astype(float)  # noqa: E731
    bump = lambda *rows: seen(*rows) * rng.normal(size=12)  # noqa: E731
    yield "dummy in the middle", np.column_stack([x[:, :3], seen(4), x[:, 3:]]), None
    yield "dummy first", np.column_stack([seen(4), x]), None
    yield (
        "dummies",
        np.column_stack([np.ones(12), seen(0), x[:, 0], seen(3, 7), seen(5, 6, 9), x[:, 1]]),
        None,
    )
    yield "one neighbourhood", np.column_stack([x[:, :2], bump(3, 4, 5), bump(3, 4), x[:, 2], bump(9)]), None
    yield "dummies that sum to one", np.column_stack([np.ones(12), seen(0, 1, 2), 1 - seen(0, 1, 2), x]), None
    yield "duplicate in the middle", np.column_stack([x[:, :3], x[:, 1], x[:, 3:]]), None
    yield "duplicated dummy", np.column_stack([x[:, 0], seen(4), x[:, 1], 3 * seen(4), x[:, 2]]), None
    yield "combination in the middle", np.column_stack([x[:, :3], x[:, :3].sum(axis=1), x[:, 3:]]), None
    yield "one direction only", np.outer(x[:, 0], np.arange(1.0, 6.0)), None
    yield "leading zeros", np.column_stack([np.zeros((12, 2)), x]), None
    yield "zeros in the middle", np.column_stack([x[:, :2], np.zeros((12, 2)), x[:, 2:]]), None
    yield "all zero", np.zeros((12, 4)), None
    yield "fewer rows than columns", rng.normal(size=(12, 20)), None
    yield "as many rows as columns", rng.normal(size=(12, 12)), None
    yield "one row more than columns", rng.normal(size=(12, 11)), None
    yield "penalty rescues the dummy", np.column_stack([x[:, :3], seen(4), x[:, 3]]), 0.1 * np.eye(5)[3:4]
    yield "penalty rescues what follows", np.column_stack([x[:, :3], seen(4), x[:, 3]]), 0.1 * np.eye(5)[4:]
    yield "penalty of a sum", np.column_stack([x[:, :3], seen(4), x[:, 3]]), [[0, 0, 0, 0.1, 0.1]]
    yield "penalty of the duplicate", np.column_stack([x[:, :3], x[:, 1], x[:, 3]]), 0.1 * np.eye(5)[3:4]
    yield "full penalty", rng.normal(size=(12, 20)), 0.1 * np.eye(20)
    yield "triangular penalty", rng.normal(size=(12, 20)), np.triu(rng.normal(size=(20, 20)))[3:]
    yield "penalty of zeros", np.column_stack([x[:, :3], seen(4)]), np.zeros((2, 4))
    yield (
        "columns of any size",
        np.column_stack([1e12 * x[:, 0], 1e-12 * x[:, 1], 1e6 * seen(4), x[:, 2]]),
        None,
    )


LOSSES = [pytest.param(A, Z, id=name) for name, A, Z in loss_cases()]


def loss_problem(A, penalty, coupling):
    extra = None if penalty is None else np.asarray(penalty, dtype=float)
    return Problem(A, np.random.default_rng(0).normal(size=12), np.arange(12) // coupling, None, extra)


@pytest.mark.parametrize("coupling", [1, *(pytest.param(g, marks=pytest.mark.slow) for g in (2, 3))])
@pytest.mark.parametrize(("A", "penalty"), LOSSES)
def test_no_score_from_the_first_lost_column_on(A, penalty, coupling):
    problem = loss_problem(A, penalty, coupling)
    n, sizes = problem.n, range(1, A.shape[1] + 1)
    sets = (
        [{i} for i in range(n)] + [{i, (i + 1) % n} for i in range(n)] + [{i, (i + 2) % n} for i in range(n)]
    )
    sets += [set(), set(range(n)), set(range(1, n)), set(range(n)) - {1}, set(range(2, n))]
    schemes = {str(x): s.from_sets([sorted(x)], n=n) for x in sets}
    found = nested(problem, sizes, schemes)
    agree(problem, found, refitted(problem, sizes, schemes))
    agree(problem, found, block_by_block(problem, sizes, schemes))
    for held, curve in found.items():
        if held != "set()":
            undefined = np.isnan(curve)
            assert (undefined[1:] >= undefined[:-1]).all(), held


@pytest.mark.slow
@pytest.mark.parametrize(("A", "penalty"), LOSSES)
def test_one_lost_pair_leaves_no_score(A, penalty):
    problem = loss_problem(A, penalty, 1)
    points = np.random.default_rng(1).uniform(0, 100, (12, 2))
    schemes = {k: v for k, v in every_scheme(points).items() if k not in {"delaunay", "from_splits"}}
    sizes = range(1, A.shape[1] + 1)
    found = nested(problem, sizes, schemes)
    agree(problem, found, refitted(problem, sizes, schemes))
    agree(problem, found, block_by_block(problem, sizes, schemes))


def test_a_lost_pair_that_validates_nothing_leaves_no_score():
    x = np.random.default_rng(0).normal(size=(8, 3))
    A = np.column_stack([x[:, :2], np.arange(8) == 2, x[:, 2]])
    scheme = s.from_sets([[0], [2], []], [[0], [], []], n=8)
    curve = nested(Problem(A, x[:, 0] ** 2, np.arange(8)), range(1, 5), {"": scheme})[""]
    np.testing.assert_array_equal(np.isnan(curve), [False, False, True, True])


def test_nothing_validated_has_no_score():
    problem, _ = make("random", 1)
    schemes = {"no pairs": s.from_sets([], n=26), "nothing": s.from_sets([[0, 1], []], [[], []], n=26)}
    for curve in nested(problem, [1, 4], schemes).values():
        np.testing.assert_array_equal(curve, [np.nan, np.nan])


def test_lost_and_kept_pairs_do_not_disturb_each_other():
    # Work spaces are used again: what a lost pair leaves behind must not reach the next.
    rng = np.random.default_rng(4)
    A = rng.normal(size=(50, 12))
    A[:, 5] *= np.arange(50) < 3
    problem = Problem(A, rng.normal(size=(50, 2)), np.arange(50))
    sets = [[0, 1, 2], [7], [0, 1], [0, 1, 2, 20, 30], range(30), range(10, 40), [49], range(50), [1, 2, 3]]
    alone = {str(i): s.from_sets([x], n=50) for i, x in enumerate(sets)}
    sizes = range(1, 13)
    found = nested(problem, sizes, alone, threads=1)
    agree(problem, found, refitted(problem, sizes, alone))
    for first in range(len(sets)):
        kept = [i for i in range(first, len(sets)) if not np.isnan(found[str(i)]).any()] or [1]
        together = nested(problem, sizes, {"": s.from_sets([sets[i] for i in kept], n=50)}, threads=1)[""]
        counts = np.array([len(sets[i]) for i in kept])[:, None]
        squares = (counts * np.array([found[str(i)] for i in kept]) ** 2).sum(axis=0)
        np.testing.assert_allclose(together, np.sqrt(squares / counts.sum()), rtol=1e-10)


def nearly_lost(kind, least, seed):
    """Return a design whose fourth column is lost without the last two rows but for a share of about `least`."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(40, 8))
    A[:, 3] *= np.sqrt(least)
    A[-2:, 3] = [5.0, -4.0]
    if kind == "collinear":
        A[:, 3] += A[:, :3].sum(axis=1)
    return A, rng.normal(size=(40, 1))


def relative_errors(A, b, held):
    """Errors of the library and of lstsq at every size, to the held-out residual in extended precision."""
    kept = np.setdiff1d(np.arange(len(A)), held)
    exact = b[held[:1]] - nested_refit_wide(A[kept], b[kept], A[held[:1]])[:, 0]
    scale = np.linalg.norm(A[kept], axis=0)
    solve = lambda size: np.linalg.lstsq((A / scale)[kept, :size], b[kept], rcond=None)[0]  # noqa: E731
    plain = [b[held[0]] - (A / scale)[held[0], :size] @ solve(size) for size in range(1, A.shape[1] + 1)]
    scheme = s.from_sets([held], [held[:1]], n=len(A))
    ours = mx.cross_validate_nested(A, b, range(1, A.shape[1] + 1), {"": scheme})[""]
    size = np.maximum(np.abs(exact[:, 0]), np.abs(b).max())
    return np.abs(ours - np.abs(exact[:, 0])) / size, np.abs(np.array(plain) - exact)[:, 0] / size


@needs_longdouble
@pytest.mark.parametrize("least", 10.0 ** -np.arange(5, 14.5, 0.5))
@pytest.mark.parametrize("kind", ["small", "collinear"])
def test_columns_that_are_nearly_lost(kind, least):
    worst = np.zeros(2)
    for seed in range(3):
        A, b = nearly_lost(kind, least, seed)
        for held in ([38, 39], [39, 38, 3], [38, *range(10), 39], [7, 39, 38, *range(9, 30)]):
            ours, plain = relative_errors(A, b, np.array(held))
            worst = np.maximum(worst, [ours.max(), plain.max()])
    # Q has its rows' digits to rounding of the largest entries only: hence the promise of eight, not nine. Of one pair
    # alone, ten times the error of lstsq would be a matter of luck: its own varies by more.
    assert worst[0] <= max(1e-8, 10 * worst[1])


@pytest.mark.parametrize("p", [5, 12])
def test_rank_that_is_lost_to_rounding_alone(p):
    for seed in range(3):
        problem = barely_of_full_rank(p, seed)
        schemes = {"lost": s.from_sets([[58, 59]], n=60), "kept": s.from_sets([[3]], n=60)}
        found, expected = nested(problem, range(1, p + 1), schemes), [True] * 3 + [False] * (p - 3)
        assert np.isfinite(found["lost"]).tolist() == expected
        assert np.isfinite(problem.curve(range(1, p + 1), schemes["lost"])).tolist() == expected
        assert np.isfinite(found["kept"]).all()


@needs_longdouble
@pytest.mark.parametrize("distance", [1, 1e-2, 1e-4, 1e-7, 0])
@pytest.mark.parametrize("m", [40, 1200])
def test_weights_count_whatever_becomes_of_a_pair(distance, m):
    # The third column is seen at `distance` of its length without the last two rows: the pair is solved as it is, with
    # twice the digits, or anew, or not at all.
    rng = np.random.default_rng(0)
    A, b, weights = rng.normal(size=(m, 5)), rng.normal(size=(m, 2)), rng.uniform(0.1, 10, m)
    A[:, 2] *= distance
    A[-2:, 2] = [1.0, -2.0]
    held = np.array([m - 2, m - 1])
    roots = np.sqrt(weights)[:-2, None]
    scheme = {"": s.from_sets([held], n=m)}
    found = mx.cross_validate_nested(A, b, range(1, 6), scheme, weights=weights)[""]
    defined = 5 if distance else 2
    e = b[-2:] - nested_refit_wide((A[:-2] * roots)[:, :defined], b[:-2] * roots, A[-2:, :defined])
    expected = np.full(5, np.nan)
    expected[:defined] = np.sqrt((weights[-2:, None] * e**2).sum(axis=(1, 2)) / weights[-2:].sum())
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@needs_longdouble
@pytest.mark.parametrize(("order", "c"), [(10, 0.3), (30, 0.3), (60, 0.15), (60, 0.2)])
def test_pivots_that_hide_the_conditioning(order, c):
    # Kahan's triangle: no pivot of its Gram matrix is small though its smallest singular value is. The
    # training rows are that triangle, whose condition lets a refit keep ten digits.
    sine = np.sqrt(1 - c * c)
    R = np.diag(sine ** np.arange(order)) @ (np.eye(order) - c * np.triu(np.ones((order, order)), 1))
    R *= 0.999 / np.linalg.norm(R, 2)
    values, vectors = np.linalg.eigh(np.eye(order) - R.T @ R)
    A = np.vstack([vectors * np.sqrt(values) @ vectors.T, R, R[: order // 2] / 1000])
    b = np.random.default_rng(0).normal(size=(len(A), 1))
    ours, plain = relative_errors(A, b, np.arange(order))
    assert plain.max() < 1e-10
    assert ours.max() < 1e-9


def test_a_row_that_takes_over_little_by_little():
    # No pivot is below a half, and yet the row has a leverage of 1 - 1e-9 at last.
    rng = np.random.default_rng(0)
    Q, row = np.linalg.qr(rng.normal(size=(100, 30)))[0], np.sqrt(2.0 ** np.arange(30))
    b = rng.normal(size=101)
    terms = row * (Q.T @ b[:100])
    problem = Problem(np.vstack([Q, row]), b, np.arange(101))
    found = nested(problem, range(1, 31), {"": s.from_sets([[100]], n=101)})[""]
    assert (np.abs(found - np.abs(b[100] - np.cumsum(terms))) < 1e-9 * np.cumsum(np.abs(terms))).all()


# ---------------------------------------------------------------------------------------------- any problem


def drawn_design(kind, m, p, rng):
    A = rng.normal(size=(m, p))
    if kind == "whole numbers":
        A = rng.integers(-2, 3, (m, p)).astype(float)
    elif kind == "dummies":
        A = (rng.uniform(size=(m, p)) < 0.2).astype(float)
    elif kind == "duplicates":
        A = A[:, rng.integers(0, max(1, p // 2), p)]
    elif kind == "zeros":
        A[:, rng.uniform(size=p) < 0.5] = 0
    elif kind == "scaled":
        A *= 10.0 ** rng.uniform(-8, 8, p)
    elif kind == "neighbourhoods":
        A *= np.abs(np.linspace(0, 1, m)[:, None] - rng.uniform(0, 1, p)) < 0.2
    return A


@given(
    n=st.integers(1, 14),
    p=st.integers(1, 9),
    coupling=st.sampled_from(COUPLINGS),
    responses=st.sampled_from([1, 3]),
    weighted=st.booleans(),
    penalty_rows=st.integers(0, 10),
    kind=st.sampled_from(
        ["dense", "whole numbers", "dummies", "duplicates", "zeros", "scaled", "neighbourhoods"]
    ),
    seed=st.integers(0, 10_000),
    data=st.data(),
)
def test_any_sizes_of_any_problem(*, n, p, coupling, responses, weighted, penalty_rows, kind, seed, data):
    rng = np.random.default_rng(seed)
    labels = label_rows(coupling, n, rng)
    A = drawn_design(kind, len(labels), p, rng)
    b = rng.normal(size=(len(labels), responses))
    weights = rng.uniform(0.01, 100, n) if weighted else None
    penalty = rng.normal(size=(penalty_rows, p)) * np.abs(A).max(axis=0) if penalty_rows else None
    if penalty_rows and data.draw(st.booleans()):
        penalty *= rng.integers(0, 2, p)
    problem = Problem(A, b[:, 0] if responses == 1 else b, labels, weights, penalty)
    subset = st.sets(st.integers(0, n - 1))
    schemes = {}
    for name in data.draw(st.lists(st.text(max_size=3), min_size=1, max_size=3, unique=True)):
        held = data.draw(st.lists(subset, min_size=1, max_size=4))
        validated = [data.draw(st.sets(st.sampled_from(sorted(x)))) if x else set() for x in held]
        schemes[name] = s.from_sets([sorted(x) for x in held], [sorted(x) for x in validated], n=n)
    sizes = sorted(data.draw(st.sets(st.integers(1, p), min_size=1)))
    agree(problem, nested(problem, sizes, schemes), refitted(problem, sizes, schemes))


def test_one_row():
    loo = {"loo": s.leave_one_out(1)}
    assert np.isnan(mx.cross_validate_nested([[2.0, 1.0]], [3.0], [1, 2], loo)["loo"]).all()
    rescued = mx.cross_validate_nested([[2.0, 1.0]], [3.0], [1, 2], loo, penalty=[[2.0, 0.0], [0.0, 1.0]])
    assert rescued["loo"].tolist() == [3.0, 3.0]


def test_means_by_hand():
    # Leave-one-out residuals of a mean are those of the fit times 3/2; of a line through three points, 1.5, 3 and 6.
    A, b = [[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]], [1.0, 2.0, 6.0]
    curve = mx.cross_validate_nested(A, b, [1, 2], {"loo": s.leave_one_out(3)})["loo"]
    np.testing.assert_allclose(curve, [1.5 * np.sqrt(14 / 3), np.sqrt((3**2 + 1.5**2 + 3**2) / 3)])


def test_interpolation_leaves_no_residual():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(30, 6))
    b = A[:, :4] @ rng.normal(size=4)
    curve = mx.cross_validate_nested(A, b, range(1, 7), {"": s.leave_one_out(30)})[""]
    assert (curve[:3] > 1e-3).all()
    assert (curve[3:] < 1e-13).all()
    assert (mx.cross_validate_nested(A, 0 * b, [1, 4], {"": s.leave_one_out(30)})[""] == 0).all()


@pytest.mark.parametrize("coupling", [1, 2, 3])
def test_coupling_by_number_or_by_labels(coupling):
    problem, points = make("tps", coupling, weighted=True, seed=4)
    one = nested(problem, [3, 9], schemes_of(points))
    rest = {"weights": problem.weights}
    two = mx.cross_validate_nested(problem.A, problem.b, [3, 9], schemes_of(points), coupling, **rest)
    identical(one, two)


def test_the_order_of_rows_and_data_does_not_matter():
    problem, points = make("tps", "uneven", responses=3, weighted=True, penalised=True, seed=2)
    rng = np.random.default_rng(0)
    rows, data = rng.permutation(problem.m), rng.permutation(problem.n)
    renamed = data[problem.labels]
    weights = np.empty(problem.n)
    weights[data] = problem.weights
    other = Problem(problem.A[rows], problem.b[rows], renamed[rows], weights, problem.penalty)
    schemes = schemes_of(points)
    moved = {
        k: s.from_sets([data[x] for x in v.held_out], [data[x] for x in v.validated], n=problem.n)
        for k, v in schemes.items()
    }
    agree(problem, nested(other, range(1, 10), moved), nested(problem, range(1, 10), schemes), rtol=1e-9)


@pytest.mark.parametrize("exponent", [-290, -100, 100, 290])
def test_the_unit_of_responses_does_not_matter(exponent):
    problem, points = make("tps", 2, responses=3, weighted=True, penalised=True, seed=9)
    unit = 10.0**exponent
    schemes = every_scheme(points)
    expected = {k: v * unit for k, v in nested(problem, [1, 3, 9], schemes).items()}
    scaled = Problem(problem.A, problem.b * unit, problem.labels, problem.weights, problem.penalty)
    agree(scaled, nested(scaled, [1, 3, 9], schemes), expected, rtol=1e-10)


@pytest.mark.parametrize("exponent", [3, 12, 100, 300])
def test_the_units_of_columns_do_not_matter(exponent):
    problem, points = make("random", 2, penalised=True, seed=9)
    scale = 10.0 ** np.random.default_rng(1).uniform(-exponent, exponent, 9)
    scaled = Problem(problem.A * scale, problem.b, problem.labels, None, problem.penalty * scale)
    schemes, sizes = schemes_of(points), range(1, 10)
    agree(problem, nested(scaled, sizes, schemes), nested(problem, sizes, schemes), rtol=1e-9)


@pytest.mark.parametrize("exponent", [-150, 150])
def test_weights_count_by_their_ratios(exponent):
    problem, points = make("random", 2, weighted=True, penalised=True, seed=9)
    unit = 10.0**exponent
    rest = (problem.weights * unit**2, problem.penalty * unit)
    heavy = Problem(problem.A, problem.b, problem.labels, *rest)
    schemes, sizes = schemes_of(points), range(1, 10)
    agree(problem, nested(heavy, sizes, schemes), nested(problem, sizes, schemes), rtol=1e-10)


# -------------------------------------------------------------------------------------- what users hand in

N = 20
A = np.random.default_rng(0).normal(size=(N, 5))
B = np.random.default_rng(1).normal(size=N)
LOO = s.leave_one_out(N)
SCHEMES = {"loo": LOO, "KF": s.k_fold(N, 4, seed=0)}
FORM = re.compile(r"^Invalid (\w+)\. .+ Given .*\.$", re.DOTALL)


def call(A=A, b=B, sizes=(1, 3, 5), schemes=SCHEMES, coupling=1, **options):
    return mx.cross_validate_nested(A, b, sizes, schemes, coupling, **options)


def refused(name, error=(ValueError, TypeError), **given):
    """Call, expect an error of the shared form about `name`, and return its text."""
    with pytest.raises(error) as caught:
        call(**given)
    assert type(caught.value) in (ValueError, TypeError)
    form = FORM.match(str(caught.value))
    assert form, caught.value
    assert re.fullmatch(name, form[1]), caught.value
    return str(caught.value)


def test_the_signature_is_the_contract():
    parameters = inspect.signature(mx.cross_validate_nested).parameters
    assert " ".join(parameters) == "A b sizes schemes coupling weights penalty threads"
    keywords = [name for name, p in parameters.items() if p.kind is p.KEYWORD_ONLY]
    assert keywords == ["weights", "penalty", "threads"]
    assert parameters["coupling"].default == 1


def test_names_and_order_are_kept():
    names = ["z", "ER10", "", "a b", "é", "A"]
    found = call(schemes=dict.fromkeys(names, LOO))
    assert type(found) is dict
    assert list(found) == names
    for curve in found.values():
        assert (type(curve), curve.shape, curve.dtype) == (np.ndarray, (3,), np.float64)
    found["z"][:] = 0
    assert (found["ER10"] > 0).all()


def test_no_schemes_no_curves():
    assert call(schemes={}) == {}


def test_any_mapping_of_schemes_will_do():
    identical(call(schemes=MappingProxyType({"x": LOO})), call(schemes={"x": LOO}))


SIZES = {
    "tuple": (1, 3, 5),
    "range": range(1, 6, 2),
    "uint8": np.array([1, 3, 5], dtype=np.uint8),
    "big-endian": np.array([1, 3, 5], dtype=">i4"),
    "numpy integers": [np.int64(1), np.int16(3), np.uint8(5)],
    "strided": np.array([1, 2, 3, 4, 5])[::2],
    "backwards": np.array([5, 3, 1])[::-1],
}


@pytest.mark.parametrize("form", SIZES)
def test_sizes_of_any_form(form):
    identical(call(sizes=SIZES[form]), call(sizes=[1, 3, 5]))


@pytest.mark.parametrize(
    "wrong",
    [
        [],
        range(0),
        [3, 1],
        range(5, 0, -1),
        [1, 1],
        [1, 3, 3, 5],
        [0],
        [0, 1],
        [-1, 2],
        [6],
        [1, 6],
        range(1, 7),
        [2**62],
        [2**70],
        np.array([2**63], dtype=np.uint64),
        [1.0, 2.0],
        [1.5],
        [np.nan],
        np.array([1.0, 3.0]),
        "135",
        ["1", "3"],
        b"135",
        [True],
        True,
        np.array([False, True]),
        3,
        np.int64(3),
        [[1, 3]],
        [[1], [3, 5]],
        [None],
        None,
        [1 + 0j],
        {1: 3},
        {1, 3},
        np.array([1, 3], dtype=object),
        np.ma.array([1, 3], mask=[False, True]),
        (i for i in (1, 3)),
    ],
    ids=lambda x: " ".join(repr(x).split())[:30],
)
def test_bad_sizes(wrong):
    refused("sizes", sizes=wrong)


@pytest.mark.parametrize(
    "wrong",
    [
        LOO,
        [LOO],
        [("loo", LOO)],
        ["loo"],
        "ER10",
        None,
        3,
        {"loo": None},
        {"loo": "ER10"},
        {"loo": [[0], [1]]},
        {"loo": LOO, "sets": LOO.held_out},
        {"loo": {"loo": LOO}},
        {3: LOO},
        mx.schemes,
    ],
    ids=lambda x: " ".join(repr(x).split())[:30],
)
def test_bad_schemes(wrong):
    refused("schemes", TypeError, schemes=wrong)


@pytest.mark.parametrize("n", [1, N - 1, N + 1, 5 * N])
def test_schemes_over_other_data(n):
    text = refused("schemes", ValueError, schemes={"good": LOO, "other": s.leave_one_out(n)})
    assert f"{N} data" in text
    assert f"{n} data" in text
    assert "other" in text
    refused("schemes", ValueError, schemes={"other": LOO}, coupling=2)


ARRAYS = {"A": A, "b": B, "weights": np.arange(1.0, N + 1), "penalty": np.eye(5)[1:]}


def frozen(x):
    x = x.copy()
    x.flags.writeable = False
    return x


FORMS = {
    "lists": lambda x: x.tolist(),
    "Fortran order": np.asfortranarray,
    "read-only": frozen,
    "strided": lambda x: np.repeat(x, 2, axis=0)[::2],
    "backwards": lambda x: x[::-1].copy()[::-1],
    "big-endian": lambda x: x.astype(">f8"),
    "longdouble": lambda x: x.astype(np.longdouble),
}


@pytest.mark.parametrize("form", FORMS)
def test_the_form_of_arrays_does_not_matter(form):
    given = {name: FORMS[form](x) for name, x in ARRAYS.items()}
    identical(call(**given), call(**ARRAYS))


@pytest.mark.parametrize("dtype", [np.float32, np.float16, np.int64, np.uint8])
def test_other_numbers_mean_what_they_are_as_float64(dtype):
    rounded = {name: np.abs(10 * x).astype(dtype) for name, x in ARRAYS.items()}
    identical(call(**rounded), call(**{name: x.astype(np.float64) for name, x in rounded.items()}))


def test_inputs_are_not_changed():
    before = {name: x.copy() for name, x in ARRAYS.items()}
    sizes, labels = np.array([1, 3, 5]), np.arange(N)
    call(**ARRAYS, sizes=sizes, coupling=labels)
    for name, x in before.items():
        np.testing.assert_array_equal(ARRAYS[name], x)
    np.testing.assert_array_equal(sizes, [1, 3, 5])
    np.testing.assert_array_equal(labels, np.arange(N))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", ARRAYS)
def test_what_is_not_finite_is_refused_and_located(name, bad):
    x = ARRAYS[name].copy()
    x[(2,) if x.ndim == 1 else (2, 4)] = bad  # in a column beyond all sizes
    assert "row 2" in refused(name, ValueError, sizes=[1, 2], **{name: x})


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("A", np.zeros((N, 0))),
        ("A", np.zeros((0, 5))),
        ("A", B),
        ("A", "matrix"),
        ("A", A + 0j),
        ("A", None),
        ("A", [[1.0, 2.0], [3.0]]),
        ("b", B[:-1]),
        ("b", B[:, None, None]),
        ("b", "b"),
        ("b", B * 1e305),
        ("weights", B),
        ("weights", np.ones(N - 1)),
        ("weights", np.zeros(N)),
        ("penalty", np.eye(4)),
        ("penalty", np.ones(5)),
        ("coupling", 3),
        ("coupling", 0),
        ("coupling", 1.0),
        ("coupling", np.arange(N - 1)),
        ("coupling", np.arange(N) * 2),
        ("threads", 0),
        ("threads", 1.5),
        ("threads", True),
        ("threads", "2"),
    ],
    ids=lambda x: " ".join(repr(x).split())[:30],
)
def test_bad_problems(name, wrong):
    refused(name, **{name: wrong})


def test_barely_full_rank_keeps_the_order_of_columns():
    """Where only singular values tell that no column is lost, leading models are still those of leading columns."""
    rng = np.random.default_rng(3)
    for size in range(12, 30):
        x = np.sort(rng.uniform(-1, 1, 40))
        A, b = np.vander(x, size, increasing=True) * 3.0 ** np.arange(size), rng.normal(size=40)
        curve = mx.cross_validate_nested(A, b, range(1, 9), {"": s.leave_one_out(40)})[""]
        whole = mx.cross_validate_nested(A, b, range(1, size + 1), {"": s.leave_one_out(40)})[""]
        np.testing.assert_allclose(whole[:8], curve, rtol=1e-9)


@pytest.mark.parametrize("factor", [1.2, 1.5, 2, 3, 6])
def test_singular_values_near_the_tolerance(factor):
    rng = np.random.default_rng(0)
    A, b = rng.normal(size=(200, 8)), rng.normal(size=200)
    A[:, 7] = A[:, 1] + factor * 200 * np.finfo(float).eps * np.linalg.norm(A[:, 1]) / 14 * rng.normal(
        size=200
    )
    scheme = s.leave_one_out(200)
    curve = mx.cross_validate_nested(A, b, range(1, 9), {"": scheme})[""]
    for size in range(1, 8):
        plain = mx.LeastSquares(A[:, :size], b).cross_validate(scheme).score
        assert curve[size - 1] == pytest.approx(plain, rel=1e-9)


def test_columns_beyond_the_largest_size_do_not_matter():
    rng = np.random.default_rng(1)
    A, b = rng.normal(size=(30, 60)), rng.normal(size=30)
    scheme = {"": s.k_fold(30, 5, seed=0)}
    few = mx.cross_validate_nested(A[:, :6], b, [2, 6], scheme, penalty=np.eye(6))
    many = mx.cross_validate_nested(A, b, [2, 6], scheme, penalty=np.eye(60)[:6])
    np.testing.assert_array_equal(few[""], many[""])
