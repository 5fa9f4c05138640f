import pickle
import threading

import cv2
import numpy as np
import pytest
import skimage.transform
from designs import warp_design
from hypothesis import given
from hypothesis import strategies as st

from mexpress.liftings import ThinPlateSpline
from mexpress.models.files import save
from mexpress.models.warp import Warp
from mexpress.selection.files import load
from mexpress.selection.fit import fit_warp

WIDTH, HEIGHT = 640, 480
CORNERS = np.array([[0.0, 0.0], [WIDTH, 0.0], [WIDTH, HEIGHT], [0.0, HEIGHT]])
HOMOGRAPHY = np.array([[0.9, 0.2, 30.0], [-0.1, 1.1, -20.0], [1e-3, -5e-4, 1.0]])  # denominators 0.76 .. 1.64


def project(homography, points):
    values = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return values[:, :2] / values[:, 2:]


def positions(count, seed=0):
    return np.random.default_rng(seed).uniform(0, 1, (count, 2)) * [WIDTH, HEIGHT]


def control_points(count):
    grid = np.stack(np.meshgrid(np.arange(5), np.arange(4)), axis=-1).reshape(-1, 2)
    jitter = np.random.default_rng(7).uniform(0.1, 0.9, (20, 2))
    return (np.random.default_rng(8).permutation(grid + jitter)[:count]) * [WIDTH / 5, HEIGHT / 4]


def bent_warp(count=9, fractional=True, bend=20.0):
    """Return a homography whose functions are bent by noise at the control points."""
    spline, random = ThinPlateSpline(control_points(count)), np.random.default_rng(4)
    target = project(HOMOGRAPHY, spline.control_points) + bend * random.normal(size=(count, 2))
    if not fractional:
        return Warp(spline, target, CORNERS)
    values = np.column_stack([spline.control_points, np.ones(count)]) @ HOMOGRAPHY[2]
    denominator = values * (1 + 0.02 * random.normal(size=count))
    denominator /= denominator.mean()
    return Warp(spline, np.column_stack([target * denominator[:, None], denominator]), CORNERS)


WARPS = [bent_warp(3), bent_warp(9), bent_warp(3, fractional=False), bent_warp(9, fractional=False)]
ids = repr


@pytest.fixture(params=WARPS, ids=ids)
def warp(request):
    return request.param


# Fits


@pytest.mark.parametrize("count", [4, 12])
def test_three_control_points_recover_a_strong_homography(count):
    source = np.vstack([CORNERS, positions(count)])
    fitted = fit_warp(source, project(HOMOGRAPHY, source), control_points(3))
    queries = positions(200, seed=1)
    np.testing.assert_allclose(fitted(queries), project(HOMOGRAPHY, queries), rtol=0, atol=1e-8)


def test_three_control_points_without_denominator_are_the_least_squares_affine_map():
    source = positions(20)
    target = source @ [[1.1, 0.2], [-0.3, 0.9]] + np.random.default_rng(1).normal(size=(20, 2))
    homogeneous = np.column_stack([source, np.ones(20)])
    affine = np.linalg.lstsq(homogeneous, target, rcond=None)[0]
    fitted = fit_warp(source, target, control_points(3), fractional=False)
    np.testing.assert_allclose(fitted(source), homogeneous @ affine, rtol=0, atol=1e-9)


@pytest.mark.parametrize("fractional", [True, False])
@pytest.mark.parametrize("count", [4, 9, 16])
def test_exact_matches_recover_the_warp(count, fractional):
    truth, source = bent_warp(count, fractional), positions(150)
    fitted = fit_warp(source, truth(source), truth.control_points, fractional=fractional)
    queries = positions(100, seed=1)
    np.testing.assert_allclose(fitted(queries), truth(queries), rtol=0, atol=1e-8)
    np.testing.assert_allclose(fitted.parameters, truth.parameters, rtol=0, atol=1e-7)


def test_the_denominators_average_one_over_the_control_points():
    source = positions(60)
    target = project(HOMOGRAPHY, source) + np.random.default_rng(0).normal(size=(60, 2))
    fitted = fit_warp(source, target, control_points(6))
    assert fitted.parameters[:, 2].mean() == pytest.approx(1, abs=1e-12)
    assert fitted.denominator(fitted.control_points).mean() == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("count", [3, 7])
