import pickle
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mexpress.liftings import (
    LIFTINGS,
    ThinPlateSpline,
    make_lifting,
    nested_basis,
    nested_bending,
)


def scattered(count, seed=0, size=1000.0):
    """Points of a jittered grid: spread, and never near a line."""
    side = int(np.ceil(np.sqrt(count)))
    random = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(*2 * [np.arange(side)]), axis=-1).reshape(-1, 2)
    return size / side * (random.permutation(grid)[:count] + random.uniform(0.2, 0.8, (count, 2)))


def kernel(a, b):
    r = np.linalg.norm(a[:, None] - b, axis=2)
    return r**2 * np.log(np.where(r > 0, r, 1))


def bordered(centres, values):
    """Weights and affine part from the textbook system [[K, P], [P^T, 0]]."""
    affine = np.column_stack([np.ones(len(centres)), centres])
    system = np.block([[kernel(centres, centres), affine], [affine.T, np.zeros((3, 3))]])
    solution = np.linalg.solve(system, np.concatenate([values, np.zeros(3)]))
    return solution[:-3], solution[-3:]


@pytest.mark.parametrize("count", [3, 4, 5, 9, 30])
def test_the_functions_are_those_of_the_bordered_system(count):
    centres, queries = scattered(count, size=3.0), scattered(40, seed=1, size=3.0)
    values = np.random.default_rng(2).normal(size=count)
    weights, affine = bordered(centres, values)
    expected = kernel(queries, centres) @ weights + affine[0] + queries @ affine[1:]
    np.testing.assert_allclose(ThinPlateSpline(centres).basis(queries) @ values, expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("count", [3, 4, 17, 100])
def test_parameters_are_values_at_the_control_points(count):
    centres = scattered(count)
    np.testing.assert_allclose(ThinPlateSpline(centres).basis(centres), np.eye(count), atol=1e-11)


@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_affine_functions_are_reproduced_also_far_from_the_origin(offset):
    centres, queries = offset + scattered(40), offset + scattered(500, seed=1, size=1500.0)

    def plane(q):
        return 3 + (q - offset) @ [0.5, -2.0]

    np.testing.assert_allclose(
        ThinPlateSpline(centres).basis(queries) @ plane(centres), plane(queries), atol=1e-7
    )
    np.testing.assert_allclose(ThinPlateSpline(centres).basis(queries).sum(axis=1), 1, atol=1e-11)


@given(
    st.floats(1e-3, 1e3), st.floats(-np.pi, np.pi), st.floats(-1e4, 1e4), st.booleans(), st.integers(3, 25)
)
def test_a_similarity_of_the_points_changes_nothing(scale, angle, shift, mirrored, count):
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    similarity = scale * rotation @ np.diag([1, -1 if mirrored else 1])
    centres, queries = scattered(count, size=1.0), scattered(30, seed=1, size=1.0)
    expected = ThinPlateSpline(centres).basis(queries)
    moved = ThinPlateSpline(centres @ similarity.T + scale * shift).basis(
        queries @ similarity.T + scale * shift
    )
    np.testing.assert_allclose(moved, expected, atol=1e-8)


@pytest.mark.parametrize("count", [3, 8, 25])
def test_derivatives_are_the_limits_of_differences(count):
    spline, queries, step = ThinPlateSpline(scattered(count)), scattered(50, seed=1, size=1200.0), 1e-2
    for b, shift in enumerate(step * np.eye(2)):
        difference = (spline.basis(queries + shift) - spline.basis(queries - shift)) / (2 * step)
        np.testing.assert_allclose(spline.derivatives(queries)[:, :, b], difference, atol=1e-8)


def test_derivatives_are_continuous_at_the_control_points():
    spline = ThinPlateSpline(scattered(9))
    beside = spline.derivatives(spline.control_points + 1e-7)
    np.testing.assert_allclose(spline.derivatives(spline.control_points), beside, atol=1e-10)


@pytest.mark.parametrize("count", [3, 4, 12, 40])
def test_bending_energy_is_that_of_the_kernel(count):
    centres, values = scattered(count, size=7.0), np.random.default_rng(3).normal(size=count)
    rows = ThinPlateSpline(centres).bending()
    weights, _ = bordered(centres, values)
    assert rows.shape == (count - 3, count)
    np.testing.assert_allclose(
        np.sum((rows @ values) ** 2), weights @ kernel(centres, centres) @ weights, atol=1e-9
    )


def test_bending_energy_belongs_to_the_function_not_to_its_control_points():
    few, many = scattered(6), np.vstack([scattered(6), scattered(20, seed=5) + 7])
    values = np.random.default_rng(3).normal(size=6)
    same = ThinPlateSpline(few).basis(many) @ values
    expected = np.sum((ThinPlateSpline(few).bending() @ values) ** 2)
    np.testing.assert_allclose(np.sum((ThinPlateSpline(many).bending() @ same) ** 2), expected, rtol=1e-8)


def test_eight_pi_times_the_bending_energy_is_the_integral_of_squared_second_derivatives():
    spline, step = ThinPlateSpline([[0, 0], [1, 0], [0, 1], [1, 1]]), 0.05
    axis = np.arange(-25, 26, step)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1)
    slope = spline.slopes(grid.reshape(-1, 2), np.array([[0.0], [0], [0], [1]])).reshape(*grid.shape[:2], 2)
    second = [np.diff(slope, axis=a)[: len(axis) - 1, : len(axis) - 1] / step for a in (0, 1)]
    integral = sum(np.sum(s**2) for s in second) * step**2
    energy = np.sum((spline.bending() @ [0, 0, 0, 1]) ** 2)
    np.testing.assert_allclose(integral, 8 * np.pi * energy, rtol=0.02)


