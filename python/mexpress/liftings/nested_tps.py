"""Thin-plate splines in an order of their control points: every leading part of the basis is a basis."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _core
from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.geometry import NEAR_LINE, thinness
from mexpress.liftings.lifting import blocks, check_spread
from mexpress.liftings.tps import kernel


class NestedSplines:
    """The functions of `nested_basis` and their bending energy, for control points that are prepared once.

    Parameters
    ----------
    control_points : ndarray, (l, 2)
        Control points in their order, finite.

    Raises
    ------
    ValueError
        If they suit no thin-plate spline, or the first three are on a line.

    Examples
    --------
    >>> splines = NestedSplines(np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 2.0], [2.0, 2.0]]))
    >>> splines.at(np.array([[1.0, 1.0]])).round(6) + 0.0
    array([[0. , 0.5, 0.5, 0. ]])
    """

    def __init__(self, control_points: Floats) -> None:
        check_spread(control_points)
        if thinness(control_points[:3]) <= NEAR_LINE:
            rule = f"The first three must not lie on a line, to within {NEAR_LINE:g} of their extent."
            check.refuse("control_points", rule, f"{control_points[:3].tolist()}")
        self._origin = control_points[0]
        self._scale = float(np.hypot(*(control_points[1:3] - self._origin).T).max())
        self._centres: Floats = (control_points - self._origin) / self._scale
        self._shares = self._barycentric(self._centres)

    @np.errstate(over="ignore", invalid="ignore")
    def at(self, points: Floats) -> Floats:
        """Return the functions at points, (n, l)."""
        functions = np.empty((len(points), len(self._centres)))
        for rows in blocks(len(points), len(self._centres)):
            here = (points[rows] - self._origin) / self._scale
            distances = kernel(here, self._centres)
            functions[rows, :3] = self._barycentric(here)
            functions[rows, 3:] = distances[:, 3:]
            for i in range(3):
                functions[rows, 3:] -= np.outer(distances[:, i], self._shares[3:, i])
        return functions

    def bending(self) -> Floats:
        """Return the rows of `nested_bending`, (l - 3, l)."""
        count = len(self._centres)
        rows = np.zeros((count - 3, count))
        kernels = kernel(self._centres, self._centres)
        rows[:, 3:] = _core.leading_bending(kernels, self._shares, check.threads(None)) / self._scale
        return rows

    def _barycentric(self, points: Floats) -> Floats:
        """Return barycentric coordinates with respect to the first three centres; the first centre is the origin."""
        (x, y), (a, b), (c, d) = points.T, *self._centres[1:3]
        second, third = (d * x - c * y) / (a * d - b * c), (a * y - b * x) / (a * d - b * c)
        return np.column_stack([1 - second - third, second, third])


def nested_basis(points: ArrayLike, control_points: ArrayLike) -> Floats:
    """Return functions: the first k span the thin-plate splines of the first k control points.

    The first three are the barycentric coordinates with respect to the first three control points. Function k > 3 is
    phi(|q - c_k|) minus its barycentric combination of the kernels of these three, in coordinates where they are about
    one apart. A function does not depend on later control points.

    Parameters
    ----------
    points : array_like, (n, 2)
        Positions, in the unit of the control points.
    control_points : array_like, (l, 2)
        As for `ThinPlateSpline`. The farther apart the first three are, the more accurate is the result.

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
    points, control_points = check.points(points, "points"), check.points(control_points, "control_points")
    return NestedSplines(control_points).at(points)


def nested_bending(control_points: ArrayLike) -> Floats:
    """Return the rows Z of the bending energy of every leading part of `nested_basis`.

    The energy of the first k functions is ||Z[:k - 3, :k] x||^2, in the unit of `ThinPlateSpline.bending`.

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
    return NestedSplines(check.points(control_points, "control_points")).bending()
