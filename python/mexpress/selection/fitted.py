"""Selections with their data and their model: scores by radius, suspects, and fits with other weights."""

from __future__ import annotations

import os
import warnings
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress import notebook
from mexpress._validation import Floats, Integers
from mexpress.caching import cached_property
from mexpress.criteria import Scorer
from mexpress.geometry import diagonal
from mexpress.io.archives import replacing
from mexpress.leastsquares.model import LeastSquares
from mexpress.models import CardinalBasis, Design, FittedModel, ModelT, files
from mexpress.progress import Show, hidden
from mexpress.radii import RadiusCurve, radius_curve
from mexpress.schemes import Places, Scheme
from mexpress.selection import saved
from mexpress.selection.candidates import CriteriaRequest
from mexpress.selection.data import part, present
from mexpress.selection.log import logged
from mexpress.selection.notes import Subject, notes
from mexpress.selection.robust import THRESHOLD, find_wrong
from mexpress.selection.selection import Selection
from mexpress.suspicion import Suspects

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from mexpress.plotting.figures import Aside

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
    searched: bool = field(kw_only=True, default=False)
    """Whether wrong data were searched for."""

    axes: tuple[str, str] | None = field(kw_only=True, default=None)
    """What x and y of the points are called, if they were columns of a frame."""

    question: Question[Any] = field(kw_only=True)
    """What was asked of the data."""

    schemes: Mapping[str, Scheme] = field(kw_only=True, default_factory=dict)
    """Schemes of the user's own, over all data."""

    kind: ClassVar[str]
    """What files call such a selection."""

    _most_flexible_count: ClassVar[int]
    """Largest number of control points in the search for suspects."""

    def __init_subclass__(cls) -> None:
        files.KINDS[cls.kind] = cls

    @property
    @abstractmethod
    def _model(self) -> ModelT:
        """The selected warp or surface."""

    @property
    def placement(self) -> str:
        """Placement of the control points, as for `select_warp` and `select_surface`."""
        return self.question.placement

    def _parts(self) -> list[str]:
        fitted = {
            "model": repr(self._model),
            "data": f"{len(self.kept)} in the fit, {len(self.left_out)} left out",
        }
        return [notebook.facts(fitted), *super()._parts(), notebook.notes(self.notes)]

    @cached_property
    def kept(self) -> Integers:
        """Indices of the data of the fit, increasing: not those of weight 0, nor those that were left out."""
        return np.setdiff1d(present(self.data), self.left_out)

    @cached_property
    def _kept_data(self) -> Any:
        return part(self.data, self.kept)

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What a careful colleague would point out: sentences with their numbers and what to do; none as a rule.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> source = np.random.default_rng(0).uniform(0, 100, (60, 2))
        >>> target = source + np.sin(source / 30)
        >>> mx.select_warp(source, target).notes
        ()
        >>> target[7] += 20
        >>> mx.select_warp(source, target).notes[0][-67:]
        'looks like wrong data. robust=True finds and leaves out wrong data.'
        """
        data, model = self._kept_data, self._model
        return notes(Subject(self, data, model, self.placement, self.searched, self.least_squares, self.axes))

    def again(self, some: Integers) -> Any:
        """Return the selection for some of the data, given their indices, with the same settings."""
        return _select_part(self.data, self.question, self.schemes, some)

    def to_dict(self) -> dict[str, Any]:
        """Return what was selected as plain values, see `Selection.to_dict`; also ``left_out`` and ``notes``.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> source = np.random.default_rng(0).uniform(0, 100, (40, 2))
        >>> mx.select_warp(source, source**1.1, counts=[3, 4]).to_dict()["counts"]
        [3, 4]
        """
        return {**super().to_dict(), "left_out": self.left_out.tolist(), "notes": list(self.notes)}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the selection to a file for `mexpress.load`: its data, its models, all scores, and what was asked.

        Parameters
        ----------
        path : str or path
            Name of the file; no ending is added.

        Raises
        ------
        OSError
            If the file cannot be written; an existing file is then unchanged.

        Notes
        -----
        What is loaded does all that this selection does. Only a seed that is a generator is not saved: where something
        random is repeated, as `suspects` may, it is drawn afresh.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> import tempfile
        >>> source = np.random.default_rng(0).uniform(0, 100, (20, 2))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     mx.select_warp(source, 2 * source, counts=[3, 9], smoothing=0).save(f"{folder}/selection.npz")
        ...     mx.load(f"{folder}/selection.npz").counts
        array([3, 9])
        """
        files.save(self, path)

    def _report(
        self,
        path: str | os.PathLike[str],
        figures: Sequence[str],
        residuals: Floats,
        unit: str | None,
        image_size: tuple[float, float] | None,
        command: str | None,
    ) -> None:
        """Write the page of the selection with figures of its model, which are HTML."""
        from mexpress.selection.reports import Account  # noqa: PLC0415 - what few need

        weights = self.data.weights
        account = Account(
            scores=self,
            kind=self._model.kind,
            model=repr(self._model),
            unit=unit,
            points=self.data.points,
            residuals=residuals,
            kept=self.kept,
            left_out=self.left_out,
            notes=self.notes,
            asked=saved.settings(self.question),
            schemes=list(self.schemes),
            weighted=weights is not None and bool((weights[~np.isnan(residuals)] != 1).any()),
            image_size=image_size,
            searched=self.searched,
            command=check.text(command, "command"),
        )
        with replacing(path) as file:
            file.write(account.page(self._table(unit), figures).encode())

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that describe the selection, by name."""
        content = {
            "scores": saved.scores_to_plain(self),
            "left_out": self.left_out.tolist(),
            "searched": self.searched,
            "axes": self.axes,
            "question": saved.settings(self.question),
            "schemes": {name: scheme.n_data for name, scheme in self.schemes.items()},
        }
        return {
            "selection": saved.to_text(content),
            **self.data.to_arrays(),
            **saved.models_to_arrays(self._models),
            **saved.schemes_to_arrays(self.schemes),
        }

    @classmethod
    @abstractmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Rebuild a selection from the arrays of `to_arrays`; other names are ignored."""

    def _whole(self) -> Self:
        """Return the selection, which was read, if it has the model that it selects."""
        if self.count not in self._models:
            rule = "Its models must have that with the selected number of control points."
            check.refuse("selection", rule, f"{self.count} of {', '.join(map(str, self._models))}")
        return self

    @property
    @abstractmethod
    def _models(self) -> Mapping[int, ModelT]:
        """The models that are kept, by number of control points."""

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
        return radius_curve(fit, Places(data.points, threads), data.domain, data.diagonal, percents, threads)

    def plot_radii(self, path: str | os.PathLike[str] | None = None, *, ax: Axes | None = None) -> Figure:
        """Plot the selected model's score against the radius of the held-out data (extra ``plot``).

        A second panel shows distances from the domain to the nearest datum: larger radii test predictions that no use
        inside the domain needs.

        Parameters
        ----------
        path : path, optional
            File for the figure; its ending gives the format.
        ax : matplotlib.axes.Axes, optional
            Where to draw the scores alone, in place of a figure of its own.

        Returns
        -------
        matplotlib.figure.Figure
            That of `ax`, or a new one, which notebooks show.
        """
        from mexpress.plotting import plot_radii  # noqa: PLC0415 - an extra

        return plot_radii(self.radii(), path, ax=ax, unit=self._unit)

    def plot_error(self, path: str | os.PathLike[str] | None = None, *, ax: Axes | None = None) -> Figure:
        """Plot the error to expect of the selected model, see `mexpress.Surface.error` (extra ``plot``).

        A map of the domain, hatched where the error has not been tested, and the error by the distance to the data.

        Parameters
        ----------
        path : path, optional
            File for the figure; its ending gives the format.
        ax : matplotlib.axes.Axes, optional
            Where to draw the map alone, in place of a figure of its own.

        Returns
        -------
        matplotlib.figure.Figure
            That of `ax`, or a new one, which notebooks show.
        """
        from mexpress.plotting import plot_error  # noqa: PLC0415 - an extra

        assert isinstance(self._model, FittedModel)  # as warps and surfaces are
        return plot_error(self._model, path, ax=ax, unit=self._unit)

    def _aside(self) -> Aside:
        """Tell which data are not in the fit; those that are missing are absent, too."""
        from mexpress.plotting.figures import Aside  # noqa: PLC0415 - an extra

        every = np.arange(len(self.data.points))
        return Aside(self.left_out, np.setdiff1d(every, np.union1d(self.left_out, self.kept)))

    def suspects(
        self, threshold: float = THRESHOLD, radius: float = 0.0, threads: int | None = None
    ) -> Suspects:
        """Find the data that contradict this selection made without them: wrong matches, wrong depths.

        The selection is repeated, with its own settings, for the data that are not suspected, until these stay the
        same; see `mexpress.selection.robust.find_wrong`. This is no RANSAC: if half of the data are wrong, it warns
        that its result is doubtful.

        Parameters
        ----------
        threshold : float, default 6
            Data with larger prediction errors are suspicious, in units of the noise or, where they are larger, of the
            errors of the data around.
        radius : float, default 0
            Every datum is predicted with all data within this percentage of the diagonal held out; only itself by
            default. A radius is for wrong data in clusters.
        threads : int, optional
            Largest number of threads.

        Returns
        -------
        Suspects
            Scores of all data, indices of the suspected data with the worst first, and weights for a refit; see
            `mexpress.suspicion.Suspects`. Data of weight 0 have no score.

        Raises
        ------
        ValueError, TypeError
            If the threshold is not a positive number, or the radius not a number of at least 0.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> source = np.random.default_rng(0).uniform(0, 100, (60, 2))
        >>> target = source + np.sin(source / 30)
        >>> target[7] += 20
        >>> mx.select_warp(source, target).suspects().indices
        array([7])
        """
        limit = check.positive(threshold, "threshold")
        share = check.number(radius, "radius", "It must be a number of at least 0.", 0.0)
        some = present(self.data)
        data = part(self.data, some)
        found = find_wrong(
            data, lambda kept: self.again(some[kept]), limit, share / 100 * data.diagonal, threads=threads
        )
        scores = np.full(len(self.data.points), np.nan)
        scores[some] = found.scores
        return replace(found, scores=scores)

    def reweighted(self, weights: ArrayLike, threads: int | None = None) -> ModelT:
        """Select and fit the model again with weights of the data, among a few models.

        Deprecated: `select_warp` and `select_surface` leave wrong data out with `robust`, and take `weights`.

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
        """
        instead = "reweighted is deprecated: select again, with robust=True or with weights."
        warnings.warn(instead, DeprecationWarning, stacklevel=2)
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

    @property
    def threads(self) -> int | None:
        """Largest number of threads."""

    @property
    def placement(self) -> str:
        """Placement of the control points."""

    def select(
        self, data: Any, criteria: Sequence[str] | Mapping[str, Scheme] | None, show: Show
    ) -> SelectionT_co:
        """Return the selection of data of positive weight; `show` shows the progress."""


