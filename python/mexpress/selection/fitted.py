"""Selections with their data and their model: scores by radius, suspects, and fits with other weights."""

from __future__ import annotations

import os
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.criteria import Scorer
from mexpress.geometry import diagonal
from mexpress.leastsquares.model import LeastSquares
from mexpress.models import CardinalBasis, Design, FittedModel, ModelT
from mexpress.radii import RadiusCurve, radius_curve
from mexpress.schemes import Places, Scheme
from mexpress.selection.candidates import CriteriaRequest
from mexpress.selection.data import Data, part, present
from mexpress.selection.selection import Selection
from mexpress.suspicion import Suspects, suspects

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_CRITERION = "ER10"

_STIFFNESSES = 10.0 ** np.arange(-6, 1)
"""Weights of the bending energy to try, in units of the squared diagonal of the data's bounding box."""


@dataclass(frozen=True)
class Trials(Generic[ModelT]):
    """A few models from stiff to flexible; ER10 selects one of them for given weights of the data."""

    pairs: list[tuple[Design[ModelT], float]]
    scorer: Scorer
    threads: int | None

    def best(self, weights: Floats) -> tuple[LeastSquares, Design[ModelT], float]:
        """Return the fit of the best model with these weights, its design, and its weight of the bending energy."""
        fits = [design.weighted(weights).fit(stiffness, self.threads) for design, stiffness in self.pairs]
        scores = [self.scorer.scores(fit, self.threads)[_CRITERION].value for fit in fits]
        if np.isnan(scores).all():
            check.refuse("points", f"{_CRITERION} must have a score.", "data that are too few for it")
        k = int(np.nanargmin(scores))
        return fits[k], *self.pairs[k]


