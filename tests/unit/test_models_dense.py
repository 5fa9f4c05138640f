"""Warps of whole images: every pixel is as close to its own evaluation as was asked; beyond the horizon is nothing."""

import cv2
import numpy as np
import pytest
import skimage.transform

import mexpress as mx
from mexpress import resampling
from mexpress.liftings import LIFTINGS
from mexpress.models import dense as dense_module
from mexpress.models.dense import dense

WIDTH, HEIGHT = 300, 200
NOTHING = np.empty((0, 2))


def pixels(width=WIDTH, height=HEIGHT):
    return np.column_stack([part.ravel() for part in np.indices((height, width))[::-1]]).astype(float)


def maps_of(positions, width=WIDTH, height=HEIGHT):
    return positions.T.reshape(2, height, width)


def bent(lifting="tps", count=60, fractional=True, bend=0.03, seed=0):
    rng = np.random.default_rng(seed)
    source = rng.uniform(0, 1, (8 * count, 2)) * (WIDTH, HEIGHT)
    x, y = source.T / WIDTH
    target = source + bend * WIDTH * np.column_stack(
        [np.sin(7 * y) + np.cos(9 * x), np.cos(6 * x) * np.sin(8 * y)]
    )
    centres = LIFTINGS[lifting].place(source, count)
    return mx.fit_warp(source, target, centres, lifting=lifting, fractional=fractional, smoothing=1e-6)


def wild(seed, lifting="tps"):
    """A warp that folds, with a third of its control points in one corner."""
    rng = np.random.default_rng(seed)
    centres = rng.uniform(-0.05, 1.05, (40, 2)) * (WIDTH, HEIGHT)
    centres[:13] = centres[0] + rng.normal(0, 8, (13, 2))
    parameters = centres + rng.normal(0, 6, centres.shape)
    return mx.Warp(LIFTINGS[lifting](centres), parameters, [[0, 0], [WIDTH, 0], [WIDTH, HEIGHT], [0, HEIGHT]])


def camera_above_a_plan():
    """80 matches of a ground plane; the camera is in the middle of the plan, and looks up the page."""
    rng = np.random.default_rng(0)
    plan = rng.uniform((0, 0), (640, 220), (80, 2))
    depth = 240 - plan[:, 1]
    image = np.column_stack([320 + 400 * (plan[:, 0] - 320) / depth, 240 + 400 * 30 / depth])
    return mx.fit_warp(plan, image, [[0, 0], [640, 0], [320, 220]])


def off(found, exact):
    """Largest distance; both are NaN in the same places."""
    np.testing.assert_array_equal(np.isnan(found), np.isnan(exact))
    return np.nanmax(np.hypot(*(found - exact)))


@pytest.mark.parametrize("tolerance", [0.5, 0.05, 0.002])
@pytest.mark.parametrize("lifting", ["tps", "bspline", "affine"])
@pytest.mark.parametrize("fractional", [False, True])
def test_every_pixel_is_within_the_tolerance(lifting, fractional, tolerance):
    warp = bent(lifting, fractional=fractional)
    found = warp.dense_map(WIDTH, HEIGHT, tolerance)
    assert off(found, maps_of(warp(pixels()))) <= tolerance


@pytest.mark.parametrize("lifting", ["tps", "affine"])
@pytest.mark.parametrize("seed", range(6))
def test_folds_and_crowded_control_points_are_within_the_tolerance(lifting, seed):
    warp = wild(seed, lifting)
    assert warp.folds(pixels()).any()
    side = np.sqrt(np.median(np.abs(np.linalg.det(warp.jacobian(pixels())))))
    assert (
        off(warp.dense_map(WIDTH, HEIGHT), maps_of(warp(pixels()))) <= 0.06 * side
    )  # a median of other samples


@pytest.mark.parametrize("lifting", ["tps", "bspline", "affine"])
def test_the_inverse_map_is_the_inverse_at_every_pixel(lifting):
    warp = bent(lifting, bend=0.01)
    assert off(warp.inverse_map(WIDTH, HEIGHT), maps_of(warp.inverse(pixels()))) <= 0.05


@pytest.mark.parametrize("lifting", ["tps", "affine"])
def test_what_a_fold_leaves_without_a_source_has_none(lifting):
    warp = wild(1, lifting)
    some = np.random.default_rng(0).integers(0, (WIDTH, HEIGHT), (2000, 2))
    found = warp.inverse_map(WIDTH, HEIGHT)[:, some[:, 1], some[:, 0]].T
    exact = warp.inverse(some)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(exact))
    known = ~np.isnan(exact[:, 0])
    assert 0.2 < known.mean() < 1
    assert np.hypot(*(found - exact)[known].T).max() <= 0.05


