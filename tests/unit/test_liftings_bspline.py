import numpy as np
import pytest
from scipy.interpolate import BSpline as Univariate

from mexpress.liftings import BSpline

BOX = np.array([[10.0, -5.0], [650.0, -5.0], [650.0, 475.0], [10.0, 475.0]])


def grid(columns, rows, step=(1.0, 1.0), low=(0.0, 0.0)):
    x, y = (low[b] + step[b] * np.arange(number) for b, number in enumerate((columns, rows)))
    return np.column_stack([np.tile(x, rows), np.repeat(y, columns)])


def inside(spline, count, seed=0):
    low, high = spline.span.min(axis=0), spline.span.max(axis=0)
    return np.random.default_rng(seed).uniform(low, high, (count, 2))


def columns_of(axis, coordinates, order=0):
    """One column a B-spline, by scipy; the axis are the sorted lines."""
    step, cells = axis[1] - axis[0], len(axis) - 3
    knots = axis[1] + step * np.arange(-3, cells + 4)
    return np.column_stack([Univariate(knots, c, 3)(coordinates, nu=order) for c in np.eye(len(axis))])


def expected(spline, points, orders=(0, 0)):
    x, y = (np.unique(c.round(9)) for c in spline.control_points.T)
    across, up = columns_of(x, points[:, 0], orders[0]), columns_of(y, points[:, 1], orders[1])
    i, j = (np.searchsorted(a, c - 1e-6) for a, c in zip((x, y), spline.control_points.T, strict=True))
    return across[:, i] * up[:, j]


@pytest.mark.parametrize("size", [(4, 4), (5, 4), (9, 7), (4, 30)])
def test_the_functions_are_those_of_scipy_in_any_order_of_the_control_points(size):
    centres = np.random.default_rng(1).permutation(grid(*size, step=(3.0, 0.5), low=(100.0, -7.0)))
    spline = BSpline(centres)
    points = inside(spline, 300)
    np.testing.assert_allclose(spline.basis(points), expected(spline, points), rtol=0, atol=1e-12)
    for b, orders in enumerate([(1, 0), (0, 1)]):
        found = spline.derivatives(points)[:, :, b]
        np.testing.assert_allclose(found, expected(spline, points, orders), rtol=0, atol=1e-11)


def test_sixteen_functions_are_positive_everywhere_inside():
    spline = BSpline(BSpline.place(BOX, 80))
    basis = spline.basis(np.vstack([inside(spline, 500), spline.span, spline.control_points]))
    assert (np.count_nonzero(basis[:500], axis=1) == 16).all()
    assert basis[:500].min() > -1e-15
    assert (np.count_nonzero(basis, axis=1) <= 16).all()


def test_outside_the_functions_go_on_with_value_and_slope_of_the_edge_along_each_axis():
    spline, random = BSpline(BSpline.place(BOX, 42)), np.random.default_rng(0)
    low, high = spline.span.min(axis=0), spline.span.max(axis=0)
    points = random.uniform(low - 500, high + 500, (500, 2))
    nearest = points.clip(low, high)
    x, y = (points - nearest).T[:, :, None]
    both = expected(spline, nearest, (1, 1))
    continued = (
        expected(spline, nearest)
        + x * expected(spline, nearest, (1, 0))
        + y * expected(spline, nearest, (0, 1))
        + x * y * both
    )
    np.testing.assert_allclose(spline.basis(points), continued, rtol=0, atol=1e-9)
    assert np.abs(spline.basis([[1e6, 100.0]])).max() < 1e5  # a cubic would have 1e12


@pytest.mark.parametrize("size", [(4, 4), (7, 5), (5, 12)])
def test_bending_is_the_integral_of_squared_second_derivatives(size):
    spline = BSpline(grid(*size, step=(2.0, 3.0)))
    x = np.random.default_rng(0).normal(size=len(spline.control_points))
    nodes, weights = np.polynomial.legendre.leggauss(6)
    axes = [(cells + (nodes + 1) / 2)[:, :].ravel() for cells in (np.arange(1, n - 2)[:, None] for n in size)]
    points = np.stack(np.meshgrid(2 * axes[0], 3 * axes[1], indexing="ij"), axis=-1).reshape(-1, 2)
    measure = np.outer(np.tile(weights, size[0] - 3), np.tile(weights, size[1] - 3)).ravel() * 6 / 4
    xx, xy, yy = (expected(spline, points, orders) @ x for orders in ((2, 0), (1, 1), (0, 2)))
    integral = measure @ (xx**2 + 2 * xy**2 + yy**2)
    np.testing.assert_allclose(8 * np.pi * np.sum((spline.bending() @ x) ** 2), integral, rtol=1e-11)


def test_bending_of_long_cells_keeps_its_digits():
    centres = grid(6, 9)
    x = centres[:, 0] ** 2 + centres[:, 1] ** 2
    for ratio in (1e-4, 1e4):
        energy = np.sum((BSpline(centres * [1, ratio]).bending() @ x) ** 2)
        exact = 3 * 6 * (4 * ratio + 4 / ratio**3) / (8 * np.pi)
        np.testing.assert_allclose(energy, exact, rtol=1e-9)


def test_a_float32_grid_is_a_grid_and_so_is_one_far_away():
    centres = grid(12, 9, (6.4, 6.1), (3.3, 7.7))
    for same in (centres.astype(np.float32), centres + 5e6, 1e-30 * centres, 1e90 * centres):
        assert len(BSpline(same).bending()) == 12 * 9 - 3


@pytest.mark.parametrize(
    "control_points",
    [
        grid(3, 8),
        grid(8, 3),
        grid(5, 5)[:-1],
        np.vstack([grid(5, 5), [[5.0, 0.0]]]),
        np.vstack([grid(5, 5)[:-1], [[2.5, 2.5]]]),
        grid(5, 5) + 0.01 * np.random.default_rng(0).normal(size=(25, 2)),
        grid(5, 5) @ [[0.8, 0.6], [-0.6, 0.8]],
        np.random.default_rng(0).uniform(size=(16, 2)),
        grid(5, 5) ** 2,
        np.vstack([grid(4, 4), grid(4, 4) + 0.5]),
    ],
)
def test_what_is_no_regular_grid_is_refused(control_points):
    rule = r"Invalid control_points\. They must be a regular grid along x and y, .* Given "
    with pytest.raises(ValueError, match=rule):
        BSpline(control_points)


def test_the_sequence_of_grids_starts_at_sixteen_and_grows_where_cells_are_longer():
    assert BSpline.counts(BOX, 42) == [16, 20, 25, 30, 36, 42]
    assert BSpline.counts(BOX, 10) == [16]
    assert BSpline.counts(BOX * [1, 0.1], 42) == [16, 20, 24, 28, 32, 36, 40]


def test_the_span_of_a_placed_grid_is_the_bounding_box():
    points = np.random.default_rng(0).uniform(BOX[0], BOX[2], (50, 2))
    span = BSpline(BSpline.place(points, 50)).span
    low, high = points.min(axis=0), points.max(axis=0)
    np.testing.assert_allclose(span, [low, [high[0], low[1]], high, [low[0], high[1]]], rtol=0, atol=1e-10)