def test_values_and_slopes_are_the_basis_times_the_parameters_at_every_block():
    spline, points = ThinPlateSpline(scattered(60)), scattered(5000, seed=1)
    parameters = np.random.default_rng(0).normal(size=(60, 3))
    np.testing.assert_allclose(
        spline.values(points, parameters), spline.basis(points) @ parameters, atol=1e-11
    )
    expected = np.einsum("nlb,lr->nrb", spline.derivatives(points), parameters)
    np.testing.assert_allclose(spline.slopes(points, parameters), expected, atol=1e-12)


def test_many_points_take_little_memory():
    spline, points = ThinPlateSpline(scattered(100)), scattered(100_000, seed=1)
    tracemalloc.start()
    spline.values(points, np.ones((100, 3)))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20e6  # n x l would be 80 MB


@pytest.mark.parametrize("near", [0.0, 1e-6])
def test_coincident_control_points_are_an_error_that_names_them(near):
    with pytest.raises(ValueError, match=r"Invalid control_points.* at 1 and .* at 4"):
        ThinPlateSpline([[0, 0], [1, 0], [0, 1], [1, 1], [1 + near, 0]])


@pytest.mark.parametrize("tilt", [0.0, 1e-9])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_control_points_on_a_line_are_an_error_at_any_scale(tilt, scale):
    x = np.arange(5.0)
    with pytest.raises(ValueError, match=r"Invalid control_points\. They must not lie on a line"):
        ThinPlateSpline(scale * np.column_stack([x, 3 * x + tilt * x**2]))


def test_a_thin_strip_is_no_line():
    centres = scattered(9) * [1, 1e-4]
    np.testing.assert_allclose(ThinPlateSpline(centres).basis(centres), np.eye(9), atol=1e-8)


@pytest.mark.parametrize(
    "control_points",
    [
        [],
        [[0, 0]],
        [[0, 0], [1, 0]],
        [[0, 0]] * 3,
        [[0, 0], [1, 0], [0, np.nan]],
        [[0, 0], [1, 0], [0, np.inf]],
        np.ones((3, 3)),
        np.ones(6),
        [["a", "b"]] * 3,
        "points",
        None,
        [[0, 0], [1, 0], [0]],
    ],
)
def test_control_points_that_are_none_are_refused(control_points):
    with pytest.raises((ValueError, TypeError), match=r"Invalid control_points\. .* Given "):
        ThinPlateSpline(control_points)


@pytest.mark.parametrize("method", ["basis", "derivatives"])
@pytest.mark.parametrize("points", [[[0, np.nan]], [[np.inf, 0]], [0, 1], [[0, 1, 2]], [["a", "b"]], None])
def test_points_that_are_none_are_refused(method, points):
    with pytest.raises((ValueError, TypeError), match=r"Invalid points\. .* Given "):
        getattr(ThinPlateSpline(scattered(5)), method)(points)


@pytest.mark.filterwarnings("error")
def test_points_absurdly_far_away_are_refused_and_raise_no_warning():
    spline = ThinPlateSpline(scattered(5))
    assert np.isfinite(spline.basis([[1e100, 0.0]])).all()
    with pytest.raises(
        ValueError, match=r"Invalid points\. Coordinates must not exceed 1e\+100\. Given 1e\+300\."
    ):
        spline.basis([[1e300, 0.0]])


