"""Every criterion of every model: numbers of control points by weights of the bending energy.

Designs of any control points are judged one after another; for one design, all weights cost little more than one.
Nested designs are judged all at once, for each weight.

Examples
--------
>>> import mexpress as mx
>>> import numpy as np
>>> from mexpress.criteria import Scorer
>>> from mexpress.liftings import ThinPlateSpline
>>> from mexpress.models import CardinalBasis
>>> from mexpress.selection.data import Samples
>>> points = np.random.default_rng(0).uniform(size=(30, 2))
>>> data = Samples.of(points, points[:, 0] ** 2)
>>> designs = [data.design(CardinalBasis(ThinPlateSpline(points[:k]))) for k in (4, 9)]
>>> sweep_designs(designs, np.zeros(1), Scorer.of(["FIT"], points), None, lambda: None).scores["FIT"].round(3)
array([[0.049],
       [0.028]])
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import chain, repeat
from typing import Generic

import numpy as np

from mexpress._validation import Floats, Integers
from mexpress.criteria import Score, Scorer
from mexpress.leastsquares.nested import Nested
from mexpress.leastsquares.penalty_path import FittedAt, PenaltyPath
from mexpress.models import Design, ModelT

__all__ = ["Sweep", "sweep_designs", "sweep_nested"]

OnStep = Callable[[], None]


@dataclass(frozen=True, eq=False, repr=False)
class Sweep(Generic[ModelT]):
    """What a sweep over k counts and w weights says.

    Attributes
    ----------
    counts : (k,) int64 array
        Numbers of control points, increasing.
    weights : (w,) array
        Weights of the bending energy, increasing.
    scores : dict of str to (k, w) array
        By criterion, in the responses' unit; NaN where undefined.
    undefined : dict of str to list of int64 array
        By criterion and count, the data that cannot be predicted at the largest weight.
    parameters : (k, w) array
        Effective numbers of parameters, trace(H) times the number of responses; NaN where the model is not determined.
    ranks : (k,) int64 array
        How many of the unknowns the data alone determine, without the bending energy.
    unknowns : (k,) int64 array
        How many there are.
    model : callable
        The model of a count and a weight, by their positions, or None if it is not determined.
    """

    counts: Integers
    weights: Floats
    scores: dict[str, Floats]
    undefined: dict[str, list[Integers]]
    parameters: Floats
    ranks: Integers
    unknowns: Integers
    model: Callable[[int, int], ModelT | None]


def sweep_designs(
    designs: Iterable[Design[ModelT]], weights: Floats, scorer: Scorer, threads: int | None, on_step: OnStep
) -> Sweep[ModelT]:
    """Judge designs of increasing counts; `on_step` is called after each weight."""
    sizes: list[tuple[int, int, int]] = []
    parameters: list[list[float]] = []
    scores: list[list[dict[str, Score]]] = []
    models: list[list[ModelT | None]] = []
    for design in designs:
        fits, rank = _fits(design, weights, threads)
        sizes.append((design.count, rank, design.A.shape[1]))
        for rows in (parameters, scores, models):
            rows.append([])
        for fit, weight in zip(fits, weights.tolist(), strict=True):
            x = fit.coefficients
            parameters[-1].append(_parameters(fit))
            scores[-1].append(scorer.scores(fit.model, threads))
            models[-1].append(None if x is None else design.model(x, smoothing=weight))
            on_step()
    counts, ranks, unknowns = np.array(sizes, dtype=np.int64).T
    return Sweep(
        counts,
        weights,
        {name: np.array([[row[name].value for row in rows] for rows in scores]) for name in scorer.criteria},
        {name: [rows[-1][name].undefined for rows in scores] for name in scorer.criteria},
        np.array(parameters),
        ranks,
        unknowns,
        lambda k, w: models[k][w],
    )


def sweep_nested(
    design: Design[ModelT],
    counts: Integers,
    weights: Floats,
    scorer: Scorer,
    threads: int | None,
    on_step: OnStep,
) -> Sweep[ModelT]:
    """Judge nested designs of increasing counts.

    For each weight, `on_step` is called as often as `mexpress.leastsquares.nested.steps` says.
    """
    sizes = np.array([design.columns(count) for count in counts.tolist()])
    bending = design.bending()
    shape = len(counts), len(weights)
    scores = {name: np.empty(shape) for name in scorer.criteria}
    undefined: dict[str, list[Integers]] = {}
    parameters = np.full(shape, math.nan)
    solutions: list[list[Floats | None]] = [[] for _ in sizes]
    ranks: Integers | None = None
    for w, weight in enumerate(weights.tolist()):
        nested = _nested(design, bending, weight, threads)
        for name, curve in scorer.curves(nested, sizes, threads, on_step).items():
            scores[name][:, w] = [score.value for score in curve]
            undefined[name] = [score.undefined for score in curve]
        fits = nested.fits(sizes, threads)
        full = fits.rank == sizes
        parameters[full, w] = nested.n_responses * fits.parameters[full]
        for k, size in enumerate(sizes.tolist()):
            solutions[k].append(nested.coefficients(size) if full[k] else None)
        ranks = fits.rank if weight == 0 else ranks
    if ranks is None:
        ranks = _nested(design, bending, 0.0, threads).fits(sizes, threads).rank

    def model(k: int, w: int) -> ModelT | None:
        x = solutions[k][w]
        return None if x is None else design.model(x, int(counts[k]), float(weights[w]))

    return Sweep(counts, weights, scores, undefined, parameters, ranks, sizes, model)


def _nested(design: Design[ModelT], bending: Floats, weight: float, threads: int | None) -> Nested:
    rows = math.sqrt(weight) * bending if weight else None
    return Nested(design.A, design.b, design.coupling, design.weights, rows, threads=threads)


def _fits(design: Design[ModelT], weights: Floats, threads: int | None) -> tuple[Iterable[FittedAt], int]:
    """Fits of one design at all weights, made as they are asked for, and its rank without bending energy.

    Each is as large as the design, so that all of them at once would take many times its memory.
    """
    bending = design.bending()
    if not (len(bending) and weights[-1] > 0):
        plain = design.fit(threads=threads)
        return repeat(FittedAt.of(plain), len(weights)), plain.rank
    if design.weights is None:
        path = PenaltyPath(design.A, design.b, design.coupling, bending)
        stiff = (path.fit(weight, threads) for weight in weights.tolist() if weight > 0)
        if weights[0] > 0:
            return stiff, path.rank
    else:
        stiff = (FittedAt.of(design.fit(weight, threads)) for weight in weights.tolist() if weight > 0)
    plain = design.fit(threads=threads)
    return chain([FittedAt.of(plain)] if weights[0] == 0 else [], stiff), plain.rank


def _parameters(fit: FittedAt) -> float:
    if fit.coefficients is None:
        return math.nan
    responses = fit.model.residuals.size // len(fit.model.residuals)
    return responses * float(fit.model.leverage.sum())
