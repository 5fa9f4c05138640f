"""Problems at the edge of what doubles hold: the right answer is that of rational numbers, or a plain refit's."""

import math
import warnings
from fractions import Fraction

import numpy as np
import pytest
from designs import surface_design, warp_design
from inputs import in_form
from refits import Problem, pairs

import mexpress as mx
from mexpress.liftings import lifting_named
from mexpress.placement import covered_region

loo = mx.schemes.leave_one_out


# ------------------------------------------------------------------------------------------ refits without rounding


def rational(x):
    """Return the numbers as they are, as fractions."""
    return np.array([Fraction(v) for v in np.ravel(x).tolist()], dtype=object).reshape(np.shape(x))


def eliminate(G, C):
    """Return a solution of G x = C, unknowns that are free being zero, and the rank of G."""
    M, pivots, p = np.hstack([G, C]), [], len(G)
    for j in range(p):
        k = len(pivots)
        row = next((i for i in range(k, p) if M[i, j]), None)
        if row is None:
            continue
        M[[k, row]] = M[[row, k]]
        M[k] = M[k] / M[k, j]
        for i in range(p):
            if i != k and M[i, j]:
                M[i] = M[i] - M[i, j] * M[k]
        pivots.append(j)
    x = np.full(C.shape, Fraction(0))
    x[pivots] = M[: len(pivots), p:]
    return x, len(pivots)


class Exact:
    """A problem of few rows and columns, refitted in rational numbers."""

    def __init__(self, problem: Problem):
        self.problem = problem
        self.A, self.w = rational(problem.A), rational(problem.row_weights)
        self.b = rational(problem.b.reshape(problem.m, -1))
        Z = rational(np.zeros((0, problem.A.shape[1])) if problem.penalty is None else problem.penalty)
        self.energy = Z.T @ Z
        self.rank = self._fit(np.arange(problem.m), self.A.T)[1]

    def _fit(self, kept, right):
        A = self.A[kept]
        return eliminate(A.T @ (self.w[kept, None] * A) + self.energy, right)

    def _without(self, held, right):
        """Solve with the rows that are left; None if their rank is lower."""
        x, rank = self._fit(np.setdiff1d(np.arange(self.problem.m), held), right)
        return x if rank == self.rank else None

    def refit(self, held):
        """Return b - A x of the held-out rows, x fitted without them; None if rank is lost."""
        kept = np.setdiff1d(np.arange(self.problem.m), held)
        x = self._without(held, self.A[kept].T @ (self.w[kept, None] * self.b[kept]))
        if x is None:
            return None
        return (self.b[held] - self.A[held] @ x).astype(float).reshape(len(held), *self.problem.b.shape[1:])

    def spread(self, held, kept):
        """Return I + X_T (X_t^T X_t)^-1 X_T^T of validated rows T and training rows t; None if rank is lost."""
        x = self._without(held, self.A[kept].T)
        roots = np.sqrt(self.problem.row_weights[kept])
        if x is None:
            return None
        return np.eye(len(kept)) + np.outer(roots, roots) * (self.A[kept] @ x).astype(float)

    def score(self, scheme):
        """Return P; NaN if a pair loses rank."""
        total = weight = 0.0
        for held, validated in pairs(scheme):
            rows, kept = self.problem.rows(held), self.problem.rows(validated)
            e = self.refit(rows)
            if e is None:
                return math.nan
            e = e[np.isin(rows, kept)].reshape(len(kept), -1)
            total += float(self.problem.row_weights[np.sort(kept)] @ (e**2).sum(axis=1)) if len(kept) else 0
            weight += sum(self.problem.row_weights[self.problem.labels == d][0] for d in validated)
        return math.sqrt(total / weight)


