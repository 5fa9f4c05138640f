"""Files as a whole: numpy's archives of arrays read from strangers, and files that are replaced once they are complete.

Examples
--------
>>> import tempfile
>>> with tempfile.TemporaryDirectory() as folder:
...     with replacing(f"{folder}/depth.npy") as file:
...         np.save(file, np.ones(2))
...     read_arrays(Path(f"{folder}/depth.npy"), "cloud")
{'cloud': array([1., 1.])}
"""

import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check

ARCHIVES = {".npy", ".npz"}
"""Endings of the files that `read_arrays` reads."""

_MAGIC = b"\x93NUMPY", b"PK"
"""First bytes of such files."""


def read_arrays(path: Path, name: str) -> dict[str, NDArray[Any]]:
    """Read the arrays of an .npz file by their names, or the one of an .npy file.

    Parameters
    ----------
    path : path
        Name of the file.
    name : str
        What messages, and the result, call the array of an .npy file.

    Returns
    -------
    dict of str to ndarray
        The arrays, none of objects.

    Raises
    ------
    ValueError
        If the file is damaged or holds objects.
    OSError
        If it cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.save(f"{folder}/depth.npy", np.ones(2))
    ...     read_arrays(Path(f"{folder}/depth.npy"), "cloud")
    {'cloud': array([1., 1.])}
    """
    with path.open("rb") as file:
        if not file.read(6).startswith(_MAGIC):
            rule = "The file must be an archive of arrays, .npy or .npz."
            check.refuse(
                name, rule, f"{path.name}, which is {'another kind of file' if file.tell() else 'empty'}"
            )
        file.seek(0)
        try:
            loaded = np.load(file, allow_pickle=False)
            if isinstance(loaded, np.ndarray):
                return {name: loaded}
            return {key: loaded[key] for key in loaded.files}
        except Exception as error:  # damaged bytes raise whatever the layers of zip and npy meet first
            rule = "The file must hold arrays of numbers."
            # numpy's own words advise to load objects, which can execute anything
            fault = "with objects" if "allow_pickle" in str(error) else f"which is damaged: {error}"
            check.refuse(name, rule, f"{path.name}, {fault}")


def read_data(path: Path, name: str) -> dict[str, NDArray[Any]]:
    """Read arrays as `read_arrays` does; refuse those of a saved model, which are no data.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.savez(f"{folder}/warp.npz", format="mexpress model", kind="warp")
    ...     read_data(Path(f"{folder}/warp.npz"), "points")
    Traceback (most recent call last):
        ...
    ValueError: Invalid points. The file must hold data. Given warp.npz, a saved model, which mexpress.load reads.
    """
    arrays = read_arrays(path, name)
    if {"format", "kind"} <= arrays.keys():
        check.refuse(
            name, "The file must hold data.", f"{path.name}, a saved model, which mexpress.load reads"
        )
    return arrays


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Open a file for writing that takes its name, and an older file's place, once it is complete.

    Parameters
    ----------
    path : str or path
        Name of the file, taken as it is; of a link, the file that it leads to. After an error an older file of this
        name is untouched. What is there and no file, such as a pipe, is written as it comes.

    Raises
    ------
    OSError
        If the file cannot be written; it has this name.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with replacing(f"{folder}/a.txt") as file:
    ...         count = file.write(b"all of it")
    ...     Path(f"{folder}/a.txt").read_text()
    'all of it'
    """
    path = check.path(path)
    real = Path(os.path.realpath(path))
    if real.exists() and not (real.is_file() or real.is_dir()):
        with real.open("wb") as file:
            yield file
        return
    part = real.with_name(f"{uuid.uuid4().hex}.part")
    try:
        with part.open("xb") as file:
            yield file
        part.replace(real)
    except OSError as error:
        if error.errno is None or error.filename not in (None, str(part)):
            raise
        # The file that could not be written is, to the user, the one that was named.
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        with suppress(OSError):  # there is none, or no folder either
            part.unlink()
