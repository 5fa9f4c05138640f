"""Criteria by name: a number per model, smallest for the model to choose.

======================  ==================================================================================
FIT                     root mean square residual, equation (11): always prefers more parameters
PRESS                   every row held out on its own, equation (3)
CMPRESS                 every datum held out on its own, equation (8)
KFkk                    kk random folds, equation (9)
ERxx                    local exclusion of all within xx % of the diagonal, equations (12, 13); decimals allowed
NNxxPTS, NNxxPCT        local exclusion of the xx nearest, or xx % of the data, the datum itself counted
DELAUNAY                local exclusion of the neighbours in the Delaunay triangulation
MATCHED                 local exclusion of so many near data that predictions reach as far as from the data's region,
                        sampled evenly, to the data: `mexpress.schemes.matched`
LPOxx                   sets of xx data, at most 1000 of them, drawn at random
RSxxPCT                 random xx % of the data, 100 times
AIC, BIC, GCV           information criteria and generalised cross-validation, with trace(H) for parameters
======================  ==================================================================================

Case does not matter, and ``PRESS`` may follow, as in the paper: ``er10`` and ``ER10PRESS`` are ER10.

Examples
--------
>>> import mexpress as mx
>>> mx.criteria.parse("ER10PRESS").name
'ER10'
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from mexpress import _validation as check
from mexpress import schemes
from mexpress._validation import Floats, Integers
from mexpress.leastsquares.model import LeastSquares, cross_validate_all, datum_of_row, leave_row_out
from mexpress.leastsquares.nested import Nested, NestedCurve
from mexpress.placement import covered_region, lattice
from mexpress.schemes import IndexSets, Neighbourhoods, Scheme, each_alone

__all__ = ["UNITLESS", "Criterion", "Judge", "Score", "parse"]

UNITLESS = frozenset({"AIC", "BIC"})
"""Criteria without a unit."""

Made = TypeVar("Made")

LEAVE_P_OUT_SETS = 1000
LEAST_QUERIES = 2000
RANDOM_REPEATS = 100


@dataclass(frozen=True)
class Criterion:
    """A criterion's name, its family (a pattern above), and the number in it.

    Examples
    --------
    >>> from mexpress.criteria import parse
    >>> parse("er7.5press")
    Criterion(name='ER7.5', family='ER', amount=7.5)
    """

    name: str
    family: str
    amount: float = 0.0


@dataclass(frozen=True)
class Data:
    """What the schemes of a sweep are made of: where the data are, how large the domain is, and a seed."""

    points: Floats
    diagonal: float
    seed: Any
    threads: int


def _share(percent: float, n: int) -> int:
    """A percentage of the data, at least one, half rounding up."""
    return max(1, math.floor(percent * n / 100 + 0.5))


def _over_domain(data: Data) -> Scheme:
    """Distances matched to those from the region that the data cover."""
    queries = lattice(covered_region(data.points), max(LEAST_QUERIES, len(data.points)))
    return schemes.matched(data.points, queries, threads=data.threads)


SCHEMES: dict[str, Callable[[float, Data], Scheme]] = {
    "CMPRESS": lambda _, data: schemes.leave_one_out(len(data.points)),
    "KF": lambda k, data: schemes.k_fold(len(data.points), int(k), data.seed),
    "ER": lambda percent, data: schemes.exclusion_radius(
        data.points, percent / 100 * data.diagonal, data.threads
    ),
    "NN..PTS": lambda k, data: schemes.nearest(data.points, int(k), data.threads),
    "NN..PCT": lambda percent, data: schemes.nearest(
        data.points, _share(percent, len(data.points)), data.threads
    ),
    "DELAUNAY": lambda _, data: schemes.delaunay(data.points),
    "MATCHED": lambda _, data: _over_domain(data),
    "LPO": lambda p, data: schemes.leave_p_out(len(data.points), int(p), LEAVE_P_OUT_SETS, data.seed),
    "RS..PCT": lambda percent, data: schemes.random_sampling(
        len(data.points), _share(percent, len(data.points)), RANDOM_REPEATS, data.seed
    ),
}


NEIGHBOURHOODS: dict[str, Callable[[float, Data], Neighbourhoods]] = {
    "ER": lambda percent, data: Neighbourhoods.within(data.points, percent / 100 * data.diagonal),
    "NN..PTS": lambda k, data: Neighbourhoods.nearest(data.points, int(k)),
    "NN..PCT": lambda percent, data: Neighbourhoods.nearest(data.points, _share(percent, len(data.points))),
}
"""Of the schemes above, those that need not be listed."""


@dataclass(frozen=True)
class Fit:
    """What information criteria look at: E, and how many parameters, measurements and data there are.

    Several responses that share a design are as many measurements, and take as many parameters.
    """

    rms: float
    parameters: float
    n_rows: int
    n_data: int

    @property
    def log_rss(self) -> float:
        """ln(RSS / m), counting measurements: with several to a datum, each is one piece of evidence."""
        if self.rms == 0:
            return -math.inf
        return 2 * math.log(self.rms) + math.log(self.n_data / self.n_rows)

    @property
    def free(self) -> float:
        """Share of the rows that the parameters leave free; NaN if none, for then the residuals are rounding."""
        share = 1 - self.parameters / self.n_rows
        return share if share > 1e-12 else math.nan


def _aic(fit: Fit) -> float:
    return fit.n_rows * fit.log_rss + 2 * fit.parameters if fit.free > 0 else math.nan


def _bic(fit: Fit) -> float:
    return fit.n_rows * fit.log_rss + math.log(fit.n_rows) * fit.parameters if fit.free > 0 else math.nan


def _gcv(fit: Fit) -> float:
    """Its root, so that it stands beside the prediction errors."""
    return fit.rms / fit.free


FORMULAS: dict[str, Callable[[Fit], float]] = {
    "FIT": lambda fit: fit.rms,
    "AIC": _aic,
    "BIC": _bic,
    "GCV": _gcv,
}

_WHOLE, _DECIMAL = r"(\d+)", r"(\d+(?:\.\d+)?)"
_PATTERNS = {
    name: name for name in ("FIT", "PRESS", "CMPRESS", "DELAUNAY", "MATCHED", "AIC", "BIC", "GCV")
} | {
    "KF": f"KF{_WHOLE}",
    "ER": f"ER{_DECIMAL}",
    "NN..PTS": f"NN{_WHOLE}PTS",
    "NN..PCT": f"NN{_DECIMAL}PCT",
    "LPO": f"LPO{_WHOLE}",
    "RS..PCT": f"RS{_DECIMAL}PCT",
}


def parse(name: str) -> Criterion:
    """Read a criterion's name.

    Parameters
    ----------
    name : str
        As in this module's table.

    Raises
    ------
    ValueError
        If it is none of them.

    Examples
    --------
    >>> from mexpress.criteria import parse
    >>> parse("KF05")
    Criterion(name='KF05', family='KF', amount=5.0)
    """
    families = (
        "FIT, PRESS, CMPRESS, KFkk, ERxx, NNxxPTS, NNxxPCT, DELAUNAY, MATCHED, LPOxx, RSxxPCT, AIC, BIC, GCV"
    )
    rule = f"It must be one of {families}."
    if not isinstance(name, str):
        check.refuse("criterion", rule, check.describe(name), TypeError)
    return _find(name) or check.refuse("criterion", rule, repr(name))


def _find(name: str) -> Criterion | None:
    """The criterion of a name, if there is one."""
    plain = name.strip().upper()
    if plain not in _PATTERNS:
        plain = plain.removesuffix("PRESS")
    for family, pattern in _PATTERNS.items():
        match = re.fullmatch(pattern, plain, re.ASCII)
        if match:
            amount = float(match.group(1)) if match.groups() else 0.0
            return Criterion(plain, family, amount)
    return None


@dataclass(frozen=True, eq=False)
class Score:
    """A criterion's value for one model; NaN if some data cannot be predicted, and which.

    Parameters
    ----------
    value : float
        In the responses' unit (AIC and BIC have none).
    undefined : int64 array
        The data whose prediction lacks the rank.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> model = mx.LeastSquares([[1.0], [1.0], [1.0]], [1.0, 3.0, 5.0])
    >>> mx.criteria.Judge.of(["CMPRESS"], np.eye(3, 2)).scores(model)["CMPRESS"].undefined
    array([], dtype=int64)
    """

    value: float
    undefined: Integers


@dataclass(frozen=True, eq=False, repr=False)
class Judge:
    """Criteria made ready for one set of data: schemes are built once and serve every model of a sweep.

    Parameters
    ----------
    criteria : dict of str to Criterion or None
        By name; None for a scheme that the user gave.
    schemes : dict of str to Scheme
        Of those criteria that have one.
    neighbourhoods : dict of str to Neighbourhoods
        In their place for nested models, see `of`.

    Examples
    --------
    >>> from mexpress.criteria import Judge
    >>> import numpy as np
    >>> Judge.of(["fit", "ER10"], np.random.default_rng(0).uniform(size=(30, 2)))
    Judge(FIT, ER10)
    """

    criteria: dict[str, Criterion | None]
    schemes: dict[str, Scheme]
    neighbourhoods: dict[str, Neighbourhoods] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        criteria: Sequence[str] | Mapping[str, Scheme],
        points: Floats,
        diagonal: float | None = None,
        seed: Any = 0,
        threads: int | None = None,
        nested: bool = False,
    ) -> Judge:
        """Build the schemes that criteria need.

        Parameters
        ----------
        criteria : sequence of str, or mapping of str to Scheme
            Names, or schemes of one's own under names that are no criterion's.
        points : (n, 2) array
            Where the data are.
        diagonal : float, optional
            What ERxx is a percentage of; that of the points' bounding box if not given.
        seed : int
            Of the random schemes.
        threads : int, optional
            At most so many threads.
        nested : bool, default False
            Whether it is for nested models, which need no list of who is near whom.

        Raises
        ------
        ValueError, TypeError
            If a name is no criterion's or does not suit the data, or a scheme has the name of a criterion.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> mx.criteria.Judge.of({"pairs": mx.schemes.from_sets([[0, 1], [2, 3]])}, np.eye(4, 2))
        Judge(pairs)
        """
        rule = "It must be a list of names, or schemes by name."
        if isinstance(criteria, Mapping):
            for name, scheme in criteria.items():
                if not (isinstance(name, str) and isinstance(scheme, Scheme)):
                    check.refuse("criteria", rule, check.describe({name: scheme}), TypeError)
                if scheme.n_data != len(points):
                    of_these = f"Its schemes must be over the {len(points)} data."
                    check.refuse("criteria", of_these, f"{name!r} over {scheme.n_data} data")
                if _find(name) is not None:
                    own = "A scheme of one's own must not have the name of a criterion."
                    check.refuse("criteria", own, check.describe(name))
            return cls(dict.fromkeys(criteria), dict(criteria))
        whole = float(np.hypot(*np.ptp(points, axis=0))) if diagonal is None else diagonal
        check.generator(seed)
        data = Data(points, whole, seed, check.threads(threads))
        parsed = {c.name: c for c in map(parse, check.items(criteria, "criteria", rule))}
        lazy = NEIGHBOURHOODS if nested else {}
        near = {c.name: _made(lazy, c, data) for c in parsed.values() if c.family in lazy}
        rest = {name: c for name, c in parsed.items() if c.family in SCHEMES and name not in near}
        return cls(dict(parsed), {name: _made(SCHEMES, c, data) for name, c in rest.items()}, near)

    def __or__(self, other: Judge) -> Judge:
        return Judge(
            self.criteria | other.criteria,
            self.schemes | other.schemes,
            self.neighbourhoods | other.neighbourhoods,
        )

    def __repr__(self) -> str:
        return f"Judge({', '.join(self.criteria)})"

    def scores(self, model: LeastSquares, threads: int | None = None) -> dict[str, Score]:
        """Every criterion's score of a model; all undefined if the data do not determine the model.

        Parameters
        ----------
        model : LeastSquares
            Over as many data as there are points.
        threads : int, optional
            At most so many threads.

        Returns
        -------
        dict of str to Score
            By the criteria's names.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> model = mx.LeastSquares([[1.0], [1.0], [1.0]], [1.0, 3.0, 5.0])
        >>> scores = mx.criteria.Judge.of(["FIT", "CMPRESS"], np.eye(3, 2)).scores(model)
        >>> {name: round(score.value, 3) for name, score in scores.items()}
        {'FIT': 1.633, 'CMPRESS': 2.449}
        """
        if model.rank < len(model.coefficients):
            lost = Score(math.nan, np.arange(model.n_data))
            return dict.fromkeys(self.criteria, lost)
        validated = cross_validate_all(model, self.schemes, threads)
        r = model.residuals.size // len(model.residuals)
        fit = Fit(model.fit_rms, r * float(model.leverage.sum()), model.residuals.size, model.n_data)
        scores = {}
        for name, criterion in self.criteria.items():
            if name in validated:
                cv = validated[name]
                pairs = self.schemes[name].validated
                data = [pairs[pair] for pair in cv.undefined]
                scores[name] = Score(cv.score, np.unique(np.concatenate([*data, cv.undefined[:0]])))
            elif criterion is not None and criterion.family in FORMULAS:
                scores[name] = Score(FORMULAS[criterion.family](fit), np.zeros(0, dtype=np.int64))
            else:
                scores[name] = _press(model, threads)
        return scores

    def curves(
        self,
        nested: Nested,
        sizes: Integers,
        threads: int | None = None,
        step: Callable[[], None] | None = None,
    ) -> dict[str, list[Score]]:
        """Every criterion's score of every model of a nested design, in one sweep.

        Parameters
        ----------
        nested : Nested
            From `mexpress.leastsquares.nested`, over as many data as there are points.
        sizes : (k,) int64 array
            The models' numbers of columns, increasing.
        threads : int, optional
            At most so many threads.
        step : callable, optional
            Called now and then, as often as `mexpress.leastsquares.nested.steps` says.

        Returns
        -------
        dict of str to list of Score
            By the criteria's names, one a size.

        Examples
        --------
        >>> from mexpress.criteria import Judge
        >>> from mexpress.leastsquares.nested import Nested
        >>> import numpy as np
        >>> nested = Nested([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]], [1.0, 3.0, 5.0])
        >>> curves = Judge.of(["FIT", "CMPRESS"], np.eye(3, 2)).curves(nested, np.array([1, 2]))
        >>> [round(score.value, 3) + 0.0 for score in curves["CMPRESS"]]
        [2.449, 0.0]
        """
        every: dict[str, Scheme | Neighbourhoods] = {**self.schemes, **self.neighbourhoods}
        for scheme in every.values():
            if scheme.n_data != nested.n_data:
                rule = f"It must be over the criteria's {scheme.n_data} data."
                check.refuse("nested", rule, f"{nested.n_data} data")
        fits = nested.fits(sizes, threads)
        found = nested.curves(every, sizes, threads, step)
        alone = each_alone(nested.n_data)
        scores = {}
        for name, criterion in self.criteria.items():
            if name in found:
                scores[name] = _scored(
                    found[name], self.schemes[name].validated if name in self.schemes else alone
                )
            elif criterion is not None and criterion.family in FORMULAS:
                formula = FORMULAS[criterion.family]
                each = zip(fits.rms, fits.parameters, strict=True)
                r = nested.n_responses
                models = (Fit(float(e), r * float(k), r * nested.n_rows, nested.n_data) for e, k in each)
                scores[name] = [Score(formula(model), np.zeros(0, dtype=np.int64)) for model in models]
            else:
                scores[name] = _scored(nested.press(sizes, threads), each_alone(nested.n_rows))
        # As in `scores`: nothing is said of models that the data do not determine.
        for k in np.flatnonzero(fits.rank < sizes):
            for curve in scores.values():
                curve[k] = Score(math.nan, np.arange(nested.n_data))
        return scores


def _scored(curve: NestedCurve, validated: IndexSets) -> list[Score]:
    """Scores of all models, with the validated data of the pairs that lack the rank."""
    scores = []
    for k, value in enumerate(curve.scores):
        lost = np.flatnonzero(curve.defined <= k)
        data = [validated[pair] for pair in lost]
        scores.append(Score(float(value), np.unique(np.concatenate([*data, lost[:0]]))))
    return scores


def _press(model: LeastSquares, threads: int | None) -> Score:
    value, rows = leave_row_out(model, threads)
    return Score(value, np.unique(datum_of_row(model)[rows]))


def _made(builders: Mapping[str, Callable[[float, Data], Made]], criterion: Criterion, data: Data) -> Made:
    try:
        return builders[criterion.family](criterion.amount, data)
    except (ValueError, OverflowError) as error:  # the number in a name may have any number of digits
        said = re.fullmatch(r"Invalid (\w+)\. (.*) Given (.*)\.", str(error))
        unsaid = "the number", "It must suit the data.", f"{len(data.points)} data"
        argument, rule, given = said.groups() if said else unsaid
        rule = rule.replace("It must", f"{argument} must", 1)
        check.refuse("criteria", f"In {criterion.name}, {rule[0].lower()}{rule[1:]}", given)
