"""Outcomes on their way from a worker: in memory that outlives it until they are sent.

To send every outcome alone would cost more than a small problem. What is not sent yet is in a file that is mapped into
memory: to keep an outcome is to copy it, without a call of the system, and a process that is killed leaves it behind.
Nothing that was done is done again.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from mmap import mmap
from pathlib import Path
from typing import TypeAlias

Packed: TypeAlias = tuple[int, bytes | memoryview]
"""A problem, and its outcome as bytes."""

_ROOM = 1 << 18
_HEAD = struct.Struct("Qd")
_FRAME = struct.Struct("QQ")


class Spool:
    """The outcomes that a worker has not sent, and when it began its present call."""

    def __init__(self, path: Path) -> None:
        file = mapped(path, _ROOM)
        self.memory = file or mmap(-1, _ROOM)
        self.room = _ROOM if file else 0  # nobody else would see what is kept
        head = memoryview(self.memory)
        # Each is written at once, not byte by byte.
        self.end, self.begun = head[:8].cast("Q"), head[8:16].cast("d")
        self.clear()

    def begin(self, now: float) -> None:
        """Take that a call begins."""
        self.begun[0] = now

    def keep(self, index: int, packed: bytes) -> bool:
        """Keep an outcome, if there is room for it."""
        start = self.end[0] + _FRAME.size
        stop = start + len(packed)
        if stop > self.room:
            return False
        _FRAME.pack_into(self.memory, start - _FRAME.size, index, len(packed))
        self.memory[start:stop] = packed
        self.end[0] = stop  # at last: what was being written does not count
        return True

    def content(self) -> bytes:
        """Return what it holds, in one piece."""
        return self.memory[_HEAD.size : self.end[0]]

    def clear(self) -> None:
        """Forget what has been sent."""
        self.end[0] = _HEAD.size


def mapped(path: Path, size: int) -> mmap | None:
    """Return memory that is a file, or None if there is no room for it."""
    try:
        with path.open("w+b", buffering=0) as file:
            file.write(bytes(size))  # a file that has holes would end the process later, on a full disk
            return mmap(file.fileno(), size)
    except (OSError, ValueError):
        path.unlink(missing_ok=True)
        return None


def framed(index: int, packed: bytes) -> bytes:
    """Return an outcome as it follows others."""
    return _FRAME.pack(index, len(packed)) + packed


def unframed(content: memoryview) -> Iterator[Packed]:
    """Return outcomes that follow each other.

    Examples
    --------
    >>> content = framed(7, b"seven") + framed(8, b"eight")
    >>> [(index, bytes(packed)) for index, packed in unframed(memoryview(content))]
    [(7, b'seven'), (8, b'eight')]
    """
    place = 0
    while place < len(content):
        index, length = _FRAME.unpack_from(content, place)
        place += _FRAME.size + length
        yield index, content[place - length : place]


def kept(path: Path) -> tuple[float, Iterator[Packed]]:
    """Return when a worker began its last call, and the outcomes that it has kept.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     spool = Spool(Path(folder, "spool"))
    ...     spool.begin(2.5)
    ...     spool.keep(7, b"seven"), spool.keep(8, bytes(_ROOM))
    ...     begun, outcomes = kept(Path(folder, "spool"))
    ...     begun, [(index, bytes(packed)) for index, packed in outcomes]
    (True, False)
    (2.5, [(7, b'seven')])
    """
    content = path.read_bytes() if path.exists() else b""
    if len(content) < _ROOM:
        return 0.0, iter(())
    end, begun = _HEAD.unpack_from(content)
    return begun, unframed(memoryview(content)[_HEAD.size : end])
