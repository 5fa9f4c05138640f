"""Versions for a problem report."""

from __future__ import annotations

import os
import platform
import re
from importlib.metadata import PackageNotFoundError, requires, version

import numpy as np

from mexpress import _validation as check


def show_versions() -> None:
    """Print the versions of mexpress and of its dependencies: please paste them into a problem report.

    `threads` is the default number of threads of a call. The processor's features are those that numpy detects; they
    determine the order of sums, and so the last digits. The libraries below BLAS belong to the extras; they are not
    imported.

    Raises
    ------
    ValueError
        If the environment variable MEXPRESS_NUM_THREADS is not a number of threads.

    Examples
    --------
    >>> import mexpress as mx
    >>> mx.show_versions()
    mexpress      ...
    Python        ...
    platform      ...
    processor     ...
    threads       ... of ... cores
    numpy         ...
    BLAS          ...
    distributed   ...
    """
    entries = versions()
    width = 2 + max(map(len, entries))
    print("\n".join(f"{name:{width}}{entry}" for name, entry in entries.items()))


def versions() -> dict[str, str]:
    """Return what `show_versions` prints, by name.

    Examples
    --------
    >>> list(versions())[:2]
    ['mexpress', 'Python']
    """
    return _machine() | {name: _installed(name) for name in _optional()}


def _machine() -> dict[str, str]:
    """Everything except the optional libraries."""
    config = np.show_config(mode="dicts")
    blas = config["Build Dependencies"]["blas"]
    simd = config["SIMD Extensions"]
    features = [*simd.get("baseline", []), *simd.get("found", [])]  # numpy omits empty lists
    return {
        "mexpress": version("mexpress"),
        "Python": f"{platform.python_version()}, {platform.python_implementation()}",
        "platform": platform.platform(),
        "processor": ", ".join([platform.machine(), *features]),
        "threads": f"{check.threads(None)} of {os.cpu_count()} cores",
        "numpy": np.__version__,
        "BLAS": f"{blas['name']} {blas.get('version', '')}".rstrip(),
    }


def _optional() -> list[str]:
    """Libraries of the extras, in the order of pyproject.toml."""
    named = (re.match(r"[\w.-]+", entry) for entry in requires("mexpress") or () if "extra ==" in entry)
    return [name[0] for name in named if name]


def _installed(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"
