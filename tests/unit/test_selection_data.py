"""Matches and samples are checked, and what they cover is found, once; their weights go all the way."""

from collections import Counter
from functools import partial

import numpy as np
import pytest

import mexpress as mx
from mexpress import _validation, geometry
from mexpress.criteria import Scorer
from mexpress.liftings import ThinPlateSpline
from mexpress.models import CardinalBasis, NestedBasis
from mexpress.selection.data import Matches, Samples
from mexpress.selection.sweep import sweep_designs, sweep_nested

N = 150
POINTS = np.random.default_rng(0).uniform(0, 640, (N, 2))
TARGET = 1.1 * POINTS + 5 * np.sin(POINTS[:, ::-1] / 90)
CRITERIA = ["FIT", "PRESS", "ER05", "NN05PTS", "DELAUNAY", "MATCHED", "KF05"]


@pytest.fixture
def looks(monkeypatch):
    """Count the checks of all data, by name, and the hulls of anything."""
    counts = Counter()
    check, hull = _validation.points, geometry._convex_hull

    def checking(value, name, *more, **named):
        counts[name] += len(value) == N
        return check(value, name, *more, **named)

    def hulling(points):
        counts["hulls"] += 1
        monkeypatch.setattr(geometry, "_convex_hull", hull)  # it calls itself, with fewer points
        corners = hull(points)
        monkeypatch.setattr(geometry, "_convex_hull", hulling)
        return corners

    monkeypatch.setattr(_validation, "points", checking)
    monkeypatch.setattr(geometry, "_convex_hull", hulling)
    return counts


@pytest.mark.parametrize(
    "options",
    [{}, {"smoothing": "auto"}, {"placement": "nested"}, {"lifting": "bspline"}, {"lifting": "affine"}],
)
def test_matches_are_checked_once_and_hulled_once(looks, options):
    mx.select_warp(POINTS, TARGET, "GCV", CRITERIA, counts=range(3, 30, 3), **{"smoothing": 0} | options)
    assert +looks == {"source": 1, "target": 1, "hulls": 1}


@pytest.mark.parametrize("options", [{}, {"placement": "nested"}, {"placement": "lloyd"}])
def test_samples_are_checked_once_and_hulled_once(looks, options):
    mx.select_surface(POINTS, TARGET[:, 0], "GCV", CRITERIA, max_count=20, **options, smoothing=0)
    assert +looks == {"points": 1, "hulls": 1}


def test_what_a_selection_does_later_neither_checks_nor_hulls_again(looks):
    selection = mx.select_warp(POINTS, TARGET, "GCV", counts=[3, 9], smoothing=0)
    looks.clear()
    selection.radii([0, 5])
    selection.suspects()
    selection.least_squares()
    assert +looks == {}


def refitted(design, weight, count):
    """The model of a plain weighted and penalised refit of the first columns."""
    size = design.columns(count)
    roots = np.sqrt(np.repeat(design.weights, design.coupling))
    A = np.vstack([roots[:, None] * design.A[:, :size], np.sqrt(weight) * design.bending()[:, :size]])
    b = roots.reshape(-1, *(1,) * (design.b.ndim - 1)) * design.b
    b = np.concatenate([b, np.zeros((len(A) - len(b), *b.shape[1:]))])
    lengths = np.linalg.norm(A, axis=0)
    x = np.linalg.lstsq(A / lengths, b, rcond=None)[0]
    return design.model((x.T / lengths).T, count)


@pytest.mark.parametrize("smoothing", [[0.0], [0.0, 1e3], [1e3, 1e6]])
@pytest.mark.parametrize("nested", [True, False])
@pytest.mark.parametrize("kind", ["fractional warp", "linear warp", "surface"])
def test_weights_of_the_data_enter_every_fit(kind, nested, smoothing):
    weights, centres = np.random.default_rng(1).uniform(0.1, 10, N), POINTS[[0, 40, 80, 120, 7, 19]]
    if kind == "surface":
        design = Samples(POINTS, TARGET[:, 0], weights).design
    else:
        matches = Matches(POINTS, TARGET, weights, None)
        design = partial(matches.design, fractional=kind == "fractional warp")
    scorer, counts = Scorer.of(["CMPRESS"], POINTS), np.array([4, 6])
    if nested:
        designs = [design(NestedBasis(centres))] * 2
        sweep = sweep_nested(designs[0], counts, np.array(smoothing), scorer, 1, lambda: None)
    else:
        designs = [design(CardinalBasis(ThinPlateSpline(centres[:count]))) for count in counts]
        sweep = sweep_designs(designs, np.array(smoothing), scorer, 1, lambda: None)
    for k, count in enumerate(counts):
        for w, weight in enumerate(smoothing):
            expected = refitted(designs[k], weight, count)(POINTS)
            np.testing.assert_allclose(sweep.model(k, w)(POINTS), expected, rtol=0, atol=1e-7)
    unweighted = sweep_designs(
        [design.weighted(None) for design in designs], np.array(smoothing), scorer, 1, int
    )
    assert not np.allclose(sweep.maps["CMPRESS"], unweighted.maps["CMPRESS"], rtol=1e-3)


def test_diagonals_are_of_the_image_or_of_the_points():
    corners = np.array([[0.0, 0.0], [30.0, 0.0], [0.0, 40.0]])
    assert Matches.of(corners, corners).diagonal == 50
    assert Matches.of(corners, corners, (600, 800)).diagonal == 1000
    assert Samples.of(corners, [1, 2, 3]).diagonal == 50
