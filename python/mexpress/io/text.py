"""Tables in text as people and programs write it.

Separators are semicolons, tabs, commas or blanks; comments begin with #, % or //. Cells that are empty, or NA, are
missing. Decimal commas are read unless commas separate the cells.

Examples
--------
>>> import tempfile
>>> with tempfile.TemporaryDirectory() as folder:
...     with open(f"{folder}/points.txt", "w") as file:
...         print("name;x;y", file=file)
...         print("door;1,5;NA", file=file)
...     table = read_text(Path(f"{folder}/points.txt"), "points")
>>> table.names, table.numbers([1, 2])
(['name', 'x', 'y'], array([[1.5, nan]]))
"""

import codecs
import csv
import io
import re
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.caching import cached_property
from mexpress.io.endings import readable
from mexpress.io.grids import is_grid
from mexpress.io.tables import between_labels, count_known

_NUMBER = re.compile(r"[+-]?(([0-9]+\.?[0-9]*|\.[0-9]+)(e[+-]?[0-9]+)?|nan|inf(inity)?)", re.IGNORECASE)
_THOUSANDS, _BELOW = re.compile(r"[+-]?[1-9][0-9]{0,2},[0-9]{3}"), re.compile(r"[+-]?[1-9][0-9]{0,2}")
_WHOLE = re.compile(r"[+-]?[0-9]+")
_ERROR = r"#(N/A|NV|DIV/0!|VALUE!|REF!|NUM!|NAME\?|NULL!)"
"""What spreadsheets write where there is no number."""
_NOTHING = re.compile(
    rf"(na|n/a|#na|<na>|null|none|--?|{_ERROR}|[+-]?nan\(\w*\)|[+-]?1[.,]#\w*)?",  # the last ones in C on Windows
    re.IGNORECASE,
)
_HASH = rf"""(?!{_ERROR}(\s*[,;\t"]|\s+[-+.\d#]|\s*$))#"""
_COMMENT = re.compile(rf"{_HASH}|%|//", re.IGNORECASE)
_AFTER_CELLS = re.compile(rf"""^((?:[^"]|"[^"]*")*?)\s{_HASH}.*""", re.IGNORECASE)  # not in quotes
_BYTE_ORDER_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
_UNCLEAR_COUNT = (
    "Its first line must be clear: 0, 1, ... may be names, as pandas writes for columns without, or a row; "
    "write names such as x,y in its place, or above it."
)
STANDARD_INPUT = "-"
"""Name of the file that is read from there."""


