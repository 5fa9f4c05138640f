"""Checks of arguments. Every message names what is invalid, the rule, and the given value."""

from __future__ import annotations

import difflib
import errno
import math
import numbers
import operator
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NoReturn, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _core

Floats: TypeAlias = NDArray[np.float64]
Integers: TypeAlias = NDArray[np.int64]


# Squares and products of coordinates must not overflow.
LARGEST_COORDINATE = 1e100

# Residuals, which may exceed the responses, must not overflow either.
LARGEST_RESPONSE = 1e303

# Parameters of a B-spline, which may exceed the values by far, are averaged to these; derivatives are multiples.
LARGEST_PARAMETER = 1e306

LARGEST_INDEX = 2**63 - 1

# To Python and NumPy, these are numbers.
_TRUTH = (bool, np.bool_)


def refuse(name: str, rule: str, given: str, error: type[Exception] = ValueError) -> NoReturn:
    """Raise the error of all checks."""
    raise error(f"Invalid {name}. {rule} Given {given}.")


def describe(value: object) -> str:
    """A short description of a given value, in one line."""
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape} and type {value.dtype}"
    shape = getattr(value, "shape", None)
    if shape and isinstance(shape, tuple):  # of a tensor or a table of another library
        return f"{type(value).__name__} of shape {tuple(shape)}"
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{type(value).__name__} {text[:50]}..."


def nearest_name(value: object, names: Iterable[str]) -> str:
    """A question that follows the rule for names, if the given one is nearly one or two of them; else nothing.

    Examples
    --------
    >>> nearest_name("Spline", ["tps", "bspline"]), nearest_name("poly", ["tps", "bspline"])
    (' Is it bspline?', '')
    """
    known = {name.lower(): name for name in names}
    given = str(value).strip().lower()
    near = [given] if given in known else difflib.get_close_matches(given, known, 2)
    return f" Is it {' or '.join(known[name] for name in near)}?" if near else ""


def path(value: Any, name: str = "path") -> Path:
    """Name of a file."""
    rule = "It must be the name of a file, as a str or a Path."
    try:
        given = Path(value)
    except TypeError:
        refuse(name, rule, describe(value), TypeError)
    if not given.name and str(value):  # such as "." and "/"
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(value))
    if not given.name:
        refuse(name, rule, repr(value))
    return given


def array(value: ArrayLike, name: str, rule: str, kinds: str | None = None) -> NDArray[Any]:
    """Array without masked entries and, unless it is empty, of one of numpy's kinds of types."""
    if isinstance(value, np.ma.MaskedArray) and np.ma.getmaskarray(value).any():
        refuse(name, rule, f"{np.ma.getmaskarray(value).sum()} masked entries")
    try:
        result = np.asarray(value)
    except (
        ValueError,
        TypeError,
        RuntimeError,
    ) as error:  # what others' arrays raise, such as tensors on a GPU
        refuse(name, rule, _no_array(value, error), TypeError)
    if result.dtype.kind == "O" and hasattr(value, "to_numpy"):
        result = _of_nullable(value, result)
    if kinds is not None and result.dtype.kind not in kinds and result.size > 0:
        refuse(name, rule + _CONVERT.get(result.dtype.kind, ""), _no_number(value, result), TypeError)
    return result


def _of_nullable(frame: Any, objects: NDArray[Any]) -> NDArray[Any]:
    """The numbers of a pandas frame or series with types that know NA, NaN for these; as it is if there is text."""
    if any(isinstance(entry, str) for entry in objects.flat):
        return objects
    try:
        return np.asarray(frame.to_numpy(dtype=np.float64, na_value=np.nan))
    except (TypeError, ValueError):
        return objects


_CONVERT = {
    "U": " Text is converted by astype(float), and a file must be read first.",
    "c": " Take real and imaginary parts as columns.",
}
"""How to make real numbers of other kinds of entries."""


def _no_array(value: Any, error: Exception) -> str:
    """Say why something is no array: rows of different lengths, or a reason of its own."""
    if hasattr(value, "__array__"):
        return f"{describe(value)}, which says: {str(error).strip().removesuffix('.')}"
    lengths = [len(row) if hasattr(row, "__len__") else 1 for row in items(value, "value", "")]
    for row, length in enumerate(lengths):
        if length != lengths[0]:
            return f"{lengths[0]} entries in row 0 and {length} in row {row}"
    return describe(value)


def _no_number(value: Any, array: NDArray[Any]) -> str:
    """Say which entry of an array of objects is no number, or that all are."""
    if array.dtype.kind != "O" or array.ndim == 0:
        return describe(value)
    for place, entry in np.ndenumerate(array):
        if not isinstance(entry, numbers.Real):
            return f"{describe(entry)} at {_place(place)}"
    return f"{describe(array)}, which astype(float) converts"


