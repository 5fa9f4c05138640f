"""What the tests of scipy, scikit-image and verde ask of their splines, asked of ours.

Each test names what it stands for. What they ask of kernels, dimensions and options that we do not have has no
counterpart: one and three dimensions, other kernels than the thin plate's, neighbours, polynomials above the first
degree, lazy grids.
"""

import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import verde
import xarray as xr
from inputs import refused
from scipy.interpolate import RBFInterpolator
from scipy.stats.qmc import Halton
from skimage.transform import rotate
from skimage.transform import warp as resample

import mexpress as mx

HALTON = Halton(2, scramble=False).random(200)
DATA, UNSEEN = HALTON[:100], HALTON[100:]


def franke(points):
    """Return Franke's function, which scipy tests with: four bumps over the unit square."""
    x, y = 9 * points.T
    return (
        0.75 * np.exp(-((x - 2) ** 2 + (y - 2) ** 2) / 4)
        + 0.75 * np.exp(-((x + 1) ** 2) / 49 - (y + 1) / 10)
        + 0.5 * np.exp(-((x - 7) ** 2 + (y - 3) ** 2) / 4)
        - 0.2 * np.exp(-((x - 4) ** 2) - (y - 7) ** 2)
    )


def spline(points, values, **options):
    """Return the thin-plate spline with a control point at each datum: it interpolates unless it is smoothed."""
    return mx.fit_surface(points, values, points, **options)


# ----------------------------------------------------------------------------------- scipy.RBFInterpolator


@pytest.mark.parametrize("smoothing", [0.0, 1e-4, 0.01, 1.0, 100.0])
def test_scipy_has_the_same_spline_and_smoothing_in_the_same_unit(smoothing):
    found = spline(DATA, franke(DATA), smoothing=smoothing)(UNSEEN)
    np.testing.assert_allclose(
        found, RBFInterpolator(DATA, franke(DATA), smoothing=smoothing)(UNSEEN), atol=1e-12
    )


def test_scipy_scale_invariance_2d():
    """The kernel's shape parameter has no effect: nor has the unit of the points."""
    found = spline(2 * DATA, franke(DATA))(2 * UNSEEN)
    np.testing.assert_allclose(found, spline(DATA, franke(DATA))(UNSEEN), rtol=0, atol=1e-12)


@pytest.mark.parametrize(("scale", "shift"), [(1e50, 1e55), (1e-50, 0.0), (1e-50, 1e-45)])
def test_scipy_extreme_domains(scale, shift):
    found = spline(DATA * scale + shift, franke(DATA))(UNSEEN * scale + shift)
    np.testing.assert_allclose(found, spline(DATA, franke(DATA))(UNSEEN), rtol=0, atol=1e-8)


@pytest.mark.parametrize("smoothing", [0.0, 1.0])
def test_scipy_polynomial_reproduction(smoothing):
    """Of the first degree, which the bending energy does not see."""
    plane = np.array([0.4, -2.0, 1.1])
    found = spline(DATA, plane[0] + DATA @ plane[1:], smoothing=smoothing)(UNSEEN)
    np.testing.assert_allclose(found, plane[0] + UNSEEN @ plane[1:], rtol=0, atol=1e-11)


def test_scipy_chunking():
    """Many queries at once are each query by itself."""
    surface = spline(DATA, franke(DATA))
    many = Halton(2, scramble=False).random(5000)
    together = surface(many)
    np.testing.assert_allclose(
        together[::500], [surface([query])[0] for query in many[::500]], rtol=0, atol=1e-12
    )


def test_scipy_vector_data():
    values = np.column_stack([franke(DATA), franke(DATA[:, ::-1])])
    found = spline(DATA, values)(UNSEEN)
    for k in range(2):
        np.testing.assert_allclose(found[:, k], spline(DATA, values[:, k])(UNSEEN), rtol=0, atol=1e-12)


def test_scipy_complex_data():
    """Real and imaginary parts are columns, and the message says so."""
    values = franke(DATA) + 1j * franke(DATA[:, ::-1])
    assert "real and imaginary parts as columns" in refused(lambda: spline(DATA, values), "values", TypeError)
    found = spline(DATA, np.column_stack([values.real, values.imag]))(UNSEEN)
    np.testing.assert_allclose(found @ [1, 1j], RBFInterpolator(DATA, values)(UNSEEN), atol=1e-11)


