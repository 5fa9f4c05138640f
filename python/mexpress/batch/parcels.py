"""What goes to a worker at once: some problems, whose arrays of one shape are one array."""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from mexpress.batch.pickling import dumps
from mexpress.batch.sharing import Array, Call, Key, Sharing

Item: TypeAlias = tuple[int, Any, dict[Key, Array]]
"""A problem, its arguments as they are sent, and those of them that are rows of one array."""


@dataclass(frozen=True)
class Parcel:
    """Problems with their arguments as bytes, each for itself: if one cannot be read, the others can."""

    lights: list[tuple[int, bytes]]
    stacks: dict[Key, Array]

    def __iter__(self) -> Iterator[Item]:
        for row, (index, light) in enumerate(self.lights):
            yield index, light, {key: stack[row] for key, stack in self.stacks.items()}


def parcel(
    chunk: Sequence[int], calls: Sequence[Call], sharing: Sharing
) -> tuple[Parcel, list[tuple[int, Exception]]]:
    """Return problems as they are sent, and those that cannot be, with the reasons."""
    alike = _alike([calls[index] for index in chunk], sharing)
    names = [key for key in alike if isinstance(key, str)]
    nothing = dumps(((None,) * (len(alike) - len(names)), dict.fromkeys(names), []))
    lights, refused = [], []
    for index in chunk:
        args, named = calls[index]
        try:
            if len(args) + len(named) == len(alike):  # it has no other arguments
                light = nothing
            else:
                light = dumps(sharing.light(*_without(alike, args, named)))
            lights.append((index, light))
        except Exception as error:  # pickling can raise anything
            refused.append((index, error))
    if refused:
        gone = {index for index, _ in refused}
        kept = [index not in gone for index in chunk]
        return Parcel(lights, {key: stack[kept] for key, stack in alike.items()}), refused
    return Parcel(lights, alike), refused


def _alike(calls: Sequence[Call], sharing: Sharing) -> dict[Key, Array]:
    """Return the arguments that are arrays of one shape and type in all calls, call after call."""
    found: dict[Key, Array] = {}
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
            flat = np.empty((len(column) * shape[0], *shape[1:]), dtype)
            found[key] = np.concatenate(column, out=flat).reshape(len(column), *shape)
    return found


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
