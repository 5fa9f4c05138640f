"""Selections whose data can be doubted: which of them their neighbourhoods contradict, and a fit that heeds it.

Examples
--------
See `mexpress.select_warp`.
"""

from __future__ import annotations

import os
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.criteria import Judge
from mexpress.leastsquares.model import LeastSquares
from mexpress.liftings import Lifting
from mexpress.models import Design
from mexpress.placement import covered_region
from mexpress.radii import RadiusCurve, score_by_radius
from mexpress.schemes import exclusion_radius
from mexpress.selection.selection import Selection
from mexpress.selection.sweep import Model, penalised
from mexpress.suspicion import Suspects, suspects

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["ModelSelection"]

_CRITERION = "ER10"

_STIFFNESSES = 10.0 ** np.arange(-6, 1)
"""Weights of the bending energy that are tried, in units of the squared diagonal of the data's bounding box."""


@dataclass(frozen=True)
class Trials(Generic[Model]):
    """A few models from stiff to supple, of which a criterion chooses for given weights of the data."""

    pairs: list[tuple[Design[Model], float]]
    judge: Judge
    threads: int | None

    def best(self, weights: Floats) -> tuple[LeastSquares, Design[Model], float]:
        fits = [penalised(design, stiffness, weights, self.threads) for design, stiffness in self.pairs]
        scores = [self.judge.scores(fit, self.threads)[_CRITERION].value for fit in fits]
        if np.isnan(scores).all():
            check.refuse("points", f"{_CRITERION} must have a score.", "data that are too few for it")
        k = int(np.nanargmin(scores))
        return fits[k], *self.pairs[k]


@dataclass(frozen=True, eq=False, repr=False)
class ModelSelection(Selection, Generic[Model]):
    """A selection that knows its data, and the model that it selects.

    Examples
    --------
    See `mexpress.WarpSelection` and `mexpress.SurfaceSelection`.
    """

    @abstractmethod
    def _data(self) -> tuple[Floats, Floats, float]:
        """Where the data are, their values, and what radii are percentages of."""

    @property
    def _unit(self) -> str | None:
        """Of the values, if it is known."""
        return None

    @abstractmethod
    def _lifting(self) -> Lifting:
        """That of the selected model."""

    @abstractmethod
    def _design(self, lifting: Lifting) -> Design[Model]:
        """The least-squares problem of a lifting."""

    @property
    @abstractmethod
    def _supplest(self) -> int:
        """Control points of the supplest model that looks for suspects, at most."""

    def least_squares(self, weights: ArrayLike | None = None, threads: int | None = None) -> LeastSquares:
        """Return the least-squares problem of the selected model, to be cross-validated further.

        Parameters
        ----------
        weights : (n,) array, optional
            Positive weight of each datum; one each if not given.
        threads : int, optional
            At most so many threads.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> source = np.random.default_rng(0).uniform(0, 100, (20, 2))
        >>> mx.select_warp(source, 2 * source + 1, counts=[3, 4, 5]).least_squares().n_data
        20
        """
        return penalised(self._design(self._lifting()), self.smoothing, weights, threads)

    def radii(self, percents: Sequence[float] | None = None, threads: int | None = None) -> RadiusCurve:
        """Score the selected model by local exclusion with several radii, see `mexpress.radii.score_by_radius`.

        Parameters
        ----------
        percents : sequence of float, optional
            Radii in percent of the diagonal, increasing; 0 to 20 if not given.
        threads : int, optional
            At most so many threads.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> source = np.random.default_rng(0).uniform(0, 100, (60, 2))
        >>> mx.select_warp(source, source + np.sin(source / 30), counts=[3, 9]).radii([0, 5, 10]).percents
        array([ 0.,  5., 10.])
        """
        points, _, diagonal = self._data()
        return score_by_radius(self.least_squares(threads=threads), points, diagonal, percents, threads)

    def plot_radii(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Draw the selected model's score against the radius within which data are held out (extra ``plot``).

        Below it is how far from the data the domain reaches: radii beyond that ask more than predictions inside it.

        Parameters
        ----------
        path : path, optional
            Where to save the figure; its ending says the format.
        """
        from mexpress.plotting import plot_radii  # noqa: PLC0415 - an extra

        return plot_radii(self.radii(), path, unit=self._unit)

    def suspects(self, threshold: float = 5.0, radius: float = 5.0, threads: int | None = None) -> Suspects:
        """Find the data that their neighbourhoods predict badly: wrong matches, wrong depths.

        Wrong data disturb the selection too. So the model is chosen anew, by ER10, in every round: of three numbers of
        control points and seven weights of the bending energy. It is no RANSAC: where half of the data are wrong, it
        says that its result is not to be trusted.

        Parameters
        ----------
        threshold : float, default 5
            Studentised prediction residuals above it are suspicious.
        radius : float, default 5
            All data within so many percent of the diagonal are held out when a datum is predicted.
        threads : int, optional
            At most so many threads.

        Returns
        -------
        Suspects
            With the scores of all data, the indices of the suspected ones, the worst first, and weights for a
            refit; see `mexpress.suspicion.suspects`.

        Raises
        ------
        ValueError, TypeError
            If the threshold or the radius is no positive number.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> source = np.random.default_rng(0).uniform(0, 100, (60, 2))
        >>> target = source + np.sin(source / 30)
        >>> target[7] += 20
        >>> mx.select_warp(source, target, counts=[3, 9]).suspects().indices
        array([7])
        """
        points, values, diagonal = self._data()
        scheme = exclusion_radius(points, check.positive(radius, "radius") / 100 * diagonal, threads)
        trials = self._trials(threads)
        return suspects(lambda weights: trials.best(weights)[0], scheme, values, threshold, threads=threads)

    def reweighted(self, weights: ArrayLike, threads: int | None = None) -> Model:
        """Fit and choose the model again, among those of `suspects`, with weights of the data.

        Parameters
        ----------
        weights : (n,) array
            Positive weight of each datum, such as `Suspects.weights`.
        threads : int, optional
            At most so many threads.

        Returns
        -------
        Warp or Surface
            As the selection is of warps or surfaces.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> source = np.random.default_rng(0).uniform(0, 100, (60, 2))
        >>> target = source + np.sin(source / 30)
        >>> target[7] += 20
        >>> selection = mx.select_warp(source, target, counts=[3, 9])
        >>> warp = selection.reweighted(selection.suspects().weights)
        >>> bool(np.abs(warp(source) - source - np.sin(source / 30)).max() < 0.2)
        True
        """
        fit, design, stiffness = self._trials(threads).best(check.real(weights, "weights"))
        return design.model(fit.coefficients, stiffness)

    def _trials(self, threads: int | None) -> Trials[Model]:
        points, _, diagonal = self._data()
        functions, region = type(self._lifting()), covered_region(points)
        most = max(4, min(len(points) // 3, self._supplest))
        counts = functions.counts(region, most)
        few = sorted({counts[0], counts[len(counts) // 3], counts[-1]})
        designs = [self._design(functions(functions.place(region, count, 0, threads))) for count in few]
        size = float(np.hypot(*np.ptp(points, axis=0)))
        pairs = [
            (design, float(size**2 * stiffness))
            for design in designs
            for stiffness in (_STIFFNESSES if len(design.bending()) else [0.0])
        ]
        return Trials(pairs, Judge.of([_CRITERION], points, diagonal, 0, threads), threads)
