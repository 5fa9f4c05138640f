"""Many problems in one call: a model of each problem alone is the oracle, itself tested against refits."""

import warnings

import numpy as np
import pytest
from refits import COUPLINGS, label_rows, predicted_exactly
from scipy.linalg import lstsq

import mexpress as mx

s = mx.schemes


def make(shapes, seed=0, *, responses=None):
    """Return problems of these numbers of rows and columns."""
    rng = np.random.default_rng(seed)
    tail = () if responses is None else (responses,)
    return [rng.normal(size=shape) for shape in shapes], [rng.normal(size=(m, *tail)) for m, _ in shapes]


def expect_alone(batch, A, b, scheme_of, coupling=1, weights=None, rtol=1e-10):
    """Compare with a model of each problem; the residuals to a part of the largest."""
    assert len(batch) == len(A)
    for i, result in enumerate(batch):
        model = mx.LeastSquares(A[i], b[i], coupling, None if weights is None else weights[i])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", mx.RankLossWarning)
            expected = model.cross_validate(scheme_of(i))
        scale = np.nanmax(np.abs(expected.residuals), initial=0)
        np.testing.assert_allclose(result.residuals, expected.residuals, rtol=0, atol=rtol * scale)
        np.testing.assert_allclose(result.score, expected.score, rtol=rtol)
        for name in ("rows", "pairs", "undefined"):
            np.testing.assert_array_equal(getattr(result, name), getattr(expected, name))
        np.testing.assert_allclose(batch.coefficients[i], model.coefficients, rtol=rtol, atol=rtol)
        np.testing.assert_allclose(batch.fit_rms[i], model.fit_rms, rtol=rtol)
        assert batch.ranks[i] == model.rank


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("responses", [None, 1, 3])
@pytest.mark.parametrize(
    "scheme", [s.leave_one_out(24), s.k_fold(24, 3, seed=1), s.leave_p_out(24, 2, 30, seed=0)]
)
def test_a_stack_is_solved_as_its_problems_alone(scheme, responses, weighted):
    A, b = make([(24, 5)] * 21, responses=responses)
    weights = np.random.default_rng(1).uniform(0.1, 9, (21, 24)) if weighted else None
    batch = mx.cross_validate_batch(np.array(A), np.array(b), scheme, weights=weights)
    assert batch.residuals.shape == (21, len(scheme.validated.indices), *b[0].shape[1:])
    assert batch.coefficients.shape == (21, 5, *b[0].shape[1:])
    assert (batch.ranks == 5).all()
    expect_alone(batch, A, b, lambda i: scheme, weights=weights)


@pytest.mark.parametrize("coupling", COUPLINGS)
def test_the_rows_of_a_datum_are_held_out_together(coupling):
    labels = label_rows(coupling, 12, np.random.default_rng(0))
    A, b = make([(len(labels), 4)] * 9, responses=2)
    weights = np.random.default_rng(1).uniform(0.1, 9, (9, 12))
    near = s.exclusion_radius(np.arange(12.0)[:, None], 1)
    batch = mx.cross_validate_batch(np.array(A), np.array(b), near, labels, weights)
    expect_alone(batch, A, b, lambda i: near, labels, weights)


@pytest.mark.parametrize(
    "scheme",
    [s.leave_one_out(14), s.k_fold(14, 3, seed=0), s.nearest(np.arange(14.0)[:, None], 3)],
    ids=["each datum", "folds", "neighbours"],
)
@pytest.mark.parametrize("spread", [0.0, 0.1], ids=["constant", "column"])
def test_a_mean_that_a_column_explains_costs_no_digit(scheme, spread):
    """Responses of a few of the problems and of their neighbours, which have none."""
    rng = np.random.default_rng(0)
    A, b = rng.normal(size=(11, 14, 3)), rng.normal(size=(11, 14, 2))
    A[..., 1] = 4 + spread * A[..., 1]
    b[::3, :, 0] += 1e8 * A[::3, :, 1]
    batch = mx.cross_validate_batch(A, b, scheme)
    expected = np.array([predicted_exactly(*each, scheme) for each in zip(A, b, strict=True)])
    np.testing.assert_allclose(batch.residuals, expected, rtol=0, atol=1e-13)
    squares = np.square(expected).sum(axis=(1, 2)) / len(scheme.validated.indices)
    np.testing.assert_allclose(batch.scores, np.sqrt(squares), rtol=1e-13)


def test_problems_of_a_list_may_differ():
    shapes = [(8 + i % 7, 1 + i % 4) for i in range(60)]
    A, b = make(shapes)
    b[5] = np.stack([b[5]] * 3, axis=1)
    batch = mx.cross_validate_batch([a.tolist() if i % 2 else a for i, a in enumerate(A)], b, s.leave_one_out)
    assert [residuals.shape[0] for residuals in batch.residuals] == [m for m, _ in shapes]
    expect_alone(batch, A, b, lambda i: s.leave_one_out(shapes[i][0]))
    rng = np.random.default_rng(2)
    weights = [rng.uniform(1, 2, m) for m, _ in shapes]
    near = [s.nearest(rng.uniform(size=(m, 2)), 2 + i % 3) for i, (m, _) in enumerate(shapes)]
    batch = mx.cross_validate_batch(A, b, near, weights=weights)
    expect_alone(batch, A, b, near.__getitem__, weights=weights)


