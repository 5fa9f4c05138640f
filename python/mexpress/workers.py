"""Worker processes: Python functions on every core, each with one thread.

A worker is an interpreter of its own that is handed pickled calls on its standard input. It does not import the
script that started it, unless what it is handed comes from there, so a script needs no guard to call functions of
modules. Workers have a process group of their own, so Ctrl-C reaches only their parent, which ends them; a worker
whose parent is gone ends itself.
"""

from __future__ import annotations

import multiprocessing.spawn
import os
import pickle
import queue
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, BinaryIO, NoReturn, TypeAlias, TypeVar

__all__ = ["Ledger", "Outcome", "awaited", "in_worker", "run"]

_ONE_THREAD = (
    "MEXPRESS_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
"""Variables that limit threads; a BLAS looks at its own when numpy is first imported."""

_NEW_GROUP = 0x200
"""Windows' flag CREATE_NEW_PROCESS_GROUP."""

_IMPORTABLE = "Worker processes must be able to import it: define it in a module, or set workers=1."

Item = TypeVar("Item")
Call: TypeAlias = tuple[tuple[Any, ...], dict[str, Any]]
Request: TypeAlias = tuple[dict[str, Any], bytes]
"""How to import the script that started all, if what is pickled needs it, and what is pickled."""


@dataclass(frozen=True)
class Outcome:
    """What became of one call: a result, or an error."""

    index: int
    result: Any = None
    error: BaseException | None = None


class Ledger:
    """Which calls are done, and below what index they are needed at all.

    Parameters
    ----------
    bound : int
        Calls from this index on are not needed; it may be lowered at any time.

    Examples
    --------
    >>> ledger = Ledger(3)
    >>> ledger.enter(1)
    >>> ledger.open
    True
    >>> ledger.bound = 1
    >>> ledger.enter(0)
    >>> ledger.open
    False
    """

    def __init__(self, bound: int) -> None:
        self.bound = bound
        self._first_missing = 0
        self._later: set[int] = set()

    def enter(self, index: int) -> None:
        """Note that a call is done."""
        self._later.add(index)
        while self._first_missing in self._later:
            self._later.remove(self._first_missing)
            self._first_missing += 1

    @property
    def open(self) -> bool:
        """Whether a call that is needed is not done."""
        return self._first_missing < self.bound


class WorkerTracebackError(Exception):
    """Where in a worker an error arose, as text: the cause of that error in the parent."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


def in_worker() -> bool:
    """Whether this process is a worker: its siblings keep the other cores busy.

    Raises
    ------
    RuntimeError
        If it is one that still imports the script that started it.
    """
    if _Here.importing:
        raise RuntimeError(
            "A worker process imports the script that started it, since the function or the problems come from "
            "there, and the script calls for workers again. Call map_problems under if __name__ == '__main__':"
        )
    return _Here.worker


def awaited(found: queue.SimpleQueue[Item]) -> Item:
    """Wait for an item; Windows sees Ctrl-C only between waits."""
    while True:
        try:
            return found.get(timeout=1.0)
        except queue.Empty:
            continue


def run(
    function: Callable[..., Any], calls: Sequence[Call], number: int, ledger: Ledger
) -> Generator[Outcome, None, None]:
    """Call a function in worker processes.

    Parameters
    ----------
    function : callable
        Picklable.
    calls : sequence of (args, kwargs)
        Taken in order.
    number : int
        Of workers.
    ledger : Ledger
        Its bound may be lowered at any time.

    Yields
    ------
    Outcome
        As they come; those of all calls below the bound, and perhaps of some others.
    """
    try:
        payload = pickle.dumps(function, pickle.HIGHEST_PROTOCOL)
    except Exception as error:  # whatever the function's class raises
        raise _refused("function", f"It must be picklable. {_IMPORTABLE}", error) from error
    found: queue.SimpleQueue[Outcome] = queue.SimpleQueue()
    indices = _Indices(ledger)
    workers: list[_Worker] = []
    feeders: list[threading.Thread] = []
    try:
        for _ in range(number):
            workers.append(_Worker(payload))
        for worker in workers:
            feeder = threading.Thread(target=_feed, args=(worker, calls, indices, found), daemon=True)
            feeder.start()
            feeders.append(feeder)
        while ledger.open:
            outcome = awaited(found)
            ledger.enter(outcome.index)
            yield outcome
    finally:
        ledger.bound = 0
        for worker in workers:
            worker.kill()
        for feeder in feeders:
            feeder.join()
        for worker in workers:
            worker.close()


class _Indices:
    """Hands out indices below the bound, to one thread at a time."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger, self._next, self._lock = ledger, 0, threading.Lock()

    def take(self) -> int | None:
        with self._lock:
            if self._next >= self._ledger.bound:
                return None
            self._next += 1
            return self._next - 1


def _feed(
    worker: _Worker,
    calls: Sequence[Call],
    indices: _Indices,
    found: queue.SimpleQueue[Outcome],
) -> None:
    """Hand one worker a call after the other; whatever happens, every index taken has an outcome."""
    while worker.alive and (index := indices.take()) is not None:
        try:
            outcome = worker.ask(index, calls[index])
        except BaseException as error:  # it is the caller's thread that must see it
            outcome = Outcome(index, error=error)
        found.put(outcome)


class _Worker:
    """The parent's side of a worker."""

    def __init__(self, function: bytes) -> None:
        # The path comes first: without it this package may not be found.
        path = [entry for entry in sys.path if isinstance(entry, str)]
        code = f"import sys; sys.path[:] = {path!r}; from mexpress import workers; workers._serve()"
        python = multiprocessing.spawn.get_executable()
        own_group: dict[str, Any] = (
            {"process_group": 0} if os.name == "posix" else {"creationflags": _NEW_GROUP}
        )
        self._process = subprocess.Popen(
            [os.fsdecode(python), "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **dict.fromkeys(_ONE_THREAD, "1")},
            **own_group,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._requests, self._replies = self._process.stdin, self._process.stdout
        self._function: bytes | None = function
        self.alive = True

    def ask(self, index: int, call: Call) -> Outcome:
        """Have it make a call, and wait."""
        try:
            payload = pickle.dumps(call, pickle.HIGHEST_PROTOCOL)
        except Exception as error:
            return Outcome(index, error=_refused(f"problems[{index}]", "It must be picklable.", error))
        try:
            if self._function is not None:
                self._send(self._function)
                self._function = None
            self._send(payload)
            succeeded, content = pickle.load(self._replies)
        except (OSError, EOFError, pickle.UnpicklingError):
            return Outcome(index, error=self._death(index))
        try:
            result = pickle.loads(content)
        except Exception as error:
            return Outcome(index, error=error)
        return Outcome(index, result) if succeeded else Outcome(index, error=_raised(*result))

    def _send(self, payload: bytes) -> None:
        pickle.dump((_main() if b"__main__" in payload else {}, payload), self._requests)
        self._requests.flush()

    def _death(self, index: int) -> RuntimeError:
        self.alive = False
        status = self._process.wait()
        how = f"by signal {-status}" if status < 0 else f"with exit status {status}"
        why = "; the system kills when memory runs out" if status == -9 else ""
        return RuntimeError(f"The worker process of problem {index} ended {how}{why}.")

    def kill(self) -> None:
        """End it, now."""
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        """Close the pipes, after `kill` and when nobody reads any more."""
        for stream in (self._requests, self._replies):
            with suppress(OSError):  # of what was not sent any more
                stream.close()


def _main() -> dict[str, Any]:
    """How to import the script that runs here, as multiprocessing does; nothing if it is no file."""
    data = multiprocessing.spawn.get_preparation_data("mexpress")
    names = ("sys_argv", "init_main_from_name", "init_main_from_path")
    known = {name: data[name] for name in names if name in data}
    return known if os.path.exists(known.get(names[-1], os.curdir)) else {}


def _refused(name: str, rule: str, cause: BaseException) -> TypeError:
    error = TypeError(f"Invalid {name}. {rule} Given {type(cause).__name__}: {cause}.")
    error.__cause__ = cause
    return error


def _raised(error: bytes, name: str, text: str) -> BaseException:
    """The error of a worker, with the traceback there as its cause."""
    raised: Any = None
    with suppress(Exception):  # an error that cannot be pickled arrives as its text
        raised = pickle.loads(error)
    known = raised if isinstance(raised, BaseException) else RuntimeError(name)
    known.__cause__ = WorkerTracebackError(text)
    return known


# ------------------------------------------------------------------------------------------ the worker's side


class _Here:
    """What this process is."""

    worker = False
    importing = False
    imported = False


def _serve() -> NoReturn:
    """Take calls until the parent is gone."""
    _Here.worker = True
    requests = os.fdopen(os.dup(0), "rb")
    replies = os.fdopen(os.dup(1), "wb")
    # What the function reads and prints must not mix with the calls.
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    os.close(null)
    os.dup2(2, 1)
    received: queue.SimpleQueue[Request] = queue.SimpleQueue()
    threading.Thread(target=_receive, args=(requests, received), daemon=True).start()
    pickled = received.get()
    function: Callable[..., Any] | None = None
    while True:
        request = received.get()
        try:
            function = function or _loaded("function", pickled)
            args, kwargs = _loaded("problems", request)
            reply = True, pickle.dumps(function(*args, **kwargs), pickle.HIGHEST_PROTOCOL)
        except BaseException as error:  # the parent raises it
            reply = False, pickle.dumps((_pickled(error), repr(error), traceback.format_exc()))
        pickle.dump(reply, replies)
        replies.flush()


def _receive(requests: BinaryIO, received: queue.SimpleQueue[Request]) -> None:
    """Queue what comes, and end the process, even in the middle of a call, when the parent is gone."""
    try:
        while True:
            received.put(pickle.load(requests))
    finally:
        os._exit(0)


def _loaded(name: str, request: Request) -> Any:
    main, payload = request
    if main and not _Here.imported:
        _Here.importing = _Here.imported = True
        try:
            multiprocessing.spawn.prepare(main)
        finally:
            _Here.importing = False
    try:
        return pickle.loads(payload)
    except (AttributeError, ImportError) as error:
        raise _refused(name, _IMPORTABLE, error) from error


def _pickled(error: BaseException) -> bytes:
    try:
        return pickle.dumps(error)
    except Exception:  # whatever its class raises
        return pickle.dumps(None)
