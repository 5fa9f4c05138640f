"""Tables wherever they are: text, numpy's and Parquet files, frames of pandas and polars.

Examples
--------
>>> import pandas as pd
>>> read_table(pd.DataFrame({"x": [1.0], "y": [2.0]}), "points").names
('x', 'y')
"""

import os
from pathlib import Path
from typing import Any

from mexpress import _validation as check
from mexpress.extras import required
from mexpress.io.archives import read_arrays
from mexpress.io.endings import refuse_foreign
from mexpress.io.labelled import is_labelled
from mexpress.io.tables import ArrayTable, Table
from mexpress.io.text import STANDARD_INPUT, read_text

Source = str | os.PathLike[str] | Any
"""A file, or a frame: an object with columns, each a `to_numpy()` away."""


def is_frame(source: Source) -> bool:
    """Whether this is a frame, and no file.

    Examples
    --------
    >>> is_frame("points.csv")
    False
    """
    return hasattr(source, "columns") and hasattr(source, "__getitem__")


def expect_source(source: Source, name: str) -> None:
    """Refuse what is neither the name of a file nor a frame.

    Examples
    --------
    >>> expect_source([[1, 2], [3, 4]], "points")
    Traceback (most recent call last):
        ...
    TypeError: Invalid points. It must be the name of a file, or a frame; arrays need no reading. Given [[1, 2],
    [3, 4]].
    """
    if not (is_frame(source) or isinstance(source, str | os.PathLike)):
        rule = "It must be the name of a file, or a frame; arrays need no reading."
        check.refuse(name, rule, check.describe(source), TypeError)


def where(source: Source) -> str:
    """Return what messages call it.

    Examples
    --------
    >>> where("data/points.csv")
    'points.csv'
    """
    if is_frame(source):
        return "the frame"
    if is_labelled(source):
        return "the DataArray"
    return "standard input" if str(source) == STANDARD_INPUT else Path(source).name


def read_table(source: Source, name: str) -> Table:
    """Read a table: a frame, `.npy`, `.parquet`, or else text.

    Parameters
    ----------
    source : path or frame
        What to read; "-" is text from standard input.
    name : str
        What messages call what is read.

    Raises
    ------
    ValueError
        If the file is damaged, or no table; of files of other kinds the message says which are read.
    ImportError
        If it is Parquet, and pyarrow is not installed.
    OSError
        If it cannot be read.

    Examples
    --------
    >>> import pandas as pd
    >>> read_table(pd.DataFrame({"x": [1.0, 3.0], "y": [2.0, None]}), "points").numbers([1, 0]).tolist()
    [[2.0, 1.0], [nan, 3.0]]
    """
    if is_frame(source):
        return ArrayTable.of_frame(source, where(source), name)
    path = Path(source)
    ending = path.suffix.lower()
    if ending == ".npy":
        return ArrayTable.of(read_arrays(path, name)[name], path.name, name)
    if ending in {".parquet", ".pq"}:
        return ArrayTable.of_frame(_read_parquet(path, name), path.name, name)
    refuse_foreign(path, name)
    return read_text(path, name)


def _read_parquet(path: Path, name: str) -> Any:
    arrow, parquet = (
        required(module, "Reading Parquet files needs pyarrow", "parquet")
        for module in ("pyarrow", "pyarrow.parquet")
    )
    try:
        with path.open("rb") as file:
            return parquet.read_table(file)
    except arrow.ArrowException as error:
        check.refuse(name, "It must be a Parquet file.", f"{path.name}: {error}")