def test_every_problem_of_a_stack_may_have_its_own_scheme():
    A, b = make([(15, 3)] * 20)
    near = [s.nearest(np.random.default_rng(i).uniform(size=(15, 2)), 2 + i % 3) for i in range(5)] * 4
    batch = mx.cross_validate_batch(np.array(A), np.array(b), near)
    assert batch.coefficients.shape == (20, 3)
    assert isinstance(batch.residuals, list)
    expect_alone(batch, A, b, near.__getitem__)


def test_a_function_makes_one_scheme_for_each_number_of_data():
    A, b = make([(12, 2), (14, 2), (12, 3)])
    asked = []

    def folds(n):
        asked.append(n)
        return s.k_fold(n, 3, seed=n)

    batch = mx.cross_validate_batch(A, b, folds)
    assert sorted(asked) == [12, 14]
    expect_alone(batch, A, b, lambda i: s.k_fold(len(b[i]), 3, seed=len(b[i])))


def spoil(A, b):
    """Make some of many problems hard: of lost rank, nearly so, with a row that alone sees a column, of any size."""
    A[1][:, 2] = A[1][:, 0] - A[1][:, 1]
    A[2][:, 2] = A[2][:, 0] + 1e-9 * A[2][:, 2]
    A[3][1:, 0] = 0
    A[4][1:, 0] *= 1e-8
    A[5] *= 10.0 ** np.array([-150, 3, 150])
    b[6] *= 0
    b[7] *= 1e250
    A[8] += 1e7
    A[9][:] = 0


def test_hard_problems_are_told_and_leave_the_others_as_they_were():
    A, b = make([(16, 3)] * 17)
    plain = mx.cross_validate_batch(np.array(A), np.array(b), s.leave_one_out)
    spoil(A, b)
    with pytest.warns(mx.RankLossWarning, match="1 of 17 problems lose rank in some pair.* the first is 3"):
        batch = mx.cross_validate_batch(np.array(A), np.array(b), s.leave_one_out)
    assert repr(batch) == "BatchCrossValidation(17 problems, 1 of them undefined)"
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(batch.scores)), [3])
    np.testing.assert_array_equal(batch.ranks[[1, 9, 10]], [2, 0, 3])
    assert batch.undefined[3] == [0]
    expect_alone(batch, A, b, lambda i: s.leave_one_out(16), rtol=1e-9)
    np.testing.assert_array_equal(batch.residuals[10:], plain.residuals[10:])


def test_graded_and_shifted_designs_are_as_exact_as_refits():
    """Columns of a polynomial in pixels: a condition beyond 1e7."""
    rng = np.random.default_rng(4)
    x = rng.uniform(0, 1000, (12, 30))
    A, b = np.stack([x**power for power in range(4)], axis=-1), rng.normal(size=(12, 30))
    batch = mx.cross_validate_batch(A, b, s.leave_one_out)
    for i in range(12):
        scales = np.linalg.norm(A[i], axis=0)
        for row in (0, 17):
            rest = np.arange(30) != row
            x = lstsq(A[i][rest] / scales, b[i][rest], lapack_driver="gelsy")[0]
            expected = b[i, row] - A[i, row] / scales @ x
            np.testing.assert_allclose(batch.residuals[i, row], expected, rtol=1e-10, atol=1e-10)


def test_no_bit_depends_on_threads_or_on_the_other_problems():
    A, b = (np.array(each) for each in make([(20, 4)] * 333))
    scheme = s.k_fold(20, 7, seed=0)
    one, three = (mx.cross_validate_batch(A, b, scheme, threads=threads) for threads in (1, 3))
    few = mx.cross_validate_batch(A[100:103], b[100:103], scheme)
    for name in ("scores", "fit_rms", "coefficients", "residuals"):
        np.testing.assert_array_equal(getattr(one, name), getattr(three, name))
        np.testing.assert_array_equal(getattr(few, name), getattr(one, name)[100:103])


def test_weights_far_apart_cost_no_digit():
    """Reflections that do not sort rows lose those of small weight."""
    A, b = (np.array(each) for each in make([(20, 2)] * 64))
    weights = np.sort(10.0 ** np.random.default_rng(6).uniform(-6, 6, (64, 20)), axis=1)
    batch = mx.cross_validate_batch(A, b, s.leave_one_out, weights=weights)
    for i in range(64):
        expected = mx.LeastSquares(A[i], b[i], 1, weights[i]).cross_validate(s.leave_one_out(20))
        np.testing.assert_allclose(batch.residuals[i], expected.residuals, rtol=1e-11)


def test_items_are_those_of_a_sequence():
    A, b = (np.array(each) for each in make([(6, 2)] * 4))
    batch = mx.cross_validate_batch(A, b, s.leave_one_out)
    assert batch[-1].score == batch.scores[3]
    assert [result.score for result in batch[1:3]] == batch.scores[1:3].tolist()
    with pytest.raises(IndexError):
        batch[4]