@logged
def select_of(
    data: Any,
    question: Question[SelectionT_co],
    criteria: Sequence[str] | Mapping[str, Scheme] | None,
    robust: bool,
    show: Show,
) -> SelectionT_co:
    """Select for the data that are present and, if `robust`, not wrong; and tell of all data by their indices."""
    n, kept = len(data.points), present(data)
    schemes = dict(criteria) if isinstance(criteria, Mapping) else {}
    wrong = np.zeros(0, dtype=np.int64)
    if robust:
        again = partial(_select_part, data, question, schemes)
        found = find_wrong(part(data, kept), lambda some: again(kept[some]), threads=question.threads)
        wrong = kept[np.sort(found.indices)]
        kept = np.setdiff1d(kept, wrong)
    selection = question.select(part(data, kept), _restricted(criteria, kept, n), show)
    undefined = {
        name: {count: kept[lost] for count, lost in by_count.items()}
        for name, by_count in selection.undefined.items()
    }
    return replace(
        selection, data=data, undefined=undefined, left_out=wrong, searched=robust, schemes=schemes
    )


def _select_part(
    data: Any, question: Question[SelectionT_co], schemes: Mapping[str, Scheme], some: Integers
) -> SelectionT_co:
    """Select for some of the data, with no criteria but the one that selects and schemes of one's own."""
    return question.select(part(data, some), _restricted(schemes, some, len(data.points)), hidden)


def _restricted(
    criteria: Sequence[str] | Mapping[str, Scheme] | None, kept: Integers, n: int
) -> Sequence[str] | Mapping[str, Scheme] | None:
    """Schemes of one's own over all n data, without those that are absent."""
    if not isinstance(criteria, Mapping) or len(kept) == n:
        return criteria
    return {
        name: scheme.restricted(kept) if isinstance(scheme, Scheme) and scheme.n_data == n else scheme
        for name, scheme in criteria.items()
    }
