"""Criteria by name. A criterion gives every model a score and selects the model with the smallest score.

======================  ==================================================================================
FIT                     root mean square residual, equation (11); it always prefers more parameters
PRESS                   every row held out on its own, equation (3)
CMPRESS                 every datum held out on its own, equation (8)
KFkk                    kk random folds, equation (9)
ERxx                    local exclusion of all data within xx % of the diagonal, equations (12, 13); decimals allowed
NNxxPTS, NNxxPCT        local exclusion of the xx nearest data, or xx % of the data, including the datum itself
DELAUNAY                local exclusion of the neighbours in the Delaunay triangulation
MATCHED                 local exclusion of just enough nearest data that a validated datum is as far from its training
                        data as a typical query is from the data: `mexpress.schemes.matched`. Queries are far ones
                        that a selection is told of, else places all over the region of the data
LPOxx                   all sets of xx data, or 1000 random ones if there are more
RSxxPCT                 random xx % of the data, 100 times
AIC, BIC, GCV           information criteria and generalised cross-validation, with trace(H) as the number of parameters
======================  ==================================================================================

AIC and BIC know no bound below: m ln(RSS / m) falls without end as residuals vanish, and 2 trace(H) is
2 m at most. Where a model may have about as many functions as there are data, as smoothed surfaces by default, they
choose to interpolate: take GCV or leave-one-out there.

Case does not matter, and ``PRESS`` may follow as in the paper: ``er10`` and ``ER10PRESS`` are ER10.

Examples
--------
>>> import mexpress as mx
>>> mx.criteria.parse("ER10PRESS").name
'ER10'
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from mexpress import _validation as check
from mexpress import schemes
from mexpress._validation import Floats, Integers
from mexpress.caching import cached_property
from mexpress.geometry import Region, hull, lattice
from mexpress.geometry import diagonal as _diagonal
from mexpress.index_sets import IndexSets
from mexpress.leastsquares.model import LeastSquares, cross_validate_all, datum_of_row, leave_row_out
from mexpress.leastsquares.nested import Nested, NestedCurve
from mexpress.schemes import LazyNeighbourhoods, Places, Scheme

__all__ = ["UNITLESS", "Criterion", "Domain", "Score", "Scorer", "parse"]


def __dir__() -> list[str]:
    return sorted(__all__)


UNITLESS = frozenset({"AIC", "BIC"})
"""Criteria without a unit."""

Made = TypeVar("Made")

LEAVE_P_OUT_SETS = 1000
LEAST_QUERIES = 2000
FEWEST_VALIDATED, VALIDATED_WORK = 50, 90_000
"""Of n data, so many are predicted for far queries: the work divided by n, this many at least."""

RANDOM_REPEATS = 100


@dataclass(frozen=True)
class Criterion:
    """A criterion: its name, its family (one of the patterns above), and the number in the name.

    Examples
    --------
    >>> from mexpress.criteria import parse
    >>> parse("er7.5press")
    Criterion(name='ER7.5', family='ER', amount=7.5)
    """

    name: str
    family: str
    amount: float = 0.0


@dataclass(frozen=True, eq=False)
class Domain:
    """The domain over which criteria build their schemes.

    Parameters
    ----------
    points : (n, 2) array
        Positions of the data, checked.
    diagonal : float
        Length of which ERxx is a percentage.
    region : Region, optional
        Region that the points cover; found when it is needed by default.
    seed : int
        Seed of the random schemes.
    threads : int
        Largest number of threads.
    queries : (q, 2) array, optional
        Positions where the model will be used, for MATCHED; all over the region by default.

    Examples
    --------
    >>> Domain(np.eye(3, 2), 1.0).places.nearest(2)
    Scheme(3 pairs over 3 data, 2 held out)
    """

    points: Floats
    diagonal: float
    region: Region | None = None
    seed: Any = 0
    threads: int = 1
    queries: Floats | None = None

    @cached_property
    def places(self) -> Places:
        """The points, prepared for searches of neighbours."""
        return Places(self.points, self.threads)


def _share(percent: float, n: int) -> int:
    """Number of data in a percentage, at least one; halves round up."""
    return max(1, math.floor(percent * n / 100 + 0.5))


def _matched(domain: Domain) -> Scheme:
    """The scheme of `mexpress.schemes.matched`, by default with queries all over the region that the data cover."""
    if domain.queries is not None:
        return _thinned(domain.places.matched(domain.queries))
    region = domain.region or Region(hull(domain.points, "points"))
    queries = lattice(region.corners, max(LEAST_QUERIES, len(domain.points)))
    return domain.places.matched(queries)


def _thinned(scheme: Scheme) -> Scheme:
    """Every so many pairs along the visiting order: far from the data each holds out many, and costs as much."""
    n = len(scheme)
    number = min(n, max(FEWEST_VALIDATED, VALIDATED_WORK // n))
    some = np.sort(scheme.visiting_order[np.linspace(0, n - 1, number).round().astype(np.int64)])
    if number == n:
        return scheme
    return Scheme(scheme.n_data, scheme.held_out.some(some), scheme.validated.some(some))


SCHEMES: dict[str, Callable[[float, Domain], Scheme]] = {
    "CMPRESS": lambda _, domain: schemes.leave_one_out(len(domain.points)),
    "KF": lambda k, domain: schemes.k_fold(len(domain.points), int(k), domain.seed),
    "ER": lambda percent, domain: domain.places.within(percent / 100 * domain.diagonal),
    "NN..PTS": lambda k, domain: domain.places.nearest(int(k)),
    "NN..PCT": lambda percent, domain: domain.places.nearest(_share(percent, len(domain.points))),
    "DELAUNAY": lambda _, domain: domain.places.delaunay(),
    "MATCHED": lambda _, domain: _matched(domain),
    "LPO": lambda p, domain: schemes.leave_p_out(len(domain.points), int(p), LEAVE_P_OUT_SETS, domain.seed),
    "RS..PCT": lambda percent, domain: schemes.random_sampling(
        len(domain.points), _share(percent, len(domain.points)), RANDOM_REPEATS, domain.seed
    ),
}


NEIGHBOURHOODS: dict[str, Callable[[float, Domain], LazyNeighbourhoods]] = {
    "ER": lambda percent, domain: domain.places.lazily_within(percent / 100 * domain.diagonal),
    "NN..PTS": lambda k, domain: domain.places.lazily_nearest(int(k)),
    "NN..PCT": lambda percent, domain: domain.places.lazily_nearest(_share(percent, len(domain.points))),
}
"""The schemes above that nested models use without a list."""


@dataclass(frozen=True)
class FitSummary:
    """Input of the information criteria: E, and the numbers of parameters, measurements and data.

    Each response that shares a design adds its own measurements and parameters.
    """

    rms: float
    parameters: float
    n_rows: int
    n_data: int

    @property
    def log_rss(self) -> float:
        """ln(RSS / m), with m the number of measurements: each is one piece of evidence, also those of one datum."""
        if self.rms == 0:
            return -math.inf
        return 2 * math.log(self.rms) + math.log(self.n_data / self.n_rows)

    @property
    def free(self) -> float:
        """1 - parameters / rows; NaN if it is zero, where residuals are only rounding."""
        share = 1 - self.parameters / self.n_rows
        return share if share > 1e-12 else math.nan


def _aic(fit: FitSummary) -> float:
    return fit.n_rows * fit.log_rss + 2 * fit.parameters if fit.free > 0 else math.nan


def _bic(fit: FitSummary) -> float:
    return fit.n_rows * fit.log_rss + math.log(fit.n_rows) * fit.parameters if fit.free > 0 else math.nan


def _gcv(fit: FitSummary) -> float:
    """The root of GCV, comparable with prediction errors."""
    return fit.rms / fit.free


FORMULAS: dict[str, Callable[[FitSummary], float]] = {
    "FIT": lambda fit: fit.rms,
    "AIC": _aic,
    "BIC": _bic,
    "GCV": _gcv,
}

WITHOUT_HOLDING_OUT = {"FIT", "PRESS", "AIC", "BIC", "GCV"}
"""Families that hold out no data, or only rows."""

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


def parse(name: str, argument: str = "criterion") -> Criterion:
    """Read a criterion's name.

    Parameters
    ----------
    name : str
        A name in the table of `mexpress.criteria`.
    argument : str
        What messages call it.

    Raises
    ------
    ValueError
        If the table does not have the name.

    Examples
    --------
    >>> from mexpress.criteria import parse
    >>> parse("KF05")
    Criterion(name='KF05', family='KF', amount=5.0)
    """
    families = (
        "FIT, PRESS, CMPRESS (leave-one-out), KFkk (kk folds), ERxx (within xx % of the diagonal), NNxxPTS, NNxxPCT, "
        "DELAUNAY, MATCHED, LPOxx, RSxxPCT, AIC, BIC, GCV"
    )
    rule = f"It must be one of {families}."
    if not isinstance(name, str):
        check.refuse(argument, rule, check.describe(name), TypeError)
    near = check.nearest_name(name, _like(name))
    return _find(name) or check.refuse(
        argument, f"It must be a criterion's name.{near}" if near else rule, repr(name)
    )


def family(name: str) -> str:
    """Return a criterion's family, or the name of a scheme of one's own.

    Examples
    --------
    >>> family("ER10"), family("mine")
    ('ER', 'mine')
    """
    known = _find(name)
    return name if known is None else known.family


def _like(name: str) -> list[str]:
    """Return a name of every family, with the number of a wrong name or, without one, with ten."""
    number = re.search(_DECIMAL, name, re.ASCII)
    amount = number[0] if number else "10"
    whole = amount.partition(".")[0]
    return [pattern.replace(_WHOLE, whole).replace(_DECIMAL, amount) for pattern in _PATTERNS.values()]


def _find(name: str) -> Criterion | None:
    """The criterion of a name, or None."""
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
    """A criterion's value for one model, and the data that cannot be predicted.

    Parameters
    ----------
    value : float
        Value in the responses' unit (AIC and BIC have none); NaN if there are such data.
    undefined : int64 array
        Data whose training data do not determine the model.
    errors : (n,) array, optional
        Size of the prediction error of every datum; of one model at a time, and of criteria with a scheme.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> model = mx.LeastSquares([[1.0], [1.0], [1.0]], [1.0, 3.0, 5.0])
    >>> mx.criteria.Scorer.of(["CMPRESS"], np.eye(3, 2)).scores(model)["CMPRESS"].errors.round(9)
    array([3., 0., 3.])
    """

    value: float
    undefined: Integers
    errors: Floats | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Scorer:
    """Criteria for one set of data, whose schemes are built once for all models of a sweep.

    Parameters
    ----------
    criteria : dict of str to Criterion or None
        Criteria by name; None for a scheme of the user.
    schemes : dict of str to Scheme
        Schemes by the names of the criteria that have one.
    neighbourhoods : dict of str to LazyNeighbourhoods
        Neighbourhoods instead of schemes, for nested models, see `of`.

    Examples
    --------
    >>> from mexpress.criteria import Scorer
    >>> import numpy as np
    >>> Scorer.of(["fit", "ER10"], np.random.default_rng(0).uniform(size=(30, 2)))
    Scorer(FIT, ER10)
    """

    criteria: dict[str, Criterion | None]
    schemes: dict[str, Scheme]
    neighbourhoods: dict[str, LazyNeighbourhoods] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        criteria: Sequence[str] | Mapping[str, Scheme],
        points: Floats,
        diagonal: float | None = None,
        seed: Any = 0,
        threads: int | None = None,
        nested: bool = False,
    ) -> Scorer:
        """Build the schemes of criteria.

        Parameters
        ----------
        criteria : sequence of str, or mapping of str to Scheme
            Names of criteria, or schemes by names that no criterion has.
        points : (n, 2) array
            Positions of the data.
        diagonal : float, optional
            Length of which ERxx is a percentage; the diagonal of the points' bounding box by default.
        seed : int
            Seed of the random schemes.
        threads : int, optional
            Largest number of threads.
        nested : bool, default False
            Whether the scorer is for nested models, which need no lists of neighbours.

        Raises
        ------
        ValueError, TypeError
            If no criterion has a name or it does not suit the data, or a scheme has the name of a criterion.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> mx.criteria.Scorer.of({"pairs": mx.schemes.from_sets([[0, 1], [2, 3]])}, np.eye(4, 2))
        Scorer(pairs)
        """
        check.generator(seed)
        points = check.points(points, "points", dimension=None)
        size = _diagonal(points) if diagonal is None else diagonal
        return cls.over(criteria, Domain(points, size, None, seed, check.threads(threads)), nested)

    @classmethod
    def over(
        cls,
        criteria: Sequence[str] | Mapping[str, Scheme],
        domain: Domain,
        nested: bool = False,
        argument: str = "criteria",
    ) -> Scorer:
        """Build the schemes of criteria over a domain, see `of`; messages name the argument that has the criteria."""
        rule = "It must be a list of names, or schemes by name."
        if isinstance(criteria, Mapping):
            _check_own_schemes(criteria, len(domain.points), rule)
            return cls(dict.fromkeys(criteria), dict(criteria))
        parsed = {
            c.name: c for c in (parse(name, argument) for name in check.items(criteria, argument, rule))
        }
        lazy = NEIGHBOURHOODS if nested else {}
        near = {c.name: _made(lazy, c, domain, argument) for c in parsed.values() if c.family in lazy}
        rest = {name: c for name, c in parsed.items() if c.family in SCHEMES and name not in near}
        return cls(
            dict(parsed), {name: _made(SCHEMES, c, domain, argument) for name, c in rest.items()}, near
        )

    def __or__(self, other: Scorer) -> Scorer:
        return Scorer(
            self.criteria | other.criteria,
            self.schemes | other.schemes,
            self.neighbourhoods | other.neighbourhoods,
        )

    def __repr__(self) -> str:
        return f"Scorer({', '.join(self.criteria)})"

    def scores(self, model: LeastSquares, threads: int | None = None) -> dict[str, Score]:
        """Score a model by every criterion; all scores are undefined if the data do not determine the model.

        Parameters
        ----------
        model : LeastSquares
            A model of the data at the points.
        threads : int, optional
            Largest number of threads.

        Returns
        -------
        dict of str to Score
            Scores by the names of the criteria.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> model = mx.LeastSquares([[1.0], [1.0], [1.0]], [1.0, 3.0, 5.0])
        >>> scores = mx.criteria.Scorer.of(["FIT", "CMPRESS"], np.eye(3, 2)).scores(model)
        >>> {name: round(score.value, 3) for name, score in scores.items()}
        {'FIT': 1.633, 'CMPRESS': 2.449}
        """
        if model.rank < len(model.coefficients):
            lost = Score(math.nan, np.arange(model.n_data))
            return dict.fromkeys(self.criteria, lost)
        predictions = cross_validate_all(model, self.schemes, threads)
        r = model.residuals.size // len(model.residuals)
        fit = FitSummary(model.fit_rms, r * float(model.leverage.sum()), model.residuals.size, model.n_data)
        datum = datum_of_row(model)
        scores = {}
        for name, criterion in self.criteria.items():
            if name in predictions:
                cv = predictions[name]
                pairs = self.schemes[name].validated
                data = [pairs[pair] for pair in cv.undefined]
                scores[name] = Score(
                    cv.score,
                    np.unique(np.concatenate([*data, cv.undefined[:0]])),
                    _sizes(cv.residuals, datum[cv.rows], model.n_data),
                )
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
        on_step: Callable[[], None] | None = None,
    ) -> dict[str, list[Score]]:
        """Score every model of a nested design by every criterion, in one sweep.

        Parameters
        ----------
        nested : Nested
            From `mexpress.leastsquares.nested`, over the data at the points.
        sizes : (k,) int64 array
            Numbers of columns of the models, increasing.
        threads : int, optional
            Largest number of threads.
        on_step : callable, optional
            Called as progress is made, `mexpress.leastsquares.nested.steps` times.

        Returns
        -------
        dict of str to list of Score
            One score per size, by the names of the criteria.

        Examples
        --------
        >>> from mexpress.criteria import Scorer
        >>> from mexpress.leastsquares.nested import Nested
        >>> import numpy as np
        >>> nested = Nested([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]], [1.0, 3.0, 5.0])
        >>> curves = Scorer.of(["FIT", "CMPRESS"], np.eye(3, 2)).curves(nested, np.array([1, 2]))
        >>> [round(score.value, 3) + 0.0 for score in curves["CMPRESS"]]
        [2.449, 0.0]
        """
        every: dict[str, Scheme] = {**self.schemes, **self.neighbourhoods}
        for scheme in every.values():
            if scheme.n_data != nested.n_data:
                rule = f"It must be over the criteria's {scheme.n_data} data."
                check.refuse("nested", rule, f"{nested.n_data} data")
        fits = nested.fits(sizes, threads)
        curves = nested.curves(every, sizes, threads, on_step)
        scores = {}
        for name, criterion in self.criteria.items():
            if name in curves:
                scores[name] = _scored(curves[name], every[name].validated)
            elif criterion is not None and criterion.family in FORMULAS:
                formula = FORMULAS[criterion.family]
                each = zip(fits.rms, fits.parameters, strict=True)
                r = nested.n_responses
                models = (
                    FitSummary(float(e), r * float(k), r * nested.n_rows, nested.n_data) for e, k in each
                )
                scores[name] = [Score(formula(model), np.zeros(0, dtype=np.int64)) for model in models]
            else:
                rows = IndexSets(np.arange(nested.n_rows + 1), datum_of_row(nested))
                scores[name] = _scored(nested.press(sizes, threads), rows)
        # As in `scores`: models that the data do not determine have no score.
        for k in np.flatnonzero(fits.rank < sizes):
            for curve in scores.values():
                curve[k] = Score(math.nan, np.arange(nested.n_data))
        return scores


def _check_own_schemes(criteria: Mapping[str, Scheme], n: int, rule: str) -> None:
    for name, scheme in criteria.items():
        if not (isinstance(name, str) and isinstance(scheme, Scheme)):
            check.refuse("criteria", rule, check.describe({name: scheme}), TypeError)
        if scheme.n_data != n:
            check.refuse(
                "criteria", f"Its schemes must be over the {n} data.", f"{name!r} over {scheme.n_data} data"
            )
        if _find(name) is not None:
            own = "A scheme of one's own must not have the name of a criterion."
            check.refuse("criteria", own, check.describe(name))


def _scored(curve: NestedCurve, validated: IndexSets) -> list[Score]:
    """Scores of all models, with the validated data of the undefined pairs."""
    scores = []
    for k, value in enumerate(curve.scores):
        lost = np.flatnonzero(curve.defined <= k)
        data = [validated[pair] for pair in lost]
        scores.append(Score(float(value), np.unique(np.concatenate([*data, lost[:0]]))))
    return scores


def _sizes(residuals: Floats, datum: Integers, n: int) -> Floats:
    """Root of the sum of squares of every datum's residuals, free of overflow; (n,)."""
    largest = float(np.abs(residuals).max(initial=0.0))
    if largest == 0.0 or not np.isfinite(largest):
        return np.full(n, largest)
    squares = ((residuals.reshape(len(datum), -1) / largest) ** 2).sum(axis=1)
    return np.asarray(largest * np.sqrt(np.bincount(datum, squares, n)))


def _press(model: LeastSquares, threads: int | None) -> Score:
    found = leave_row_out(model, threads)
    return Score(found.score, np.unique(datum_of_row(model)[found.undefined]))


def _made(
    builders: Mapping[str, Callable[[float, Domain], Made]], criterion: Criterion, domain: Domain, name: str
) -> Made:
    try:
        return builders[criterion.family](criterion.amount, domain)
    except (ValueError, OverflowError) as error:  # the number in a name may have any number of digits
        refusal = re.fullmatch(r"Invalid (\w+)\. (.*) Given (.*)\.", str(error))
        unnamed = "the number", "It must suit the data.", f"{len(domain.points)} data"
        argument, rule, given = refusal.groups() if refusal else unnamed
        rule = rule.replace("It must", f"{argument} must", 1)
        check.refuse(name, f"In {criterion.name}, {rule[0].lower()}{rule[1:]}", given)


if not TYPE_CHECKING:  # otherwise a type checker accepts any attribute

    def __getattr__(name: str) -> Any:
        if name == "Judge":
            warnings.warn("criteria.Judge is now criteria.Scorer.", DeprecationWarning, stacklevel=2)
            return Scorer
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