def quiet(call, *given):
    """Call where rank may be lost."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mx.RankLossWarning)
        return call(*given)


def press(model):
    return model.press


def nested(problem, scheme):
    """Cross-validate every leading block of columns."""
    sizes = range(1, problem.A.shape[1] + 1)
    given = {"weights": problem.weights, "penalty": problem.penalty}
    return mx.cross_validate_nested(problem.A, problem.b, sizes, {"": scheme}, problem.labels, **given)[""]


def check(problem, scheme, within=1e-9):
    """Predictions, spreads, undefined pairs, PRESS and rank are those of rational numbers."""
    exact, model = Exact(problem), problem.model()
    assert model.rank == exact.rank
    cv, spreads = quiet(model.cross_validate, scheme), model.prediction_spread(scheme)
    lost, size = [], np.abs(problem.b).max()
    for s, (held, validated) in enumerate(pairs(scheme)):
        rows, kept = problem.rows(held), problem.rows(validated)
        got, expected = cv.residuals[cv.pairs == s], exact.refit(rows)
        if expected is None:
            lost.append(s)
            assert np.isnan(got).all()
            assert np.isnan(spreads[s]).all()
            continue
        scale = max(size, np.abs(expected).max())
        np.testing.assert_allclose(got, expected[np.isin(rows, kept)], rtol=0, atol=within * scale)
        spread = exact.spread(rows, kept)
        np.testing.assert_allclose(spreads[s], spread, rtol=0, atol=within * np.abs(spread).max())
    assert cv.undefined.tolist() == lost
    determined = all(exact.refit(np.array([row])) is not None for row in range(problem.m))
    assert np.isfinite(quiet(press, model)) == determined


# ------------------------------------------------------------------------------- data that nobody has changed


def light(rng, n):
    """Return weights of which about half are too light to be seen beside the others."""
    return np.where(rng.random(n) < 0.5, 1, 1e-11)


def graded(seed):
    """Return a problem with rows of any size and weight: some are lost in the rounding of others."""
    rng = np.random.default_rng(seed)
    weights = light(rng, 12)
    A = rng.normal(size=(12, 3)) * 10.0 ** rng.uniform(-12, 12, (12, 1))
    return Problem(A, rng.normal(size=12), np.arange(12), weights)


def lonely(unit):
    """Return a problem in which each unknown is seen by one row alone, beside rows of zeros."""
    return Problem(
        unit * np.eye(12, 4), np.random.default_rng(0).normal(size=12) / np.sqrt(unit), np.arange(12)
    )


UNCHANGED = {
    **{f"graded rows {seed}": graded(seed) for seed in (224, 255, 271, 285, 296)},
    **{f"lonely rows {unit:g}": lonely(unit) for unit in (1e-200, 1.0, 1e300)},
}


@pytest.mark.parametrize("scheme", [loo(12), mx.schemes.k_fold(12, 4, seed=0)], ids=["each", "folds"])
@pytest.mark.parametrize("name", UNCHANGED)
def test_nobody_is_accused_of_having_changed_data(name, scheme):
    problem = UNCHANGED[name]
    cv = quiet(problem.model().cross_validate, scheme)
    lost = [s for s, held in enumerate(scheme.held_out) if problem.loses_rank(held)]
    assert cv.undefined.tolist() == lost
    assert np.isnan(nested(problem, scheme)[-1]) == np.isnan(cv.score) == bool(lost)


# ------------------------------------------------------------------------------------------- spreads near rank loss


@pytest.mark.parametrize("weighted", [False, True], ids=["", "weights"])
@pytest.mark.parametrize("distance", 10.0 ** -np.arange(1, 8))
def test_spreads_close_to_rank_loss(distance, weighted):
    # Without the last two rows, the second column is seen at `distance` of its length alone.
    rng = np.random.default_rng(0)
    A = np.column_stack([np.ones(20), distance * rng.normal(size=20)])
    A[-2:, 1] = [1.0, -2.0]
    weights = rng.uniform(0.1, 10, 20) if weighted else None
    held = [[18, 19], [3, 18, 19], [2, 3, 4, 18, 19]]
    check(Problem(A, rng.normal(size=20), np.arange(20), weights), mx.schemes.from_sets(held, n=20))


@pytest.mark.parametrize("size", [1e-8, 1.0, 1e8])
@pytest.mark.parametrize("seed", range(5))
def test_spreads_are_undefined_where_predictions_are(seed, size):
    # Rows of three kinds for four unknowns: a pair that holds out one kind has lost rank, up to rounding.
    rng = np.random.default_rng(seed)
    problem = Problem(
        np.repeat(size * rng.normal(size=(3, 4)), 4, axis=0), rng.normal(size=12), np.arange(12)
    )
    check(problem, mx.schemes.from_sets([range(4), range(8), [0, 4], range(3), range(2, 7)], n=12))


# ------------------------------------------------------------------------------------------ designs that lack rank


def with_zero_rows(rng):
    A = rng.normal(size=(12, 4))
    A[rng.random(12) < 0.6] = 0
    return A


def with_repeated_columns(rng):
    A = rng.normal(size=(12, 4))
    A[:, 1], A[:, 2] = 0, 2 * A[:, 0]
    A[5, 1] = 1
    return A


def with_combinations(rng):
    A = rng.integers(-3, 4, (12, 4)).astype(float)
    A[:, 3] = A[:, 0] + A[:, 1]
    return A


@pytest.mark.parametrize(
    ("design", "seed"),
    [
        *((with_zero_rows, seed) for seed in (2, 3, 57, 116, 117)),
        *((with_repeated_columns, seed) for seed in (2, 3, 5)),
        *((with_combinations, seed) for seed in (27, 32, 117)),
    ],
)
def test_pairs_of_designs_that_lack_rank_or_nearly_do(design, seed):
    rng = np.random.default_rng(seed)
    problem = Problem(design(rng), rng.normal(size=12), np.arange(12))
    check(problem, loo(12))
    check(problem, mx.schemes.from_sets([[0], [1, 2], range(8), range(9), range(10), range(2, 12)], n=12))


def test_two_rows_that_are_not_zero_have_rank_two():
    A = np.zeros((15, 5))
    A[6] = [-2.949e-08, 1.578e-13, -1.958e13, -1.493e-10, 3.734e-06]
    A[10] = [3.341e-08, -1.9e-13, -1.669e13, 1.285e-09, -4.072e-05]
    b = np.random.default_rng(0).normal(size=15)
    weights = np.array([1, 1, 1e-11, 1e-11, 1])
    problem = Problem(A, b, np.repeat(np.arange(5), 3), weights)
    assert problem.model().rank == 2
    check(problem, loo(5))


@pytest.mark.parametrize("seed", [3, 4, 5, 50, 104, 107])
def test_two_rows_of_columns_of_any_size(seed):
    rng = np.random.default_rng(seed)
    A = np.zeros((15, 5))
    A[6] = rng.normal(size=5) * 10.0 ** rng.uniform(-12, 12, 5)
    A[10] = rng.normal(size=5) * np.abs(A[6])
    weights = np.array([1, 1, 1e-11, 1e-11, 1])
    check(Problem(A, rng.normal(size=15), np.repeat(np.arange(5), 3), weights), loo(5))


# ----------------------------------------------------------------------------------------- light rows and graded ones


@pytest.mark.parametrize("seed", range(1, 11))
def test_one_column_of_light_rows_with_the_heavy_ones_held_out(seed):
    rng = np.random.default_rng(seed)
    heavy = rng.choice(12, 3, replace=False)
    weights = np.full(12, 1e-11)
    weights[heavy] = 1
    problem = Problem(rng.normal(size=(12, 1)), rng.normal(size=12), np.arange(12), weights)
    scheme = mx.schemes.from_sets([heavy], n=12)
    np.testing.assert_allclose(nested(problem, scheme), Exact(problem).score(scheme), rtol=1e-8)
    check(problem, scheme)


@pytest.mark.parametrize("seed", [7, 29, 40, 41, 50, 52, 59])
def test_one_graded_column_with_a_penalty(seed):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(12, 1)) * 10.0 ** rng.uniform(-6, 6, (12, 1))
    penalty = np.array([[10.0 ** rng.uniform(-3, 3)]])
    for weights in (None, light(rng, 12)):
        problem = Problem(A, rng.normal(size=12), np.arange(12), weights, penalty)
        check(problem, loo(12))
        np.testing.assert_allclose(nested(problem, loo(12)), Exact(problem).score(loo(12)), rtol=1e-8)


# ----------------------------------------------------------------------------------------------- dependent columns


def dependent(rng, rows, columns, distance=0.0):
    """Return a problem of whole numbers, one of whose columns is the sum of two others, but for a distance."""
    A = rng.integers(-3, 4, (rows, columns)).astype(float)
    A[:, -1] = A[:, 0] + A[:, 1] + distance * rng.normal(size=rows)
    return Problem(A[:, rng.permutation(columns)], rng.normal(size=rows), np.arange(rows))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("distance", [0, 1e-1, 1e-2, 1e-3])
def test_sums_of_other_columns(distance, seed):
    rng = np.random.default_rng(seed)
    problem = dependent(rng, 12, 4, distance)
    held = [rng.choice(12, count, replace=False) for count in (1, 3, 6, 8)]
    check(problem, mx.schemes.from_sets(held, n=12))


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("distance", [1e-6, 1e-9])
def test_near_sums_of_other_columns_are_as_good_as_a_plain_refit(distance, seed):
    # It loses digits itself, to the square of the conditioning; how many is chance.
    rng = np.random.default_rng(seed)
    problem = dependent(rng, 12, 4, distance)
    exact, model = Exact(problem), problem.model()
    assert model.rank == exact.rank == 4
    for count in (1, 3, 6):
        held = np.sort(rng.choice(12, count, replace=False))
        expected = exact.refit(held)
        theirs = np.abs(problem.refit(held) - expected).max()
        ours = np.abs(model.held_out_residuals(held) - expected).max()
        assert ours < max(1e-9 * np.abs(expected).max(), 1000 * theirs)


# ------------------------------------------------------------------------------------- liftings with little smoothing

WEIGHT = 1e-7


def scattered(seed):
    """Return 20 points in an image, and where they move to."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 1, (20, 2)) * [640, 480]
    return points, points + 20 * np.sin(points[:, ::-1] / 90) + rng.normal(size=points.shape)


