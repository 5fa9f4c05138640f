"""Liftings: the functions whose linear combinations bend the plane.

A lifting nu maps a point q to l numbers; a scalar function is f(q) = nu(q) . x. A new lifting is a subclass of
`Lifting` that `register` adds by its name.

Examples
--------
>>> from mexpress.liftings import make_lifting
>>> make_lifting("tps", [[0, 0], [2, 0], [0, 2]]).basis([[1, 1]]).round(6) + 0.0
array([[0. , 0.5, 0.5]])
"""

from mexpress.liftings.affine import PiecewiseAffine
from mexpress.liftings.bspline import BSpline
from mexpress.liftings.lifting import LIFTINGS, Lifting, check_lifting, lifting_named, make_lifting, register
from mexpress.liftings.nested_tps import NestedSplines, nested_basis, nested_bending
from mexpress.liftings.sparse import SparseLifting
from mexpress.liftings.tps import ThinPlateSpline

__all__ = [
    "LIFTINGS",
    "BSpline",
    "Lifting",
    "NestedSplines",
    "PiecewiseAffine",
    "SparseLifting",
    "ThinPlateSpline",
    "check_lifting",
    "lifting_named",
    "make_lifting",
    "nested_basis",
    "nested_bending",
    "register",
]


def __dir__() -> list[str]:
    return sorted(__all__)
