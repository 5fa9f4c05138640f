"""Wrong data, found while a model is selected: a start without any model, then rounds of selection and prediction.

Wrong data bend the model that is to find them, and make the criterion choose another one. So the search starts from
the neighbours of each datum alone (`agreeing`). Then a model is selected for the data that are kept, and all data are
judged by its predictions, those in the fit with their own neighbourhood held out (`find_wrong`). A datum is wrong if
its prediction error is large against the noise, and against the errors of the data around it: on rough ground, these
are as large. Nor is a depth wrong that two of its nearest data share: it is beside an edge, or on a small thing.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mexpress._validation import Floats, Integers
from mexpress.caching import cached_property
from mexpress.geometry import lengths_of
from mexpress.leastsquares.model import LeastSquares
from mexpress.models.expectation import FittedModel
from mexpress.schemes import Places
from mexpress.selection.data import Data, Matches, Samples
from mexpress.suspicion import (
    ROUNDING,
    UNSETTLED_SHARE,
    Suspects,
    SuspicionWarning,
    chi_square_quantile,
    deviation,
    studentised_lengths,
)

Mask = NDArray[np.bool_]

THRESHOLD = 6.0

FEWEST, FEWEST_SAMPLES = 8, 25
"""Fewer matches, or samples of a surface, have no verdict: planes through three of them leave too small a majority."""

_NEIGHBOURS = 24
_REACH = 40
"""A plane goes through 24 neighbours that are kept, of the 40 nearest data."""

_SIDES = 6
_TRIPLES = 30
_LEAST_AREA = 0.1
"""Triples of neighbours that span less, in units of their mean squared distance, give no plane."""

_START = 20.0
_START_ROUNDS = 4
"""The start leaves out errors beyond 20 times the median of those nearby: gross ones, which bend a model most."""

_COMPANIONS = 6
_SCENE = 20.0
"""A depth that two of its six nearest data share is no error but a small thing in the scene, unless it is beyond 20
times the spread of all depths, as placeholders are. Matches of one warp have no edges."""

_NEAR = 12
_QUARTILE = 0.75
"""Errors are compared with the upper quartile of those of the 12 nearest data."""

_EXPECTED = 3.0
"""Data of a surface are wrong only beyond three times the error that the model expects at their place."""

_ROUNDS = 5

_FEW, _SCATTERED = 0.35, 3.0
"""Data beyond a gap wider than the data before it, half of all at least, are wrong if they are at most 35 % and three
times as far from the next place as the others are: nothing speaks for them, and one of them moves the region and the
scale of all others. A second group of data, as dense as the first, is none."""


class Selected(Protocol):
    """What a search needs of a selection: its data, its fit, and its model."""

    @property
    def data(self) -> Any:
        """The data of the selection."""

    @property
    def _model(self) -> FittedModel:
        """The selected model."""

    def least_squares(self, weights: None = None, threads: int | None = None) -> LeastSquares:
        """Return the fit of the selected model."""


def find_wrong(
    data: Data,
    select: Callable[[Integers], Selected],
    threshold: float = THRESHOLD,
    radius: float = 0.0,
    seed: int = 0,
    threads: int | None = None,
) -> Suspects:
    """Find the data that a model selected without them, and their neighbours, contradict.

    Parameters
    ----------
    data : Matches or Samples
        Data whose weight is not 0.
    select : callable
        Returns the selection for some of the data, given their indices. Region, scale, control points and smoothing
        then come from data that are kept.
    threshold : float, default 6
        Data with larger scores are wrong.
    radius : float, default 0
        Data in the fit are predicted with all data within this distance held out: by default themselves, and those in
        the same place.
    seed : int, default 0
        Seed of the planes through neighbours.
    threads : int, optional
        Largest number of threads. The result does not depend on it.

    Returns
    -------
    Suspects
        The scores of all data: prediction errors divided by the standard deviation of the noise or, if that is larger,
        for data in the fit, by the upper quartile of the errors of the 12 nearest over that of noise. Wrong data are
        `Suspects.indices`. A `SuspicionWarning` is issued if they are doubtful.

    Notes
    -----
    A round costs one selection; there are at most five, and one or two as a rule. Errors of data in the fit are
    studentised. Those of other data are compared with the noise alone, so that nothing comes back because other wrong
    data are in the fit.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> from mexpress.selection.data import Samples
    >>> points = np.random.default_rng(0).uniform(0, 1, (200, 2))
    >>> depth = np.sin(3 * points[:, 0]) + np.random.default_rng(1).normal(0, 0.01, 200)
    >>> depth[[7, 30]], points[90] = 5.0, 1e3
    >>> found = find_wrong(Samples.of(points, depth), lambda some: mx.select_surface(points[some], depth[some]))
    >>> sorted(found.indices.tolist())
    [7, 30, 90]
    """
    if len(data.points) < (FEWEST if isinstance(data, Matches) else FEWEST_SAMPLES):
        return Suspects(np.zeros(len(data.points)), threshold, 0.0, 0.0, 0, True)
    around = Surroundings.of(data.points, threads)
    kept, steps = agreeing(data, around, seed)
    seen: list[Mask] = []
    for _ in range(_ROUNDS):
        seen.append(kept)
        some = np.flatnonzero(kept)
        selection = select(some)
        scores, sigma = _scores(data, some, selection, around, steps, radius, threads)
        scores[around.far] = np.inf
        kept = ~(scores > threshold)
        if any((kept == before).all() for before in seen):
            break
    settled = bool((kept != seen[-1]).mean() <= UNSETTLED_SHARE)
    if not isinstance(data, Matches):
        scores = _against_expectation(data, scores, around.far, selection, threshold)
        kept = ~(scores > threshold)
    spread = deviation(data.values[kept] if kept.any() else data.values)
    found = Suspects(scores, threshold, sigma, spread, len(seen), settled)
    if len(found.indices) and found.doubtful:
        warnings.warn(SuspicionWarning(found.doubt), stacklevel=2)
    return found


@dataclass(frozen=True, eq=False)
class Surroundings:
    """The nearest data of each datum, the nearest first, without itself.

    Parameters
    ----------
    points : (n, 2) array
        Positions of the data.
    nearest : (n, k) int64 array
        Indices of neighbours.

    Examples
    --------
    >>> Surroundings.of(np.array([[0.0, 0.0], [1.0, 0.0], [3.0, 0.0]]), None).nearest
    array([[1, 2],
           [0, 2],
           [1, 0]])
    """

    points: Floats
    nearest: Integers

    @classmethod
    def of(cls, points: Floats, threads: int | None) -> Surroundings:
        """Search the neighbours of all points."""
        n = len(points)
        k = min(_REACH + 1, n)
        near = Places(points, threads).neighbours(k)
        distances = np.hypot(*np.moveaxis(points[near] - points[:, None], 2, 0))
        distances[near == np.arange(n)[:, None]] = -1.0
        order = np.argsort(distances, axis=1, kind="stable")
        return cls(points, np.take_along_axis(near, order, axis=1)[:, 1:])

    @cached_property
    def far(self) -> Mask:
        """Which data are `beyond_gaps`, (n,)."""
        return beyond_gaps(self.points)

    def kept(self, kept: Mask, most: int) -> tuple[Integers, Mask]:
        """Return the nearest kept data of each datum, (n, most), and which of these are kept at all."""
        order = np.argsort(~kept[self.nearest], axis=1, kind="stable")[:, :most]
        chosen = np.take_along_axis(self.nearest, order, axis=1)
        return chosen, kept[chosen]

    def quantile(self, errors: Floats, kept: Mask, share: float, most: int) -> Floats:
        """Return a quantile of the errors of the nearest kept data of each datum; 0 where there are none."""
        chosen, valid = self.kept(kept, most)
        nearby = np.sort(np.where(valid, errors[chosen], np.inf), axis=1)
        last = np.maximum(np.ceil(share * valid.sum(axis=1)).astype(np.int64) - 1, 0)
        return np.where(valid.any(axis=1), nearby[np.arange(len(nearby)), last], 0.0)

    def steps(self, values: Floats, slopes: Floats) -> Floats:
        """Return the second smallest of the differences of each datum from its six nearest, less the slope there."""
        near = self.nearest[:, :_COMPANIONS]
        rises = values[near] - values[:, None] - (self.points[near] - self.points[:, None]) @ slopes
        return np.asarray(np.sort(lengths_of(rises), axis=1)[:, 1])


def agreeing(data: Data, around: Surroundings, seed: int) -> tuple[Mask, Floats]:
    """Return which data agree with their neighbours, and the error of each against two of its companions, (n,).

    A datum agrees with a plane through its neighbours on one side, beside an edge, or with two of the six nearest data.
    Errors are compared with the median of those nearby, and gross errors leave in turn, so that they do not hide each
    other.

    Examples
    --------
    >>> from mexpress.selection.data import Samples
    >>> points = np.random.default_rng(0).uniform(0, 1, (100, 2))
    >>> depth = points[:, 0] + np.where(points[:, 1] > 0.5, 9.0, 0.0)
    >>> depth[[4, 60]] = 30.0
    >>> kept, _ = agreeing(Samples.of(points, depth), Surroundings.of(points, None), 0)
    >>> np.flatnonzero(~kept)
    array([ 4, 60])
    """
    values = data.values.reshape(len(data.points), -1)
    distances = lengths_of(values - np.median(values, axis=0))
    alone = isinstance(data, Matches) | (distances > _SCENE * np.median(distances))
    near = ~around.far
    alone |= around.far
    kept = near
    for _ in range(_START_ROUNDS):
        errors, slopes = _plane_errors(values, around, kept, np.random.default_rng(seed))
        steps = np.where(alone, np.inf, around.steps(values, slopes))
        errors = np.minimum(errors, steps)
        level = max(float(np.median(errors[kept])), ROUNDING * deviation(values[kept]))
        now = near & (errors <= _START * np.maximum(around.quantile(errors, kept, 0.5, _NEIGHBOURS), level))
        if (now == kept).all() or 2 * now.sum() < len(now):
            break
        kept = now
    return kept, steps / np.sqrt(values.shape[1])


def beyond_gaps(points: Floats) -> Mask:
    """Return which points are few, far from each other, and beyond a gap in x or y wider than the data before it.

    Examples
    --------
    >>> beyond_gaps(np.array([[0, 0], [1, 2], [2, 1], [3, 4], [4, 3], [60, 2.0]]))
    array([False, False, False, False, False,  True])
    """
    beyond = np.zeros(len(points), dtype=np.bool_)
    half = (len(points) + 1) // 2
    for x in points.T:
        order = np.argsort(x, kind="stable")
        ordered = x[order]
        first = int((ordered[half - 1 :] - ordered[: len(x) - half + 1]).argmin())
        low, high = ordered[first], ordered[first + half - 1]
        steps = np.diff(ordered)
        gaps_right = np.flatnonzero((steps > (ordered[:-1] - low)) & (ordered[:-1] >= high))
        gaps_left = np.flatnonzero((steps > (high - ordered[1:])) & (ordered[1:] <= low))
        if gaps_right.size:
            beyond[order[gaps_right[0] + 1 :]] = True
        if gaps_left.size:
            beyond[order[: gaps_left[-1] + 1]] = True
    far = beyond.any() and beyond.mean() <= _FEW and _scattered(points, beyond)
    return beyond if far else np.zeros_like(beyond)


def _scattered(points: Floats, some: Mask) -> bool:
    """Whether the places of some points are much farther from the next place than those of the others are.

    Placeholders share their place, which is one.
    """
    places, first = np.unique(points, axis=0, return_index=True)
    apart = Places(places).spacing()
    return bool(np.median(apart[some[first]]) > _SCATTERED * np.median(apart[~some[first]]))


def _plane_errors(
    values: Floats, around: Surroundings, kept: Mask, random: np.random.Generator
) -> tuple[Floats, Floats]:
    """Smallest error of planes through the kept neighbours on a side, (n,), and the slopes of those on all sides.

    A plane goes through three neighbours, and has the least median of the errors of the neighbours on its side.
    """
    near, valid = around.kept(kept, _NEIGHBOURS)
    n, k = near.shape
    some: Mask = np.asarray(valid.any(axis=1))
    offsets = around.points[near] - around.points[:, None]
    size = np.sqrt((offsets**2).sum(axis=2).mean(axis=1, where=np.asarray(valid | ~some[:, None])))
    size = np.where(size > 0, size, 1.0)[:, None, None]
    offsets /= size
    rises = values[near] - values[:, None]
    angles = 2 * np.pi * np.arange(_SIDES) / _SIDES
    half_discs = [np.asarray(valid & (offsets @ (np.cos(a), np.sin(a)) >= -1e-9)) for a in angles]
    sides = [valid, *(side & (side.sum(axis=1) > _NEIGHBOURS // 4)[:, None] for side in half_discs)]
    best = np.full((len(sides), n), np.inf)
    levels = np.full((len(sides), n, values.shape[1]), np.inf)
    slopes = np.zeros((n, 2, values.shape[1]))
    ordered = np.sort(np.where(valid[:, :, None], rises, np.inf), axis=1)
    levels[0] = ordered[np.arange(n), np.maximum(valid.sum(axis=1) - 1, 0) // 2]  # for neighbours on a line
    for triple in (random.choice(k, 3, replace=False) for _ in range(_TRIPLES)):
        plane, spans = _planes(offsets[:, triple], rises[:, triple], np.all(valid[:, triple], axis=1))
        misses = lengths_of(rises - plane[:, 0, None] - offsets @ plane[:, 1:])
        for s, side in enumerate(sides):
            middle = _median_of(misses, side)
            better = spans & (middle < best[s])
            best[s, better], levels[s, better] = middle[better], plane[better, 0]
            if s == 0:
                slopes[better] = plane[better, 1:]
    return np.asarray(lengths_of(levels).min(axis=0)), slopes / size


def _planes(corners: Floats, rises: Floats, usable: Mask) -> tuple[Floats, Mask]:
    """Planes through three neighbours each, (n, 3, d), as seen from the datum; and where these span enough area."""
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    spans = usable & (np.abs(area) > _LEAST_AREA)
    safe = np.where(spans, area, 1.0)[:, None]
    up, vp = rises[:, 1] - rises[:, 0], rises[:, 2] - rises[:, 0]
    along_x = (v[:, 1:] * up - u[:, 1:] * vp) / safe
    along_y = (u[:, :1] * vp - v[:, :1] * up) / safe
    height = rises[:, 0] - corners[:, 0, :1] * along_x - corners[:, 0, 1:] * along_y
    return np.stack([height, along_x, along_y], axis=1), spans


def _median_of(numbers: Floats, some: Mask) -> Floats:
    """Median of some numbers in each row, counting the three through which a plane goes as none."""
    ordered = np.sort(np.where(some, numbers, np.inf), axis=1)
    middle = np.minimum((some.sum(axis=1) + 3) // 2, numbers.shape[1] - 1)
    return np.asarray(ordered[np.arange(len(ordered)), middle])


def _scores(
    data: Data,
    some: Integers,
    selection: Selected,
    around: Surroundings,
    steps: Floats,
    radius: float,
    threads: int | None,
) -> tuple[Floats, float]:
    """Scores of all data by a selection for some of them, and sigma; `steps` are their errors against companions."""
    n = len(data.points)
    fit, scheme = selection.least_squares(threads=threads), Places(data.points[some], threads).within(radius)
    weights = np.ones(len(some)) if selection.data.weights is None else selection.data.weights
    lengths, freedom = studentised_lengths(fit, scheme, weights, threads)
    kept = np.zeros(n, dtype=np.bool_)
    kept[some] = True
    errors = np.empty(n)
    errors[some] = lengths / np.sqrt(freedom)
    if not kept.all():
        away = (selection._model(data.points[~kept]) - data.values[~kept]).reshape(n - len(some), -1)
        # NaN is beyond the horizon of a warp.
        errors[~kept] = np.nan_to_num(lengths_of(away) / np.sqrt(away.shape[1]), nan=np.inf, posinf=np.inf)
    known = kept & np.isfinite(errors)
    if not known.any():  # nothing tells the noise, so nothing is wrong
        return np.full(n, np.nan), np.nan
    per_row = int(freedom[0])
    noise = float(np.median(errors[known])) / _noise(0.5, per_row)
    sigma = max(noise, ROUNDING * deviation(data.values[some]))
    nearby = around.quantile(errors, known, _QUARTILE, _NEAR) / _noise(_QUARTILE, per_row)
    scale = np.where(kept, np.maximum(nearby, sigma), sigma) if sigma else 1.0
    return np.minimum(errors, steps) / scale, sigma


def _against_expectation(
    data: Samples, scores: Floats, far: Mask, selection: Selected, threshold: float
) -> Floats:
    """Scores of which those above the threshold are at least errors in units of a third of what is expected there.

    Ground is rough in places, and at its borders the prediction is vague, so the noise alone makes too much of an
    error. Points beyond a gap have no expectation.
    """
    doubted = np.flatnonzero((scores > threshold) & ~far)
    if not len(doubted):
        return scores
    points, values = data.points[doubted], data.values[doubted]
    away = lengths_of((selection._model(points) - values).reshape(len(doubted), -1))
    lenient = scores.copy()
    # At an expectation of zero, of a model without noise, nothing is more lenient.
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.nan_to_num(away / selection._model.error(points), nan=np.inf, posinf=np.inf)
    lenient[doubted] = np.minimum(scores[doubted], threshold / _EXPECTED * relative)
    return lenient


def _noise(share: float, freedom: int) -> float:
    """Quantile of the root mean square of so many independent measurements with noise of variance one."""
    return float(np.sqrt(chi_square_quantile(share, freedom) / freedom))
