"""The scores of a sweep over models, and the model that each criterion selects."""

from __future__ import annotations

import math
import os
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress import notebook
from mexpress._validation import Floats, Integers
from mexpress.criteria import UNITLESS
from mexpress.extras import required

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame


_FEW = 4
"""Up to so many counts, weights are the axis that tells more."""


@dataclass(frozen=True, eq=False, repr=False)
class Selection:
    """Scores by number of control points and weight of the bending energy, and the model that each criterion selects.

    Parameters
    ----------
    criterion : str
        The criterion that selects.
    counts : (k,) int64 array
        Numbers of control points, increasing.
    maps : dict of str to (k, w) array
        Score of every count and weight by criterion, in the responses' unit (AIC and BIC have none); NaN where
        undefined. (k,) arrays stand for (k, 1).
    undefined : dict of str to dict of int to int64 array
        Data that cannot be predicted at any weight, by criterion and count (as found at the largest weight). Counts
        without such data are absent.
    weights : (w,) array, optional
        Weights of the bending energy, increasing; 0 alone by default.
    parameters : (k, w) array, optional
        Effective numbers of parameters, trace(H); NaN where a model is not determined.
    open : dict of int to int, optional
        Number of unknowns that only the bending energy determines, by count. Counts without such unknowns are absent.
    slack : float, default 0
        Scores within this fraction of the best are ties; the model with the fewest effective parameters wins.
    rivals : dict of str to Selection, optional
        Scores of other models by name: "affine map", "homography", "plane", or "piecewise affine".
    rival : str, optional
        Which of them is selected; None if it is a model of these counts and weights.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> maps = {"FIT": np.array([3.0, 2.0, 1.0]), "ER10": np.array([4.0, 3.5, np.nan])}
    >>> selection = mx.Selection("ER10", np.array([3, 4, 5]), maps, {"ER10": {5: np.array([17])}})
    >>> selection
    Selection(ER10 chooses 4 of 3 to 5 control points, ER10=3.5)
    >>> selection.selected
    {'FIT': 5, 'ER10': 4}
    """

    criterion: str
    counts: Integers
    maps: dict[str, Floats]
    undefined: dict[str, dict[int, Integers]]
    weights: Floats = field(kw_only=True, default_factory=lambda: np.zeros(1))
    parameters: Floats | None = field(kw_only=True, default=None)
    open: dict[int, int] = field(kw_only=True, default_factory=dict)
    slack: float = field(kw_only=True, default=0.0)
    rivals: dict[str, Selection] = field(kw_only=True, default_factory=dict)
    rival: str | None = field(kw_only=True, default=None)

    _unit: ClassVar[str | None] = None
    """Unit of the values, if it is known."""

    def __post_init__(self) -> None:
        shape = len(self.counts), len(self.weights)
        object.__setattr__(self, "maps", {name: np.reshape(m, shape) for name, m in self.maps.items()})

    def __repr__(self) -> str:
        tried = f"{self.counts[0]} to {self.counts[-1]} control points"
        if self._scoreless:
            return f"{type(self).__name__}({self.sentence} at {tried})"
        chosen = f"{self.criterion} chooses {self.count} of {tried}"
        if self.rival is not None:
            chosen = f"{self.criterion} chooses the {self.rival} before {tried}"
        elif len(self.weights) > 1:
            tried = f"{self.weights[0]:.3g} to {self.weights[-1]:.3g}"
            chosen += f" and smoothing {self.smoothing:.3g} of {tried}"
        return f"{type(self).__name__}({chosen}, {self.criterion}={self.score:.4g})"

    def _repr_html_(self) -> str:
        return notebook.card(f"{type(self).__name__}: {self.sentence}", *self._parts())

    @property
    def _scoreless(self) -> bool:
        """Whether the criterion is undefined for all models, as it may be for a rival's."""
        return self.rival is None and strongest([self], self.criterion) is None

    @property
    def sentence(self) -> str:
        """What the criterion selects, in words.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> mx.Selection("FIT", np.array([3, 4]), {"FIT": np.array([2.0, 1.0])}, {}).sentence
        'FIT selects 4 control points'
        """
        if self._scoreless:
            return f"{self.criterion} has no score"
        what = f"the {self.rival}" if self.rival is not None else f"{self.count} control points"
        if self.rival is None and len(self.weights) > 1:
            what += f" and smoothing {self.smoothing:.3g}"
        return f"{self.criterion} selects {what}"

    def _parts(self) -> list[str]:
        """What a notebook shows below the title, as HTML."""
        return [self._table(self._unit), self._curve_picture()]

    def _table(self, unit: str | None) -> str:
        """What each criterion selects, as HTML."""
        heads = ["criterion", "selects", "smoothing", "parameters", f"score ({unit or 'unit of the data'})"]
        rows = [[name, *self._choice_cells(name)] for name in self.maps]
        return notebook.table(heads, rows, [self.criterion])

    def _choice_cells(self, name: str) -> list[str]:
        """What a criterion selects, the weight and the effective parameters of that, and its score there."""
        best = self.choice(name)
        if best is None:
            return ["none", "", "", ""]
        winner, k, w = best
        rival = self.selected_rival[name]
        parameters = math.nan if winner.parameters is None else float(winner.parameters[k, w])
        return [
            str(winner.counts[k]) if rival is None else rival,
            f"{winner.weights[w]:.3g}" if rival is None else "",
            "" if math.isnan(parameters) else f"{parameters:.1f}",
            f"{winner.maps[name][k, w]:.4g}{' (no unit)' if name in UNITLESS else ''}",
        ]

    def _curve_picture(self) -> str:
        """The criterion against the count or, with few counts, against the weight; nothing if there is one of each."""
        if self._scoreless:
            return ""
        k, w = self.place
        scores = self.maps[self.criterion]
        if weights_tell_more(self):
            y, chosen, axis = scores[k], w, f"smoothing, at {self.counts[k]} control points"
            x, names = range(len(self.weights)), [f"{weight:.3g}" for weight in self.weights]
        else:
            y, chosen, axis = self.curves[self.criterion], k, "control points"
            x, names = self.counts.tolist(), [str(count) for count in self.counts]
        if len(y) < 2 or np.isnan(y).all():
            return ""
        marks = [names[0], names[chosen], names[-1]]
        rival = None if self.rival is None else (self.rival, self.score)
        return notebook.curve(self.criterion, x, y.tolist(), chosen, marks, axis, rival)

    def showing(self, names: Container[str]) -> Self:
        """Return the selection with some of its criteria."""
        maps = {name: scores for name, scores in self.maps.items() if name in names}
        undefined = {name: data for name, data in self.undefined.items() if name in names}
        return replace(self, maps=maps, undefined=undefined)

    @property
    def curves(self) -> dict[str, Floats]:
        """Score of every count at its best weight, (k,), by criterion; NaN where undefined.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> maps = {"GCV": np.array([[4.0, 3.5], [3.0, 5.0]])}
        >>> mx.Selection("GCV", np.array([3, 4]), maps, {}, weights=np.array([0.0, 1.0])).curves
        {'GCV': array([3.5, 3. ])}
        """
        return {name: np.fmin.reduce(scores, axis=1) for name, scores in self.maps.items()}

    @property
    def selected(self) -> dict[str, int | None]:
        """Number of control points that each criterion selects, of all models; None for a criterion without a score.

        The slack does not apply to AIC and BIC, which have no unit and penalise parameters themselves.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> mx.Selection("FIT", np.array([3, 4]), {"FIT": np.array([2.0, 1.0])}, {}).selected
        {'FIT': 4}
        """
        best = {name: self.choice(name) for name in self.maps}
        return {name: None if at is None else int(at[0].counts[at[1]]) for name, at in best.items()}

    @property
    def selected_smoothing(self) -> dict[str, float | None]:
        """Weight of the bending energy that each criterion selects; None for a criterion without a score.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> maps = {"GCV": np.array([[4.0, 3.5], [3.0, 5.0]]), "FIT": np.array([[2.0, 3.0], [1.0, 2.0]])}
        >>> mx.Selection("GCV", np.array([3, 4]), maps, {}, weights=np.array([0.0, 1.0])).selected_smoothing
        {'GCV': 0.0, 'FIT': 0.0}
        """
        best = {name: self.choice(name) for name in self.maps}
        return {name: None if at is None else float(at[0].weights[at[2]]) for name, at in best.items()}

    @property
    def selected_rival(self) -> dict[str, str | None]:
        """Name of the rival that each criterion selects; None for a model of these counts and weights.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> plain = mx.Selection("FIT", np.array([3]), {"FIT": np.array([1.0])}, {})
        >>> maps = {"FIT": np.array([2.0]), "AIC": np.array([9.0])}
        >>> mx.Selection("FIT", np.array([3]), maps, {}, rivals={"plane": plain}, rival="plane").selected_rival
        {'FIT': 'plane', 'AIC': None}
        """
        winners = {name: best[0] for name in self.maps if (best := self.choice(name)) is not None}
        names = {id(rival): name for name, rival in self.rivals.items()}
        return {name: names.get(id(winners.get(name))) for name in self.maps}

    @property
    def count(self) -> int:
        """The selected number of control points."""
        return int(self.winner.counts[self.winner.place[0]])

    @property
    def smoothing(self) -> float:
        """The selected weight of the bending energy."""
        return float(self.winner.weights[self.winner.place[1]])

    @property
    def score(self) -> float:
        """The criterion's score of the selected model."""
        return float(self.winner.maps[self.criterion][self.winner.place])

    @property
    def effective_parameters(self) -> float:
        """Effective number of parameters of the selected model, trace(H); NaN if it is not known."""
        known = self.winner.parameters
        return math.nan if known is None else float(known[self.winner.place])

    @property
    def place(self) -> tuple[int, int]:
        """Positions of the best count and weight, whatever rivals do; the first ones if only a rival has a score."""
        best = strongest([self], self.criterion)
        if best is None and self.rival is not None:
            return 0, 0
        if best is None:
            ways = "more data, or fewer of them held out, as by CMPRESS" + (
                "" if self.weights[0] > 0 else ", or smoothing above 0"
            )
            rule = f"It must have a score at one count at least; {ways} may help."
            check.refuse(
                "criterion", rule, f"{self.criterion}, undefined from {self.counts[0]} control points on"
            )
        return best[1:]

    @property
    def winner(self) -> Selection:
        """The scores that have the selected model: these, or those of a rival."""
        return self if self.rival is None else self.rivals[self.rival]

    def choice(self, name: str) -> tuple[Selection, int, int] | None:
        """The selection with the model that a criterion selects, and the positions of its count and weight."""
        if name == self.criterion and self.rival is not None:
            return self.winner, *self.winner.place
        # A rival that the criterion did not select may still be the best by its score alone.
        own = [self] if name == self.criterion else [self, *self.rivals.values()]
        return strongest([entrant for entrant in own if name in entrant.maps], name)

    def best_weight(self, k: int) -> int | None:
        """Position of the criterion's best weight at the k-th count; None without a score.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> maps = {"GCV": np.array([[4.0, 3.5], [3.0, 5.0]])}
        >>> mx.Selection("GCV", np.array([3, 4]), maps, {}, weights=np.array([0.0, 1.0])).best_weight(0)
        1
        """
        best = strongest([self], self.criterion)
        if best is not None and k == best[1]:
            return best[2]
        scores = self.maps[self.criterion][k]
        return None if np.isnan(scores).all() else int(np.nanargmin(scores))

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return count, smoothing, effective parameters and every score of the models, each (k w,), without rivals.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> mx.Selection("FIT", np.array([3, 4]), {"FIT": np.array([2.0, 1.0])}, {}).columns()["FIT"]
        array([2., 1.])
        """
        shape = len(self.counts), len(self.weights)
        parameters = np.full(shape, np.nan) if self.parameters is None else self.parameters
        return {
            "count": np.repeat(self.counts, shape[1]),
            "smoothing": np.tile(self.weights, shape[0]),
            "parameters": parameters.ravel(),
            **{name: scores.ravel() for name, scores in self.maps.items()},
        }

    def to_frame(self) -> DataFrame:
        """Return all models that were tried as a table of pandas (extra ``pandas``).

        Returns
        -------
        DataFrame
            A row for each count and weight, and for each of the rivals'. ``rival`` is the rival's name, missing for
            other models; ``count``, ``smoothing`` and ``parameters`` are the number of control points, the weight of
            the bending energy and the effective number of parameters; then every criterion has a column, NaN where
            undefined; ``selected`` is True for the selected model.

        Raises
        ------
        ImportError
            If pandas is not installed.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> maps = {"GCV": np.array([[4.0, 3.5], [3.0, 5.0]])}
        >>> mx.Selection("GCV", np.array([3, 4]), maps, {}, weights=np.array([0.0, 1.0])).to_frame()
          rival  count  smoothing  parameters  GCV  selected
        0  None      3        0.0         NaN  4.0     False
        1  None      3        1.0         NaN  3.5     False
        2  None      4        0.0         NaN  3.0      True
        3  None      4        1.0         NaN  5.0     False
        """
        pd = required("pandas", "Tables of pandas need it", "pandas")
        names = [None, *self.rivals]
        tables = [entrant.columns() for entrant in (self, *self.rivals.values())]
        sizes = [len(table["count"]) for table in tables]
        rival = [name for name, size in zip(names, sizes, strict=True) for _ in range(size)]
        columns = {
            name: np.concatenate(
                [table.get(name, np.full(size, np.nan)) for table, size in zip(tables, sizes, strict=True)]
            )
            for name in tables[0]
        }
        k, w = self.winner.place
        selected = np.arange(sum(sizes)) == rival.index(self.rival) + k * len(self.winner.weights) + w
        return pd.DataFrame({"rival": pd.Series(rival, dtype=object), **columns, "selected": selected})

    def to_dict(self) -> dict[str, Any]:
        """Return what was selected as plain numbers, texts, lists and dictionaries, as JSON has them.

        Returns
        -------
        dict
            ``criterion`` selects; ``score`` is its value for the selected model; ``count``, ``smoothing``,
            ``effective_parameters`` and ``rival`` say which that is. ``selected`` and ``selected_smoothing`` have what
            each criterion would select. ``counts`` and ``weights`` are what was tried; ``curves`` has the scores by
            criterion and count, each at its best weight, and ``maps``, if there are several weights, by criterion,
            count and weight. ``rivals`` has the scores of each rival by criterion. ``open`` is the attribute of this
            name, and ``undefined`` too, by criterion and count. None stands for what is not defined.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> maps = {"FIT": np.array([3.0, 2.0]), "ER10": np.array([4.0, np.nan])}
        >>> plain = mx.Selection("ER10", np.array([3, 4]), maps, {"ER10": {4: np.array([17])}}).to_dict()
        >>> plain["curves"], plain["undefined"]
        ({'FIT': [3.0, 2.0], 'ER10': [4.0, None]}, {'ER10': {'4': [17]}})
        """
        several = {"maps": {name: scores.tolist() for name, scores in self.maps.items()}}
        content: dict[str, Any] = {
            "criterion": self.criterion,
            "count": self.count,
            "smoothing": self.smoothing,
            "effective_parameters": self.effective_parameters,
            "score": self.score,
            "selected": self.selected,
            "selected_smoothing": self.selected_smoothing,
            "counts": self.counts.tolist(),
            "weights": self.weights.tolist(),
            "rival": self.rival,
            "rivals": {name: rival.best_scores() for name, rival in self.rivals.items()},
            "open": {str(count): unknowns for count, unknowns in self.open.items()},
            "curves": {name: curve.tolist() for name, curve in self.curves.items()},
            "undefined": {
                name: {str(count): data.tolist() for count, data in by_count.items()}
                for name, by_count in self.undefined.items()
            },
            **(several if len(self.weights) > 1 else {}),
        }
        return {name: plain(value) for name, value in content.items()}

    def best_scores(self) -> dict[str, float]:
        """Return every criterion's score of the model that the criterion selects; none if it has no score.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> mx.Selection("FIT", np.array([3, 4]), {"FIT": np.array([2.0, 1.0])}, {}).best_scores()
        {'FIT': 1.0}
        """
        best = self.choice(self.criterion)
        return {} if best is None else {name: float(scores[best[1:]]) for name, scores in self.maps.items()}

    def plot(self, path: str | os.PathLike[str] | None = None, *, ax: Axes | None = None) -> Figure:
        """Plot the criteria against the number of control points, and the weight if there are several (extra ``plot``).

        Parameters
        ----------
        path : path, optional
            File for the figure; its ending gives the format.
        ax : matplotlib.axes.Axes, optional
            Where to draw the curves alone, in place of a figure of its own.

        Returns
        -------
        matplotlib.figure.Figure
            That of `ax`, or a new one, which notebooks show.
        """
        from mexpress.plotting import plot_selection  # noqa: PLC0415 - an extra

        return plot_selection(self, path, ax=ax)


def plain(value: Any) -> Any:
    """Return numbers, texts, lists and mappings as JSON has them: it knows neither NaN nor infinity, but None.

    Examples
    --------
    >>> plain({"a": (1.0, math.inf)})
    {'a': [1.0, None]}
    """
    if isinstance(value, Mapping):
        return {name: plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def weights_tell_more(selection: Selection) -> bool:
    """Tell whether there are weights to choose from, and few counts."""
    return len(selection.weights) > 1 and len(selection.counts) <= _FEW


def strongest(entrants: Sequence[Selection], name: str) -> tuple[Selection, int, int] | None:
    """Return the selection with the best model by a criterion, and the positions of its count and weight.

    Ties go to the model with the fewest effective parameters. AIC and BIC, which charge for parameters themselves, have
    no ties. None if no model has a score.
    """
    scores = np.concatenate([entrant.maps[name].ravel() for entrant in entrants])
    if np.isnan(scores).all():
        return None
    best = int(np.nanargmin(scores))
    known = [entrant.parameters for entrant in entrants if entrant.parameters is not None]
    slack = entrants[0].slack
    if slack and len(known) == len(entrants) and name not in UNITLESS:
        parameters = np.concatenate([each.ravel() for each in known])
        near = scores <= (1 + slack) * scores[best]
        best = int(np.where(near, parameters, np.inf).argmin())
    for entrant in entrants:
        shape = entrant.maps[name].shape
        if best < math.prod(shape):
            break
        best -= math.prod(shape)
    k, w = np.unravel_index(best, shape)
    return entrant, int(k), int(w)
