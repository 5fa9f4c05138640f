"""Predictions of what a scheme holds out: their result, and its warnings."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.schemes import expect_scheme


class RankLossWarning(UserWarning):
    """Without some held-out set, the other rows no longer determine the model: predictions and score are NaN.

    Examples
    --------
    Only the third row has an entry in the second column:

    >>> import warnings
    >>> import mexpress as mx
    >>> model = mx.LeastSquares([[1.0, 0.0], [1.0, 0.0], [1.0, 1.0]], [1.0, 2.0, 6.0])
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     model.held_out_residuals([2])
    array([nan])
    >>> caught[0].message
    RankLossWarning('The other rows no longer determine the model.')
    """


@dataclass(frozen=True, eq=False, repr=False)
class CrossValidation:
    """The prediction residuals of a scheme and their score.

    Parameters
    ----------
    score : float
        P, in the responses' unit: ``P^2 = sum w ||e||^2 / sum w`` over the validated data; NaN if a pair is undefined.
    residuals : (k,) or (k, r) array
        Prediction residuals of the validated rows, pair after pair, in the responses' unit; NaN where undefined.
    rows : (k,) int64 array
        The row of the design of each residual.
    pairs : (k,) int64 array
        The pair of the scheme of each residual.
    undefined : int64 array
        The pairs whose training rows lose rank; usually empty.

    Examples
    --------
    >>> import mexpress as mx
    >>> model = mx.LeastSquares([[1.0], [1.0], [1.0]], [1.0, 2.0, 6.0])
    >>> model.cross_validate(mx.schemes.leave_one_out(3))
    CrossValidation(score=3.24037, 3 residuals, 0 undefined pairs)
    """

    score: float
    residuals: Floats
    rows: Integers
    pairs: Integers
    undefined: Integers

    def __repr__(self) -> str:
        counts = f"{len(self.rows)} residuals, {len(self.undefined)} undefined pairs"
        return f"CrossValidation(score={self.score:.7g}, {counts})"


def expect_scheme_of(n_data: int, scheme: Any) -> None:
    """Refuse a scheme that is not over a model's data."""
    expect_scheme(scheme, f"leave_one_out({n_data})")
    if scheme.n_data != n_data:
        rule = f"It must be over the model's {n_data} data."
        check.refuse("scheme", rule, f"a scheme over {scheme.n_data} data")


def warn_of_rank_loss(result: CrossValidation, pairs: int) -> None:
    """Warn of the pairs of a scheme that are undefined."""
    where = "the attribute 'undefined' of the result lists them, the first is"
    warn_of_loss(result.undefined, pairs, "pairs", where, 4)


def warn_of_loss(lost: Integers, total: int, what: str, where: str, level: int = 3) -> None:
    """Warn of pairs or rows that lose rank, if there are any."""
    if len(lost):
        text = (
            f"{len(lost)} of {total} {what} lose rank when held out, so there is no score: {where} {lost[0]}."
        )
        warnings.warn(RankLossWarning(text), stacklevel=level)
