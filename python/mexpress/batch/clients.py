"""The workers of others: Dask's, or any executor's."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from queue import Empty, SimpleQueue
from typing import Any

from mexpress import _validation as check
from mexpress.batch.agenda import TICK, Agenda, Results
from mexpress.batch.calls import Outcome, Task, assembled, failed, packed, unpacked, within
from mexpress.batch.parcels import Item, Parcel, parcel
from mexpress.batch.sharing import Call, Sharing

Submit = Callable[[Sequence[int], float | None], Future[Any]]

_SPELL = 0.1
"""Seconds of work that a worker is given at once, and after which it gives back what it has not begun."""

_BROKEN = "A worker ended before its time: it crashed, ran out of memory, or could not import the function."
_CANCELLED = "The client has cancelled problems that were not done."


def by_client(
    client: Any, task: Task, calls: Sequence[Call], agenda: Agenda, timeout: float | None
) -> Generator[Results, None, None]:
    """Have calls made by an executor, or by Dask's client."""
    make = _dask if hasattr(client, "get_executor") else _any
    submit, workers, ahead = make(client, task, calls)
    done: SimpleQueue[Future[Any]] = SimpleQueue()
    pending: dict[Future[Any], list[int]] = {}
    try:
        while agenda.unsettled:
            while len(pending) < (1 if agenda.alone else ahead) and (chunk := agenda.take(workers, _SPELL)):
                try:
                    future = submit(chunk, timeout)
                except Exception as error:
                    yield _refused(chunk, error, agenda)
                    continue
                pending[future] = chunk
                future.add_done_callback(done.put)
            try:
                future = done.get(timeout=TICK)
            except Empty:
                continue
            yield _settled(future, pending.pop(future), agenda)
    finally:
        for future in pending:
            future.cancel()


def _any(executor: Executor, task: Task, calls: Sequence[Call]) -> tuple[Submit, int, int]:
    """Return how problems go to an executor, how many workers it may have, and for how many tasks it may be asked."""

    def submit(chunk: Sequence[int], timeout: float | None) -> Future[Any]:
        return executor.submit(_spell, task, [(index, (*calls[index], []), {}) for index in chunk], timeout)

    return submit, check.threads(None), 1000


def _dask(client: Any, task: Task, calls: Sequence[Call]) -> tuple[Submit, int, int]:
    """Return the same for Dask, which sends what all calls have in common to every worker once.

    It is the result of a call, and made again when it is lost. What is scattered is gone with the workers that have it.
    """
    sharing = Sharing(calls, task.options, lambda array: array, mapped=False)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
        common = client.submit(
            assembled, task.function, sharing.light((), task.options), sharing.sources, pure=False
        )
    executor = client.get_executor(pure=False)  # Dask makes equal calls of pure functions once
    workers = sum(client.nthreads().values()) or 1

    def submit(chunk: Sequence[int], timeout: float | None) -> Future[Any]:
        some, refused = parcel(chunk, calls, sharing)  # what Dask cannot send, it tries to send for ever
        if refused:
            raise refused[0][1]
        future: Future[Any] = executor.submit(_spell, common, some, timeout)
        return future

    return submit, workers, max(4 * workers, 32)  # a cluster may grow


def _settled(future: Future[Any], chunk: list[int], agenda: Agenda) -> Results:
    """Take what comes of some problems."""
    try:
        outcomes, seconds = future.result()
    except Exception as error:
        return _refused(chunk, error, agenda)
    agenda.learn(len(outcomes), seconds)
    agenda.put_back(chunk[len(outcomes) :])
    return agenda.settle(
        (index, unpacked(index, outcome) if isinstance(outcome, bytes) else outcome)
        for index, outcome in outcomes
    )


def _refused(chunk: list[int], error: Exception, agenda: Agenda) -> Results:
    """Take that some problems did not get to a worker, or their results not back, or that the worker ended."""
    if isinstance(error, CancelledError | BrokenExecutor):
        raise RuntimeError(_CANCELLED if isinstance(error, CancelledError) else _BROKEN) from error
    # Dask gives up on all that a worker had when it ended, however little of it had begun.
    killed = type(error).__name__ == "KilledWorker"
    if len(chunk) > 1 or (killed and chunk[0] not in agenda.alone):
        agenda.suspect(chunk)
        return []
    return agenda.settle([(chunk[0], failed(chunk[0], error))])


def _spell(
    task: Task, some: Iterable[Item], timeout: float | None
) -> tuple[list[tuple[int, Outcome | bytes]], float]:
    """Make calls for a while; return what comes of them, as bytes if they came so, and the seconds that they took."""
    begun, outcomes = time.monotonic(), []
    token = within.set(True)  # of a thread that may have other work, too
    try:
        make = packed if isinstance(some, Parcel) else Task.attempt
        for index, light, rows in some:
            outcomes.append((index, make(task, index, light, rows, timeout)))
            if time.monotonic() - begun > _SPELL:
                break
    finally:
        within.reset(token)
    return outcomes, time.monotonic() - begun
