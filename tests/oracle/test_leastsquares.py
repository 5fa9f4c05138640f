import copy
import pickle
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refits import (
    COUPLINGS,
    FAMILIES,
    Problem,
    b_spline,
    barely_of_full_rank,
    every_scheme,
    lstsq_wide,
    make,
    needs_longdouble,
    thin_plate,
    worst_error,
)

import mexpress as mx
from mexpress.leastsquares.model import cross_validate_all

loo = mx.schemes.leave_one_out


def quiet(model, scheme, **options):
    """Cross-validate where rank may be lost."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mx.RankLossWarning)
        return model.cross_validate(scheme, **options)


# ------------------------------------------------------------------------------------------ equal to refits


@pytest.mark.parametrize("penalised", [False, True], ids=["", "penalty"])
@pytest.mark.parametrize("weighted", [False, True], ids=["", "weights"])
@pytest.mark.parametrize("responses", [pytest.param(1, marks=pytest.mark.slow), 3])
@pytest.mark.parametrize("coupling", COUPLINGS)
@pytest.mark.parametrize("family", FAMILIES)
def test_every_scheme_equals_its_refits(*, family, coupling, responses, weighted, penalised):
    options = {"responses": responses, "weighted": weighted, "penalised": penalised}
    problem, points = make(family, coupling, **options, seed=7)
    model = problem.model()
    for name, scheme in every_scheme(points).items():
        cv = quiet(model, scheme)
        assert worst_error(problem, scheme, cv) < 1e-9, name
        if len(cv.undefined):
            assert np.isnan(cv.score)
        else:
            assert cv.score == pytest.approx(problem.score(scheme), rel=1e-9), name


@given(
    n=st.integers(1, 14),
    p=st.integers(1, 9),
    coupling=st.sampled_from(COUPLINGS),
    responses=st.sampled_from([1, 3]),
    weighted=st.booleans(),
    penalty_rows=st.integers(0, 10),
    kind=st.sampled_from(["dense", "whole numbers", "dummies", "duplicates", "zeros"]),
    seed=st.integers(0, 10_000),
    data=st.data(),
)
def test_any_sets_of_any_problem(*, n, p, coupling, responses, weighted, penalty_rows, kind, seed, data):
    rng = np.random.default_rng(seed)
    labels = np.arange(n * 2) // 2 if coupling == 2 else np.repeat(np.arange(n), 1 if coupling == 1 else 3)
    if coupling == "uneven":
        labels = rng.permutation(np.repeat(np.arange(n), rng.integers(1, 4, n)))
    m = len(labels)
    A = rng.normal(size=(m, p))
    if kind == "whole numbers":
        A = rng.integers(-2, 3, (m, p)).astype(float)
    elif kind == "dummies":
        A = (rng.uniform(size=(m, p)) < 0.2).astype(float)
    elif kind == "duplicates":
        A = A[:, rng.integers(0, max(1, p // 2), p)]
    elif kind == "zeros":
        A[:, rng.uniform(size=p) < 0.5] = 0
    b = rng.normal(size=(m, responses))
    weights = rng.uniform(0.01, 100, n) if weighted else None
    penalty = rng.normal(size=(penalty_rows, p)) if penalty_rows else None
    if kind in {"duplicates", "zeros"} and penalty_rows:
        penalty = penalty * (np.abs(A).sum(axis=0) > 0) @ np.diag(rng.integers(0, 2, p))
    problem = Problem(A, b[:, 0] if responses == 1 else b, labels, weights, penalty)
    model = problem.model()
    assert model.rank == problem.rank
    subset = st.sets(st.integers(0, n - 1))
    held = data.draw(st.lists(subset, min_size=1, max_size=4))
    validated = [data.draw(st.sets(st.sampled_from(sorted(s)))) if s else set() for s in held]
    scheme = mx.schemes.from_sets([sorted(s) for s in held], [sorted(s) for s in validated], n=n)
    assert worst_error(problem, scheme, quiet(model, scheme)) < 1e-9


@given(
    n=st.integers(2, 30),
    p=st.integers(1, 9),
    coupling=st.sampled_from([1, 2, 5, "uneven"]),
    responses=st.sampled_from([1, 3]),
    weighted=st.booleans(),
    penalised=st.booleans(),
    lossy=st.booleans(),
    seed=st.integers(0, 10_000),
)
def test_sets_that_nest_around_a_datum_equal_their_refits(
    *, n, p, coupling, responses, weighted, penalised, lossy, seed
):
    # Such sets share a factorisation or a matrix, until they lose rank; others between them do not belong to it.
    rng = np.random.default_rng(seed)
    labels = np.arange(n * coupling) // coupling if coupling != "uneven" else np.arange(2 * n) % n
    if coupling == "uneven":
        labels = np.concatenate([labels, rng.integers(0, n, n)])
    A = rng.normal(size=(len(labels), p))
    if lossy:
        A[:, rng.integers(p)] *= rng.uniform(size=len(A)) < 0.2
    b = rng.normal(size=(len(labels), responses))
    weights = rng.uniform(0.01, 100, n) if weighted else None
    penalty = rng.normal(size=(2, p)) if penalised else None
    problem = Problem(A, b[:, 0] if responses == 1 else b, labels, weights, penalty)
    held, validated = [], []
    for datum in rng.permutation(n)[:6]:
        others = rng.permutation(np.delete(np.arange(n), datum))
        sizes = rng.integers(0, n, 5)
        sets = [others[:size] for size in sizes] + [rng.choice(others, rng.integers(0, n), replace=False)]
        held += [np.append(inside, datum) for inside in sets]
        validated += [[datum]] * len(sets)
    scheme = mx.schemes.from_sets(held, validated, n=n)
    model = problem.model()
    cv = quiet(model, scheme)
    assert worst_error(problem, scheme, cv) < 1e-9
    visited = mx.schemes.Scheme(n, scheme.held_out, scheme.validated, rng.permutation(len(scheme)))
    assert worst_error(problem, visited, quiet(model, visited)) < 1e-9
    schemes = {str(k): mx.schemes.from_sets(held[k::6], validated[k::6], n=n) for k in range(6)}
    with warnings.catch_warnings(action="ignore", category=mx.RankLossWarning):
        together = cross_validate_all(model, schemes, None)
    for name, part in schemes.items():
        assert worst_error(problem, part, together[name]) < 1e-9
    np.testing.assert_array_equal(
        quiet(model, visited, threads=1).residuals, quiet(model, visited, threads=2).residuals
    )


def errors(problem, points):
    """Worst relative errors of the library and of lstsq, both against refits in extended precision."""
    model = problem.model()
    ours = theirs = 0.0
    size = np.abs(problem.b).max()
    for scheme in every_scheme(points).values():
        cv = quiet(model, scheme)
        ours = max(ours, worst_error(problem, scheme, cv, wide=True))
        for held in scheme.held_out:
            rows = problem.rows(held)
            if not problem.loses_rank(rows):
                exact = problem.refit(rows, wide=True)
                difference = np.abs(problem.refit(rows) - exact).max(initial=0)
                theirs = max(theirs, difference / max(size, np.abs(exact).max(initial=0)))
    return ours, theirs


@needs_longdouble
@pytest.mark.slow
@pytest.mark.parametrize("count", [3, 8, 16])
@pytest.mark.parametrize("seed", range(3))
def test_thin_plate_splines_on_raw_pixels_against_extended_precision(count, seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 1, (50, 2)) * [1920, 1080]
    A = thin_plate(points, rng.uniform(0, 1, (count, 2)) * [1920, 1080])
    b = points + 10 * np.sin(points / 300) + rng.normal(size=points.shape)
    assert np.linalg.cond(A) > 1e7
    assert errors(Problem(A, b, np.arange(50)), points)[0] < 1e-9


@needs_longdouble
@pytest.mark.parametrize("exponent", [2, 4, 6, 7])
def test_splines_with_a_nearly_empty_cell_against_extended_precision(exponent):
    # The last spline is supported by one datum alone that just enters its cell: a column of 10^-2..-7 cubed,
    # with a leverage of one, beside data that reach nearly as far.
    rng = np.random.default_rng(1)
    x = np.concatenate([rng.uniform(0, 0.75, 40), 0.75 + 10.0**-exponent * np.array([1.0, 0.7, 0.4])])
    A = b_spline(x, 8)
    A = A[:, np.abs(A).sum(axis=0) > 0]
    b = np.sin(6 * x) + rng.normal(0, 0.1, len(x))
    points = np.column_stack([x * 1920, rng.uniform(0, 1080, len(x))])
    assert errors(Problem(A, b, np.arange(len(x))), points)[0] < 1e-9


@needs_longdouble
@pytest.mark.parametrize("distance", 10.0 ** -np.arange(1, 13))
def test_training_rows_close_to_rank_loss(distance):
    # Without the last two rows, the second column is seen at `distance` of its length alone. Every entry is
    # given to full precision, and what is left to fit is well conditioned once its columns have unit length:
    # a refit is accurate, so 1e-9 is a fair demand.
    rng = np.random.default_rng(0)
    A = np.column_stack([np.ones(20), distance * rng.normal(size=20)])
    A[-2:, 1] = [1.0, -2.0]
    b = rng.normal(size=20)
    model = mx.LeastSquares(A, b)
    for held in ([18, 19], [3, 18, 19], [2, 3, 4, 18, 19]):
        kept = np.setdiff1d(np.arange(20), held)
        expected, refit = refits(A, b, kept, held)
        assert np.abs(refit - expected).max() < 1e-10 * np.abs(expected).max()
        got = model.held_out_residuals(held)
        assert np.abs(got - expected).max() < 1e-9 * np.abs(expected).max()


@needs_longdouble
@pytest.mark.parametrize("distance", [1, 4e-4, 1e-7, 0], ids=["closed", "refined", "refitted", "undefined"])
@pytest.mark.parametrize("responses", [1, 3])
def test_weights_count_whatever_becomes_of_a_pair(distance, responses):
    # As above, the pairs on each way through the core and beyond it.
    rng = np.random.default_rng(0)
    A = np.column_stack([np.ones(20), distance * rng.normal(size=20)])
    A[-2:, 1] = [1.0, -2.0]
    b, weights = rng.normal(size=(20, responses)), rng.uniform(0.1, 10, 20)
    problem = Problem(A, b, np.arange(20), weights)
    scheme = mx.schemes.from_sets([[18, 19], [3, 18, 19]], [[18, 19], [18]], n=20)
    cv = quiet(problem.model(), scheme)
    assert worst_error(problem, scheme, cv, wide=True) < 1e-9
    if distance:
        assert cv.score == pytest.approx(problem.score(scheme), rel=1e-7)


@pytest.mark.parametrize("p", [5, 12])
def test_rank_that_is_lost_to_rounding_alone(p):
    # Two columns differ by 1e-12, and by rounding once the last two rows are gone: lambda_min(M) is 1e-6 or so and says
    # nothing of that.
    for seed in range(3):
        problem = barely_of_full_rank(p, seed)
        scheme = mx.schemes.from_sets([[58, 59], [3, 58, 59], [3]], n=60)
        assert quiet(problem.model(), scheme).undefined.tolist() == [0, 1]
        assert [problem.loses_rank(held) for held in scheme.held_out] == [True, True, False]


@needs_longdouble
@pytest.mark.parametrize("penalised", [False, True])
@pytest.mark.parametrize("m", [511, 513, 1500])
def test_refits_of_more_training_rows_than_are_reduced_at_a_time(m, penalised):
    rng = np.random.default_rng(m)
    A = np.column_stack([rng.normal(size=(m, 3)), 1e-7 * rng.normal(size=m)])
    A[[2, m // 2], 3] = [1.0, -2.0]
    b, weights = rng.normal(size=(m, 2)), rng.uniform(0.1, 10, m)
    penalty = np.array([[0.1, 0.2, 0.3, 0.0]]) if penalised else None
    problem = Problem(A, b, np.arange(m), weights, penalty)
    scheme = mx.schemes.from_sets([[2, m // 2], [2, 7, m // 2, m - 1]], n=m)
    assert worst_error(problem, scheme, problem.model().cross_validate(scheme), wide=True) < 1e-9


@pytest.mark.parametrize("mean", [1e6, 1e9])
def test_residuals_far_smaller_than_responses(mean):
    # A constant column takes the mean; what is left is orthogonal to the design to its own digits, not to the mean's.
    rng = np.random.default_rng(0)
    A = np.column_stack([rng.normal(size=(5000, 4)), np.ones(5000)])
    b = np.round(rng.normal(size=5000) * 2.0**20) / 2.0**20  # so that adding the mean is exact
    residuals = mx.LeastSquares(A, b + mean).residuals
    along = A.T @ residuals / np.linalg.norm(A, axis=0)
    assert np.abs(along).max() < 1e-13 * np.linalg.norm(b)
    np.testing.assert_allclose(residuals, mx.LeastSquares(A, b).residuals, atol=1e-13 * mean)


@pytest.mark.parametrize(("m", "penalty_rows"), [(4000, 0), (400, 3600)])
@pytest.mark.parametrize("ratio", [2e-13, 5e-12])
def test_rank_of_many_rows_is_that_of_numpy(m, penalty_rows, ratio):
    # What counts as rounding grows with the number of rows: here 9e-13 of the largest singular value.
    rng = np.random.default_rng(0)
    Q, V = np.linalg.qr(rng.normal(size=(m + penalty_rows, 5)))[0], np.linalg.qr(rng.normal(size=(5, 5)))[0]
    A = Q * [1, 1, 1, 1, ratio] @ V
    model = mx.LeastSquares(A[:m], rng.normal(size=m), penalty=A[m:] if penalty_rows else None)
    assert model.rank == np.linalg.matrix_rank(A) == 4 + (ratio > 1e-12)


def refits(A, b, kept, held):
    """Residuals in extended precision, and by lstsq; columns of the training rows at unit length."""
    scale = np.linalg.norm(A[kept], axis=0)
    wide = lstsq_wide(A[kept] / scale, b[kept, None])[:, 0]
    plain = np.linalg.lstsq(A[kept] / scale, b[kept], rcond=None)[0]
    return tuple((b[held] - (A[held] / scale) @ x).astype(float) for x in (wide, plain))


@needs_longdouble
@pytest.mark.parametrize(("order", "c"), [(10, 0.3), (20, 0.3), (30, 0.3), (60, 0.15), (60, 0.2)])
def test_pivots_that_hide_the_conditioning(order, c):
    # Kahan's triangle: no pivot of its Gram matrix is small though its smallest singular value is. The
    # training rows are that triangle, whose condition lets a refit keep ten digits.
    s = np.sqrt(1 - c * c)
    R = np.diag(s ** np.arange(order)) @ (np.eye(order) - c * np.triu(np.ones((order, order)), 1))
    R *= 0.999 / np.linalg.norm(R, 2)
    values, vectors = np.linalg.eigh(np.eye(order) - R.T @ R)
    A = np.vstack([R, R[: order // 2] / 1000, vectors * np.sqrt(values) @ vectors.T])
    b = np.random.default_rng(0).normal(size=len(A))
    kept, held = np.split(np.arange(len(A)), [len(A) - order])
    expected, refit = refits(A, b, kept, held)
    assert np.abs(refit - expected).max() < 1e-10 * np.abs(expected).max()
    got = mx.LeastSquares(A, b).held_out_residuals(held)
    assert np.abs(got - expected).max() < 1e-9 * np.abs(expected).max()


@pytest.mark.parametrize("column", [[1, 2e-3, 4e-6], [1, 3e-3, 1e-5], [1, 1.5e-2, 2e-4, 3e-6]])
def test_few_rows_whose_pivots_hide_the_conditioning(column):
    problem = Problem(
        np.array(column)[:, None], np.array([1, 0.3, 0.7, 0.2])[: len(column)], np.arange(len(column))
    )
    scheme = mx.schemes.from_sets([np.arange(len(column) - 1)], n=len(column))
    assert worst_error(problem, scheme, problem.model().cross_validate(scheme)) < 1e-9


@pytest.mark.parametrize("spread", [1e-5, 1e-6, 1e-7, 1e-8, 1e-9])
def test_one_row_that_nearly_determines_a_column(spread):
    for seed in range(100):
        rng = np.random.default_rng(seed)
        A = rng.normal(size=(9, 5))
        A[1:, -1] *= np.sqrt(spread)
        A[0, -1] = 3
        if np.linalg.cond(A[1:] / np.linalg.norm(A[1:], axis=0)) < 20:
            b = rng.normal(size=9)
            norms = np.linalg.norm(A[1:], axis=0)
            expected = b[0] - A[0] / norms @ np.linalg.lstsq(A[1:] / norms, b[1:], rcond=None)[0]
            found = mx.LeastSquares(A, b).held_out_residuals([0])[0]
            assert found == pytest.approx(expected, abs=1e-9 * max(abs(expected), np.abs(b).max()))


def test_many_sets_around_one_datum_that_do_not_nest():
    # Were each compared with all others, this would take minutes.
    rng = np.random.default_rng(0)
    model = mx.LeastSquares(rng.normal(size=(60, 4)), rng.normal(size=60))
    others = 1 + rng.random((100_000, 59)).argsort(axis=1)[:, :8]
    held = np.column_stack([others, np.zeros(100_000, dtype=int)])
    cv = model.cross_validate(mx.schemes.from_sets(held, [[0]] * len(held), n=60))
    some = rng.choice(len(held), 50, replace=False)
    alone = [model.held_out_residuals(held[s])[-1] for s in some]
    np.testing.assert_allclose(cv.residuals[some], alone, rtol=1e-9)


@pytest.mark.parametrize("n", [1, 2, 7, 1999, 2000, 2001, 4100])
def test_shapes_around_the_blocks_of_the_factorisation(n):
    rng = np.random.default_rng(n)
    p = min(n, 6)
    A, b = rng.normal(size=(n, p)), rng.normal(size=n)
    model = mx.LeastSquares(A, b)
    x = np.linalg.lstsq(A, b, rcond=None)[0]
    np.testing.assert_allclose(model.coefficients, x, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(model.residuals, b - A @ x, atol=1e-11)
    held = np.arange(0, n, 3)
    if n > 12:
        problem = Problem(A, b, np.arange(n))
        np.testing.assert_allclose(model.held_out_residuals(held), problem.refit(held), atol=1e-9)


def test_sets_larger_than_any_special_case():
    # More held-out rows than columns and fewer, whole hat matrix or not: all ways must agree with a refit.
    rng = np.random.default_rng(5)
    A, b = rng.normal(size=(700, 40)), rng.normal(size=(700, 2))
    problem = Problem(A, b, np.arange(700))
    sizes = [1, 2, 3, 4, 5, 39, 40, 41, 100, 300, 600, 660]
    scheme = mx.schemes.from_sets([rng.choice(700, q, replace=False) for q in sizes], n=700)
    assert worst_error(problem, scheme, problem.model().cross_validate(scheme)) < 1e-9


@pytest.mark.parametrize("weighted", [False, True], ids=["", "weights"])
@pytest.mark.parametrize("size", [(12, 4), (60, 6), (700, 9)], ids=str)
@pytest.mark.parametrize("near", [0.0, 1e-7], ids=["", "near rank loss"])
def test_a_mean_that_a_column_explains_costs_no_digit(size, near, weighted):
    """Responses that are moved by an exact multiple of a column have the residuals that they had."""
    rng, (m, p) = np.random.default_rng(4), size
    A = rng.normal(size=size)
    A[:, p // 2] = 4.0
    if near:
        A[:, 0] = A[:, 1] + near * A[:, 0]
    b = np.round(1024 * rng.normal(size=(m, 2))) / 1024
    weights = 4.0 ** rng.integers(-2, 3, m) if weighted else None
    for scheme in (loo(m), mx.schemes.k_fold(m, 4, seed=0)):
        there, here = (
            mx.LeastSquares(A, b + np.array([mean, -mean]), weights=weights).cross_validate(scheme).residuals
            for mean in (0.0, 2.0**30)
        )
        np.testing.assert_allclose(here, there, rtol=0, atol=1e-9 * np.abs(there).max())


def test_a_triangle_whose_singular_values_do_not_converge_at_once():
    """Of dummies of a factor, where columns are whole or zero; the decomposition went round in circles."""
    level = np.array([7, 1, 0, 5, 2, 12, 4, 8, 7, 1, 3, 5, 7, 11, 0, 5, 13, 8, 5, 1, 9, 0, 11, 12])
    level = np.append(level, [9, 10, 7, 0, 6, 9, 2, 6, 8, 1, 6, 6, 1, 0, 6, 3, 8, 13, 6, 11, 2, 13, 10, 0])
    A = (level[:, None] == np.arange(14)).astype(float)
    A[:, 0] = 1
    held = np.r_[0, 2, 3, 6, 12, 15, 19, 20, 23:27, 29, 31, 32, 34:39, 40, 41, 43, 45, 46]
    kept = np.setdiff1d(np.arange(48), held)
    assert np.linalg.matrix_rank(A[kept]) < 14
    with pytest.warns(mx.RankLossWarning):
        found = mx.LeastSquares(A, np.ones(48)).cross_validate(mx.schemes.from_sets([held], n=48))
    assert np.isnan(found.residuals).all()


# ------------------------------------------------------------------------------------------------ rank loss


def rank_loss_cases():
    rng = np.random.default_rng(3)
    x = rng.normal(size=12)
    ones = np.ones(12)
    dummy = lambda *rows: np.isin(np.arange(12), rows).astype(float)  # noqa: E731
    line = np.column_stack([ones, x])
    yield "dummy seen by one datum", np.column_stack([line, dummy(4)]), None
    yield "dummies seen by few", np.column_stack([line, dummy(0), dummy(3, 7), dummy(5, 6, 9)]), None
    yield "duplicated column", np.column_stack([line, x]), None
    yield "duplicated dummy", np.column_stack([line, dummy(4), 3 * dummy(4)]), None
    yield "dummies that sum to one", np.column_stack([ones, dummy(0, 1, 2), 1 - dummy(0, 1, 2)]), None
    yield "fewer rows than columns", rng.normal(size=(12, 20)), None
    yield "as many rows as columns", rng.normal(size=(12, 12)), None
    yield "one row more than columns", rng.normal(size=(12, 11)), None
    yield "all zero", np.zeros((12, 3)), None
    yield "a zero column", np.column_stack([line, 0 * x]), None
    yield "penalty rescues the dummy", np.column_stack([line, dummy(4)]), [[0, 0, 0.1]]
    yield "penalty rescues another column", np.column_stack([line, dummy(4)]), [[0, 0.1, 0]]
    yield "full penalty", rng.normal(size=(12, 20)), 0.1 * np.eye(20)
    yield "penalty of lower rank", rng.normal(size=(12, 20)), rng.normal(size=(11, 20))
    yield "penalty of zeros", np.column_stack([line, dummy(4)]), np.zeros((2, 3))
    yield "columns of very different size", np.column_stack([1e12 * ones, 1e-12 * x, 1e6 * dummy(4)]), None


@pytest.mark.parametrize("coupling", [1, 2, 3])
@pytest.mark.parametrize(("A", "penalty"), [pytest.param(a, z, id=name) for name, a, z in rank_loss_cases()])
def test_exactly_the_pairs_that_lose_rank_are_undefined(A, penalty, coupling):
    rng = np.random.default_rng(0)
    labels = np.arange(12) // coupling
    n = 12 // coupling
    extra = None if penalty is None else np.asarray(penalty, dtype=float)
    problem = Problem(A, rng.normal(size=12), labels, None, extra)
    model = problem.model()
    assert model.rank == problem.rank
    sets = [{i} for i in range(n)] + [{i, (i + 3) % n} for i in range(n)]
    sets += [set(), set(range(n)), set(range(1, n))]
    scheme = mx.schemes.from_sets([sorted(s) for s in sets], n=n)
    cv = quiet(model, scheme)
    assert worst_error(problem, scheme, cv) < 1e-9
    assert np.isnan(cv.score) == (len(cv.undefined) > 0)


def test_rank_of_penalised_problems_counts_the_penalty():
    A = np.ones((3, 2))
    assert mx.LeastSquares(A, np.ones(3)).rank == 1
    assert mx.LeastSquares(A, np.ones(3), penalty=[[0.0, 1.0]]).rank == 2


def test_coefficients_of_least_norm_when_rank_is_lost():
    rng = np.random.default_rng(0)
    x = rng.normal(size=9)
    A, b = np.column_stack([x, x, np.ones(9)]), rng.normal(size=9)
    model = mx.LeastSquares(A, b)
    np.testing.assert_allclose(model.coefficients, np.linalg.pinv(A) @ b, atol=1e-12)


def lossy():
    A = np.column_stack([np.ones(6), np.arange(6.0), [0, 0, 1, 0, 0, 0], [0, 0, 0, 0, 1, 0]])
    return mx.LeastSquares(A, np.arange(6.0) ** 2)


def test_one_warning_says_how_many_and_where():
    with pytest.warns(mx.RankLossWarning) as caught:
        cv = lossy().cross_validate(loo(6))
    assert len(caught) == 1
    assert caught[0].filename == __file__
    text = str(caught[0].message)
    assert "2 of 6" in text
    assert "undefined" in text
    np.testing.assert_array_equal(cv.undefined, [2, 4])
    assert np.isnan(cv.score)
    np.testing.assert_array_equal(np.isnan(cv.residuals), np.isin(np.arange(6), [2, 4]))


def test_press_and_held_out_residuals_warn_without_naming_what_they_lack():
    model = lossy()
    for call in (lambda: model.press, lambda: model.held_out_residuals([1, 2])):
        with pytest.warns(mx.RankLossWarning) as caught:
            result = call()
        assert len(caught) == 1
        assert caught[0].filename == __file__
        assert np.isnan(result).all()
        # Neither a number nor an array has an attribute of that name.
        assert "attribute 'undefined' of the result" not in str(caught[0].message)


def test_no_score_if_an_undefined_pair_validates_nothing():
    with pytest.warns(mx.RankLossWarning):
        cv = lossy().cross_validate(mx.schemes.from_sets([[0], [2]], [[0], []], n=6))
    np.testing.assert_array_equal(cv.undefined, [1])
    assert np.isnan(cv.score)


def test_no_warning_without_rank_loss():
    model = mx.LeastSquares(np.ones((4, 1)), np.arange(4.0))
    cv = model.cross_validate(loo(4))  # warnings are errors here
    assert cv.undefined.size == 0
    assert cv.undefined.dtype == np.int64


# ------------------------------------------------------------------------------------------ the mathematics


def test_fit_by_hand():
    # Mean 3, residuals -2 -1 3, over n = 3 data.
    assert mx.LeastSquares(np.ones((3, 1)), [1.0, 2.0, 6.0]).fit_rms == pytest.approx(np.sqrt(14 / 3))
    # Two rows to a datum: E^2 divides by two data, not four rows (11).
    model = mx.LeastSquares(np.ones((4, 1)), [1.0, 2.0, 6.0, 3.0], coupling=2)
    assert model.fit_rms == pytest.approx(np.sqrt((4 + 1 + 9 + 0) / 2))


def test_press_by_hand():
    # Leave-one-out residuals of a mean are those of the fit times 3/2.
    assert mx.LeastSquares(np.ones((3, 1)), [1.0, 2.0, 6.0]).press == pytest.approx(1.5 * np.sqrt(14 / 3))
    # Row by row, over m = 4 rows, whatever the coupling (3).
    model = mx.LeastSquares(np.ones((4, 1)), [1.0, 2.0, 6.0, 3.0], coupling=2)
    assert model.press == pytest.approx(np.sqrt((4 + 1 + 9 + 0) / 4) * 4 / 3)


def test_coupled_leave_one_out_by_hand():
    # Means of the other pair: 4.5 and 1.5; residuals -3.5 -2.5 4.5 1.5, over two data (8).
    model = mx.LeastSquares(np.ones((4, 1)), [1.0, 2.0, 6.0, 3.0], coupling=2)
    cv = model.cross_validate(loo(2))
    np.testing.assert_allclose(cv.residuals, [-3.5, -2.5, 4.5, 1.5])
    assert cv.score == pytest.approx(np.sqrt((3.5**2 + 2.5**2 + 4.5**2 + 1.5**2) / 2))


@given(
    seed=st.integers(0, 1000), n=st.integers(6, 30), responses=st.sampled_from([1, 3]), weighted=st.booleans()
)
def test_press_is_leave_one_out_of_uncoupled_rows(seed, n, responses, weighted):
    problem, _ = make("random", 1, responses=responses, weighted=weighted, seed=seed, n=n)
    model = problem.model()
    cv = quiet(model, loo(n))
    e = model.residuals / (1 - model.leverage).reshape(-1, *[1] * (responses > 1))
    if not len(cv.undefined):
        assert model.press == pytest.approx(cv.score, rel=1e-12)
        np.testing.assert_allclose(cv.residuals, e, rtol=1e-7, atol=1e-9)


def test_leave_one_out_of_coupled_rows_is_groups_of_them():
    problem, _ = make("random", 3, responses=2, seed=1)
    rows = np.arange(problem.m).reshape(-1, 3)
    coupled = problem.model().cross_validate(loo(problem.n))
    grouped = mx.LeastSquares(problem.A, problem.b).cross_validate(mx.schemes.from_sets(rows))
    np.testing.assert_allclose(coupled.residuals, grouped.residuals, rtol=1e-12, atol=1e-12)
    assert coupled.score == pytest.approx(np.sqrt(3) * grouped.score)


@given(seed=st.integers(0, 1000), coupling=st.sampled_from([1, 2, "uneven"]), penalised=st.booleans())
def test_whole_weights_repeat_rows(seed, coupling, penalised):
    problem, points = make("random", coupling, responses=2, penalised=penalised, seed=seed, n=12)
    counts = np.random.default_rng(seed).integers(1, 4, 12)
    weighted = Problem(problem.A, problem.b, problem.labels, counts.astype(float), problem.penalty).model()
    copies = np.repeat(np.arange(problem.m), counts[problem.labels])
    # A datum of weight w is w equal data that are held out together: one datum of w times the rows.
    A, b, labels = (x[copies] for x in (problem.A, problem.b, problem.labels))
    repeated = Problem(A, b, labels, None, problem.penalty).model()
    np.testing.assert_allclose(weighted.coefficients, repeated.coefficients, rtol=1e-9, atol=1e-11)
    for scheme in every_scheme(points).values():
        one, two = quiet(weighted, scheme), quiet(repeated, scheme)
        np.testing.assert_array_equal(one.undefined, two.undefined)
        if not len(one.undefined):
            # Averages: the weighted score divides by the sum of the weights, the other by the number of data.
            data = np.concatenate(list(scheme.validated))
            ratio = np.sqrt(len(data) / counts[data].sum())
            assert one.score == pytest.approx(ratio * two.score, rel=1e-9)


@given(seed=st.integers(0, 1000), coupling=st.sampled_from([1, 2, "uneven"]))
def test_the_order_of_data_does_not_matter(seed, coupling):
    problem, points = make("tps", coupling, weighted=True, penalised=True, seed=seed, n=15)
    order = np.random.default_rng(seed).permutation(problem.m)
    A, b, labels = (x[order] for x in (problem.A, problem.b, problem.labels))
    one, two = problem.model(), Problem(A, b, labels, problem.weights, problem.penalty).model()
    assert one.fit_rms == pytest.approx(two.fit_rms, rel=1e-9)
    np.testing.assert_allclose(one.residuals[order], two.residuals, rtol=1e-7, atol=1e-9 * np.abs(b).max())
    for scheme in every_scheme(points).values():
        first, second = quiet(one, scheme), quiet(two, scheme)
        np.testing.assert_array_equal(first.undefined, second.undefined)
        assert first.score == pytest.approx(second.score, rel=1e-9, nan_ok=True)


@given(seed=st.integers(0, 1000), penalised=st.booleans(), exponent=st.sampled_from([3, 12, 100]))
def test_the_unit_of_a_column_does_not_matter(seed, penalised, exponent):
    problem, points = make("random", 1, penalised=penalised, seed=seed, n=15)
    scale = 10.0 ** np.random.default_rng(seed).uniform(-exponent, exponent, problem.A.shape[1])
    penalty = None if problem.penalty is None else problem.penalty * scale
    one, two = problem.model(), mx.LeastSquares(problem.A * scale, problem.b, penalty=penalty)
    assert one.rank == two.rank
    np.testing.assert_allclose(one.coefficients, two.coefficients * scale, rtol=1e-9)
    for scheme in every_scheme(points).values():
        first, second = quiet(one, scheme), quiet(two, scheme)
        np.testing.assert_array_equal(first.undefined, second.undefined)
        assert first.score == pytest.approx(second.score, rel=1e-9, nan_ok=True)


def test_penalty_rows_are_rows_that_are_never_held_out():
    problem, points = make("random", 2, responses=2, penalised=True, seed=3)
    model = problem.model()
    stacked = np.vstack([problem.A, problem.penalty])
    zeros = np.zeros((len(problem.penalty), 2))
    # The penalty rows are one more datum.
    labels = np.append(problem.labels, np.full(len(zeros), problem.n))
    other = mx.LeastSquares(stacked, np.vstack([problem.b, zeros]), labels)
    np.testing.assert_allclose(model.residuals, other.residuals[: problem.m], atol=1e-10)
    np.testing.assert_allclose(model.leverage, other.leverage[: problem.m], atol=1e-12)
    for scheme in every_scheme(points).values():
        same = mx.schemes.from_sets(scheme.held_out, scheme.validated, n=problem.n + 1)
        np.testing.assert_allclose(
            model.cross_validate(scheme).residuals, other.cross_validate(same).residuals, rtol=1e-9, atol=1e-9
        )


def test_an_empty_penalty_is_none():
    problem, _ = make("random", 1, seed=3)
    penalised = mx.LeastSquares(problem.A, problem.b, penalty=np.zeros((0, problem.A.shape[1])))
    assert penalised.press == problem.model().press


def test_several_responses_are_each_alone():
    problem, points = make("tps", 2, responses=3, weighted=True, penalised=True, seed=4)
    model = problem.model()
    rest = (problem.labels, problem.weights, problem.penalty)
    alone = [Problem(problem.A, b, *rest).model() for b in problem.b.T]
    together = np.column_stack([a.coefficients for a in alone])
    np.testing.assert_allclose(model.coefficients, together, rtol=1e-9)
    assert model.fit_rms**2 == pytest.approx(sum(a.fit_rms**2 for a in alone))
    for scheme in every_scheme(points).values():
        cv = model.cross_validate(scheme)
        parts = [a.cross_validate(scheme) for a in alone]
        assert cv.residuals.shape == (len(cv.rows), 3)
        size = np.abs(problem.b).max()
        np.testing.assert_allclose(
            cv.residuals, np.column_stack([p.residuals for p in parts]), rtol=1e-9, atol=1e-10 * size
        )
        assert cv.score**2 == pytest.approx(sum(p.score**2 for p in parts))


@pytest.mark.parametrize("penalised", [False, True])
@pytest.mark.parametrize("weighted", [False, True])
def test_hat_blocks_leverage_and_trace(weighted, penalised):
    problem, _ = make("random", "uneven", weighted=weighted, penalised=penalised, seed=6)
    model = problem.model()
    whole = problem.whole
    H = (whole @ np.linalg.pinv(whole))[: problem.m, : problem.m]
    np.testing.assert_allclose(model.leverage, np.diag(H), atol=1e-12)
    for datum, block in enumerate(model.hat_blocks()):
        rows = problem.rows([datum])
        np.testing.assert_allclose(block, H[np.ix_(rows, rows)], atol=1e-12)
    sets = mx.schemes.from_sets([[3, 0, 5], [], [1], range(problem.m)]).held_out
    for rows, block in zip(sets, model.hat_blocks(sets, threads=2), strict=True):
        np.testing.assert_allclose(block, H[np.ix_(rows, rows)], atol=1e-12)
    assert model.leverage.sum() == pytest.approx(np.trace(H))
    if not penalised:
        assert model.leverage.sum() == pytest.approx(model.rank)
    else:
        assert model.leverage.sum() < model.rank


def test_hat_blocks_of_no_sets_is_an_empty_list():
    assert mx.LeastSquares(np.ones((3, 1)), np.ones(3)).hat_blocks(mx.schemes.from_sets([]).held_out) == []


def test_trace_of_the_hat_matrix_is_the_rank_also_of_deficient_designs():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(30, 4)) @ rng.normal(size=(4, 9))
    model = mx.LeastSquares(A, rng.normal(size=30))
    assert model.rank == 4
    assert model.leverage.sum() == pytest.approx(4)


@pytest.mark.parametrize("weighted", [False, True])
def test_a_datum_validated_twice_counts_twice(weighted):
    problem, _ = make("random", "uneven", responses=2, weighted=weighted, seed=8)
    scheme = mx.schemes.from_sets([[0, 1, 2], [0, 3], [4, 5]], [[0, 1], [0], [4, 5]], n=problem.n)
    assert problem.model().cross_validate(scheme).score == pytest.approx(problem.score(scheme), rel=1e-10)


def test_what_is_not_validated_does_not_count():
    problem, _ = make("random", 1, seed=9)
    model = problem.model()
    both = model.held_out_residuals([4, 7])
    cv = model.cross_validate(mx.schemes.from_sets([[4, 7]], [[7]], n=problem.n))
    assert cv.score == pytest.approx(abs(both[1]))
    np.testing.assert_array_equal(cv.rows, [7])


def test_validating_nothing_has_no_score_and_loses_no_rank():
    model = mx.LeastSquares(np.ones((4, 1)), np.arange(4.0))
    for scheme in (mx.schemes.from_sets([], n=4), mx.schemes.from_sets([[0, 1], []], [[], []], n=4)):
        cv = model.cross_validate(scheme)
        assert np.isnan(cv.score)
        assert cv.residuals.shape == cv.rows.shape == cv.pairs.shape == cv.undefined.shape == (0,)


@given(seed=st.integers(0, 1000), order=st.permutations(range(6)), weighted=st.booleans())
def test_held_out_residuals_come_in_the_order_given(seed, order, weighted):
    problem, _ = make("random", 2, responses=2, weighted=weighted, seed=seed)
    rows = np.array([3, 10, 11, 20, 31, 40])[list(order)]
    size = np.abs(problem.b).max()
    found = problem.model().held_out_residuals(rows)
    np.testing.assert_allclose(found, problem.refit(rows), atol=1e-9 * size)


def test_interpolation_leaves_no_residual():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(30, 4))
    b = A @ rng.normal(size=4)
    assert mx.LeastSquares(A, b).cross_validate(loo(30)).score < 1e-13
    assert mx.LeastSquares(A, 0 * b).cross_validate(loo(30)).score == 0


def test_results_cannot_be_changed_by_accident():
    A, b = np.eye(4, 2) + 1, np.arange(4.0)
    model = mx.LeastSquares(A, b)
    before = model.press
    for name in ("coefficients", "residuals", "leverage"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(model, name)[0] = 7
    with pytest.raises(AttributeError):
        model.rank = 7
    A[:], b[:] = 0, 0
    assert model.press == before


@pytest.mark.parametrize("changed", ["A", "b"])
def test_a_problem_that_changes_while_its_model_is_in_use(changed):
    rng = np.random.default_rng(0)
    A = np.column_stack([np.ones(20), 1e-6 * rng.normal(size=20)])
    A[-2:, 1] = [1.0, -2.0]
    b = rng.normal(size=20)
    model = mx.LeastSquares(A, b)
    before = model.held_out_residuals([18, 19])  # so close to rank loss that the rows are read again
    array = {"A": A, "b": b}[changed]
    kept = array[3].copy()
    array[3] = np.nextafter(kept, np.inf)  # one digit is enough
    with pytest.raises(
        ValueError, match=r"^Invalid A\. It must not change .*\. Given row 3 has changed .*\.$"
    ):
        model.held_out_residuals([18, 19])
    array[3] = kept
    np.testing.assert_array_equal(model.held_out_residuals([18, 19]), before)


@pytest.mark.parametrize("duplicate", [pickle.dumps, copy.copy, copy.deepcopy])
def test_models_are_built_again_rather_than_copied(duplicate):
    with pytest.raises(
        TypeError, match=r"^Invalid model\. .* build it again from A and b\. Given LeastSquares"
    ):
        duplicate(mx.LeastSquares(np.eye(4, 2) + 1, np.arange(4.0)))


# ---------------------------------------------------------------------------------------------- bit for bit


def identical(one, two):
    assert one.score == two.score or (np.isnan(one.score) and np.isnan(two.score))
    for name in ("residuals", "rows", "pairs", "undefined"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


@pytest.mark.parametrize(("m", "p", "responses"), [(60, 5, 1), (5000, 12, 3), (4001, 30, 1)])
@pytest.mark.parametrize("deficient", [False, True])
def test_the_number_of_threads_changes_no_bit(m, p, responses, deficient):
    rng = np.random.default_rng(m)
    A = rng.normal(size=(m, p)) * 10.0 ** rng.integers(-6, 6, p)
    if deficient:
        A[:, -1] = A[:, 0]
    A[:, 1] *= rng.uniform(size=m) < 5 / m  # seen by few rows: some pairs are refitted, some undefined
    b = rng.normal(size=(m, responses))
    weights = rng.uniform(0.5, 2, m)
    sizes = rng.integers(1, 80, 150) % (m // 2) + 1
    scheme = mx.schemes.from_sets([rng.choice(m, q, replace=False) for q in sizes], n=m)
    models = [mx.LeastSquares(A, b, weights=weights, threads=threads) for threads in (1, 2, 3)]
    results = [quiet(model, scheme, threads=t) for model in models for t in (1, 2, 3)]
    for model in models[1:]:
        for name in ("coefficients", "residuals", "leverage"):
            np.testing.assert_array_equal(getattr(model, name), getattr(models[0], name))
        assert model.rank == models[0].rank
        blocks = model.hat_blocks(scheme.held_out, threads=2)
        for one, two in zip(blocks, models[0].hat_blocks(scheme.held_out, threads=1), strict=True):
            np.testing.assert_array_equal(one, two)
    for result in results[1:]:
        identical(result, results[0])


def test_one_pair_is_the_same_alone_and_among_others():
    # Work spaces are used again: what a pair leaves behind must not reach the next.
    rng = np.random.default_rng(2)
    A = rng.normal(size=(80, 6))
    A[:, 0] *= np.arange(80) < 3
    problem = Problem(A, rng.normal(size=(80, 2)), np.arange(80))
    model = problem.model()
    held = [rng.choice(80, q, replace=False) for q in rng.integers(1, 60, 60)] + [[0, 1, 2], [0, 1], [0], [5]]
    together = quiet(model, mx.schemes.from_sets(held, n=80), threads=1)
    for s, rows in enumerate(held):
        alone = quiet(model, mx.schemes.from_sets([rows], n=80), threads=1)
        among = together.residuals[together.pairs == s]
        np.testing.assert_allclose(among, alone.residuals, rtol=1e-10, atol=1e-12)
        assert (s in together.undefined) == (len(alone.undefined) == 1)


def test_rows_of_zeros_are_not_taken_for_changed_ones():
    # Close to rank loss the core goes back to A; a row of zeros has residuals of rounding alone.
    rng = np.random.default_rng(0)
    A, b = rng.normal(size=(30, 5)), 1e3 * rng.normal(size=30)
    A[0], b[0] = 0, 0
    A[:, 4] = 0
    A[10, 4] = 1
    with pytest.warns(mx.RankLossWarning):
        cv = mx.LeastSquares(A, b).cross_validate(mx.schemes.leave_one_out(30))
    assert cv.undefined.tolist() == [10]
    assert np.isfinite(np.delete(cv.residuals, 10)).all()


def test_the_old_way_to_orthonormal_designs_still_works_and_says_so():
    Q = np.full((4, 1), 0.5)
    with pytest.warns(DeprecationWarning, match="orthonormal does what LeastSquares does"):
        model = mx.LeastSquares.orthonormal(Q, np.arange(4.0), 1, np.zeros((0, 1)))
    np.testing.assert_allclose(model.coefficients, [3.0])
