"""Jackknife+ against n real refits, and the coverage that it promises."""

import math
from dataclasses import replace

import numpy as np
import pytest
from designs import nested_warp_design, surface_design, warp_design

import mexpress as mx
from mexpress.liftings import ThinPlateSpline
from mexpress.models.jackknife import Jackknife, jackknife_plus

N, QUERIES = 40, 30


def refits(design, smoothing, points):
    """Return values at points of the models without each datum, (k, n, d), and every datum's own, (n, d)."""
    n, g = len(design.data.points), design.coupling
    roots = np.sqrt(np.repeat(np.ones(n) if design.weights is None else design.weights, g))
    bending = math.sqrt(smoothing) * design.bending()
    responses = design.b.reshape(n * g, -1)
    at, own = [], []
    for i in range(n):
        kept = np.ones(n * g, dtype=bool)
        kept[g * i : g * i + g] = False
        whole = np.vstack([(roots[:, None] * design.A)[kept], bending])
        right = np.vstack([(roots[:, None] * responses)[kept], np.zeros((len(bending), responses.shape[1]))])
        size = np.linalg.norm(whole, axis=0)
        x = np.linalg.lstsq(whole / size, right, rcond=None)[0] / size[:, None]
        model = design.model(x[:, 0] if design.b.ndim == 1 else x, smoothing=smoothing)
        at.append(model(points).reshape(len(points), -1))
        own.append(model(design.data.points[[i]]).reshape(-1))
    return np.stack(at, axis=1), np.array(own)


def bounds_of_refits(design, smoothing, points, level):
    """Return the interval as Barber, Candes, Ramdas and Tibshirani define it, by sorting."""
    at, own = refits(design, smoothing, points)
    n = len(own)
    spread = np.abs(design.data.values.reshape(n, -1) - own)
    lower, upper = np.sort(at - spread, axis=1), np.sort(at + spread, axis=1)
    low, high = math.floor((1 - level) * (n + 1) + 1e-9), math.ceil(level * (n + 1) - 1e-9)
    infinite = np.full_like(lower[:, 0], np.inf)
    return (
        lower[:, low - 1] if low > 0 else -infinite,
        upper[:, high - 1] if high <= n else infinite,
    )


def positions(number, seed):
    return np.random.default_rng(seed).uniform(0, 1, (number, 2)) * [640, 480]


def problem(name):
    """Return a design of N data."""
    points, random = positions(N, 0), np.random.default_rng(1)
    bend = 20 * np.sin(points / 150)
    below = 1 + points @ [[0.0005], [0.001]]
    target = (points + bend[:, ::-1]) / below + random.normal(0, 1, points.shape)
    depth = bend.sum(axis=1) + random.normal(0, 1, N)
    lifting = ThinPlateSpline(positions(9, 2))
    return {
        "depth": lambda: surface_design(lifting, points, depth),
        "embedding": lambda: surface_design(lifting, points, np.column_stack([target, depth])),
        "linear warp": lambda: warp_design(lifting, points, target, fractional=False),
        "warp": lambda: warp_design(lifting, points, target),
        "warp over data": lambda: warp_design(lifting, points, target, over_data=True),
        "nested warp": lambda: nested_warp_design(points, target, lifting.control_points),
    }[name]()


NAMES = ["depth", "embedding", "linear warp", "warp", "warp over data", "nested warp"]


@pytest.mark.parametrize("weighted", [False, True], ids=["", "weighted"])
@pytest.mark.parametrize("smoothing", [0.0, 100.0])
@pytest.mark.parametrize("name", NAMES)
def test_models_without_a_datum_are_the_refits(name, smoothing, weighted):
    design = problem(name)
    if weighted:
        design = design.weighted(np.random.default_rng(3).uniform(0.1, 10, N))
    points = positions(QUERIES, 4)
    at, own = refits(design, smoothing, points)
    jackknife = Jackknife(design, smoothing)
    np.testing.assert_allclose(np.concatenate(list(jackknife.predictions(points))), at, rtol=1e-10, atol=1e-8)
    expected = design.data.values.reshape(N, -1) - own
    np.testing.assert_allclose(jackknife.residuals(), expected, rtol=1e-10, atol=1e-8)