@dataclass(frozen=True, eq=False, repr=False)
class FittedSelection(Selection, Generic[ModelT]):
    """A selection with its data and its selected model: a `WarpSelection` or a `SurfaceSelection`."""

    data: Any
    left_out: Integers = field(kw_only=True, default_factory=lambda: np.zeros(0, dtype=np.int64))
    _unit: ClassVar[str | None] = None
    """Unit of the values, if it is known."""

    _most_flexible_count: ClassVar[int]
    """Largest number of control points in the search for suspects."""

    @property
    @abstractmethod
    def _model(self) -> ModelT:
        """The selected warp or surface."""

    @cached_property
    def _kept_data(self) -> Any:
        """The data of the fit: not those of weight 0, nor those that were left out."""
        kept = np.setdiff1d(present(self.data), self.left_out)
        return part(self.data, kept)

    @abstractmethod
    def _design(self, basis: CardinalBasis) -> Design[ModelT]:
        """The least-squares problem over a basis."""

    def least_squares(self, weights: ArrayLike | None = None, threads: int | None = None) -> LeastSquares:
        """Return the least-squares problem of the selected model, for further cross-validation.

        Parameters
        ----------
        weights : (n,) array, optional
            Positive weight of each datum; 1 each by default.
        threads : int, optional
            Largest number of threads.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> source = np.random.default_rng(0).uniform(0, 100, (20, 2))
        >>> mx.select_warp(source, 2 * source + 1, counts=[3, 4, 5]).least_squares().n_data
        20
        """
        design = self._design(CardinalBasis(self._model.lifting))
        return design.weighted(None if weights is None else check.real(weights, "weights")).fit(
            self.smoothing, threads
        )

    def radii(self, percents: Sequence[float] | None = None, threads: int | None = None) -> RadiusCurve:
        """Score the selected model by local exclusion with several radii, see `mexpress.radii.score_by_radius`.

        Parameters
        ----------
        percents : sequence of float, optional
            Radii in percent of the diagonal, increasing; 0 to 20 by default.
        threads : int, optional
            Largest number of threads.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> source = np.random.default_rng(0).uniform(0, 100, (60, 2))
        >>> mx.select_warp(source, source + np.sin(source / 30), counts=[3, 9]).radii([0, 5, 10]).percents
        array([ 0.,  5., 10.])
        """
        data = self._kept_data
        fit = self.least_squares(threads=threads)
        return radius_curve(fit, Places(data.points), data.domain, data.diagonal, percents, threads)

    def plot_radii(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Plot the selected model's score against the radius of the held-out data (extra ``plot``).

        A second panel shows distances from the domain to the nearest datum: larger radii test predictions that no use
        inside the domain needs.

        Parameters
        ----------
        path : path, optional
            File for the figure; its ending gives the format.
        """
        from mexpress.plotting import plot_radii  # noqa: PLC0415 - an extra

        return plot_radii(self.radii(), path, unit=self._unit)

    def plot_error(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Plot the error to expect of the selected model, see `mexpress.Surface.error` (extra ``plot``).

        A map of the domain, hatched where the error has not been tested, and the error by the distance to the data.

        Parameters
        ----------
        path : path, optional
            File for the figure; its ending gives the format.
        """
        from mexpress.plotting import plot_error  # noqa: PLC0415 - an extra

        assert isinstance(self._model, FittedModel)  # as warps and surfaces are
        return plot_error(self._model, path, unit=self._unit)

    def suspects(self, threshold: float = 5.0, radius: float = 5.0, threads: int | None = None) -> Suspects:
        """Find the data that their neighbourhoods predict badly: wrong matches, wrong depths.

        Wrong data disturb the selection too. So ER10 selects the model again in every round, among three numbers of
        control points and seven weights of the bending energy. This is no RANSAC: if half of the data are wrong, it
        warns that its result is doubtful.

        Parameters
        ----------
        threshold : float, default 5
            Studentised prediction residuals above it are suspicious.
        radius : float, default 5
            Every datum is predicted with all data within this percentage of the diagonal held out.
        threads : int, optional
            Largest number of threads.

        Returns
        -------
        Suspects
            Scores of all data, indices of the suspected data with the worst first, and weights for a refit; see
            `mexpress.suspicion.suspects`.

        Raises
        ------
        ValueError, TypeError
            If the threshold or the radius is not a positive number.

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
        data = self._kept_data
        scheme = Places(data.points).within(check.positive(radius, "radius") / 100 * data.diagonal, threads)
        trials = self._trials(threads)
        return suspects(
            lambda weights: trials.best(weights)[0], scheme, data.values, threshold, threads=threads
        )

    def reweighted(self, weights: ArrayLike, threads: int | None = None) -> ModelT:
        """Select and fit the model again with weights of the data, among the models that `suspects` tries.

        Parameters
        ----------
        weights : (n,) array
            Positive weight of each datum, such as `Suspects.weights`.
        threads : int, optional
            Largest number of threads.

        Returns
        -------
        Warp or Surface
            A model of the kind of this selection.

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
        given = check.real(weights, "weights")
        fit, design, stiffness = self._trials(threads).best(given)
        return design.weighted(given).model(fit.coefficients, smoothing=stiffness)

    def _trials(self, threads: int | None) -> Trials[ModelT]:
        data, lifting = self._kept_data, type(self._model.lifting)
        most = max(4, min(len(data.points) // 3, self._most_flexible_count))
        counts = lifting.counts(data.domain.corners, most)
        few = sorted({counts[0], counts[len(counts) // 3], counts[-1]})
        bases = [CardinalBasis(lifting(lifting.place_over(data.domain, count, 0, threads))) for count in few]
        unit = diagonal(data.points) ** 2
        pairs = [
            (design, float(unit * stiffness))
            for design in map(self._design, bases)
            for stiffness in (_STIFFNESSES if len(design.bending()) else [0.0])
        ]
        _, scorer = CriteriaRequest(_CRITERION, [], data, 0, threads).scorer(nested=False)
        return Trials(pairs, scorer, threads)


SelectionT_co = TypeVar("SelectionT_co", bound=FittedSelection[Any], covariant=True)


class Question(Protocol[SelectionT_co]):
    """What a selection is asked, whichever of the data remain."""

    def select(
        self, data: Any, criteria: Sequence[str] | Mapping[str, Scheme] | None, label: str | None
    ) -> SelectionT_co:
        """Return the selection of data of positive weight; `label` names the progress that is shown, if any."""


def select_of(
    data: Data,
    question: Question[SelectionT_co],
    criteria: Sequence[str] | Mapping[str, Scheme] | None,
    label: str | None,
) -> SelectionT_co:
    """Select for the data that are present, and tell of all data by their indices."""
    n, kept = len(data.points), present(data)
    if len(kept) == n:
        return question.select(data, criteria, label)
    selection = question.select(data.subset(kept), _restricted(criteria, kept, n), label)
    undefined = {
        name: {count: kept[lost] for count, lost in by_count.items()}
        for name, by_count in selection.undefined.items()
    }
    return replace(selection, data=data, undefined=undefined)


def _restricted(
    criteria: Sequence[str] | Mapping[str, Scheme] | None, kept: Integers, n: int
) -> Sequence[str] | Mapping[str, Scheme] | None:
    """Schemes of one's own over all n data, without those that are absent."""
    if not isinstance(criteria, Mapping):
        return criteria
    return {
        name: scheme.restricted(kept) if isinstance(scheme, Scheme) and scheme.n_data == n else scheme
        for name, scheme in criteria.items()
    }
