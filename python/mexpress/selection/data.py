"""The data of a selection, checked once: matches of two images, or samples of a surface.

Both have `points`, `values`, `weights`, `domain` and `diagonal`, have subsets, and make a design over a basis. Warps
and surfaces differ in nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.caching import cached_property
from mexpress.geometry import Region, check_extent, diagonal, hull
from mexpress.models import Basis, Design, Surface, Warp, fractional_design, linear_design
from mexpress.selection import incomplete
from mexpress.selection.incomplete import RAISE, filled, filled_weights, spread


@dataclass(frozen=True, eq=False, repr=False)
class Matches:
    """Point matches between two images.

    Parameters
    ----------
    source, target : (n, 2) array
        Matched points, x then y, in pixels of either image; NaN where they were missing.
    weights : (n,) array or None
        Weights of the matches; 1 each if None. A weight of 0 stands for a match that is absent.
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
    image_size: tuple[float, float] | None

    @classmethod
    def of(
        cls,
        source: ArrayLike,
        target: ArrayLike,
        image_size: Any = None,
        weights: ArrayLike | None = None,
        missing: str = RAISE,
    ) -> Matches:
        """Check matches: n pairs of points, finite unless missing ones are dropped, whose weight is then 0."""
        known = incomplete.complete_rows(missing, source=source, target=target, weights=weights)
        if known is not None:
            shares = filled_weights(weights, known)
            whole = cls.of(filled(source, known), filled(target, known), image_size, shares)
            return replace(
                whole, source=spread(whole.source[known], known), target=spread(whole.target[known], known)
            )
        # Copies: models keep their data, whatever becomes of the caller's arrays.
        source, target = check.points(source, "source").copy(), check.points(target, "target").copy()
        check.as_many(target, source)
        check_extent(target, "target")
        size, shares = check.image_size(image_size), _weights(weights, len(source))
        return cls(source, target, shares, size)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that describe the matches, by name."""
        size = {} if self.image_size is None else {"image_size": np.array(self.image_size)}
        return {"source": self.source, "target": self.target, **size, **_named(self.weights)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Matches:
        """Check the arrays of `to_arrays`; other names are ignored."""
        size, weights = arrays.get("image_size"), arrays.get("weights")
        return cls.of(arrays["source"], arrays["target"], size, weights, incomplete.DROP)

    def subset(self, some: Integers) -> Matches:
        """Return some of the matches, with the region that they cover."""
        return Matches(self.source[some], self.target[some], _part(self.weights, some), self.image_size)

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
    def domain(self) -> Region:
        """Region that the source points cover, which are not on a line; those of weight 0 do not count."""
        return Region(hull(_present(self.source, self.weights), "source"))

    @cached_property
    def diagonal(self) -> float:
        """Length that radii are percentages of: the diagonal of the image, or of the source points' bounding box."""
        if self.image_size is not None:
            return math.hypot(*self.image_size)
        return diagonal(_present(self.source, self.weights))

    def design(self, basis: Basis, fractional: bool, over_data: bool | None = None) -> Design[Warp]:
        """Write the fit of a warp as a least-squares problem, see `mexpress.models.fractional_design`."""
        if fractional:
            design: Design[Warp] = fractional_design(
                basis, self.source, self.target, self.domain, Warp, over_data
            )
        else:
            design = linear_design(basis, self.source, self.target, self.domain, Warp)
        return design.weighted(self.weights)


