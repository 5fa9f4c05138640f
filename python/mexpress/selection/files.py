"""Models and selections read from files, which is safe whatever the source: they hold plain arrays."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress.io.archives import read_arrays
from mexpress.models import files

_HEADER = {"format", "version", "kind"}


def load(path: str | os.PathLike[str]) -> Any:
    """Read a model or a selection from a file that its `save` wrote.

    Parameters
    ----------
    path : str or path
        Name of the file. Loading executes nothing in it.

    Returns
    -------
    Warp, Surface, WarpSelection or SurfaceSelection
        Equal to what was saved, bit for bit.

    Raises
    ------
    ValueError
        If the file holds neither a model nor a selection of mexpress, is damaged, or comes from a newer version.
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
    return rebuilt(read(path), path)


def read(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """Return the arrays of a file that this version of mexpress can rebuild.

    Raises
    ------
    ValueError, OSError
        As of `load`.
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
    if name == files.FORMAT and (version > files.VERSION or kind not in files.KINDS):
        raise _invalid(
            path, f"a {kind} of format {version}; this version of mexpress reads up to {files.VERSION}"
        )
    if name != files.FORMAT:
        raise _invalid(path, f"which holds {name!r}")
    return arrays


def rebuilt(arrays: Mapping[str, NDArray[Any]], path: str | os.PathLike[str]) -> Any:
    """Return what the arrays of a file are, the path of which messages name."""
    kind, path = str(arrays["kind"]), Path(path)
    try:
        return files.KINDS[kind].from_arrays(arrays)
    except KeyError as error:
        raise _invalid(path, f"a {kind} without {error}") from error
    except (TypeError, ValueError) as error:
        raise _invalid(path, f"a {kind} that cannot be rebuilt: {str(error).removesuffix('.')}") from error


def _invalid(path: Path, what: str) -> ValueError:
    return ValueError(f"Invalid path. It must name a saved model or selection. Given {str(path)!r}, {what}.")
