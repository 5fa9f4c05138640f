"""What the library replaces: refits without the held-out rows, by lstsq or in extended precision."""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.linalg import solve_triangular

import mexpress as mx

Array = NDArray[np.float64]

COUPLINGS = [1, 2, 3, "uneven"]
FAMILIES = ["random", "tps", "spline"]

needs_longdouble = pytest.mark.skipif(
    np.finfo(np.longdouble).eps > 1e-18, reason="numpy's longdouble is no wider than a double here"
)


@dataclass(frozen=True, eq=False)
class Problem:
    """A least-squares problem with rows grouped into data."""

    A: Array
    b: Array
    labels: NDArray[np.int64]
    weights: Array | None = None
    penalty: Array | None = None

    @property
    def m(self) -> int:
        """Number of rows."""
        return len(self.A)

    @property
    def n(self) -> int:
        """Number of data."""
        return int(self.labels.max()) + 1

    @property
    def row_weights(self) -> Array:
        """Weight of every row."""
        return np.ones(self.m) if self.weights is None else self.weights[self.labels]

    def model(self, **options) -> mx.LeastSquares:
        """Return what is tested."""
        return mx.LeastSquares(self.A, self.b, self.labels, self.weights, self.penalty, **options)

    def rows(self, data) -> NDArray[np.int64]:
        """List rows of data, datum after datum as the library does."""
        parts = [np.flatnonzero(self.labels == d) for d in sorted(data)]
        return np.concatenate([np.zeros(0, dtype=np.int64), *parts])

    @cached_property
    def whole(self) -> Array:
        """Weighted design over the penalty rows, columns at unit length."""
        extra = np.zeros((0, self.A.shape[1])) if self.penalty is None else self.penalty
        whole = np.vstack([self.A * np.sqrt(self.row_weights)[:, None], extra])
        largest = np.abs(whole).max(axis=0)
        whole = whole / np.where(largest > 0, largest, 1)
        norms = np.linalg.norm(whole, axis=0)
        return whole / np.where(norms > 0, norms, 1)

    @cached_property
    def rank(self) -> int:
        """Rank, columns at unit length."""
        return int(np.linalg.matrix_rank(self.whole))

    def _training(self, held) -> NDArray[np.bool_]:
        kept = np.ones(len(self.whole), dtype=bool)
        kept[held] = False
        return kept

    def loses_rank(self, held) -> bool:
        """Tell whether the rows that are left have lower rank; columns scaled as those of all rows."""
        training = self.whole[self._training(held)]
        return (np.linalg.matrix_rank(training) if len(training) else 0) < self.rank

    def refit(self, held, wide: bool = False) -> Array:
        """Return b - A x of the held-out rows, x fitted without them."""
        roots = np.sqrt(self.row_weights)
        b = self.b.reshape(self.m, -1) * roots[:, None]
        whole = np.vstack([b, np.zeros((len(self.whole) - self.m, b.shape[1]))])
        kept = self._training(held)
        solve = lstsq_wide if wide else lambda a, c: np.linalg.lstsq(a, c, rcond=None)[0]
        x = solve(self.whole[kept], whole[kept]) if kept.any() else np.zeros((self.A.shape[1], b.shape[1]))
        found = (b[held] - self.whole[held] @ x) / roots[held, None]
        return np.asarray(found, dtype=np.float64).reshape(len(held), *self.b.shape[1:])

    def score(self, scheme) -> float:
        """Return P by refits: a datum's weight counts once each time it is validated."""
        total = weight = 0.0
        for held, validated in pairs(scheme):
            rows = self.rows(held)
            kept = np.isin(rows, self.rows(validated))
            e = self.refit(rows)[kept].reshape(kept.sum(), -1)
            total += float((self.row_weights[rows[kept]] * (e**2).sum(axis=1)).sum())
            weight += sum(self.row_weights[self.labels == d][0] for d in validated)
        return float(np.sqrt(total / weight))

    def leading(self, size: int) -> "Problem":
        """Return the problem of the first columns."""
        penalty = None if self.penalty is None else self.penalty[:, :size]
        return Problem(self.A[:, :size], self.b, self.labels, self.weights, penalty)

    def curve(self, sizes, scheme) -> Array:
        """Return P of every leading model by refits; NaN where a pair loses rank or nothing is validated."""
        models = [self.leading(size) for size in sizes]
        total, weight = np.zeros(len(models)), 0.0
        for held, validated in pairs(scheme):
            rows, kept = self.rows(held), self.rows(validated)
            total += [model.squares(rows, kept) for model in models]
            weight += (np.ones(self.n) if self.weights is None else self.weights)[validated].sum()
        return np.sqrt(total / weight) if weight else np.full(len(models), np.nan)

    def squares(self, held, kept) -> float:
        """Return the weighted sum of squared errors of some held-out rows; NaN if the other rows lose rank."""
        if self.loses_rank(held):
            return np.nan
        scored = np.isin(held, kept)
        e = self.refit(held)[scored]
        return float((self.row_weights[held[scored]] @ e**2).sum())


