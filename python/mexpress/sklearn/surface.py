"""A surface over the plane as an estimator: selected when it is fitted."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.models import Surface
from mexpress.selection import select_surface
from mexpress.sklearn.linear import LinearRegression
from mexpress.sklearn.regression import checked_weights

if TYPE_CHECKING:
    import xarray as xr


class SurfaceRegressor(MultiOutputMixin, RegressorMixin, BaseEstimator):  # type: ignore[misc]  # scikit-learn has no types
    """A smooth surface over positions in the plane, as complex as predicts held-out data best.

    `fit` is `mexpress.select_surface`: what is selected there needs no search over this estimator's parameters.

    The first two features are positions, x and y. Others, such as the altitude of a thermometer, are covariates: they
    enter linearly, with the coefficients of a regression on all features, and the surface describes what is left.

    Data at one position are merged: their mean, with the sum of their weights. So a weight of two is the same as a
    datum given twice.

    Parameters
    ----------
    criterion : str, optional
        Criterion that selects, see `mexpress.criteria`.
    smoothing : float, list of float or "auto", default "auto"
        Weight of the bending energy; the best of several is selected, "auto" tries twenty.
    max_count, min_distance, lifting, placement, robust, queries, seed, threads
        As for `mexpress.select_surface`.

    Attributes
    ----------
    selection_ : SurfaceSelection
        The selection: scores, notes, suspects.
    surface_ : Surface
        The selected surface.
    coef_ : (c,) or (r, c) array
        Coefficients of the covariates.

    Examples
    --------
    >>> import numpy as np
    >>> from mexpress.sklearn import SurfaceRegressor
    >>> rng = np.random.default_rng(0)
    >>> points = rng.uniform(0, 10, (300, 2))
    >>> values = np.sin(points[:, 0]) + 0.1 * rng.normal(size=300)
    >>> surface = SurfaceRegressor().fit(points[:200], values[:200])
    >>> round(surface.score(points[200:], values[200:]), 2)
    0.98
    >>> mean, std = surface.predict([[5.0, 5.0]], return_std=True)
    """

    def __init__(
        self,
        criterion: str | None = None,
        *,
        smoothing: float | ArrayLike | str = "auto",
        max_count: int | None = None,
        min_distance: float | None = None,
        lifting: str = "tps",
        placement: str | None = None,
        robust: bool = False,
        queries: ArrayLike | str | None = None,
        seed: int = 0,
        threads: int | None = None,
    ) -> None:
        self.criterion = criterion
        self.smoothing = smoothing
        self.max_count = max_count
        self.min_distance = min_distance
        self.lifting = lifting
        self.placement = placement
        self.robust = robust
        self.queries = queries
        self.seed = seed
        self.threads = threads

    def fit(self, X: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None = None) -> Self:
        """Select a surface for data.

        Parameters
        ----------
        X : (n, 2 + c) array or frame
            Positions, and covariates if there are more than two columns.
        y : (n,) or (n, r) array
            Values.
        sample_weight : (n,) array, optional
            Weights of the data, such as one over the square of their standard deviations. A datum of weight 0 is
            absent.

        Returns
        -------
        SurfaceRegressor
            Itself.

        Raises
        ------
        ValueError
            If there is one feature only, or if the positions do not cover a region.
        """
        features, values = validate_data(
            self, X, y, multi_output=True, y_numeric=True, dtype=np.float64, ensure_min_samples=2
        )
        if features.shape[1] < 2:
            check.refuse("X", "It must have two columns at least, x and y.", "n_features = 1")
        given = checked_weights(sample_weight, len(features))
        weights = np.ones(len(features)) if given is None else given
        some = weights > 0
        features, values, weights = features[some], values[some].astype(np.float64), weights[some]
        self.coef_ = LinearRegression().fit(features, values, weights).coef_[..., 2:]
        points, means, totals = _merged(features[:, :2], values - self._of_covariates(features), weights)
        self.selection_ = select_surface(points, means, weights=totals, **self.get_params())
        self.surface_ = self.selection_.surface
        self._surfaces = _values_of(self.surface_)
        return self

    def predict(self, X: ArrayLike, return_std: bool = False) -> Floats | tuple[Floats, Floats]:
        """Predict values.

        Parameters
        ----------
        X : (k, 2 + c) array or frame
            Positions and covariates.
        return_std : bool, default False
            Whether to return the standard deviation of a measurement there from its prediction as well.

        Returns
        -------
        (k,) or (k, r) array, or two of them
            The predictions; with `return_std` also the error to expect, of each value, see `mexpress.Surface.error`.
        """
        check_is_fitted(self)
        features = validate_data(self, X, reset=False, dtype=np.float64)
        points = features[:, :2]
        mean = self.surface_(points) + self._of_covariates(features)
        if not return_std:
            return mean
        errors = [surface.error(points) for surface in self._surfaces]
        return mean, np.column_stack(errors).reshape(mean.shape)

    def grid(
        self,
        region: ArrayLike | None = None,
        shape: tuple[int, int] | None = None,
        spacing: float | None = None,
        **options: Any,
    ) -> xr.Dataset:
        """Predict on a grid, as verde's gridders do: `mexpress.Surface.to_xarray` (extra ``xarray``).

        Parameters
        ----------
        region : (west, east, south, north), optional
            What the grid covers; the bounding box of the data by default.
        shape : tuple of int, optional
            Numbers of rows and columns.
        spacing : float, optional
            Distance of neighbouring samples.
        **options
            As for `mexpress.Surface.to_xarray`: names, dims, units, like, outside.

        Raises
        ------
        ValueError
            If there are covariates, which are known at the data only.
        """
        check_is_fitted(self)
        if self.n_features_in_ > 2:
            rule = "It must be fitted to positions alone for a grid; predict takes positions with their covariates."
            check.refuse("surface", rule, f"{self.n_features_in_} features")
        return self.surface_.to_xarray(region, spacing, shape, **options)

    def _of_covariates(self, features: Floats) -> Floats:
        """What the covariates add, (n,) or (n, r)."""
        return np.asarray(features[:, 2:] @ self.coef_.T)


def _merged(points: Floats, values: Floats, weights: Floats) -> tuple[Floats, Floats, Floats | None]:
    """Positions that differ, the weighted mean of the values at each, and the sum of the weights; None if all are 1."""
    places, which = np.unique(points, axis=0, return_inverse=True)
    if len(places) == len(points):
        return points, values, None if (weights == 1).all() else weights
    totals = np.bincount(which, weights).astype(np.float64)
    columns = values.reshape(len(values), -1)
    means = np.column_stack([np.bincount(which, weights * column) / totals for column in columns.T])
    return places, means.reshape(len(places), *values.shape[1:]), totals


def _values_of(surface: Surface) -> list[Surface]:
    """A surface of several values as surfaces of one each."""
    data = surface.data
    if surface.parameters.ndim == 1 or data is None:
        return [surface]
    columns = zip(surface.parameters.T, data.values.T, strict=True)
    return [replace(surface, parameters=p, data=replace(data, values=values)) for p, values in columns]
