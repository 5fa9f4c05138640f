"""The scores of a sweep over models, and the model that each criterion selects."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.criteria import UNITLESS

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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

    def __post_init__(self) -> None:
        shape = len(self.counts), len(self.weights)
        object.__setattr__(self, "maps", {name: np.reshape(m, shape) for name, m in self.maps.items()})

    def __repr__(self) -> str:
        tried = f"{self.counts[0]} to {self.counts[-1]} control points"
        chosen = f"{self.criterion} chooses {self.count} of {tried}"
        if len(self.weights) > 1:
            tried = f"{self.weights[0]:.3g} to {self.weights[-1]:.3g}"
            chosen += f" and smoothing {self.smoothing:.3g} of {tried}"
        return f"{type(self).__name__}({chosen}, {self.criterion}={self.score:.4g})"

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
        """Number of control points that each criterion selects; None for a criterion without a score.

        The slack does not apply to AIC and BIC, which have no unit and penalise parameters themselves.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> mx.Selection("FIT", np.array([3, 4]), {"FIT": np.array([2.0, 1.0])}, {}).selected
        {'FIT': 4}
        """
        places = {name: self._place(name) for name in self.maps}
        return {name: None if at is None else int(self.counts[at[0]]) for name, at in places.items()}

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
        places = {name: self._place(name) for name in self.maps}
        return {name: None if at is None else float(self.weights[at[1]]) for name, at in places.items()}

    @property
    def count(self) -> int:
        """The selected number of control points."""
        return int(self.counts[self.place[0]])

    @property
    def smoothing(self) -> float:
        """The selected weight of the bending energy."""
        return float(self.weights[self.place[1]])

    @property
    def score(self) -> float:
        """The criterion's score of the selected model."""
        return float(self.maps[self.criterion][self.place])

    @property
    def place(self) -> tuple[int, int]:
        """Positions of the selected count and the selected weight."""
        chosen = self._place(self.criterion)
        if chosen is None:
            rule = (
                "It must have a score at one count at least; more data, fewer of them held out, or smoothing "
                "above 0 may help."
            )
            check.refuse(
                "criterion", rule, f"{self.criterion}, undefined from {self.counts[0]} control points on"
            )
        return chosen

    def _place(self, name: str) -> tuple[int, int] | None:
        """Positions of the count and the weight that a criterion selects."""
        scores = self.maps[name]
        if np.isnan(scores).all():
            return None
        best = int(np.nanargmin(scores))
        if self.slack and self.parameters is not None and name not in UNITLESS:
            near = scores <= (1 + self.slack) * scores.flat[best]
            best = int(np.where(near, self.parameters, np.inf).argmin())
        k, w = np.unravel_index(best, scores.shape)
        return int(k), int(w)

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
        if k == self.place[0]:
            return self.place[1]
        scores = self.maps[self.criterion][k]
        return None if np.isnan(scores).all() else int(np.nanargmin(scores))

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Plot the criteria against the number of control points, and the weight if there are several (extra ``plot``).

        Parameters
        ----------
        path : path, optional
            File for the figure; its ending gives the format.
        """
        from mexpress.plotting import plot_selection  # noqa: PLC0415 - an extra

        return plot_selection(self, path)
