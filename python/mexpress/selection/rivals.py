"""The models beside the grid of counts and weights, and which of all is selected.

With automatic smoothing, plain maps are candidates too: an affine map and a homography, or a plane. They have no
control points to place, and a dozen matches want no more. Where queries are far from the data, piecewise affine models
are another one: they bridge gaps without the waves of a spline, but they are worse everywhere else, so they have to
be better by more than chance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Generic

import numpy as np

from mexpress._validation import Floats
from mexpress.leastsquares.model import cross_validate_all, datum_of_row
from mexpress.liftings import ThinPlateSpline
from mexpress.models import Basis, CardinalBasis, Design, ModelT
from mexpress.placement import farthest_order
from mexpress.selection.candidates import Candidates, CriteriaRequest
from mexpress.selection.data import Data
from mexpress.selection.selection import Selection, strongest
from mexpress.selection.sweep import Sweep

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
    label: str | None,
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
    label : str or None
        Name of the progress that is shown, if any.
    """
    own, sweep, ordered = grid.select(request, label)
    families = {name: candidates.select(request, None)[:2] for name, candidates in plain.items()}
    rivals = {name: _comparable(scores) for name, (scores, _) in families.items()}
    entrants = [own, *rivals.values()]
    best = strongest([entrant for entrant in entrants if own.criterion in entrant.maps], own.criterion)
    if best is None:
        own.place  # noqa: B018 - it says why there is none
        raise AssertionError("a selection without a score has no place")
    rival = next((name for name, scores in rivals.items() if scores is best[0]), None)
    winner, models = (grid, sweep) if rival is None else (plain[rival], families[rival][1])
    model = models.model(*best[1:])
    if bridge is not None:
        scores, models, _ = bridge.select(request, None)
        rivals[PIECEWISE_AFFINE] = _comparable(scores)
        at = strongest([scores], own.criterion)
        other = None if at is None else models.model(*at[1:])
        if model is not None and other is not None:
            old, new = _squares(winner, model, request), _squares(bridge, other, request)
            if better_by_more_than_chance(old, new, request.data.weights):
                rival, model = PIECEWISE_AFFINE, other
    assert model is not None  # a model with a score is determined
    return Outcome(replace(own, rivals=rivals, rival=rival), sweep, ordered, model)


def plain_map(design: Callable[[Basis], Design[ModelT]], data: Data) -> Candidates[ModelT]:
    """Return the candidate that is affine, or a homography if the design has denominators."""
    three = np.array([3])
    return Candidates(ThinPlateSpline, design, three, 3, partial(farthest_order, data.points), 0.0)


def better_by_more_than_chance(old: Floats, new: Floats, weights: Floats | None = None) -> bool:
    """Whether the mean of new squares, (n,), is below that of old ones by more than its standard error.

    Examples
    --------
    >>> old = np.array([4.0, 5.0, 6.0, 5.0])
    >>> better_by_more_than_chance(old, old - 1), better_by_more_than_chance(old, old - [9, -4, -4, 4])
    (True, False)
    """
    difference = new - old if weights is None else (new - old) * weights / weights.mean()
    return bool(difference.mean() + difference.std() / math.sqrt(len(difference)) < 0)


def _squares(candidates: Candidates[ModelT], model: ModelT, request: CriteriaRequest) -> Floats:
    """Squared prediction error of every datum, held out as the criterion says, (n,)."""
    name, scorer = request.listed
    fit = candidates.design(CardinalBasis(model.lifting)).fit(model.smoothing, request.threads)
    cv = cross_validate_all(fit, {name: scorer.schemes[name]}, request.threads)[name]
    squares = (cv.residuals.reshape(len(cv.rows), -1) ** 2).sum(axis=1)
    return np.asarray(np.bincount(datum_of_row(fit)[cv.rows], squares, fit.n_data), dtype=np.float64)


def _comparable(scores: Selection) -> Selection:
    """Leave out PRESS, which averages over rows: not every family has as many."""
    return replace(scores, maps={name: of for name, of in scores.maps.items() if name != "PRESS"})