@dataclass(frozen=True, eq=False, repr=False)
class Samples:
    """Values at points of the plane.

    Parameters
    ----------
    points : (n, 2) array
        Positions; NaN where they, or the values, were missing.
    values : (n,) or (n, d) array
        Depths, or points in space.
    weights : (n,) array or None
        Weights of the data; 1 each if None. A weight of 0 stands for a datum that is absent.

    Examples
    --------
    >>> Samples.of([[0, 0], [4, 0], [0, 3]], [1.0, 2.0, 3.0])
    Samples(3 data, diagonal 5)
    """

    points: Floats
    values: Floats
    weights: Floats | None
    image_size: ClassVar[None] = None

    @classmethod
    def of(
        cls,
        points: ArrayLike,
        values: ArrayLike,
        weights: ArrayLike | None = None,
        missing: str = RAISE,
    ) -> Samples:
        """Check data: n points with a value each, finite unless missing ones are dropped, whose weight is then 0."""
        known = incomplete.complete_rows(missing, points=points, values=values, weights=weights)
        if known is not None:
            whole = cls.of(filled(points, known), filled(values, known), filled_weights(weights, known))
            return replace(
                whole, points=spread(whole.points[known], known), values=spread(whole.values[known], known)
            )
        points = check.points(points, "points").copy()
        values, shares = check.columns(values, "values", len(points)).copy(), _weights(weights, len(points))
        return cls(points, values, shares)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that describe the data, by name."""
        return {"points": self.points, "values": self.values, **_named(self.weights)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Samples:
        """Check the arrays of `to_arrays`; other names are ignored."""
        return cls.of(arrays["points"], arrays["values"], arrays.get("weights"), incomplete.DROP)

    def subset(self, some: Integers) -> Samples:
        """Return some of the data, with the region that they cover."""
        return Samples(self.points[some], self.values[some], _part(self.weights, some))

    def __repr__(self) -> str:
        return f"Samples({len(self.points)} data, diagonal {self.diagonal:g})"

    @cached_property
    def domain(self) -> Region:
        """Region that the points cover, which are not on a line; those of weight 0 do not count."""
        return Region(hull(_present(self.points, self.weights), "points"))

    @cached_property
    def diagonal(self) -> float:
        """Length that radii are percentages of: the diagonal of the points' bounding box."""
        return diagonal(_present(self.points, self.weights))

    def design(self, basis: Basis) -> Design[Surface]:
        """Write the fit of a surface as a least-squares problem."""
        return linear_design(basis, self.points, self.values, self.domain, Surface).weighted(self.weights)


_HEAVIEST = 1e50
"""Products of weights with areas and sums of squares must not overflow."""

Data: TypeAlias = Matches | Samples

DataT = TypeVar("DataT", Matches, Samples)


def present(data: Data) -> Integers:
    """Return the indices of the data whose weight is not 0, increasing.

    Examples
    --------
    >>> present(Samples.of([[0, 0], [4, 0], [0, 3], [4, 3]], [1.0, 2.0, 3.0, 9.0], [1, 1, 1, 0]))
    array([0, 1, 2])
    """
    n = len(data.points)
    return np.arange(n) if data.weights is None else np.flatnonzero(data.weights)


def part(data: DataT, some: Integers) -> DataT:
    """Return some of the data, by increasing indices; the data themselves if these are all."""
    return data if len(some) == len(data.points) else data.subset(some)


def those_present(data: DataT) -> DataT:
    """Return the data whose weight is not 0."""
    return part(data, present(data))


def is_speck(data: Data) -> bool:
    """Return whether points are hardly in the pixels of an image: fractions of it, or within 1 % of its diagonal.

    Examples
    --------
    >>> square = [[0, 0], [1, 0], [0, 1], [1, 1]]
    >>> is_speck(Matches.of(square, square, (640, 480))), is_speck(Matches.of(square, square))
    (True, False)
    """
    if data.image_size is None:
        return False
    fractions = float(np.abs(data.points).max()) <= 1 < min(data.image_size)
    return fractions or diagonal(data.points) < 0.01 * data.diagonal


def total_weight(data: Data) -> float:
    """Return the sum of the weights."""
    return float(len(data.points)) if data.weights is None else float(data.weights.sum())


def _weights(weights: ArrayLike | None, n: int) -> Floats | None:
    if weights is None:
        return None
    rule = f"It must be {n} numbers of at least 0, one for each datum, and one above 0."
    shares = check.real(weights, "weights")
    if shares.shape != (n,):
        check.refuse("weights", rule, f"shape {shares.shape}")
    if check.finite(shares, "weights").min() < 0 or shares.max() == 0:
        check.refuse("weights", rule, f"{shares.min():g} for datum {int(shares.argmin())}")
    smallest, largest = shares[shares > 0].min(), shares.max()
    if largest > _HEAVIEST or smallest < 1 / _HEAVIEST:
        limits = f"Those above 0 must be from {1 / _HEAVIEST:g} to {_HEAVIEST:g}."
        check.refuse("weights", limits, f"{smallest:g} to {largest:g}")
    return shares.copy()


def _present(points: Floats, weights: Floats | None) -> Floats:
    return points if weights is None else points[weights > 0]


def _named(weights: Floats | None) -> dict[str, NDArray[Any]]:
    """Return the weights in a mapping of arrays; none if these are 1 each."""
    return {} if weights is None else {"weights": weights}


def _part(weights: Floats | None, some: Integers) -> Floats | None:
    """Return some of the weights; None if these are 1 each."""
    return None if weights is None or (weights[some] == 1).all() else weights[some]
