import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import LinearNDInterpolator

from mexpress.liftings import PiecewiseAffine
from mexpress.liftings.triangulation import Triangulation
from mexpress.placement import covered_region


def turned(points, angle=0.3):
    return points @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def grid(columns, rows):
    return np.column_stack([np.tile(np.arange(columns), rows), np.repeat(np.arange(rows), columns)]) + 0.0


def equilateral(columns, rows):
    points = grid(columns, rows)
    return np.column_stack([points[:, 0] + 0.5 * (points[:, 1] % 2), points[:, 1] * np.sqrt(0.75)])


def scattered(count, seed=0):
    return np.random.default_rng(seed).uniform(0, 10, (count, 2))


def circle(count):
    angles = 2 * np.pi * np.arange(count) / count
    return np.column_stack([np.cos(angles), np.sin(angles)])


SETS = {
    "three": np.array([[0.0, 0.0], [4.0, 0.0], [1.0, 3.0]]),
    "square": grid(2, 2),
    "grid": grid(7, 5),
    "turned grid": 0.1 * turned(grid(7, 5)) + 3.3,
    "grid far away": turned(grid(7, 5)) + 5e5,
    "equilateral": equilateral(9, 8),
    "circle": circle(12),
    "circle and centre": np.vstack([circle(12), [[0, 0]]]),
    "scattered": scattered(60),
    "strip": scattered(60) * [1, 1e-4],
    "thinnest strip": turned(grid(100, 1) / 10 + scattered(100) * [1e-3, 1e-5]),
    "strip of a grid": turned(grid(60, 5) * [1, 1e-3]),
    "points on hull edges": np.array(
        [[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0], [0.25, 0], [0, 0.3], [0.6, 0.6]]
    ),
    "hull edge bent by rounding": np.vstack(
        [np.column_stack([np.linspace(0, 1, 9), 1e-15 * np.cos(9 * np.arange(9))]), [[0.5, 1]]]
    ),
    "tiny": 1e-60 * scattered(20),
    "huge": 1e60 * scattered(20),
}


def area(corners):
    x, y = (corners - corners[0]).T
    return 0.5 * (x * np.roll(y, -1) - np.roll(x, -1) * y).sum()


def around(points, count=3000, seed=1):
    low, extent = points.min(axis=0), np.ptp(points, axis=0)
    return low + np.random.default_rng(seed).uniform(-1, 2, (count, 2)) * extent


@pytest.mark.parametrize("name", SETS)
def test_triangles_cover_the_hull_once_and_every_point_is_a_corner(name):
    mesh = Triangulation(SETS[name])
    assert (mesh.areas > 0).all()
    np.testing.assert_allclose(mesh.areas.sum(), area(covered_region(SETS[name])), rtol=1e-8)
    assert sorted(np.unique(mesh.corners)) == list(range(len(SETS[name])))
    assert len(mesh.corners) == 2 * len(SETS[name]) - 2 - len(mesh.hull[0])  # Euler
    t, side = np.nonzero(mesh.neighbours >= 0)
    ends = np.sort(np.stack([mesh.corners[t, side], mesh.corners[t, (side + 1) % 3]], axis=1), axis=1)
    other = mesh.corners[mesh.neighbours[t, side]]
    assert (ends[:, :1] == other).any(axis=1).all()
    assert (ends[:, 1:] == other).any(axis=1).all()


def located(points, at):
    """Triangle whose corners' functions are nonzero at places; -1 outside, where there are more of them."""
    number = {tuple(corners): t for t, corners in enumerate(Triangulation(points).corners)}
    functions, elements = PiecewiseAffine(points)._functions.elements(at, 0)
    rows = functions.reshape(elements.shape)
    return np.array([-1 if row[3:].any() else number[tuple(row[:3])] for row in rows])


@pytest.mark.parametrize("name", SETS)
def test_a_point_is_in_the_triangle_that_is_found(name):
    mesh, points = Triangulation(SETS[name]), around(SETS[name])
    points = np.vstack([points, SETS[name], (SETS[name] + np.roll(SETS[name], 1, axis=0)) / 2])
    found = located(SETS[name], points)
    corners = mesh.points[mesh.corners]
    # Every triangle is asked, as nothing else than the plain definition does.
    offset = points[:, None, None] - corners
    beyond = mesh.sides[..., 0] * offset[..., 1] - mesh.sides[..., 1] * offset[..., 0]
    depth = (beyond / (2 * mesh.areas[:, None])).min(axis=2)
    held = found >= 0
    np.testing.assert_array_less(-1e-9, depth[np.flatnonzero(held), found[held]])
    assert depth[~held].max(initial=-1.0) < 1e-9
    assert held[len(points) - 2 * len(SETS[name]) :].mean() > 0.5


