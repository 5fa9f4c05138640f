"""A surface over the plane as an estimator: selected when it is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.models import Surface
from mexpress.models.expectation import NAN
from mexpress.selection import select_surface
from mexpress.sklearn.covariates import PartialSpline
from mexpress.sklearn.regression import checked_weights

if TYPE_CHECKING:
    import xarray as xr


class SurfaceRegressor(MultiOutputMixin, RegressorMixin, BaseEstimator):  # type: ignore[misc]  # scikit-learn has no types
    """A smooth surface over positions in the plane, as complex as predicts held-out data best.

    `fit` is `mexpress.select_surface`: what is selected there needs no search over this estimator's parameters.

    The first two features are positions, x and y. Others, such as the altitude of a thermometer, are covariates: they
    enter linearly, and the surface describes what they leave. Their coefficients are the least squares of what the
    surface's smoothing leaves of the values on what it leaves of the covariates: a partial spline, in geostatistics
    external drift. So a covariate that goes with position is told from the surface by its rough part. The smaller that
    is, the less certain is the coefficient, and hardly the prediction, since the surface makes up for it. A covariate
    that is a function of position as smooth as the surface, of which less than 1 % is left of what is left of noise,
    has the coefficient 0, and the surface has all of its effect. With covariates, four to six surfaces are selected.

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
        The selection, for the values without what the covariates add: scores, notes, suspects.
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
        select = partial(select_surface, **self.get_params())
        spline = PartialSpline(features[:, :2], values, features[:, 2:], weights, select)
        self.coef_, self.selection_ = spline.fit()
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
        if not check.flag(return_std, "return_std"):
            return mean
        errors = [surface.error(points) for surface in self._surfaces]
        return mean, np.column_stack(errors).reshape(mean.shape)

    def grid(
        self,
        region: ArrayLike | None = None,
        shape: tuple[int, int] | None = None,
        spacing: float | None = None,
        like: Any = None,
        *,
        names: str | Sequence[str] | None = None,
        dims: tuple[str, str] | None = None,
        units: str | None = None,
        xy_units: str | None = None,
        error: bool = True,
        outside: str = NAN,
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
        like, names, dims, units, xy_units, error, outside
            As for `mexpress.Surface.to_xarray`.

        Returns
        -------
        xarray.Dataset
            See `mexpress.Surface.to_xarray`.

        Raises
        ------
        ValueError
            If there are covariates, which are known at the data only.
        """
        check_is_fitted(self)
        if self.n_features_in_ > 2:
            rule = "It must be fitted to positions alone for a grid; predict takes positions with their covariates."
            check.refuse("surface", rule, f"{self.n_features_in_} features")
        return self.surface_.to_xarray(
            region,
            spacing,
            shape,
            like,
            names=names,
            dims=dims,
            units=units,
            xy_units=xy_units,
            error=error,
            outside=outside,
        )

    def _of_covariates(self, features: Floats) -> Floats:
        """What the covariates add, (n,) or (n, r)."""
        return np.asarray(features[:, 2:] @ self.coef_.T)


def _values_of(surface: Surface) -> list[Surface]:
    """A surface of several values as surfaces of one each."""
    data = surface.data
    if surface.parameters.ndim == 1 or data is None:
        return [surface]
    columns = zip(surface.parameters.T, data.values.T, strict=True)
    return [replace(surface, parameters=p, data=replace(data, values=values)) for p, values in columns]
