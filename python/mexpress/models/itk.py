"""Places in space of an image's pixels, as ITK has them, and displacement fields between two images.

A pixel's index (x, y) is where the warps of this package have it: whole numbers at the centres of pixels. Its place is
origin + direction @ (spacing * index).

Examples
--------
>>> import SimpleITK as sitk
>>> image = sitk.Image(4, 3, sitk.sitkUInt8)
>>> image.SetSpacing((0.5, 2.0))
>>> placed(image, np.array([[1.0, 3.0], [0.0, 1.0]]))
array([[0.5, 0. ],
       [1.5, 2. ]])
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.extras import required


def simpleitk() -> ModuleType:
    """Return SimpleITK.

    Raises
    ------
    ImportError
        If it is not installed; the message names the extra.

    Examples
    --------
    >>> simpleitk().__name__
    'SimpleITK'
    """
    return required("SimpleITK", "A transform of SimpleITK needs SimpleITK", "simpleitk")


def check_plane(image: Any, name: str) -> Any:
    """Return an image of SimpleITK; refuse what is none, or has not two dimensions.

    Examples
    --------
    >>> check_plane(np.zeros((3, 4)), "fixed")
    Traceback (most recent call last):
    TypeError: Invalid fixed. It must be an image of SimpleITK, sitk.GetImageFromArray(array) of an array. Given an ...
    """
    if not isinstance(image, simpleitk().Image):
        rule = "It must be an image of SimpleITK, sitk.GetImageFromArray(array) of an array."
        check.refuse(name, rule, check.describe(image), TypeError)
    if image.GetDimension() != 2:
        check.refuse(name, "It must have two dimensions, as image[:, :, k] has.", f"{image.GetDimension()}")
    return image


def placed(image: Any, indices: Floats) -> Floats:
    """Return the places of pixels, (..., 2), whose x and y are the first axis of the indices, (2, ...)."""
    direction = np.reshape(image.GetDirection(), (2, 2))
    scaled = np.moveaxis(indices, 0, -1) * image.GetSpacing()
    return np.asarray(image.GetOrigin() + scaled @ direction.T)


def displacement_transform(fixed: Any, moving: Any, positions: NDArray[np.floating]) -> Any:
    """Return the transform of SimpleITK that takes each pixel of a fixed image to a position in a moving one.

    Parameters
    ----------
    fixed, moving : sitk.Image
        Checked images.
    positions : ndarray, (2, height, width)
        For each pixel of the fixed image, x then y in the moving image. Where it is NaN, so is the transform, and
        `sitk.Resample` has its default value there.
    """
    sitk = simpleitk()
    height, width = positions.shape[1:]
    grid = np.stack(np.meshgrid(np.arange(width), np.arange(height))).astype(np.float64)
    vectors = placed(moving, positions.astype(np.float64)) - placed(fixed, grid)
    field = sitk.GetImageFromArray(vectors, isVector=True)
    field.CopyInformation(fixed)
    return sitk.DisplacementFieldTransform(field)