def test_the_residual_is_the_algebraic_error_in_pixels_of_the_target(count):
    source = positions(50)
    target = project(HOMOGRAPHY, source) + np.random.default_rng(0).normal(size=(50, 2))
    design = warp_design(ThinPlateSpline(control_points(count)), source, target)
    x = np.random.default_rng(1).normal(size=design.A.shape[1]) * 0.1
    model = design.model(x)
    denominator = model.denominator(source)
    expected = denominator[:, None] * (target - model(source))
    np.testing.assert_allclose((design.b - design.A @ x).reshape(-1, 2), expected, atol=1e-8)
    assert design.A.shape == (100, 3 * count - 1)
    assert design.coupling == 2


def test_the_residual_of_a_warp_without_denominator_is_the_transfer_error():
    source, target = positions(50), positions(50, seed=1)
    design = warp_design(ThinPlateSpline(control_points(7)), source, target, fractional=False)
    x = np.random.default_rng(1).normal(size=(7, 2))
    np.testing.assert_allclose(design.b - design.A @ x, target - design.model(x)(source), atol=1e-9)
    assert design.coupling == 1


@pytest.mark.parametrize("count", [3, 7])
def test_the_fit_minimises_the_algebraic_error_among_denominators_of_mean_one(count):
    source = positions(40)
    target = project(HOMOGRAPHY, source) + np.random.default_rng(0).normal(size=(40, 2))
    basis = ThinPlateSpline(control_points(count)).basis(source)
    zero = np.zeros_like(basis)
    raw = np.vstack(
        [np.hstack([basis, zero, -target[:, :1] * basis]), np.hstack([zero, basis, -target[:, 1:] * basis])]
    )
    # The constraint by elimination: the last denominator is l minus the others.
    reduced = raw[:, :-1] - np.repeat(raw[:, -1:], 3 * count - 1, axis=1) * (
        np.arange(3 * count - 1) >= 2 * count
    )
    scale = np.linalg.norm(reduced, axis=0)
    x = np.linalg.lstsq(reduced / scale, -count * raw[:, -1], rcond=None)[0] / scale
    expected = np.append(x, count - x[2 * count :].sum()).reshape(3, count).T
    fitted = fit_warp(source, target, control_points(count))
    np.testing.assert_allclose(fitted.parameters, expected, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("fractional", [True, False])
@given(st.floats(1e-2, 1e2), st.floats(-np.pi, np.pi), st.floats(-1e3, 1e3), st.booleans())
def test_a_similarity_of_either_image_does_not_change_the_fit(fractional, scale, angle, shift, mirrored):
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    matrix = scale * rotation @ np.diag([1, -1 if mirrored else 1])

    def moved(points):
        return points @ matrix.T + shift * scale

    source, queries, centres = positions(40), positions(30, seed=2), control_points(5)
    target = project(HOMOGRAPHY, source) + np.random.default_rng(0).normal(size=(40, 2))
    expected = fit_warp(source, target, centres, fractional=fractional)(queries)
    of_source = fit_warp(moved(source), target, moved(centres), fractional=fractional)(moved(queries))
    np.testing.assert_allclose(of_source, expected, rtol=0, atol=1e-6)
    of_target = fit_warp(source, moved(target), centres, fractional=fractional)(queries)
    np.testing.assert_allclose(of_target / scale, moved(expected) / scale, rtol=0, atol=1e-6)


def test_the_order_of_the_matches_does_not_matter():
    source, order = positions(40), np.random.default_rng(3).permutation(40)
    target = project(HOMOGRAPHY, source) + np.random.default_rng(0).normal(size=(40, 2))
    expected = fit_warp(source, target, control_points(6)).parameters
    np.testing.assert_allclose(
        fit_warp(source[order], target[order], control_points(6)).parameters, expected, rtol=1e-9
    )


@pytest.mark.parametrize("fractional", [True, False])
def test_bending_rows_measure_the_functions_of_the_warp(fractional):
    source, target = positions(40), project(HOMOGRAPHY, positions(40)) + np.array([5e3, -2e3])
    design = warp_design(ThinPlateSpline(control_points(6)), source, target, fractional)
    x = np.random.default_rng(1).normal(size=(design.A.shape[1], *design.b.shape[1:]))
    warp, rows = design.model(x), design.basis.bending()
    functions = warp.parameters.copy()
    if fractional:
        functions[:, :2] -= functions[:, 2:] * target.mean(axis=0)
        functions[:, 2] *= np.linalg.norm(target - target.mean(axis=0)) / np.sqrt(40)
    np.testing.assert_allclose(
        np.sum((design.bending() @ x) ** 2), np.sum((rows @ functions) ** 2), rtol=1e-8
    )


@pytest.mark.parametrize(
    ("matches", "count", "fractional"), [(3, 3, True), (4, 6, False), (12, 9, True), (5, 16, True)]
)
def test_too_few_matches_are_an_error_with_rank_and_parameters(matches, count, fractional):
    source = positions(matches)
    with pytest.raises(ValueError, match=r"Invalid control_points\. .* determine the warp.* rank \d+"):
        fit_warp(source, project(HOMOGRAPHY, source), control_points(count), fractional=fractional)


@pytest.mark.parametrize("fractional", [True, False])
def test_matches_that_repeat_each_other_do_not_determine_a_warp(fractional):
    source = np.repeat(positions(5), 10, axis=0)
    with pytest.raises(ValueError, match=r"Invalid control_points\. .* determine the warp"):
        fit_warp(source, project(HOMOGRAPHY, source), control_points(9), fractional=fractional)


def test_one_target_point_for_all_determines_no_fractional_warp():
    source = positions(20)
    with pytest.raises(ValueError, match="determine the warp"):
        fit_warp(source, np.ones((20, 2)), control_points(3))


# Maps and their derivatives


def test_the_jacobian_is_the_limit_of_differences(warp):
    points, step = positions(50), 1e-3
    jacobian = warp.jacobian(points)
    for b, shift in enumerate(step * np.eye(2)):
        difference = (warp(points + shift) - warp(points - shift)) / (2 * step)
        np.testing.assert_allclose(jacobian[:, :, b], difference, atol=1e-6)


def test_the_denominator_is_that_of_the_homography():
    points = positions(10)
    expected = np.column_stack([points, np.ones(10)]) @ HOMOGRAPHY[2]
    fitted = fit_warp(positions(30), project(HOMOGRAPHY, positions(30)), control_points(3))
    ratio = fitted.denominator(points) / expected
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-9)
    np.testing.assert_array_equal(bent_warp(fractional=False).denominator(points), 1)