def test_behind_the_camera_is_nothing():
    warp, width, height = camera_above_a_plan(), 640, 480
    points = pixels(width, height)
    beyond = maps_of(np.repeat(warp.vanishes(points)[:, None], 2, axis=1), width, height)[0]
    assert beyond[241:].all()
    assert beyond.sum() > 115_000
    raw = warp._map(points)
    assert ((raw > 0) & (raw < (width, height))).all(axis=1)[beyond.ravel()].sum() > 20_000  # ghosts
    np.testing.assert_array_equal(np.isnan(warp.dense_map(width, height)), [beyond, beyond])
    np.testing.assert_array_equal(np.isnan(warp(points)), np.repeat(beyond.reshape(-1, 1), 2, axis=1))


def test_images_of_ghosts_have_the_border_value():
    warp, photo = camera_above_a_plan(), np.full((480, 640), 200, np.uint8)
    plan = warp.remap(photo, inverse=True, fill=7)
    by_opencv = cv2.remap(photo, *warp.dense_map(640, 480), cv2.INTER_LINEAR, borderValue=7)
    by_skimage = skimage.transform.warp(photo, warp, output_shape=(480, 640), preserve_range=True, cval=7)
    for image, nothing in ((plan, 7), (by_opencv, 7), (by_skimage, np.nan)):
        np.testing.assert_array_equal(image[241:], nothing)
        assert (image[100] == 200).any()
    # The horizon of the photograph is in row 240: above, no place of the plan is seen.
    assert np.isnan(warp.inverse([[320.0, 200.0]])).all()
    assert (warp.remap(photo, fill=7)[:240] == 7).all()


def test_near_the_horizon_the_map_is_as_close_as_elsewhere():
    warp = camera_above_a_plan()
    found, exact = warp.dense_map(640, 480, 0.05), maps_of(warp(pixels(640, 480)), 640, 480)
    side = np.sqrt(np.median(np.abs(np.linalg.det(warp.jacobian(pixels(640, 200))))))
    distance = np.hypot(*(found - exact))
    known = np.hypot(*exact) < 1e5  # farther, float32 has steps of 0.004 or more
    assert distance[known].max() <= 0.06 * max(side, 1)


def test_above_the_horizon_of_a_photograph_piecewise_affine_functions_have_no_place():
    plan = [[0, 0], [640, 0], [640, 220], [0, 220]]
    centres = LIFTINGS["affine"].place([[0, 0], [640, 300], *plan], 30)  # triangles reach beyond the camera
    depth = 240 - centres[:, 1]
    image = np.column_stack([80 * depth + 100 * (centres[:, 0] - 320), 60 * depth + 100 * 30, depth])
    warp = mx.Warp(LIFTINGS["affine"](centres), image / 130, plan)
    found, exact = warp.inverse_map(160, 120, 1e-3), maps_of(warp.inverse(pixels(160, 120)), 160, 120)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(exact))
    assert np.isnan(exact[:, :61]).all()
    x, y = pixels(160, 120)[80 * 160 :].T
    away = 100 * 30 / (y - 60)
    expected = maps_of(np.column_stack([320 + (x - 80) * away / 100, 240 - away]), 160, 40)
    np.testing.assert_allclose(exact[:, 80:], expected, rtol=0, atol=1e-7)


def test_a_map_with_a_pole_and_an_edge_is_exact_in_the_end():
    def pole(points):
        x, y = points.T
        with np.errstate(divide="ignore", invalid="ignore"):
            values = np.column_stack([1e3 / (x - 70.3), np.sqrt(y - 50.5)])
        return np.where(((x > 71) & (y > 50.5))[:, None], values, np.nan)

    found = dense(pole, WIDTH, HEIGHT, 0.01, NOTHING, np.float64)
    assert off(found, maps_of(pole(pixels()))) <= 0.01


@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 500), (500, 1), (15, 15), (16, 16), (17, 129)])
def test_any_size(width, height):
    warp = bent()
    found = warp.dense_map(width, height)
    assert found.flags.c_contiguous
    assert off(found, maps_of(warp(pixels(width, height)), width, height)) <= 0.05
    back = warp.inverse_map(width, height)
    assert off(back, maps_of(warp.inverse(pixels(width, height)), width, height)) <= 0.05