def pairs(scheme) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    return zip(scheme.held_out, scheme.validated, strict=True)


def lstsq_wide(A, b):
    """Householder least squares in numpy's widest floats; A has full column rank and scaled columns."""
    a, c = np.array(A, dtype=np.longdouble), np.array(b, dtype=np.longdouble)
    p = a.shape[1]
    for j in range(p):
        v = a[j:, j].copy()
        v[0] += np.copysign(np.sqrt((v * v).sum()), v[0])
        v /= np.sqrt((v * v).sum())
        a[j:, j:] -= 2 * np.outer(v, v @ a[j:, j:])
        c[j:] -= 2 * np.outer(v, v @ c[j:])
    x = np.zeros((p, c.shape[1]), dtype=np.longdouble)
    for j in reversed(range(p)):
        x[j] = (c[j] - a[j, j + 1 : p] @ x[j + 1 :]) / a[j, j]
    return x


def predicted_exactly(A, b, scheme) -> Array:
    """Prediction residuals of few rows and columns, (t, r), pair after pair: normal equations in fractions."""
    m, p = A.shape
    rows = [[Fraction(x) for x in row] for row in np.column_stack([A, b]).tolist()]
    width, found = len(rows[0]), []
    for held, validated in pairs(scheme):
        kept = [rows[i] for i in range(m) if i not in held]
        system = [[sum(row[j] * row[k] for row in kept) for k in range(width)] for j in range(p)]
        for j in range(p):
            system[j] = [x / system[j][j] for x in system[j]]
            for k in set(range(p)) - {j}:
                system[k] = [x - system[k][j] * y for x, y in zip(system[k], system[j], strict=True)]
        for i in validated:
            fit = [sum(rows[i][j] * system[j][k] for j in range(p)) for k in range(p, width)]
            found.append([float(y - x) for x, y in zip(fit, rows[i][p:], strict=True)])
    return np.array(found)


def nested_refit(A, b, rows) -> Array:
    """Predict rows (q, p) by each leading block of columns of A, (p, q, r): one QR of A, of full column rank."""
    scale = np.linalg.norm(A, axis=0)
    Q, R = np.linalg.qr(A / scale)
    u = solve_triangular(R, (rows / scale).T, trans="T")
    return np.cumsum(u[:, :, None] * (Q.T @ b)[:, None], axis=0)


def nested_refit_wide(A, b, rows) -> Array:
    """Do the same by Gram-Schmidt, each column twice, in numpy's widest floats."""
    Q, b, u = (np.array(x, dtype=np.longdouble) for x in (A, b, rows))
    for j in range(Q.shape[1]):
        for _ in range(2):
            shares = Q[:, :j].T @ Q[:, j]
            Q[:, j] -= Q[:, :j] @ shares
            u[:, j] -= u[:, :j] @ shares
        length = np.sqrt((Q[:, j] ** 2).sum())
        Q[:, j] /= length
        u[:, j] /= length
    return np.cumsum(u.T[:, :, None] * (Q.T @ b)[:, None], axis=0).astype(np.float64)


def worst_error(problem: Problem, scheme, cv, wide: bool = False) -> float:
    """Return the largest difference from a refit, relative to the pair's residuals or the responses.

    Also asserts that rows, pairs and undefined are what the scheme says.
    """
    worst, at = 0.0, 0
    lost = []
    size = np.abs(problem.b).max()
    for s, (held, validated) in enumerate(pairs(scheme)):
        rows, kept = problem.rows(held), problem.rows(validated)
        got = cv.residuals[at : at + len(kept)]
        np.testing.assert_array_equal(cv.rows[at : at + len(kept)], kept)
        np.testing.assert_array_equal(cv.pairs[at : at + len(kept)], s)
        at += len(kept)
        if problem.loses_rank(rows):
            lost.append(s)
            assert np.isnan(got).all(), f"pair {s} has lost rank"
            continue
        assert np.isfinite(got).all(), f"pair {s} has not lost rank"
        if len(kept):
            order = np.argsort(rows)
            expected = problem.refit(rows, wide)[order[np.searchsorted(rows, kept, sorter=order)]]
            worst = max(worst, np.abs(got - expected).max() / max(np.abs(expected).max(), size))
    assert at == len(cv.residuals)
    np.testing.assert_array_equal(cv.undefined, lost)
    return float(worst)


def label_rows(coupling, n: int, rng) -> NDArray[np.int64]:
    """Name the datum of each row; uneven: one to four rows each, shuffled."""
    if coupling == "uneven":
        labels = np.repeat(np.arange(n), rng.integers(1, 5, n))
        return rng.permutation(labels)
    return np.repeat(np.arange(n), coupling)


def thin_plate(points: Array, control_points: Array) -> Array:
    """Return [r^2 log r, 1, x, y] in the unit of the points, pixels say."""
    r = np.linalg.norm(points[:, None] - control_points, axis=2)
    kernel = r**2 * np.log(np.where(r > 0, r, 1))
    return np.column_stack([kernel, np.ones(len(points)), points])


