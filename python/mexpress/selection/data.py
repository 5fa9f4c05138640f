"""What a selection is about, checked once at the door: matches of two images, or samples of a surface.

Both have `points`, `values`, `weights`, `domain` and `diagonal`, and write themselves as a design over a basis: that is
all by which warps and surfaces differ.

Examples
--------
>>> Matches.of([[0, 0], [9, 0], [0, 9]], [[1, 1], [9, 0], [0, 9]], image_size=(30, 40))
Matches(3 matches, diagonal 50)
>>> Samples.of([[0, 0], [4, 0], [0, 3]], [1.0, 2.0, 3.0])
Samples(3 data, diagonal 5)
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
        Of the matches; one each if None.
    domain : Region
        What the source points cover.
    image_size : (width, height) or None
        Of the source image in pixels.
    """

    source: Floats
    target: Floats
    weights: Floats | None
    domain: Region
    image_size: tuple[float, float] | None

    @classmethod
    def of(cls, source: ArrayLike, target: ArrayLike, image_size: Any = None) -> Matches:
        """Check matches.

        Raises
        ------
        ValueError, TypeError
            If they are not n pairs of finite points, or the source points are on a line.
        """
        source, target = check.points(source, "source"), check.points(target, "target")
        if len(source) != len(target):
            rule = "It must have one point per source point."
            check.refuse("target", rule, f"{len(target)} for {len(source)}")
        size = check.image_size(image_size)
        return cls(source, target, None, Region(hull(source, "source")), size)

    def __repr__(self) -> str:
        return f"Matches({len(self.source)} matches, diagonal {self.diagonal:g})"

    @property
    def points(self) -> Floats:
        """Where the data are."""
        return self.source

    @property
    def values(self) -> Floats:
        """What was measured there."""
        return self.target

    @cached_property
    def diagonal(self) -> float:
        """What radii are percentages of: the diagonal of the image, or of the source points' bounding box."""
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
        Where they are.
    values : (n,) or (n, d) array
        Depths, or points in space.
    weights : (n,) array or None
        Of the data; one each if None.
    domain : Region
        What the points cover.
    """

    points: Floats
    values: Floats
    weights: Floats | None
    domain: Region

    @classmethod
    def of(cls, points: ArrayLike, values: ArrayLike) -> Samples:
        """Check data.

        Raises
        ------
        ValueError, TypeError
            If they are not n finite points with a value each, or the points are on a line.
        """
        points = check.points(points, "points")
        values = check.columns(values, "values", len(points))
        return cls(points, values, None, Region(hull(points, "points")))

    def __repr__(self) -> str:
        return f"Samples({len(self.points)} data, diagonal {self.diagonal:g})"

    @cached_property
    def diagonal(self) -> float:
        """What radii are percentages of: the diagonal of the points' bounding box."""
        return diagonal(self.points)

    def design(self, basis: Basis) -> Design[Surface]:
        """Write the fit of a surface as a least-squares problem."""
        return linear_design(basis, self.points, self.values, self.domain, Surface).weighted(self.weights)


Data: TypeAlias = Matches | Samples
