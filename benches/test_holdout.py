"""Time mexpress beside its peers: ``pytest benches --benchmark-group-by=group``. Small; see `grid.py` for tables."""

import numpy as np
import pytest
from peers import cvmatrix_folds, numpy_stacked, refit
from threadpoolctl import threadpool_limits

import mexpress as mx


class Mexpress:
    """Mexpress as the adapters are: made, then asked for the residuals of a scheme."""

    def __init__(self, A, b):
        self.model = mx.LeastSquares(A, b, threads=1)

    def residuals(self, held_out, validated):
        """Predict the validated rows of every pair, in order."""
        scheme = mx.schemes.Scheme(self.model.n_data, held_out, validated)
        return self.model.cross_validate(scheme, threads=1).residuals


PEERS = {
    "mexpress": Mexpress,
    "numpy looped": numpy_stacked.Looped,
    "numpy stacked primal": numpy_stacked.Primal,
    "numpy stacked dual": numpy_stacked.Dual,
    "cvmatrix": cvmatrix_folds.Folds,
    "cvmatrix centred": lambda A, b: cvmatrix_folds.Folds(A, b, centred=True),
    "sklearn": refit.Sklearn,
    "refit": refit.Refit,
}
STACKS = ["mexpress", "numpy looped", "numpy stacked primal", "numpy stacked dual", "cvmatrix", "refit"]
FOLDS = ["mexpress", "numpy looped", "cvmatrix", "cvmatrix centred", "sklearn", "refit"]


def problem(n, p):
    """Random regressors, the first of them constant."""
    rng = np.random.default_rng(0)
    A = rng.standard_normal((n, p))
    A[:, 0] = 1.0
    return A, A @ rng.standard_normal(p) + rng.standard_normal(n)


@pytest.fixture(autouse=True)
def one_thread():
    with threadpool_limits(1):
        yield


def compare(benchmark, name, A, b, scheme):
    """The residuals are right, then timed; the model is made beforehand."""
    adapter = PEERS[name](A, b)
    expected = Mexpress(A, b).residuals(scheme.held_out, scheme.validated)
    arguments = (scheme.held_out, scheme.validated)
    if name not in ("mexpress", "sklearn"):
        arguments = tuple(map(list, arguments))
    found = benchmark.pedantic(adapter.residuals, arguments, rounds=5, iterations=1, warmup_rounds=1)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)


@pytest.mark.benchmark(group="local exclusion, small sets (n 500, p 60, 15 held out)")
@pytest.mark.parametrize("name", STACKS)
def test_small_sets(benchmark, name):
    scheme = mx.schemes.nearest(np.random.default_rng(1).random((500, 2)), 15)
    compare(benchmark, name, *problem(500, 60), scheme)


@pytest.mark.benchmark(group="local exclusion, large sets (n 500, p 30, 101 held out)")
@pytest.mark.parametrize("name", STACKS)
def test_large_sets(benchmark, name):
    scheme = mx.schemes.nearest(np.random.default_rng(1).random((500, 2)), 101)
    compare(benchmark, name, *problem(500, 30), scheme)


@pytest.mark.benchmark(group="coupled rows (n 2000, two rows each, p 30)")
@pytest.mark.parametrize("name", ["mexpress", "numpy looped", "numpy stacked dual"])
def test_coupled_rows(benchmark, name):
    rows = mx.schemes.from_sets(np.arange(4000).reshape(-1, 2))
    compare(benchmark, name, *problem(4000, 30), rows)


@pytest.mark.benchmark(group="ten folds (n 20000, p 40)")
@pytest.mark.parametrize("name", FOLDS)
def test_folds(benchmark, name):
    compare(benchmark, name, *problem(20000, 40), mx.schemes.k_fold(20000, 10, seed=0))


@pytest.mark.benchmark(group="fit (m 20000, p 40)")
@pytest.mark.parametrize("name", ["mexpress", "numpy looped", "cvmatrix"])
def test_fit(benchmark, name):
    benchmark.pedantic(PEERS[name], problem(20000, 40), rounds=5, warmup_rounds=1)


@pytest.mark.benchmark(group="a small problem, whole (n 200, p 20, leave-one-out)")
@pytest.mark.parametrize("name", ["mexpress", "numpy looped", "cvmatrix"])
def test_small_problem(benchmark, name):
    A, b = problem(200, 20)
    scheme = mx.schemes.leave_one_out(200)
    benchmark(lambda: PEERS[name](A, b).residuals(scheme.held_out, scheme.validated))
