import pickle
import re
import threading

import numpy as np
import pytest
from designs import nested_surface_design
from test_io_meshes import read_obj, read_ply
from test_liftings import bordered, kernel, scattered

import mexpress as mx
from mexpress.liftings import ThinPlateSpline
from mexpress.models import files
from mexpress.models.surface import Surface
from mexpress.selection.fit import fit_surface

WIDTH, HEIGHT = 640.0, 480.0
CORNERS = np.array([[0.0, 0.0], [WIDTH, 0.0], [WIDTH, HEIGHT], [0.0, HEIGHT]])
SHAPES = [(), (1,), (2,), (3,), (5,)]


def positions(count, seed=0):
    return np.random.default_rng(seed).uniform(0, 1, (count, 2)) * [WIDTH, HEIGHT]


def control_points(count):
    return scattered(count, seed=7, size=1.0) * [WIDTH, HEIGHT]


def bent(shape=(), count=12, domain=CORNERS):
    """Return a surface whose values, or each of them, are noise about a plane; three are about a sheet."""
    centres, random = control_points(count), np.random.default_rng(4)
    plane = centres @ [[0.5, 0.1, 1.0, 0, 0], [0.1, 0.5, -0.5, 1, 0]]
    values = plane[:, : shape[0]] if shape else plane[:, 2]
    return Surface(ThinPlateSpline(centres), values + 20 * random.normal(size=(count, *shape)), domain)


SURFACES = [bent(shape) for shape in SHAPES]
SPACE = [bent(), bent((1,)), bent((3,))]


# Fits


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("count", [3, 4, 15])
def test_exact_data_recover_the_surface(shape, count):
    truth, points = bent(shape, count), positions(200)
    fitted = fit_surface(points, truth(points), truth.control_points)
    assert fitted.parameters.shape == (count, *shape)
    np.testing.assert_allclose(fitted.parameters, truth.parameters, rtol=0, atol=1e-9)
    np.testing.assert_allclose(fitted(positions(99, 5)), truth(positions(99, 5)), rtol=0, atol=1e-9)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_fit_is_that_of_least_squares_on_the_textbook_columns(shape):
    points, centres = positions(150) / 100, control_points(9) / 100
    values = np.random.default_rng(1).normal(size=(150, *shape))
    side = np.column_stack([np.ones(9), centres])
    free = np.linalg.svd(side.T)[2][3:].T  # weights that affine functions do not see
    columns = np.column_stack([np.ones(150), points, kernel(points, centres) @ free])
    expected = columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
    np.testing.assert_allclose(fit_surface(points, values, centres)(points), expected, rtol=0, atol=1e-10)


