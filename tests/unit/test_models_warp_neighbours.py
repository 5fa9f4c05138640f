"""Warps in the hands of scikit-image, OpenCV, SimpleITK and GDAL, against what these compute of them."""

import sys

import cv2
import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813 - as its documentation has it
from inputs import in_form, refused
from skimage.measure import ransac
from skimage.transform import warp as skimage_warp

import mexpress as mx

WIDTH, HEIGHT = 60, 45
RNG = np.random.default_rng(4)
SOURCE = RNG.uniform(0, 1, (80, 2)) * [WIDTH, HEIGHT]
TARGET = 0.9 * SOURCE + [3, 2] + np.sin(SOURCE[:, ::-1] / 12)
WARP = mx.fit_warp(SOURCE, TARGET, SOURCE[:20])
X, Y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
IMAGE = (np.sin(X / 5.0) + np.cos(Y / 7.0) + X / 30.0).astype(np.float64)
MIDDLE = np.s_[8:-8, 8:-8]


# --------------------------------------------------------------------------------------------- scikit-image


def contaminated(n, wrong, noise):
    source = RNG.uniform(0, 600, (n, 2))
    w = 1 + source @ [1e-4, 2e-4]
    target = (source @ [[1.0, 0.1], [0.05, 0.9]] + [5, 3]) / w[:, None] + RNG.normal(0, noise, (n, 2))
    target[:wrong] = RNG.uniform(0, 600, (wrong, 2))
    return source, target


