"""Matches as matchers give them: keypoints of two images, and which belong together.

Examples
--------
>>> keypoints = [[0, 0], [5, 0], [9, 9]]
>>> matches_of(keypoints, [[1, 1], [7, 1]], [1, -1, 0])  # SuperGlue: the keypoint of the other image, -1 for none
(array([[0., 0.], [9., 9.]]), array([[7., 1.], [1., 1.]]))
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats, Integers


def matches_of(
    keypoints0: ArrayLike | Iterable[Any],
    keypoints1: ArrayLike | Iterable[Any],
    matches: ArrayLike | Iterable[Any],
) -> tuple[Floats, Floats]:
    """Return matched points of two images.

    Parameters
    ----------
    keypoints0, keypoints1 : (n, 2) and (m, 2) array, or sequences of cv2.KeyPoint
        Points of the first and the second image in pixels.
    matches : (k, 2) array, (n,) array, or sequence of cv2.DMatch
        Pairs of a keypoint of the first and one of the second image, as LightGlue and kornia give them; or the second
        for each of the first, -1 for none, as SuperGlue does; or those of OpenCV with their `queryIdx` and `trainIdx`.

    Returns
    -------
    source, target : ndarray, (k, 2)
        Matched points, in the order of the matches.

    Raises
    ------
    ValueError, TypeError
        If a match is of a keypoint that is not there, or the input is something else.

    Examples
    --------
    >>> matches_of([[0, 0], [5, 0], [9, 9]], [[1, 1], [7, 1]], [[2, 0]])
    (array([[9., 9.]]), array([[1., 1.]]))
    """
    first, second = _places(keypoints0, "keypoints0"), _places(keypoints1, "keypoints1")
    pairs = index_pairs(matches, len(first), len(second))
    return first[pairs[:, 0]], second[pairs[:, 1]]


def index_pairs(matches: Any, n: int, m: int) -> Integers:
    """Return which of n and m keypoints belong together, (k, 2), from any form that `matches_of` takes.

    Examples
    --------
    >>> index_pairs([-1, 4, 0], 3, 5)
    array([[1, 4], [2, 0]])
    """
    rule = "They must be pairs of indices (k, 2), an index for each keypoint of the first image, or a list of DMatch."
    if not isinstance(matches, np.ndarray):
        listed = check.items(matches, "matches", rule)
        if listed and all(hasattr(match, "queryIdx") for match in listed):
            matches = [(match.queryIdx, match.trainIdx) for match in listed]
    numbers = check.array(matches, "matches", rule, "iu")
    if numbers.ndim == 1 and len(numbers) == n:
        numbers = np.column_stack([np.arange(n), numbers])[numbers >= 0]
    if numbers.ndim != 2 or numbers.shape[1] != 2:
        check.refuse("matches", rule, f"shape {numbers.shape} for {n} keypoints")
    for k, bound in enumerate((n, m)):
        for bad in numbers[(numbers[:, k] < 0) | (numbers[:, k] >= bound), k][:1]:
            check.refuse("matches", f"Indices into keypoints{k} must be from 0 to {bound - 1}.", f"{bad}")
    return numbers.astype(np.int64)


def _places(keypoints: Any, name: str) -> Floats:
    if not isinstance(keypoints, np.ndarray):
        listed = check.items(keypoints, name, "It must be points (n, 2), or a list of KeyPoint.")
        keypoints = [getattr(point, "pt", point) for point in listed]
    return check.points(keypoints, name)
