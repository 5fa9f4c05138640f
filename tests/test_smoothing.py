"""Selections over counts and weights of smoothing, against a plain refit for every entry of their maps."""

import math

import numpy as np
import pytest
from oracle import Problem

import mexpress as mx
from mexpress.designs import nested_surface_design, nested_warp_design, surface_design, warp_design
from mexpress.liftings import ThinPlateSpline, lifting_named, make_lifting
from mexpress.placement import area, covered_region, farthest_first, lloyd
from mexpress.smoothing import weights_of

RNG = np.random.default_rng(0)
N = 30
SOURCE = RNG.uniform(0, 1, (N, 2)) * [640, 480]
BEND = 20 * np.column_stack([np.sin(SOURCE[:, 0] / 120), np.cos(SOURCE[:, 1] / 150)])
TARGET = 1.3 * SOURCE + 50 + BEND + RNG.normal(size=(N, 2))
DEPTH = np.sin(SOURCE[:, 0] / 120) + 0.1 * RNG.normal(size=N)
NAMES = ["FIT", "CMPRESS", "ER10", "KF5", "GCV", "AIC"]
REGION = covered_region(SOURCE)
UNIT = N * area(REGION)
WEIGHTS = [0.0, *(UNIT * np.array([1e-6, 1e-3, 1.0, 100.0]))]


def schemes():
    diagonal = float(np.hypot(*np.ptp(SOURCE, axis=0)))
    return {
        "CMPRESS": mx.schemes.leave_one_out(N),
        "ER10": mx.schemes.exclusion_radius(SOURCE, 0.1 * diagonal),
        "KF5": mx.schemes.k_fold(N, 5, 0),
    }


def refit(design, weight):
    """Every criterion of one model, from its definition, its trace(H), and its solution; None if it has none."""
    Z = math.sqrt(weight) * design.bending()
    labels = np.repeat(np.arange(N), design.coupling)
    problem = Problem(design.A, design.b, labels, penalty=Z)
    if problem.rank < design.A.shape[1]:
        return None, math.nan, None
    m, r = len(design.A), design.b.size // len(design.A)
    scale = np.linalg.norm(np.vstack([design.A, Z]), axis=0)
    inverse = np.linalg.pinv(np.vstack([design.A, Z]) / scale)[:, :m]
    x = ((inverse @ design.b).T / scale).T
    used = r * np.trace(design.A / scale @ inverse)
    rss = ((design.b - design.A @ x) ** 2).sum()
    found = {name: problem.score(scheme) for name, scheme in schemes().items()}
    found["FIT"] = math.sqrt(rss / N)
    found["GCV"] = math.sqrt(rss / N) / (1 - used / (r * m))
    found["AIC"] = r * m * math.log(rss / (r * m)) + 2 * used
    return found, used, x


def check_maps(selection, design_of, where):
    """Every entry of the maps is that of a refit."""
    assert set(selection.maps) == set(NAMES)
    for k, count in enumerate(selection.counts.tolist()):
        design = design_of(count)
        for w, weight in enumerate(selection.weights.tolist()):
            expected, used, _ = refit(design, weight)
            if expected is None:
                assert np.isnan(selection.parameters[k, w])
                assert all(np.isnan(found[k, w]) for found in selection.maps.values())
                continue
            assert selection.parameters[k, w] == pytest.approx(used, rel=1e-9), (count, weight)
            for name, value in expected.items():
                got = selection.maps[name][k, w]
                assert got == pytest.approx(value, rel=1e-9, nan_ok=True), (name, count, weight)
    k, w = selection.place
    _, _, x = refit(design_of(selection.count), selection.smoothing)
    model = design_of(selection.count).model(x)
    got = selection.warp if hasattr(selection, "warp") else selection.surface
    assert got.smoothing == selection.smoothing == selection.weights[w]
    np.testing.assert_allclose(got(where), model(where), rtol=1e-8)
    own = selection.least_squares()
    for name, scheme in schemes().items():
        assert own.cross_validate(scheme).score == pytest.approx(selection.maps[name][k, w], rel=1e-9)


WHERE = np.random.default_rng(1).uniform(-20, 500, (40, 2))


@pytest.mark.parametrize("fractional", [True, False])
@pytest.mark.parametrize("counts", [[3, 6, 9], [3, 4, 6, 8, 9]], ids=["one by one", "together"])
@pytest.mark.parametrize("placement", ["lloyd", "nested"])
def test_maps_of_warps_are_refits(placement, counts, fractional):
    selection = mx.select_warp(
        SOURCE,
        TARGET,
        "CMPRESS",
        NAMES,
        fractional=fractional,
        counts=counts,
        placement=placement,
        smoothing=WEIGHTS,
    )
    np.testing.assert_array_equal(selection.counts, counts)
    np.testing.assert_array_equal(selection.weights, WEIGHTS)
    ordered = SOURCE[farthest_first(SOURCE, 9)]

    def design(count):
        points = lloyd(SOURCE, count, 0) if placement == "lloyd" else ordered[:count]
        return warp_design(ThinPlateSpline(points), SOURCE, TARGET, fractional, placement == "nested")

    check_maps(selection, design, WHERE)


@pytest.mark.parametrize("fractional", [True, False])
@pytest.mark.parametrize("lifting", ["bspline", "affine"])
def test_maps_of_warps_on_grids_are_refits(lifting, fractional):
    functions = lifting_named(lifting)
    selection = mx.select_warp(
        SOURCE, TARGET, "CMPRESS", NAMES, lifting, fractional, counts=[16, 20], smoothing=WEIGHTS[1:]
    )

    def design(count):
        return warp_design(functions(functions.place(REGION, count)), SOURCE, TARGET, fractional)

    check_maps(selection, design, WHERE)


@pytest.mark.parametrize("values", [DEPTH, np.column_stack([SOURCE, DEPTH])], ids=["depth", "space"])
@pytest.mark.parametrize("placement", ["residual", "nested", "lloyd"])
def test_maps_of_surfaces_are_refits(placement, values):
    selection = mx.select_surface(
        SOURCE, values, "CMPRESS", NAMES, max_count=9, placement=placement, smoothing=WEIGHTS
    )
    assert selection.counts.tolist() == list(range(3, 10))

    def design(count):
        points = lloyd(SOURCE, count, 0) if placement == "lloyd" else selection.control_points[:count]
        return surface_design(ThinPlateSpline(points), SOURCE, values)

    if placement == "nested":
        np.testing.assert_array_equal(selection.control_points, SOURCE[farthest_first(SOURCE, 9)])
    check_maps(selection, design, WHERE)


@pytest.mark.parametrize("lifting", ["bspline", "affine"])
def test_maps_of_surfaces_on_grids_are_refits(lifting):
    functions = lifting_named(lifting)
    selection = mx.select_surface(
        SOURCE, DEPTH, "CMPRESS", NAMES, max_count=20, lifting=lifting, smoothing=WEIGHTS[1:]
    )
    assert selection.counts.tolist() == functions.counts(REGION, 20)

    def design(count):
        return surface_design(functions(functions.place(REGION, count)), SOURCE, DEPTH)

    check_maps(selection, design, WHERE)
