"""Thin-plate splines in an order of their control points: a basis of which every leading part is a basis."""

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.liftings.lifting import blocks, check_spread
from mexpress.liftings.tps import kernel
from mexpress.placement import NEAR_LINE, thinness

__all__ = ["nested_basis", "nested_bending"]


@np.errstate(over="ignore", invalid="ignore")
def nested_basis(points: ArrayLike, control_points: ArrayLike) -> Floats:
    """Return functions of which the first k span the thin-plate splines of the first k control points.

    The first three are the barycentric coordinates with respect to the first three control points. Function
    k > 3 is phi(|q - c_k|) minus its barycentric combination of the kernels of these three, in coordinates
    where they are about one apart: a function does not change with the control points after its own.

    Parameters
    ----------
    points : array_like, (n, 2)
        Positions, in the unit of the control points.
    control_points : array_like, (l, 2)
        As for `ThinPlateSpline`. The farther apart the first three are, the fewer digits are lost.

    Returns
    -------
    ndarray, (n, l)
        Row i holds the functions at q_i.

    Raises
    ------
    ValueError
        If the control points suit no thin-plate spline, or the first three are on a line.

    Examples
    --------
    >>> corners = [[0, 0], [2, 0], [0, 2], [2, 2]]
    >>> nested_basis([[1, 1], [2, 2]], corners).round(6) + 0.0
    array([[ 0.      ,  0.5     ,  0.5     ,  0.      ],
           [-1.      ,  1.      ,  1.      ,  0.693147]])
    """
    points, origin, scale, centres, shares = check.points(points, "points"), *_nested_frame(control_points)
    functions = np.empty((len(points), len(centres)))
    for rows in blocks(len(points), len(centres)):
        here = (points[rows] - origin) / scale
        distances = kernel(here, centres)
        functions[rows, :3] = _barycentric(here, centres)
        functions[rows, 3:] = distances[:, 3:]
        for i in range(3):
            functions[rows, 3:] -= np.outer(distances[:, i], shares[3:, i])
    return functions


def nested_bending(control_points: ArrayLike) -> Floats:
    """Return the rows Z whose squared norm is the bending energy, of every leading part of `nested_basis`.

    The energy of the k-th leading model is ||Z[:k - 3, :k] x||^2, in the unit of `ThinPlateSpline.bending`.

    Parameters
    ----------
    control_points : array_like, (l, 2)
        As for `nested_basis`.

    Returns
    -------
    ndarray, (l - 3, l)
        Zeros for the affine functions, then an upper triangle.

    Examples
    --------
    >>> energy = nested_bending([[0, 0], [2, 0], [0, 2], [2, 2]]) @ [5, 5, 5, 1]
    >>> (energy @ energy).round(6)
    np.float64(0.693147)
    """
    _, scale, centres, shares = _nested_frame(control_points)
    weights = np.vstack([-shares[3:].T, np.eye(len(centres) - 3)])
    side, triangle = np.linalg.qr(weights)
    factor = np.linalg.cholesky(side.T @ kernel(centres, centres) @ side)
    rows = np.zeros((len(centres) - 3, len(centres)))
    rows[:, 3:] = factor.T @ triangle / scale
    return rows


def _nested_frame(control_points: ArrayLike) -> tuple[Floats, float, Floats, Floats]:
    """Return origin, unit, and the control points in this frame, with their barycentric coordinates."""
    points = check.points(control_points, "control_points")
    check_spread(points)
    if thinness(points[:3]) <= NEAR_LINE:
        rule = f"The first three must not lie on a line, to within {NEAR_LINE:g} of their extent."
        check.refuse("control_points", rule, f"{points[:3].tolist()}")
    origin = points[0]
    scale = float(np.hypot(*(points[1:3] - origin).T).max())
    centres = (points - origin) / scale
    return origin, scale, centres, _barycentric(centres, centres)


def _barycentric(points: Floats, centres: Floats) -> Floats:
    """Return barycentric coordinates with respect to the first three centres, of which the first is 0."""
    (x, y), (a, b), (c, d) = points.T, *centres[1:3]
    second, third = (d * x - c * y) / (a * d - b * c), (a * y - b * x) / (a * d - b * c)
    return np.column_stack([1 - second - third, second, third])
