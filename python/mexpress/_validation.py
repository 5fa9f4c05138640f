"""Checks of what users hand in. A message says what is invalid, the rule, and what was given."""

from __future__ import annotations

import math
import operator
import os
from typing import Any, NoReturn, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _core

Floats: TypeAlias = NDArray[np.float64]
Integers: TypeAlias = NDArray[np.int64]


# Squares and products of coordinates must not overflow.
LARGEST_COORDINATE = 1e100


def refuse(name: str, rule: str, given: str, error: type[Exception] = ValueError) -> NoReturn:
    """Raise the error that all checks share."""
    raise error(f"Invalid {name}. {rule} Given {given}.")


def describe(value: object) -> str:
    """What was given, in a few words."""
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape} and type {value.dtype}"
    text = repr(value)
    return text if len(text) <= 60 else f"{type(value).__name__} {text[:50]}..."


def real(value: ArrayLike, name: str) -> Floats:
    """Float64 array in C order; of real numbers, without masked entries."""
    rule = "It must be an array of real numbers."
    if isinstance(value, np.ma.MaskedArray) and np.ma.getmaskarray(value).any():
        refuse(name, rule, f"{np.ma.getmaskarray(value).sum()} masked entries")
    try:
        array = np.asarray(value)
    except (ValueError, TypeError):
        refuse(name, rule, describe(value), TypeError)
    if array.dtype.kind not in "biuf" and array.size > 0:
        refuse(name, rule, describe(value), TypeError)
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(array, dtype=np.float64).reshape(array.shape)


def finite(array: Floats, name: str) -> Floats:
    """The array itself, or where its first entry stands that is NaN or infinite."""
    rows = array.reshape(len(array), -1) if array.size else array.reshape(0, 1)
    place = _core.find_not_finite(rows)
    if place is not None:
        row, column = place
        where = f"row {row}" if array.ndim == 1 else f"row {row}, column {column}"
        refuse(name, "Its entries must be finite.", f"{rows[place]} at {where}")
    return array


def matrix(value: ArrayLike, name: str) -> Floats:
    """Finite matrix with at least one row and one column."""
    array = real(value, name)
    if array.ndim != 2 or array.size == 0:
        rule = "It must be a matrix with at least one row and one column."
        refuse(name, rule, f"shape {array.shape}")
    return finite(array, name)


def columns(value: ArrayLike, name: str, rows: int) -> Floats:
    """Finite (rows,) or (rows, r) array, r at least one."""
    array = real(value, name)
    if array.ndim not in (1, 2) or array.size == 0 or len(array) != rows:
        refuse(name, f"It must have shape ({rows},) or ({rows}, r).", f"shape {array.shape}")
    return finite(array, name)


def points(value: ArrayLike, name: str, dimension: int | None = 2) -> Floats:
    """Finite points (n, dimension), at least one; one to three coordinates if dimension is None."""
    array = real(value, name)
    if dimension is None and array.ndim == 2 and 1 <= array.shape[1] <= 3:
        dimension = array.shape[1]
    if array.ndim != 2 or array.shape[1] != dimension or len(array) == 0:
        shape = f"(n, {dimension})" if dimension else "(n, 1), (n, 2) or (n, 3)"
        refuse(name, f"It must be points of shape {shape}, at least one.", f"shape {array.shape}")
    largest = float(np.abs(finite(array, name)).max())
    if largest > LARGEST_COORDINATE:
        refuse(name, f"Coordinates must not exceed {LARGEST_COORDINATE:g}.", f"{largest:g}")
    return array


def indices(value: ArrayLike, name: str, bound: int | None = None) -> Integers:
    """Distinct indices from 0 to bound - 1, (k,)."""
    rule = "It must be a list of distinct indices."
    try:
        array = np.asarray(value)
    except (ValueError, TypeError):
        refuse(name, rule, describe(value), TypeError)
    if array.size == 0:
        return np.zeros(0, dtype=np.int64)
    if array.dtype.kind not in "iu":
        refuse(name, rule, describe(value), TypeError)
    low, high = int(array.min()), int(array.max())
    if bound is not None and high >= bound:
        refuse(name, f"Indices must be from 0 to {bound - 1}.", f"{high}")
    if low < 0:
        refuse(name, "Indices must not be negative.", f"{low}")
    if array.ndim != 1 or len(np.unique(array)) < len(array):
        refuse(name, rule, describe(value))
    return np.ascontiguousarray(array, dtype=np.int64)


def count(value: Any, name: str, low: int, high: int | None = None) -> int:
    """Whole number from low to high."""
    limits = f"of at least {low}" if high is None else f"from {low} to {high}"
    rule = f"It must be a whole number {limits}."
    try:
        number = operator.index(value)
    except TypeError:
        refuse(name, rule, describe(value), TypeError)
    if isinstance(value, bool | np.bool_):
        refuse(name, rule, describe(value), TypeError)
    if number < low or (high is not None and number > high):
        refuse(name, rule, describe(value))
    return number


def number(value: Any, name: str, rule: str, low: float, *, strict: bool = False) -> float:
    """Finite number of at least low, or above it."""
    if isinstance(value, str | bytes | bool | np.bool_):
        refuse(name, rule, describe(value), TypeError)
    try:
        result = float(value)
    except (TypeError, ValueError):
        refuse(name, rule, describe(value), TypeError)
    if not math.isfinite(result) or result < low or (strict and result == low):
        refuse(name, rule, describe(value))
    return result


def positive(value: Any, name: str) -> float:
    """Finite number above zero."""
    return number(value, name, "It must be a positive number.", 0.0, strict=True)


def image_size(value: Any) -> tuple[float, float] | None:
    """(width, height) in pixels, or None."""
    if value is None:
        return None
    rule = "It must be (width, height) in pixels."
    try:
        width, height = value
    except (TypeError, ValueError):
        refuse("image_size", rule, describe(value), TypeError)
    return (
        number(width, "image_size", rule, 0.0, strict=True),
        number(height, "image_size", rule, 0.0, strict=True),
    )


def threads(value: Any) -> int:
    """Number of threads: the argument, else MEXPRESS_NUM_THREADS, else what the process may use."""
    if value is not None:
        return min(count(value, "threads", 1), 1024)
    variable = os.environ.get("MEXPRESS_NUM_THREADS", "").strip()
    if variable:
        if not variable.isdecimal() or int(variable) == 0:
            refuse("MEXPRESS_NUM_THREADS", "It must be a whole number of at least 1.", repr(variable))
        return min(int(variable), 1024)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def generator(seed: Any) -> np.random.Generator:
    """Random numbers from a seed; None draws a fresh one."""
    try:
        return np.random.default_rng(seed)
    except (TypeError, ValueError):
        rule = "It must be None, a whole number of at least 0, or a numpy Generator."
        refuse("seed", rule, describe(seed), TypeError)
