"""Warps and surfaces, and their fits as linear least-squares problems: sections 4.2 and 5 of the paper.

Examples
--------
>>> import numpy as np
>>> from mexpress.geometry import Region
>>> from mexpress.liftings import ThinPlateSpline
>>> from mexpress.models import CardinalBasis, Warp, linear_design
>>> square = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0], [100.0, 100.0]])
>>> basis = CardinalBasis(ThinPlateSpline(square))
>>> linear_design(basis, square, 2 * square, Region.of(square), Warp).A.shape
(4, 4)
"""

from mexpress.models.base import Model
from mexpress.models.design import (
    Basis,
    CardinalBasis,
    Design,
    FractionalDesign,
    LinearDesign,
    ModelT,
    NestedBasis,
    fractional_design,
    linear_design,
)
from mexpress.models.surface import Surface, SurfaceGrid
from mexpress.models.warp import Warp

__all__ = [
    "Basis",
    "CardinalBasis",
    "Design",
    "FractionalDesign",
    "LinearDesign",
    "Model",
    "ModelT",
    "NestedBasis",
    "Surface",
    "SurfaceGrid",
    "Warp",
    "fractional_design",
    "linear_design",
]
