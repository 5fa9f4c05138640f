"""Arrays are sent once: what problems share, or are parts of, is a file that every worker maps into its memory."""

from __future__ import annotations

import mmap
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Bytes = NDArray[np.uint8]

Call: TypeAlias = tuple[tuple[Any, ...], Mapping[str, Any]]
"""The arguments of a problem, by position and by name."""

Key: TypeAlias = int | str
"""Position or name of an argument."""

Place: TypeAlias = tuple[Key, int, int, tuple[int, ...], tuple[int, ...], Any]
"""An argument; its source, and where it begins there; its shape, its strides and its type."""

Light: TypeAlias = tuple[tuple[Any, ...], Mapping[str, Any], list[Place]]
"""Arguments without the arrays that are sent once, and the places of these."""

_SMALL = 1 << 16
"""Bytes: sending a smaller array with every problem costs less than a file."""


@dataclass
class _Need:
    """What all problems together need of an array."""

    root: Array
    nbytes: int = 0

    def is_worth_it(self) -> bool:
        """Return whether more of it would be sent than it has."""
        plain = self.root.flags.forc and not self.root.dtype.hasobject
        return plain and self.nbytes > self.root.nbytes >= _SMALL


class Sharing:
    """The arrays that are sent once.

    Parameters
    ----------
    calls, options
        Of all problems, and for all.
    store : callable
        Makes a source of the bytes of an array.
    mapped : bool
        Whether the path of a file that the user has mapped is a source, too.
    """

    def __init__(
        self, calls: Sequence[Call], options: Mapping[str, Any], store: Callable[[Bytes], Any], mapped: bool
    ) -> None:
        self.sources: list[Any] = []
        self._starts: dict[int, tuple[int, int]] = {}
        for need in _needs(calls, options):
            file = _file(need.root) if mapped else None
            if not file and need.is_worth_it():
                with suppress(OSError):  # without room for it, it is sent as often as it is needed
                    file = store(_bytes(need.root)), 0
            if file:
                self._starts[id(need.root)] = len(self.sources), file[1] - _address(need.root)
                self.sources.append(file[0])

    def has(self, array: Array) -> bool:
        """Return whether an array is sent once."""
        return bool(self._starts) and id(_root(array)) in self._starts

    def light(self, args: tuple[Any, ...], named: Mapping[str, Any]) -> Light:
        """Return arguments as they are sent."""
        places: list[Place] = []
        if not self.sources:
            return args, named, places
        left = [self._light(key, value, places) for key, value in enumerate(args)]
        return tuple(left), {key: self._light(key, value, places) for key, value in named.items()}, places

    def _light(self, key: Key, value: Any, places: list[Place]) -> Any:
        if type(value) not in _ARRAYS or (found := self._starts.get(id(_root(value)))) is None:
            return value
        source, start = found
        form = value.dtype if value.dtype.kind == "V" else value.dtype.str
        places.append((key, source, start + _address(value), value.shape, value.strides, form))
        return None


def whole(light: Light, sources: Sequence[Bytes], rows: Mapping[Key, Array]) -> Call:
    """Return the arguments that were sent, with the rows of others that are in one array with theirs.

    Shared arrays cannot be written to: others see the same memory.
    """
    args, named, places = light
    if not places and not rows:
        return args, named
    by_position, by_name = list(args), dict(named)
    arrays = dict(rows)
    for key, source, start, shape, strides, form in places:
        array: Array = np.ndarray(shape, form, sources[source], start, strides)
        array.flags.writeable = False
        arrays[key] = array
    for key, array in arrays.items():
        if isinstance(key, int):
            by_position[key] = array
        else:
            by_name[key] = array
    return tuple(by_position), by_name


def opened(sources: Iterable[Path]) -> list[Bytes]:
    """Map files into the memory of this process, to be read."""
    return [np.memmap(path, np.uint8, "r").view(np.ndarray) for path in sources]


_ARRAYS = (np.ndarray, np.memmap)


def _root(array: Array) -> Array:
    """Return the array that has the memory."""
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array


def _needs(calls: Sequence[Call], options: Mapping[str, Any]) -> Iterable[_Need]:
    needs: dict[int, _Need] = {}
    every = ((args, named, 1) for args, named in calls)
    for args, named, times in chain(every, [((), options, len(calls))]):
        for value in (*args, *named.values()):
            if type(value) in _ARRAYS:
                root = _root(value)
                need = needs.get(id(root)) or needs.setdefault(id(root), _Need(root))
                need.nbytes += times * value.nbytes
    return needs.values()


def _address(array: Array) -> int:
    return int(array.__array_interface__["data"][0])


def _bytes(root: Array) -> Bytes:
    return (root if root.flags.c_contiguous else root.T).reshape(-1).view(np.uint8)


def _file(root: Any) -> tuple[Path, int] | None:
    """Return the file that an array is mapped from, and where it begins there; None if it has changes of its own."""
    file = getattr(root, "filename", None)
    if file and isinstance(root.base, mmap.mmap) and root.mode != "c":
        return Path(file).absolute(), root.offset
    return None