def test_few_pixels_are_evaluated():
    calls = []
    warp = bent()

    def counted(points):
        calls.append(len(points))
        return warp(points)

    scaled = dense(
        lambda points: 10 * counted(points / 10), 10 * WIDTH, 10 * HEIGHT, 0.05, NOTHING, np.float32
    )
    assert scaled.shape == (2, 10 * HEIGHT, 10 * WIDTH)
    assert sum(calls) < 0.05 * scaled[0].size


def test_a_bump_between_the_places_of_a_block_is_told_by_its_details():
    place = np.array([40.0, 51.0])

    def bump(points):
        return points + 5 * np.exp(-((points - place) ** 2).sum(axis=1, keepdims=True) / 8)

    exact = maps_of(bump(pixels()))
    assert off(dense(bump, WIDTH, HEIGHT, 0.05, NOTHING, np.float64), exact) > 0.05
    assert off(dense(bump, WIDTH, HEIGHT, 0.05, np.tile(place, (5, 1)), np.float64), exact) <= 0.05


@pytest.mark.parametrize("lifting", ["tps", "bspline", "affine"])
def test_maps_do_not_depend_on_threads(monkeypatch, lifting):
    warp, found = bent(lifting), []
    image = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("MEXPRESS_NUM_THREADS", threads)
        found.append((warp.dense_map(WIDTH, HEIGHT), warp.inverse_map(WIDTH, HEIGHT), warp.remap(image)))
    for maps in zip(*found, strict=True):
        for other in maps[1:]:
            np.testing.assert_array_equal(maps[0], other)


@pytest.mark.parametrize("lifting", ["bspline", "affine"])
def test_values_and_slopes_do_not_depend_on_threads(monkeypatch, lifting):
    functions, random = bent(lifting).lifting, np.random.default_rng(0)
    points = random.uniform(-0.2, 1.2, (3 * 4096 + 5, 2)) * (WIDTH, HEIGHT)  # four tasks
    parameters, found = random.normal(0, 1, (len(functions.control_points), 3)), []
    for threads in ("1", "5"):
        monkeypatch.setenv("MEXPRESS_NUM_THREADS", threads)
        found.append((functions.values(points, parameters), functions.slopes(points, parameters)))
    for one, five in zip(*found, strict=True):
        np.testing.assert_array_equal(one, five)
    some = points[::1000]
    np.testing.assert_allclose(found[0][0][::1000], functions.basis(some) @ parameters, rtol=0, atol=1e-9)


def test_the_unit_and_the_origin_of_the_target_do_not_matter():
    here = bent(fractional=False)
    for scale, offset in ((1e-6, 0.0), (1e6, 0.0), (0.5, 5e6)):
        there = mx.Warp(here.lifting, scale * here.parameters + offset, here.domain)
        found, exact = there.dense_map(WIDTH, HEIGHT), maps_of(there(pixels()))
        assert off(found, exact) <= 0.05 * scale
        assert found.dtype == (np.float64 if offset else np.float32)


# Outside of the data


@pytest.mark.parametrize("fractional", [False, True])
def test_outside_of_the_domain_is_nan_on_demand(fractional):
    warp = bent(fractional=fractional)
    points = pixels(400, 300) - 50
    hull = warp._inside(points)
    assert 0.3 < hull.mean() < 0.6
    np.testing.assert_array_equal(~np.isnan(warp(points, outside="nan")).any(axis=1), hull)
    np.testing.assert_array_equal(warp(points, outside="nan")[hull], warp(points)[hull])
    assert np.isfinite(warp(points)).all()
    within = maps_of(np.repeat(warp._inside(pixels())[:, None], 2, axis=1))
    np.testing.assert_array_equal(~np.isnan(warp.dense_map(WIDTH, HEIGHT, outside="nan")), within)
    np.testing.assert_array_equal(
        warp.dense_map(WIDTH, HEIGHT)[within], warp.dense_map(WIDTH, HEIGHT, outside="nan")[within]
    )


def test_what_comes_from_outside_of_the_domain_is_filled_on_demand():
    warp = bent()
    back = warp.inverse_map(WIDTH, HEIGHT)
    known = warp._inside(back.reshape(2, -1).T.astype(float)).reshape(HEIGHT, WIDTH)
    np.testing.assert_array_equal(~np.isnan(warp.inverse_map(WIDTH, HEIGHT, outside="nan")), [known, known])
    seen = (np.abs(back - [[[149.5]], [[99.5]]]) <= [[[150]], [[100]]]).all(axis=0)
    filled = np.isnan(warp.remap(np.ones((HEIGHT, WIDTH)), fill=np.nan, outside="nan"))
    np.testing.assert_array_equal(filled, ~(known & seen))


