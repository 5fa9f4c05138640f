"""Warps and surfaces, and their fits as linear least-squares problems: sections 4.2 and 5 of the paper."""

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
from mexpress.models.error_curves import ErrorCurve, ErrorCurves
from mexpress.models.expectation import FittedModel
from mexpress.models.jackknife import Interval
from mexpress.models.observations import Observations
from mexpress.models.surface import Surface, SurfaceGrid
from mexpress.models.warp import Warp

__all__ = [
    "Basis",
    "CardinalBasis",
    "Design",
    "ErrorCurve",
    "ErrorCurves",
    "FittedModel",
    "FractionalDesign",
    "Interval",
    "LinearDesign",
    "Model",
    "ModelT",
    "NestedBasis",
    "Observations",
    "Surface",
    "SurfaceGrid",
    "Warp",
    "fractional_design",
    "linear_design",
]
