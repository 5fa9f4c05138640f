"""Data in which something is missing: an error, unless their rows are to be dropped.

Dropped rows have weight 0 and stay among the data as NaN, so that indices are those of the rows that were given.

Examples
--------
>>> import mexpress as mx
>>> rng = np.random.default_rng(0)
>>> source = rng.uniform(0, 100, (40, 2))
>>> target = np.ma.array(source + np.sin(source / 30))
>>> target[3] = np.ma.masked
>>> target[7] += 20
>>> selection = mx.select_warp(source, target, missing="drop", robust=True)
>>> selection.left_out, 3 in selection.kept
(array([7]), False)
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress._validation import Floats

RAISE, DROP = "raise", "drop"

_RULE = f'Its entries must be finite and not masked; missing="{DROP}" leaves out the rows of others.'


def complete_rows(missing: str, **arrays: ArrayLike | None) -> NDArray[np.bool_] | None:
    """Return which rows of arrays have all of their numbers; None if all rows of all have.

    Parameters
    ----------
    missing : {"raise", "drop"}
        Whether rows with masked, NaN or infinite entries are an error.
    **arrays : array_like, (n, ...), or None
        Arrays by the names that messages call them.

    Raises
    ------
    ValueError, TypeError
        If something is missing that may not, or the lengths differ.

    Examples
    --------
    >>> complete_rows("drop", points=[[0, 1], [np.nan, 2]], values=[3, 4])
    array([ True, False])
    >>> complete_rows("drop", points=[[0, 1], [1, 2]], values=[3, 4])
    """
    if not isinstance(missing, str) or missing not in (RAISE, DROP):
        check.refuse("missing", 'It must be "raise" or "drop".', check.describe(missing))
    given = {name: array for name, array in arrays.items() if array is not None}
    if missing == RAISE:
        for name, array in given.items():
            if np.ma.is_masked(array):
                check.refuse(name, _RULE, f"{np.ma.getmaskarray(np.ma.asarray(array)).sum()} masked entries")
            if np.ndim(numbers := check.real(array, name)):
                check.finite(numbers, name, _RULE)
        return None
    tables = {name: _unmasked(array, name) for name, array in given.items()}
    first, *others = tables
    for name in others:
        if len(tables[name]) != len(tables[first]):
            rule = f"It must have as many rows as {first}."
            check.refuse(name, rule, f"{len(tables[name])} for {len(tables[first])}")
    known = check.whole_rows(**tables)
    return None if known.all() else known


def _unmasked(array: ArrayLike, name: str) -> Floats:
    """Return a table of numbers, NaN where they are masked."""
    numbers: Floats = check.real(_beneath(array), name)
    if numbers.ndim == 0:
        check.refuse(name, "It must be an array with a row for each datum.", check.describe(array))
    if np.ma.is_masked(array):
        numbers = np.where(np.ma.getmaskarray(np.ma.asarray(array)), np.nan, numbers)
    return np.asarray(check.as_rows(numbers))


def filled(array: Any, known: NDArray[np.bool_]) -> Any:
    """Return an array with its first known row in place of those that are not, so that messages count all rows.

    Examples
    --------
    >>> filled([np.nan, 5, 6], np.array([False, True, True]))
    array([5., 5., 6.])
    """
    rows: Floats = check.as_rows(check.real(_beneath(array), "data").copy())
    rows[~known] = rows[known.argmax()]
    return rows


def filled_weights(weights: Any, known: NDArray[np.bool_]) -> Any:
    """Return the weights of all rows: 0 for those that are not known."""
    rows = np.ones(len(known)) if weights is None else check.real(_beneath(weights), "weights").copy()
    rows[~known] = 0
    return rows


def _beneath(array: Any) -> Any:
    """Return an array without its mask."""
    return array.data if isinstance(array, np.ma.MaskedArray) else array


def spread(array: Floats, known: NDArray[np.bool_]) -> Floats:
    """Return an array of the rows that are known among the others, which are NaN.

    Examples
    --------
    >>> spread(np.array([5.0, 6]), np.array([True, False, True]))
    array([ 5., nan,  6.])
    """
    all_rows = np.full((len(known), *array.shape[1:]), np.nan)
    all_rows[known] = array
    return all_rows
