"""Models in files: one .npz archive of plain arrays. `mexpress.selection.files` reads them."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from mexpress.io.archives import replacing

FORMAT = "mexpress model"
VERSION = 1

KINDS: dict[str, Any] = {}
"""Classes of models and selections in files, by their kind; `Model` and `FittedSelection` add their subclasses."""


def save(model: Any, path: str | os.PathLike[str]) -> None:
    """Write what is of a class in `KINDS` to a file; an existing file is replaced once the new one is complete.

    Raises
    ------
    TypeError
        If the class of the model is not in `KINDS`.
    OSError
        If the file cannot be written; an existing file is then unchanged.
    """
    if KINDS.get(getattr(model, "kind", "")) is not type(model):
        raise TypeError(f"Invalid model. It must be one of {_class_names()}. Given {type(model).__name__}.")
    from importlib.metadata import version  # noqa: PLC0415 - an import of mexpress need not take as long

    header = {
        "format": np.array(FORMAT),
        "version": np.array(VERSION),
        "kind": np.array(model.kind),
        "mexpress": np.array(version("mexpress")),
    }
    with replacing(path) as file:  # np.savez would append .npz to a name
        np.savez(file, allow_pickle=False, **header, **model.to_arrays())


def _class_names() -> str:
    return ", ".join(sorted(model.__name__ for model in KINDS.values()))
