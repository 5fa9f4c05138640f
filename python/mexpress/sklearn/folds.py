"""Splitters of scikit-learn as schemes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from sklearn.model_selection import LeaveOneOut, check_cv

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.schemes import Scheme, leave_one_out, scheme_of_splits


def scheme_of(cv: Any, X: Floats, y: Floats, groups: Any = None) -> Scheme:
    """Return what a splitter, a number of folds, or a list of (train, test) holds out and validates.

    Parameters
    ----------
    cv : int, splitter, Scheme, iterable of (train, test), or None
        As for `sklearn.model_selection.cross_val_score`, with masks and negative indices; None stands for five folds.
    X, y, groups
        What the splitter splits.

    Examples
    --------
    >>> scheme_of(2, np.zeros((4, 1)), np.zeros(4))
    Scheme(2 pairs over 4 data, 2 held out)
    """
    n = len(X)
    if isinstance(cv, Scheme):
        if cv.n_data != n:
            check.refuse("cv", f"It must be over the {n} data of X.", f"a scheme over {cv.n_data} data")
        scheme = cv
    elif isinstance(cv, str | bytes):  # bytes have a method "split"
        rule = "It must be a number of folds, a splitter, a Scheme, or an iterable of (train, test)."
        check.refuse("cv", rule, check.describe(cv), TypeError)
    elif isinstance(cv, LeaveOneOut):  # its n lists of training data take longer than all predictions
        scheme = leave_one_out(n)
    else:
        scheme = scheme_of_splits(_splits(cv, X, y, groups), n, "cv")
    if not len(scheme.validated.indices):
        rule = "It must validate a datum at least; a generator serves once."
        check.refuse("cv", rule, check.describe(cv))
    return scheme


def _splits(cv: Any, X: Floats, y: Floats, groups: Any) -> Iterator[Any]:
    """Yield the pairs of folds, a splitter or an iterable, which need not fit in memory, as indices from 0."""
    is_list = isinstance(cv, Iterable) and not hasattr(cv, "split")
    for split in cv if is_list else check_cv(cv, y).split(X, y, groups):
        yield [_from_zero(part, len(X)) for part in split] if isinstance(split, Iterable) else split


def _from_zero(part: Any, n: int) -> Any:
    """Indices of a mask, or of indices of which negative ones count from the end; anything else as it is."""
    given = check.array(part, "cv", "It must be a list of (train, test) index arrays.")
    if given.dtype == np.bool_ and given.shape == (n,):
        return np.flatnonzero(given)
    if given.dtype.kind == "i":
        indices = given.astype(np.int64, copy=False)
        return np.where((-n <= indices) & (indices < 0), indices + n, indices)
    return part


def expect_training(scheme: Scheme, weights: Floats | None) -> None:
    """Refuse a scheme with a pair that holds out all data, or all of weight above 0."""
    n, held = scheme.n_data, scheme.held_out
    if weights is not None:
        present = np.flatnonzero(weights)
        n, held = len(present), held.restricted(present, n)
    left = n - held.sizes
    if not left.all():
        rule = "Every split must leave training data, some of weight above 0."
        check.refuse("cv", rule, f"split {left.argmin()}, which leaves none")


def expect_partition(scheme: Scheme) -> None:
    """Refuse a scheme that does not validate every datum once."""
    times = np.bincount(scheme.validated.indices, minlength=scheme.n_data)
    if (times != 1).any():
        i = int((times != 1).argmax())
        rule = "It must validate every datum once for a prediction of each."
        check.refuse("cv", rule, f"a splitter that validates datum {i} {times[i]} times")
