"""What a worker process does: it makes call after call, and sends what comes of them some at a time."""

from __future__ import annotations

import pickle
import time
from multiprocessing.connection import Connection
from pathlib import Path

from mexpress.batch.calls import Task, assembled, packed, within
from mexpress.batch.parcels import Parcel
from mexpress.batch.pickling import received
from mexpress.batch.process import prepare
from mexpress.batch.sharing import opened
from mexpress.batch.spool import Spool, framed

SPELL = 0.02
"""Seconds of work that a worker is given at once. After them it sends outcomes, and gives back what it has not begun:
a problem that takes longer is sent at once."""


def serve(connection: Connection, path: Path, payload: bytes) -> None:
    """Take problems until the parent says that it is over."""
    following = prepare(path.parent)
    within.set(True)
    try:
        function, options, paths = pickle.loads(payload)
        task = assembled(function, options, opened(paths))
    except Exception as error:  # whatever an import raises
        connection.send_bytes(repr(error).encode())
        return
    connection.send_bytes(b"")
    spool = Spool(path)
    try:
        while (some := received(connection)) is not None:
            _work(task, some, connection, spool)
    except (EOFError, OSError):
        following.join()


def _work(task: Task, some: Parcel, connection: Connection, spool: Spool) -> None:
    """Make calls, until all are made or a spell is over."""
    begun = now = time.monotonic()
    last = some.indices[-1]
    for index, light, rows in some:
        spool.begin(now)
        outcome = packed(task, index, light, rows)
        now = time.monotonic()
        finished = now - begun > SPELL or index == last
        rest = b"" if spool.keep(index, outcome) else framed(index, outcome)
        if finished or rest:
            connection.send_bytes(bytes([finished]) + spool.content() + rest)
            spool.clear()
            now = time.monotonic()
        if finished:
            return