@pytest.mark.parametrize("factor", [1.0, -3.0])
def test_points_on_and_beyond_the_horizon_vanish(factor):
    spline = ThinPlateSpline([[0, 0], [1, 0], [0, 1]])
    parameters = np.column_stack([[1.0, 2, 1], [1.0, 1, 2], [1.0, 0, 1]])  # the denominator is 1 - x
    horizon = Warp(spline, factor * parameters, [[0, 0], [0.5, 0], [0, 0.5]])
    points = np.array([[0.5, 3.0], [0.9995, 0.0], [1.0, 0.0], [1.5, 0.0]])
    np.testing.assert_array_equal(horizon.vanishes(points), [False, True, True, True])
    np.testing.assert_array_equal(horizon.vanishes(points, tolerance=1e-6), [False, False, True, True])
    np.testing.assert_array_equal(horizon.folds(points), [False, False, True, True])


def test_a_denominator_of_zero_is_infinite_or_nan_and_no_warning():
    spline = ThinPlateSpline([[-1, -1], [1, -1], [0, 2]])
    zero = Warp(spline, np.array([[1.0, 1, 0], [1.0, 1, 0], [1.0, 1, 0]]), CORNERS)
    assert not np.isfinite(zero([[0.0, 0.0]])).any()
    assert not np.isfinite(zero.jacobian([[0.0, 0.0]])).any()
    assert zero.vanishes([[0.0, 0.0]]).all()
    assert zero.folds([[0.0, 0.0]]).all()
    assert np.isnan(zero.inverse([[1.0, 1.0]])).all()
    assert zero.dense_map(3, 2).shape == (2, 2, 3)


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_fold_is_where_the_orientation_is_not_the_usual_one(mirrored):
    spline = ThinPlateSpline([[x, y] for x in (0, 1, 2, 3, 4) for y in (0, 4)])
    target = spline.control_points * [-1 if mirrored else 1, 1]
    target[8:, 0] = target[4:6, 0]  # the last column turns back
    folded = Warp(spline, target, spline.control_points)
    np.testing.assert_array_equal(folded.folds([[0.5, 2], [1.5, 2], [3.7, 2]]), [False, False, True])