def test_scipy_interpolation_misfit_2d():
    assert np.mean((spline(DATA, franke(DATA))(UNSEEN) - franke(UNSEEN)) ** 2) < 2e-4


def test_scipy_smoothing_misfit():
    """Some smoothing removes half of the noise: cross-validation finds one by itself."""
    rng = np.random.default_rng(0)
    noisy = franke(HALTON) + rng.normal(0, 0.2, len(HALTON))
    found = mx.select_surface(HALTON, noisy).surface(HALTON)
    assert np.sqrt(np.mean((found - franke(HALTON)) ** 2)) < 0.1


def test_scipy_array_smoothing():
    """A known outlier counts less: here by its weight."""
    plane = 1 + DATA @ [2, -3]
    values, weights = plane.copy(), np.ones(len(DATA))
    values[10] += 1
    weights[10] = 1e-9
    found = spline(DATA, values, weights=weights, smoothing=1e-6)(DATA)
    np.testing.assert_allclose(found, plane, rtol=0, atol=1e-4)


def test_scipy_smoothing_limit_2d():
    """Much smoothing leaves the plane of least squares."""
    values = franke(DATA)
    ones, there = (np.column_stack([np.ones(len(points)), points]) for points in (DATA, UNSEEN))
    plane = there @ np.linalg.lstsq(ones, values, rcond=None)[0]
    np.testing.assert_allclose(spline(DATA, values, smoothing=1e8)(UNSEEN), plane, rtol=0, atol=1e-8)


def test_scipy_errors():
    """Dimensions and lengths that do not fit, too few observations, and a matrix without full rank."""
    values = franke(DATA)
    surface = spline(DATA, values)
    line = [[2.0, 0.0], [1.0, 0.0], [0.0, 0.0]]
    for name, call in (
        ("points", lambda: surface(np.zeros((4, 1)))),
        ("points", lambda: surface(np.zeros(5))),
        ("points", lambda: mx.fit_surface(np.zeros(5), np.zeros(5), DATA)),
        ("values", lambda: mx.fit_surface(DATA, values[:1], DATA)),
        ("weights", lambda: mx.fit_surface(DATA, values, DATA, weights=np.ones(1))),
        ("lifting", lambda: mx.fit_surface(DATA, values, DATA, lifting="test")),
        ("control_points", lambda: spline(DATA[:1], values[:1])),
        ("control_points", lambda: spline(line, np.zeros(3))),
    ):
        refused(call, name, ValueError)


def test_scipy_pickleable():
    surface = spline(DATA, franke(DATA))
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(surface))(UNSEEN), surface(UNSEEN))


def test_scipy_concurrency():
    surface = spline(DATA, franke(DATA))
    with ThreadPoolExecutor(10) as pool:
        found = list(pool.map(surface, [UNSEEN] * 20))
    for values in found:
        np.testing.assert_array_equal(values, surface(UNSEEN))


# ------------------------------------------------------- skimage.transform.ThinPlateSplineTransform

SQUARE = np.array([[0, 0], [0, 5], [5, 5], [5, 0]])
TURNED = np.array([[5, 0], [0, 0], [0, 5], [5, 5]])


def bent(source, target):
    """Return the thin-plate warp that takes each source point to its target point."""
    return mx.fit_warp(source, target, source, fractional=False)


def test_skimage_call_on_source():
    np.testing.assert_allclose(bent(SQUARE, TURNED)(SQUARE), TURNED, atol=1e-14)


def test_skimage_call_on_a_grid():
    grid = np.stack(np.meshgrid(np.arange(5), np.arange(5)), axis=-1).reshape(-1, 2)
    expected = np.column_stack([5 - grid[:, 1], grid[:, 0]])  # a quarter of a turn
    np.testing.assert_allclose(bent(SQUARE, TURNED)(grid), expected, atol=1e-13)


def test_skimage_coefficients():
    """Bookstein's example of four points on a diamond: x stays, and y bends by the points' crosswise heights."""
    source = np.array([[0, 1], [-1, 0], [0, -1], [1, 0]])
    target = np.array([[0, 0.75], [-1, 0.25], [0, -1.25], [1, 0.25]])
    warp = bent(source, target)
    kernel = RBFInterpolator(source, target)
    queries = np.array([[0.3, 0.2], [-0.7, 0.1], [2.0, -3.0]])
    np.testing.assert_allclose(warp(queries), kernel(queries), atol=1e-13)
    np.testing.assert_allclose(warp(queries)[:, 0], queries[:, 0], atol=1e-13)
    # y = 0.0902 times r^2 log r^2 of the distances to the points, with alternate signs, after y itself.
    squares = ((queries[:, None] - source) ** 2).sum(axis=-1)
    bend = 0.0902 * (squares * np.log(squares)) @ [-1, 1, -1, 1]
    np.testing.assert_allclose(warp(queries)[:, 1], queries[:, 1] + bend, rtol=2e-3)


