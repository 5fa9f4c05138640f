"""The models that a selection tries, and the criteria that score them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.caching import cached_property
from mexpress.criteria import Domain, Scorer, parse
from mexpress.geometry import thinness
from mexpress.leastsquares.nested import steps
from mexpress.liftings import Lifting, ThinPlateSpline
from mexpress.models import Basis, CardinalBasis, Design, ModelT, NestedBasis
from mexpress.progress import Show
from mexpress.schemes import Scheme
from mexpress.selection.data import Data, Matches, total_weight
from mexpress.selection.defaults import CRITERIA, is_automatic
from mexpress.selection.queries import Queries
from mexpress.selection.selection import Selection
from mexpress.selection.sweep import Sweep, sweep_designs, sweep_nested
from mexpress.selection.weights import smoothing_weights, tie_slack

_FEW = 3
"""Up to this number, nested designs cost less one by one than in one sweep."""

_THIN = 1e-3
"""In regions with a larger ratio of width to length, control points can be placed."""


@dataclass(frozen=True)
class CriteriaRequest:
    """The criteria that a user names, before their schemes are built.

    Parameters
    ----------
    criterion : str
        The criterion that selects.
    criteria : names, schemes by name, or None
        Further criteria.
    data : Matches or Samples
        The data of the models.
    seed, threads
        As for `select_warp`.
    queries : Queries, optional
        Where the model will be used; MATCHED matches far ones.

    Examples
    --------
    >>> from mexpress.selection.data import Samples
    >>> data = Samples.of([[0, 0], [4, 0], [0, 3], [4, 3]], [1.0, 2.0, 3.0, 5.0])
    >>> CriteriaRequest("er10press", ["FIT"], data).scorer(nested=False)
    ('ER10', Scorer(FIT, ER10))
    """

    criterion: str
    criteria: Sequence[str] | Mapping[str, Scheme] | None
    data: Data
    seed: Any = 0
    threads: int | None = None
    queries: Queries | None = None

    @property
    def far(self) -> bool:
        """Whether the model will be used far from the data."""
        return self.queries is not None and self.queries.far

    def scorer(self, nested: bool) -> tuple[str, Scorer]:
        """Return the name of the criterion that selects, and a scorer of all criteria; `nested` of nested designs."""
        check.generator(self.seed)
        chosen, names = self._names
        scorer = Scorer.over(names, self._domain, nested)
        if chosen not in scorer.criteria and chosen not in self._own:
            scorer |= Scorer.over([chosen], self._domain, nested, "criterion")
        return chosen, scorer | Scorer.over(self._own, self._domain)

    @cached_property
    def listed(self) -> tuple[str, Scorer]:
        """The scorer of designs that are not nested, the same for all candidates; leave-one-out is always in it."""
        chosen, scorer = self.scorer(nested=False)
        if "CMPRESS" in scorer.criteria:
            return chosen, scorer
        return chosen, scorer | Scorer.over(["CMPRESS"], self._domain)

    @property
    def shown(self) -> frozenset[str]:
        """Names of the criteria that were asked for."""
        chosen, names = self._names
        return frozenset({chosen} | {parse(name).name for name in names} | self._own.keys())

    @property
    def _own(self) -> Mapping[str, Scheme]:
        return self.criteria if isinstance(self.criteria, Mapping) else {}

    @cached_property
    def _names(self) -> tuple[str, list[str]]:
        """The criterion that selects, and the others by name: without any scheme, which can be large."""
        if isinstance(self.criterion, str) and self.criterion in self._own:
            return self.criterion, []
        named = CRITERIA if self.criteria is None or self._own else self.criteria
        names = check.items(named, "criteria", "It must be a list of names, or schemes by name.")
        return parse(self.criterion).name, names

    @cached_property
    def _domain(self) -> Domain:
        data, threads = self.data, check.threads(self.threads)
        queries = self.queries.points if self.queries is not None and self.far else None
        return Domain(data.points, data.diagonal, data.domain, self.seed, threads, queries)


@dataclass(frozen=True, eq=False, repr=False)
class Candidates(Generic[ModelT]):
    """The models that a selection tries: numbers of control points by weights of the bending energy.

    Parameters
    ----------
    lifting : type of Lifting
        The functions.
    design : callable
        Returns the design over a basis.
    counts : int array or None
        Numbers of control points, increasing. None stands for all up to the largest or, with an automatic weight, for
        the smallest and the largest.
    largest : int
        Largest number of control points if `counts` is None.
    order : callable or None
        Returns at most a number of data that become control points; every count takes the first of them, and the
        lifting is a thin-plate spline. None if every count has its own control points.
    smoothing : float, list of float, or "auto"
        Weights of the bending energy.
    placed : bool
        Whether automatic weights suit the largest number of control points that was placed, not that was wished.
    """

    lifting: type[Lifting]
    design: Callable[[Basis], Design[ModelT]]
    counts: Integers | None
    largest: int
    order: Callable[[int], Integers] | None
    smoothing: float | ArrayLike | str
    placed: bool = False

    def select(self, request: CriteriaRequest, show: Show) -> tuple[Selection, Sweep[ModelT], Floats | None]:
        """Score all models and let the criterion select; `show` shows the progress.

        Returns
        -------
        selection, sweep, ordered
            The selection, the sweep behind it, and the ordered control points or None.
        """
        data, automatic = request.data, is_automatic(self.smoothing)
        tried = (
            self.lifting.counts(data.domain.corners, self.largest)
            if self.counts is None
            else self.counts.tolist()
        )
        ordered, wished = None, tried[-1]
        if self.order is not None:
            ordered = data.points[self.order(tried[-1])]
            tried = sorted({min(count, len(ordered)) for count in tried})
        if automatic and self.counts is None:
            tried = sorted({tried[0], tried[-1]})
        n = len(data.points)
        largest = tried[-1] if self.placed else wished
        weights = smoothing_weights(self.smoothing, total_weight(data), data.domain.area, largest)
        nested = ordered is not None and len(tried) > _FEW
        name, scorer = request.scorer(nested=True) if nested else request.listed
        liftings = [] if nested else self._liftings(request, tried, ordered)
        costs = (
            [1.0] * (steps(n) * len(weights))
            if nested
            else [cost for lifting in liftings for cost in _costs(n, lifting, len(weights))]
        )
        with show(costs) as on_step:
            if ordered is not None and nested:
                design = self.design(NestedBasis(ordered))
                sweep = sweep_nested(design, np.array(tried), weights, scorer, request.threads, on_step)
            else:
                designs = (self.design(CardinalBasis(lifting)) for lifting in liftings)
                sweep = sweep_designs(designs, weights, scorer, request.threads, on_step)
        return sweep.selection(name, tie_slack(self.smoothing, n)), sweep, ordered

    def _liftings(self, request: CriteriaRequest, counts: list[int], ordered: Floats | None) -> list[Lifting]:
        """Liftings with different, increasing numbers of control points."""
        if ordered is not None:
            return [self.lifting(ordered[:count]) for count in counts]
        where, seed, threads = request.data.domain, request.seed, request.threads
        placed = (self.lifting.place_over(where, count, seed, threads) for count in counts)
        by_count = {len(control_points): control_points for control_points in placed}
        try:
            return [self.lifting(control_points) for _, control_points in sorted(by_count.items())]
        except ValueError as error:  # of control points that the user has not given
            self._refuse_region(request.data, error)

    def _refuse_region(self, data: Data, error: ValueError) -> NoReturn:
        """Refuse data in whose region control points cannot be placed."""
        thin = thinness(data.domain.corners)
        if thin > _THIN:
            raise error
        nested = ', or with placement="nested"' if self.lifting is ThinPlateSpline else ""
        rule = (
            f"Their region must be wide enough for control points: try fewer{nested}, or scale x and y so that it "
            "is nearly square."
        )
        given = f"{len(data.points)} points whose spread across a line is {thin:.1g} of that along it"
        check.refuse("source" if isinstance(data, Matches) else "points", rule, given)


def _costs(n: int, lifting: Lifting, weights: int) -> list[float]:
    """Return about how many multiply-adds each weight of a design takes: any takes some; then fit and held-out sets.

    The first comes with the basis of all of them, which takes about as long as they do together.
    """
    one = 1e7 + n * len(lifting.control_points) ** 2 * (10 + n / 20)
    return [one * (1 + weights), *[one] * (weights - 1)]


def checked_counts(counts: ArrayLike | None, n: int, name: str) -> Integers | None:
    """Check numbers of control points, and sort them; None stays None.

    Examples
    --------
    >>> checked_counts(range(5, 2, -1), 20, "matches")
    array([3, 4, 5])
    """
    if counts is None:
        return None
    sequence = list(counts) if isinstance(counts, range) else counts
    if isinstance(sequence, int | float | np.number):
        rule = f"It must be a list of numbers of control points, such as [{sequence:.0f}] or range(3, 20)."
        check.refuse("counts", rule, check.describe(counts), TypeError)
    rule = f"They must be different whole numbers, one or more, from 3 to the number of {name}, {n}."
    wished = check.integers(sequence, "counts", rule)
    if wished.size == 0 or len(np.unique(wished)) < len(wished):
        check.refuse("counts", rule, check.describe(counts))
    if wished.min() < 3 or wished.max() > n:
        check.refuse("counts", rule, f"{wished.min()}" if wished.min() < 3 else f"{wished.max()}")
    return np.sort(wished)


def checked_placement(
    placement: str | None, lifting: type[Lifting], choices: Sequence[str], default: str
) -> str:
    """Check the placement of control points; by default, thin-plate splines have a default of their own.

    Examples
    --------
    >>> from mexpress.liftings import BSpline
    >>> [checked_placement(None, lifting, ["nested", "lloyd"], "nested") for lifting in (ThinPlateSpline, BSpline)]
    ['nested', 'lloyd']
    """
    splines = lifting is ThinPlateSpline
    if placement is None:
        return default if splines else "lloyd"
    if not isinstance(placement, str) or placement not in choices:
        *others, last = (f'"{choice}"' for choice in choices)
        rule = f"It must be {', '.join(others)} or {last}.{check.nearest_name(placement, choices)}"
        check.refuse("placement", rule, check.describe(placement))
    if placement != "lloyd" and not splines:
        check.refuse(
            "placement", 'It must be "lloyd" unless the lifting is "tps".', check.describe(placement)
        )
    return placement