@pytest.mark.parametrize("level", [0.5, 0.9, 0.95, 39 / 41, 0.99])
@pytest.mark.parametrize("smoothing", [0.0, 100.0])
@pytest.mark.parametrize("name", NAMES[:5])
def test_bounds_are_those_of_the_refits(name, smoothing, level):
    design = problem(name).weighted(np.random.default_rng(3).uniform(0.1, 10, N))
    points = positions(QUERIES, 4)
    model = design.model(design.fit(smoothing).coefficients, smoothing=smoothing)
    interval = model.interval(points, level)
    lower, upper = bounds_of_refits(design, smoothing, points, level)
    for bounds, expected in ((interval.lower, lower), (interval.upper, upper)):
        assert bounds.shape == model(points).shape
        np.testing.assert_allclose(bounds.reshape(expected.shape), expected, rtol=1e-10, atol=1e-8)
    assert np.isinf(interval.lower).all() == (level == 0.99)


@pytest.mark.parametrize("name", ["depth", "warp"])
def test_blocks_of_points_do_not_matter(name, monkeypatch):
    design, points = problem(name), positions(QUERIES, 4)
    jackknife = Jackknife(design, 1.0)
    whole, residuals = np.concatenate(list(jackknife.predictions(points))), jackknife.residuals()
    monkeypatch.setattr("mexpress.models.jackknife._ENTRIES", 1000)
    parts = list(jackknife.predictions(points))
    assert len(parts) > 3
    np.testing.assert_allclose(np.concatenate(parts), whole, rtol=1e-12)
    np.testing.assert_allclose(jackknife.residuals(), residuals, rtol=0, atol=1e-9)


def test_a_datum_that_the_others_do_not_replace_makes_its_model_unbounded():
    # The last of the control points is far from all data except one.
    points = np.vstack([positions(30, 0), [[5000, 5000]]])
    design = surface_design(
        ThinPlateSpline([[0, 0], [640, 0], [0, 480], [5000, 5000]]), points, points[:, 0] ** 2
    )
    design = replace(design, A=np.where(np.arange(31)[:, None] < 30, design.A * [1, 1, 1, 0], design.A))
    jackknife = Jackknife(design, 0.0)
    assert np.isnan(jackknife.residuals()).sum(axis=0).tolist() == [1]
    assert np.isnan(jackknife.residuals()[30])
    bounded, unbounded = (jackknife_plus(design, 0.0, points[:3], level) for level in (0.9, 0.97))
    assert np.isfinite(bounded.lower).all()
    assert np.isinf(unbounded.lower).all()


def test_too_few_data_have_no_bounds():
    square = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 2.0], [2.0, 2.0]])
    exact = mx.fit_surface(square, [0, 2, 2, 5], square).interval(square, 0.5)
    assert (exact.lower == -np.inf).all()
    assert (exact.upper == np.inf).all()


def test_coverage_is_what_is_promised_for_exchangeable_data():
    # 1 - 2 alpha at least, about 1 - alpha: 60 fits of 50 data, and 50 measurements more of each.
    inside = []
    for seed in range(60):
        random = np.random.default_rng(seed)
        points = random.uniform(0, 6, (100, 2))
        values = np.sin(points[:, 0]) * np.cos(points[:, 1]) + random.standard_t(3, 100) * 0.1
        interval = mx.fit_surface(points[:50], values[:50], points[:20], smoothing=0.01).interval(
            points[50:], 0.8
        )
        inside.append((interval.lower <= values[50:]) & (values[50:] <= interval.upper))
    assert 0.76 < np.mean(inside) < 0.86
