"""The error of a model's predictions as a function of the distance to the nearest datum."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from mexpress._validation import Floats, Integers
from mexpress.geometry import EDGE, Region, hull, inside, lengths_of, nearest, without_ties
from mexpress.index_sets import compress
from mexpress.leastsquares.model import LeastSquares, cross_validate_all
from mexpress.schemes import Places, Scheme

_RADII = 10
"""Number of radii besides 0."""

_LARGEST_SHARE = 0.5
"""Largest share of the data that are held out for one prediction."""

_FEWEST, _MOST, _WORK = 30, 100, 45_000_000
"""Neighbourhoods of each radius: _WORK / (n p) with p unknowns, within these limits."""

_PREDICTED, _EDGE = 9, 1 / 3
"""Data that are predicted in a neighbourhood, at most, and how deep inside it they are, in radii.

The centre is one of them, the others are spread. At its centre a neighbourhood is like the smallest gap with that
distance to the data: alone, the centres promise too much of wider gaps. Near the edge it is like a much wider gap, and
promises too little of places between data.
"""

_KNOTS, _SMALLEST, _LARGEST = 8, 10, 200
"""Predictions are averaged in groups: so many groups at least, if they have the smallest size, up to the largest."""


@dataclass(frozen=True, eq=False, repr=False)
class ErrorCurve:
    """Errors that never fall with the distance to the nearest datum.

    Parameters
    ----------
    distances : (k,) array
        In the unit of the points, increasing.
    errors : (k,) array
        In the unit of the values.

    Examples
    --------
    >>> curve = ErrorCurve(np.array([1.0, 3.0]), np.array([0.2, 0.6]))
    >>> curve(np.array([0.0, 2.0, 6.0])).round(9)
    array([0.2, 0.4, 1.2])
    """

    distances: Floats
    errors: Floats

    def __repr__(self) -> str:
        (near, small), (far, large) = ((self.distances[k], self.errors[k]) for k in (0, -1))
        return f"ErrorCurve({small:.4g} at {near:.4g} to {large:.4g} at {far:.4g})"

    def __call__(self, distance: Floats) -> Floats:
        """Return the errors at distances: linear between knots, constant before them, proportional beyond them."""
        tested = np.interp(distance, self.distances, self.errors)
        if self.reach == 0:  # nothing could be tested
            return tested
        with np.errstate(over="ignore"):
            return np.asarray(tested * np.maximum(distance / self.reach, 1))

    @property
    def reach(self) -> float:
        """Largest tested distance."""
        return float(self.distances[-1])

    @classmethod
    def through(cls, distances: Floats, errors: Floats, weights: Floats) -> Self | None:
        """Average squared errors in groups of similar distances, and make the averages monotone; None without data.

        NaN marks what is undefined. The curve ends before the first group of which half is undefined.
        """
        # Squares of errors may be no numbers.
        unit = np.abs(errors).max(initial=0.0, where=np.isfinite(errors)) or 1.0
        squares = (errors / unit) ** 2
        order = np.argsort(distances, kind="stable")
        number = max(1, math.ceil(len(order) / np.clip(len(order) // _KNOTS, _SMALLEST, _LARGEST)))
        groups = []
        for group in np.array_split(order, number):
            known = group[np.isfinite(squares[group])]
            if 2 * len(known) <= len(group):
                break
            shares = weights[known] / weights[known].sum()
            groups.append((shares @ distances[known], shares @ squares[known], len(known)))
        if not groups:
            return None
        where, averages, sizes = np.array(groups).T
        # Rounding may mix equal distances.
        return cls(np.maximum.accumulate(where), unit * np.sqrt(increasing(averages, sizes)))


@dataclass(frozen=True, eq=False, repr=False)
class ErrorCurves:
    """Errors where a model interpolates, and where it extrapolates.

    Parameters
    ----------
    inside : ErrorCurve
        Of predictions inside the region of the data.
    outside : ErrorCurve
        Of predictions outside it.

    Examples
    --------
    >>> import mexpress as mx
    >>> points = np.random.default_rng(0).uniform(0, 1, (100, 2))
    >>> curves = mx.fit_surface(points, np.sin(6 * points[:, 0]), points[:30]).error_curves
    >>> bool(curves.inside.errors[0] < curves.inside.errors[-1] < curves.outside.errors[-1])
    True
    """

    inside: ErrorCurve
    outside: ErrorCurve

    def __repr__(self) -> str:
        return f"ErrorCurves(inside={self.inside!r}, outside={self.outside!r})"

    def __call__(self, distance: Floats, inside: NDArray[np.bool_]) -> Floats:
        """Return the errors at distances; extrapolation is never better than interpolation."""
        near = self.inside(distance)
        return np.where(inside, near, np.maximum(near, self.outside(distance)))

    @classmethod
    def of(
        cls, fit: LeastSquares, points: Floats, domain: Region, units: Floats, weights: Floats | None
    ) -> Self:
        """Predict some of the data with ever larger neighbourhoods held out.

        Parameters
        ----------
        fit : LeastSquares
            The fit of n data.
        points : (n, 2) array
            Their positions.
        domain : Region
            Region that they cover.
        units : (n,) array
            What the residuals of every datum are divided by.
        weights : (n,) array or None
            Weights of the data in the averages.
        """
        number = int(np.clip(_WORK // (len(points) * len(fit.coefficients)), _FEWEST, _MOST))
        gaps = list(_neighbourhoods(points, domain, number))
        held, validated = compress(gap.held_out for gap in gaps), compress(gap.predicted for gap in gaps)
        scheme = Scheme(len(points), held, validated)
        residuals = cross_validate_all(fit, {"": scheme}, None)[""].residuals
        data = validated.indices
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            errors = lengths_of(residuals.reshape(len(data), -1)) / units[data]
        distances = without_ties(np.concatenate([gap.distances for gap in gaps]))
        outside = np.concatenate([gap.outside for gap in gaps])
        shares = np.ones(len(data)) if weights is None else weights[data]
        near, far = (
            ErrorCurve.through(distances[some], errors[some], shares[some]) for some in (~outside, outside)
        )
        if near is None or far is None:
            only = near or far or ErrorCurve(np.zeros(1), np.full(1, np.inf))
            return cls(only, only)
        # The region of the data has no step at its edge.
        edge = min(near.errors[0], far.errors[0])
        return cls(near, ErrorCurve(np.append(0, far.distances), np.append(edge, far.errors)))


class Gap(NamedTuple):
    """A neighbourhood that is held out, and the data that are predicted in it."""

    held_out: Integers
    predicted: Integers
    distances: Floats
    """From the predicted data to the nearest datum that is not held out."""
    outside: NDArray[np.bool_]
    """Whether they are outside the region of the data that are not held out."""


def _neighbourhoods(points: Floats, domain: Region, number: int) -> Iterator[Gap]:
    """Hold out ever larger neighbourhoods of data that are spread as the data are."""
    n, order = len(points), Places(points).order
    centres = _spread(order, number)
    corner = np.isin(_as_complex(points), _as_complex(domain.corners))
    most = max(1, math.floor(_LARGEST_SHARE * n))

    def distances(centre: int) -> Floats:
        return np.asarray(np.hypot(*(points[centre] - points).T))

    ends = [np.partition(distances(centre), (1, most))[[1, most]] for centre in centres]
    nearest_one, farthest = np.median(ends, axis=0)
    radii = np.append(0, np.geomspace(max(nearest_one, 1e-9 * farthest), farthest, _RADII))
    for centre in centres.tolist():
        row, size = distances(centre), 0
        for radius in radii:
            within = row <= (1 + EDGE) * radius
            if within.sum() > most:
                break
            if within.sum() > size:
                size, others = int(within.sum()), points[~within]
                some = np.union1d(centre, _spread(order[within[order]], _PREDICTED - 1))
                reach = nearest(points[some], others)[1]
                deep = (some == centre) | (reach > _EDGE * radius)
                outside = np.zeros(deep.sum(), dtype=np.bool_)
                if corner[within].any():
                    outside = _outside(others, points[some[deep]])
                yield Gap(np.flatnonzero(within), some[deep], reach[deep], outside)


def _spread(ordered: Integers, number: int) -> Integers:
    """Take every so many."""
    return ordered[
        np.unique(np.linspace(0, len(ordered) - 1, min(number, len(ordered))).round().astype(np.int64))
    ]


def _as_complex(points: Floats) -> NDArray[np.complex128]:
    return np.asarray(points[:, 0] + 1j * points[:, 1])


def _outside(points: Floats, places: Floats) -> NDArray[np.bool_]:
    try:
        corners = hull(points, "points")
    except ValueError:  # on a line
        return np.ones(len(places), dtype=np.bool_)
    return ~inside(corners, *places.T)


def increasing(values: Floats, sizes: Floats) -> Floats:
    """Return the closest increasing sequence, by least squares with weights: pool adjacent violators.

    Examples
    --------
    >>> increasing(np.array([1.0, 4.0, 2.0, 5.0]), np.array([1.0, 1.0, 1.0, 2.0]))
    array([1., 3., 3., 5.])
    """
    blocks: list[tuple[float, float, int]] = []
    for value, size in zip(values.tolist(), sizes.tolist(), strict=True):
        mean, weight, length = value, size, 1
        while blocks and blocks[-1][0] >= mean:
            other, more, longer = blocks.pop()
            mean = (mean * weight + other * more) / (weight + more)
            weight, length = weight + more, length + longer
        blocks.append((mean, weight, length))
    means, _, lengths = zip(*blocks, strict=True)
    return np.repeat(means, lengths)
