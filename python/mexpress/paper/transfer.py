"""A problem's warps with more and more control points: every criterion, and how well each warp transfers the rest.

Examples
--------
>>> from mexpress.paper.two_views import Simulated
>>> judged = trial(Simulated("flat", "perspective").draw(51, seed=0), True, range(3, 8), criteria=["ER10"])
>>> bool(judged.jaccard[0] > 0.99), bool(judged.transfer[0] < 2)
(True, True)
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from mexpress._validation import Floats
from mexpress.models.warp import Warp
from mexpress.paper import published
from mexpress.paper.contours import Mask, jaccard, rasterised, transferred
from mexpress.paper.two_views import Problem
from mexpress.placement import lattice
from mexpress.selection import WarpSelection, select_warp

CRITERIA = ("FIT", *published.CRITERIA)
"""Of the paper's tables."""

MEASURES = ("JACCARD", "TRANSFER", "LOST", "FOLDED", "VANISHING")
"""What a `Trial` adds to the criteria, under the names that files have."""

_SAMPLES = 1000
"""Points of the region of the matches where a warp may fold or vanish."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Criteria by number of control points, beside what they do not see; NaN where unknown.

    Parameters
    ----------
    problem : Problem
        What was fitted.
    selection : WarpSelection
        The warps and the criteria, for k numbers of control points.
    jaccard : (k,) array
        Jaccard index of the transferred contour; 0 where it is lost.
    transfer : (k,) array
        Root mean square distance, in pixels, of unseen points from where they should be mapped to; infinite where
        the denominator vanishes at one.
    lost : (k,) array of bool
        Where the denominator vanishes on the contour, so that nothing is transferred.
    folded, vanishing : (k,) array
        Share of the region of the matches where the warp folds, and where its denominator vanishes.
    """

    problem: Problem
    selection: WarpSelection
    jaccard: Floats
    transfer: Floats
    lost: Mask
    folded: Floats
    vanishing: Floats

    def measures(self) -> dict[str, Floats]:
        """Return the arrays as numbers, by the names in `MEASURES`.

        Examples
        --------
        >>> from mexpress.paper.two_views import Simulated
        >>> problem = Simulated("flat", "affine").draw(51, seed=0)
        >>> list(trial(problem, False, [3], criteria=["FIT"]).measures())
        ['JACCARD', 'TRANSFER', 'LOST', 'FOLDED', 'VANISHING']
        """
        arrays = (self.jaccard, self.transfer, self.lost.astype(np.float64), self.folded, self.vanishing)
        return dict(zip(MEASURES, arrays, strict=True))


def trial(
    problem: Problem,
    fractional: bool,
    counts: Iterable[int],
    criteria: Sequence[str] = CRITERIA,
    seed: int = 0,
    threads: int | None = None,
    progress: bool = False,
) -> Trial:
    """Fit a warp with every number of control points, and judge it.

    Parameters
    ----------
    problem : Problem
        Matches and truth.
    fractional : bool
        Whether the warp models perspective.
    counts : iterable of int
        Numbers of control points.
    criteria : sequence of str
        Which to compute; FIT is added.
    seed, threads, progress
        As `mexpress.select_warp` has them.

    Returns
    -------
    Trial
        FIT selects, so that no other criterion must be defined.
    """
    selection = select_warp(
        problem.source,
        problem.target,
        "FIT",
        criteria,
        fractional=fractional,
        counts=list(counts),
        image_size=problem.image_size,
        seed=seed,
        threads=threads,
        progress=progress,
        smoothing=0,
    )
    warps = [selection.warps.get(int(count)) for count in selection.counts]
    truth = rasterised(problem.target_contour, problem.target_size) if problem.target_contour else None
    unknown = (math.nan, math.nan, 0.0, math.nan, math.nan)
    rows = [_judged(warp, problem, truth) if warp else unknown for warp in warps]
    overlap, error, lost, folded, vanishing = np.array(rows).T
    return Trial(problem, selection, overlap, error, lost == 1, folded, vanishing)


def _judged(warp: Warp, problem: Problem, truth: Mask | None) -> tuple[float, ...]:
    """Return the measures of a warp."""
    overlap, error, lost = math.nan, math.nan, False
    if truth is not None:
        rings = transferred(warp, problem.source_contour)
        lost = rings is None
        overlap = 0.0 if rings is None else jaccard(truth, rings, problem.target_size)
    if len(problem.unseen_source):
        with np.errstate(invalid="ignore", over="ignore"):
            squared = ((warp(problem.unseen_source) - problem.unseen_target) ** 2).sum(axis=1)
            error = float(np.sqrt(np.where(np.isnan(squared), np.inf, squared).mean()))
    inside = lattice(warp.domain, _SAMPLES)
    vanishes = warp.vanishes(inside)
    folds = warp.folds(inside) & ~vanishes
    return overlap, error, float(lost), float(folds.mean()), float(vanishes.mean())