@dataclass(frozen=True, eq=False)
class TextTable:
    """A table in text: its lines, cut into cells where they are read.

    Parameters
    ----------
    where : str
        Name of the file.
    name : str
        What messages call what is read.
    names : list of str
        Names of the columns, none without a header.
    lines : list of (int, str)
        Number and text of every line below the header, of which there may be none.
    separator : str or None
        What is between cells; None for blanks.
    """

    where: str
    name: str
    names: list[str]
    lines: list[tuple[int, str]]
    separator: str | None

    @property
    def first(self) -> list[str]:
        """Cells of the first row."""
        return _split(self.lines[0][1], self.separator)

    @cached_property
    def width(self) -> int:
        """Number of columns."""
        return len(self.names or self.first)

    @cached_property
    def numeric(self) -> range:
        """The columns between those that are no numbers, at either end."""
        names = self.names or [""] * self.width
        if not self.lines:
            return range(0)
        cells = zip(self._examples, names, strict=False)
        return between_labels(
            [not (_is_number(cell) or (_is_nothing(cell) and (cell or name))) for cell, name in cells]
        )

    @property
    def _examples(self) -> list[str]:
        """The first cell of each column that holds something, or that of the first row: "-" may be among words."""
        examples = self.first
        for _, line in self.lines[1:]:
            absent = [k for k, cell in enumerate(examples) if _is_nothing(cell)]
            if not absent:
                break
            cells = _split(line, self.separator)
            for k in absent:
                examples[k] = cells[k] if k < len(cells) and not _is_nothing(cells[k]) else examples[k]
        return examples

    def words(self, column: int) -> list[str]:
        """Return a column as it is written."""
        return [self._cells(number, line, column)[column] for number, line in self.lines]

    def numbers(self, columns: Sequence[int]) -> Floats:
        """Return columns, NaN where there is no number; refuse text."""
        if not self.lines:
            return np.empty((0, len(columns)))
        lines = [line for _, line in self.lines]
        table = _loaded(lines, self.separator, columns) if self._is_even(lines) else None
        if table is not None:
            return table
        rows = [
            [cells[k] for k in columns] for cells in (self._cells(*line, max(columns)) for line in self.lines)
        ]
        comma = any(_has_comma(cell) for row in rows for cell in row)
        if comma:
            self._refuse_thousands(rows)
        plain = ["\t".join("nan" if _is_nothing(cell) else cell for cell in row) for row in rows]
        if comma and not any("." in line for line in plain):
            plain = [line.replace(",", ".") for line in plain]
        table = _loaded(plain, "\t", range(len(columns)))
        return self._one_by_one(rows, "," if comma else ".") if table is None else table

    def place(self, row: int, column: int) -> str:
        """Say what is in a cell, and where that is."""
        if not self.lines:
            return f"{self.names[column]!r} with nothing below it"
        number, line = self.lines[row]
        return f"{self._cells(number, line, column)[column]!r} in {self._line(number)}"

    def _line(self, number: int) -> str:
        return f"line {number} of {self.where}"

    def _is_even(self, lines: Sequence[str]) -> bool:
        """Whether all lines have as many cells, none of which may hold a separator."""
        if self.separator is None:
            return all(len(line.split()) == self.width for line in lines)
        more = self.width - 1
        return all(line.count(self.separator) == more and '"' not in line for line in lines)

    def _refuse_thousands(self, rows: Sequence[Sequence[str]]) -> None:
        """Refuse commas that may be between thousands as well as decimal ones.

        Three digits follow every one. Where commas also separate the cells, decimal commas are not usual. Elsewhere
        there must be a whole number below 1000 in the same column: among decimals it would have some, too.
        """
        marked = [(k, row) for k, row in enumerate(rows) if any(_has_comma(cell) for cell in row)]
        if any(_has_comma(cell) and not _THOUSANDS.fullmatch(cell) for _, row in marked for cell in row):
            return
        columns = zip(*rows, strict=True)
        mixed = any(any(map(_has_comma, cells)) and any(map(_BELOW.fullmatch, cells)) for cells in columns)
        if self.separator != "," and not mixed:
            return
        k, row = marked[0]
        cell = next(filter(_has_comma, row))
        rule = "Commas in numbers must be clear: write thousands without a mark, or decimals with a point."
        reading = f"which may be {cell.replace(',', '')} or {cell.replace(',', '.')}"
        check.refuse(self.name, rule, f"{cell!r} in {self._line(self.lines[k][0])}, {reading}")

    def _one_by_one(self, rows: Sequence[Sequence[str]], mark: str) -> Floats:
        return np.array(
            [
                [self._value(cell, mark, number) for cell in row]
                for row, (number, _) in zip(rows, self.lines, strict=True)
            ]
        )

    def _value(self, cell: str, mark: str, number: int) -> float:
        # Not float's own grammar: it reads 1_000, and digits of any script.
        if _NUMBER.fullmatch(cell) and (mark != "," or "." not in cell):
            return float(cell)
        if _is_nothing(cell):
            return np.nan
        if mark == "," and _has_comma(cell):
            return float(cell.replace(",", "."))
        rule = "Cells must be numbers" + (" with the decimal comma that others have." if mark == "," else ".")
        check.refuse(self.name, rule, f"{cell!r} in {self._line(number)}")

    def _cells(self, number: int, line: str, last: int) -> list[str]:
        """Cut a line, which has as many cells as all, but for words of a label behind the numbers."""
        cells = _split(line, self.separator)
        fewest = self.width if self.names else max(self.numeric.stop, last + 1)
        labelled = self.separator is None and len(cells) >= fewest and self.numeric.stop < self.width
        only_numbers = len(cells) > self.width == self.numeric.stop
        commented = only_numbers and not (_is_number(cells[self.width]) or _is_nothing(cells[self.width]))
        if len(cells) != self.width and not (labelled or commented):
            rule = f"A line must have {self.width} columns, as the first has."
            check.refuse(self.name, rule, f"{len(cells)} in {self._line(number)}")
        return cells


def _loaded(lines: Sequence[str], separator: str | None, columns: Sequence[int]) -> Floats | None:
    """Read columns ten times as fast as one by one; None if there is anything to look at more closely."""
    try:
        return np.loadtxt(lines, delimiter=separator, comments=None, ndmin=2, usecols=list(columns))
    except ValueError:
        return None


