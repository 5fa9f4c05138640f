import cv2
import numpy as np
import pytest

from mexpress.io.keypoints import matches_of
from mexpress.io.matches import read_matches, read_weighted_matches

FIRST = np.array([[1.0, 2], [3, 4], [5, 6], [7, 8.5]], np.float32)
SECOND = np.array([[10.0, 20], [30, 40], [50, 60]], np.float32)
SOURCE, TARGET = FIRST[[1, 3]], SECOND[[2, 0]]

KEYPOINTS = [[cv2.KeyPoint(float(x), float(y), 1) for x, y in points] for points in (FIRST, SECOND)]
PAIRS = [cv2.DMatch(1, 2, 0.5), cv2.DMatch(3, 0, 0.25)]


@pytest.mark.parametrize(
    ("keypoints", "matches"),
    [
        ((FIRST, SECOND), [[1, 2], [3, 0]]),
        ((FIRST, SECOND), np.array([-1, 2, -1, 0])),
        ((FIRST, SECOND), PAIRS),
        (KEYPOINTS, PAIRS),
        (tuple(map(tuple, KEYPOINTS)), tuple(PAIRS)),
        (KEYPOINTS, np.array([[1, 2], [3, 0]], np.int32)),
        ((FIRST[:, None], SECOND[:, None]), PAIRS),
        ((FIRST[None], SECOND[None]), PAIRS),
    ],
)
def test_matches_of_any_matcher(keypoints, matches):
    source, target = matches_of(*keypoints, matches)
    np.testing.assert_array_equal(source, SOURCE)
    np.testing.assert_array_equal(target, TARGET)


def test_those_of_opencv():
    image = np.zeros((200, 200), np.uint8)
    for k, (x, y) in enumerate(np.random.default_rng(0).integers(20, 170, (25, 2))):
        cv2.rectangle(image, (int(x), int(y)), (int(x) + 5 + k, int(y) + 9), 50 + 8 * k, -1)
    orb = cv2.ORB_create()
    (first, one), (second, two) = (orb.detectAndCompute(np.roll(image, k, axis=1), None) for k in (0, 6))
    found = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(one, two)
    source, target = matches_of(first, second, found)
    assert len(source) == len(found) > 20
    np.testing.assert_array_equal(np.median(target - source, axis=0), [6, 0])


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((FIRST, SECOND, [[1, 3]]), r"matches\. Indices into keypoints1 must be from 0 to 2\. Given 3"),
        ((FIRST, SECOND, [[-1, 0]]), r"keypoints0 must be from 0 to 3\. Given -1"),
        ((FIRST, SECOND, [0, 1]), r"matches\. .*DMatch\. Given shape \(2,\) for 4"),
        ((FIRST, SECOND, [[0, 1, 2]]), r"shape \(1, 3\)"),
        ((FIRST, SECOND, [[0.0, 1.0]]), r"matches\. "),
        ((FIRST, SECOND, [[PAIRS[0], PAIRS[1]]]), r"matches\. .*DMatch"),
        ((FIRST, SECOND, None), r"matches\. .*DMatch"),
        ((FIRST[:, :1], SECOND, PAIRS), r"keypoints0\. "),
        ((FIRST, 7, PAIRS), r"keypoints1\. .*KeyPoint"),
    ],
)
def test_what_is_refused(arguments, says):
    with pytest.raises((ValueError, TypeError), match=rf"^Invalid .*{says}"):
        matches_of(*arguments)


@pytest.mark.parametrize(
    ("arrays", "weights"),
    [
        (
            {"matches": np.array([-1, 2, -1, 0]), "match_confidence": np.array([0, 0.5, 0, 0.25])},
            "match_confidence",
        ),
        (
            {"matches0": np.array([-1, 2, -1, 0]), "matching_scores0": np.array([0, 0.5, 0, 0.25])},
            "matching_scores0",
        ),
        ({"matches": np.array([[1, 2], [3, 0]]), "scores": np.array([0.5, 0.25])}, "scores"),
    ],
)
def test_archives_of_superglue_and_lightglue(tmp_path, arrays, weights):
    np.savez(tmp_path / "m.npz", keypoints0=FIRST, keypoints1=SECOND, **arrays)
    np.testing.assert_array_equal(np.hstack(read_matches(tmp_path / "m.npz")), np.hstack([SOURCE, TARGET]))
    assert read_weighted_matches(tmp_path / "m.npz").weights is None
    assert read_weighted_matches(tmp_path / "m.npz", weights).weights.tolist() == [0.5, 0.25]