def test_every_layout_of_the_same_numbers_gives_the_same():
    centres, points = scattered(6).round(), scattered(10, seed=1).round()
    read_only = points.copy()
    read_only.flags.writeable = False
    expected = ThinPlateSpline(centres).basis(points)
    for same in (
        points.tolist(),
        points.astype(np.float32),
        np.asfortranarray(points),
        read_only,
        points.astype(int),
    ):
        np.testing.assert_array_equal(ThinPlateSpline(centres.astype(np.float32)).basis(same), expected)
    wide = np.empty((10, 4))
    wide[:, ::2] = points
    np.testing.assert_array_equal(ThinPlateSpline(centres.tolist()).basis(wide[:, ::2]), expected)


def test_a_lifting_does_not_change_with_the_array_it_was_made_from():
    centres = scattered(5)
    spline = ThinPlateSpline(centres)
    centres[:] = 0
    np.testing.assert_array_equal(spline.control_points, scattered(5))
    with pytest.raises(ValueError, match="read-only"):
        spline.control_points[0, 0] = 1


def test_a_pickled_lifting_is_the_same():
    spline, points = ThinPlateSpline(scattered(7)), scattered(9, seed=1)
    copy = pickle.loads(pickle.dumps(spline))
    np.testing.assert_array_equal(copy.basis(points), spline.basis(points))


def test_no_points_give_no_rows():
    spline, none = ThinPlateSpline(scattered(5)), np.empty((0, 2))
    assert spline.values(none, np.ones((5, 3))).shape == (0, 3)
    assert spline.slopes(none, np.ones((5, 3))).shape == (0, 3, 2)


@pytest.mark.parametrize("name", ["spline", "", None, 3, ["tps"]])
def test_unknown_liftings_are_refused(name):
    with pytest.raises(
        ValueError, match=r"Invalid lifting\. It must be one of affine, bspline, tps, .* Given "
    ):
        make_lifting(name, scattered(4))


def test_every_registered_lifting_reports_its_own_name():
    for name, lifting in LIFTINGS.items():
        made = make_lifting(name, lifting.place(scattered(5), 16))
        assert type(made) is lifting
        assert made.name == name
        assert repr(made) == f"{lifting.__name__}(16 control points)"


# The nested form

FRAMES = {"unit": (1.0, 0.0), "pixels": (1000.0, 0.0), "map": (100.0, 5e6), "huge": (1e100, 0.0)}


def fitted(columns, values):
    scaled = columns / np.linalg.norm(columns, axis=0)
    return scaled @ np.linalg.lstsq(scaled, values, rcond=None)[0]


@pytest.mark.parametrize("frame", FRAMES)
def test_leading_nested_functions_span_the_splines_of_the_leading_control_points(frame):
    size, offset = FRAMES[frame]
    centres, points = size * scattered(60, size=0.9) + offset, size * scattered(400, 1, 0.9) + offset
    values = np.random.default_rng(2).normal(size=(400, 2))
    functions = nested_basis(points, centres)
    for count in (3, 4, 5, 8, 20, 60):
        expected = fitted(ThinPlateSpline(centres[:count]).basis(points), values)
        np.testing.assert_allclose(fitted(functions[:, :count], values), expected, rtol=0, atol=1e-9)


@given(st.integers(0, 10**6), st.integers(3, 20))
def test_nested_functions_are_splines_at_every_point_also_outside(seed, count):
    centres, points = scattered(count, seed, 1.0), scattered(50, seed + 1, 3.0) - 1
    functions, at_centres = nested_basis(points, centres), nested_basis(centres, centres)
    expected = ThinPlateSpline(centres).basis(points) @ at_centres
    scale = 1 + np.abs(functions).max(axis=0) + np.abs(at_centres).max(axis=0)
    np.testing.assert_allclose(functions / scale, expected / scale, rtol=0, atol=1e-9)


def test_nested_functions_do_not_change_with_later_control_points():
    centres, points = scattered(40), scattered(500, seed=1)
    functions = nested_basis(points, centres)
    for count in (3, 4, 17):
        np.testing.assert_array_equal(nested_basis(points, centres[:count]), functions[:, :count])
    np.testing.assert_array_equal(nested_basis(points[:7], centres), functions[:7])


def test_the_first_three_nested_functions_are_barycentric_coordinates():
    centres, points = scattered(5), scattered(30, seed=1)
    weights = nested_basis(points, centres)[:, :3]
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(weights @ centres[:3], points, atol=1e-9)
    np.testing.assert_allclose(nested_basis(centres[:3], centres)[:, :3], np.eye(3), atol=1e-14)