def test_a_surface_is_nan_outside_on_demand():
    square = [[0, 0], [2, 0], [0, 2], [2, 2]]
    surface = mx.fit_surface(square, [[0, 1], [2, 3], [2, 4], [5, 6]], square)
    np.testing.assert_array_equal(
        np.isnan(surface([[1, 1], [3, 1]], outside="nan")), [[False, False], [True, True]]
    )
    assert np.isfinite(surface([[1, 1], [3, 1]])).all()
    with pytest.raises(ValueError, match=r"Invalid outside\."):
        surface([[1, 1]], outside="zero")


# Images


def test_an_image_is_moved_as_points_are():
    warp = bent(bend=0.01)
    image = np.zeros((HEIGHT, WIDTH))
    image[118:123, 148:153] = 1  # a square about (150, 120)
    moved = warp.remap(image)
    centre = (pixels() * moved.reshape(-1, 1)).sum(axis=0) / moved.sum()
    np.testing.assert_allclose(centre, warp([[150, 120]])[0], atol=0.1)
    back = warp.remap(moved, inverse=True)
    centre = (pixels() * back.reshape(-1, 1)).sum(axis=0) / back.sum()
    np.testing.assert_allclose(centre, [150, 120], atol=0.1)


@pytest.mark.parametrize(
    "dtype", [bool, np.uint8, np.int16, np.uint16, np.int32, np.uint64, np.float16, np.float32, float]
)
@pytest.mark.parametrize("channels", [(), (1,), (3,), (4,)])
def test_resampling_is_bilinear_in_any_type(dtype, channels):
    rng = np.random.default_rng(0)
    image = rng.integers(0, 2 if dtype is bool else 100, (7, 9, *channels)).astype(dtype)
    positions = rng.uniform(-2, 10, (2, 11, 13))
    found = resampling.resampled(image, positions, dtype(1))
    assert found.dtype == image.dtype
    for row, column in np.ndindex(11, 13):
        x, y = positions[:, row, column]
        expected = np.ones(channels)
        if -0.5 <= x <= 8.5 and -0.5 <= y <= 6.5:
            x, y = np.clip(x, 0, 8), np.clip(y, 0, 6)
            i, j = min(int(y), 5), min(int(x), 7)
            v, u = y - i, x - j
            a, b, c, d = (image[i + k, j + m].astype(float) for k in (0, 1) for m in (0, 1))
            expected = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)
        rounding = 0.5 if image.dtype.kind in "biu" else 0.05 if dtype is np.float16 else 1e-4
        np.testing.assert_allclose(found[row, column].astype(float), expected, atol=rounding + 1e-4)


def test_large_whole_numbers_and_single_pixels_keep_their_values():
    image = np.array([[2**63 - 1, -(2**63)]])
    here = np.stack(np.meshgrid([0.0, 1.0], [0.0]))
    np.testing.assert_array_equal(resampling.resampled(image, here, 0), image)
    assert resampling.resampled(np.array([[7]], np.uint8), np.zeros((2, 1, 1)), 0) == 7


def test_strips_make_no_difference(monkeypatch):
    warp, image = bent(), np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH), dtype=np.uint8)
    whole = warp.dense_map(WIDTH, HEIGHT), warp.remap(image, inverse=True)
    monkeypatch.setattr(dense_module, "_AT_ONCE", 1000)
    monkeypatch.setattr(resampling, "_AT_ONCE", 1000)
    parts = warp.dense_map(WIDTH, HEIGHT), warp.remap(image, inverse=True)
    for one, other in zip(whole, parts, strict=True):
        np.testing.assert_array_equal(one, other)


def test_an_identity_loses_no_pixel():
    square = [[0, 0], [100, 0], [0, 100], [100, 100]]
    image = np.random.default_rng(0).integers(1, 255, (60, 80, 3), dtype=np.uint8)
    identity = mx.fit_warp(square, square, square[:3])
    for inverse in (False, True):
        np.testing.assert_array_equal(identity.remap(image, inverse=inverse), image)
    assert identity.remap(image, (5, 4)).shape == (4, 5, 3)


def test_a_map_beyond_the_range_of_float32():
    square = np.array([[0.0, 0], [100, 0], [0, 100], [100, 100]])
    warp = mx.fit_warp(square, square * 1e40, square[:3], fractional=False)
    np.testing.assert_allclose(warp.dense_map(60, 60)[:, 50, 40], [4e41, 5e41], rtol=1e-3)