@pytest.mark.parametrize("kind", ["surface", "warp", "fractional"])
@pytest.mark.parametrize("lifting", ["affine", "bspline"])
@pytest.mark.parametrize("seed", [4, 5, 11])
def test_scores_of_smoothed_liftings_are_those_of_refits(lifting, kind, seed):
    # Some functions are seen by few points: without those, the smoothing alone determines their values.
    points, target = scattered(seed)
    values, fractional = target[:, 0], kind == "fractional"
    options = {"criteria": ["CMPRESS", "KF03"], "lifting": lifting, "smoothing": WEIGHT}
    if kind == "surface":
        selection = mx.select_surface(points, values, "FIT", max_count=9, **options)
    else:
        selection = mx.select_warp(points, target, "FIT", counts=[4, 9], fractional=fractional, **options)
    functions, compared = lifting_named(lifting), 0
    for k, count in enumerate(selection.counts.tolist()):
        basis = functions(functions.place(covered_region(points), count))
        if kind == "surface":
            design = surface_design(basis, points, values)
        else:
            design = warp_design(basis, points, target, fractional)
        labels = np.repeat(np.arange(20), design.coupling)
        problem = Problem(design.A, design.b, labels, penalty=math.sqrt(WEIGHT) * design.bending())
        for name, scheme in {"CMPRESS": loo(20), "KF03": mx.schemes.k_fold(20, 3, 0)}.items():
            lost = any(problem.loses_rank(problem.rows(held)) for held in scheme.held_out)
            expected = math.nan if lost else problem.score(scheme)
            compared += not lost
            assert selection.maps[name][k, 0] == pytest.approx(expected, rel=1e-8, nan_ok=True), (name, count)
    assert compared