@pytest.mark.parametrize("frame", [name for name in FRAMES if name != "huge"])
def test_leading_rows_of_nested_bending_measure_every_leading_model(frame):
    size, offset = FRAMES[frame]
    centres = size * scattered(40, size=0.9) + offset
    rows, x = nested_bending(centres), np.random.default_rng(3).normal(size=40)
    assert rows.shape == (37, 40)
    assert not np.tril(rows[:, 3:], -1).any()
    assert not rows[:, :3].any()
    for count in range(3, 41):
        leading = centres[:count]
        values = nested_basis(leading, leading) @ x[:count]
        expected = np.sum((ThinPlateSpline(leading).bending() @ values) ** 2)
        energy = np.sum((rows[: count - 3, :count] @ x[:count]) ** 2)
        np.testing.assert_allclose(energy, expected, rtol=1e-7)


def test_nested_bending_is_the_integral_of_squared_second_derivatives():
    centres, step = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [0.4, 0.5]]), 0.05
    axis, x = np.arange(-20, 21, step), [3.0, -1, 2, 1, -0.5]
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    f = (nested_basis(grid, centres) @ x).reshape(len(axis), -1)
    xx, yy = (
        np.diff(f, 2, axis=a)[tuple(np.s_[1:-1] if b != a else np.s_[:] for b in (0, 1))] for a in (0, 1)
    )
    xy = (f[2:, 2:] - f[2:, :-2] - f[:-2, 2:] + f[:-2, :-2]) / 4
    integral = np.sum(xx**2 + 2 * xy**2 + yy**2) / step**2
    np.testing.assert_allclose(integral, 8 * np.pi * np.sum((nested_bending(centres) @ x) ** 2), rtol=0.02)


@pytest.mark.parametrize("shrink", [1e-1, 1e-3])
def test_a_small_first_triangle_costs_few_digits(shrink):
    centres, points = scattered(40, size=1.0), scattered(400, seed=1, size=1.0)
    centres[:3] = centres[:3].mean(axis=0) + shrink * (centres[:3] - centres[:3].mean(axis=0))
    values = np.random.default_rng(2).normal(size=400)
    expected = fitted(ThinPlateSpline(centres).basis(points), values)
    np.testing.assert_allclose(fitted(nested_basis(points, centres), values), expected, rtol=0, atol=1e-8)
    assert np.isfinite(nested_bending(centres)).all()


def test_control_points_as_near_as_they_may_be_still_bend():
    centres = scattered(6, size=1.0)
    rows = nested_bending(np.vstack([centres, centres[4] + [2e-5, 0], centres[0] + [0, 2e-5]]))
    assert np.linalg.matrix_rank(rows / np.abs(rows).max(axis=0, initial=1e-300)) == 5


def test_three_control_points_do_not_bend():
    assert nested_bending(scattered(3)).shape == (0, 3)
    assert nested_basis(scattered(5, seed=1), scattered(3)).shape == (5, 3)


def test_nested_functions_of_many_points_take_little_more_memory_than_their_result():
    centres, points = scattered(100), scattered(50_000, seed=1)
    tracemalloc.start()
    size = nested_basis(points, centres).nbytes
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < size + 5e6


@pytest.mark.parametrize(
    "control_points",
    [
        [],
        [[0, 0]],
        [[0, 0], [1, 0]],
        [[0, 0]] * 3,
        [[0, 0], [1, 1], [2, 2], [0, 5]],
        [[0, 0], [1, 0], [0, 1], [1, 0]],
        [[0, 0], [1, 0], [0, np.nan]],
        [["a", "b"]] * 3,
        None,
    ],
)
def test_control_points_that_make_no_nested_functions_are_refused(control_points):
    for call in (lambda c: nested_basis([[1, 1]], c), nested_bending):
        with pytest.raises((ValueError, TypeError), match=r"Invalid control_points\. .* Given "):
            call(control_points)


def test_control_points_that_begin_on_a_line_are_told_from_those_on_a_line():
    ThinPlateSpline([[0, 0], [1, 1], [2, 2], [0, 5]])
    with pytest.raises(ValueError, match=r"control_points\. The first three must not lie on a line"):
        nested_basis([[1, 1]], [[0, 0], [1, 1], [2, 2], [0, 5]])


def test_every_layout_of_the_same_numbers_gives_the_same_nested_functions():
    centres, points = scattered(6).round(), scattered(10, seed=1).round()
    expected = nested_basis(points, centres)
    for change in (
        np.ndarray.tolist,
        np.asfortranarray,
        lambda a: a.astype(np.float32),
        lambda a: a.astype(int),
    ):
        np.testing.assert_array_equal(nested_basis(change(points), change(centres)), expected)


@pytest.mark.filterwarnings("error")
def test_nested_functions_absurdly_far_away_raise_no_warning():
    assert np.isfinite(nested_basis([[1e100, 0.0]], scattered(5))).all()
    nested_basis([[1e100, 0.0]], 1e-80 * scattered(5))