def _place(index: tuple[int, ...]) -> str:
    if len(index) > 2:
        return f"{list(index)}"
    return ", ".join(f"{name} {i}" for name, i in zip(("row", "column"), index, strict=False))


def real(value: ArrayLike, name: str) -> Floats:
    """Float64 array of real numbers, aligned and in C order."""
    numbers = array(value, name, "It must be an array of real numbers.", "biuf")
    if numbers.dtype != np.float64:
        with np.errstate(over="ignore"):
            numbers = numbers.astype(np.float64)
    return _in_order(numbers)


def _in_order(array: NDArray[Any]) -> NDArray[Any]:
    """The array, aligned and in C order; np.require takes longer to find that it is."""
    flags = array.flags
    return array if flags.c_contiguous and flags.aligned else np.require(array, None, ["C", "A"])


FINITE_RULE = "Its entries must be finite."


def finite(array: Floats, name: str, rule: str = FINITE_RULE) -> Floats:
    """The array itself, if all entries are finite; the message names the first other entry."""
    _largest(array, name, rule)
    return array


def _largest(array: Floats, name: str, rule: str = FINITE_RULE) -> float:
    """The largest absolute value of an array whose entries must be finite."""
    largest = _core.largest(array.reshape(-1))
    if math.isfinite(largest):
        return largest
    rows = array.reshape(len(array), -1)
    wrong = ~np.isfinite(rows)
    place = divmod(int(wrong.argmax()), rows.shape[1])
    others = int(wrong.any(axis=1).sum()) - 1
    more = f", and others in {others} more rows" if others else ""
    refuse(name, rule, f"{rows[place]} at {_place(place[: array.ndim])}{more}")


def matrix(value: ArrayLike, name: str) -> Floats:
    """Finite matrix with at least one row and one column."""
    array = real(value, name)
    if array.ndim != 2 or array.size == 0:
        rule = "It must be a matrix with at least one row and one column."
        refuse(name, rule, f"shape {array.shape}")
    return finite(array, name)


def columns(value: ArrayLike, name: str, rows: int, limit: float = LARGEST_RESPONSE) -> Floats:
    """Finite (rows,) or (rows, r) array within a limit, with r at least 1."""
    array = real(value, name)
    if array.ndim not in (1, 2) or array.size == 0 or len(array) != rows:
        remedy = ": transpose it" if array.ndim == 2 and array.shape[1] == rows else ""
        refuse(name, f"It must have shape ({rows},) or ({rows}, r){remedy}.", f"shape {array.shape}")
    return _bounded(array, name, "Its entries", limit)


def as_rows(array: NDArray[Any]) -> NDArray[Any]:
    """The array itself, but (n, 2) if it has the shape of OpenCV's points, (n, 1, 2) or (1, n, 2)."""
    return array.reshape(-1, 2) if array.ndim == 3 and 1 in array.shape[:2] and array.shape[2] == 2 else array


def whole_rows(**tables: Floats) -> NDArray[np.bool_]:
    """Which rows are finite in all of some tables, equally long and called by their names; there must be one."""
    known = np.logical_and.reduce(
        [np.isfinite(table).all(axis=tuple(range(1, table.ndim))) for table in tables.values()]
    )
    if len(known) and not known.any():
        refuse(next(iter(tables)), "There must be rows that are whole.", f"0 of {len(known)}")
    return np.asarray(known)


def points(value: ArrayLike, name: str, dimension: int | None = 2) -> Floats:
    """At least one finite point, (n, dimension); one to three coordinates if dimension is None; OpenCV's shapes too."""
    _expect_order(value, name)
    array: Floats = as_rows(real(value, name))
    if dimension is None and array.ndim == 2 and 1 <= array.shape[1] <= 3:
        dimension = array.shape[1]
    if array.ndim != 2 or array.shape[1] != dimension or len(array) == 0:
        shape = f"(n, {dimension})" if dimension else "(n, 1), (n, 2) or (n, 3)"
        rule = f"It must be points of shape {shape}, at least one{_as_points(array.shape, dimension)}."
        refuse(name, rule, f"shape {array.shape}" if array.ndim else describe(value))
    return _bounded(array, name, "Coordinates", LARGEST_COORDINATE)


def queries(value: ArrayLike, name: str) -> Floats:
    """Positions in the plane where a model is asked, (k, 2), k from 0 on: one that is not known is a row of NaN.

    Infinite ones and those beyond the largest coordinate are not known either, since models map points to such places:
    what one model returns, any other takes.
    """
    _expect_order(value, name)
    array: Floats = as_rows(real(value, name))
    if array.ndim != 2 or array.shape[1] != 2:
        refuse(
            name,
            f"They must be positions of shape (k, 2){_as_points(array.shape, 2)}.",
            f"shape {array.shape}",
        )
    known = np.asarray((np.abs(array) <= LARGEST_COORDINATE).all(axis=1))
    return array if known.all() else np.where(known[:, None], array, np.nan)


