"""What goes to a worker at once: some problems, whose arrays of one shape are one array."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import Any, TypeAlias

import numpy as np

from mexpress.batch.pickling import dumps
from mexpress.batch.sharing import Array, Call, Key, Light, Sharing
from mexpress.batch.tray import Lying, Tray

_BLOCK = 1 << 15
"""Bytes that are copied at once: a row that a function keeps keeps no more."""

Item: TypeAlias = tuple[int, Light | bytes, Mapping[Key, Array]]
"""A problem, its arguments as they are sent, and those of them that are rows of one array."""


@dataclass(frozen=True)
class Parcel:
    """Problems with the arguments that are no rows, as bytes, each for itself: if one cannot be read, others can.

    There are no bytes if all arguments are rows.
    """

    indices: Sequence[int]
    others: Sequence[bytes] | None
    stacks: Mapping[Key, Array | Lying]

    def __iter__(self) -> Iterator[Item]:
        keys, rows = list(self.stacks), self._rows()
        if self.others is not None:
            for index, light, own in zip(self.indices, self.others, rows, strict=True):
                yield index, light, dict(zip(keys, own, strict=True))
        else:
            names = [key for key in keys if isinstance(key, str)]
            by_position = len(keys) - len(names)
            for index, own in zip(self.indices, rows, strict=True):
                named = dict(zip(names, own[by_position:], strict=True)) if names else {}
                yield index, (own[:by_position], named, []), {}

    def _rows(self) -> Iterator[tuple[Array, ...]]:
        """Return the rows of each problem, copied some problems at a time: they may be kept and written to."""
        number = len(self.indices)
        if not self.stacks:
            yield from repeat((), number)
            return
        stacks = [stack.array() if isinstance(stack, Lying) else stack for stack in self.stacks.values()]
        step = max(1, _BLOCK * number // max(1, sum(stack.nbytes for stack in stacks)))
        if step == 1:
            yield from (tuple([row.copy() for row in rows]) for rows in zip(*stacks, strict=True))
            return
        for start in range(0, number, step):
            yield from zip(*[stack[start : start + step].copy() for stack in stacks], strict=True)


def parcel(
    chunk: Sequence[int], calls: Sequence[Call], sharing: Sharing, tray: Tray | None = None
) -> tuple[Parcel, list[tuple[int, Exception]]]:
    """Return problems as they are sent, and those that cannot be, with the reasons."""
    some = [calls[index] for index in chunk]
    alike = _alike(some, sharing)
    others: list[bytes] = []
    refused: list[tuple[int, Exception]] = []
    if not alike or any(len(args) + len(named) > len(alike) for args, named in some):
        for index, call in zip(chunk, some, strict=True):
            try:
                others.append(dumps(sharing.light(*_without(alike, call))))
            except Exception as error:  # pickling can raise anything
                refused.append((index, error))
    if refused:
        gone = {index for index, _ in refused}
        return parcel([index for index in chunk if index not in gone], calls, sharing, tray)[0], refused
    return Parcel(chunk, others or None, {key: _stacked(column, tray) for key, column in alike.items()}), []


def weight(call: Call, sharing: Sharing) -> int:
    """Return the bytes of the arrays that are sent for a problem."""
    arrays = [value for value in (*call[0], *call[1].values()) if type(value) is np.ndarray]
    return sum(array.nbytes for array in arrays if not sharing.has(array))


def _alike(calls: Sequence[Call], sharing: Sharing) -> dict[Key, list[Array]]:
    """Return the arguments that are arrays of one shape and type in all calls, call after call."""
    if len(calls) < 2:
        return {}
    first_args, first_named = calls[0]
    columns: dict[Key, list[Any]] = {
        place: [args[place] if place < len(args) else None for args, _ in calls]
        for place in range(len(first_args))
    }
    columns |= {name: [named.get(name) for _, named in calls] for name in first_named}
    return {key: column for key, column in columns.items() if _is_stack(column, sharing)}


def _is_stack(column: Sequence[Any], sharing: Sharing) -> bool:
    """Return whether arguments are arrays of one shape and type, none of which is sent once."""
    first = column[0]
    if type(first) is not np.ndarray or first.ndim == 0 or first.dtype.hasobject:
        return False
    shape, dtype = first.shape, first.dtype
    return all(
        [
            type(value) is np.ndarray
            and value.shape == shape
            and value.dtype == dtype
            and value.flags.c_contiguous
            and not sharing.has(value)
            for value in column
        ]
    )


def _stacked(column: Sequence[Array], tray: Tray | None) -> Array | Lying:
    """Return arrays of one shape as one, on the tray if there is room."""
    if tray and (lying := tray.stacked(column)):
        return lying
    number, shape = len(column), column[0].shape
    flat = np.empty((number * shape[0], *shape[1:]), column[0].dtype)
    return np.concatenate(column, out=flat).reshape(number, *shape)


def _without(keys: Collection[Key], call: Call) -> Call:
    if not keys:
        return call
    args, named = call
    return (
        tuple(None if key in keys else value for key, value in enumerate(args)),
        {key: None if key in keys else value for key, value in named.items()},
    )
