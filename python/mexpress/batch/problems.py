"""Many problems at once: what users call."""

from __future__ import annotations

import inspect
import os
import sys
import time
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from traceback import format_exception
from typing import Any, Literal, TypeVar, overload

from mexpress import _validation as check
from mexpress.batch.agenda import Agenda, Results
from mexpress.batch.calls import Failure, Outcome, Task, within
from mexpress.batch.clients import by_client
from mexpress.batch.journal import Journal
from mexpress.batch.pickling import dumps, is_out_of_reach, takes_anything
from mexpress.batch.sharing import Call
from mexpress.batch.workers import by_processes
from mexpress.logger import LOG
from mexpress.progress import Show, shown

Result = TypeVar("Result")
Problem = tuple[Any, ...] | Mapping[str, Any]
Work = Callable[[Agenda], Generator[Results, None, None]]

_ON_ERROR = ("raise", "return")


@overload
def map_problems(
    function: Callable[..., Result],
    problems: Iterable[Problem],
    workers: int | None = None,
    client: Any = None,
    progress: bool | Callable[..., Any] = False,
    on_result: Callable[[int, Any], object] | None = None,
    *,
    on_error: Literal["return"],
    **options: Any,
) -> list[Result | Failure]: ...


@overload
def map_problems(
    function: Callable[..., Result],
    problems: Iterable[Problem],
    workers: int | None = None,
    client: Any = None,
    progress: bool | Callable[..., Any] = False,
    on_result: Callable[[int, Result], object] | None = None,
    **options: Any,
) -> list[Result]: ...


