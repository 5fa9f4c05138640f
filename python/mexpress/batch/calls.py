"""One call of the user's function, wherever it is made, and what comes of it."""

from __future__ import annotations

import pickle
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextvars import ContextVar, copy_context
from dataclasses import dataclass, field
from functools import partial
from queue import Empty, SimpleQueue
from threading import TIMEOUT_MAX, Thread
from typing import Any, TypeAlias

from mexpress.batch.pickling import dumps
from mexpress.batch.sharing import Array, Bytes, Key, Light, whole

Outcome: TypeAlias = tuple[bool, Any]
"""True and the result, or False and the failure."""

within: ContextVar[bool] = ContextVar("within", default=False)
"""Whether this is a worker: there, the other workers already use the cores."""


@dataclass(frozen=True)
class Failure:
    """A problem without a result, in the place of its result.

    Attributes
    ----------
    index : int
        Of the problem, from 0.
    error : BaseException
        What the function raised; a TimeoutError if the call took too long; a RuntimeError if its process ended.
    traceback : str
        Where it was raised, as Python prints it; empty if the call did not come to an end.

    Examples
    --------
    >>> import mexpress as mx
    >>> import math
    >>> found = mx.map_problems(math.sqrt, [(4,), (-1,)], workers=1, on_error="return")
    >>> found
    [2.0, Failure(index=1, error=ValueError('math domain error'))]
    >>> [failure.index for failure in found if isinstance(failure, mx.Failure)]
    [1]
    """

    index: int
    error: BaseException
    traceback: str = field(default="", repr=False)


@dataclass(frozen=True)
class Task:
    """What is the same for all problems: a function, options, and the arrays that problems share."""

    function: Callable[..., Any]
    options: Mapping[str, Any]
    sources: Sequence[Bytes] = ()

    def call(self, args: tuple[Any, ...], named: Mapping[str, Any]) -> Any:
        """Return the result of a problem."""
        return self.function(*args, **{**self.options, **named})

    def attempt(
        self, index: int, light: Light | bytes, rows: Mapping[Key, Array], timeout: float | None = None
    ) -> Outcome:
        """Make a call in a worker; with a timeout in a thread, which is left to itself if it takes too long."""
        if timeout is not None:
            return self._attempt_within(timeout, index, light, rows)
        try:
            given = pickle.loads(light) if isinstance(light, bytes) else light
            return True, self.call(*whole(given, self.sources, rows))
        except BaseException as error:  # also SystemExit, which ends no worker
            return failed(index, error)

    def _attempt_within(
        self, timeout: float, index: int, light: Light | bytes, rows: Mapping[Key, Array]
    ) -> Outcome:
        outcome: SimpleQueue[Outcome] = SimpleQueue()
        call = partial(copy_context().run, lambda: outcome.put(self.attempt(index, light, rows)))
        Thread(target=call, daemon=True).start()
        try:
            return outcome.get(timeout=min(timeout, TIMEOUT_MAX))
        except Empty:
            return timed_out(index, timeout)


def assembled(function: Callable[..., Any], options: Light, sources: Sequence[Bytes]) -> Task:
    """Return a task of what was sent."""
    return Task(function, whole(options, sources, {})[1], sources)


def packed(
    task: Task,
    index: int,
    light: Light | bytes,
    rows: Mapping[Key, Array],
    timeout: float | None = None,
) -> bytes:
    """Make a call in a worker; return its outcome as it is sent."""
    try:
        return dumps(task.attempt(index, light, rows, timeout))
    except Exception as error:  # pickling can raise anything
        return dumps(failed(index, unpicklable(error)))


def unpacked(index: int, outcome: bytes | memoryview) -> Outcome:
    """Return the outcome of a call that was sent."""
    try:
        found: Outcome = pickle.loads(outcome)
    except Exception as error:  # what can be sent cannot always be read
        return failed(index, error)
    return found


def unpicklable(error: Exception) -> TypeError:
    """Return the error of a result that neither goes to another process nor into a file."""
    try:
        raise TypeError(f"The result cannot be pickled: {error}") from error
    except TypeError as new:
        return new


def failed(index: int, error: BaseException) -> Outcome:
    """Return the outcome of a call that raised an error, one that can be sent."""
    text = "".join(traceback.format_exception(error))
    try:
        pickle.loads(dumps(error))
    except Exception:  # its arguments may not be those that it was made of
        error = RuntimeError(repr(error))
    return False, Failure(index, error, text)


def timed_out(index: int, timeout: float) -> Outcome:
    """Return the outcome of a call that took too long."""
    return False, Failure(index, TimeoutError(f"The call took longer than {timeout:g} s."))