def _expect_order(value: Any, name: str) -> None:
    """Refuse a frame of y and x: columns are taken as they stand."""
    first, *rest = (str(column).strip().lower() for column in getattr(value, "columns", ["x"]))
    if len(rest) == 1 and first.startswith("y") and rest[0].startswith("x"):
        rule = f"Columns are taken as they stand, x first: [[{value.columns[1]!r}, {value.columns[0]!r}]] turns them."
        refuse(name, rule, f"{value.columns[0]}, {value.columns[1]}")


def axes_of(value: Any) -> tuple[str, str] | None:
    """What the two columns of a frame are called; None for what has no names."""
    names = [str(column) for column in getattr(value, "column_names", getattr(value, "columns", ()))]
    return (names[0], names[1]) if len(names) == 2 else None


def _as_points(shape: tuple[int, ...], dimension: int | None) -> str:
    """Say how to make points of an array of another shape, if that is clear."""
    width = dimension or 3
    if len(shape) == 1 and shape[0] == dimension:
        return ": one point is [[x, y]]" if dimension == 2 else ": one point is [[x, y, z]]"
    if len(shape) == 1 and shape[0] > width:
        return ": np.column_stack([x, y]) makes them of coordinates" if dimension == 2 else ""
    if len(shape) != 2 or shape[1] <= width:
        return ""
    if shape[0] in (dimension, width):
        return ": transpose it, a row is a point"
    if shape[1] == 4 and dimension == 2:
        return ": of matches in a table, source is table[:, :2] and target table[:, 2:]"
    return ": take the columns x and y alone" if shape[1] == 3 else ""


def _bounded(array: Floats, name: str, what: str, limit: float) -> Floats:
    """The array itself, if it is finite and does not exceed a limit."""
    largest = _largest(array, name)
    if largest > limit:
        refuse(name, f"{what} must not exceed {limit:g}.", f"{largest:g}")
    return array


def integers(value: ArrayLike, name: str, rule: str) -> Integers:
    """Int64 array (k,) of whole numbers, aligned and in C order."""
    numbers = array(value, name, rule, "iu")
    if numbers.size == 0:
        return np.zeros(0, dtype=np.int64)
    if numbers.ndim != 1:
        refuse(name, rule, describe(value))
    if numbers.dtype.kind == "u" and int(numbers.max()) > LARGEST_INDEX:
        refuse(name, f"Its entries must not exceed {LARGEST_INDEX}.", f"{numbers.max()}")
    return _in_order(numbers.astype(np.int64, copy=False))


INDICES_RULE = "It must be a list of distinct indices."


def indices(value: ArrayLike, name: str, bound: int | None = None, rule: str = INDICES_RULE) -> Integers:
    """Distinct indices from 0 to bound - 1, (k,)."""
    entries = from_zero(integers(value, name, rule), name, bound)
    ordered = np.sort(entries)
    if (ordered[1:] == ordered[:-1]).any():
        refuse(name, rule, describe(value))
    return entries


def from_zero(entries: Integers, name: str, bound: int | None) -> Integers:
    """Indices from 0 to bound - 1, which may repeat."""
    low, high = int(entries.min(initial=0)), int(entries.max(initial=-1))
    if bound is not None and high >= bound:
        refuse(name, f"Indices must be from 0 to {bound - 1}.", f"{high}")
    if low < 0:
        refuse(name, "Indices must not be negative.", f"{low}")
    return entries


def sets(
    offsets: ArrayLike, members: ArrayLike, name: str, bound: int | None = None
) -> tuple[Integers, Integers]:
    """Sets of indices from 0 to bound - 1 in compressed rows, increasing in each."""
    cuts = integers(offsets, name, "Its offsets must be whole numbers.")
    entries = integers(members, name, "Its indices must be whole numbers.")
    most = LARGEST_INDEX + 1 if bound is None else min(bound, LARGEST_INDEX + 1)
    if not _core.are_sets(cuts.view(np.uintp), entries.view(np.uintp), most):
        _refuse_sets(cuts, entries, name, bound)
    return cuts, entries


