"""Models in files: one .npz archive of plain arrays, which is safe to load from any source."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from mexpress import _validation as check
from mexpress.io.archives import read_arrays, replacing

FORMAT = "mexpress model"
VERSION = 1

_HEADER = {"format", "version", "kind"}

KINDS: dict[str, Any] = {}
"""Classes of models in files, by their kind; `Model` adds its subclasses."""


def save(model: Any, path: str | os.PathLike[str]) -> None:
    """Write a model, of a class in `KINDS`, to a file; an existing file is replaced once the new one is complete.

    Raises
    ------
    TypeError
        If the class of the model is not in `KINDS`.
    OSError
        If the file cannot be written; an existing file is then unchanged.
    """
    if KINDS.get(getattr(model, "kind", "")) is not type(model):
        raise TypeError(f"Invalid model. It must be one of {_class_names()}. Given {type(model).__name__}.")
    header = {"format": np.array(FORMAT), "version": np.array(VERSION), "kind": np.array(model.kind)}
    with replacing(path) as file:  # np.savez would append .npz to a name
        np.savez(file, allow_pickle=False, **header, **model.to_arrays())


def load(path: str | os.PathLike[str]) -> Any:
    """Read a model from a file that `save` wrote.

    Parameters
    ----------
    path : str or path
        Name of the file. Loading executes nothing in it.

    Returns
    -------
    Warp or another model
        Equal to the saved model, bit for bit.

    Raises
    ------
    ValueError
        If the file does not hold a model of mexpress, is damaged, or comes from a newer version.
    OSError
        If the file cannot be opened; FileNotFoundError if it does not exist.

    Examples
    --------
    >>> import tempfile
    >>> from mexpress import fit_warp
    >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
    >>> warp = fit_warp(square, [[5, 5], [90, 0], [0, 110], [95, 99]], square[:3])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     warp.save(f"{folder}/warp.npz")
    ...     load(f"{folder}/warp.npz")
    Warp(fractional tps, 3 control points)
    """
    path = check.path(path)
    try:
        arrays = read_arrays(path, "array")
    except ValueError as error:
        raise _invalid(path, "a file of another kind, or a damaged one") from error
    if _HEADER - arrays.keys():
        there = ", ".join(f"{name} {array.shape}" for name, array in arrays.items()) or "nothing"
        raise _invalid(path, f"which holds {there}")
    try:
        name, version, kind = str(arrays["format"]), int(arrays["version"]), str(arrays["kind"])
    except (TypeError, ValueError) as error:
        raise _invalid(path, "whose header is damaged") from error
    if name == FORMAT and (version > VERSION or kind not in KINDS):
        raise _invalid(path, f"a {kind} of format {version}; this version of mexpress reads up to {VERSION}")
    if name != FORMAT:
        raise _invalid(path, f"which holds {name!r}")
    try:
        return KINDS[kind].from_arrays(arrays)
    except KeyError as error:
        raise _invalid(path, f"a model without {error}") from error
    except (TypeError, ValueError) as error:
        raise _invalid(path, f"a model that cannot be rebuilt: {str(error).removesuffix('.')}") from error


def _invalid(path: Path, what: str) -> ValueError:
    return ValueError(f"Invalid path. It must name a saved model. Given {str(path)!r}, {what}.")


def _class_names() -> str:
    return ", ".join(sorted(model.__name__ for model in KINDS.values()))
