"""The data of a selection, checked once: matches of two images, or samples of a surface.

Both have `points`, `values`, `weights`, `domain` and `diagonal`, and make a design over a basis. Warps and surfaces
differ in nothing else.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.geometry import Region, diagonal, hull
from mexpress.models import Basis, Design, Surface, Warp, fractional_design, linear_design


@dataclass(frozen=True, eq=False, repr=False)
class Matches:
    """Point matches between two images.

    Parameters
    ----------
    source, target : (n, 2) array
        Matched points, x then y, in pixels of either image.
    weights : (n,) array or None
        Weights of the matches; 1 each if None.
    domain : Region
        Region that the source points cover.
    image_size : (width, height) or None
        Size of the source image in pixels.

    Examples
    --------
    >>> Matches.of([[0, 0], [9, 0], [0, 9]], [[1, 1], [9, 0], [0, 9]], image_size=(30, 40))
    Matches(3 matches, diagonal 50)
    """

    source: Floats
    target: Floats
    weights: Floats | None
    domain: Region
    image_size: tuple[float, float] | None

    @classmethod
    def of(
        cls, source: ArrayLike, target: ArrayLike, image_size: Any = None, weights: ArrayLike | None = None
    ) -> Matches:
        """Check matches: n pairs of finite points, with source points that are not on a line."""
        source, target = check.points(source, "source"), check.points(target, "target")
        if len(source) != len(target):
            rule = "It must have one point per source point."
            check.refuse("target", rule, f"{len(target)} for {len(source)}")
        size = check.image_size(image_size)
        return cls(source, target, _weights(weights), Region(hull(source, "source")), size)

    def __repr__(self) -> str:
        return f"Matches({len(self.source)} matches, diagonal {self.diagonal:g})"

    @property
    def points(self) -> Floats:
        """Positions of the data."""
        return self.source

    @property
    def values(self) -> Floats:
        """Measurements at those positions."""
        return self.target

    @cached_property
    def diagonal(self) -> float:
        """Length that radii are percentages of: the diagonal of the image, or of the source points' bounding box."""
        return diagonal(self.source) if self.image_size is None else math.hypot(*self.image_size)

    def design(self, basis: Basis, fractional: bool, over_data: bool | None = None) -> Design[Warp]:
        """Write the fit of a warp as a least-squares problem, see `mexpress.models.fractional_design`."""
        if fractional:
            design: Design[Warp] = fractional_design(basis, self.source, self.target, self.domain, over_data)
        else:
            design = linear_design(basis, self.source, self.target, self.domain, Warp)
        return design.weighted(self.weights)


@dataclass(frozen=True, eq=False, repr=False)
class Samples:
    """Values at points of the plane.

    Parameters
    ----------
    points : (n, 2) array
        Positions.
    values : (n,) or (n, d) array
        Depths, or points in space.
    weights : (n,) array or None
        Weights of the data; 1 each if None.
    domain : Region
        Region that the points cover.

    Examples
    --------
    >>> Samples.of([[0, 0], [4, 0], [0, 3]], [1.0, 2.0, 3.0])
    Samples(3 data, diagonal 5)
    """

    points: Floats
    values: Floats
    weights: Floats | None
    domain: Region

    @classmethod
    def of(cls, points: ArrayLike, values: ArrayLike, weights: ArrayLike | None = None) -> Samples:
        """Check data: n finite points that are not on a line, with a value each."""
        points = check.points(points, "points")
        values = check.columns(values, "values", len(points))
        return cls(points, values, _weights(weights), Region(hull(points, "points")))

    def __repr__(self) -> str:
        return f"Samples({len(self.points)} data, diagonal {self.diagonal:g})"

    @cached_property
    def diagonal(self) -> float:
        """Length that radii are percentages of: the diagonal of the points' bounding box."""
        return diagonal(self.points)

    def design(self, basis: Basis) -> Design[Surface]:
        """Write the fit of a surface as a least-squares problem."""
        return linear_design(basis, self.points, self.values, self.domain, Surface).weighted(self.weights)


def _weights(weights: ArrayLike | None) -> Floats | None:
    return None if weights is None else check.finite(check.real(weights, "weights"), "weights")


Data: TypeAlias = Matches | Samples
