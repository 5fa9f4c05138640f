"""Results in a file, so that a run that was interrupted goes on."""

from __future__ import annotations

import hashlib
import inspect
import pickle
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from mexpress.batch.agenda import Results
from mexpress.batch.calls import Task, unpicklable
from mexpress.batch.pickling import dumps
from mexpress.batch.sharing import Call
from mexpress.records import Records

_RULE = "It must be a new file, or one of results that this version of mexpress has written."


class Journal:
    """A file that gets result after result.

    A result is known by the place of its problem, and by a fingerprint of what it is of: the function and all its
    arguments.
    """

    def __init__(self, path: Path, task: Task, calls: Sequence[Call]) -> None:
        self.calls = calls
        self.arrays: dict[int, bytes] = {}
        self.common = self._fingerprint(_name(task.function), task.options)
        title = f"mexpress {version('mexpress')}: results of map_problems\n".encode()
        self.records = Records(path, title, _RULE)

    def known(self) -> Iterator[tuple[int, Any]]:
        """Return the results that the file holds, with the indices of their problems."""
        for record in self.records:
            index, fingerprint, packed = pickle.loads(record)
            if index < len(self.calls) and fingerprint == self._fingerprint_of(index):
                yield index, pickle.loads(packed)

    def add(self, results: Results) -> list[tuple[int, Exception]]:
        """Write results, at once; return those that cannot be pickled, with the reasons."""
        records: list[bytes] = []
        refused: list[tuple[int, Exception]] = []
        for index, result in results:
            try:
                records.append(pickle.dumps((index, self._fingerprint_of(index), dumps(result))))
            except Exception as error:  # pickling can raise anything
                refused.append((index, unpicklable(error)))
        self.records.add(records)
        return refused

    def _fingerprint_of(self, index: int) -> bytes:
        args, named = self.calls[index]
        return self._fingerprint(self.common, *args, named)

    def _fingerprint(self, *values: Any) -> bytes:
        return hashlib.blake2b(b"".join(map(self._part, values)), digest_size=16).digest()

    def _part(self, value: Any) -> bytes:
        """Return bytes of a value: equal ones for equal values, if they come about in the same way."""
        if isinstance(value, Mapping):
            names = sorted(value, key=repr)
            return dumps(names) + b"".join(self._part(value[name]) for name in names)
        if type(value) not in (np.ndarray, np.memmap) or value.dtype.hasobject:
            return dumps(value)
        if id(value) not in self.arrays:  # which many problems may share
            content = np.ascontiguousarray(value).reshape(-1).view(np.uint8).data
            self.arrays[id(value)] = hashlib.blake2b(content, digest_size=16).digest()
        return dumps((value.dtype.str, value.shape)) + self.arrays[id(value)]


def _name(function: Any) -> Any:
    """Return what a function is called, or itself, if that does not tell all: a method of an object, a lambda."""
    name = getattr(function, "__qualname__", None)
    alone = name is None or "<" in name or inspect.ismethod(function)
    return function if alone else (getattr(function, "__module__", None), name)