@pytest.mark.parametrize("samples", [4, 8])
def test_ransac_takes_the_class(samples):
    source, target = contaminated(200, 60, 0.3)
    warp, inliers = ransac((source, target), mx.Warp, samples, 3, max_trials=300, rng=0)
    assert inliers[:60].sum() <= 2
    assert inliers[60:].sum() > 100
    assert isinstance(warp, mx.Warp)
    assert len(warp.control_points) == min(inliers.sum() // 4, 100)
    np.testing.assert_allclose(warp.residuals(source[inliers], target[inliers]), 0, atol=3)


def test_ransac_goes_on_after_samples_on_a_line():
    source, target = contaminated(40, 0, 0)
    source[:37, 1] = 7.0
    target[:37] = (source[:37] @ [[1.0, 0.1], [0.05, 0.9]] + [5, 3]) / (1 + source[:37] @ [1e-4, 2e-4])[
        :, None
    ]
    warp, inliers = ransac((source, target), mx.Warp, 8, 1, max_trials=50, rng=0)
    assert inliers.all()
    np.testing.assert_allclose(warp(source), target, atol=1e-6)


def test_an_estimate_is_the_fit_with_its_control_points():
    warp = mx.Warp.from_estimate(SOURCE, TARGET)
    assert warp.control_points.shape == (20, 2)
    expected = mx.fit_warp(SOURCE, TARGET, warp.control_points)
    np.testing.assert_allclose(warp(SOURCE), expected(SOURCE), rtol=0, atol=1e-12)
    assert warp.data is not None
    assert np.isfinite(warp.error([[30, 20]])).all()
    plain = mx.Warp.from_estimate(SOURCE, TARGET, 7, fractional=False)
    assert (plain.fractional, len(plain.control_points)) == (False, 7)


def test_an_estimate_does_not_share_arrays_with_its_caller():
    source, target = SOURCE.copy(), TARGET.copy()
    warp = mx.Warp.from_estimate(source, target)
    source[:], target[:] = 0, 0
    np.testing.assert_array_equal(warp.data.points, SOURCE)
    np.testing.assert_array_equal(warp.data.values, TARGET)


def test_a_subclass_estimates_warps_of_its_own_kind():
    class Bent(mx.Warp):
        @classmethod
        def from_estimate(cls, source, target):
            return super().from_estimate(source, target, 6, fractional=False)

    warp, _ = ransac((SOURCE, TARGET), Bent, 12, 1, max_trials=20, rng=0)
    assert (type(warp), len(warp.control_points)) == (Bent, 6)


@pytest.mark.parametrize(
    ("source", "target", "options"),
    [
        (SOURCE[:3], TARGET[:3], {}),
        (SOURCE[:1], TARGET[:1], {}),
        (SOURCE[:2], TARGET[:2], {"fractional": False}),
        (np.column_stack([X[0], 2 * X[0]]), np.column_stack([X[0], 2 * X[0]]), {}),
        (SOURCE[[0] * 9], TARGET[[0] * 9], {}),
        (SOURCE[[0, 1, 2, 2]], TARGET[[0, 1, 2, 2]], {}),
        (SOURCE[:12], TARGET[:12], {"count": 12}),
        (SOURCE[:12], TARGET[:12], {"count": 13, "fractional": False}),
        (SOURCE[[0, 1, 2, 3, 3]], TARGET[:5], {"count": 5, "fractional": False}),
        (SOURCE[:0], TARGET[:0], {}),
    ],
    ids=[
        "three",
        "one",
        "two of an affine map",
        "a line",
        "one place",
        "three places",
        "3l - 1 > 2n",
        "l > n",
        "l > places",
        "none",
    ],
)
def test_what_matches_do_not_determine_is_none(source, target, options):
    assert mx.Warp.from_estimate(source, target, **options) is None


def test_what_is_no_match_is_refused():
    refused(lambda: mx.Warp.from_estimate(SOURCE, TARGET[:-1]), "target", ValueError)
    refused(lambda: mx.Warp.from_estimate(SOURCE.ravel(), TARGET), "source", ValueError)
    refused(lambda: mx.Warp.from_estimate(SOURCE[:0], TARGET), "source", ValueError)
    refused(lambda: mx.Warp.from_estimate(SOURCE, TARGET[:0]), "target", ValueError)
    refused(lambda: mx.Warp.from_estimate([], []), "source", ValueError)
    refused(lambda: mx.Warp.from_estimate(SOURCE * np.nan, TARGET), "source", ValueError)
    refused(lambda: mx.Warp.from_estimate(SOURCE, TARGET, 2), "count", ValueError)
    refused(lambda: mx.Warp.from_estimate(SOURCE, TARGET, fractional=1), "fractional", TypeError)
    refused(lambda: WARP.residuals(SOURCE, TARGET[:-1]), "target", ValueError)


def test_residuals_are_distances():
    np.testing.assert_allclose(
        WARP.residuals(SOURCE, TARGET), np.linalg.norm(TARGET - WARP(SOURCE), axis=1), rtol=1e-12
    )
    square = [[0, 0], [100, 0], [0, 100], [100, 100]]
    steep = mx.fit_warp(square, [[0, 0], [100, 0], [20, 100], [80, 100]], square[:3])
    found = steep.residuals(
        [[50, 50], [50, -300], [np.nan, 0], [0, 0]], [[50, 62.5], [0, 0], [0, 0], [np.inf, 0]]
    )
    assert np.isfinite(found[0])
    assert found[1] == np.inf  # beyond the horizon: an outlier to everyone who compares it with a threshold
    assert np.isnan(found[2:]).all()


def test_scikit_image_resamples_by_the_warp_and_by_its_inverse():
    ours = WARP.remap(IMAGE, inverse=True, tolerance=1e-6)
    np.testing.assert_allclose(skimage_warp(IMAGE, WARP)[MIDDLE], ours[MIDDLE], atol=1e-6)
    ours = WARP.remap(IMAGE, tolerance=1e-6)
    np.testing.assert_allclose(skimage_warp(IMAGE, WARP.inverse)[MIDDLE], ours[MIDDLE], atol=1e-6)
    array = WARP.inverse_map(WIDTH, HEIGHT, 1e-6)[
        ::-1
    ]  # rows first, as scikit-image has coordinates in arrays
    np.testing.assert_allclose(skimage_warp(IMAGE, array)[MIDDLE], ours[MIDDLE], atol=1e-5)


def test_opencv_resamples_by_the_maps():
    for maps, inverse in ((WARP.dense_map, True), (WARP.inverse_map, False)):
        found = cv2.remap(IMAGE, *maps(WIDTH, HEIGHT), cv2.INTER_LINEAR)
        ours = WARP.remap(IMAGE, inverse=inverse)
        np.testing.assert_allclose(found[MIDDLE], ours[MIDDLE], atol=0.02)  # it has 1/32 of a pixel


# ------------------------------------------------------------------------------------------------ SimpleITK


def itk(array, spacing=(1.0, 1.0), origin=(0.0, 0.0), angle=0.0):
    image = sitk.GetImageFromArray(array)
    image.SetSpacing(spacing)
    image.SetOrigin(origin)
    image.SetDirection([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)])
    return image


PLACES = {
    "pixels": ({}, {}),
    "spacing and origin": (
        {"spacing": (0.5, 2.0), "origin": (100.0, -7.0)},
        {"spacing": (3.0, 0.1), "origin": (5.0, 6.0)},
    ),
    "directions": ({"angle": 0.3, "spacing": (0.5, 2.0)}, {"angle": -1.2, "origin": (9.0, 1.0)}),
}


