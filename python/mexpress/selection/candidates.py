"""Which models a selection tries, and how they are judged.

Examples
--------
See `mexpress.select_warp`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any, Generic

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.criteria import Judge, parse
from mexpress.leastsquares.nested import steps
from mexpress.liftings import Lifting
from mexpress.models import Design, NestedDesign
from mexpress.progress import bar
from mexpress.schemes import Scheme
from mexpress.selection.sweep import Model, Sweep, one_by_one, together
from mexpress.selection.weights import is_auto

__all__ = ["Jury", "Models", "default_criterion", "largest_count", "most_of", "slack_of", "wished_counts"]

DEFAULT_CRITERIA = ("FIT", "PRESS", "CMPRESS")

_MOST_PARAMETERS = 900
"""Of a design whose stiffness is found automatically: the time grows with their cube."""

_FEW = 3
"""Up to so many nested designs cost less one by one than together."""


def largest_count(n: int) -> int:
    """The largest number of control points that the paper tries for n data: half of them, at most 100.

    Examples
    --------
    >>> from mexpress.selection import largest_count
    >>> [largest_count(n) for n in (10, 15, 30, 150, 500)]
    [6, 7, 15, 75, 100]
    """
    return {10: 6, 15: 7}.get(n, min(math.floor(n / 2 + 0.5), 100))


def most_of(n: int, functions: int) -> int:
    """The most control points that an automatic weight needs for n data: one each, unless unknowns become too many.

    Parameters
    ----------
    n : int
        Number of data.
    functions : int
        How many functions share a design: three of a fractional warp, otherwise one.

    Examples
    --------
    >>> from mexpress.selection.candidates import most_of
    >>> most_of(60, 3), most_of(5000, 3)
    (60, 300)
    """
    return max(3, min(n, _MOST_PARAMETERS // functions))


def slack_of(smoothing: Any, n: int) -> float:
    """The slack of a selection with an automatic weight.

    Sums of squared prediction errors that differ by less than one datum's share of them are taken for equal.

    Examples
    --------
    >>> from mexpress.selection.candidates import slack_of
    >>> slack_of(0.0, 50), round(slack_of("auto", 50), 4)
    (0.0, 0.01)
    """
    return math.sqrt(1 + 1 / n) - 1 if is_auto(smoothing) else 0.0


def default_criterion(criterion: str | None, smoothing: Any) -> str:
    """The criterion that selects: ER10 unless the user says otherwise, or leaves the weight to the library.

    Examples
    --------
    >>> from mexpress.selection.candidates import default_criterion
    >>> default_criterion(None, 0.0), default_criterion(None, "auto"), default_criterion("GCV", "auto")
    ('ER10', 'MATCHED', 'GCV')
    """
    if criterion is None:
        return "MATCHED" if is_auto(smoothing) else "ER10"
    return criterion


@dataclass(frozen=True)
class Jury:
    """The criteria that a user asks for, before their schemes are made.

    Parameters
    ----------
    criterion : str
        What selects.
    criteria : names, schemes by name, or None
        Others.
    points : (n, 2) array
        Where the data are.
    diagonal : float or None
        What ERxx is a percentage of.
    seed, threads
        As for `select_warp`.

    Examples
    --------
    See `mexpress.select_warp`.
    """

    criterion: str
    criteria: Sequence[str] | Mapping[str, Scheme] | None
    points: Floats
    diagonal: float | None
    seed: Any
    threads: int | None

    def judge(self, nested: bool) -> tuple[str, Judge]:
        """The selecting criterion's name, and a judge of it and the others.

        Examples
        --------
        See `mexpress.select_warp`.
        """
        own = self.criteria if isinstance(self.criteria, Mapping) else {}
        if isinstance(self.criterion, str) and self.criterion in own:
            return self.criterion, Judge.of(own, self.points)
        named = DEFAULT_CRITERIA if self.criteria is None or own else self.criteria
        names = check.items(named, "criteria", "It must be a list of names, or schemes by name.")
        chosen = parse(self.criterion).name
        options = (self.points, self.diagonal, self.seed, self.threads, nested)
        return chosen, Judge.of([*names, chosen], *options) | Judge.of(own, self.points)


@dataclass(frozen=True, eq=False, repr=False)
class Models(Generic[Model]):
    """The models that a selection tries.

    Attributes
    ----------
    lifting : type of Lifting
        The functions.
    counts : list of int
        Wished numbers of control points, increasing.
    weights : (w,) array
        Weights of the bending energy, increasing.
    ordered : (l, 2) array or None
        Control points of thin-plate splines, of which every count takes the first; None if every count has its own.
    region : (k, 2) array
        What the data cover.
    design : callable
        The design of a lifting.
    nested : callable
        The nested design of ordered control points.

    Examples
    --------
    See `mexpress.select_warp`.
    """

    lifting: type[Lifting]
    counts: list[int]
    weights: Floats
    ordered: Floats | None
    region: Floats
    design: Callable[[Lifting], Design[Model]]
    nested: Callable[[Floats], NestedDesign[Model]]

    def sweep(self, jury: Jury, label: str | None) -> tuple[str, Sweep[Model]]:
        """Judge them all, showing progress under a label if there is one; with the name of the criterion that selects.

        Examples
        --------
        See `mexpress.select_warp`.
        """
        if self.ordered is not None and len(self.counts) > _FEW:
            name, judge = jury.judge(nested=True)
            rounds = len(self.weights) * steps(len(jury.points))
            with bar(rounds, label) if label else nullcontext(lambda: None) as step:
                design, counts = self.nested(self.ordered), np.array(self.counts)
                return name, together(design, counts, self.weights, judge, jury.threads, step)
        name, judge = jury.judge(nested=False)
        liftings = self._liftings(jury.seed, jury.threads)
        with bar(len(liftings) * len(self.weights), label) if label else nullcontext(lambda: None) as step:
            designs = (self.design(lifting) for lifting in liftings)
            return name, one_by_one(designs, self.weights, judge, jury.threads, step)

    def _liftings(self, seed: Any, threads: int | None) -> list[Lifting]:
        """Liftings of different, increasing numbers of control points."""
        if self.ordered is not None:
            return [self.lifting(self.ordered[:count]) for count in self.counts]
        placed = (self.lifting.place(self.region, count, seed, threads) for count in self.counts)
        by_count = {len(control_points): control_points for control_points in placed}
        return [self.lifting(control_points) for _, control_points in sorted(by_count.items())]


def wished_counts(counts: ArrayLike | None, n: int, name: str) -> Integers | None:
    """Numbers of control points that a user wants, increasing.

    Examples
    --------
    >>> from mexpress.selection.candidates import wished_counts
    >>> wished_counts(range(5, 2, -1), 20, "matches")
    array([3, 4, 5])
    """
    if counts is None:
        return None
    listed = list(counts) if isinstance(counts, range) else counts
    if isinstance(listed, int | float | np.number):
        check.refuse(
            "counts", "It must be a list of numbers of control points.", check.describe(counts), TypeError
        )
    tried = check.indices(listed, "counts")
    if tried.size == 0 or tried.min() < 3 or tried.max() > n:
        rule = f"They must be one or more, from 3 to the number of {name}, {n}."
        check.refuse("counts", rule, check.describe(counts))
    return np.sort(tried)
