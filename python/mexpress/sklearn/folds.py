"""Splitters of scikit-learn as schemes."""

from __future__ import annotations

from typing import Any

import numpy as np
from sklearn.model_selection import LeaveOneOut, check_cv

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.schemes import Scheme, from_splits, leave_one_out


def scheme_of(cv: Any, X: Floats, y: Floats, groups: Any = None) -> Scheme:
    """Return what a splitter, a number of folds, or a list of (train, test) holds out and validates.

    Parameters
    ----------
    cv : int, splitter, Scheme, iterable of (train, test), or None
        As for `sklearn.model_selection.cross_val_predict`; None stands for five folds.
    X, y, groups
        What the splitter splits.

    Examples
    --------
    >>> scheme_of(2, np.zeros((4, 1)), np.zeros(4))
    Scheme(2 pairs over 4 data, 2 held out)
    """
    if isinstance(cv, Scheme):
        if cv.n_data != len(X):
            check.refuse("cv", f"It must be over the {len(X)} data of X.", f"a scheme over {cv.n_data} data")
        return cv
    if isinstance(cv, LeaveOneOut):  # its n lists of training data take longer than all predictions
        return leave_one_out(len(X))
    return from_splits(check_cv(cv, y).split(X, y, groups), len(X))


def expect_partition(scheme: Scheme) -> None:
    """Refuse a scheme that does not validate every datum once."""
    times = np.bincount(scheme.validated.indices, minlength=scheme.n_data)
    if (times != 1).any():
        i = int((times != 1).argmax())
        rule = "It must validate every datum once for a prediction of each."
        check.refuse("cv", rule, f"a splitter that validates datum {i} {times[i]} times")