# -------------------------------------------------------------------------------------------- huge and tiny numbers

POINTS, TARGET = scattered(0)
VALUES = np.sin(POINTS[:, 0] / 90) + 0.01 * np.random.default_rng(1).normal(size=20)
VALUES[3] += 5


def surface(values=VALUES, points=POINTS, **options):
    return mx.select_surface(points, values, "CMPRESS", max_count=5, **options)


SIZES = [1e-300, 1e-150, 1e150, 1e300]


@pytest.mark.parametrize(
    "options",
    [{"smoothing": 0}, {}, {"robust": True}, {"lifting": "bspline", "smoothing": "auto"}],
    ids=["plain", "auto", "robust", "bspline"],
)
@pytest.mark.parametrize("size", SIZES)
def test_the_size_of_values_does_not_change_their_score(size, options):
    assert surface(size * VALUES, **options).score / size == pytest.approx(surface(**options).score, rel=1e-9)


def with_an_error():
    """Return 40 points and their depths, of which the fourth is wrong."""
    rng = np.random.default_rng(0)
    places = rng.uniform(0, 100, (40, 2))
    values = places.sum(axis=1) + 0.1 * rng.normal(size=40)
    values[3] += 50
    return places, values


@pytest.mark.parametrize("size", SIZES)
def test_the_size_of_values_changes_no_suspect(size):
    places, values = with_an_error()
    one, other = (surface(v, places, smoothing=0).suspects() for v in (values, size * values))
    assert np.nanargmax(one.scores) == 3
    np.testing.assert_allclose(other.scores, one.scores, rtol=1e-8)
    assert surface(size * values, places, robust=True).left_out.tolist() == [3]


@pytest.mark.parametrize("size", SIZES)
def test_the_size_of_values_is_that_of_the_error_to_expect(size):
    places, values = with_an_error()
    queries = np.array([*places[:3], [200.0, 300.0]])  # the last one is far outside
    one, other = (surface(v, places).surface.error(queries) for v in (values, size * values))
    assert one[3] > one[0] > 1
    np.testing.assert_allclose(other / size, one, rtol=1e-8)


