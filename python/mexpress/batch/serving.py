"""What a worker process does: it makes call after call, and sends what comes of them some at a time.

To send every outcome alone would cost more than a small problem. What is not sent yet is in a file, the spool, which
outlives a process that is killed: nothing that was done is done again.
"""

from __future__ import annotations

import pickle
import struct
import time
from collections.abc import Iterator
from contextlib import suppress
from io import FileIO
from multiprocessing.connection import Connection
from pathlib import Path

from mexpress.batch.agenda import SPELL
from mexpress.batch.calls import Task, assembled, packed
from mexpress.batch.parcels import Parcel
from mexpress.batch.process import prepare
from mexpress.batch.sharing import opened

Packed = tuple[int, bytes]
"""A problem, and its outcome as bytes."""

_PERIOD = 0.02
"""Seconds after which outcomes are sent: a problem that takes longer is sent at once, and never in the spool."""

_HEAD = struct.Struct("<QQ")


def serve(connection: Connection, spool: Path, payload: bytes) -> None:
    """Take problems until the parent says that it is over."""
    following = prepare(spool.parent)
    try:
        function, options, paths = pickle.loads(payload)
        task = assembled(function, options, opened(paths))
    except Exception as error:  # whatever an import raises
        connection.send(repr(error))
        return
    connection.send(None)
    try:
        while some := connection.recv():
            _work(task, some, connection, spool)
    except (EOFError, OSError):
        following.join()


def _work(task: Task, some: Parcel, connection: Connection, spool: Path) -> None:
    begun = sent = time.monotonic()
    outcomes: list[Packed] = []
    with spool.open("ab", buffering=0) as file:
        for index, light, rows in some:
            outcomes.append((index, packed(task, index, light, rows)))
            now = time.monotonic()
            finished = now - begun > SPELL or index == some.lights[-1][0]
            if finished or now - sent > _PERIOD:
                connection.send((outcomes, finished))
                if len(outcomes) > 1:
                    file.truncate(0)
                outcomes, sent = [], now
                if finished:
                    return
            else:
                _keep(file, *outcomes[-1])


def _keep(spool: FileIO, index: int, packed: bytes) -> None:
    record = _HEAD.pack(index, len(packed)) + packed
    with suppress(OSError):  # without room, what is lost with a process is done again
        if spool.write(record) < len(record):
            spool.truncate(0)


def kept(spool: Path) -> Iterator[Packed]:
    """Return the outcomes that a spool holds, without one that was being written.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     spool = Path(folder, "spool")
    ...     with spool.open("wb", buffering=0) as file:
    ...         _keep(file, 7, b"seven")
    ...         _ = file.write(_HEAD.pack(8, 5) + b"ei")
    ...     list(kept(spool))
    [(7, b'seven')]
    """
    content = spool.read_bytes() if spool.exists() else b""
    place = 0
    while place + _HEAD.size <= len(content):
        index, length = _HEAD.unpack_from(content, place)
        place += _HEAD.size
        if place + length <= len(content):
            yield index, content[place : place + length]
        place += length