def test_a_surface_has_its_parameters_at_its_control_points_and_is_the_spline_of_them():
    for surface in SURFACES:
        at_centres = surface(surface.control_points)
        np.testing.assert_allclose(at_centres, surface.parameters, rtol=0, atol=1e-9)
    surface, points = SURFACES[0], positions(30) / 100
    weights, affine = bordered(surface.control_points / 100, surface.parameters)
    expected = kernel(points, surface.control_points / 100) @ weights + affine[0] + points @ affine[1:]
    np.testing.assert_allclose(surface(100 * points), expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("count", [3, 4, 9, 25])
def test_leading_columns_of_the_design_fit_the_surface_of_the_leading_control_points(shape, count):
    points, centres = positions(300), control_points(25)
    values = np.random.default_rng(1).normal(size=(300, *shape)) + 10 * np.sin(points[:, :1] / 90).reshape(
        300, *len(shape) * [1]
    )
    design = nested_surface_design(points, values, centres)
    model = mx.LeastSquares(design.A[:, :count], design.b, coupling=design.coupling)
    surface, expected = (
        design.model(model.coefficients, count),
        fit_surface(points, values, centres[:count]),
    )
    np.testing.assert_allclose(surface.parameters, expected.parameters, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(surface.domain, expected.domain)
    np.testing.assert_allclose(values - surface(points), model.residuals, rtol=0, atol=1e-9)
    padded = np.concatenate([model.coefficients, np.zeros((25 - count, *shape))])
    np.testing.assert_array_equal(design.model(padded, count).parameters, surface.parameters)


def test_the_bending_of_a_design_is_that_of_its_surfaces():
    points, centres = positions(100), control_points(12)
    design = nested_surface_design(points, points[:, 0], centres)
    x = np.random.default_rng(2).normal(size=12)
    for count in (3, 4, 12):
        surface = design.model(x, count)
        rows = ThinPlateSpline(surface.control_points).bending()
        expected = np.sum((rows @ surface.parameters) ** 2)
        energy = np.sum((design.bending()[: count - 3, :count] @ x[:count]) ** 2)
        np.testing.assert_allclose(energy, expected, rtol=1e-8)


def test_smoothing_by_the_rows_of_bending_is_the_same_in_both_coordinates():
    points, centres = positions(100), control_points(12)
    values = np.sin(points[:, 0] / 70) + 0.3 * np.random.default_rng(2).normal(size=100)
    design, spline, weight = nested_surface_design(points, values, centres), ThinPlateSpline(centres), 2000.0
    nested = mx.LeastSquares(design.A, design.b, penalty=weight * design.bending())
    cardinal = mx.LeastSquares(spline.basis(points), values, penalty=weight * spline.bending())
    free = mx.LeastSquares(design.A, values)
    assert np.abs(nested.residuals - free.residuals).max() > 1e-2
    np.testing.assert_allclose(nested.residuals, cardinal.residuals, rtol=0, atol=1e-9)
    surface = design.model(nested.coefficients, 12)
    np.testing.assert_allclose(surface.parameters, cardinal.coefficients, rtol=0, atol=1e-9)


@pytest.mark.parametrize(("size", "offset"), [(1e-3, 0.0), (100.0, 5e6), (1e100, 0.0)])
@pytest.mark.parametrize("shape", [(), (3,)])
def test_neither_the_unit_nor_the_place_of_the_points_matters(size, offset, shape):
    points, centres, queries = positions(80) / WIDTH, control_points(9) / WIDTH, positions(50, 3) / WIDTH
    values = np.random.default_rng(1).normal(size=(80, *shape))
    expected, moved = (
        fit_surface(points, values, centres),
        fit_surface(size * points + offset, values, size * centres + offset),
    )
    at = size * queries + offset
    np.testing.assert_allclose(moved(at), expected(queries), rtol=0, atol=1e-7)
    np.testing.assert_allclose(size * moved.derivatives(at), expected.derivatives(queries), rtol=0, atol=1e-6)
    grid, same = moved.grid(shape=(17, 23)), expected.grid(shape=(17, 23))
    np.testing.assert_array_equal(grid.inside, same.inside)
    np.testing.assert_allclose(grid.values, same.values, rtol=0, atol=1e-7)
    assert 0.9e4 < moved.grid().inside.sum() < 1.1e4
    count = len(expected.grid(shape=(9, 9)).triangles)
    assert len(nested_surface_design(size * points + offset, values, size * centres + offset).A) == 80
    assert len(moved.grid(shape=(9, 9)).triangles) == count


@pytest.mark.parametrize("value", [0.0, 7.0, -1e100, 1e300])
def test_constant_values_give_constant_surfaces(value):
    surface = fit_surface(positions(50), np.full(50, value), control_points(8))
    np.testing.assert_allclose(surface(positions(20, 1)), value, rtol=1e-12)
    np.testing.assert_allclose(surface.derivatives(positions(20, 1)), 0, atol=1e-14 * max(abs(value), 1))


@pytest.mark.parametrize(("data", "count"), [(3, 4), (8, 9), (20, 30)])
def test_too_few_data_are_an_error_with_their_rank(data, count):
    with pytest.raises(
        ValueError, match=r"Invalid control_points\. The data must determine .* rank \d+ in all\."
    ):
        fit_surface(positions(data), np.ones(data), control_points(count))


def test_repeated_data_do_not_determine_a_surface_but_repeats_beside_enough_do():
    with pytest.raises(ValueError, match=r"Invalid control_points\. The data must determine"):
        fit_surface(np.repeat(positions(5), 10, axis=0), np.ones(50), control_points(9))
    points = np.repeat(positions(30), 2, axis=0)
    values = np.random.default_rng(0).normal(size=60)
    means = fit_surface(points[::2], values.reshape(30, 2).mean(axis=1), control_points(6))
    np.testing.assert_allclose(
        fit_surface(points, values, control_points(6)).parameters, means.parameters, atol=1e-10
    )


# Values, derivatives and normals


@pytest.mark.parametrize("surface", SURFACES, ids=repr)
def test_values_and_derivatives_have_the_shape_of_the_data(surface):
    shape = surface.parameters.shape[1:]
    assert surface([[3, 4]]).shape == (1, *shape)
    assert surface(positions(9)).shape == (9, *shape)
    assert surface.derivatives(positions(9)).shape == (9, *shape, 2)


@pytest.mark.parametrize("surface", SURFACES, ids=repr)
def test_derivatives_are_the_limits_of_differences(surface):
    points, step = positions(50), 1e-2
    for b, shift in enumerate(step * np.eye(2)):
        difference = (surface(points + shift) - surface(points - shift)) / (2 * step)
        np.testing.assert_allclose(surface.derivatives(points)[..., b], difference, rtol=0, atol=1e-6)


@pytest.mark.parametrize("surface", SPACE, ids=repr)
def test_normals_are_the_cross_products_of_tangents(surface):
    points, step = positions(50), 1e-3

    def lifted(q):
        return surface(q) if surface.parameters.shape[1:] == (3,) else np.column_stack([q, surface(q)])

    along, up = (lifted(points + shift) - lifted(points - shift) for shift in step * np.eye(2))
    normals, cross = surface.normals(points), np.cross(along, up)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-14)
    np.testing.assert_allclose(normals, cross / np.linalg.norm(cross, axis=1)[:, None], rtol=0, atol=1e-5)
    if surface is not SPACE[2]:
        assert (normals[:, 2] > 0).all()


@pytest.mark.parametrize("factor", [1e-200, 1e-30, 1e30, 1e200])
def test_normals_of_points_in_space_do_not_depend_on_their_unit(factor):
    surface, points = SPACE[2], positions(50)
    scaled = Surface(surface.lifting, factor * surface.parameters, CORNERS)
    np.testing.assert_allclose(scaled.normals(points), surface.normals(points), rtol=0, atol=1e-10)


@pytest.mark.filterwarnings("error")
def test_a_surface_in_space_that_is_a_line_has_no_normals():
    line = fit_surface(CORNERS, CORNERS[:, :1] * [1, 2, 3.0], CORNERS[:3])
    point = fit_surface(CORNERS, np.zeros((4, 3)), CORNERS[:3])
    assert np.isnan(point.normals(positions(5))).all()
    exact = Surface(ThinPlateSpline(CORNERS[:3]), np.zeros((3, 3)), CORNERS)
    assert np.isnan(exact.normals(positions(5))).all()
    assert line.normals(positions(5)).shape == (5, 3)


@pytest.mark.parametrize("surface", [bent((2,)), bent((5,))], ids=repr)
def test_only_depths_and_points_in_space_have_normals_and_meshes(surface, tmp_path):
    with pytest.raises(ValueError, match=r"Invalid surface\. It must have one value, .* Given [25] values\."):
        surface.normals(positions(5))
    with pytest.raises(ValueError, match=r"Invalid surface\. It must have one value, .* Given [25] values\."):
        surface.write_mesh(tmp_path / "a.ply")
    assert surface.grid(step=50).values.ndim == 3


@pytest.mark.filterwarnings("error")
def test_points_absurdly_far_away_raise_no_warning():
    for surface in SPACE:
        for method in (surface, surface.derivatives, surface.normals):
            assert len(method([[1e100, -1e100]])) == 1
    steep = Surface(ThinPlateSpline(control_points(5)), 1e303 * np.array([1.0, -1, 1, -1, 1]), CORNERS)
    assert not np.isfinite(steep([[1e100, 0]])).any()
    assert np.isfinite(steep.normals(positions(5))).all()


# Grids


@pytest.mark.parametrize("surface", SURFACES, ids=repr)
def test_a_grid_holds_the_surface_inside_and_nothing_outside(surface):
    hull = np.array([[0.0, 0.0], [WIDTH, 40.0], [500.0, HEIGHT], [100.0, 300.0]])
    surface = Surface(surface.lifting, surface.parameters, hull)
    grid = surface.grid(shape=(31, 41))
    np.testing.assert_allclose(grid.x, np.linspace(0, WIDTH, 41), atol=1e-12)
    np.testing.assert_allclose(grid.y, np.linspace(0, HEIGHT, 31), atol=1e-12)
    assert grid.values.shape == (31, 41, *surface.parameters.shape[1:])
    x, y = np.meshgrid(grid.x, grid.y)
    np.testing.assert_array_equal(grid.points, np.column_stack([x.ravel(), y.ravel()]))
    expected = surface(grid.points).reshape(grid.values.shape)
    np.testing.assert_allclose(grid.values[grid.inside], expected[grid.inside], atol=1e-10)
    assert np.isnan(grid.values[~grid.inside]).all()
    assert not np.isnan(grid.values[grid.inside]).any()


def depth_below_edges(corners, points):
    """Distance of points to the nearest edge's line of a convex polygon, negative outside."""
    edges = np.roll(corners, -1, axis=0) - corners
    normals = np.column_stack([-edges[:, 1], edges[:, 0]]) / np.linalg.norm(edges, axis=1)[:, None]
    return np.min(
        [(points - corner) @ normal for corner, normal in zip(corners, normals, strict=True)], axis=0
    )


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("offset", [0.0, 5e6])
def test_inside_is_on_the_left_of_every_edge(seed, offset):
    random = np.random.default_rng(seed)
    cloud = random.normal(size=(random.integers(3, 30), 2)) @ random.normal(size=(2, 2)) + offset
    surface = Surface(ThinPlateSpline(control_points(3)), [1.0, 2, 3], cloud)
    grid = surface.grid(shape=(23, 29))
    depth = depth_below_edges(surface.domain, grid.points)
    assert grid.inside.ravel()[depth > 1e-6].all()
    assert not grid.inside.ravel()[depth < -1e-6].any()


@pytest.mark.parametrize(
    ("corners", "inside"),
    [
        (CORNERS, 25),
        ([[0, 0], [4, 0], [0, 4]], 15),
        ([[4, 4], [4, 0], [0, 4]], 15),
        ([[2, 0], [4, 2], [2, 4], [0, 2]], 13),
        ([[1e-13, 0], [4, 0], [4, 4], [0, 4]], 25),
    ],
)
def test_samples_on_the_edge_are_inside(corners, inside):
    for offset, factor in ((0, 1), (5e6, 10), (-3, 1e97)):
        domain = factor * np.asarray(corners, dtype=float) + offset
        grid = Surface(ThinPlateSpline(control_points(3)), [1.0, 2, 3], domain).grid(shape=(5, 5))
        assert grid.inside.sum() == inside


def area(points, triangles):
    (ax, ay), (bx, by), (cx, cy) = points[triangles].transpose(1, 2, 0)
    return 0.5 * ((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))


@pytest.mark.parametrize("seed", range(5))
def test_triangles_cover_the_domain_once_and_turn_left(seed):
    cloud = np.random.default_rng(seed).normal(size=(40, 2))
    surface = Surface(ThinPlateSpline(control_points(4)), [1.0, 2, 3, 5], cloud)
    grid = surface.grid(step=0.02)
    areas = area(grid.points, grid.triangles)
    assert (areas > 0).all()
    hull = surface.domain
    fan = np.column_stack(
        [np.zeros(len(hull) - 2, int), np.arange(1, len(hull) - 1), np.arange(2, len(hull))]
    )
    assert 0.97 < areas.sum() / area(hull, fan).sum() <= 1 + 1e-9
    assert grid.inside.ravel()[grid.triangles].all()
    edges = np.vstack([grid.triangles[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
    assert len(np.unique(edges, axis=0)) == len(edges)  # no edge twice in one direction


def test_steps_start_at_the_corner_and_keep_their_length():
    grid = bent().grid(step=100)
    np.testing.assert_allclose(grid.x, np.arange(0, 601, 100))
    np.testing.assert_allclose(grid.y, np.arange(0, 401, 100))
    shifted = Surface(
        ThinPlateSpline(control_points(3)), [1.0, 2, 3], [[0.1, 0.2], [0.4, 0.2], [0.4, 0.5], [0.1, 0.5]]
    ).grid(step=0.1)
    np.testing.assert_allclose(shifted.x, [0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose(shifted.y, [0.2, 0.3, 0.4, 0.5])
    assert shifted.inside.all()


@pytest.mark.parametrize("width", [1.0, 1e-1, 1e-2, 1e-4, 2e-6])
def test_a_slanted_strip_is_sampled_too(width):
    along, across = np.array([1, 1.0]), width * np.array([-1, 1.0])
    grid = Surface(
        ThinPlateSpline(control_points(3)), [1.0, 2, 3], [0 * along, along, along + across, across]
    ).grid()
    assert grid.inside.size <= 1.1e6
    if width >= 1e-2:
        assert 0.8e4 < grid.inside.sum() < 1.2e4
        assert area(grid.points, grid.triangles).sum() > 0.8 * 2 * width


def test_grids_describe_themselves():
    assert repr(bent().grid(step=100)) == "SurfaceGrid(5 x 7, 35 inside, 48 triangles)"


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"step": 0}, "step"),
        ({"step": -1.0}, "step"),
        ({"step": np.nan}, "step"),
        ({"step": "1"}, "step"),
        ({"step": 1e-3}, "step"),
        ({"step": 1e3}, "step"),
        ({"step": 1e-320}, "step"),
        ({"shape": 5}, "shape"),
        ({"shape": "55"}, "shape"),
        ({"shape": (5,)}, "shape"),
        ({"shape": (5, 5, 5)}, "shape"),
        ({"shape": (1, 5)}, "shape[0]"),
        ({"shape": (5, 2.5)}, "shape[1]"),
        ({"shape": (10**5, 10**5)}, "shape"),
        ({"shape": (10**400, 2)}, "shape[0]"),
        ({"shape": (5, 5), "step": 1.0}, "shape"),
    ],
)
def test_grids_that_are_none_are_refused(arguments, name, tmp_path):
    for call in (bent().grid, lambda **kw: bent().write_mesh(tmp_path / "a.ply", **kw)):
        with pytest.raises((ValueError, TypeError), match=rf"Invalid {re.escape(name)}\. .* Given "):
            call(**arguments)
    assert not list(tmp_path.iterdir())


# Meshes


HULL = np.array([[20.0, 10.0], [WIDTH, 40.0], [500.0, HEIGHT], [100.0, 300.0]])


@pytest.mark.parametrize("ending", [".ply", ".obj", ".PLY"])
@pytest.mark.parametrize("shape", [(), (1,), (3,)])
def test_a_mesh_is_the_surface_over_its_domain(shape, ending, tmp_path):
    surface, path = bent(shape, domain=HULL), tmp_path / f"mesh{ending}"
    surface.write_mesh(path, step=25)
    grid = surface.grid(step=25)
    if ending == ".obj":
        numbers, faces = read_obj(path)
        vertices, normals, triangles = numbers["v"], numbers["vn"], faces[:, :, 0]
    else:
        columns, triangles = read_ply(path)
        vertices, normals = (
            np.column_stack([columns[name] for name in names]) for names in ("xyz", ["nx", "ny", "nz"])
        )
    assert sorted(np.unique(triangles)) == list(range(len(vertices)))
    assert len(triangles) == len(grid.triangles)
    used = np.unique(grid.triangles)
    points = grid.points[used]
    values = surface(points)
    expected = values if shape == (3,) else np.column_stack([points, values])
    np.testing.assert_allclose(vertices, expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(normals, surface.normals(points), rtol=0, atol=1e-6)
    np.testing.assert_array_equal(used[triangles], grid.triangles)
    assert depth_below_edges(surface.domain, points).min() > -1e-6
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    facing = np.cross(b - a, c - a)
    agreement = np.einsum("tk,tk->t", facing, normals[triangles[:, 0]])
    assert (agreement > 0).mean() > 0.99  # all but where the surface bends within one step
    if shape != (3,):
        assert (facing[:, 2] > 0).all()
        assert (normals[:, 2] > 0).all()


def test_the_texture_of_points_in_space_has_its_origin_at_the_lower_left(tmp_path):
    bent((3,)).write_mesh(tmp_path / "a.obj", shape=(3, 3))
    numbers, faces = read_obj(tmp_path / "a.obj")
    expected = [[x, 1 - y] for y in (0, 0.5, 1) for x in (0, 0.5, 1)]
    np.testing.assert_allclose(numbers["vt"], expected, atol=1e-12)
    np.testing.assert_array_equal(faces[:, :, 1], faces[:, :, 0])
    bent().write_mesh(tmp_path / "b.obj", shape=(3, 3))
    assert len(read_obj(tmp_path / "b.obj")[0]["vt"]) == 0


def test_coordinates_of_maps_keep_their_digits(tmp_path):
    points = positions(50) / 6 + [5.1e5, 5.3e6]
    fit_surface(points, points[:, 0] - 5.1e5, points[:5]).write_mesh(tmp_path / "a.ply", step=0.5)
    x = np.unique(read_ply(tmp_path / "a.ply")[0]["x"])
    np.testing.assert_allclose(np.diff(x), 0.5, atol=1e-6)


def test_undefined_normals_are_zeros_in_a_mesh(tmp_path):
    Surface(ThinPlateSpline(CORNERS[:3]), np.zeros((3, 3)), CORNERS).write_mesh(tmp_path / "a.ply", step=100)
    assert not read_ply(tmp_path / "a.ply")[0]["nx"].any()


@pytest.mark.parametrize("name", ["mesh.stl", "mesh", "ply", ".ply.gz", ""])
def test_other_endings_are_refused(name, tmp_path):
    with pytest.raises(ValueError, match=r"Invalid path\. It must end in \.ply or \.obj\. Given "):
        bent().write_mesh(tmp_path / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("option", "value"), [("step", 400.0), ("shape", (2, 2))])
def test_a_grid_too_coarse_for_a_triangle_is_refused(option, value, tmp_path):
    surface = bent(domain=[[0, 240], [320, 0], [640, 240], [320, 480]])
    with pytest.raises(ValueError, match=rf"Invalid {option}\. .* no triangle is inside the domain\. Given "):
        surface.write_mesh(tmp_path / "a.ply", **{option: value})


@pytest.mark.parametrize("ending", [".ply", ".obj"])
def test_a_mesh_replaces_the_file_and_failing_leaves_it(ending, tmp_path, monkeypatch):
    path = tmp_path / f"mesh{ending}"
    path.write_bytes(b"older")

    def fail(*_):
        raise OSError("disk full")

    with monkeypatch.context() as patched:
        patched.setattr(type(path), "replace", fail)
        with pytest.raises(OSError, match="disk full"):
            bent().write_mesh(path)
    assert path.read_bytes() == b"older"
    assert len(list(tmp_path.iterdir())) == 1
    bent().write_mesh(str(path), step=50)
    assert len(path.read_bytes()) > 1000
    assert len(list(tmp_path.iterdir())) == 1


# What a model owes its user


@pytest.mark.parametrize("surface", SURFACES, ids=repr)
def test_a_saved_surface_is_read_back_bit_for_bit(surface, tmp_path):
    path = tmp_path / "model.surface"
    surface.save(path)
    copy = mx.load(str(path))
    assert type(copy) is Surface
    for name in ("parameters", "domain", "control_points"):
        np.testing.assert_array_equal(getattr(copy, name), getattr(surface, name))
    np.testing.assert_array_equal(copy(positions(20)), surface(positions(20)))
    assert repr(copy) == repr(surface)
    assert [entry.name for entry in tmp_path.iterdir()] == ["model.surface"]


@pytest.mark.parametrize("surface", SURFACES, ids=repr)
def test_a_pickled_surface_is_the_same_and_remembers_no_more(surface):
    before = pickle.dumps(Surface(surface.lifting, surface.parameters, surface.domain))
    expected = surface(positions(20))
    assert pickle.dumps(surface) == before
    copy = pickle.loads(before)
    np.testing.assert_array_equal(copy(positions(20)), expected)
    assert not copy.parameters.flags.writeable


def test_the_domain_is_the_hull_of_the_data_and_survives_a_file(tmp_path):
    points = np.round(positions(2000), 1)
    surface = fit_surface(points, points[:, 0], control_points(5))
    assert len(surface.domain) < 50
    surface.save(tmp_path / "a")
    np.testing.assert_array_equal(mx.load(tmp_path / "a").domain, surface.domain)


@pytest.mark.parametrize(
    "change",
    [
        {"parameters": np.ones(3)},
        {"parameters": np.ones((12, 2, 2))},
        {"parameters": np.full(12, np.nan)},
        {"control_points": np.ones((12, 2))},
        {"control_points": np.array("abc")},
        {"domain": np.ones((2, 2))},
        {"parameters": None},
    ],
)
def test_models_that_contradict_themselves_are_an_error(change, tmp_path):
    arrays = {"format": "mexpress model", "version": 1, "kind": "surface", **bent().to_arrays(), **change}
    with (tmp_path / "bad").open("wb") as file:
        np.savez(file, **{name: array for name, array in arrays.items() if array is not None})
    with pytest.raises(ValueError, match=r"Invalid path\. It must name a saved model or selection\. Given "):
        mx.load(tmp_path / "bad")


def test_surfaces_are_a_kind_of_model():
    assert files.KINDS["surface"] is Surface is mx.Surface


def test_surfaces_say_what_they_are():
    assert repr(bent()) == "Surface(depth, tps, 12 control points)"
    assert repr(bent((1,))) == "Surface(depth, tps, 12 control points)"
    assert repr(bent((5,), 3)) == "Surface(5 values, tps, 3 control points)"
    design = nested_surface_design(positions(9), np.ones(9), control_points(4))
    assert repr(design) == "LinearDesign(9 x 4, NestedBasis(4 control points))"


def test_a_surface_does_not_change_with_the_arrays_it_was_made_from():
    centres, parameters, domain = control_points(5), np.arange(5.0), CORNERS.copy()
    surface = Surface(ThinPlateSpline(centres), parameters, domain)
    for array in (centres, parameters, domain):
        array[:] = 0
    np.testing.assert_array_equal(surface.parameters, np.arange(5.0))
    np.testing.assert_array_equal(surface.control_points, control_points(5))
    np.testing.assert_array_equal(surface.domain, CORNERS)
    for name in ("control_points", "parameters", "domain"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(surface, name)[0] = 1


def test_threads_share_a_surface():
    shared, points, results = bent(), positions(3000), {}
    expected = bent()(points)
    workers = [threading.Thread(target=lambda k=k: results.update({k: shared(points)})) for k in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert len(results) == 4
    for result in results.values():
        np.testing.assert_array_equal(result, expected)


# Hostile input

NO_QUERIES = [
    [0, 1],
    [[0, 1, 2]],
    [["a", "b"]],
    "points",
    None,
    [[1, 2], [3]],
    [],
    np.ones((3, 2), dtype=complex),
]
NONE_POINTS = [*NO_QUERIES, [[0, np.nan]], [[np.inf, 0]], np.empty((0, 2)), [[1e101, 0]]]


@pytest.mark.parametrize("points", NO_QUERIES)
@pytest.mark.parametrize("method", ["__call__", "derivatives", "normals"])
def test_points_that_are_none_are_refused(method, points):
    with pytest.raises((ValueError, TypeError), match=r"Invalid points\. .* Given "):
        getattr(bent(), method)(points)


@pytest.mark.parametrize("fit", [fit_surface, nested_surface_design])
@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("points", points) for points in NONE_POINTS),
        ("points", [[k, k] for k in range(9)]),
        ("points", [[1, 2]] * 9),
        ("values", np.ones(8)),
        ("values", np.ones((2, 9))),
        ("values", np.ones((9, 2, 2))),
        ("values", np.ones((9, 0))),
        ("values", [1.0] * 8 + [np.nan]),
        ("values", ["a"] * 9),
        ("values", np.ma.masked_equal(np.arange(9), 3)),
        ("values", None),
        ("control_points", [[0, 0], [1, 1], [2, 2]]),
        ("control_points", [[0, 0], [1, 0], [0, 1], [1, 0]]),
        ("control_points", [[0, 0]]),
        ("control_points", 5),
        ("control_points", [[0, 0], [1, 0], [0, np.inf]]),
        ("control_points", "abc"),
    ],
)
def test_data_that_are_none_are_refused(fit, name, value):
    arguments = {
        "points": positions(9),
        "values": np.ones(9),
        "control_points": control_points(3),
        name: value,
    }
    other = "values" if name == "points" else name  # as many values as points, whatever these are
    with pytest.raises((ValueError, TypeError), match=rf"Invalid ({name}|{other})\. .* Given "):
        fit(**arguments)


def test_control_points_that_begin_on_a_line_suit_a_fit_but_no_sweep():
    points, centres = positions(50), np.array([[0, 0], [100, 100], [200, 200], [0, 300.0]])
    assert np.isfinite(fit_surface(points, points[:, 0], centres).parameters).all()
    with pytest.raises(ValueError, match=r"Invalid control_points\. The first three must not lie on a line"):
        nested_surface_design(points, points[:, 0], centres)


@pytest.mark.parametrize(
    ("parameters", "domain", "name"),
    [
        (np.ones(11), CORNERS, "parameters"),
        (np.ones((12, 0)), CORNERS, "parameters"),
        (np.ones((12, 2, 1)), CORNERS, "parameters"),
        (np.full(12, np.nan), CORNERS, "parameters"),
        ("abc", CORNERS, "parameters"),
        (np.ones(12), CORNERS[:2], "domain"),
        (np.ones(12), None, "domain"),
    ],
)
def test_parts_that_do_not_make_a_surface_are_refused(parameters, domain, name):
    with pytest.raises((ValueError, TypeError), match=rf"Invalid {name}\. .* Given "):
        Surface(ThinPlateSpline(control_points(12)), parameters, domain)


@pytest.mark.parametrize("shape", [(), (3,)])
def test_every_layout_of_the_same_numbers_gives_the_same(shape):
    points, centres = positions(30).round(), control_points(5).round()
    values = np.random.default_rng(0).normal(size=(30, *shape)).round(1).astype(np.float32).astype(float)
    expected = fit_surface(points, values, centres).parameters
    read_only, wide = values.copy(), np.empty((60, *shape))
    read_only.flags.writeable = False
    wide[::2] = values
    for same in (values.tolist(), values.astype(np.float32), np.asfortranarray(values), read_only, wide[::2]):
        for place in (
            points.tolist(),
            points.astype(np.float32),
            np.asfortranarray(points),
            points.astype(int),
        ):
            fitted = fit_surface(place, same, centres.tolist()).parameters
            np.testing.assert_array_equal(fitted, expected)