def test_good_warps_neither_fold_nor_vanish(warp):
    assert not warp.folds(positions(500)).any()
    assert not warp.vanishes(positions(500)).any()


# Inverse


def test_the_inverse_undoes_the_warp(warp):
    points = positions(2000, seed=9)
    np.testing.assert_allclose(warp.inverse(warp(points)), points, rtol=0, atol=1e-6)


def test_the_inverse_of_a_homography_is_that_of_its_matrix_also_outside_the_domain():
    source = positions(30)
    fitted = fit_warp(source, project(HOMOGRAPHY, source), control_points(3))
    queries = np.array([[300.0, 200.0], [-200.0, -100.0], [900.0, 700.0]])
    np.testing.assert_allclose(
        fitted.inverse(queries), project(np.linalg.inv(HOMOGRAPHY), queries), atol=1e-6
    )


def test_points_that_nothing_maps_to_are_nan():
    spline = ThinPlateSpline([[x, y] for x in (0, 1, 2, 3, 4) for y in (0, 4)])
    target = spline.control_points.copy()
    target[8:, 0] = target[4:6, 0]
    folded = Warp(spline, target, spline.control_points)
    assert folded([[x, 2] for x in np.linspace(-9, 9, 500)])[:, 0].max() < 6
    found = folded.inverse([[1.0, 2.0], [60.0, 2.0]])
    np.testing.assert_allclose(folded(found[:1]), [[1, 2]], atol=1e-6)
    assert np.isnan(found[1]).all()


def test_halved_steps_find_what_full_steps_miss():
    warp = bent_warp()
    far = warp(3 * positions(500, seed=3) - [WIDTH, HEIGHT])
    found = warp.inverse(far)
    solved = ~np.isnan(found[:, 0])
    assert solved.mean() > 0.95  # full steps: 0.83
    np.testing.assert_allclose(warp(found[solved]), far[solved], rtol=0, atol=1e-8)


def test_no_inverse_is_given_where_the_warp_vanishes():
    spline = ThinPlateSpline([[0, 0], [1, 0], [0, 1]])
    parameters = np.column_stack([[1.0, 2, 1], [1.0, 1, 2], [1.0, 0, 1]])  # the denominator is 1 - x
    horizon = Warp(spline, parameters, [[0, 0], [0.5, 0], [0, 0.5]])
    points = np.array([[0.99, 0.1], [0.9999, 0.1]])
    found = horizon.inverse(horizon(points))
    np.testing.assert_allclose(found[0], points[0], atol=1e-8)
    assert np.isnan(found[1]).all()


def test_no_steps_find_only_what_the_samples_hit():
    assert np.isnan(bent_warp().inverse(positions(5), max_steps=0)).all()


def test_a_constant_warp_has_no_inverse():
    constant = fit_warp(positions(9), np.full((9, 2), 7.0), control_points(3), fractional=False)
    np.testing.assert_allclose(constant(positions(3)), 7)
    assert np.isnan(constant.inverse([[50.0, 60.0]])).all()


# Images


def checked_image():
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return (127 + 60 * np.sin(x / 25) + 60 * np.cos(y / 31)).astype(np.float32)