def test_skimage_inverse():
    """Theirs is not supported; ours is its own inverse's inverse."""
    rng = np.random.default_rng(0)
    source = rng.uniform(0, 100, (30, 2))
    warp = bent(source, source + 3 * np.sin(source[:, ::-1] / 20))
    np.testing.assert_allclose(warp.inverse(warp(source)), source, atol=1e-9)


def test_skimage_faulty_input():
    warp = bent(SQUARE, TURNED)
    for name, call in (
        ("points", lambda: warp([1, 2, 3])),
        ("target", lambda: bent(SQUARE, TURNED[:3])),
        ("source", lambda: mx.fit_warp(np.array([0, 1, 2, 3]), TURNED, SQUARE)),
        ("target", lambda: bent(SQUARE, np.array([0, 1, 2, 3]))),
        ("control_points", lambda: bent(SQUARE[:2], TURNED[:2])),
        ("control_points", lambda: bent(np.ones((4, 2)), TURNED)),
    ):
        refused(call, name, ValueError)


def test_skimage_failed_estimation_is_false():
    assert not mx.Warp.from_estimate(np.ones((4, 2)), TURNED)
    assert mx.Warp.from_estimate(SQUARE, TURNED)


def test_skimage_rotate():
    size = 64
    image = np.random.default_rng(0).uniform(0, 1, (size, size, 3))
    far = size - 1
    corners = np.array([[0, 0], [0, far], [far, far], [far, 0]])
    warp = bent(corners, np.array([[far, 0], [0, 0], [0, far], [far, far]]))
    inner = np.s_[1:-1, 1:-1]  # at the edge, rounding decides what is outside
    np.testing.assert_allclose(resample(image, warp)[inner], rotate(image, 90)[inner], atol=1e-11)
    np.testing.assert_allclose(
        warp.remap(image, inverse=True, tolerance=0)[inner], rotate(image, 90)[inner], atol=1e-4
    )


def test_skimage_translation_and_zoom():
    image = np.zeros((7, 7))
    image[2:5, 2:5] = [[1, 1, 1], [1, 2, 1], [1, 1, 1]]
    square = np.array([[2, 2], [2, 4], [4, 4], [4, 2]])
    moved = bent(square, square + 1).remap(image, tolerance=0)
    np.testing.assert_allclose(moved[1:, 1:], image[:-1, :-1], atol=1e-5)
    zoomed = bent(square, np.array([[1, 1], [1, 5], [5, 5], [5, 1]])).remap(image, tolerance=0)
    np.testing.assert_allclose(zoomed[3, 1:6], [1, 1.5, 2, 1.5, 1], atol=1e-5)


# --------------------------------------------------------------------------------------------- verde.Spline

REGION = (100, 500, -800, -700)
BOARD = verde.synthetic.CheckerBoard(region=REGION)


def scattered(board=BOARD, size=600, seed=1):
    """Return points and values of a synthetic data set of verde."""
    table = board.scatter(size=size, random_state=seed)
    return table[["easting", "northing"]].to_numpy(), table["scalars"].to_numpy()


@pytest.mark.slow
def test_verde_spline():
    """It is perfect at the data, and near the truth between them."""
    points, values = scattered(size=1500)
    surface = spline(points, values)
    np.testing.assert_allclose(surface(points), values, rtol=1e-5)
    part = (270, 320, -770, -720)
    found = surface.to_xarray(part, shape=(5, 5), error=False)["value"]
    np.testing.assert_allclose(found, BOARD.grid(region=part, shape=(5, 5)).scalars, rtol=5e-2)


def test_verde_spline_cv():
    """Without noise, the best damping is none to speak of."""
    points, values = scattered()
    surface = mx.select_surface(points, values).surface
    np.testing.assert_allclose(surface(points), values, rtol=0, atol=1e-3 * np.abs(values).max())


