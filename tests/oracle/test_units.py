"""The unit and the origin of the data have no effect.

Scaling by a power of four is exact, and so are sums of coordinates that are multiples of 1/64 and below 2^46: what
comes out must then be the same, to the last bit where nothing else is rounded. Other scales round the data themselves,
whose last digits a flexible model multiplies.
"""

import warnings

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import example, given, settings

import mexpress as mx
from mexpress.geometry import covered_region, inside, lattice
from mexpress.liftings import lifting_named
from mexpress.placement import by_residual, farthest_first, lloyd
from mexpress.schemes import Places, exclusion_radius
from mexpress.suspicion import SuspicionWarning

SIZE = 512
FAR = 2**39  # 10^9 times the size

SELECTIONS = settings(max_examples=max(5, settings().max_examples // 10))  # each takes a second or two

SEEDS = st.integers(0, 10**6)
POWERS = st.integers(-15, 15).map(lambda k: 4.0**k)  # whose roots are powers of two
SCALES = st.floats(-9, 9).map(lambda x: 10.0**x)
PLACES = st.tuples(*2 * [st.integers(-FAR, FAR)]).map(np.array)
WARPS = st.sampled_from(
    [
        {},
        {"fractional": False},
        {"smoothing": 0, "counts": range(3, 9)},
        {"lifting": "affine", "fractional": False},
        {"lifting": "bspline", "smoothing": [1.0, 100.0]},
    ]
)
SURFACES = st.sampled_from(
    [{}, {"smoothing": 0, "max_count": 12}, {"lifting": "affine"}, {"lifting": "bspline", "max_count": 30}]
)


def positions(seed, number=30):
    """Return distinct positions, at random or on a grid, multiples of 1/64 in a square of a side of 512."""
    if seed % 3 == 0:
        across = np.arange(5 + seed % 2) * 64.0
        return np.column_stack([axis.ravel() for axis in np.meshgrid(across, across + 32)])
    random = np.random.default_rng(seed)
    cells = random.choice(SIZE * SIZE, number, replace=False)
    return np.column_stack([cells % SIZE, cells // SIZE]) + random.integers(0, 64, (number, 2)) / 64


def bent(points, seed, wrong=90):
    """Return images of positions, with noise and a wrong one, multiples of 1/64."""
    random = np.random.default_rng(seed)
    x, y = points.T / SIZE
    images = SIZE * np.column_stack([x + 0.05 * np.sin(3 * y) + 0.1 * x * y, y + 0.05 * np.cos(4 * x)])
    images += random.normal(0, 1, points.shape)
    images[seed % len(points)] += wrong
    return np.round(64 * images) / 64


def selected(select, points, values, ways, unit=1.0):
    """Select a model and the suspects; weights of the bending energy are in the square of the points' unit."""
    if isinstance(ways.get("smoothing"), list):
        ways = {**ways, "smoothing": [unit**2 * weight for weight in ways["smoothing"]]}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SuspicionWarning)
        selection = select(points, values, robust=True, **ways)
        return selection, selection.suspects().indices.tolist()


def same_selection(found, expected, unit, rtol):
    """Expect the same decisions and, in their unit, the same scores."""
    (found, suspects), (expected, others) = found, expected
    np.testing.assert_array_equal(found.counts, expected.counts)
    assert (found.count, found.place, found.rival) == (expected.count, expected.place, expected.rival)
    np.testing.assert_array_equal(found.left_out, expected.left_out)
    assert suspects == others
    assert [note.split()[0] for note in found.notes] == [note.split()[0] for note in expected.notes]
    for name in ("CMPRESS", found.criterion):
        np.testing.assert_allclose(found.maps[name] / unit, expected.maps[name], rtol=rtol)


def same_model(found, expected, seed, there, back, rtol, digits, unit=1.0):
    """Expect the same of a model whose points are `there` and whose values come `back`, but for some digits."""
    points = np.random.default_rng(seed + 1).integers(-64 * 64, (SIZE + 64) * 64, (40, 2)) / 64
    places = there(points)
    np.testing.assert_allclose(back(found(places)), expected(points), rtol=rtol, atol=digits)
    np.testing.assert_array_equal(found.covers(places), expected.covers(points))
    np.testing.assert_allclose(found.error(places) / unit, expected.error(points), rtol=max(rtol, 1e-15))
    if isinstance(found, mx.Warp):
        np.testing.assert_array_equal(found.folds(places), expected.folds(points))
        np.testing.assert_array_equal(found.vanishes(places), expected.vanishes(points))
        comes_back(found, there(positions(3 * seed + 1)))
    else:
        np.testing.assert_array_equal(found.grid().triangles, expected.grid().triangles)


def comes_back(warp, points):
    """Expect an inverse of every image, to 1e-11 of the size or a few units in the last place of the coordinates."""
    points = points[inside(warp.domain, *points.T)]
    if warp.folds(np.vstack([points, lattice(warp.domain, 1000)])).any():
        return  # Newton's steps need not find a way
    images = warp(points)
    found = warp.inverse(images)
    stretch = np.linalg.norm(warp.jacobian(found), axis=(1, 2)).max()
    rounding = np.spacing(np.abs(images).max()) + stretch * np.spacing(np.abs(points).max())
    assert np.abs(warp(found) - images).max() <= max(1e-11 * np.ptp(images[:, 0]), 32 * rounding)


@pytest.mark.slow
@SELECTIONS
@given(SEEDS, WARPS, POWERS, POWERS)
def test_a_warp_is_the_same_in_units_of_any_powers_of_four(seed, ways, s, t):
    source = positions(seed)
    target = bent(source, seed)
    expected = selected(mx.select_warp, source, target, ways)
    found = selected(mx.select_warp, s * source, t * target, ways, s)
    same_selection(found, expected, t, 0)
    same_model(found[0].warp, expected[0].warp, seed, lambda x: s * x, lambda y: y / t, 0, 0, t)


@pytest.mark.slow
@SELECTIONS
@given(SEEDS, WARPS, SCALES, SCALES)
@example(6555, {"lifting": "affine", "fractional": False}, 10**2.875, 1.0)  # a square, but for rounding
def test_a_warp_is_the_same_in_any_units(seed, ways, s, t):
    source = positions(seed)
    target = bent(source, seed)
    expected = selected(mx.select_warp, source, target, ways)
    found = selected(mx.select_warp, s * source, t * target, ways, s)
    same_selection(found, expected, t, 1e-7)
    same_model(found[0].warp, expected[0].warp, seed, lambda x: s * x, lambda y: y / t, 1e-7, 1e-7, t)


@pytest.mark.slow
@SELECTIONS
@given(SEEDS, WARPS, PLACES, PLACES)
def test_a_warp_is_the_same_about_any_origins(seed, ways, here, there):
    source = positions(seed)
    target = bent(source, seed)
    expected = selected(mx.select_warp, source, target, ways)
    found = selected(mx.select_warp, source + here, target + there, ways)
    same_selection(found, expected, 1.0, 1e-5)
    digits = 64 * (np.spacing(np.abs(here).max() + 1.0) + np.spacing(np.abs(there).max() + 1.0)) + 1e-7
    model = found[0].warp
    same_model(
        model,
        expected[0].warp,
        seed,
        lambda x: x + here,
        lambda y: y - there,
        1e-5,
        digits,
    )


@pytest.mark.slow
@SELECTIONS
@given(SEEDS, WARPS, PLACES)
def test_the_origin_of_the_target_changes_no_bit_of_a_score(seed, ways, there):
    source = positions(seed)
    target = bent(source, seed)
    expected, found = (mx.select_warp(source, values, **ways) for values in (target, target + there))
    for name, scores in expected.maps.items():
        np.testing.assert_array_equal(found.maps[name], scores)


@pytest.mark.slow
@SELECTIONS
@given(SEEDS, SURFACES, POWERS, POWERS)
def test_a_surface_is_the_same_in_units_of_any_powers_of_four(seed, ways, s, t):
    points = positions(seed)
    depth = bent(points, seed)[:, 0]
    expected = selected(mx.select_surface, points, depth, ways)
    found = selected(mx.select_surface, s * points, t * depth, ways, s)
    same_selection(found, expected, t, 0)
    same_model(found[0].surface, expected[0].surface, seed, lambda x: s * x, lambda y: y / t, 0, 0, t)


@pytest.mark.slow
@SELECTIONS
@given(SEEDS, SURFACES, SCALES, SCALES)
def test_a_surface_is_the_same_in_any_units(seed, ways, s, t):
    points = positions(seed)
    depth = bent(points, seed)[:, 0]
    expected = selected(mx.select_surface, points, depth, ways)
    found = selected(mx.select_surface, s * points, t * depth, ways, s)
    same_selection(found, expected, t, 1e-7)
    same_model(found[0].surface, expected[0].surface, seed, lambda x: s * x, lambda y: y / t, 1e-7, 1e-7, t)


@pytest.mark.slow
@SELECTIONS
@given(SEEDS, SURFACES, PLACES, st.integers(-FAR, FAR))
def test_a_surface_is_the_same_about_any_origins(seed, ways, here, level):
    points = positions(seed)
    depth = bent(points, seed)[:, 0]
    expected = selected(mx.select_surface, points, depth, ways)
    found = selected(mx.select_surface, points + here, depth + level, ways)
    same_selection(found, expected, 1.0, 1e-5)
    digits = 64 * (np.spacing(np.abs(here).max() + 1.0) + np.spacing(abs(level) + 1.0)) + 1e-7
    model = found[0].surface
    same_model(
        model,
        expected[0].surface,
        seed,
        lambda x: x + here,
        lambda y: y - level,
        1e-5,
        digits,
    )


@given(SEEDS, SCALES, SCALES, PLACES, PLACES, st.booleans(), st.sampled_from(["tps", "affine", "bspline"]))
def test_an_inverse_is_as_close_in_any_units_about_any_origins(seed, s, t, here, there, fractional, lifting):
    source = positions(seed)
    target = bent(source, seed, wrong=0)
    source, target = s * (source + here), t * (target + there)
    control_points = source if lifting == "tps" else lifting_named(lifting).place(source, 20)
    warp = mx.fit_warp(source, target, control_points, lifting, fractional, smoothing=s**2)
    comes_back(warp, s * (positions(3 * seed + 1) + here))


@given(SEEDS, SCALES)
def test_neighbourhoods_and_placements_are_the_same_in_any_unit(seed, s):
    points = positions(seed)
    same_places(points, s * points, lambda x: x / s, 1e-9, seed)


@given(SEEDS, PLACES)
def test_neighbourhoods_and_placements_are_the_same_about_any_origin(seed, here):
    points = positions(seed)
    same_places(points, points + here, lambda x: x - here, 4 * np.spacing(FAR + 1.0), seed)


def same_places(points, others, back, digits, seed):
    unit = np.ptp(others[:, 0]) / np.ptp(points[:, 0])
    for radius in (0.0, 64.0, 64 * np.sqrt(2), 128.0):
        held, expected = (
            exclusion_radius(x, r).held_out for x, r in ((others, unit * radius), (points, radius))
        )
        np.testing.assert_array_equal(held.offsets, expected.offsets)
        np.testing.assert_array_equal(held.indices, expected.indices)
    np.testing.assert_array_equal(Places(others).order, Places(points).order)
    region, same = covered_region(points), covered_region(others)
    np.testing.assert_allclose(back(same), region, rtol=0, atol=digits)
    np.testing.assert_array_equal(inside(same, *others.T), np.ones(len(points)))
    np.testing.assert_allclose(back(lattice(same, 100)), lattice(region, 100), rtol=0, atol=digits)
    np.testing.assert_allclose(back(lloyd(same, 7)), lloyd(region, 7), rtol=0, atol=digits)
    np.testing.assert_array_equal(farthest_first(others, 12), farthest_first(points, 12))
    values = bent(points, seed)
    np.testing.assert_array_equal(by_residual(others, values, 12), by_residual(points, values, 12))


UNITS = [0.1, 1 / 3, 1e-9, 1e9, 1e-9 / 3, 0.7e90]
GRIDS = {
    "square": np.stack(np.meshgrid(np.arange(9.0), np.arange(7.0)), axis=-1).reshape(-1, 2),
    "oblong": np.stack(np.meshgrid(3 * np.arange(6.0), 7 * np.arange(8.0)), axis=-1).reshape(-1, 2),
    "pixels": np.random.default_rng(0).integers(0, 40, (60, 2)).astype(float),
}


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("grid", GRIDS)
def test_rounding_decides_no_radius_of_a_grid(grid, unit):
    points = GRIDS[grid]
    for radius in (0.0, 1.0, np.sqrt(2), 3.0, 5.0, np.sqrt(58), 7.0):
        found, expected = (exclusion_radius(s * points, s * radius).held_out for s in (unit, 1.0))
        np.testing.assert_array_equal(found.offsets, expected.offsets)
        np.testing.assert_array_equal(found.indices, expected.indices)


@pytest.mark.parametrize("unit", UNITS[:4])
@pytest.mark.parametrize("grid", GRIDS)
def test_rounding_places_no_control_point_of_a_grid(grid, unit):
    points = GRIDS[grid]
    values = (points % 5).prod(axis=1)
    np.testing.assert_array_equal(farthest_first(unit * points, 30), farthest_first(points, 30))
    for distance in (2.0, 3.0, np.sqrt(8), 7.0):
        expected = by_residual(points, values, 30, distance)
        np.testing.assert_array_equal(by_residual(unit * points, values, 30, unit * distance), expected)
    for count in (4, 9, 16):
        centres = lloyd(points, count)
        np.testing.assert_allclose(lloyd(unit * points, count) / unit, centres, rtol=0, atol=1e-9)


@pytest.mark.parametrize("level", [0.0, 1e3, -1e9, 1e12])
@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_placement_by_residual_ends_at_rounding_whatever_the_origin_of_the_values(unit, level):
    points = positions(1, 200)
    values = np.round(64 * np.sin(points[:, 0] / 90) * np.cos(points[:, 1] / 70)) / 64
    expected = by_residual(points, values, 30)
    np.testing.assert_array_equal(by_residual(points, unit * (values + level), 30), expected)