def test_opencv_and_skimage_bring_the_target_image_into_the_frame_of_the_source():
    image, warp = checked_image(), bent_warp()
    by_opencv = cv2.remap(image, *warp.dense_map(64, 48), cv2.INTER_LINEAR)
    by_skimage = skimage.transform.warp(image, warp, output_shape=(48, 64), order=1, preserve_range=True)
    x, y = warp(np.argwhere(np.ones((48, 64)))[:, ::-1]).T
    expected = (127 + 60 * np.sin(x / 25) + 60 * np.cos(y / 31)).reshape(48, 64)
    within = ((x > 0) & (x < WIDTH - 1) & (y > 0) & (y < HEIGHT - 1)).reshape(48, 64)
    assert within.mean() > 0.5
    np.testing.assert_allclose(by_opencv[within], by_skimage[within], atol=0.2)  # OpenCV: 1/32 of a pixel
    np.testing.assert_allclose(by_skimage[within], expected[within], atol=0.1)


def test_the_dense_map_holds_the_warp_of_every_pixel(warp):
    width, height = 37, 23
    maps = warp.dense_map(width, height, tolerance=0)
    assert maps.shape == (2, height, width)
    assert maps.dtype == np.float32
    for x, y in [(0, 0), (36, 0), (0, 22), (36, 22), (20, 11)]:
        np.testing.assert_allclose(maps[:, y, x], warp([[x, y]])[0], rtol=1e-6)


# What a model owes its user


def test_a_pickled_warp_is_the_same(warp):
    copy = pickle.loads(pickle.dumps(warp))
    np.testing.assert_array_equal(copy(positions(20)), warp(positions(20)))
    assert repr(copy) == repr(warp)


def test_a_saved_warp_is_read_back_bit_for_bit(warp, tmp_path):
    path = tmp_path / "model.warp"
    warp.save(path)
    copy = load(str(path))
    for name in ("parameters", "domain", "control_points"):
        np.testing.assert_array_equal(getattr(copy, name), getattr(warp, name))
    np.testing.assert_array_equal(copy(positions(20)), warp(positions(20)))
    assert [entry.name for entry in tmp_path.iterdir()] == ["model.warp"]


def test_saving_replaces_the_file_and_failing_leaves_it(warp, tmp_path, monkeypatch):
    path = tmp_path / "model.npz"
    path.write_bytes(b"older")

    def fail(*_, **__):
        raise OSError("disk full")

    with monkeypatch.context() as patched:
        patched.setattr(np, "savez", fail)
        with pytest.raises(OSError, match="disk full"):
            warp.save(path)
    assert path.read_bytes() == b"older"
    assert len(list(tmp_path.iterdir())) == 1
    warp.save(path)
    assert load(path).control_points.shape == warp.control_points.shape


def test_a_missing_file_is_not_found(tmp_path):
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "none.npz")


def archive(path, **arrays):
    with path.open("wb") as file:
        np.savez(file, **arrays)


def header(**changes):
    return {"format": "mexpress model", "version": 1, "kind": "warp"} | changes


@pytest.mark.parametrize(
    "arrays",
    [
        {},
        {"x": np.ones(3)},
        header(),
        header(format="other", **WARPS[1].to_arrays()),
        header(version=2, **WARPS[1].to_arrays()),
        header(version="new"),
        header(version=[1, 2]),
        header(kind="sculpture"),
        header(kind=np.array([None])),
        {name: array for name, array in header(**WARPS[1].to_arrays()).items() if name != "parameters"},
    ],
)
def test_archives_without_a_model_are_an_error(arrays, tmp_path):
    archive(tmp_path / "bad.npz", **arrays)
    with pytest.raises(ValueError, match=r"Invalid path\. It must name a saved model or selection\. Given "):
        load(tmp_path / "bad.npz")


@pytest.mark.parametrize(
    "change", [{"lifting": "none"}, {"parameters": np.ones((2, 2))}, {"control_points": np.ones((9, 2))}]
)
def test_models_that_contradict_themselves_are_an_error(change, tmp_path):
    archive(tmp_path / "bad.npz", **header(**WARPS[1].to_arrays()) | change)
    with pytest.raises(ValueError, match=r"Invalid .* Given "):
        load(tmp_path / "bad.npz")


