"""Liftings with only a few nonzero functions at a point."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _core
from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.liftings.lifting import Lifting, blocks

Entries: TypeAlias = Iterator[tuple[slice | NDArray[np.intp], NDArray[np.intp], Floats]]
"""Type of the result of `SparseLifting.entries`."""


class SparseLifting(Lifting):
    """A lifting that defines the nonzero elements of its basis instead of the basis.

    Examples
    --------
    >>> from mexpress.liftings import PiecewiseAffine
    >>> plane, point = PiecewiseAffine([[0, 0], [2, 0], [0, 2]]), np.array([[1.0, 1.0]])
    >>> plane.basis(point)
    array([[0. , 0.5, 0.5]])
    >>> plane.derivatives(point)
    array([[[-0.5, -0.5],
            [ 0.5,  0. ],
            [ 0. ,  0.5]]])
    >>> plane.values(point, np.array([[1.0], [2.0], [3.0]]))
    array([[2.5]])
    >>> plane.slopes(point, np.array([[1.0], [2.0], [3.0]]))
    array([[[0.5, 1. ]]])
    """

    @abstractmethod
    def entries(self, points: Floats, along: int | None = None) -> Entries:
        """Return the nonzero elements of the basis at n points, or of its derivative along x (0) or y (1).

        Parameters
        ----------
        points : ndarray, (n, 2)
            Positions, in the unit of the control points.
        along : int, optional
            Axis of the derivative, if any.

        Returns
        -------
        iterator of (rows, functions, elements)
            Distinct points; the index of a function for each of them; the number to add to that element of the basis.

        Examples
        --------
        >>> from mexpress.liftings import PiecewiseAffine
        >>> plane = PiecewiseAffine([[0, 0], [2, 0], [0, 2]])
        >>> [(int(k[0]), float(e[0])) for _, k, e in plane.entries(np.array([[1.0, 0.5]]))]
        [(0, 0.25), (1, 0.5), (2, 0.25)]
        """

    def basis(self, points: ArrayLike) -> Floats:
        """Return the l functions at n points, (n, l)."""
        return self._dense(check.points(points, "points"))

    def at(self, points: Floats) -> Floats:
        """Return the basis at checked points, (n, l)."""
        return self._dense(points)

    def derivatives(self, points: ArrayLike) -> Floats:
        """Return the derivatives of the l functions along x and y at n points, (n, l, 2)."""
        points = check.points(points, "points")
        return np.stack([self._dense(points, b) for b in range(2)], axis=-1)

    def values(self, points: Floats, parameters: Floats) -> Floats:
        """Return nu(q_i) . x for every column x of the parameters, (n, r)."""
        return self._product(points, parameters)

    def slopes(self, points: Floats, parameters: Floats) -> Floats:
        """Return the derivatives of nu(q) . x along x and y, for every column x of the parameters, (n, r, 2)."""
        return np.stack([self._product(points, parameters, b) for b in range(2)], axis=-1)

    def _dense(self, points: Floats, along: int | None = None) -> Floats:
        matrix = np.zeros((len(points), len(self.control_points)))
        numbers = np.arange(len(points))
        for rows, functions, elements in self.entries(points, along):
            matrix[numbers[rows], functions] += elements
        return matrix

    @np.errstate(over="ignore", invalid="ignore")
    def _product(self, points: Floats, parameters: Floats, along: int | None = None) -> Floats:
        product = np.zeros((len(points), parameters.shape[1]))
        for block in blocks(len(points), 4):
            here = product[block]
            for rows, functions, elements in self.entries(points[block], along):
                here[rows] += elements[:, None] * parameters[functions]
        return product


class LocalLifting(SparseLifting):
    """A sparse lifting that the core evaluates, on all threads."""

    @property
    @abstractmethod
    def _functions(self) -> _core.LocalFunctions:
        """What the core knows of the functions."""

    def entries(self, points: Floats, along: int | None = None) -> Entries:
        """Return the nonzero elements of the basis at n points, or of its derivative along x (0) or y (1)."""
        order = 0 if along is None else along + 1
        functions, elements = self._functions.elements(np.ascontiguousarray(points, float), order)
        for here, column in zip(functions.reshape(elements.shape).T, elements.T, strict=True):
            if len(rows := np.flatnonzero(column)):
                yield rows, here[rows], column[rows]

    def values(self, points: Floats, parameters: Floats) -> Floats:
        """Return nu(q_i) . x for every column x of the parameters, (n, r)."""
        return self._functions.values(*_for_the_core(points, parameters))

    def slopes(self, points: Floats, parameters: Floats) -> Floats:
        """Return the derivatives of nu(q) . x along x and y, for every column x of the parameters, (n, r, 2)."""
        slopes = self._functions.slopes(*_for_the_core(points, parameters))
        return slopes.reshape(len(points), parameters.shape[1], 2)


def _for_the_core(points: Floats, parameters: Floats) -> tuple[Floats, Floats, int]:
    return (
        np.ascontiguousarray(points, float),
        np.ascontiguousarray(parameters, float),
        check.threads(None),
    )