@pytest.mark.parametrize("inverse", [False, True])
@pytest.mark.parametrize("places", PLACES)
def test_simpleitk_resamples_as_we_do_wherever_the_images_are(places, inverse):
    here, there = PLACES[places]
    fixed, moving = itk(np.zeros((HEIGHT, WIDTH)), **here), itk(IMAGE, **there)
    transform = WARP.to_sitk(fixed, moving, 1e-6, inverse=inverse)
    found = sitk.GetArrayFromImage(sitk.Resample(moving, fixed, transform, sitk.sitkLinear, -9.0))
    ours = WARP.remap(IMAGE, inverse=not inverse, fill=-9, tolerance=1e-6)
    both = (found != -9) & (ours != -9)
    assert both.mean() > 0.8
    np.testing.assert_allclose(found[both], ours[both], atol=1e-5)


def test_the_other_image_is_where_the_fixed_one_is_unless_told():
    fixed = itk(IMAGE, spacing=(0.5, 2.0), origin=(3.0, 4.0))
    place = fixed.TransformContinuousIndexToPhysicalPoint((20.0, 10.0))
    x, y = WARP([[20, 10]])[0]
    expected = fixed.TransformContinuousIndexToPhysicalPoint((x, y))
    np.testing.assert_allclose(WARP.to_sitk(fixed, tolerance=0).TransformPoint(place), expected, atol=1e-9)


def test_a_field_of_vectors_is_one_of_itk():
    field = WARP.displacement_field(WIDTH, HEIGHT, 0)
    assert (field.shape, field.dtype) == ((HEIGHT, WIDTH, 2), np.float64)
    positions = np.column_stack([X.ravel(), Y.ravel()])
    np.testing.assert_allclose(field.reshape(-1, 2), WARP(positions) - positions, atol=1e-4)
    transform = sitk.DisplacementFieldTransform(sitk.GetImageFromArray(field, isVector=True))
    np.testing.assert_allclose(transform.TransformPoint((11.0, 30.0)), WARP([[11, 30]])[0], atol=1e-4)
    back = WARP.displacement_field(WIDTH, HEIGHT, 0, inverse=True)
    np.testing.assert_allclose(back.reshape(-1, 2), WARP.inverse(positions) - positions, atol=1e-4)


def test_what_is_nowhere_has_the_default_value_of_itk():
    transform = WARP.to_sitk(itk(IMAGE), outside="nan")
    lost = np.isnan(WARP.displacement_field(WIDTH, HEIGHT, outside="nan")).any(axis=-1)
    assert 0 < lost.sum() < lost.size
    found = sitk.GetArrayFromImage(sitk.Resample(itk(IMAGE), itk(IMAGE), transform, sitk.sitkLinear, -9.0))
    assert (found[lost] == -9).all()


@pytest.mark.parametrize("wrong", [None, IMAGE, "image", sitk.Image(3, 4, 5, sitk.sitkUInt8)])
def test_what_is_no_image_of_two_dimensions(wrong):
    refused(lambda: WARP.to_sitk(wrong), "fixed")
    if wrong is not None:
        refused(lambda: WARP.to_sitk(itk(IMAGE), wrong), "moving")


def test_without_simpleitk_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "SimpleITK", None)
    with pytest.raises(ImportError, match=r"pip install 'mexpress\[simpleitk\]'"):
        WARP.to_sitk(itk(IMAGE))


@pytest.mark.parametrize("flag", [None, 1, "yes"])
def test_flags_are_true_or_false(flag):
    for call in (WARP.displacement_field, lambda *size, inverse: WARP.to_sitk(itk(IMAGE), inverse=inverse)):
        with pytest.raises(TypeError) as caught:
            call(4, 3, inverse=flag)
        in_form(caught.value)


@pytest.mark.parametrize("inverse", [False, True])
@pytest.mark.parametrize("size", [(10**6, 10**6), (1, 10**11), (10**30, 1)])
def test_images_that_no_machine_holds(size, inverse):
    refused(lambda: WARP.displacement_field(*size, inverse=inverse), "width", ValueError)
    refused(lambda: (WARP.inverse_map if inverse else WARP.dense_map)(*size), "width", ValueError)
    refused(lambda: WARP.remap(np.zeros((3, 4)), size, inverse=inverse), "width", ValueError)