def read_text(path: Path, name: str) -> TextTable:
    """Read a table in a text, whatever its encoding, separator and comments are.

    Parameters
    ----------
    path : path
        Name of the file; "-" is standard input.
    name : str
        What messages call what is read.

    Raises
    ------
    ValueError
        If there is no text. There may be no line below a header.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with open(f"{folder}/cloud.xyz", "w") as file:
    ...         print("// X Y Z", file=file)
    ...         print("1 2 3", file=file)
    ...     read_text(Path(f"{folder}/cloud.xyz"), "cloud").names
    ['X', 'Y', 'Z']
    """
    where = "standard input" if str(path) == STANDARD_INPUT else path.name
    content = sys.stdin.buffer.read() if str(path) == STANDARD_INPUT else path.read_bytes()
    if is_grid(content):
        rule = (
            "It must be a table; a grid with ncols and nrows, as ESRI's, is for read_cloud, in an .asc file."
        )
        check.refuse(name, rule, f"{where}, such a grid")
    lines, comments = _lines(_decoded(content, name, where))
    if not lines:
        check.refuse(name, "The file must have at least one line of numbers.", f"{where}, which has none")
    separator = _separator(lines[0][1])
    if len(lines) > 1 and (
        told := re.fullmatch(r"sep=(\W?)", lines[0][1].strip('"'), re.IGNORECASE)
    ):  # Excel
        separator, lines = told[1] or "\t", lines[1:]
    rows = [_split(line, separator) for _, line in lines[:2]]
    names = _named_in(comments, rows[0])
    counted = _counts(rows[0]) and len(lines) > 1 and not count_known(names)
    if counted and (whole := _first_whole(lines[1:], separator)):
        check.refuse(name, _UNCLEAR_COUNT, f"{lines[0][1]!r} above {whole!r} in {where}")
    if counted or _is_header(rows[0]):
        names, lines, rows = rows[0], lines[1:], rows[1:]
        if rows and len(rows[0]) == len(names) + 1:  # R has no name for those of the rows
            names = ["", *names]
    return TextTable(where, name, names, lines, separator)


def _decoded(content: bytes, name: str, where: str) -> str:
    marked = [encoding for mark, encoding in _BYTE_ORDER_MARKS.items() if content.startswith(mark)]
    for encoding in marked or ["utf-8", "latin-1"]:  # where other encodings differ are no numbers
        with suppress(UnicodeDecodeError):
            text = content.decode(encoding)
            if "\0" not in text:
                return text
    rule = "A file of this ending must be text, in UTF-8, Latin-1, or UTF-16 with a byte-order mark."
    check.refuse(name, f"{readable(name)} {rule}", f"{where}, which is not")


def _named_in(comments: Sequence[str], row: Sequence[str]) -> list[str]:
    """Return the names of a row's columns that a comment has: the most that are known, else those of the last one."""
    headers: list[list[str]] = [[]]
    for comment in comments:
        for text in (comment, comment.partition(":")[2]):  # columns: x y
            cells = _split(text, _separator(text))
            known = count_known(cells)
            labelled = known == len(cells) < len(row) and not _is_number(row[len(cells)])
            if (len(cells) == len(row) or labelled) and _is_header(cells):
                headers.append(cells)
    return max(reversed(headers), key=count_known)


def _lines(text: str) -> tuple[list[tuple[int, str]], list[str]]:
    """Return the lines that hold something, with their numbers, and the comments before them."""
    lines: list[tuple[int, str]] = []
    comments: list[str] = []
    for number, raw in enumerate(io.StringIO(text, newline=None), start=1):
        line = raw.strip()
        if line and "\t" in raw:  # which may stand for empty cells at the ends
            line = raw.strip("\n ")
        if "#" in line:
            line = _AFTER_CELLS.sub(r"\1", line)
        if _COMMENT.match(line):
            comments += [] if lines else [line.lstrip("#%/ \t")]
        elif line:
            lines.append((number, line))
    return lines, comments


def _separator(line: str) -> str | None:
    return next((separator for separator in (";", "\t", ",") if separator in line), None)


def _split(line: str, separator: str | None) -> list[str]:
    if '"' in line and len(line) <= csv.field_size_limit():  # what is quoted may hold separators
        (cells,) = csv.reader([line], delimiter=separator or " ", skipinitialspace=True)
    else:
        cells = line.split(separator)
    return [cell.strip().strip("\"'") for cell in cells]


def _is_header(cells: Sequence[str]) -> bool:
    """Whether cells are names: none is a number, or they are the numbers that pandas counts by beside row names."""
    if not any(map(_is_number, cells)):
        return not all(map(_is_nothing, cells))
    return cells[0] == "" and _counts(cells[1:])


def _counts(cells: Sequence[str]) -> bool:
    """Whether cells are 0, 1, ..., as pandas calls columns that have no names."""
    return list(cells) == [str(k) for k in range(len(cells))] and len(cells) > 1


def _first_whole(lines: Sequence[tuple[int, str]], separator: str | None) -> str:
    """Return the first line with a whole number, or "": where there is none, whole numbers are names."""
    return next((line for _, line in lines if any(map(_WHOLE.fullmatch, _split(line, separator)))), "")


def _is_number(cell: str) -> bool:
    return bool(_NUMBER.fullmatch(cell) or _has_comma(cell))


def _has_comma(cell: str) -> bool:
    return "," in cell and "." not in cell and bool(_NUMBER.fullmatch(cell.replace(",", ".")))


def _is_nothing(cell: str) -> bool:
    return bool(_NOTHING.fullmatch(cell))