def test_damaged_bytes_are_an_error_or_change_nothing(tmp_path):
    path, random = tmp_path / "model.npz", np.random.default_rng(0)
    WARPS[1].save(path)
    whole = path.read_bytes()
    refused = 0
    for trial in range(300):
        damaged = bytearray(whole)
        damaged[random.integers(len(whole))] ^= 1 << random.integers(8)
        path.write_bytes(damaged if trial % 2 else whole[: random.integers(len(whole))])
        try:
            np.testing.assert_array_equal(load(path).parameters, WARPS[1].parameters)
        except ValueError as error:
            assert str(error).startswith("Invalid path.")  # noqa: PT017
            refused += 1
    assert refused > 200


def test_pickles_and_arrays_are_no_models(tmp_path):
    for name, write in (("a", lambda f: pickle.dump(WARPS[0], f)), ("b", lambda f: np.save(f, np.ones(3)))):
        with (tmp_path / name).open("wb") as file:
            write(file)
        with pytest.raises(ValueError, match=r"Invalid path\."):
            load(tmp_path / name)


class Trap:
    """An object whose unpickling leaves a trace."""

    sprung = False

    def __reduce__(self):
        return (setattr, (Trap, "sprung", True))


def test_nothing_in_a_file_is_executed(tmp_path):
    arrays = header(**WARPS[1].to_arrays()) | {"parameters": np.array([Trap()], dtype=object)}
    archive(tmp_path / "trap.npz", **arrays)
    with pytest.raises(ValueError, match=r"Invalid path\."):
        load(tmp_path / "trap.npz")
    assert not Trap.sprung


@pytest.mark.parametrize("model", [None, 3, ThinPlateSpline(control_points(4))])
def test_only_models_are_saved(model, tmp_path):
    with pytest.raises(TypeError, match=r"Invalid model\. It must be one of .*Warp.* Given "):
        save(model, tmp_path / "x")
    assert not list(tmp_path.iterdir())


def test_threads_share_a_warp():
    shared, points, results = bent_warp(), positions(3000), {}
    expected = bent_warp().inverse(points)
    workers = [
        threading.Thread(target=lambda k=k: results.update({k: shared.inverse(points)})) for k in range(4)
    ]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    for result in results.values():
        np.testing.assert_array_equal(result, expected)
    assert len(results) == 4


def test_a_warp_does_not_change_with_the_arrays_it_was_made_from():
    parameters = WARPS[1].parameters.copy()
    warp = Warp(WARPS[1].lifting, parameters, CORNERS)
    parameters[:] = 0
    np.testing.assert_array_equal(warp.parameters, WARPS[1].parameters)
    with pytest.raises(ValueError, match="read-only"):
        warp.parameters[0, 0] = 1


# Hostile input

NO_QUERIES = [
    [0, 1],
    [[0, 1, 2]],
    [["a", "b"]],
    "points",
    None,
    [[1, 2], [3]],
    [],
]
NONE_POINTS = [*NO_QUERIES, [[0, np.nan]], [[np.inf, 0]], np.empty((0, 2))]


@pytest.mark.parametrize("points", NO_QUERIES)
@pytest.mark.parametrize("method", ["__call__", "jacobian", "denominator", "vanishes", "folds", "inverse"])
def test_points_that_are_none_are_refused(method, points):
    with pytest.raises((ValueError, TypeError), match=r"Invalid points\. .* Given "):
        getattr(WARPS[1], method)(points)


@pytest.mark.parametrize("points", [*NONE_POINTS, [[1, 2]], [[1, 2]] * 8, [[k, k] for k in range(8)]])
def test_matches_that_are_none_are_refused(points):
    with pytest.raises((ValueError, TypeError), match=r"Invalid source\. .* Given "):
        fit_warp(points, points, control_points(3))


