"""Time nested models beside other ways: ``pytest benches --benchmark-group-by=group``. Small; see `nested.py`."""

import numpy as np
import pytest
from peers import numpy_nested
from threadpoolctl import threadpool_limits

import mexpress as mx

SIZES = range(3, 41)
RADII = (0.02, 0.07, 0.14)


@pytest.fixture(autouse=True)
def one_thread():
    with threadpool_limits(1):
        yield


@pytest.fixture(scope="module")
def problem():
    """Random regressors over the unit square."""
    rng = np.random.default_rng(0)
    A = rng.standard_normal((600, SIZES[-1]))
    b = A @ rng.standard_normal(A.shape[1]) + rng.standard_normal(len(A))
    points = rng.random((len(A), 2))
    return A, b, {str(radius): mx.schemes.exclusion_radius(points, radius) for radius in RADII}


def nested(A, b, schemes):
    return np.array(list(mx.cross_validate_nested(A, b, SIZES, schemes, threads=1).values()))


def largest(A, b, schemes):
    """One model, whose scores are those of the last size."""
    model = mx.LeastSquares(A, b, threads=1)
    return np.array([[model.cross_validate(scheme, threads=1).score] for scheme in schemes.values()])


def one_by_one(A, b, schemes):
    return np.hstack([largest(np.ascontiguousarray(A[:, :size]), b, schemes) for size in SIZES])


def rings(A, b, schemes):
    peer = numpy_nested.Rings(A, b)
    sets = zip(*(scheme.held_out for scheme in schemes.values()), strict=True)
    found = [peer.residuals(i, balls)[:, SIZES[0] - 1 :] for i, balls in enumerate(sets)]
    return np.sqrt(np.mean(np.square(found), axis=0))


def equation_13(A, b, schemes):
    peer = numpy_nested.EachModel(A, b)
    found = [
        [[peer.residual(i, K, size) for size in SIZES] for i, K in enumerate(scheme.held_out)]
        for scheme in schemes.values()
    ]
    return np.sqrt(np.mean(np.square(found), axis=1))


def compare(benchmark, way, A, b, schemes):
    """The scores are right, and timed; models are made within the time."""
    found = benchmark.pedantic(way, (A, b, schemes), rounds=3, iterations=1, warmup_rounds=1)
    np.testing.assert_allclose(found, nested(A, b, schemes)[:, -found.shape[1] :], rtol=0, atol=1e-8)


@pytest.mark.benchmark(group="38 nested models, a radius (n 600, p 40)")
@pytest.mark.parametrize("way", [nested, largest, one_by_one, rings])
def test_one_radius(benchmark, way, problem):
    A, b, schemes = problem
    compare(benchmark, way, A, b, {"0.14": schemes["0.14"]})


@pytest.mark.benchmark(group="38 nested models, three radii together (n 600, p 40)")
@pytest.mark.parametrize("way", [nested, largest, rings])
def test_three_radii(benchmark, way, problem):
    compare(benchmark, way, *problem)


@pytest.mark.benchmark(group="38 nested models, small sets (n 600, p 40, radius 2 %)")
@pytest.mark.parametrize("way", [nested, largest, rings, equation_13])
def test_small_sets(benchmark, way, problem):
    A, b, schemes = problem
    compare(benchmark, way, A, b, {"0.02": schemes["0.02"]})