def test_verde_spline_region():
    grid = verde.synthetic.CheckerBoard(region=(1000, 5000, -8000, -6000)).grid(shape=(10, 10))
    cloud = mx.read_cloud(grid.scalars)
    found = spline(cloud.points, cloud.values).to_xarray(shape=(3, 4), error=False)
    assert (found.x[0], found.x[-1], found.y[0], found.y[-1]) == (1000, 5000, -8000, -6000)


def test_verde_spline_weights():
    """A weight makes an outlier count for nothing."""
    board = verde.synthetic.CheckerBoard()
    points, values = scattered(board, 550)
    wrong, weights = values.copy(), np.ones(len(values))
    wrong[500] += 100e3
    weights[500] = 1e-10
    surface = spline(points, wrong, weights=weights, smoothing=0.01)
    np.testing.assert_allclose(surface(points), values, rtol=1e-2, atol=10)
    assert wrong[500] - surface(points[500:501])[0] == pytest.approx(100e3, rel=1e-2)
    weights[500] = 0
    surface = mx.fit_surface(points, wrong, np.delete(points, 500, axis=0), weights=weights)
    assert wrong[500] - surface(points[500:501])[0] == pytest.approx(100e3, rel=1e-2)


def test_verde_spline_damping():
    """A bit of it changes little."""
    board = verde.synthetic.CheckerBoard(region=(1000, 5000, -8000, -6000))
    points, values = scattered(board, 800)
    surface = spline(points, values, smoothing=1e-8)
    np.testing.assert_allclose(surface(points), values, rtol=1e-2, atol=10)
    part = (2000, 4000, -7500, -6500)
    found = surface.to_xarray(part, shape=(5, 5), error=False)["value"]
    np.testing.assert_allclose(found, board.grid(region=part, shape=(5, 5)).scalars, rtol=1e-2, atol=10)


def test_verde_base_gridder():
    """A region and a shape, the coordinates themselves, or those of a grid: all give the same grid."""
    region, shape = (0, 10, -10, -5), (50, 30)
    points = np.random.default_rng(0).uniform([0, -10], [10, -5], (300, 2))
    surface = mx.fit_surface(points, 2 * points[:, 0] + 100, points[:3])
    x, y = verde.grid_coordinates(region, shape=shape)
    by_region = surface.to_xarray(region, shape=shape, dims=("northing", "easting"), outside="extrapolate")
    like = verde.make_xarray_grid((x, y), np.zeros(shape), data_names="given")
    for grid in (by_region, surface.to_xarray(like=like, outside="extrapolate")):
        np.testing.assert_allclose(grid["value"], 2 * x + 100)
        np.testing.assert_allclose(grid["easting"], x[0])
        np.testing.assert_allclose(grid["northing"], y[:, 0])
    xr.testing.assert_allclose(
        by_region["value"].drop_attrs(), surface.to_xarray(like=like, outside="extrapolate")["value"]
    )


def test_verde_data_names():
    points, values = scattered(size=60)
    three = mx.fit_surface(points, np.column_stack([values, 2 * values, -values]), points[:9])
    names = ["east_component", "north_component", "vertical_component"]
    assert list(three.to_xarray(shape=(2, 3), names=names, error=False).data_vars) == names
    refused(lambda: three.to_xarray(shape=(2, 3), names=names[:2]), "names", ValueError)


def test_verde_projection():
    """A surface of projected points is asked at projected points."""
    points, values = scattered(size=60)
    projected = mx.fit_surface(2 * points, values, 2 * points[:20])
    np.testing.assert_allclose(
        projected(2 * points), mx.fit_surface(points, values, points[:20])(points), atol=1e-9
    )


def test_verde_trend():
    """Three control points are a trend of the first degree, which one wrong datum of no weight does not change."""
    points, _ = scattered(size=100)
    trend = 10 + points @ [2, -0.4]
    wrong = trend.copy()
    wrong[20] += 500
    weights = np.ones(100)
    weights[20] = 0
    surface = mx.fit_surface(points, wrong, points[:3], weights=weights)
    np.testing.assert_allclose(surface(points), trend, rtol=1e-9)


def test_verde_vector_spline():
    """Components are predicted together as each by itself, with the same points."""
    points, values = scattered(size=200)
    both = spline(points, np.column_stack([values, np.roll(values, 1)]))
    np.testing.assert_allclose(both(points)[:, 0], values, rtol=1e-6)
    np.testing.assert_allclose(
        both(points + 1)[:, 1], spline(points, np.roll(values, 1))(points + 1), rtol=1e-6
    )