@pytest.mark.parametrize("name", [name for name in SETS if name != "grid far away"])
def test_parameters_are_values_at_the_control_points_and_functions_sum_to_one(name):
    hats = PiecewiseAffine(SETS[name])
    np.testing.assert_allclose(hats.basis(SETS[name]), np.eye(len(SETS[name])), rtol=0, atol=1e-9)
    points, extent = around(SETS[name]), np.ptp(SETS[name], axis=0)
    basis = hats.basis(points)
    size = np.abs(basis).sum(axis=1)  # beside a strip, a million
    assert (np.abs(basis.sum(axis=1) - 1) < 1e-13 * size).all()
    wrong = np.abs(basis @ (SETS[name] / extent) - points / extent).max(axis=1)
    assert (wrong < 1e-13 * size * np.abs(points / extent).max()).all()


@given(st.integers(0, 10**6), st.integers(3, 40))
def test_inside_it_is_the_interpolation_of_scipy(seed, count):
    centres = scattered(count, seed)
    values = np.random.default_rng(seed + 1).normal(size=count)
    points = around(centres, 200, seed)
    expected = LinearNDInterpolator(centres, values)(points)
    known = np.isfinite(expected)
    found = PiecewiseAffine(centres).basis(points) @ values
    np.testing.assert_allclose(found[known], expected[known], rtol=0, atol=1e-7)


@given(st.integers(0, 10**6), st.integers(3, 60), st.integers(2, 6))
def test_points_of_a_coarse_lattice_turned_or_not_make_a_triangulation(seed, count, size):
    random = np.random.default_rng(seed)
    points = np.unique(random.integers(0, size, (count, 2)), axis=0) + 0.0
    if len(points) < 3 or np.linalg.matrix_rank(points - points[0]) < 2:
        return
    for made in (points, turned(points, random.uniform(0, 7)) * 0.37 + 11):
        mesh = Triangulation(made)
        np.testing.assert_allclose(mesh.areas.sum(), area(covered_region(made)), rtol=1e-9)
        assert len(np.unique(mesh.corners)) == len(made)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["grid", "turned grid", "scattered", "points on hull edges", "three"])
def test_outside_it_goes_on_continuously_from_the_hull(name):
    hats = PiecewiseAffine(SETS[name])
    values, extent = (
        np.random.default_rng(0).normal(size=(len(SETS[name]), 1)),
        np.ptp(SETS[name], axis=0).max(),
    )
    middle = SETS[name].mean(axis=0)
    for reach in (0.9, 1.5, 20.0):
        angles = np.linspace(0, 2 * np.pi, 40_001)[:, None]
        ring = middle + reach * extent * np.column_stack([np.cos(angles), np.sin(angles)])
        steps = np.abs(np.diff(hats.values(ring, values)[:, 0]))
        steepest = np.abs(hats.slopes(ring, values)).max()
        assert steps.max() < 1.5 * steepest * 2 * np.pi * reach * extent / 40_000


def test_slopes_outside_are_the_mean_of_both_triangles_at_a_corner():
    hats = PiecewiseAffine(np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 1.0], [1.0, -1.0], [1.0, 0.2]]))
    values = np.array([[0.0], [5.0], [1.0], [-2.0], [7.0]])
    inside = hats.slopes(np.array([[0.3, 0.25], [0.3, -0.25]]), values)[:, 0]  # both triangles at (0, 0)
    assert np.abs(inside[0] - inside[1]).max() > 1
    np.testing.assert_allclose(hats.slopes(np.array([[-3.0, 0.1]]), values)[0, 0], inside.mean(axis=0))
    offset = np.array([-3.0, 0.1])
    np.testing.assert_allclose(hats.values(offset[None], values)[0], values[0] + inside.mean(axis=0) @ offset)


@pytest.mark.parametrize(
    ("mesh", "bowl", "ridge", "saddle"),
    [(equilateral(60, 60), 0.5, 0.75, 1.0), (grid(60, 60), 0.75, 0.75, 2.25)],
)
def test_bending_of_quadratic_functions_is_about_the_integral(mesh, bowl, ridge, saddle):
    centres = mesh / 60
    rows, total = PiecewiseAffine(centres).bending(), Triangulation(centres).areas.sum()
    x, y = centres.T
    for function, square, factor in (
        (x**2 + y**2, 8, bowl),
        (x**2, 4, ridge),
        (y**2, 4, ridge),
        (x * y, 2, saddle),
    ):
        energy = 8 * np.pi * np.sum((rows @ function) ** 2)
        np.testing.assert_allclose(energy / total, factor * square, rtol=0.04)


