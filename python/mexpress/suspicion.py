"""Suspicious data: wrong matches and wrong depths, which disagree with the predictions from their neighbourhoods."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.leastsquares.model import LeastSquares, cross_validate_all
from mexpress.schemes import Scheme

LEFT_OUT = 1e-8
"""Weight of a datum that is predicted like any other, but does not influence the fit."""

KEPT_AT_FIRST = 0.5

ROUNDING = 1e-7
"""Smallest sigma, as a fraction of the spread of the values."""

DOUBTFUL_SHARE = 0.4
DOUBTFUL_SCALE = 0.08
"""The result is doubtful if share / 0.4 + (sigma / spread) / 0.08 > 1: undetected wrong data increase sigma."""

UNSETTLED_SHARE = 0.05


class SuspicionWarning(UserWarning):
    """Too many data are suspicious, or predictions are too bad, to trust the suspects."""


@dataclass(frozen=True, eq=False, repr=False)
class Suspects:
    """Scores of all data against the predictions from their neighbourhoods, and the suspected data.

    Parameters
    ----------
    scores : (n,) array
        Studentised prediction residuals: the root mean square of each datum, in units of its standard deviation under
        noise; usually about 1. NaN where the other data do not determine a prediction.
    threshold : float
        Scores above it are suspicious.
    sigma : float
        Robust estimate of the standard deviation of the noise of a row, in the responses' unit. NaN if no datum of the
        fit has a score.
    spread : float
        Root mean square deviation of the values from their mean, in the same unit.
    rounds : int
        Number of models in the search.
    settled : bool
        Whether the last two rounds suspected the same data, up to a few.

    Examples
    --------
    >>> import numpy as np
    >>> from mexpress.suspicion import Suspects
    >>> found = Suspects(np.array([0.4, 9.0, 1.2, 31.0, 0.9, 0.5, 0.8]), 5.0, 0.7, 90.0, 4, True)
    >>> found
    Suspects(2 of 7 data above 5, sigma=0.7)
    >>> found.indices
    array([3, 1])
    >>> found.weights.round(2)
    array([0.99, 0.  , 0.89, 0.  , 0.94, 0.98, 0.95])
    """

    scores: Floats
    threshold: float
    sigma: float
    spread: float
    rounds: int
    settled: bool

    def __repr__(self) -> str:
        doubt = ", not to be trusted" if self.doubtful else ""
        suspected = f"{len(self.indices)} of {len(self.scores)} data above {self.threshold:g}"
        return f"Suspects({suspected}, sigma={self.sigma:.4g}{doubt})"

    @property
    def indices(self) -> Integers:
        """Indices of the suspected data, (k,), the worst first."""
        order = np.argsort(-self.scores, kind="stable")
        return np.asarray(order[self.scores[order] > self.threshold])

    @property
    def share(self) -> float:
        """Share of suspected data, from 0 to 1."""
        return len(self.indices) / len(self.scores)

    @property
    def doubt(self) -> str:
        """Reasons to doubt the result; empty if there are none.

        Examples
        --------
        >>> import numpy as np
        >>> from mexpress.suspicion import Suspects
        >>> found = Suspects(np.array([9.0, 9.0, 1.0, 0.5]), 5.0, 0.7, 90.0, 4, True)
        >>> found.doubt.split(". ")[1]
        'This is no RANSAC: it needs a clear majority that agrees'
        """
        if math.isnan(self.sigma):
            return "No datum of the fit has a score, so nothing tells the noise."
        beyond = self.sigma / self.spread if self.spread else 0.0
        if self.settled and self.share / DOUBTFUL_SHARE + beyond / DOUBTFUL_SCALE <= 1:
            return ""
        unsettled = "" if self.settled else ", and the rounds did not settle"
        return (
            f"{100 * self.share:.0f} % of the data are suspicious, sigma is {100 * beyond:.2g} % of the values' own "
            f"spread{unsettled}. This is no RANSAC: it needs a clear majority that agrees. Remove wrong data by other "
            "means first."
        )

    @property
    def doubtful(self) -> bool:
        """Whether `doubt` gives a reason."""
        return bool(self.doubt)

    @property
    def weights(self) -> Floats:
        """Weights for a refit, (n,): Tukey's bisquare of the scores, 1 at 0 and almost 0 from the threshold on.

        Data without a score have weight 1.
        """
        part = np.minimum(np.nan_to_num(self.scores) / self.threshold, 1.0)
        return np.asarray(np.maximum((1 - part**2) ** 2, LEFT_OUT))


def studentised_lengths(
    model: LeastSquares, scheme: Scheme, weights: Floats, threads: int | None = None
) -> tuple[Floats, Integers]:
    """Lengths of the prediction residuals of every datum, relative to their covariance under noise of variance one.

    Parameters
    ----------
    model : LeastSquares
        A fit with these weights.
    scheme : Scheme
        Validates every datum once, alone.
    weights : (n,) array
        1 for data in the fit, and almost 0 for other data; both are scored as data of weight one.
    threads : int, optional
        Largest number of threads.

    Returns
    -------
    lengths : (n,) array
        ``(e^T C^-1 e)^(1/2)`` with ``C = I + Q_T M^-1 Q_T^T``, summed over the responses; NaN where undefined. Their
        squares divided by the variance of the noise have a chi-square distribution.
    freedom : (n,) int array
        Its degrees of freedom: rows times responses of the datum.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> model = mx.LeastSquares([[1.0], [1.0], [1.0]], [1.0, 2.0, 6.0])
    >>> lengths, freedom = studentised_lengths(model, mx.schemes.leave_one_out(3), np.ones(3))
    >>> (lengths**2).round(3), freedom
    (array([ 6. ,  1.5, 13.5]), array([1, 1, 1]))
    """
    cv = cross_validate_all(model, {"": scheme}, threads)[""]
    residuals = cv.residuals.reshape(len(cv.rows), -1)
    starts = np.searchsorted(cv.pairs, np.arange(len(scheme) + 1))
    lengths, freedom = np.empty(len(scheme)), np.empty(len(scheme), dtype=np.int64)
    for pair, spread in enumerate(model.prediction_spread(scheme, threads)):
        datum, e = scheme.validated.indices[pair], residuals[starts[pair] : starts[pair + 1]]
        one = np.eye(len(e))
        # prediction_spread is the covariance of weighted residuals.
        unit = np.abs(e).max(initial=0.0) or 1.0  # squares of finite residuals need not be
        e = e / unit
        lengths[datum] = unit * np.sqrt((e * np.linalg.solve(one + (spread - one) / weights[datum], e)).sum())
        freedom[datum] = e.size
    return lengths, freedom


def deviation(values: Floats) -> float:
    """Return the root mean square deviation of values from their mean.

    Examples
    --------
    >>> f"{deviation(np.array([1e300, 3e300])):g}"
    '1e+300'
    """
    unit = np.abs(values).max(initial=0.0) or 1.0
    scaled = values / unit
    return float(unit * np.sqrt(((scaled - scaled.mean(axis=0)) ** 2).mean()))


def suspects(
    build: Callable[[Floats], LeastSquares],
    scheme: Scheme,
    values: ArrayLike,
    threshold: float = 5.0,
    max_rounds: int = 20,
    threads: int | None = None,
) -> Suspects:
    """Find the data that their neighbourhoods predict badly: wrong matches, wrong depths.

    Parameters
    ----------
    build : callable
        Returns a `LeastSquares` of all data with given weights, (n,): 1 for data in the fit, almost 0 for other data.
        Wrong data disturb the selection of a model as much as its fit, so `build` should select the model again each
        time, by a criterion with these weights.
    scheme : Scheme
        Validates every datum once, alone: `schemes.exclusion_radius`, `schemes.nearest`, or, if wrong data do not form
        clusters, `schemes.leave_one_out`.
    values : (n,) or (n, d) array
        Measurements in the unit of the responses: target points, depths. Predictions must be better than their spread.
    threshold : float, default 5
        Scores above it are suspicious. Gaussian noise exceeds 3 in 0.3 % of data with one row and one response, and in
        0.01 % of data with two; real data also have model error.
    max_rounds : int, default 20
        Largest number of models in each of the two stages below.
    threads : int, optional
        Largest number of threads.

    Returns
    -------
    Suspects
        The scores and the suspected data. A `SuspicionWarning` is issued if they are doubtful.

    Raises
    ------
    ValueError, TypeError
        If the scheme does not validate every datum once and alone, or a model has other data than the scheme.

    Notes
    -----
    The score of datum i is ``t_i^2 = e_(i)^T C_i^-1 e_(i) / (g r sigma^2)``, with its prediction residual e_(i), r
    responses of g rows, and ``C_i = ((I - H_KK)^-1)_TT``, the covariance of e_(i) under unit noise. sigma comes from
    the median over all data, which fails if half of the data are wrong.

    Wrong data mask each other, so there are two stages. The first fits the half of the data with the best scores and
    scores all data again, until the half is stable (the concentration steps of least trimmed squares). The second fits
    all data with scores below the threshold and scores all data again, until the suspects are stable.

    References
    ----------
    P. Rousseeuw, K. Van Driessen, "Computing LTS regression for large data sets", Data Mining and Knowledge
    Discovery, 2006.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> x = np.linspace(0, 1, 60)
    >>> y = np.sin(3 * x) + np.random.default_rng(0).normal(0, 0.01, 60)
    >>> y[[7, 30]] = 0.0
    >>> near = mx.schemes.exclusion_radius(x[:, None], 0.03)
    >>> found = suspects(lambda w: mx.LeastSquares(np.vander(x, 6), y, weights=w), near, y)
    >>> found.indices
    array([30,  7])
    """
    n = _each_once(scheme).n_data
    measured = check.columns(values, "values", n)
    spread = deviation(measured)
    limit = check.positive(threshold, "threshold")
    most = check.count(max_rounds, "max_rounds", 1)
    sigma, rounds = math.nan, 0

    def score(weights: Floats) -> Floats:
        nonlocal sigma, rounds
        rounds += 1
        lengths, freedom = studentised_lengths(_model(build, weights), scheme, weights, threads)
        # Residuals from rounding, or from the influence of data with weight LEFT_OUT, must not be suspicious.
        sigma = max(_robust_scale(lengths, freedom), ROUNDING * spread)
        return np.asarray(lengths / np.sqrt(freedom) / (sigma or 1.0))

    first = math.ceil(KEPT_AT_FIRST * n)
    scores, _ = _settle(score, np.ones(n), lambda scores: _best(scores, first), most)
    scores, settled = _settle(score, _as_weights(~(scores > limit)), lambda scores: ~(scores > limit), most)
    result = Suspects(scores, limit, sigma, spread, rounds, settled)
    if result.doubtful:
        warnings.warn(SuspicionWarning(result.doubt), stacklevel=2)
    return result


def _settle(
    score: Callable[[Floats], Floats], weights: Floats, keep: Callable[[Floats], Any], most: int
) -> tuple[Floats, bool]:
    """Score and keep in turn until the kept data repeat: the last scores, and whether almost no datum changed."""
    seen: set[bytes] = set()
    while len(seen) < most:
        seen.add(weights.tobytes())
        scores = score(weights)
        kept = _as_weights(keep(scores))
        changed = float((kept != weights).mean())
        if kept.tobytes() in seen:
            break
        weights = kept
    return scores, changed <= UNSETTLED_SHARE


def _as_weights(kept: Any) -> Floats:
    return np.where(kept, 1.0, LEFT_OUT)


def _best(scores: Floats, count: int) -> Any:
    """Mask of the smallest scores; equal scores are ordered by index."""
    kept = np.zeros(len(scores), dtype=np.bool_)
    kept[np.argsort(scores, kind="stable")[:count]] = True
    return kept


def _robust_scale(lengths: Floats, freedom: Integers) -> float:
    """Sigma from the median of the lengths over the roots of the medians of their chi squares."""
    known = np.isfinite(lengths)
    if not known.any():
        rule = "Its models must be determined by all data but those around one."
        check.refuse("build", rule, "one that predicts no datum")
    return float(np.median(lengths[known] / np.sqrt(chi_square_quantile(0.5, freedom[known]))))


def chi_square_quantile(share: float, freedom: int | Integers) -> Any:
    """Return a quantile of a chi square (Wilson and Hilferty), within 3 % from the median to the 0.95 quantile.

    Examples
    --------
    >>> [round(float(chi_square_quantile(0.75, k)), 2) for k in (1, 2, 3)]
    [1.32, 2.76, 4.1]
    """
    spread = 2 / (9 * np.asarray(freedom))
    return freedom * (1 - spread + NormalDist().inv_cdf(share) * np.sqrt(spread)) ** 3


def _model(build: Callable[[Floats], LeastSquares], weights: Floats) -> LeastSquares:
    model = build(weights.copy())
    if not isinstance(model, LeastSquares):
        check.refuse("build", "It must return a LeastSquares.", check.describe(model), TypeError)
    return model


def _each_once(scheme: Any) -> Scheme:
    """Check that a scheme validates every datum once, alone."""
    rule = "It must validate every datum once, alone, as schemes.exclusion_radius does."
    if not isinstance(scheme, Scheme):
        check.refuse("scheme", rule, check.describe(scheme), TypeError)
    alone = (scheme.validated.sizes == 1).all() and len(scheme) == scheme.n_data
    if not alone or len(np.unique(scheme.validated.indices)) < scheme.n_data:
        check.refuse("scheme", rule, repr(scheme))
    return scheme
