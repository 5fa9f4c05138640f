"""A surface and the coefficients of covariates beside it, each fitted to what the other leaves: a partial spline.

Values are surface(position) + covariates @ coefficients. A smoother, the surface's control points and smoothing, takes
from values and covariates alike what goes with position; the coefficients are the least squares of what is left of the
values on what is left of the covariates (Robinson 1988, Speckman 1988). A surface is then selected for the values
without the covariates, and its smoother gives coefficients again, until it is selected again.

A regression on positions and covariates alone would count to a covariate what is the surface's, and the surface would
then be selected for a wrong remainder, which can confirm it: so there are two starts, and the better prediction goes
on.

Examples
--------
>>> from functools import partial
>>> from mexpress.selection import select_surface
>>> rng = np.random.default_rng(0)
>>> points = rng.uniform(0, 6, (200, 2))
>>> altitude = np.sin(points[:, 0]) + 0.3 * rng.normal(size=200)
>>> values = 2 * altitude - np.sin(points[:, 0]) + 0.01 * rng.normal(size=200)
>>> spline = PartialSpline(points, values, altitude[:, None], np.ones(200), partial(select_surface, threads=1))
>>> coefficients, selection = spline.fit()
>>> coefficients.round(2)
array([2.])
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mexpress._validation import Floats, Integers
from mexpress.caching import cached_property
from mexpress.selection import SurfaceSelection, fit_surface
from mexpress.sklearn.linear import LinearRegression

_ROUNDS = 3
"""Most surfaces that are selected after the starts; as a rule the first one confirms its start."""

_ROUGH = 0.01
"""What goes with position alone: a direction of the covariates of which a smaller share is left than of noise."""

_LEFT = 1e-6
"""What is left of noise at least: a smoother that interpolates leaves rounding errors."""

_ROUNDING = 1e-10
"""What does not vary: a covariate, or a direction of them, with a smaller share of the largest."""


@dataclass(frozen=True, eq=False)
class PartialSpline:
    """Positions (n, 2), values (n,) or (n, r), covariates (n, c), positive weights (n,), and what selects a surface."""

    points: Floats
    values: Floats
    covariates: Floats
    weights: Floats
    select: Callable[..., SurfaceSelection]

    def fit(self) -> tuple[Floats, SurfaceSelection]:
        """Return the coefficients, (c,) or (r, c), and the selection of a surface for what they leave of the values."""
        if not self._directions.shape[1]:
            none = np.zeros((*self.values.shape[1:], self.covariates.shape[1]))
            return none, self._beside(none)
        features = np.hstack([self.points, self.covariates])
        beside_plane = LinearRegression().fit(features, self.values, self.weights).coef_[..., 2:]
        starts = beside_plane, self.coefficients(self._selected(self._columns))
        selection = min(map(self._beside, starts), key=lambda start: start.score)
        for _ in range(_ROUNDS):
            before, coefficients = selection, self.coefficients(selection)
            selection = self._beside(coefficients)
            if _same_smoother(selection, before):
                break
        return coefficients, selection

    def coefficients(self, selection: SurfaceSelection) -> Floats:
        """Return the coefficients with the smoother of a selection for these data, (c,) or (r, c)."""
        surface, kept = selection.surface, selection.kept
        smooth = fit_surface(
            self._merged.points[kept],
            self._merged.means(self._columns)[kept],
            surface.control_points,
            surface.lifting.name,
            surface.smoothing,
            threads=selection.question.threads,
            weights=self._merged.weights[kept],
        )
        rows = np.isin(self._merged.places, kept)
        left = self._shares[rows, None] * (self._columns[rows] - smooth(self.points[rows]))
        values, rough = np.split(left, [-self._directions.shape[1]], axis=1)
        u, shares, axes = np.linalg.svd(rough, full_matrices=False)
        some = shares > _ROUGH * max(1 - selection.effective_parameters / len(left), _LEFT)
        solution = axes[some].T @ (u[:, some].T @ values / shares[some, None])
        found = self._unit * self._directions @ solution
        return np.asarray(found.T).reshape(*self.values.shape[1:], len(found))

    def _beside(self, coefficients: Floats) -> SurfaceSelection:
        return self._selected(self.values - self.covariates @ coefficients.T)

    def _selected(self, columns: Floats) -> SurfaceSelection:
        merged = self._merged
        weights = None if (merged.weights == 1).all() else merged.weights
        return self.select(merged.points, merged.means(columns), weights=weights)

    @cached_property
    def _merged(self) -> Merged:
        return Merged.of(self.points, self.weights)

    @cached_property
    def _shares(self) -> Floats:
        """Roots of the weights, (n,), whose squares sum to one."""
        return np.asarray(np.sqrt(self.weights / self.weights.sum()))

    @cached_property
    def _directions(self) -> Floats:
        """Combinations of the covariates, (c, k), that are uncorrelated and have variance one."""
        about = _centred(self.covariates, self.weights)
        size = np.abs(about).max(axis=0)
        size[size <= _ROUNDING * np.abs(self.covariates).max(axis=0)] = np.inf
        _, lengths, axes = np.linalg.svd(self._shares[:, None] * (about / size), full_matrices=False)
        some = lengths > _ROUNDING * lengths.max(initial=0.0)
        return np.asarray((axes[some] / size).T / lengths[some])

    @cached_property
    def _unit(self) -> float:
        """Largest distance of values to their mean, or one."""
        return float(np.abs(_centred(self.values, self.weights)).max()) or 1.0

    @cached_property
    def _columns(self) -> Floats:
        """Values and combinations of the covariates, all about zero and of about one size, (n, r + k)."""
        values = _centred(self.values, self.weights).reshape(len(self.values), -1)
        return np.hstack([values / self._unit, _centred(self.covariates, self.weights) @ self._directions])


@dataclass(frozen=True, eq=False)
class Merged:
    """Positions that differ, the sums of the weights there, and the place of every datum among them."""

    points: Floats
    weights: Floats
    places: Integers
    given: Floats

    @classmethod
    def of(cls, points: Floats, weights: Floats) -> Merged:
        """Return the places of data; if all differ, in the order of the data."""
        distinct, places = np.unique(points, axis=0, return_inverse=True)
        if len(distinct) == len(points):
            return cls(points, weights, np.arange(len(points)), weights)
        return cls(distinct, np.bincount(places, weights).astype(np.float64), places, weights)

    def means(self, columns: Floats) -> Floats:
        """Return the weighted means of (n,) or (n, d) columns at the places."""
        if len(self.points) == len(columns):
            return columns
        sums = [
            np.bincount(self.places, self.given * column) for column in columns.reshape(len(columns), -1).T
        ]
        return (np.array(sums) / self.weights).T.reshape(-1, *columns.shape[1:])


def _centred(columns: Floats, weights: Floats) -> Floats:
    return np.asarray(columns - np.average(columns, axis=0, weights=weights))


def _same_smoother(one: SurfaceSelection, other: SurfaceSelection) -> bool:
    """Whether two selections smooth the same data in the same way."""
    a, b = one.surface, other.surface
    alike = (a.lifting.name, a.smoothing) == (b.lifting.name, b.smoothing)
    same = zip((a.control_points, one.kept), (b.control_points, other.kept), strict=True)
    return alike and all(np.array_equal(*pair) for pair in same)
