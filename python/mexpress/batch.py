"""Many problems at once."""

from __future__ import annotations

import queue
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing, nullcontext
from typing import Any, TypeVar

from mexpress import _validation as check
from mexpress import workers as processes
from mexpress.progress import bar
from mexpress.workers import Call, Ledger, Outcome

__all__ = ["map_problems"]

Result = TypeVar("Result")
Problem = tuple[Any, ...] | Mapping[str, Any]


def map_problems(
    function: Callable[..., Result],
    problems: Iterable[Problem],
    workers: int | None = None,
    client: Any = None,
    progress: bool = False,
    on_result: Callable[[int, Result], object] | None = None,
    **options: Any,
) -> list[Result]:
    """Call a function on many problems, on all cores.

    The cores are used by processes with one thread each. Python's lock lets only one thread at a time do what is not
    in the core: three quarters of the time that `select_warp` takes on 60 matches with the paper's criteria, a third
    on 500, so threads of Python would gain at most 1.3 and 3 times, on however many cores
    (``benches/reproduce.py batches`` times both). A process costs about a quarter of a second to start.

    Parameters
    ----------
    function : callable
        Such as `select_warp`. It must be picklable, and so must be what it takes and returns: a function of a module,
        not a lambda. If it, or a problem's class, is defined in the script itself, this call must be under
        ``if __name__ == "__main__":``.
    problems : iterable of tuples or mappings
        Each holds the arguments of one call, by position or by name.
    workers : int, optional
        Number of processes; MEXPRESS_NUM_THREADS, or the number of cores, if not given. 1 is a loop in this process,
        which takes any function, and whose calls may use all cores themselves.
    client : distributed.Client or concurrent.futures.Executor, optional
        Makes the calls in place of processes of our own, with its workers and its threads: several calls on one
        machine should then be given ``threads=1``.
    progress : bool, default False
        Whether to show progress on the terminal.
    on_result : callable, optional
        Called in this thread with the index of a problem and its result, as soon as it is there.
    **options
        More arguments by name, the same for every call.

    Returns
    -------
    list
        The results, in the order of the problems whatever the order they came in.

    Raises
    ------
    ValueError, TypeError
        If a problem is neither a tuple nor a mapping, or something cannot be pickled.
    Exception
        What the function raises, with a note that says in which problem: the first one, in the order of the problems,
        that fails. Those that were already begun are finished before it is raised.
    RuntimeError
        If a process dies.

    Notes
    -----
    The seed of a call is among its arguments, so results do not depend on who computes them, or when. Ctrl-C ends the
    processes at once; what `on_result` has seen by then is not lost.

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
    rule = "It must be a tuple of arguments, or a mapping of them by name."
    calls: list[Call] = []
    for problem in check.items(problems, "problems", "They must be tuples or mappings."):
        if isinstance(problem, Mapping) and all(isinstance(name, str) for name in problem):
            calls.append(((), {**options, **problem}))
        elif isinstance(problem, tuple):
            calls.append((problem, options))
        else:
            check.refuse(f"problems[{len(calls)}]", rule, check.describe(problem), TypeError)
    for name, given in (("function", function), ("on_result", on_result)):
        if not callable(given) and (given is not None or name == "function"):
            check.refuse(name, "It must be callable.", check.describe(given), TypeError)
    check.flag(progress, "progress")
    ledger = Ledger(len(calls))
    stream = _stream(function, calls, workers, client, ledger)
    results: dict[int, Result] = {}
    failure: Outcome | None = None
    with closing(stream), bar(len(calls), "problems") if progress else nullcontext(lambda: None) as step:
        for outcome in stream:
            if outcome.error is None:
                results[outcome.index] = outcome.result
                if on_result is not None:
                    on_result(outcome.index, outcome.result)
            elif failure is None or outcome.index < failure.index:
                failure = outcome
                ledger.bound = outcome.index
            step()
    if failure is not None and failure.error is not None:
        failure.error.add_note(f"This was problem {failure.index} (from 0) of {len(calls)}.")
        raise failure.error
    return [results[index] for index in range(len(calls))]


def _stream(
    function: Callable[..., Any], calls: Sequence[Call], workers: int | None, client: Any, ledger: Ledger
) -> Generator[Outcome, None, None]:
    """Choose who makes the calls."""
    number = check.threads(None) if workers is None else check.count(workers, "workers", 1)
    if client is not None:
        if workers is not None:
            check.refuse("workers", "A client has workers of its own.", f"{number} beside a client")
        if not callable(getattr(client, "submit", None)) or getattr(client, "asynchronous", False):
            rule = "It must be a distributed.Client, not an asynchronous one, or an Executor."
            check.refuse("client", rule, check.describe(client), TypeError)
        return _by_client(client, function, calls, ledger)
    number = min(number, len(calls), 1024)
    if processes.in_worker() or number <= 1:
        return _in_turn(function, calls, ledger)
    return processes.run(function, calls, number, ledger)


def _in_turn(
    function: Callable[..., Any], calls: Sequence[Call], ledger: Ledger
) -> Generator[Outcome, None, None]:
    """Make the calls in this process."""
    for index, (args, kwargs) in enumerate(calls):
        if index >= ledger.bound:
            return
        try:
            outcome = Outcome(index, function(*args, **kwargs))
        except Exception as error:  # raised by the caller
            outcome = Outcome(index, error=error)
        yield outcome


def _by_client(
    client: Any, function: Callable[..., Any], calls: Sequence[Call], ledger: Ledger
) -> Generator[Outcome, None, None]:
    """Have a client make the calls; its futures are those of Dask or of the standard library."""
    # Dask takes equal calls for one, unless told that they are not pure.
    pure = {"pure": False} if callable(getattr(client, "scheduler_info", None)) else {}
    found: queue.SimpleQueue[int] = queue.SimpleQueue()
    futures = [client.submit(_called, function, args, kwargs, **pure) for args, kwargs in calls]
    try:
        for index, future in enumerate(futures):
            future.add_done_callback(lambda _, index=index: found.put(index))
        while ledger.open:
            index = processes.awaited(found)
            ledger.enter(index)
            if index < ledger.bound:
                yield _outcome(index, futures[index])
    finally:
        for future in futures:
            future.cancel()


def _called(function: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    return function(*args, **kwargs)


def _outcome(index: int, future: Any) -> Outcome:
    try:
        return Outcome(index, future.result())
    except Exception as error:  # raised by the caller
        return Outcome(index, error=error)
