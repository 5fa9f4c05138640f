"""Scores of all models by all criteria: numbers of control points by weights of the bending energy.

Designs are scored one after another; for one design, all weights cost little more than one weight. Nested designs are
scored at once, for each weight.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import chain, repeat
from typing import Generic, Self

import numpy as np

from mexpress._validation import Floats, Integers
from mexpress.criteria import Score, Scorer
from mexpress.leastsquares.nested import Nested
from mexpress.leastsquares.penalty_path import FittedAt, PenaltyPath
from mexpress.models import Design, ModelT
from mexpress.selection.selection import Selection

OnStep = Callable[[], None]


@dataclass(frozen=True, eq=False, repr=False)
class Sweep(Generic[ModelT]):
    """Scores of k counts and w weights: the fields of a `Selection` except the criterion, and the models.

    Attributes
    ----------
    counts, maps, undefined, weights, parameters, open
        See `Selection`.
    model : callable
        Returns the model at the positions of a count and a weight, or None if it is not determined.
    scores : list of dict of str to list of Score
        Scores by weight, criterion and count.
    """

    counts: Integers
    maps: dict[str, Floats]
    undefined: dict[str, dict[int, Integers]]
    weights: Floats
    parameters: Floats
    open: dict[int, int]
    model: Callable[[int, int], ModelT | None]
    scores: list[dict[str, list[Score]]]

    @classmethod
    def of(
        cls,
        counts: Integers,
        weights: Floats,
        scores: list[dict[str, list[Score]]],
        parameters: Floats,
        lacks: Integers,
        model: Callable[[int, int], ModelT | None],
    ) -> Self:
        """Arrange scores by weight, criterion and count, and the unknowns that the data alone leave open by count."""
        maps = {name: np.array([[s.value for s in by[name]] for by in scores]).T for name in scores[0]}
        undefined = {
            name: {
                count: score.undefined
                for count, row, score in zip(counts.tolist(), maps[name], scores[-1][name], strict=True)
                if score.undefined.size and np.isnan(row).all()
            }
            for name in maps
        }
        smoothed = lacks > 0 if weights[-1] > 0 else np.zeros(len(lacks), dtype=np.bool_)
        return cls(
            counts,
            maps,
            {name: data for name, data in undefined.items() if data},
            weights,
            parameters,
            dict(zip(counts[smoothed].tolist(), lacks[smoothed].tolist(), strict=True)),
            model,
            scores,
        )

    def best_models(self, selection: Selection) -> dict[int, ModelT]:
        """Return the model of every count that the data determine, at the criterion's best weight for the count."""
        models = {}
        for k, count in enumerate(self.counts.tolist()):
            w = selection.best_weight(k)
            model = self.model(k, -1 if w is None else w)
            if model is not None:
                models[count] = model
        return models

    def selection(self, criterion: str, slack: float) -> Selection:
        """Let a criterion select."""
        shared = {name: value for name, value in vars(self).items() if name not in {"model", "scores"}}
        return Selection(criterion, **shared, slack=slack)


def sweep_designs(
    designs: Iterable[Design[ModelT]], weights: Floats, scorer: Scorer, threads: int | None, on_step: OnStep
) -> Sweep[ModelT]:
    """Score designs of increasing counts; `on_step` is called after each weight.

    Examples
    --------
    >>> from mexpress.criteria import Scorer
    >>> from mexpress.liftings import ThinPlateSpline
    >>> from mexpress.models import CardinalBasis
    >>> from mexpress.selection.data import Samples
    >>> points = np.random.default_rng(0).uniform(size=(30, 2))
    >>> data = Samples.of(points, points[:, 0] ** 2)
    >>> designs = [data.design(CardinalBasis(ThinPlateSpline(points[:k]))) for k in (4, 9)]
    >>> sweep_designs(designs, np.zeros(1), Scorer.of(["FIT"], points), None, lambda: None).maps["FIT"].round(3)
    array([[0.049],
           [0.028]])
    """
    counts, lacks = [], []
    parameters: list[list[float]] = []
    scores: list[dict[str, list[Score]]] = [{name: [] for name in scorer.criteria} for _ in weights]
    models: list[list[ModelT | None]] = []
    for design in designs:
        fits, rank = _fits(design, weights, threads)
        counts.append(design.count)
        lacks.append(design.A.shape[1] - rank)
        parameters.append([])
        models.append([])
        for by_name, fit, weight in zip(scores, fits, weights.tolist(), strict=True):
            x = fit.coefficients
            parameters[-1].append(_parameters(fit))
            models[-1].append(None if x is None else design.model(x, smoothing=weight))
            for name, score in scorer.scores(fit.model, threads).items():
                by_name[name].append(score)
            on_step()
    return Sweep.of(
        np.array(counts), weights, scores, np.array(parameters), np.array(lacks), lambda k, w: models[k][w]
    )


def sweep_nested(
    design: Design[ModelT],
    counts: Integers,
    weights: Floats,
    scorer: Scorer,
    threads: int | None,
    on_step: OnStep,
) -> Sweep[ModelT]:
    """Score nested designs of increasing counts; `mexpress.leastsquares.nested.steps` counts the calls of `on_step`."""
    sizes = np.array([design.columns(count) for count in counts.tolist()])
    bending = design.bending()
    parameters = np.full((len(counts), len(weights)), math.nan)
    scores, solutions = [], []
    ranks: Integers | None = None
    for w, weight in enumerate(weights.tolist()):
        nested = _nested(design, bending, weight, threads)
        scores.append(scorer.curves(nested, sizes, threads, on_step))
        fits = nested.fits(sizes, threads)
        full = fits.rank == sizes
        parameters[full, w] = nested.n_responses * fits.parameters[full]
        solutions.append(
            [nested.coefficients(int(size)) if ok else None for size, ok in zip(sizes, full, strict=True)]
        )
        ranks = fits.rank if weight == 0 else ranks
    if ranks is None:
        ranks = _nested(design, bending, 0.0, threads).fits(sizes, threads).rank

    def model(k: int, w: int) -> ModelT | None:
        x = solutions[w][k]
        return None if x is None else design.model(x, int(counts[k]), float(weights[w]))

    return Sweep.of(counts, weights, scores, parameters, sizes - ranks, model)


def _nested(design: Design[ModelT], bending: Floats, weight: float, threads: int | None) -> Nested:
    rows = math.sqrt(weight) * bending if weight else None
    return Nested(design.A, design.b, design.coupling, design.weights, rows, threads=threads)


def _fits(design: Design[ModelT], weights: Floats, threads: int | None) -> tuple[Iterable[FittedAt], int]:
    """Fits of one design at all weights, and its rank without bending energy.

    The fits are made one by one: each is as large as the design, so all at once would take many times its memory.
    """
    bending = design.bending()
    if not (len(bending) and weights[-1] > 0):
        plain = design.fit(threads=threads)
        return repeat(FittedAt.of(plain), len(weights)), plain.rank
    path = PenaltyPath(design.A, design.b, design.coupling, bending, design.weights, threads)
    stiff = (path.fit(weight, threads) for weight in weights.tolist() if weight > 0)
    if weights[0] > 0:
        return stiff, path.rank
    plain = design.fit(threads=threads)
    return chain([FittedAt.of(plain)] if weights[0] == 0 else [], stiff), plain.rank


def _parameters(fit: FittedAt) -> float:
    if fit.coefficients is None:
        return math.nan
    responses = fit.model.residuals.size // len(fit.model.residuals)
    return responses * float(fit.model.leverage.sum())
