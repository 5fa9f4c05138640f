"""Linear fits without sets of the data, of any rank: where data do not determine coefficients, the shortest are taken.

A triangle R of the rows ``[1, X, y]``, ``R^T R`` being their squares and products, has all that a fit needs. That of
all rows but one set is found by halves: the triangle of the rows in no set gains those that only the other half of the
sets holds out, and so on. All triangles take about as long as that of all rows times the logarithm of their number.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mexpress._validation import Floats, Integers

_SHORT = 1e-6
"""Share of the longest feature below which the norm does not depend on a feature's unit, which would cost digits."""


@dataclass(frozen=True, eq=False)
class LinearFit:
    """Coefficients (p, r) and constants (r,) of features and responses that are shifted by (p,) and (r,).

    Examples
    --------
    >>> fit = LinearFit(np.array([[2.0]]), np.array([1.0]), np.array([100.0]), np.array([0.0]))
    >>> fit.predict(np.array([[103.0]])), fit.intercept
    (array([[7.]]), array([-199.]))
    """

    coefficients: Floats
    constants: Floats
    X_shift: Floats
    y_shift: Floats

    def predict(self, X: Floats) -> Floats:
        """Predict the responses, (k, r), of features, (k, p)."""
        return np.asarray((X - self.X_shift) @ self.coefficients + self.constants + self.y_shift)

    @property
    def intercept(self) -> Floats:
        """Constants for features and responses that are not shifted, (r,)."""
        return np.asarray(self.constants + self.y_shift - self.X_shift @ self.coefficients)


def fits_without(
    X: Floats,
    y: Floats,
    weights: Floats | None,
    alpha: float,
    fit_intercept: bool,
    held: Sequence[Integers],
) -> Iterator[tuple[Floats, Floats]]:
    """Minimise ``sum w ||y - X c - c_0||^2 + alpha ||c||^2`` without each of some sets of the data.

    Where many coefficients do, ``||c||`` is minimised too. Rank is that of columns, the ones of the constant first, at
    unit length, so that it does not depend on units. The norm does: it is that of the coefficients as they are, but for
    features shorter than a millionth of the longest, which count as if they had a millionth.

    Parameters
    ----------
    X, y : (n, p) and (n, r) arrays
        Features and responses.
    weights : (n,) array or None
        Weights of the data, above 0.
    alpha : float
        Weight of the ridge.
    fit_intercept : bool
        Whether there is a constant; it is 0 otherwise.
    held : list of (q,) int arrays
        Data that are left out.

    Yields
    ------
    coefficients, constants : (p, r) and (r,) arrays

    Examples
    --------
    >>> X = np.array([[0.0, 0.0], [1.0, 2.0], [2.0, 4.0], [0.0, 9.0]])
    >>> for coefficients, constants in fits_without(X, X[:, :1] + 5, None, 0.0, True, [np.array([3]), np.array([2])]):
    ...     print(coefficients.ravel().round(6), constants.round(6))
    [0.2 0.4] [5.]
    [1. 0.] [5.]
    """
    (n, p), ones = X.shape, int(fit_intercept)
    sizes = _or_one(np.maximum(np.abs(X).max(axis=0), np.sqrt(alpha)))  # before squares overflow
    rows = np.hstack([np.ones((n, ones)), X / sizes, y])
    if weights is not None:
        rows *= np.sqrt(weights)[:, None]
    ridge = np.diag(np.sqrt(alpha) / sizes) if alpha > 0 else np.zeros((0, p))
    tolerance = max(n + len(ridge), p) * np.finfo(np.float64).eps
    for triangle in _without(rows, held, rows[:0], np.arange(n)):
        yield _solved(triangle, ridge, ones, sizes, tolerance)


def _without(rows: Floats, held: Sequence[Integers], triangle: Floats, missing: Integers) -> Iterator[Floats]:
    """Yield the triangles of the rows without each set, from that of the rows that are not missing."""
    if not held:
        return
    kept = np.unique(np.concatenate(held))
    added = rows[np.setdiff1d(missing, kept, assume_unique=True)]
    more = np.asarray(np.linalg.qr(np.vstack([triangle, added]), mode="r"))
    if len(held) == 1:
        yield more
    else:
        for half in (held[: len(held) // 2], held[len(held) // 2 :]):
            yield from _without(rows, half, more, kept)


def _solved(
    triangle: Floats, ridge: Floats, ones: int, sizes: Floats, tolerance: float
) -> tuple[Floats, Floats]:
    """Coefficients and constants of a triangle of ones, features over their sizes, and responses."""
    p = len(sizes)
    columns, responses = triangle[:, ones : ones + p], triangle[:, ones + p :]
    centred = columns[ones:]
    constant = np.linalg.norm(centred, axis=0) <= tolerance * np.linalg.norm(columns, axis=0)
    penalised = np.vstack([np.where(constant, 0.0, centred), ridge])
    lengths = _or_one(np.hypot(np.linalg.norm(columns, axis=0), np.linalg.norm(ridge, axis=0)))
    left, values, right = np.linalg.svd(penalised / lengths, full_matrices=False)
    rank = int((values > tolerance * max(ones, values.max(initial=0.0))).sum())
    solution = (left[: len(centred), :rank].T @ responses[ones:]) / values[:rank, None]
    lengths = lengths * sizes
    units = np.minimum(1.0, lengths / (_SHORT * lengths.max()))
    longest_first = np.argsort(-lengths / units)  # or a QR decomposition loses digits of short rows
    across = np.linalg.qr((lengths / units)[longest_first, None] * right[:rank, longest_first].T)
    coefficients = np.empty((p, responses.shape[1]))
    coefficients[longest_first] = across.Q @ np.linalg.solve(across.R.T, solution)
    coefficients /= units[:, None]
    if not ones:
        return coefficients, np.zeros(responses.shape[1])
    rest = responses[0] - columns[0] @ (coefficients * sizes[:, None])
    return coefficients, rest / triangle[0, 0]


def _or_one(lengths: Floats) -> Floats:
    return np.where(lengths > 0, lengths, 1.0)