def map_problems(
    function: Callable[..., Any],
    problems: Iterable[Problem],
    workers: int | None = None,
    client: Any = None,
    progress: bool | Callable[..., Any] = False,
    on_result: Callable[[int, Any], object] | None = None,
    *,
    on_error: str = "raise",
    timeout: float | None = None,
    retries: int = 0,
    resume: str | os.PathLike[str] | None = None,
    **options: Any,
) -> list[Any]:
    """Call a function on many problems, on all cores.

    Every core runs a process with one thread, since Python's lock admits only one thread at a time outside the Rust
    core. On 60 problems of 60 matches, with the paper's criteria and two cores, two processes took 11 s, two threads of
    Python 20 s, and a loop 19 s (``benches/reproduce.py batches`` times all ways). Processes start in about a second,
    so a few small problems gain nothing. Small problems go to them many at a time.

    Parameters
    ----------
    function : callable
        A function such as `select_warp`. It is a function of a module; with the extra ``notebook`` also a lambda, or a
        function of a notebook. Its arguments and its results must be picklable. Processes import the calling script, so
        a script must call this under ``if __name__ == "__main__":``, as with `multiprocessing`.
    problems : iterable of tuples or mappings
        The arguments of each call, by position or by name. Arrays that problems share, or are parts of, are sent once,
        and a file that is mapped into memory (`numpy.memmap`) is mapped by every process: these cannot be written to.
    workers : int, optional
        Number of processes; MEXPRESS_NUM_THREADS or the number of cores by default. With 1 and no timeout, a loop in
        this process makes the calls: it takes any function, and the calls may use all cores.
    client : distributed.Client or concurrent.futures.Executor, optional
        Makes the calls with its own workers instead. Pass ``threads=1`` if it runs several calls on one machine.
    progress : bool or callable, default False
        Whether to show progress on the terminal; or what makes a bar, such as ``tqdm.tqdm``. It is called with
        ``total`` and ``desc``, the number of problems and what they are. What it returns has ``update(1)`` called after
        each problem, and ``close()`` at the end. What they raise ends the work.
    on_result : callable, optional
        Called in this thread with the index and the result of each problem, as soon as the result arrives. What it
        raises ends the work, with a note of the index.
    on_error : {"raise", "return"}, default "raise"
        What to do with a problem that fails: raise its error, or have a `Failure` in the place of its result.
    timeout : float, optional
        Seconds that a call may take; a longer one fails with a TimeoutError. Its process is ended. A client's worker
        cannot be: there the call goes on, but nobody waits for it.
    retries : int, default 0
        How often a problem that fails is tried again.
    resume : str or PathLike, optional
        A file that keeps every result as soon as it arrives. If it is there, the results of the same calls are taken
        from it, and only the others are made; failures are tried again. It holds pickles, of this version: open only
        what you have written.
    **options
        Further arguments by name, the same for every call.

    Returns
    -------
    list
        The results, in the order of the problems.

    Raises
    ------
    ValueError, TypeError
        If an argument is invalid: a problem is neither a tuple nor a mapping, the function cannot be pickled, the file
        is another one.
    Exception
        The exception of the first problem that fails, in the order of the problems, with a note of its index.
        Earlier problems are finished; later unfinished ones are cancelled.
    RuntimeError
        If a process dies three times at a problem, or the function raises an exception that cannot be pickled.

    See Also
    --------
    iterate_problems : Results one by one, as they come.

    Notes
    -----
    A process that is killed, or runs out of memory, is replaced. Nothing that it had done is lost or done again, and
    the problem at which it ended is begun again, twice at most. ``logging.getLogger("mexpress")`` is told of that, of
    every failure and repetition as a warning, and of the begin and the end at the level INFO.

    The seed is an argument of each call, so results do not depend on the workers, except for the last bits of numpy's
    products, which depend on the number of threads of its BLAS (a process has one). Ctrl-C ends the processes at once;
    `on_result` and the file have received all results so far.

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
    stream = iterate_problems(
        function,
        problems,
        workers,
        client,
        progress,
        on_error=on_error,
        timeout=timeout,
        retries=retries,
        resume=resume,
        **options,
    )
    if on_result is not None:
        _check_listener(on_result)
    results: dict[int, Any] = {}
    with closing(stream):
        for index, result in stream:
            results[index] = result
            if on_result is not None:
                try:
                    on_result(index, result)
                except Exception as error:
                    error.add_note(f"on_result raised this for problem {index} (from 0).")
                    raise
    return [results[index] for index in range(len(results))]


def iterate_problems(
    function: Callable[..., Any],
    problems: Iterable[Problem],
    workers: int | None = None,
    client: Any = None,
    progress: bool | Callable[..., Any] = False,
    *,
    on_error: str = "raise",
    timeout: float | None = None,
    retries: int = 0,
    resume: str | os.PathLike[str] | None = None,
    **options: Any,
) -> Generator[tuple[int, Any], None, None]:
    """Call a function on many problems, on all cores, and return results as they come.

    Work begins when the first result is asked for. Whoever stops early ends it.

    Parameters
    ----------
    function, problems, workers, client, progress, on_error, timeout, retries, resume, **options
        As `map_problems` takes them.

    Yields
    ------
    index : int
        Of the problem, from 0. The order is that in which they are done.
    result
        What the function returned, or a `Failure`.

    Raises
    ------
    ValueError, TypeError, RuntimeError, Exception
        As `map_problems` does. The error of a problem is raised after the results of all before it.

    Examples
    --------
    >>> import mexpress as mx
    >>> for index, power in mx.iterate_problems(pow, [(2, 3), (3, 3)], workers=1):
    ...     print(index, power)
    0 8
    1 27
    """
    calls = _calls(problems)
    if not callable(function):
        check.refuse("function", "It must be callable.", check.describe(function), TypeError)
    if not isinstance(on_error, str) or on_error not in _ON_ERROR:
        rule = f"It must be 'raise' or 'return'.{check.nearest_name(on_error, _ON_ERROR)}"
        error = ValueError if isinstance(on_error, str) else TypeError
        check.refuse("on_error", rule, check.describe(on_error), error)
    limit = None if timeout is None else check.positive(timeout, "timeout")
    retries = check.count(retries, "retries", 0)
    file = None if resume is None else check.path(resume, "resume")
    show = shown(progress, "problems")
    task = Task(function, options)
    work = _work(task, calls, workers, client, limit)
    return _results(task, calls, work, show, file, retries, on_error == "raise")


def _results(
    task: Task, calls: Sequence[Call], work: Work, show: Show, file: Path | None, retries: int, raising: bool
) -> Generator[tuple[int, Any], None, None]:
    """Do what is to be done; return results that a file holds first."""
    name, start = getattr(task.function, "__qualname__", repr(task.function)), time.perf_counter()
    LOG.info("Calling %s on %d problems.", name, len(calls))
    with ExitStack() as stack:
        step = stack.enter_context(show([1] * len(calls)))
        left = dict.fromkeys(range(len(calls)))
        journal = Journal(file, task, calls) if file else None
        for index, result in journal.known() if journal else ():
            if index in left:
                del left[index]
                yield index, result
                step()
        if journal:
            LOG.info("%s holds %d results of %d.", file, len(calls) - len(left), len(calls))
        agenda = Agenda(left, len(calls), retries, raising, journal.add if journal else None)
        for results in stack.enter_context(closing(work(agenda))):
            for index, result in results:
                yield index, result
                step()
    failures = len(agenda.failures)
    LOG.info("%d problems in %.2g s, %d failures.", len(calls), time.perf_counter() - start, failures)
    agenda.conclude()


def _calls(problems: Iterable[Problem]) -> list[Call]:
    calls: list[Call] = []
    for problem in check.items(problems, "problems", "They must be tuples or mappings."):
        if isinstance(problem, tuple):
            calls.append((problem, {}))
        elif isinstance(problem, Mapping) and all(isinstance(name, str) for name in problem):
            calls.append(((), problem))
        else:
            rule = "It must be a tuple of arguments, or a mapping of them by name."
            check.refuse(f"problems[{len(calls)}]", rule, check.describe(problem), TypeError)
    return calls


def _check_listener(on_result: Any) -> None:
    rule = "It must be callable with two arguments, an index and a result."
    if not callable(on_result):
        check.refuse("on_result", rule, check.describe(on_result), TypeError)
    try:
        parameters = inspect.signature(on_result)
    except ValueError:  # Python knows no parameters of some builtins
        return
    try:
        parameters.bind(0, None)
    except TypeError as error:
        check.refuse("on_result", rule, f"{check.describe(on_result)}: {error}", TypeError)


def _work(task: Task, calls: Sequence[Call], workers: int | None, client: Any, timeout: float | None) -> Work:
    """Return who makes the calls."""
    number = check.threads(None) if workers is None else check.count(workers, "workers", 1)
    if client is not None:
        if workers is not None:
            check.refuse("workers", "A client has workers of its own.", f"{number} beside a client")
        if not callable(getattr(client, "submit", None)) or getattr(client, "asynchronous", False):
            rule = "It must be a distributed.Client, not an asynchronous one, or an Executor."
            check.refuse("client", rule, check.describe(client), TypeError)
        return lambda agenda: by_client(client, task, calls, agenda, timeout)
    number = min(number, len(calls), 61 if sys.platform == "win32" else len(calls))  # the limit of Windows
    if within.get() or (number <= 1 and timeout is None):  # in a worker, the others already use the cores
        return lambda agenda: _in_turn(task, calls, agenda, timeout)
    _check_reach(task.function)
    return lambda agenda: by_processes(task, calls, agenda, number, timeout)


def _check_reach(function: Any) -> None:
    """Refuse a function that does not get to other processes."""
    rule = "It must be picklable: define it in a module, pip install 'mexpress[notebook]', or set workers=1."
    if is_out_of_reach(function) and not takes_anything():
        check.refuse("function", rule, f"{check.describe(function)} of a notebook", TypeError)
    try:
        dumps(function)
    except Exception as error:  # pickling can raise anything
        raise TypeError(f"Invalid function. {rule} Given {check.describe(function)}: {error}.") from error


def _in_turn(
    task: Task, calls: Sequence[Call], agenda: Agenda, timeout: float | None
) -> Generator[Results, None, None]:
    """Make calls here."""
    while agenda.unsettled:
        (index,) = agenda.take(1, 0.0)
        yield agenda.settle([(index, _outcome(task, index, calls[index], timeout))])


def _outcome(task: Task, index: int, call: Call, timeout: float | None) -> Outcome:
    if timeout is not None:
        return task.attempt(index, (*call, []), {}, timeout)
    try:
        return True, task.call(*call)
    except Exception as error:  # as it is: it need not be sent
        return False, Failure(index, error, "".join(format_exception(error)))
