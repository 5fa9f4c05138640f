"""What goes to a worker at once: some problems, whose arrays of one shape are one array."""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from mexpress.batch.pickling import dumps
from mexpress.batch.sharing import Array, Call, Key, Sharing
from mexpress.batch.tray import ROOM, Lying, Tray

Item: TypeAlias = tuple[int, Any, dict[Key, Array]]
"""A problem, its arguments as they are sent, and those of them that are rows of one array."""


@dataclass(frozen=True)
class Parcel:
    """Problems with the arguments that are no rows, as bytes, each for itself: if one cannot be read, others can."""

    lights: list[tuple[int, bytes | None]]
    stacks: dict[Key, Array | Lying]

    def __iter__(self) -> Iterator[Item]:
        keys = list(self.stacks)
        stacks = [stack.array() if isinstance(stack, Lying) else stack for stack in self.stacks.values()]
        for (index, light), *rows in zip(self.lights, *stacks, strict=True):
            yield index, light, {key: row.copy() for key, row in zip(keys, rows, strict=True)}


def parcel(
    chunk: Sequence[int], calls: Sequence[Call], sharing: Sharing, tray: Tray | None = None
) -> tuple[Parcel, list[tuple[int, Exception]]]:
    """Return problems as they are sent, and those that cannot be, with the reasons."""
    alike = _alike([calls[index] for index in chunk], sharing)
    lights: list[tuple[int, bytes | None]] = []
    refused = []
    for index in chunk:
        args, named = calls[index]
        try:
            others = len(args) + len(named) > len(alike)
            lights.append((index, dumps(sharing.light(*_without(alike, args, named))) if others else None))
        except Exception as error:  # pickling can raise anything
            refused.append((index, error))
    if refused:
        gone = {index for index, _ in refused}
        alike = {
            key: [array for index, array in zip(chunk, column, strict=True) if index not in gone]
            for key, column in alike.items()
        }
    return Parcel(lights, {key: _stacked(column, tray) for key, column in alike.items() if column}), refused


def fitting(chunk: Sequence[int], calls: Sequence[Call]) -> int:
    """Return how many of some problems have room on a tray, if all are like the first: at least that."""
    args, named = calls[chunk[0]]
    nbytes = sum(value.nbytes for value in (*args, *named.values()) if type(value) is np.ndarray)
    return max(1, ROOM // max(nbytes, 1))


def _alike(calls: Sequence[Call], sharing: Sharing) -> dict[Key, list[Array]]:
    """Return the arguments that are arrays of one shape and type in all calls, call after call."""
    found: dict[Key, list[Array]] = {}
    if len(calls) < 2:
        return found
    args, named = calls[0]
    keys: list[Key] = [*range(len(args)), *named]
    for key in keys:
        first = _argument(calls[0], key)
        if type(first) is not np.ndarray or first.ndim == 0 or first.dtype.hasobject:
            continue
        shape, dtype = first.shape, first.dtype
        column = [_argument(call, key) for call in calls]
        if all(
            type(value) is np.ndarray
            and value.shape == shape
            and value.dtype == dtype
            and value.flags.c_contiguous
            and not sharing.has(value)
            for value in column
        ):
            found[key] = column
    return found


def _stacked(column: Sequence[Array], tray: Tray | None) -> Array | Lying:
    """Return arrays of one shape as one, on the tray if there is room."""
    if tray and (lying := tray.stacked(column)):
        return lying
    number, shape = len(column), column[0].shape
    flat = np.empty((number * shape[0], *shape[1:]), column[0].dtype)
    return np.concatenate(column, out=flat).reshape(number, *shape)


def _without(keys: Container[Key], args: tuple[Any, ...], named: Mapping[str, Any]) -> Call:
    return (
        tuple(None if key in keys else value for key, value in enumerate(args)),
        {key: None if key in keys else value for key, value in named.items()},
    )


def _argument(call: Call, key: Key) -> Any:
    args, named = call
    if isinstance(key, str):
        return named.get(key)
    return args[key] if key < len(args) else None
