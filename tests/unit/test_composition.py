"""What one model or command returns, any other takes; a position that is not known is NaN all the way, row by row."""

import functools

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis.extra.numpy import arrays

import mexpress as mx
from mexpress.cli import main
from mexpress.io.matches import read_points

SIZE = 100.0
SOURCE = np.random.default_rng(0).uniform(0, SIZE, (40, 2))
X, Y = SOURCE.T / SIZE
TARGET = SIZE * np.column_stack([1 + X + 0.1 * X * Y, 2 + Y + 0.05 * np.sin(3 * X)])


@functools.cache
def models():
    """Return warps that map the square to others of about its size, and surfaces over it."""
    grid = mx.liftings.BSpline.place(SOURCE, 25)
    return {
        "fractional": mx.fit_warp(SOURCE, TARGET, SOURCE[:9], smoothing=1.0),
        "linear": mx.fit_warp(SOURCE, TARGET, SOURCE[:9], fractional=False),
        "affine": mx.fit_warp(SOURCE, TARGET, SOURCE[:9], "affine", fractional=False),
        "bspline": mx.fit_warp(SOURCE, TARGET, grid, "bspline", smoothing=1.0),
        "depth": mx.fit_surface(SOURCE, TARGET[:, 0], SOURCE[:9]),
        "space": mx.fit_surface(SOURCE, np.column_stack([TARGET, X]), SOURCE[:9]),
    }


WARPS = ["fractional", "linear", "affine", "bspline"]
SURFACES = ["depth", "space"]
BOTH = ["__call__", "error", "covers", "interval"]
OF_WARPS = [*BOTH, "jacobian", "denominator", "vanishes", "folds", "inverse"]
OF_SURFACES = [*BOTH, "derivatives", "normals"]
METHODS = [
    *((name, method) for name in WARPS for method in OF_WARPS),
    *((name, method) for name in SURFACES for method in OF_SURFACES),
]
NOWHERE = {"vanishes": True, "folds": True, "covers": False}  # nothing is to be trusted there

FEW = settings(max_examples=max(5, settings().max_examples // 10))
NUMBERS = st.one_of(
    st.floats(-50, 250), st.sampled_from([np.nan, np.inf, -np.inf, 1e101, -1e308]), st.floats()
)
POINTS = st.integers(0, 6).flatmap(lambda k: arrays(np.float64, (k, 2), elements=NUMBERS))


def answer(name, method, points):
    found = getattr(models()[name], method)(points)
    return np.stack([found.lower, found.upper], axis=1) if method == "interval" else found


@pytest.mark.parametrize(("name", "method"), METHODS)
@FEW
@given(POINTS)
def test_rows_that_are_not_known_are_unknown_and_no_others_change(name, method, points):
    found, known = answer(name, method, points), (np.abs(points) <= 1e100).all(axis=1)
    assert len(found) == len(points)
    expected = answer(name, method, points[known])
    assert found.dtype == expected.dtype
    assert found.shape[1:] == expected.shape[1:] == answer(name, method, SOURCE[:1]).shape[1:]
    np.testing.assert_array_equal(found[known], expected)
    np.testing.assert_array_equal(found[~known], np.full_like(found[~known], NOWHERE.get(method, np.nan)))


@given(
    POINTS, st.lists(st.tuples(st.sampled_from(WARPS), st.sampled_from(["__call__", "inverse"])), max_size=4)
)
def test_warps_and_inverses_compose_in_any_order(points, chain):
    unknown = ~(np.abs(points) <= 1e100).all(axis=1)
    for name, way in chain:
        points = getattr(models()[name], way)(points)
        assert np.isnan(points[unknown]).all()
    for name in SURFACES:
        assert np.isnan(models()[name](points)[unknown]).all()


@pytest.mark.parametrize("name", WARPS)
@given(arrays(np.float64, (5, 2), elements=st.floats(10, 90)), st.integers(0, 4))
def test_an_inverse_undoes_what_is_known(name, points, row):
    warp = models()[name]
    points[row, 1] = np.nan
    images = warp(points)
    np.testing.assert_allclose(warp(warp.inverse(images)), images, rtol=0, atol=1e-8)
    assert np.isnan(images).any(axis=1).sum() == 1


@pytest.mark.parametrize("name", WARPS + SURFACES)
def test_no_positions_have_no_values(name, tmp_path):
    model = models()[name]
    assert repr(model.interval(np.empty((0, 2)))) == "Interval(0 points)"
    assert repr(model.interval([[np.nan, 1.0]])) == "Interval(1 points)"


@pytest.fixture
def apply(tmp_path, capsys):
    """Return a function that applies a model to a file, and returns the file of the results and the warnings."""

    def run(name, points, *options):
        path, out = tmp_path / f"{name}.npz", tmp_path / f"{name}{len(options)}.csv"
        models()[name].save(path)
        assert main(["apply", str(path), str(points), *options, "--out", str(out)]) == 0
        return out, capsys.readouterr().err

    return run


@pytest.mark.parametrize("name", WARPS)
def test_what_apply_writes_apply_reads(name, apply, tmp_path):
    points = np.vstack([SOURCE[:5], [[np.nan, 3.0]], SOURCE[5:9], [[np.nan, np.nan]]])
    np.save(tmp_path / "points.npy", points)
    there, warnings = apply(name, tmp_path / "points.npy")
    assert "2 of 11 points are not known" in warnings
    assert "no image" not in warnings
    np.testing.assert_array_equal(read_points(there, missing="keep"), models()[name](points))
    back, _ = apply(name, there, "--inverse")
    again, _ = apply(name, back)
    known = ~np.isnan(points).any(axis=1)
    np.testing.assert_allclose(read_points(back, missing="keep")[known], points[known], rtol=0, atol=1e-6)
    assert np.isnan(read_points(back, missing="keep")[~known]).all()
    np.testing.assert_allclose(
        read_points(again, missing="keep"), read_points(there, missing="keep"), rtol=0, atol=1e-8
    )


@pytest.mark.parametrize("name", SURFACES)
def test_what_a_surface_makes_of_points_is_read_as_points_and_as_a_cloud(name, apply, tmp_path):
    points = np.vstack([SOURCE, [[np.nan, 3.0]]])
    np.savetxt(tmp_path / "points.csv", points, delimiter=",")
    space, warnings = apply(name, tmp_path / "points.csv")
    assert "1 of 41 points are not known" in warnings
    values = models()[name](points)
    expected = np.column_stack([points, values]) if name == "depth" else values
    np.testing.assert_array_equal(read_points(space, missing="keep")[:-1], expected[:-1, :2])
    assert np.isnan(read_points(space, missing="keep")[-1]).all()
    cloud = mx.read_cloud(space)
    np.testing.assert_array_equal(np.column_stack([cloud.points, cloud.values]), expected[:-1])
    assert cloud.n_missing == 1
    assert apply("linear", space)[0].read_text().splitlines()[-1] == "nan,nan,nan"


def test_no_points_are_applied_to_none(apply, tmp_path):
    np.save(tmp_path / "none.npy", np.empty((0, 2)))
    there, warnings = apply("linear", tmp_path / "none.npy")
    assert there.read_text() == "x,y,error\n"
    assert warnings == ""
    back, warnings = apply("linear", there, "--inverse")
    assert (back.read_text(), warnings) == ("x,y\n", "")
