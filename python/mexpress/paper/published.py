"""Table 1 of the paper: what each criterion selects on simulated sheets, and the fitting error there.

Examples
--------
>>> PUBLISHED["ER10"][500]
Cell(count=23.9, count_std=7.7, fit=14.9, fit_std=6.9)
"""

from __future__ import annotations

import math
from dataclasses import dataclass

SIZES = (15, 30, 150, 500)
"""Numbers of correspondences."""


@dataclass(frozen=True)
class Cell:
    """Mean and standard deviation of the selected number of control points, and of FIT there in pixels."""

    count: float
    count_std: float
    fit: float
    fit_std: float


_TEXT = """
TEST    5.5±1.3 42.5±28.4 11.2±2.2 21.8±11.9 50.3±8.9 4.0±2.0   97.3±3.8  1.7±0.3
PRESS   5.0±1.3 42.4±26.4 10.2±2.6 23.3±15.2 48.6±9.6 4.0±2.1   97.1±3.8  1.7±0.3
CMPRESS 4.9±1.3 45.2±28.9 9.9±2.6  24.7±15.3 46.3±9.4 4.4±2.3   96.7±4.4  1.7±0.3
KF10    4.7±1.3 47.7±29.7 9.3±2.4  27.7±16.1 41.8±7.8 5.4±2.4   95.2±5.6  1.8±0.4
KF05    4.4±1.1 53.1±31.3 8.4±2.1  31.8±16.6 37.4±6.9 6.6±2.9   93.5±6.6  1.9±0.4
ER01    4.8±1.3 45.4±29.0 9.9±2.6  25.0±15.7 45.9±9.5 4.5±2.3   96.3±4.6  1.7±0.3
ER05    4.7±1.3 47.0±29.5 9.4±2.5  26.8±16.5 34.9±8.1 7.5±3.7   75.0±12.8 2.7±0.9
ER10    4.4±1.2 52.8±31.3 7.7±2.5  36.9±22.6 16.9±4.5 19.6±7.5  23.9±7.7  14.9±6.9
NN02PTS 4.1±1.1 58.7±34.3 8.0±2.5  35.1±21.0 38.9±8.5 6.2±3.1   93.9±6.8  1.8±0.4
NN05PTS 3.1±0.4 88.9±38.0 4.7±1.6  67.3±34.4 24.4±7.1 13.0±6.1  83.4±11.9 2.3±0.8
NN10PTS -       -         -        -         14.3±3.5 23.6±8.5  56.3±12.1 4.5±1.9
NN01PCT 4.9±1.3 45.2±28.9 9.9±2.6  24.7±15.3 38.9±8.5 6.2±3.1   83.4±11.9 2.3±0.8
NN05PCT 4.9±1.3 45.2±28.9 8.0±2.5  35.1±21.0 16.6±4.7 20.3±8.1  24.6±7.1  14.4±6.5
NN10PCT 4.1±1.1 58.7±34.3 6.5±2.3  47.1±27.4 10.8±3.3 34.0±17.9 12.2±3.4  31.2±15.4
"""


def _read(text: str) -> dict[str, dict[int, Cell]]:
    rows = (line.split() for line in text.strip().splitlines())
    return {name: dict(zip(SIZES, map(_cell, cells[::2], cells[1::2]), strict=True)) for name, *cells in rows}


def _cell(count: str, fit: str) -> Cell:
    if "-" in (count, fit):
        return Cell(*[math.nan] * 4)
    return Cell(*(float(number) for cell in (count, fit) for number in cell.split("±")))


PUBLISHED = _read(_TEXT)
"""By criterion and number of correspondences; NaN where the paper has none."""

CRITERIA = tuple(PUBLISHED)[1:]
"""The 13 criteria; TEST, which knows the truth, stands beside them."""

LOCAL = ("ER05", "ER10", "NN05PCT", "NN10PCT")
"""Those of them that hold out whole neighbourhoods, and resist as n grows."""
