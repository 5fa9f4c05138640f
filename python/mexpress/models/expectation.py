"""Models that keep the data of their fit, and tell how far off they are to be expected."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.caching import cached_property
from mexpress.geometry import Region, inside, nearest
from mexpress.models.base import Model, row_by_row
from mexpress.models.design import Design
from mexpress.models.error_curves import ErrorCurve, ErrorCurves
from mexpress.models.jackknife import Interval, jackknife_plus
from mexpress.models.observations import Observations

_CURVES = "error_curves"

EXTRAPOLATE, NAN = "extrapolate", "nan"
"""What models return outside their domain."""


def check_outside(outside: object) -> bool:
    """Tell whether values outside the domain are not wanted.

    Examples
    --------
    >>> check_outside("nan")
    True
    """
    if not isinstance(outside, str) or outside not in {EXTRAPOLATE, NAN}:
        rule = f'It must be "{EXTRAPOLATE}" or "{NAN}".'
        check.refuse("outside", rule, check.describe(outside))
    return outside == NAN


@dataclass(frozen=True, eq=False, repr=False)
class FittedModel(Model):
    """A `Warp` or a `Surface`; with the data of its fit it tells what error to expect.

    Models that `select_*` and `fit_*` return have their data, and so have models that are loaded from files of such
    models.
    """

    @abstractmethod
    def _design(self, data: Observations) -> Design[Self]:
        """The least-squares problem that the model solves."""

    @abstractmethod
    def _units(self, points: Floats) -> Floats:
        """What residuals of the design at points are divided by to be differences of values, (k,)."""

    def _meaningful(self, points: ArrayLike) -> Floats:
        """Return positions, NaN where the model has no value."""
        return check.queries(points, "points")

    def error(self, points: ArrayLike) -> Floats:
        """Return the error to expect at points, from the distance to the nearest datum.

        Data in up to 100 places are predicted from the others, with ever larger neighbourhoods held out (local
        exclusion, equations 12 and 13); control points and smoothing stay. The root mean square of these prediction
        errors, as a function of the distance to the nearest datum that is not held out, is the error to expect at that
        distance.

        Parameters
        ----------
        points : array_like, (k, 2)
            Positions, x then y.

        Returns
        -------
        ndarray, (k,)
            Root mean square difference of a measurement there from the model, in the unit of the values: the noise of a
            measurement is in it. Of d values it is the norm of the difference; that of one value is smaller by a factor
            of sqrt(d) if all differ alike. Infinite if no datum can be predicted from the others, NaN where a position
            is not known, and where a warp vanishes.

        Raises
        ------
        ValueError
            If the model has no data.

        Notes
        -----
        Predictions inside the region of the other data are told from those outside it, and the error outside is never
        less. Neither falls with the distance. The curves begin with the leave-one-out error of the data that are
        closest to each other, and end where half of the data would have to be held out; beyond that, the error is
        proportional to the distance, which is a guess: see `covers`.

        If noise and errors of the model are Gaussian and the same everywhere, 1.96 times the error covers 95 %.
        ``docs/error.md`` has what it covered.

        Examples
        --------
        >>> import mexpress as mx
        >>> points = np.random.default_rng(0).uniform(0, 6, (300, 2))
        >>> points = points[np.hypot(*(points - 3).T) > 1]  # a hole in the middle
        >>> surface = mx.fit_surface(points, np.sin(points[:, 0]), points, smoothing=0.001)
        >>> near, far = surface.error([[1, 3], [3, 3]])
        >>> bool(far > 3 * near)
        True
        """
        data = self._known("error").points
        return row_by_row(
            self._meaningful(points),
            lambda known: self.error_curves(nearest(known, data)[1], self._inside(known)),
        )

    def covers(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Tell where `error` has been tested: inside the region of the data, in no gap wider than could be tested.

        Parameters
        ----------
        points : array_like, (k, 2)
            Positions, x then y.

        Returns
        -------
        ndarray of bool, (k,)
            True inside the convex hull of the data if the nearest datum is not farther than in the predictions that
            `error` rests on; False where a position is not known, and where a warp vanishes.

        Raises
        ------
        ValueError
            If the model has no data.

        Examples
        --------
        >>> import mexpress as mx
        >>> points = np.random.default_rng(0).uniform(0, 6, (300, 2))
        >>> mx.fit_surface(points, np.sin(points[:, 0]), points[:50]).covers([[3, 3], [9, 3]])
        array([ True, False])
        """
        data, tested = self._known("covers").points, self.error_curves.inside

        def covered(known: Floats) -> NDArray[np.bool_]:
            distance = nearest(known, data)[1]
            return self._inside(known) & (distance <= tested.reach) & np.isfinite(tested(distance))

        return row_by_row(self._meaningful(points), covered, unknown=False)

    def interval(self, points: ArrayLike, level: float = 0.9) -> Interval:
        """Return an interval for a measurement at each point by jackknife+, from all leave-one-out models.

        Parameters
        ----------
        points : array_like, (k, 2)
            Positions, x then y: as many as possible at once, since most of the work is the same for all.
        level : float, default 0.9
            Aim, 1 - alpha: the share of measurements that are inside, of each value separately.

        Returns
        -------
        Interval
            Bounds in the shape of the values, (k,) or (k, d). They are infinite if 1 / alpha - 1 data are not there,
            or if too many data are such that the others do not determine the model. NaN where a position is not
            known, and where a warp vanishes.

        Raises
        ------
        ValueError
            If the model has no data, or the level is not between 0 and 1.

        Notes
        -----
        With R_i the distance of datum i from the model f_(i) without it, the bounds at q are the alpha quantile of
        f_(i)(q) - R_i and the 1 - alpha quantile of f_(i)(q) + R_i. If the measurement and the data are exchangeable,
        such as drawn independently from one distribution of positions and values, it is inside with a probability of
        1 - 2 alpha at least, and 1 - alpha as a rule, whatever that distribution is. That does not hold in gaps, where
        `error` is to be asked. Control points and smoothing are those of all data, which the theorem does not allow
        for; weights count in the fits alone.

        The predictions of all n models follow from one factorisation, also of warps with a denominator.

        References
        ----------
        R. F. Barber, E. J. Candes, A. Ramdas, R. J. Tibshirani, "Predictive inference with the jackknife+", Annals of
        Statistics, 2021.

        Examples
        --------
        >>> import mexpress as mx
        >>> random = np.random.default_rng(0)
        >>> points, unseen = random.uniform(0, 6, (2, 300, 2))
        >>> noisy = lambda points: np.sin(points[:, 0]) + random.normal(0, 0.1, len(points))
        >>> interval = mx.fit_surface(points, noisy(points), points[:20]).interval(unseen)
        >>> values = noisy(unseen)
        >>> round(float(np.mean((interval.lower <= values) & (values <= interval.upper))), 2)
        0.89
        """
        points = self._meaningful(points)
        rule = "It must be between 0 and 1, such as 0.95 for 95 %."
        share = check.number(level, "level", rule, 0.0, strict=True)
        if share >= 1:
            check.refuse("level", rule, check.describe(level))
        design = self._design(self._known("interval"))

        def bounds(known: Floats) -> Floats:
            found = jackknife_plus(design, self.smoothing, known, share)
            return np.stack([found.lower, found.upper], axis=1)

        return Interval(*np.moveaxis(row_by_row(points, bounds), 1, 0))

    @cached_property
    def error_curves(self) -> ErrorCurves:
        """Errors by distance, on which `error` and `covers` rest; they are computed once, and saved with the model."""
        data = self._known("error_curves")
        fit = self._design(data).fit(self.smoothing)
        return ErrorCurves.of(fit, data.points, Region(self.domain), self._units(data.points), data.weights)

    def __reduce__(self) -> tuple[Any, ...]:
        curves = {_CURVES: self.error_curves} if _CURVES in vars(self) else None
        return (*super().__reduce__(), curves)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that describe the model, by name; with those of `error_curves` if they are computed."""
        arrays = super().to_arrays()
        if _CURVES in vars(self):
            for name, curve in vars(self.error_curves).items():
                arrays[f"{name}_curve"] = np.stack([curve.distances, curve.errors])
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Rebuild a model from the arrays of `to_arrays`; other names are ignored."""
        model = super().from_arrays(arrays)
        if "inside_curve" in arrays:
            curves = (ErrorCurve(*arrays[f"{name}_curve"]) for name in ("inside", "outside"))
            vars(model)[_CURVES] = ErrorCurves(*curves)
        return model

    def _valued(self, points: Floats, function: Callable[[Floats], Floats], outside: str) -> Floats:
        """Return a function's values at points, (k, 2): NaN where a position is not known, or outside if wanted."""
        if check_outside(outside):
            points = np.where(self._inside(points)[:, None], points, np.nan)
        return row_by_row(points, function)

    def _inside(self, points: Floats) -> NDArray[np.bool_]:
        return inside(self.domain, *points.T)

    def _known(self, purpose: str) -> Observations:
        if self.data is None:
            rule = f"It must have the data of its fit for {purpose}, as select_* and fit_* give them."
            check.refuse("model", rule, f"{self!r} without data")
        return self.data