@pytest.mark.parametrize("options", [{}, {"smoothing": 0}], ids=["auto", "plain"])
@pytest.mark.parametrize("size", SIZES)
def test_the_size_of_values_changes_no_note(size, options):
    places, values = with_an_error()
    one, other = (surface(v, places, **options).notes for v in (values, size * values))
    assert any("looks like wrong data" in note for note in one)
    assert [note[-40:] for note in other] == [note[-40:] for note in one]


def test_the_error_to_expect_may_be_more_than_a_number_holds():
    places, values = with_an_error()
    assert surface(1e300 * values, places).surface.error([[1e90, 0.0]]) == np.inf


@pytest.mark.parametrize("lifting", ["tps", "affine", "bspline"])
def test_a_slope_may_be_more_than_a_number_holds(lifting):
    places = 1e-100 * POINTS
    slopes = surface(1e250 * VALUES, places, lifting=lifting).surface.derivatives(places[:3])
    assert not np.isfinite(slopes).any()


def test_a_score_may_be_more_than_a_number_holds():
    # Without the first row predictions are 1e12 times as large as the responses.
    A, b = np.array([[1.0], [1e-12], [2e-12], [-1e-12]]), np.array([1e300, 1e300, -2e300, 1e300])
    assert mx.LeastSquares(A, b).cross_validate(loo(4)).score == np.inf
    assert mx.cross_validate_nested(A, b, [1], {"": loo(4)})[""] == np.inf


def test_values_whose_model_would_overflow_are_refused():
    with pytest.raises(ValueError, match=r"^Invalid values\. The parameters of its model") as caught:
        surface(1e302 * VALUES, lifting="bspline", smoothing=[1e-30])
    in_form(caught.value)


@pytest.mark.parametrize("lifting", ["tps", "affine", "bspline"])
def test_huge_smoothing_leaves_a_plane(lifting):
    plane = Problem(np.column_stack([np.ones(20), POINTS / 640]), VALUES, np.arange(20))
    found = surface(lifting=lifting, smoothing=1e300)
    assert found.score == pytest.approx(plane.score(loo(20)), rel=1e-9)


RATIOS = {
    "surface": lambda size: surface(points=size * POINTS).score / surface().score,
    "source": lambda size: warp(size * POINTS, TARGET).score / warp().score,
    "target": lambda size: warp(POINTS, size * TARGET).score / size / warp().score,
    "both": lambda size: warp(size * POINTS, size * TARGET).score / size / warp().score,
}


def warp(source=POINTS, target=TARGET):
    return mx.select_warp(source, target, "CMPRESS", counts=[3, 5])


@pytest.mark.parametrize("name", RATIOS)
@pytest.mark.parametrize("size", [1e-150, 1e-90, 1e90])
def test_points_of_any_size_have_their_score(name, size):
    assert RATIOS[name](size) == pytest.approx(1, rel=1e-8)


@pytest.mark.parametrize("name", RATIOS)
def test_points_that_are_too_close_are_refused(name):
    with pytest.raises(ValueError, match="must extend over 1e-150 at least") as caught:
        RATIOS[name](1e-160)
    in_form(caught.value)


@pytest.mark.parametrize("fit", [mx.fit_surface, mx.fit_warp])
@pytest.mark.parametrize("size", [1e-160, 1e-310])
def test_control_points_that_are_too_close_are_refused(fit, size):
    with pytest.raises(ValueError, match=r"^Invalid control_points\. They must extend over 1e-150") as caught:
        fit(POINTS, TARGET, size * POINTS[:5])
    in_form(caught.value)


def test_an_image_that_is_a_speck_has_radii():
    selection = mx.select_warp(POINTS, TARGET, "CMPRESS", image_size=(1e-308, 1e-308))
    curve = selection.radii([0])
    assert curve.scores[0] == pytest.approx(selection.score, rel=1e-9)
    assert np.isinf(curve.reach).all()


@pytest.mark.parametrize("name", RATIOS)
def test_points_that_are_too_large_are_refused(name):
    with pytest.raises(ValueError, match=r"must not exceed 1e\+100") as caught:
        RATIOS[name](1e150)
    in_form(caught.value)


def test_one_datum_that_is_not_zero_is_the_suspect():
    places = np.random.default_rng(0).uniform(0, 100, (40, 2))
    values = (np.arange(40) == 5).astype(float)
    scores = surface(values, places, smoothing=1e300).suspects().scores
    assert np.nanargmax(scores) == 5
