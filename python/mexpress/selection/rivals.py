"""The models beside the grid of counts and weights, and which of all is selected.

With automatic smoothing, plain maps are candidates too: an affine map and a homography, or a plane. They have no
control points to place, and a dozen matches want no more. The criterion alone is not enough for them: where it holds
out much, as in clusters, an affine map can be no worse than a bend that every neighbour confirms. So a plain map is
selected only if leave-one-out does not contradict.

Where queries are far from the data, piecewise affine models are candidates: they bridge gaps without the waves of a
spline, but they are worse everywhere else, so they have to be better by more than chance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Generic

import numpy as np

from mexpress._validation import Floats
from mexpress.liftings import ThinPlateSpline
from mexpress.models import Basis, Design, ModelT
from mexpress.placement import farthest_order
from mexpress.progress import Show, hidden
from mexpress.selection.candidates import Candidates, CriteriaRequest
from mexpress.selection.data import Data
from mexpress.selection.selection import Selection
from mexpress.selection.sweep import Sweep
from mexpress.selection.unscored import refuse_unscored

PIECEWISE_AFFINE = "piecewise affine"


@dataclass(frozen=True, eq=False, repr=False)
class Outcome(Generic[ModelT]):
    """What was selected.

    Parameters
    ----------
    selection : Selection
        The grid, with its rivals.
    sweep : Sweep
        The models of the grid.
    ordered : (l, 2) array or None
        Ordered control points of the grid.
    model : Warp or Surface
        The selected model, of the grid or a rival.
    """

    selection: Selection
    sweep: Sweep[ModelT]
    ordered: Floats | None
    model: ModelT


def select(
    grid: Candidates[ModelT],
    plain: Mapping[str, Candidates[ModelT]],
    bridge: Candidates[ModelT] | None,
    request: CriteriaRequest,
    show: Show,
) -> Outcome[ModelT]:
    """Let the criterion select among the grid and the plain maps, and perhaps piecewise affine models instead.

    Parameters
    ----------
    grid : Candidates
        Counts and weights.
    plain : mapping of str to Candidates
        Plain maps by name, which compete by their scores.
    bridge : Candidates or None
        Piecewise affine models, if the queries are far from the data and the criterion holds out data.
    request : CriteriaRequest
        The criteria.
    show : callable
        Shows the progress of the grid.
    """
    own, sweep, ordered = grid.select(request, show)
    if own.criterion == "PRESS":  # it averages over rows, and not every family has as many
        plain, bridge = {}, None
    winner = Entrant.best_of(None, own, sweep)
    tried = {name: candidates.select(request, hidden)[:2] for name, candidates in plain.items()}
    simple = (Entrant.best_of(name, *found) for name, found in tried.items())
    for each in sorted((each for each in simple if each is not None), key=lambda each: each.score):
        if winner is None or each.may_replace(winner, request):
            winner = each
            break
    if winner is None:
        refuse_unscored(own, request)
    if bridge is not None:
        tried[PIECEWISE_AFFINE] = bridge.select(request, hidden)[:2]
        other = Entrant.best_of(PIECEWISE_AFFINE, *tried[PIECEWISE_AFFINE])
        if other is not None and other.surely_better_than(winner, request):
            winner = other
    rivals = {name: found[0].showing(request.shown - {"PRESS"}) for name, found in tried.items()}
    selection = replace(own.showing(request.shown), rivals=rivals, rival=winner.name)
    return Outcome(selection, sweep, ordered, winner.model)


ROUNDING = 1e-9
"""One model reached in two ways, as the plane is by three control points at any weight, has about the same numbers."""


@dataclass(frozen=True, eq=False, repr=False)
class Entrant(Generic[ModelT]):
    """The best model of a family, and how well it predicts held-out data.

    Parameters
    ----------
    name : str or None
        The family; None is the grid.
    score : float
        The criterion's.
    parameters : float
        Effective number of parameters.
    model : Warp or Surface
        The model.
    errors : dict of str to (n,) array
        Size of the prediction error of every datum, by scheme.
    """

    name: str | None
    score: float
    parameters: float
    model: ModelT
    errors: dict[str, Floats]

    @classmethod
    def best_of(cls, name: str | None, scores: Selection, models: Sweep[ModelT]) -> Entrant[ModelT] | None:
        """Return what the criterion selects in a family; None if no model has a score."""
        if np.isnan(scores.maps[scores.criterion]).all():
            return None
        k, w = scores.place
        model = models.model(k, w)
        assert model is not None  # a model with a score is determined
        found = {of: by[k].errors for of, by in models.scores[w].items()}
        errors = {of: each for of, each in found.items() if each is not None}
        return cls(name, scores.score, scores.effective_parameters, model, errors)

    def may_replace(self, other: Entrant[ModelT], request: CriteriaRequest) -> bool:
        """Whether this simpler model predicts no worse: the mean difference is within half its standard error.

        Both by the criterion and by leave-one-out. A criterion without a scheme has scores alone.
        """
        if self.parameters > (1 + ROUNDING) * other.parameters:
            return self.score < other.score
        names = {request.listed[0], "CMPRESS"} & self.errors.keys() & other.errors.keys()
        if request.listed[0] not in names:
            return self.score <= (1 + ROUNDING) * other.score
        means = (_mean_and_error(self.errors[of], other.errors[of], request) for of in names)
        return all(mean <= 0.5 * error + ROUNDING for mean, error in means)

    def surely_better_than(self, other: Entrant[ModelT], request: CriteriaRequest) -> bool:
        """Whether this model predicts better by more than the standard error of the mean difference."""
        name = request.listed[0]
        if name not in self.errors or name not in other.errors:
            return False
        mean, error = _mean_and_error(self.errors[name], other.errors[name], request)
        return mean + error < 0


def _mean_and_error(new: Floats, old: Floats, request: CriteriaRequest) -> tuple[float, float]:
    """Weighted mean of differences of squared errors, (n,), and its standard error, in units of the largest."""
    largest = float(max(new.max(), old.max())) or 1.0
    differences = (new / largest) ** 2 - (old / largest) ** 2
    weights = request.data.weights
    each = differences if weights is None else differences * weights / weights.mean()
    return float(each.mean()), float(each.std() / math.sqrt(len(each)))


def plain_map(design: Callable[[Basis], Design[ModelT]], data: Data) -> Candidates[ModelT]:
    """Return the candidate that is affine, or a homography if the design has denominators."""
    three = np.array([3])
    return Candidates(ThinPlateSpline, design, three, 3, partial(farthest_order, data.points), 0.0)
