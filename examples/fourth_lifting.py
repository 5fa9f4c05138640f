"""A fourth lifting: the polyharmonic cubic r^3, in one class. docs/liftings.md explains it.

Importing this file is all that mexpress needs to know the lifting by its name: `select_warp(..., lifting="cubic")`,
`fit_warp`, and models that load from their files. Running it compares the lifting with thin-plate splines.
"""

from functools import cached_property

import numpy as np

import mexpress as mx
from mexpress.liftings import Lifting, register


# The class in docs/liftings.md
@register
class Cubic(Lifting):
    """f(q) = a . (1, q) + sum_k w_k |q - c_k|^3 with sum_k w_k (1, c_k) = 0: one derivative smoother than TPS."""

    name = "cubic"

    def basis(self, points):
        """Return the l functions at n points, (n, l): 1 at one control point, 0 at the others."""
        return self._terms(points) @ self._solution[0]

    def derivatives(self, points):
        """Return their derivatives along x and y, (n, l, 2)."""
        offset = self._normalised(points)[:, None] - self._normalised(self.control_points)
        cubes = 3 * np.linalg.norm(offset, axis=2)[..., None] * offset
        affine = np.broadcast_to(np.eye(3)[:, 1:], (len(cubes), 3, 2))
        terms = np.concatenate([cubes, affine], axis=1) / self._size
        return np.einsum("ntb,tl->nlb", terms, self._solution[0])

    def bending(self):
        """Return rows Z with ||Z x||^2 = w^T K w, which is no integral of second derivatives but ranks like it."""
        return self._solution[1] / self._size

    def _terms(self, points):
        here, centres = self._normalised(points), self._normalised(self.control_points)
        cubes = np.linalg.norm(here[:, None] - centres, axis=2) ** 3
        return np.column_stack([cubes, np.ones(len(here)), here])

    def _normalised(self, points):
        return (np.asarray(points, dtype=float) - self.control_points[0]) / self._size

    @cached_property
    def _size(self):
        return np.ptp(self.control_points, axis=0).max()

    @cached_property
    def _solution(self):
        """Weights w and affine parts a that make the functions cardinal, and the rows of the energy."""
        terms = self._terms(self.control_points)
        kernel, affine = terms[:, :-3], terms[:, -3:]
        free = np.linalg.qr(affine, mode="complete").Q[:, 3:]
        energy = np.linalg.solve(np.linalg.cholesky(free.T @ kernel @ free), free.T)
        weights = energy.T @ energy
        rest = np.eye(len(kernel)) - kernel @ weights
        return np.vstack([weights, np.linalg.pinv(affine) @ rest]), energy


# The end of the class


def main() -> None:
    """Fit a bent sheet seen in perspective with both liftings, and print how far each is from the truth."""
    rng = np.random.default_rng(0)
    source, queries = (rng.uniform(0, 1, (count, 2)) * [640, 480] for count in (150, 2000))

    def seen(points):
        bent = points + 12 * np.sin(points[:, ::-1] / 110)
        return bent / (0.8 + points[:, :1] / 1600)

    target = seen(source) + rng.normal(0, 1, source.shape)
    print("lifting  control points  RMS on 2,000 other points, pixels")
    for name in ("tps", "cubic"):
        warp = mx.select_warp(
            source, target, "CMPRESS", lifting=name, image_size=(640, 480), smoothing=0
        ).warp
        error = np.sqrt(((warp(queries) - seen(queries)) ** 2).sum(axis=1).mean())
        print(f"{name:7}  {len(warp.control_points):14}  {error:.2f}")


if __name__ == "__main__":
    main()
