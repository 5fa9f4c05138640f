"""Libraries of the extras, which are imported where they are used."""

from __future__ import annotations

import sys
from types import ModuleType


def required(module: str, purpose: str, extra: str) -> ModuleType:
    """Return a module of a library that only some uses need.

    Raises
    ------
    ImportError
        If it is not installed; the message says what needs it, and names the extra.

    Examples
    --------
    >>> required("a_library_of_the_moon", "Moonlight needs it", "moon")
    Traceback (most recent call last):
    ImportError: Moonlight needs it: pip install 'mexpress[moon]'
    """
    try:
        __import__(module)  # unlike import_module, it looks for the library first, then for its module
    except ImportError as error:
        raise ImportError(f"{purpose}: pip install 'mexpress[{extra}]'") from error
    return sys.modules[module]