def nested_thin_plate(points: Array, control_points: Array) -> Array:
    """Return the thin-plate splines whose first l columns are those of the first l control points."""
    corners = np.vstack([control_points[:3].T, np.ones(3)])
    weights = lambda x: np.linalg.solve(corners, np.vstack([x.T, np.ones(len(x))])).T  # noqa: E731
    size = np.abs(points).max()
    kernel = thin_plate(points / size, control_points / size)[:, : len(control_points)]
    return np.column_stack([weights(points), kernel[:, 3:] - kernel[:, :3] @ weights(control_points[3:]).T])


def b_spline(x: Array, cells: int) -> Array:
    """Return cubic B-splines on equal cells of [0, 1]."""
    knots = np.concatenate([[0] * 3, np.linspace(0, 1, cells + 1), [1] * 3])
    return BSpline.design_matrix(np.clip(x, 0, 1), knots, 3).toarray()


def make(family: str, coupling=1, *, responses=1, weighted=False, penalised=False, seed=0, n=24):
    """Return a problem of one of the families, and where its data are, in pixels."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 1, (n, 2)) * [1920, 1080]
    labels = label_rows(coupling, n, rng)
    where = points[labels] + rng.normal(0, 20, (len(labels), 2))
    if family == "random":
        A = rng.normal(size=(len(labels), 5))
    elif family == "tps":
        A = thin_plate(where, points[rng.choice(n, 4, replace=False)])
    else:
        A = b_spline(where[:, 0] / 1920, 4)
    return respond(A, labels, rng, responses, weighted, penalised), points


def respond(A, labels, rng, responses=1, weighted=False, penalised=False) -> Problem:
    """Return a problem of a design: noisy responses, and weights and penalty rows if wanted."""
    n = int(labels.max()) + 1
    truth = rng.normal(size=(A.shape[1], responses)) / np.linalg.norm(A, axis=0)[:, None]
    b = 100 * np.sqrt(len(A)) * A @ truth + rng.normal(0, 5, (len(A), responses))
    weights = rng.uniform(0.1, 10, n) if weighted else None
    penalty = rng.normal(size=(3, A.shape[1])) * np.linalg.norm(A, axis=0) / 5 if penalised else None
    return Problem(A, b[:, 0] if responses == 1 else b, labels, weights, penalty)


def barely_of_full_rank(p: int, seed: int) -> Problem:
    """Return a problem of 60 rows whose third and fourth column differ by rounding alone but for the last two rows."""
    rng = np.random.default_rng(seed)
    A, difference = rng.normal(size=(60, p)), 1e-4 * rng.normal(size=60)
    difference[-2:] = [1.0, -2.0]
    A[:, 3] = A[:, 2] + 1e-12 * difference
    return Problem(A, rng.normal(size=60), np.arange(60))


def every_scheme(points: Array, seed: int = 0) -> dict:
    """Return a scheme of each builder."""
    n, s = len(points), mx.schemes
    rng = np.random.default_rng(seed)
    order = rng.permutation(n)
    gap = [(np.setdiff1d(order, order[i : i + 5]), order[i : i + 2]) for i in range(0, n - 5, 5)]
    sets = [rng.choice(n, size, replace=False) for size in (1, 2, 3, 4, min(7, n), n // 2)]
    return {
        "leave_one_out": s.leave_one_out(n),
        "k_fold": s.k_fold(n, min(4, n), seed=seed),
        "exclusion_radius": s.exclusion_radius(points, 0.15 * np.hypot(1920, 1080)),
        "nearest": s.nearest(points, min(5, n)),
        "delaunay": s.delaunay(points),
        "leave_p_out": s.leave_p_out(n, 2, max_sets=20, seed=seed),
        "random_sampling": s.random_sampling(n, max(1, n // 4), 6, seed=seed),
        "from_sets": s.from_sets(sets, [x[: (len(x) + 1) // 2] for x in sets], n=n),
        "from_splits": s.from_splits(gap, n=n),
        "buffered": s.buffered(s.k_fold(n, min(4, n), seed=seed), points, 0.03 * np.hypot(1920, 1080)),
    }


def expect_same_predictions(found, expected):
    """Compare the predictions of a scheme with those of a fit in memory."""
    np.testing.assert_allclose(found.residuals, expected.residuals, rtol=1e-10, atol=1e-11)
    np.testing.assert_allclose(found.score, expected.score, rtol=1e-12)
    for name in ("rows", "pairs", "undefined"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def expect_same_fit(model, expected, rank, n_data):
    """Compare a fit with that in memory, whose rank and number of data are known."""
    for name in ("coefficients", "residuals", "leverage", "fit_rms", "press"):
        np.testing.assert_allclose(getattr(model, name), getattr(expected, name), rtol=1e-10, atol=1e-13)
    assert (model.rank, model.n_data) == (rank, n_data)