@pytest.mark.parametrize("name", SETS)
def test_bending_has_a_row_for_every_inner_edge(name):
    mesh = Triangulation(SETS[name])
    rows = PiecewiseAffine(SETS[name]).bending()
    assert len(rows) == (mesh.neighbours >= 0).sum() / 2
    values = np.random.default_rng(0).normal(size=len(SETS[name]))
    slopes = np.einsum("tkb,tk->tb", mesh.gradients, values[mesh.corners])
    t, side = np.nonzero(mesh.neighbours > np.arange(len(mesh.corners))[:, None])
    other = mesh.neighbours[t, side]
    jump = np.hypot(*(slopes[t] - slopes[other]).T)  # across the edge: along it both are the same
    length, both = np.hypot(*mesh.sides[t, side].T), mesh.areas[t] + mesh.areas[other]
    expected = np.sum(jump**2 * 0.75 * length**2 / both) / (8 * np.pi)
    np.testing.assert_allclose(np.sum((rows @ values) ** 2), expected, rtol=1e-6)


def test_placed_control_points_are_three_or_a_grid_around_the_data():
    points = np.random.default_rng(0).uniform([0, 0], [640, 480], (90, 2))
    assert PiecewiseAffine.counts(covered_region(points), 20) == [3, 4, 6, 9, 12, 16, 20]
    for count in (3, 4, 9, 20):
        hats = PiecewiseAffine(PiecewiseAffine.place(points, count))
        assert (hats.basis(points) > -1e-12).all()


def test_points_in_a_crowd_of_tiny_triangles_are_found():
    centres = np.vstack([equilateral(40, 60) / 5000, [[1.0, 0], [0, 1.0], [-1.0, -1.0]]])
    points = np.random.default_rng(2).uniform(0, 0.008, (2000, 2))
    assert (located(centres, points) >= 0).all()
    weights = PiecewiseAffine(centres).basis(points[:200])
    assert weights.min() > -1e-9
    np.testing.assert_allclose(weights @ centres, points[:200], atol=1e-9)


@pytest.mark.parametrize(
    ("unit", "shift"), [(1e-6, 0.0), (1e-3, 0.0), (3.0, 0.0), (1e60, 0.0), (1.0, 0.1), (10.0, 77.7)]
)
def test_the_cells_of_a_grid_are_cut_the_same_way_in_every_unit_and_from_every_origin(unit, shift):
    points = np.random.default_rng(0).uniform(0, 640, (60, 2))
    here, there = (Triangulation(PiecewiseAffine.place(at, 56)) for at in (points, unit * (points + shift)))
    np.testing.assert_array_equal(there.corners, here.corners)
    diagonals = here.sides[(np.abs(here.sides) > 1e-6).all(axis=2)]
    assert len(diagonals) == 2 * 6 * 7
    assert len(np.unique(np.sign(diagonals.prod(axis=1)))) == 1


def solutions(centres, parameters, position):
    """Points of all triangles, one by one, whose image is a position, and their denominators."""
    found = []
    for corners in Triangulation(centres).corners:
        numerators, denominators = parameters[corners, :2], parameters[corners, 2]
        system = np.vstack([(numerators - position * denominators[:, None]).T, np.ones(3)])
        shares = np.linalg.solve(system, [0.0, 0.0, 1.0])
        if (shares >= 0).all():
            found.append((shares @ centres[corners], shares @ denominators))
    return found


@pytest.mark.parametrize("bend", [0.1, 1.5])
@pytest.mark.parametrize("front", [1.0, -1.0])
@pytest.mark.parametrize("least", [0.01, 0.4])
def test_a_preimage_is_the_only_solution_in_all_triangles(bend, front, least):
    random, centres = np.random.default_rng(7), scattered(40)
    denominators = front * (0.1 * centres[:, :1] - 0.2)  # the horizon is x = 2
    numerators = (centres + random.normal(0, bend, centres.shape)) * denominators
    parameters = np.column_stack([numerators, denominators])
    positions = random.uniform(-2, 12, (400, 2))
    found = PiecewiseAffine(centres).preimages(positions, front * parameters, least)
    counts = []
    for position, point in zip(positions, found, strict=True):
        expected = [at for at, w in solutions(centres, parameters, position) if front * w > least]
        counts.append(len(expected))
        if len(expected) == 1:
            np.testing.assert_allclose(point, expected[0], rtol=0, atol=1e-9)
        else:
            assert np.isnan(point).all()
    assert min(counts.count(0), counts.count(1)) > 20
    assert bend < 1 or counts.count(2) + counts.count(3) > 20


