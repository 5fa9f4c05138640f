"""What the choices of table 2 say: statements, in how many of its cells they are true, and so whether they hold.

A statement holds if it is true in nine of ten of the cells that it is about.

Examples
--------
>>> from mexpress.paper.table2_cells import Choice, cells
>>> made = [Choice("flat-affine", "linear", 51, 0, "FIT", 26, 26, 1.0, 0.95, 9.0)]
>>> findings(cells(made), {"flat-affine": "flat"}, {"flat-affine": "affine"})[0].text
'holds: FIT alone takes nearly all control points that it may have, 90 % at least (in 1 of 1 cells)'
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

from mexpress.paper.published import LOCAL
from mexpress.paper.table1_claims import Claim
from mexpress.paper.table2_cells import Cell
from mexpress.paper.transfer import CRITERIA

HOLDS = 0.9
"""A statement holds if it is true in this share of its cells at least."""

_NEXT = {"PRESS": "ER05", "ER05": "ER10"}
_NEAR_THREE = 4


@dataclass(frozen=True)
class _Place:
    """What a cell is of."""

    scene: str
    kind: str
    projection: str
    form: str
    n: int
    criterion: str

    @property
    def curved(self) -> bool:
        return self.kind in {"rigid", "deformable"}

    @property
    def bent_by_perspective(self) -> bool:
        """Whether the warps must imitate perspective."""
        return self.form == "linear" and self.projection == "perspective"


_Table: TypeAlias = Mapping[_Place, Cell]
_About: TypeAlias = Callable[[_Place], bool]
_True: TypeAlias = Callable[[Cell, Cell], bool]
_Other: TypeAlias = Callable[[_Place], _Place]


def _worse(cell: Cell, other: Cell) -> bool:
    """Whether one choice transfers worse than another."""
    if math.isnan(cell.jaccard):
        return cell.transfer > other.transfer
    return cell.jaccard < other.jaccard


def _no_worse(cell: Cell, other: Cell) -> bool:
    return not _worse(cell, other)


def _more(cell: Cell, other: Cell) -> bool:
    return cell.count > other.count


def _about_three(cell: Cell, _: Cell) -> bool:
    return cell.count_median <= _NEAR_THREE


def _same(place: _Place) -> _Place:
    return place


def _fractional(place: _Place) -> _Place:
    return replace(place, form="fractional")


def _of(criterion: str) -> _Other:
    return lambda place: replace(place, criterion=criterion)


_STATEMENTS: tuple[tuple[str, Sequence[str], _About, _True, _Other], ...] = (
    (
        f"flat scene, no perspective, linear warps: local exclusion selects 3 or {_NEAR_THREE} (median)",
        LOCAL,
        lambda place: (place.kind, place.projection, place.form) == ("flat", "affine", "linear"),
        _about_three,
        _same,
    ),
    (
        f"flat scene, fractional warps: local exclusion selects 3 or {_NEAR_THREE} (median)",
        LOCAL,
        lambda place: (place.kind, place.form) == ("flat", "fractional"),
        _about_three,
        _same,
    ),
    (
        "flat scene in perspective: linear warps take more control points than fractional ones",
        ("PRESS", "ER05", "ER10"),
        lambda place: place.kind == "flat" and place.bent_by_perspective,
        _more,
        _fractional,
    ),
    (
        "flat scene in perspective: linear warps transfer worse than fractional ones",
        ("PRESS", "ER05", "ER10"),
        lambda place: place.kind == "flat" and place.bent_by_perspective,
        _worse,
        _fractional,
    ),
    (
        "FIT alone takes nearly all control points that it may have, 90 % at least",
        ("FIT",),
        lambda place: True,
        lambda cell, _: cell.share >= 0.9,
        _same,
    ),
    (
        "fractional warps: what local exclusion selects transfers no worse than what FIT selects",
        LOCAL,
        lambda place: place.form == "fractional",
        _no_worse,
        _of("FIT"),
    ),
    (
        "linear warps: what local exclusion selects transfers no worse than what FIT selects",
        LOCAL,
        lambda place: place.form == "linear",
        _no_worse,
        _of("FIT"),
    ),
    (
        "curved scene: the more is held out (PRESS, ER05, ER10) the fewer control points, within one",
        tuple(_NEXT),
        lambda place: place.curved,
        lambda cell, next_: next_.count <= cell.count + 1,
        lambda place: replace(place, criterion=_NEXT[place.criterion]),
    ),
    (
        "curved scene in perspective: for PRESS linear warps take more control points than fractional ones",
        ("PRESS",),
        lambda place: place.curved and place.bent_by_perspective,
        _more,
        _fractional,
    ),
    (
        "curved scene: what local exclusion selects transfers no worse than what PRESS selects",
        LOCAL,
        lambda place: place.curved,
        _no_worse,
        _of("PRESS"),
    ),
)


def findings(cells: Sequence[Cell], kinds: Mapping[str, str], projections: Mapping[str, str]) -> list[Claim]:
    """Return the statements, in how many cells they are true, and whether they hold.

    Parameters
    ----------
    cells : sequence of Cell
        All cells.
    kinds : mapping of str to str
        Every scene's kind.
    projections : mapping of str to str
        Affine or perspective; statements on projections leave out scenes of which that is not known.

    Returns
    -------
    list of Claim
        Those that are about any of the cells.
    """
    table = {
        _Place(c.scene, kinds[c.scene], projections.get(c.scene, ""), c.form, c.n, c.criterion): c
        for c in cells
    }
    checked = (
        (statement, _checked(table, criteria, about, true, other))
        for statement, criteria, about, true, other in _STATEMENTS
    )
    return [
        Claim(statement, f"in {sum(true)} of {len(true)} cells", sum(true) >= HOLDS * len(true))
        for statement, true in checked
        if true
    ]


def _checked(table: _Table, criteria: Sequence[str], about: _About, true: _True, other: _Other) -> list[bool]:
    """Return in which cells a statement is true, of those that it can be asked of.

    A criterion may be undefined in a cell, or a form not tried; one that does not exist is an error.
    """
    unknown = {*criteria, *(other(place).criterion for place in table if place.criterion in criteria)} - {
        *CRITERIA
    }
    if unknown:
        raise KeyError(*unknown)
    asked = [
        place for place in table if place.criterion in criteria and about(place) and other(place) in table
    ]
    return [true(table[place], table[other(place)]) for place in asked]
