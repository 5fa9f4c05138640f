"""Where a model will be used: near the data, so that they speak for it, or in gaps between and beside them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.geometry import Region, lattice, nearest
from mexpress.schemes import Places
from mexpress.selection.data import Data, Matches

IMAGE = "image"
"""Queries all over the image."""

_RULE = 'They must be points, (q, 2), a rectangle, (left, top, right, bottom), or "image" with an image_size.'

_NEAR = 1.5
"""Queries are near if they are at most so many times as far from the data as the data are from each other."""

_MOST = 10_000
"""More queries than this say no more of their distances."""


@dataclass(frozen=True, eq=False, repr=False)
class Queries:
    """Positions where a model will be used, and whether they are far from its data.

    They are near if the median of their distances to the nearest datum is at most 1.5 times the median distance of a
    datum to the next one, and the 90 % quantiles likewise.

    Parameters
    ----------
    points : (q, 2) array
        Positions.
    far : bool
        Whether they are not near.

    Examples
    --------
    >>> from mexpress.selection.data import Samples
    >>> data = Samples.of([[0, 0], [1, 0], [0, 1], [1, 1], [2, 0]], [0.0, 1.0, 2.0, 3.0, 4.0])
    >>> Queries.of([[0.5, 0.5]], data), Queries.of((2, 0, 9, 9), data)
    (Queries(1 near the data), Queries(2025 far from the data))
    """

    points: Floats
    far: bool

    def __repr__(self) -> str:
        return f"Queries({len(self.points)} {'far from' if self.far else 'near'} the data)"

    @classmethod
    def of(cls, queries: ArrayLike | str, data: Data, seed: Any = 0) -> Queries:
        """Check queries, and compare their distances to the data with those of the data."""
        points = _positions(queries, data)
        if len(points) > _MOST:
            points = points[np.sort(check.generator(seed).choice(len(points), _MOST, replace=False))]
        _, away = nearest(points, data.points)
        apart = Places(data.points).spacing()
        far = any(np.quantile(away, level) > _NEAR * np.quantile(apart, level) for level in (0.5, 0.9))
        return cls(points, far)


def _positions(queries: ArrayLike | str, data: Data) -> Floats:
    if isinstance(queries, str):
        if queries != IMAGE:
            check.refuse("queries", _RULE + check.nearest_name(queries, [IMAGE]), check.describe(queries))
        if not isinstance(data, Matches):
            check.refuse(
                "queries", "A surface has no image: they must be points or a rectangle.", repr(queries)
            )
        if data.image_size is None:
            check.refuse("image_size", 'It must be given with queries="image".', "none")
        return _over((0.0, 0.0, *data.image_size), len(data.points))
    given = check.real(queries, "queries")
    if given.shape == (4,):
        left, top, right, bottom = check.finite(given, "queries").tolist()
        if not (left < right and top < bottom):
            rule = "A rectangle must be (left, top, right, bottom), with left < right and top < bottom."
            check.refuse("queries", rule, check.describe(queries))
        return _over((left, top, right, bottom), len(data.points))
    if given.ndim != 2 or given.shape[1] != 2 or not len(given):
        check.refuse("queries", _RULE, check.describe(queries))
    return check.points(given, "queries")


def _over(rectangle: tuple[float, ...], n: int) -> Floats:
    left, top, right, bottom = rectangle
    corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
    return lattice(Region(corners).corners, min(max(2000, n), _MOST))