def test_a_corner_and_an_edge_have_one_preimage_and_a_position_that_is_none_has_none():
    centres = grid(7, 5)
    between = (centres[1:] + centres[:-1]) / 2
    positions = np.vstack([centres, between, [[np.nan, 1.0], [np.inf, 1.0], [1e100, -1e100]]])
    found = PiecewiseAffine(centres).preimages(positions, centres, 0.5)
    np.testing.assert_allclose(found[:-3], positions[:-3], rtol=0, atol=1e-12)
    assert np.isnan(found[-3:]).all()
    assert np.isnan(PiecewiseAffine(centres).preimages(positions, 0 * centres, 0.5)).all()


def test_preimages_under_images_that_overlap_much_are_those_of_all_triangles():
    random, centres = np.random.default_rng(0), scattered(3000)
    parameters = np.column_stack([random.normal(0, 1, centres.shape), np.ones(3000)])
    far = parameters[:, :2] @ [np.cos(1), np.sin(1)]
    parameters[far.argmax(), :2] *= 2  # only its own triangles reach there
    tip = parameters[far.argmax(), :2]
    positions = np.vstack([random.normal(0, 1, (8, 2)), tip, 0.8 * tip, 1.1 * tip])
    found = PiecewiseAffine(centres).preimages(positions, parameters[:, :2], 0.5)
    for position, point in zip(positions, found, strict=True):
        expected = [at for at, _ in solutions(centres, parameters, position)]
        if expected and np.ptp(expected, axis=0).max() < 1e-9:
            np.testing.assert_allclose(point, expected[0], rtol=0, atol=1e-9)
        else:
            assert np.isnan(point).all()
    assert np.isnan(found[:8]).all()
    np.testing.assert_allclose(found[8], centres[far.argmax()], rtol=0, atol=1e-9)


@pytest.mark.parametrize("far", [1e9, -1e9, 1e300])
def test_a_far_position_has_no_preimage_and_changes_no_other(far):
    centres = scattered(300)
    denominators = 0.1 * centres[:, :1] - 0.2  # images reach 1e6 times as far as they are wide
    maps = {"plain": centres, "horizon": np.column_stack([centres * denominators, denominators])}
    positions = np.random.default_rng(1).uniform(2.5, 9, (500, 2))
    for name, parameters in maps.items():
        hats = PiecewiseAffine(centres)
        alone = hats.preimages(positions, parameters, 1e-7)
        found = hats.preimages(np.vstack([positions, [[far, far / 3]]]), parameters, 1e-7)
        np.testing.assert_array_equal(found[:-1], alone, err_msg=name)
        assert np.isnan(found[-1]).all()
    np.testing.assert_allclose(PiecewiseAffine(centres).preimages(positions, centres, 1e-7), positions)


@pytest.mark.parametrize("shift", [0.0, 1e3])
def test_a_control_point_is_found_alone_as_among_others(shift):
    centres = circle(50) + shift
    hats = PiecewiseAffine(centres)
    np.testing.assert_allclose(hats.preimages(centres, centres, 0.5), centres, rtol=1e-14, atol=1e-14)
    for near in (0.0, 1e-15, 1e-9):
        for point in centres:
            found = hats.preimages(np.vstack([point, point * (1 - near)]), centres, 0.5)
            np.testing.assert_allclose(found[0], point, rtol=1e-14, atol=1e-14)


def test_integers_and_single_precision_are_parameters_and_positions():
    hats, whole = PiecewiseAffine([[0, 0], [2, 0], [0, 2]]), np.array([[1], [2], [3]])
    points = np.array([[1, 1]])
    for kind in (np.int64, np.float32):
        np.testing.assert_array_equal(hats.values(points.astype(kind), whole.astype(kind)), [[2.5]])
        np.testing.assert_array_equal(hats.slopes(points.astype(kind), whole.astype(kind)), [[[0.5, 1]]])
        corners = np.array([[0, 0], [4, 0], [0, 4]], kind)
        np.testing.assert_array_equal(hats.preimages(points.astype(kind), corners, 0.5), [[0.5, 0.5]])
