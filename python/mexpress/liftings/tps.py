"""Thin-plate splines: the smoothest functions with given values at scattered control points."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _core
from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.caching import cached_property
from mexpress.geometry import Region
from mexpress.liftings.lifting import Lifting, register
from mexpress.placement import lloyd


@register
class ThinPlateSpline(Lifting):
    """Thin-plate splines with given control points, in cardinal form.

    The functions f(q) = a . (1, q) + sum_k w_k phi(|q - c_k|), with phi(r) = r^2 log r and sum_k w_k (1, c_k) = 0, form
    a space of dimension l. The coordinates x are the values f(c_k) at the control points, in the unit of f. Constants
    and affine functions are contained exactly; three control points give only these. Values are infinite or NaN at
    points so far away that squared distances overflow.

    Parameters
    ----------
    control_points : array_like, (l, 2)
        Positions c_k, see `Lifting`.

    Examples
    --------
    >>> spline = ThinPlateSpline([[0, 0], [100, 0], [0, 100], [100, 100]])
    >>> spline
    ThinPlateSpline(4 control points)
    >>> spline.basis([[100, 0], [50, 50]]).round(6) + 0.0
    array([[0.  , 1.  , 0.  , 0.  ],
           [0.25, 0.25, 0.25, 0.25]])
    >>> spline.values(np.array([[50.0, 50.0]]), np.array([[0.0], [2.0], [4.0], [6.0]])).round(6)
    array([[3.]])
    >>> spline.slopes(np.array([[50.0, 50.0]]), np.array([[0.0], [2.0], [4.0], [6.0]])).round(6)
    array([[[0.02, 0.04]]])
    """

    name: ClassVar[str] = "tps"

    def basis(self, points: ArrayLike) -> Floats:
        """Return the l cardinal functions at n points, (n, l): 1 at one control point, 0 at the others."""
        return self.at(check.points(points, "points"))

    def at(self, points: Floats) -> Floats:
        """Return the basis at checked points, (n, l)."""
        return self._splines(_core.spline_values, points, self._solution[0])

    @classmethod
    def place_over(cls, region: Region, count: int, seed: int = 0, threads: int | None = None) -> Floats:
        """Return the control points of `place` over a known region."""
        return lloyd(region, count, seed, threads)

    def derivatives(self, points: ArrayLike) -> Floats:
        """Return the derivatives of the l cardinal functions along x and y at n points, (n, l, 2).

        Examples
        --------
        >>> ThinPlateSpline([[0, 0], [2, 0], [0, 2]]).derivatives([[1, 1]]).round(6) + 0.0
        array([[[-0.5, -0.5],
                [ 0.5,  0. ],
                [ 0. ,  0.5]]])
        """
        return self.slopes(check.points(points, "points"), np.eye(len(self.control_points)))

    def bending(self) -> Floats:
        """Return the rows Z of the bending energy ||Z x||^2, (l - 3, l).

        ||Z x||^2 = w^T K w with K_jk = phi(|c_j - c_k|) and distances in the unit of the control points. 8 pi ||Z x||^2
        is the integral of f_xx^2 + 2 f_xy^2 + f_yy^2 over the plane. It depends on the function alone, so energies of
        splines with different control points are comparable.

        Examples
        --------
        >>> energy = ThinPlateSpline([[0, 0], [1, 0], [0, 1], [1, 1]]).bending() @ [0, 0, 0, 1]
        >>> (energy @ energy).round(6)
        np.float64(0.360674)
        """
        return self._solution[1] / self._scale

    def values(self, points: Floats, parameters: Floats) -> Floats:
        """Return nu(q_i) . x for every column x of the parameters, (n, r)."""
        return self._splines(_core.spline_values, points, self._weights(parameters))

    @np.errstate(over="ignore", invalid="ignore")
    def slopes(self, points: Floats, parameters: Floats) -> Floats:
        """Return the derivatives of nu(q) . x along x and y, for every column x of the parameters, (n, r, 2)."""
        slopes = self._splines(_core.spline_slopes, points, self._weights(parameters)) / self._scale
        return np.asarray(slopes.reshape(len(points), parameters.shape[1], 2))

    def _weights(self, parameters: Floats) -> Floats:
        """Return the weights of the terms, (l + 3, r)."""
        return _core.product(self._solution[0], np.ascontiguousarray(parameters), check.threads(None))

    def _splines(self, evaluate: Callable[..., Floats], points: Floats, weights: Floats) -> Floats:
        """Have the core sum the terms phi(|q - c_k|), x, y and 1 at points, in normalised coordinates."""
        with np.errstate(over="ignore", invalid="ignore"):
            points = np.ascontiguousarray(self._normalised(points))
        return evaluate(points, self._normalised(self.control_points), weights, check.threads(None))

    @cached_property
    def _centre(self) -> Floats:
        return np.asarray(self.control_points.mean(axis=0))

    @cached_property
    def _scale(self) -> float:
        return float(np.hypot(*(self.control_points - self._centre).T).max())

    def _normalised(self, points: Floats) -> Floats:
        # A similarity changes phi by multiples of r^2, which the conditions on w turn into constants: the
        # functions are the same, and coordinates of thousands of pixels lose no digits.
        return np.asarray((points - self._centre) / self._scale)

    @cached_property
    def _solution(self) -> tuple[Floats, Floats]:
        """Return weights w and affine parts a of the cardinal functions, (l + 3, l), and the bending rows.

        For an orthonormal basis U of {w : sum_k w_k (1, c_k) = 0}, G = U^T K U is positive definite, w = E x with
        E = U G^-1 U^T, and the affine part interpolates the remainder of K w: a = P^+ (x - K E x). By the core, whose
        results do not depend on the threads of NumPy's BLAS.
        """
        here = self._normalised(self.control_points)
        affine = np.column_stack([here, np.ones(len(here))])
        return _core.cardinal_splines(kernel(here, here), affine, check.threads(None))


def kernel(points: Floats, centres: Floats) -> Floats:
    """Return phi = r^2 log r = (r^2 log r^2) / 2, (n, l); a lower bound in the logarithm gives 0 at r = 0.

    Examples
    --------
    >>> kernel(np.array([[0.0, 0.0]]), np.array([[0.0, 0.0], [0.0, 3.0]])).round(3) + 0.0
    array([[0.   , 9.888]])
    """
    x, y = (np.subtract.outer(points[:, b], centres[:, b]) for b in range(2))
    squared = x**2 + y**2
    return np.asarray(0.5 * squared * np.log(np.maximum(squared, np.finfo(float).tiny)))
