"""Regions of the plane."""

import tracemalloc

import numpy as np
import pytest

from mexpress.geometry import hull, inside


def polygons():
    rng = np.random.default_rng(0)
    yield "random", hull(rng.normal(size=(200, 2)), "points")
    yield "thin", hull(rng.normal(size=(200, 2)) * [1e5, 1.0] + [1e6, 3], "points")
    yield "rectangle", np.array([[2.0, 1.0], [9.0, 1.0], [9.0, 4.0], [2.0, 4.0]])
    yield "triangle", np.array([[0.0, 0.0], [5.0, -3.0], [5.0, 8.0]])
    yield "trapezium", np.array([[0.0, 2.0], [7.0, 0.0], [7.0, 5.0], [0.0, 3.0]])
    angles = np.arange(300) * (2 * np.pi / 300)
    yield "circle", hull(np.column_stack([np.cos(angles), np.sin(angles)]), "points")


@pytest.mark.parametrize(("name", "corners"), list(polygons()))
def test_inside_is_to_the_left_of_every_edge(name, corners):
    low, extent = corners.min(axis=0), np.ptp(corners, axis=0)
    points = low + np.random.default_rng(1).uniform(-0.2, 1.2, (5000, 2)) * extent
    edges = np.roll(corners, -1, axis=0) - corners
    offsets = points[:, None] - corners
    left = edges[:, 0] * offsets[..., 1] - edges[:, 1] * offsets[..., 0]
    clear = (np.abs(left) > 1e-6 * extent.prod()).all(axis=1)
    np.testing.assert_array_equal(inside(corners, *points.T)[clear], (left > 0).all(axis=1)[clear])
    assert clear.mean() > 0.9


@pytest.mark.parametrize(("name", "corners"), list(polygons()))
def test_corners_and_middles_of_edges_are_inside(name, corners):
    assert inside(corners, *corners.T).all()
    assert inside(corners, *((corners + np.roll(corners, -1, axis=0)) / 2).T).all()
    middle, extent = corners.mean(axis=0), np.ptp(corners, axis=0)
    outer = corners + 1e-6 * (corners - middle)
    assert not inside(corners, *outer.T).any()
    assert not inside(corners, np.array([np.nan, middle[0]]), np.array([middle[1], np.nan])).any()
    assert inside(corners, middle[0] + np.zeros(3), middle[1] + np.zeros((2, 1)) * extent[1]).shape == (2, 3)


def test_many_points_and_corners_need_no_table_of_both():
    circle = dict(polygons())["circle"]
    x, y = np.random.default_rng(0).uniform(-1, 1, (2, 200_000))
    tracemalloc.start()
    inside(circle, x, y)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10 * x.nbytes  # the table would have 300 times