@pytest.mark.parametrize("points", [*NONE_POINTS, [[1, 2]]])
def test_targets_that_do_not_match_are_refused(points):
    with pytest.raises((ValueError, TypeError), match=r"Invalid target\. .* Given "):
        fit_warp(positions(9), points, control_points(3))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("control_points", [[0, 0], [1, 1], [2, 2]]),
        ("control_points", 5),
        ("lifting", "polynomial"),
        ("fractional", "no"),
        ("fractional", None),
    ],
)
def test_options_that_are_none_are_refused(name, value):
    options = {"control_points": control_points(3), name: value}
    with pytest.raises((ValueError, TypeError), match=rf"Invalid {name}\. .* Given "):
        fit_warp(positions(9), positions(9), **options)


@pytest.mark.parametrize(
    ("method", "arguments", "name"),
    [
        ("dense_map", (0, 5), "width"),
        ("dense_map", (5, 2.5), "height"),
        ("dense_map", (5, 5, -1.0), "tolerance"),
        ("dense_map", (5, 5, np.nan), "tolerance"),
        ("inverse_map", (0, 5), "width"),
        ("inverse_map", (5, 2.5), "height"),
        ("inverse_map", (5, 5, "fine"), "tolerance"),
        ("remap", ([1, 2],), "image"),
        ("remap", (np.zeros((3, 0)),), "image"),
        ("remap", ([["a"]],), "image"),
        ("remap", ([[1j]],), "image"),
        ("remap", ([[1]], 5), "size"),
        ("remap", ([[1]], (5, 2.5)), "size"),
        ("remap", ([[1]], (5, 5, 5)), "size"),
        ("inverse", ([[1, 1]], 0.0), "tolerance"),
        ("inverse", ([[1, 1]], np.nan), "tolerance"),
        ("inverse", ([[1, 1]], 1e-6, -1), "max_steps"),
        ("vanishes", ([[1, 1]], -1.0), "tolerance"),
    ],
)
def test_arguments_that_are_none_are_refused(method, arguments, name):
    with pytest.raises((ValueError, TypeError), match=rf"Invalid {name}\. .* Given "):
        getattr(WARPS[1], method)(*arguments)


@pytest.mark.parametrize(
    ("method", "arguments"),
    [("__call__", ([[1, 1]],)), ("dense_map", (5, 5)), ("inverse_map", (5, 5)), ("remap", ([[1]],))],
)
@pytest.mark.parametrize("outside", ["NaN", np.nan, None, 0])
def test_no_other_values_outside_than_two(method, arguments, outside):
    with pytest.raises(ValueError, match=r"Invalid outside\. .* Given "):
        getattr(WARPS[1], method)(*arguments, outside=outside)


@pytest.mark.parametrize(
    ("image", "fill"),
    [([[1]], 0.5), ([[1]], np.nan), ([[True]], 2), (np.zeros((2, 2, 3)), [1, 2]), ([[1.0]], "x")],
)
def test_values_that_no_pixel_has_are_refused(image, fill):
    with pytest.raises((ValueError, TypeError), match=r"Invalid fill\. .* Given "):
        WARPS[1].remap(image, fill=fill)


@pytest.mark.parametrize(
    ("parameters", "domain", "name"),
    [
        (np.ones((8, 2)), CORNERS, "parameters"),
        (np.ones((9, 4)), CORNERS, "parameters"),
        (np.full((9, 2), np.nan), CORNERS, "parameters"),
        ("abc", CORNERS, "parameters"),
        (np.ones((9, 2)), CORNERS[:2], "domain"),
        (np.ones((9, 2)), None, "domain"),
    ],
)
def test_parts_that_do_not_make_a_warp_are_refused(parameters, domain, name):
    with pytest.raises((ValueError, TypeError), match=rf"Invalid {name}\. .* Given "):
        Warp(WARPS[1].lifting, parameters, domain)


def test_every_layout_of_the_same_numbers_gives_the_same():
    source, centres = positions(30).round(), control_points(5).round()
    target = project(HOMOGRAPHY, source).round()
    expected = fit_warp(source, target, centres).parameters
    read_only = target.copy()
    read_only.flags.writeable = False
    for same in (
        target.tolist(),
        target.astype(np.float32),
        np.asfortranarray(target),
        read_only,
        target.astype(int),
    ):
        np.testing.assert_array_equal(fit_warp(source.tolist(), same, centres.tolist()).parameters, expected)
