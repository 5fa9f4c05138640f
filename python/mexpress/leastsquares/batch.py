"""Many small least-squares problems, fitted and cross-validated in one call of the core."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _core
from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.index_sets import IndexSets
from mexpress.leastsquares.cross_validation import CrossValidation, RankLossWarning
from mexpress.leastsquares.problems import Kind, Problems, Schemes, kinds_of
from mexpress.schemes import Scheme


@dataclass(frozen=True, eq=False, repr=False)
class BatchCrossValidation(Sequence[CrossValidation]):
    """The fits of many problems, and how they predict what a scheme holds out; item i is the result of problem i.

    Parameters
    ----------
    scores : (k,) array
        P of each problem, in the responses' unit; NaN where a pair is undefined.
    fit_rms : (k,) array
        E of each problem, the root mean square residual of its fit.
    ranks : (k,) int64 array
        Rank of each design.
    coefficients : (k, p) or (k, p, r) array, or list of k arrays
        The solutions; a list if the problems were given as a list.
    residuals : (k, t) or (k, t, r) array, or list of k arrays
        Prediction residuals of the validated rows, pair after pair; a list if problems or schemes were given as lists.
    undefined : IndexSets
        Of each problem, the pairs whose training rows lose rank; usually empty.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> batch = mx.cross_validate_batch(np.ones((2, 3, 1)), [[1, 2, 6], [3, 3, 3]], mx.schemes.leave_one_out(3))
    >>> batch
    BatchCrossValidation(2 problems, 0 of them undefined)
    >>> batch[0]
    CrossValidation(score=3.24037, 3 residuals, 0 undefined pairs)
    """

    scores: Floats
    fit_rms: Floats
    ranks: Integers
    coefficients: Floats | list[Floats]
    residuals: Floats | list[Floats]
    undefined: IndexSets
    _kinds: list[Kind]
    _kind_of: Integers

    def __len__(self) -> int:
        return len(self.scores)

    def __getitem__(self, i: Any) -> Any:
        if isinstance(i, slice):
            return [self[j] for j in range(*i.indices(len(self)))]
        number = range(len(self))[i]
        kind = self._kinds[self._kind_of[number]]
        rows, pairs = kind.places
        return CrossValidation(
            float(self.scores[number]), self.residuals[number], rows, pairs, self.undefined[number]
        )

    def __repr__(self) -> str:
        return f"BatchCrossValidation({len(self)} problems, {np.count_nonzero(self.undefined.sizes)} of them undefined)"


def cross_validate_batch(
    A: ArrayLike | Sequence[ArrayLike],
    b: ArrayLike | Sequence[ArrayLike],
    scheme: Schemes,
    coupling: int | ArrayLike = 1,
    weights: ArrayLike | Sequence[ArrayLike] | None = None,
    *,
    threads: int | None = None,
) -> BatchCrossValidation:
    """Fit and cross-validate many problems, each as `LeastSquares` and its `cross_validate` would.

    Small problems of one shape are solved side by side, several in each vector of the processor, by Householder's
    reflections and equation (6); where one of them is close to rank loss it is solved as `LeastSquares` does.

    Parameters
    ----------
    A : (k, m, p) array, or list of k matrices
        Design matrices; those of a list may have any shapes.
    b : (k, m) or (k, m, r) array, or list of k arrays
        Responses of each problem.
    scheme : Scheme, list of k Schemes, or callable
        What is held out: the same of all problems, of each its own, or a function of the number of data, such as
        `mexpress.schemes.leave_one_out` itself.
    coupling : int or (m,) int array, default 1
        The number of consecutive rows per datum, or the datum of every row; the same in all problems.
    weights : (k, n) array, or list of k arrays, optional
        Positive weight of each datum; (n,) for the same in all problems of a stack, and None in a list for ones.
    threads : int, optional
        Largest number of threads; MEXPRESS_NUM_THREADS or all cores by default. The result does not depend on it.

    Returns
    -------
    BatchCrossValidation
        Scores, prediction residuals, coefficients, ranks. A score is NaN, with a `RankLossWarning`, if the training
        rows of a pair lose rank.

    Raises
    ------
    ValueError, TypeError
        If a shape does not fit, or an entry is not a finite number; the message names the problem.

    Examples
    --------
    Lines through 1,000 sets of 20 points, or through sets of 10 and of 15:

    >>> import mexpress as mx
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> x = rng.uniform(size=(1000, 20))
    >>> A = np.stack([np.ones_like(x), x], axis=-1)
    >>> mx.cross_validate_batch(A, x**2, mx.schemes.k_fold(20, 5, seed=0)).scores.mean().round(3)
    np.float64(0.081)
    >>> batch = mx.cross_validate_batch([A[0, :10], A[1, :15]], [x[0, :10], x[1, :15]], mx.schemes.leave_one_out)
    >>> [residuals.shape for residuals in batch.residuals]
    [(10,), (15,)]
    """
    given = Problems.of(A, b, coupling, weights)
    kinds, kind_of = kinds_of(given, scheme)
    counts = np.bincount(kind_of, minlength=len(kinds))
    members = np.split(np.argsort(kind_of, kind="stable"), np.cumsum(counts)[:-1])
    runs = [given.run(some, kind) for some, kind in zip(members, kinds, strict=True)]
    try:
        found = _core.cross_validate_batch(runs, check.threads(threads))
    except ValueError:
        given.refuse()
        raise
    undefined = _undefined(found[-1], members)
    if len(undefined.indices):
        lost = np.flatnonzero(undefined.sizes)
        which = f"{len(lost)} of {len(given)} problems lose rank in some pair"
        text = f"{which}, so there is no score: the first is {lost[0]}."
        warnings.warn(RankLossWarning(text), stacklevel=2)
    coefficients, residuals, *summaries = found[:-1]
    scores, fit_rms, ranks = (
        _in_order(np.split(each, np.cumsum(counts)[:-1]), members) for each in summaries
    )
    solved, predicted = zip(*_by_kind(coefficients, residuals, kinds, counts), strict=True)
    listed = isinstance(given.A, list)
    own_schemes = not (isinstance(scheme, Scheme) or callable(scheme))
    solutions = (_listed if listed else _in_order)(solved, members)
    predictions = (_listed if listed or own_schemes else _in_order)(predicted, members)
    return BatchCrossValidation(scores, fit_rms, ranks, solutions, predictions, undefined, kinds, kind_of)


def _undefined(found: tuple[Integers, Integers], members: list[Integers]) -> IndexSets:
    """Undefined pairs of each problem, from the places of problems as the core knows them, and pairs."""
    places, pairs = found
    problems = np.concatenate(members)[places]
    counts = np.bincount(problems, minlength=sum(map(len, members)))
    ends = np.concatenate([[0], np.cumsum(counts)])
    return IndexSets(ends, pairs[np.argsort(problems, kind="stable")])


def _by_kind(
    coefficients: Floats, residuals: Floats, kinds: list[Kind], counts: Integers
) -> Iterator[tuple[Floats, Floats]]:
    """Coefficients, (g, p) or (g, p, r), and residuals, (g, t) or (g, t, r), of the g problems of each kind."""
    for kind, count in zip(kinds, counts, strict=True):
        _, p, width, flat = kind.shape
        solved, coefficients = np.split(coefficients, [count * p * width])
        predicted, residuals = np.split(residuals, [count * kind.n_validated * width])
        if flat:
            yield solved.reshape(count, p), predicted.reshape(count, -1)
        else:
            turned = solved.reshape(count, width, p).transpose(0, 2, 1)
            yield np.ascontiguousarray(turned), predicted.reshape(count, -1, width)


def _in_order(pieces: Sequence[Any], members: list[Integers]) -> Any:
    """Results of all problems in one array, from those of each kind."""
    if len(pieces) == 1:
        return pieces[0]
    together = np.concatenate(pieces)
    arranged = np.empty_like(together)
    arranged[np.concatenate(members)] = together
    return arranged


def _listed(pieces: Sequence[Floats], members: list[Integers]) -> list[Floats]:
    """Results of all problems in a list, from those of each kind."""
    results = dict(
        zip(np.concatenate(members).tolist(), (row for piece in pieces for row in piece), strict=True)
    )
    return [results[i] for i in range(len(results))]
