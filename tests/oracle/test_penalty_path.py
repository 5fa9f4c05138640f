"""All weights of a penalty from one factorisation, against a refit for each."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from refits import Problem, every_scheme, make, pairs

import mexpress as mx
from mexpress.leastsquares.penalty_path import PenaltyPath

# In units of the weight at which the penalty is as large as the design; "auto" tries 1e-6 to 1e8 of it. Farther down,
# 1e-12 say, pairs that lose the design's rank are good to seven digits: predictions that the penalty alone makes.
WEIGHTS = [1e-7, 1e-3, 0.1, 1.0, 30.0, 1e4, 1e8]


def unit(problem):
    """The weight at which the penalty is as large as the design."""
    return (np.linalg.norm(problem.A) / np.linalg.norm(problem.penalty)) ** 2


def weighted(problem, weight):
    """The problem with a weight of its penalty."""
    return replace(problem, penalty=np.sqrt(weight) * problem.penalty)


def factorised(problem):
    return PenaltyPath(problem.A, problem.b, problem.m // problem.n, problem.penalty)


def check_fit(fit, problem):
    """Coefficients, residuals and leverages are those of a refit, columns at unit length."""
    m, size = problem.m, np.abs(problem.b).max()
    scale = np.linalg.norm(np.vstack([problem.A, problem.penalty]), axis=0)
    A, Z = problem.A / scale, problem.penalty / scale
    inverse = np.linalg.pinv(np.vstack([A, Z]))[:, :m]
    x = inverse @ problem.b
    assert fit.model.rank == len(fit.model.coefficients)
    assert fit.model.n_data == problem.n
    np.testing.assert_allclose((fit.coefficients.T * scale).T, x, rtol=0, atol=1e-9 * np.abs(x).max())
    np.testing.assert_allclose(fit.model.residuals, problem.b - A @ x, rtol=0, atol=1e-9 * size)
    np.testing.assert_allclose(fit.model.leverage, np.diag(A @ inverse), rtol=0, atol=1e-9)


def check_predictions(fit, problem, schemes):
    """Every prediction is that of a refit."""
    for name, scheme in schemes.items():
        cv = fit.model.cross_validate(scheme)
        assert len(cv.undefined) == 0, name
        assert cv.score == pytest.approx(problem.score(scheme), rel=1e-9), name
    atol = 1e-9 * np.abs(problem.b).max()
    for held, _ in pairs(schemes["from_sets"]):
        rows = problem.rows(held)
        np.testing.assert_allclose(fit.model.held_out_residuals(rows), problem.refit(rows), rtol=0, atol=atol)


@pytest.mark.parametrize("family", ["random", "tps", "spline"])
@pytest.mark.parametrize(("coupling", "responses"), [(1, 1), (1, 3), (2, 1), (3, 2)])
def test_every_weight_is_a_refit(family, coupling, responses):
    problem, points = make(family, coupling, responses=responses, penalised=True)
    path, schemes = factorised(problem), every_scheme(points)
    assert path.determined
    assert path.rank == np.linalg.matrix_rank(problem.A / np.linalg.norm(problem.A, axis=0))
    for weight in WEIGHTS:
        here = weighted(problem, weight * unit(problem))
        fit = path.fit(weight * unit(problem))
        check_fit(fit, here)
        check_predictions(fit, here, schemes)


@pytest.mark.parametrize("coupling", [1, 2])
def test_every_weight_is_the_direct_least_squares(coupling):
    problem, points = make("tps", coupling, responses=2, penalised=True)
    path = factorised(problem)
    for weight in WEIGHTS:
        fit, direct = path.fit(weight * unit(problem)), weighted(problem, weight * unit(problem)).model()
        np.testing.assert_allclose(fit.coefficients, direct.coefficients, rtol=1e-9)
        np.testing.assert_allclose(fit.model.leverage, direct.leverage, rtol=1e-9)
        assert fit.model.fit_rms == pytest.approx(direct.fit_rms, rel=1e-9)
        assert fit.model.press == pytest.approx(direct.press, rel=1e-9)
        for scheme in every_scheme(points).values():
            one, two = fit.model.cross_validate(scheme), direct.cross_validate(scheme)
            np.testing.assert_allclose(one.residuals, two.residuals, rtol=1e-9, atol=1e-9 * one.score)


def test_threads_do_not_matter():
    rng = np.random.default_rng(0)
    problem = respond_to(rng.normal(size=(1500, 60)), rng.normal(size=(80, 60)))
    schemes = every_scheme(rng.uniform(size=(1500, 2)))
    paths = [PenaltyPath(problem.A, problem.b, 1, problem.penalty, threads=k) for k in (1, 2, 3)]
    one, *others = (path.fit(unit(problem), k) for k, path in enumerate(paths, 1))
    for other in others:
        np.testing.assert_array_equal(one.coefficients, other.coefficients)
        for scheme in schemes.values():
            found = [
                fit.model.cross_validate(scheme, threads=k).residuals for fit, k in ((one, 1), (other, 2))
            ]
            np.testing.assert_array_equal(*found)


def respond_to(A, Z):
    """A problem of a design and a penalty, with any responses."""
    return Problem(A, 100 * np.random.default_rng(1).normal(size=len(A)), np.arange(len(A)), penalty=Z)


@pytest.mark.parametrize("weight", WEIGHTS[2:])
def test_more_columns_than_rows(weight):
    rng = np.random.default_rng(2)
    problem = respond_to(rng.normal(size=(10, 15)), rng.normal(size=(17, 15)))
    path = factorised(problem)
    assert (path.determined, path.rank) == (True, 10)
    here, fit = weighted(problem, weight * unit(problem)), path.fit(weight * unit(problem))
    check_fit(fit, here)
    check_predictions(fit, here, every_scheme(rng.uniform(0, 1000, (10, 2))))


@pytest.mark.parametrize("weight", WEIGHTS[2:])
def test_what_the_design_leaves_open_the_penalty_determines(weight):
    rng = np.random.default_rng(3)
    A = rng.normal(size=(20, 6))
    A[:, 4] = A[:, 0] - 2 * A[:, 1]
    A[:, 5] = 0
    problem = respond_to(A, np.eye(6)[3:] + 0.1 * rng.normal(size=(3, 6)))
    path = factorised(problem)
    assert (path.determined, path.rank) == (True, 4)
    here, fit = weighted(problem, weight * unit(problem)), path.fit(weight * unit(problem))
    check_fit(fit, here)
    check_predictions(fit, here, {"from_sets": mx.schemes.from_sets([[0], [3, 4], range(6)], n=20)})


def test_columns_of_any_scale():
    rng = np.random.default_rng(4)
    A, Z = rng.normal(size=(20, 5)), rng.normal(size=(4, 5))
    plain, scale = respond_to(A, Z), 10.0 ** np.array([-9, 6, 0, -4, 9])
    scaled = replace(plain, A=A * scale, penalty=Z * scale)
    scheme = mx.schemes.k_fold(20, 4, seed=0)
    for weight in WEIGHTS:
        one, two = (factorised(problem).fit(weight) for problem in (plain, scaled))
        np.testing.assert_allclose(two.coefficients * scale, one.coefficients, rtol=1e-9)
        np.testing.assert_allclose(two.model.leverage, one.model.leverage, rtol=1e-9)
        scores = [fit.model.cross_validate(scheme).score for fit in (one, two)]
        assert scores[1] == pytest.approx(scores[0], rel=1e-9)
        check_fit(two, weighted(scaled, weight))


@pytest.mark.parametrize("decades", [4, 8, 12])
def test_soft_and_stiff_directions_keep_their_digits(decades):
    # Where the stiffest direction is as stiff as the design is long, all others have the same cosine: one.
    rng = np.random.default_rng(11)
    problem = respond_to(rng.normal(size=(20, 6)), np.diag(np.logspace(0, decades, 6)))
    scheme = mx.schemes.from_sets([[0], [3, 4], range(6)], n=20)
    for weight in (1e-4, 1.0, 1e4):
        fit, here = factorised(problem).fit(weight), weighted(problem, weight)
        check_fit(fit, here)
        check_predictions(fit, here, {"from_sets": scheme})


@pytest.mark.parametrize("gap", [1.0, 1e-2, 1e-4, 1e-6])
def test_a_loss_of_rank_is_seen_where_the_design_lacks_rank(gap):
    # Two columns differ in rows that are held out, and the penalty sees neither; what it sees, the design does not.
    rng = np.random.default_rng(12)
    A = rng.normal(size=(20, 6))
    A[:, 5], A[:, 0] = A[:, 2] + A[:, 3], A[:, 1]
    A[:2, 0] += gap * rng.normal(size=2)
    path = factorised(respond_to(A, np.eye(6)[5:]))
    assert (path.determined, path.rank) == (True, 5)
    scheme = mx.schemes.from_sets([[0, 1]], n=20)
    for weight in (1e-4, 1.0, 1e4):
        model = path.fit(weight).model
        with pytest.warns(mx.RankLossWarning):
            assert np.isnan(model.held_out_residuals([0, 1])).all()
        assert np.isnan(model.prediction_spread(scheme)[0]).all()


def exact_residuals(problem, weight, held):
    """Residuals of held-out rows by a refit in rational numbers."""
    rows = [[Fraction(x) for x in row] for row in problem.A.tolist()]
    b = [Fraction(x) for x in problem.b.tolist()]
    extra = [[Fraction(x) for x in row] for row in problem.penalty.tolist()]
    kept, p = [i for i in range(len(rows)) if i not in held], len(rows[0])
    system = [
        [
            sum(rows[i][j] * rows[i][k] for i in kept) + Fraction(weight) * sum(z[j] * z[k] for z in extra)
            for k in range(p)
        ]
        + [sum(rows[i][j] * b[i] for i in kept)]
        for j in range(p)
    ]
    for j in range(p):
        for k in range(p):
            if k != j:
                share = system[k][j] / system[j][j]
                system[k] = [x - share * y for x, y in zip(system[k], system[j], strict=True)]
    x = [system[j][p] / system[j][j] for j in range(p)]
    return [float(b[i] - sum(map(Fraction.__mul__, rows[i], x))) for i in held]


@pytest.mark.parametrize("exponent", [-300, -100, -30, -16, -8, 0, 8, 16, 24, 28, 32, 40, 100, 300])
def test_extreme_weights_are_exact(exponent):
    # Neither end is more than a limit: the design alone, and the design where the penalty is zero.
    rng = np.random.default_rng(5)
    problem = respond_to(rng.normal(size=(14, 4)), rng.normal(size=(2, 4)))
    fit, weight = factorised(problem).fit(10.0**exponent), 10.0**exponent
    size = np.abs(problem.b).max()
    expected = exact_residuals(problem, weight, [])
    every = [exact_residuals(problem, weight, [i])[0] for i in range(14)]
    cv = fit.model.cross_validate(mx.schemes.leave_one_out(14))
    np.testing.assert_allclose(cv.residuals, every, rtol=0, atol=1e-9 * size)
    for held in ([2, 3, 7], [0, 1, 2, 3, 4, 5, 13]):
        expected = exact_residuals(problem, weight, held)
        np.testing.assert_allclose(fit.model.held_out_residuals(held), expected, rtol=0, atol=1e-9 * size)


@pytest.mark.parametrize("exponent", [-300, -40, -30, 0, 30])
def test_at_extreme_weights_the_rank_of_the_design_is_still_seen(exponent):
    # The last column is seen by the penalty alone: it has no leverage at any weight.
    rng = np.random.default_rng(6)
    A = np.column_stack([rng.normal(size=(14, 3)), np.zeros(14)])
    A[:, 3] = A[:, :3] @ [1.0, 2.0, 3.0]
    path = factorised(respond_to(A, np.eye(4)[3:]))
    fit = path.fit(10.0**exponent)
    assert path.rank == 3
    assert fit.model.leverage.sum() == pytest.approx(3, rel=1e-9)


def test_what_both_leave_open_has_no_coefficients():
    rng = np.random.default_rng(7)
    A, Z = rng.normal(size=(20, 5)), rng.normal(size=(3, 5))
    A[:, 2], Z[:, 2] = A[:, 0] + A[:, 1], Z[:, 0] + Z[:, 1]
    path = factorised(respond_to(A, Z))
    assert not path.determined
    for weight in WEIGHTS:
        fit = path.fit(weight)
        assert fit.coefficients is None
        assert fit.model.rank == 4


@pytest.mark.parametrize("k", [0, 1])
def test_fewer_rows_than_columns_in_all(k):
    rng = np.random.default_rng(8)
    A, Z = rng.normal(size=(4, 6)), rng.normal(size=(k, 6))
    fit = PenaltyPath(A, rng.normal(size=4), 1, Z).fit(1.0)
    assert fit.coefficients is None
    assert fit.model.rank == 4 + k


def test_a_penalty_of_zeros_is_none():
    rng = np.random.default_rng(9)
    problem = respond_to(rng.normal(size=(12, 3)), np.zeros((2, 3)))
    for weight in (1e-30, 1.0, 1e30):
        check_fit(factorised(problem).fit(weight), problem)


@pytest.mark.parametrize("family", ["random", "tps"])
@pytest.mark.parametrize(("coupling", "responses"), [(1, 3), (2, 1)])
@pytest.mark.parametrize("size", [1.0, 7.3, 1e-9, 1e12])
def test_weights_of_the_data_are_those_of_refits(family, coupling, responses, size):
    problem, points = make(family, coupling, responses=responses, weighted=True, penalised=True)
    problem = replace(problem, weights=size * problem.weights)
    path = PenaltyPath(problem.A, problem.b, coupling, problem.penalty, problem.weights)
    for weight in WEIGHTS:
        here = weighted(problem, size * weight * unit(problem))
        fit, direct = path.fit(size * weight * unit(problem)), here.model()
        np.testing.assert_allclose(fit.coefficients, direct.coefficients, rtol=1e-8)
        np.testing.assert_allclose(fit.model.leverage, direct.leverage, rtol=1e-9)
        assert fit.model.fit_rms == pytest.approx(direct.fit_rms, rel=1e-9)
        for name, scheme in every_scheme(points).items():
            cv = fit.model.cross_validate(scheme)
            assert cv.score == pytest.approx(here.score(scheme), rel=1e-9), name
            np.testing.assert_allclose(cv.residuals, direct.cross_validate(scheme).residuals, atol=1e-7)


@pytest.mark.parametrize("weight", [1e3, 5e6, 1e9])
def test_control_points_without_data_do_not_set_the_unit(weight):
    # Their columns are not zero, but rounding: their ratios to those of the penalty mean nothing.
    rng = np.random.default_rng(3)
    x = rng.uniform(size=38)
    A = np.column_stack([1 - x, x, 1e-3 * x * (1 - x), 1e-19 * rng.uniform(size=(38, 13))])
    b, Z = 40_000 + 1000 * x + rng.normal(size=38), 5e-6 * np.diff(np.eye(16), 2, axis=0)
    folds = mx.schemes.k_fold(38, 5, seed=0)
    found = PenaltyPath(A, b, 1, Z).fit(weight).model.cross_validate(folds).residuals
    expected = mx.LeastSquares(A, b, penalty=np.sqrt(weight) * Z).cross_validate(folds).residuals
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
