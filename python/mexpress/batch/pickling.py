"""What goes to workers and comes back as bytes: by reference where workers can import it, else by value."""

from __future__ import annotations

import pickle
import sys
from collections.abc import Iterable
from multiprocessing.connection import Connection
from typing import Any


def dumps(value: Any) -> bytes:
    """Return the bytes of any value that Python can pickle, or cloudpickle if it is installed.

    Workers import the calling script, but a notebook has nothing to import: its functions and classes go by value, as
    lambdas do.

    Examples
    --------
    >>> pickle.loads(dumps([1, 2]))
    [1, 2]
    """
    try:
        packed = pickle.dumps(value, pickle.HIGHEST_PROTOCOL)
    except Exception:  # pickling can raise anything
        if not takes_anything():
            raise
    else:
        # To find is quicker than `in`, which asks first whether it is given a number.
        if packed.find(b"__main__") < 0 or _is_main_imported() or not takes_anything():
            return packed
    import cloudpickle  # noqa: PLC0415 - an extra

    return bytes(cloudpickle.dumps(value))


def takes_anything() -> bool:
    """Return whether values can be sent that no module has."""
    try:
        import cloudpickle  # noqa: F401, PLC0415 - an extra
    except ImportError:
        return False
    return True


def is_out_of_reach(function: Any) -> bool:
    """Return whether a function is one of a notebook, which workers cannot import."""
    return getattr(function, "__module__", None) == "__main__" and not _is_main_imported()


def _is_main_imported() -> bool:
    """Return whether processes that are spawned import the module __main__: a script, or ``python -m module``."""
    main = sys.modules["__main__"]
    name = getattr(getattr(main, "__spec__", None), "name", None)
    if name is not None:
        return not f".{name}".endswith(".__main__")
    return getattr(main, "__file__", None) is not None


def frames(value: Any) -> list[bytes | memoryview]:
    """Return what is sent of a value: its pickle, and the memory of its arrays as it is."""
    buffers: list[pickle.PickleBuffer] = []
    packed = pickle.dumps(value, pickle.HIGHEST_PROTOCOL, buffer_callback=buffers.append)
    memory = [buffer.raw() for buffer in buffers]
    return [pickle.dumps((packed, [part.nbytes for part in memory])), *memory]


def send(connection: Connection, some: Iterable[bytes | memoryview]) -> None:
    """Send frames to a process that reads."""
    for part in some:
        connection.send_bytes(part)


def received(connection: Connection) -> Any:
    """Return a value that was sent as frames; its arrays can be written to."""
    packed, sizes = connection.recv()
    memory = [bytearray(size) for size in sizes]
    for part in memory:
        connection.recv_bytes_into(part)
    return pickle.loads(packed, buffers=memory)