LISTS = make([(7, 2), (9, 2), (7, 2)])
STACK = tuple(np.array(each) for each in make([(7, 2)] * 3))


def spoiled(arrays, i, value):
    """Return copies of arrays of which an entry of the i-th is another value."""
    copies = [array.copy() for array in arrays]
    copies[i].flat[-1] = value
    return copies


@pytest.mark.parametrize(
    ("name", "where", "call"),
    [
        (
            "A",
            "problem 2",
            lambda: mx.cross_validate_batch(spoiled(STACK[0], 2, np.nan), STACK[1], s.leave_one_out),
        ),
        (
            "A",
            "problem 1",
            lambda: mx.cross_validate_batch(spoiled(LISTS[0], 1, np.inf), LISTS[1], s.leave_one_out),
        ),
        (
            "b",
            "problem 1",
            lambda: mx.cross_validate_batch(LISTS[0], spoiled(LISTS[1], 1, np.nan), s.leave_one_out),
        ),
        ("b", "1e\\+303", lambda: mx.cross_validate_batch(STACK[0], STACK[1] * 1e304, s.leave_one_out)),
        ("b", "problem 1", lambda: mx.cross_validate_batch(LISTS[0], [LISTS[1][0]] * 3, s.leave_one_out)),
        ("b", "2 items", lambda: mx.cross_validate_batch(LISTS[0], LISTS[1][:2], s.leave_one_out)),
        ("b", "shape", lambda: mx.cross_validate_batch(STACK[0], STACK[1][:2], s.leave_one_out)),
        ("A", "shape", lambda: mx.cross_validate_batch(STACK[0][0], STACK[1], s.leave_one_out)),
        (
            "A",
            "shape",
            lambda: mx.cross_validate_batch(np.zeros((0, 3, 2)), np.zeros((0, 3)), s.leave_one_out),
        ),
        ("A", "none", lambda: mx.cross_validate_batch([], [], s.leave_one_out)),
        ("A", "3", lambda: mx.cross_validate_batch(3, STACK[1], s.leave_one_out)),
        ("A", "'no'", lambda: mx.cross_validate_batch("no", STACK[1], s.leave_one_out)),
        ("A", "problem 1", lambda: mx.cross_validate_batch([[[1.0]], "x"], [[1.0], [2.0]], s.leave_one_out)),
        ("scheme", "problem 1", lambda: mx.cross_validate_batch(*LISTS, s.leave_one_out(7))),
        ("scheme", "2 items", lambda: mx.cross_validate_batch(*STACK, [s.leave_one_out(7)] * 2)),
        ("scheme", "None", lambda: mx.cross_validate_batch(*STACK, lambda n: None)),
        ("scheme", "'loo'", lambda: mx.cross_validate_batch(*STACK, "loo")),
        ("scheme", "4", lambda: mx.cross_validate_batch(*STACK, 4)),
        ("coupling", "7", lambda: mx.cross_validate_batch(*STACK, s.leave_one_out, 2)),
        (
            "weights",
            "problem 0",
            lambda: mx.cross_validate_batch(*STACK, s.leave_one_out, 1, np.eye(7)[:3] - 0.5),
        ),
        ("weights", "shape", lambda: mx.cross_validate_batch(*STACK, s.leave_one_out, 1, np.ones(6))),
        (
            "weights",
            "problem 1",
            lambda: mx.cross_validate_batch(*LISTS, s.leave_one_out, 1, [np.ones(7)] * 3),
        ),
        ("weights", "2 items", lambda: mx.cross_validate_batch(*LISTS, s.leave_one_out, 1, [np.ones(7)] * 2)),
        ("threads", "0", lambda: mx.cross_validate_batch(*STACK, s.leave_one_out, threads=0)),
    ],
)
def test_what_is_wrong_is_told_with_the_problem(name, where, call):
    with pytest.raises((ValueError, TypeError), match=rf"^Invalid {name}\. .*{where}"):
        call()


def test_weights_of_one_problem_may_be_those_of_all():
    shares = np.linspace(1, 2, 7)
    batch = mx.cross_validate_batch(*STACK, s.leave_one_out, weights=shares)
    expect_alone(batch, *STACK, lambda i: s.leave_one_out(7), weights=[shares] * 3)


@pytest.mark.parametrize(
    "form", [np.float32, np.asfortranarray, lambda a: a[:, ::1][::1], lambda a: a.tolist()]
)
def test_the_form_of_arrays_does_not_matter(form):
    A, b = (np.round(100 * each) for each in STACK)
    expected = mx.cross_validate_batch(A, b, s.leave_one_out)
    given = mx.cross_validate_batch(form(A), form(b), s.leave_one_out)
    np.testing.assert_array_equal(given.scores, expected.scores)
    read_only = A.copy()
    read_only.flags.writeable = False
    np.testing.assert_array_equal(
        mx.cross_validate_batch(read_only, b, s.leave_one_out).scores, expected.scores
    )
    listed = mx.cross_validate_batch(list(read_only), list(b), s.leave_one_out)
    np.testing.assert_array_equal(listed.scores, expected.scores)