def _refuse_sets(cuts: Integers, entries: Integers, name: str, bound: int | None) -> NoReturn:
    """Say what is wrong with sets."""
    from_zero(entries, name, bound)
    if not cuts.size or cuts[0] != 0 or cuts[-1] != len(entries) or (cuts[1:] < cuts[:-1]).any():
        rule = f"Its offsets must rise from 0 to the number of indices, {len(entries)}."
        refuse(name, rule, describe(cuts))
    rises = entries[1:] > entries[:-1]
    inner = slice(*np.searchsorted(cuts, [1, len(entries)]))
    rises[cuts[inner] - 1] = True
    i = int(rises.argmin())
    where = f"{entries[i + 1]} after {entries[i]} in set {np.searchsorted(cuts, i, side='right') - 1}"
    refuse(name, "The indices of a set must increase, so that none comes twice.", where)


def items(value: Any, name: str, rule: str) -> list[Any]:
    """List of any iterable except text."""
    if isinstance(value, str | bytes):
        refuse(name, rule, describe(value), TypeError)
    try:
        return list(value)
    except TypeError:
        refuse(name, rule, describe(value), TypeError)


def count(value: Any, name: str, low: int, high: int | None = None) -> int:
    """Whole number from low to high."""
    try:
        number = operator.index(value)
    except TypeError:
        number = None
    if number is None or isinstance(value, _TRUTH):
        refuse(name, _count_rule(low, high), describe(value), TypeError)
    if number < low or (high is not None and number > high):
        refuse(name, _count_rule(low, high), describe(value))
    return number


def _count_rule(low: int, high: int | None) -> str:
    limits = f"of at least {low}" if high is None else f"from {low} to {high}"
    return f"It must be a whole number {limits}."


def number(value: Any, name: str, rule: str, low: float, *, strict: bool = False) -> float:
    """Finite number of at least low, or above low if strict."""
    if isinstance(value, (str, bytes, *_TRUTH)):
        refuse(name, rule, describe(value), TypeError)
    try:
        result = float(value)
    except (TypeError, ValueError, OverflowError):  # a whole number may have any number of digits
        refuse(name, rule, describe(value), TypeError)
    if not math.isfinite(result) or result < low or (strict and result == low):
        refuse(name, rule, describe(value))
    return result


def flag(value: Any, name: str, rule: str = "It must be True or False.") -> bool:
    """True or False."""
    if not isinstance(value, _TRUTH):
        refuse(name, rule, describe(value), TypeError)
    return bool(value)


def as_many(target: Any, source: Any) -> None:
    """Refuse target points that are not as many as the source points."""
    if len(target) != len(source):
        refuse("target", "It must have one point per source point.", f"{len(target)} for {len(source)}")


def text(value: Any, name: str) -> str | None:
    """A text, or None."""
    if value is not None and not isinstance(value, str):
        refuse(name, "It must be a text.", describe(value), TypeError)
    return value


def positive(value: Any, name: str) -> float:
    """Finite number above zero."""
    return number(value, name, "It must be a positive number.", 0.0, strict=True)


def image_size(value: Any) -> tuple[float, float] | None:
    """(width, height) in pixels, or None."""
    if value is None:
        return None
    rule = "It must be (width, height) in pixels, image.shape[1::-1] of an array."
    try:
        width, height = value
    except (TypeError, ValueError):
        refuse("image_size", rule, describe(value), TypeError)
    return (
        number(width, "image_size", rule, 0.0, strict=True),
        number(height, "image_size", rule, 0.0, strict=True),
    )


def intrinsics(value: Any) -> tuple[float, float, float, float] | None:
    """(fx, fy, cx, cy) of a camera in pixels, or None."""
    if value is None:
        return None
    rule = "They must be (fx, fy, cx, cy) in pixels, the focal lengths fx and fy positive."
    try:
        fx, fy, cx, cy = value
    except (TypeError, ValueError):
        refuse("intrinsics", rule, describe(value), TypeError)
    fx, fy = (number(focal, "intrinsics", rule, 0.0, strict=True) for focal in (fx, fy))
    cx, cy = (number(centre, "intrinsics", rule, -math.inf) for centre in (cx, cy))
    return fx, fy, cx, cy


def threads(value: Any) -> int:
    """Number of threads: the argument, else MEXPRESS_NUM_THREADS, else the number of cores that the process may use."""
    if value is not None:
        return min(count(value, "threads", 1), 1024)
    variable = os.environ.get("MEXPRESS_NUM_THREADS", "").strip()
    if variable:
        if not (variable.isascii() and variable.isdecimal()) or float(variable) == 0:
            refuse("MEXPRESS_NUM_THREADS", "It must be a whole number of at least 1.", repr(variable))
        return int(min(float(variable), 1024))  # a float can hold any number of digits
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def generator(seed: Any) -> np.random.Generator:
    """Random generator of a seed; None gives fresh numbers."""
    try:
        return np.random.default_rng(seed)
    except (TypeError, ValueError) as error:
        rule = "It must be None, a whole number of at least 0, or a numpy Generator."
        refuse("seed", rule, describe(seed), ValueError if isinstance(error, ValueError) else TypeError)
