"""Every criterion of every model: numbers of control points by weights of the bending energy.

Designs of any control points are judged one by one, and each at all weights for little more than one. Nested designs
are judged all at once, for each weight.

Examples
--------
See `mexpress.select_warp`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import chain, repeat
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from mexpress._validation import Floats, Integers
from mexpress.criteria import Judge, Score
from mexpress.leastsquares.model import LeastSquares
from mexpress.leastsquares.nested import Nested
from mexpress.leastsquares.penalty_path import Fitted, Spectrum
from mexpress.models import Design, NestedDesign

__all__ = ["Sweep", "one_by_one", "penalised", "together"]

Model = TypeVar("Model")

Step = Callable[[], None]


@dataclass(frozen=True, eq=False, repr=False)
class Sweep(Generic[Model]):
    """What a sweep over k counts and w weights finds.

    Attributes
    ----------
    counts : (k,) int64 array
        Numbers of control points, increasing.
    weights : (w,) array
        Weights of the bending energy, increasing.
    scores : dict of str to list of list of Score
        By criterion, count and weight.
    parameters : (k, w) array
        Effective numbers of parameters, trace(H) times the number of responses; NaN where the model is not determined.
    ranks : (k,) int64 array
        How many of the unknowns the data alone determine, without the bending energy.
    unknowns : (k,) int64 array
        How many there are.
    fitted : callable
        The model of a count and a weight, by their positions, or None if it is not determined.

    Examples
    --------
    See `mexpress.select_warp`.
    """

    counts: Integers
    weights: Floats
    scores: dict[str, list[list[Score]]]
    parameters: Floats
    ranks: Integers
    unknowns: Integers
    fitted: Callable[[int, int], Model | None]


def penalised(
    design: Design[Model],
    smoothing: float,
    weights: ArrayLike | None = None,
    threads: int | None = None,
) -> LeastSquares:
    """Return the least-squares problem of a design with a weight of its bending energy, and weights of the data.

    Examples
    --------
    >>> from mexpress.models import surface_design
    >>> from mexpress.liftings import ThinPlateSpline
    >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
    >>> penalised(surface_design(ThinPlateSpline(square), square, [0, 2, 2, 4]), 1.0).rank
    4
    """
    rows = math.sqrt(smoothing) * design.bending() if smoothing else None
    return LeastSquares(design.A, design.b, design.coupling, weights, rows, threads=threads)


def one_by_one(
    designs: Iterable[Design[Model]], weights: Floats, judge: Judge, threads: int | None, step: Step
) -> Sweep[Model]:
    """Judge designs of increasing counts; `step` is called after each weight.

    Examples
    --------
    See `mexpress.select_warp`.
    """
    sizes: list[tuple[int, int, int]] = []
    parameters: list[list[float]] = []
    found: list[list[dict[str, Score]]] = []
    models: list[list[Model | None]] = []
    for design in designs:
        fits, rank = _fits(design, weights, threads)
        sizes.append((design.count, rank, design.A.shape[1]))
        for row in (parameters, found, models):
            row.append([])
        for fit, weight in zip(fits, weights.tolist(), strict=True):
            parameters[-1].append(_parameters(fit))
            found[-1].append(judge.scores(fit.model, threads))
            models[-1].append(None if fit.coefficients is None else design.model(fit.coefficients, weight))
            step()
    scores = {name: [[by_name[name] for by_name in row] for row in found] for name in judge.criteria}
    counts, ranks, unknowns = np.array(sizes, dtype=np.int64).T
    return Sweep(counts, weights, scores, np.array(parameters), ranks, unknowns, lambda k, w: models[k][w])


def _fits(design: Design[Model], weights: Floats, threads: int | None) -> tuple[Iterable[Fitted], int]:
    """Fits of one design at all weights, made as they are asked for, and its rank without bending energy.

    Each is as large as the design, so that all of them at once would take many times its memory.
    """
    problem, bending = (design.A, design.b, design.coupling), design.bending()
    if not (len(bending) and weights[-1] > 0):
        plain = LeastSquares(*problem, threads=threads)
        return repeat(Fitted.plain(plain), len(weights)), plain.rank
    spectrum = Spectrum(*problem, bending)
    stiff = (spectrum.at(weight, threads) for weight in weights.tolist() if weight > 0)
    if weights[0] > 0:
        return stiff, spectrum.rank
    plain = LeastSquares(*problem, threads=threads)
    return chain([Fitted.plain(plain)], stiff), plain.rank


def _parameters(fit: Fitted) -> float:
    if fit.coefficients is None:
        return math.nan
    responses = fit.model.residuals.size // len(fit.model.residuals)
    return responses * float(fit.model.leverage.sum())


def together(
    design: NestedDesign[Model],
    counts: Integers,
    weights: Floats,
    judge: Judge,
    threads: int | None,
    step: Step,
) -> Sweep[Model]:
    """Judge all leading parts of a nested design.

    For each weight, `step` is called as often as `mexpress.leastsquares.nested.steps` says.

    Examples
    --------
    See `mexpress.select_surface`.
    """
    sizes = np.array([design.columns(int(count)) for count in counts], dtype=np.int64)
    bending = design.bending()
    scores: dict[str, list[list[Score]]] = {name: [[] for _ in counts] for name in judge.criteria}
    parameters = np.empty((len(counts), len(weights)))
    solutions: list[list[Floats | None]] = [[] for _ in counts]
    ranks: Integers | None = None
    for w, weight in enumerate(weights):
        stiff = np.sqrt(weight) * bending if weight else None
        nested = Nested(design.A, design.b, design.coupling, penalty=stiff, threads=threads)
        fits = nested.fits(sizes, threads)
        for name, curve in judge.curves(nested, sizes, threads, step).items():
            for row, score in zip(scores[name], curve, strict=True):
                row.append(score)
        full = fits.rank == sizes
        parameters[:, w] = np.where(full, nested.n_responses * fits.parameters, np.nan)
        for k, size in enumerate(sizes):
            solutions[k].append(nested.coefficients(int(size)) if full[k] else None)
        ranks = fits.rank if weight == 0 else ranks
    if ranks is None:
        ranks = Nested(design.A, design.b, design.coupling, threads=threads).fits(sizes, threads).rank

    def fitted(k: int, w: int) -> Model | None:
        x = solutions[k][w]
        return None if x is None else design.model(x, int(counts[k]), float(weights[w]))

    return Sweep(np.asarray(counts), weights, scores, parameters, ranks, sizes, fitted)
