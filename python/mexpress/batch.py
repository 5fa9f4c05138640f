"""Many problems at once."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import closing
from contextvars import ContextVar
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any, TypeVar

from mexpress import _validation as check
from mexpress.progress import shown

Result = TypeVar("Result")
Problem = tuple[Any, ...] | Mapping[str, Any]
Call = tuple[tuple[Any, ...], dict[str, Any]]
Results = Generator[tuple[int, Any], None, None]

_THREADS = "MEXPRESS_NUM_THREADS OMP_NUM_THREADS OPENBLAS_NUM_THREADS MKL_NUM_THREADS VECLIB_MAXIMUM_THREADS"
_STARTING = threading.Lock()
_within: ContextVar[bool] = ContextVar("within", default=False)
_DEAD = (
    "A worker process ended before its time, while it had one of problems {} to {} (from 0). It crashed, ran out of "
    "memory, or could not import the function, or the script: a script calls this under if __name__ == '__main__'."
)


def map_problems(
    function: Callable[..., Result],
    problems: Iterable[Problem],
    workers: int | None = None,
    client: Any = None,
    progress: bool | Callable[..., Any] = False,
    on_result: Callable[[int, Result], object] | None = None,
    **options: Any,
) -> list[Result]:
    """Call a function on many problems, on all cores.

    Every core runs a process with one thread, since Python's lock admits only one thread at a time outside the Rust
    core. On 60 problems of 60 matches, with the paper's criteria and two cores, two processes took 11 s, two threads of
    Python 20 s, and a loop 19 s. Processes start in about a second, so a few small problems gain nothing
    (``benches/reproduce.py batches`` times all ways).

    Parameters
    ----------
    function : callable
        A function such as `select_warp`. It is a function of a module, not a lambda: it, its arguments and its results
        must be picklable. Processes import the calling script, so a script must call this under
        ``if __name__ == "__main__":``, as with `multiprocessing`.
    problems : iterable of tuples or mappings
        The arguments of each call, by position or by name.
    workers : int, optional
        Number of processes; MEXPRESS_NUM_THREADS or the number of cores by default. With 1, a loop in this process
        makes the calls: it takes any function, and the calls may use all cores.
    client : distributed.Client or concurrent.futures.Executor, optional
        Makes the calls with its own workers instead. Pass ``threads=1`` if it runs several calls on one machine.
    progress : bool or callable, default False
        Whether to show progress on the terminal; or what makes a bar, such as ``tqdm.tqdm``. It is called with
        ``total`` and ``desc``, the number of problems and what they are. What it returns has ``update(1)`` called after
        each problem, and ``close()`` at the end. What they raise ends the work.
    on_result : callable, optional
        Called in this thread with the index and the result of each problem, as soon as the result arrives.
    **options
        Further arguments by name, the same for every call.

    Returns
    -------
    list
        The results, in the order of the problems.

    Raises
    ------
    ValueError, TypeError
        If a problem is neither a tuple nor a mapping, or the function cannot be pickled.
    Exception
        The exception of the first problem that fails, in the order of the problems, with a note of its index.
        Earlier problems are finished; later unfinished ones are cancelled.
    RuntimeError
        If a process dies, or the function raises an exception that cannot be pickled.

    Notes
    -----
    The seed is an argument of each call, so results do not depend on the workers, except for the last bits of numpy's
    products, which depend on the number of threads of its BLAS (a process has one). Ctrl-C ends the processes at once;
    `on_result` has received all results so far.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> sources = rng.uniform(0, 100, (3, 20, 2))
    >>> problems = [(source, 2 * source + rng.normal(size=(20, 2))) for source in sources]
    >>> selections = mx.map_problems(mx.select_warp, problems, workers=2, criterion="CMPRESS", counts=[3, 4, 5])
    >>> [selection.count for selection in selections]
    [3, 3, 3]
    """
    calls: list[Call] = []
    for problem in check.items(problems, "problems", "They must be tuples or mappings."):
        if isinstance(problem, Mapping) and all(isinstance(name, str) for name in problem):
            calls.append(((), {**options, **problem}))
        elif isinstance(problem, tuple):
            calls.append((problem, options))
        else:
            rule = "It must be a tuple of arguments, or a mapping of them by name."
            check.refuse(f"problems[{len(calls)}]", rule, check.describe(problem), TypeError)
    for name, callback in (("function", function), ("on_result", on_result)):
        if not callable(callback) and (callback is not None or name == "function"):
            check.refuse(name, "It must be callable.", check.describe(callback), TypeError)
    show = shown(progress, "problems")
    results: dict[int, Result] = {}
    stream = _stream(function, calls, workers, client)
    with (
        closing(stream),
        show([1] * len(calls)) as step,
    ):
        for index, result in stream:
            results[index] = result
            if on_result is not None:
                on_result(index, result)
            step()
    return [results[index] for index in range(len(calls))]


def _stream(function: Callable[..., Any], calls: Sequence[Call], workers: int | None, client: Any) -> Results:
    """Select the workers; results come with the indices of their problems."""
    number = check.threads(None) if workers is None else check.count(workers, "workers", 1)
    if client is not None:
        if workers is not None:
            check.refuse("workers", "A client has workers of its own.", f"{number} beside a client")
        if not callable(getattr(client, "submit", None)) or getattr(client, "asynchronous", False):
            rule = "It must be a distributed.Client, not an asynchronous one, or an Executor."
            check.refuse("client", rule, check.describe(client), TypeError)
        if callable(getattr(client, "get_executor", None)):
            client = client.get_executor(pure=False)  # Dask makes equal calls of pure functions once
        return _by_executor(client, function, calls, 1000, cancel=True)
    number = min(number, len(calls), 61 if sys.platform == "win32" else len(calls))  # the limit of Windows
    if number <= 1 or _within.get():  # in a worker, the other workers already use the cores
        return _in_turn(function, calls)
    return _by_processes(function, calls, number)


def _in_turn(function: Callable[..., Any], calls: Sequence[Call]) -> Results:
    for index, (args, kwargs) in enumerate(calls):
        try:
            result = function(*args, **kwargs)
        except Exception as error:
            error.add_note(f"This was problem {index} (from 0) of {len(calls)}.")
            raise
        yield index, result


def _by_processes(function: Callable[..., Any], calls: Sequence[Call], number: int) -> Results:
    try:
        pickle.dumps(function)
    except Exception as error:  # pickling can raise anything
        rule = "It must be picklable: define it in a module, or set workers=1."
        raise TypeError(f"Invalid function. {rule} Given {check.describe(function)}: {error}.") from error
    context = _Context()
    pool = ProcessPoolExecutor(number, context, _begin)
    try:
        # If a worker dies, Python 3.11's pool fails on futures that were cancelled.
        yield from _by_executor(pool, function, calls, 4 * number, cancel=False)
    except BaseException:  # also Ctrl-C, and a caller that stops early
        for process in context.started:
            if process.is_alive():
                process.kill()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _by_executor(
    executor: Executor, function: Callable[..., Any], calls: Sequence[Call], ahead: int, cancel: bool
) -> Results:
    """Submit a limited number of calls ahead, until all calls before the first failure are done."""
    pending: dict[Future[Any], int] = {}
    failure: BaseException | None = None
    following, bound = 0, len(calls)
    try:
        while following < bound or min(pending.values(), default=bound) < bound:
            while following < bound and len(pending) < ahead:
                pending[executor.submit(_call, function, *calls[following])] = following
                following += 1
            for future in wait(pending, 1.0, FIRST_COMPLETED).done:  # Windows sees Ctrl-C only between waits
                index, error = pending[future], future.exception()
                if isinstance(error, BrokenExecutor):
                    raise error
                if error is None:
                    yield index, future.result()
                elif index < bound:
                    failure, bound = error, index
                del pending[future]
    except BrokenExecutor as error:
        raise RuntimeError(_DEAD.format(min(pending.values(), default=0), following - 1)) from error
    finally:
        for future in pending if cancel else ():
            future.cancel()
    if failure is not None:
        failure.add_note(f"This was problem {bound} (from 0) of {len(calls)}.")
        raise failure


class _Process(SpawnProcess):
    """A process whose libraries have one thread: they read the inherited variables when they are imported."""

    def start(self) -> None:
        with _STARTING:
            before = {name: os.environ.get(name) for name in _THREADS.split()}
            os.environ.update(dict.fromkeys(before, "1"))
            try:
                super().start()
            finally:
                for name, value in before.items():
                    del os.environ[name]
                    if value is not None:
                        os.environ[name] = value


class _Context(SpawnContext):
    """Makes the processes of one pool, and keeps a list of them."""

    def __init__(self) -> None:
        self.started: list[_Process] = []

    def Process(self, *args: Any, **kwargs: Any) -> _Process:  # type: ignore[override]  # noqa: N802
        self.started.append(_Process(*args, **kwargs))
        return self.started[-1]


def _begin() -> None:
    """Prepare a worker: it ignores Ctrl-C, and ends with its parent (an idle pool's worker would not)."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
        os._exit(1)


def _call(function: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    token = _within.set(True)
    try:
        return function(*args, **kwargs)
    except Exception as error:
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:  # an exception that cannot be unpickled would break the pool
            raise RuntimeError(repr(error)) from error
        raise
    finally:
        _within.reset(token)
