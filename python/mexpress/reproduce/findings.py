"""What the choices of table 2 say: statements, and in how many of its cells they are true.

Examples
--------
>>> from mexpress.reproduce.choices import Choice, cells
>>> made = [Choice("flat-affine", "linear", 51, 0, "FIT", 26, 26, 1.0, 0.95, 9.0)]
>>> print(*findings(cells(made), {"flat-affine": "flat"}, {"flat-affine": "affine"}))
in 1 of 1 cells: FIT alone takes nearly all control points that it may have, 90 % at least
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from mexpress.reproduce.choices import Cell

__all__ = ["Finding", "findings"]

_LOCAL = ("ER05", "ER10", "NN05PCT", "NN10PCT")
_NEXT = {"PRESS": "ER05", "ER05": "ER10"}
_NEAR_THREE = 4


@dataclass(frozen=True)
class Finding:
    """A statement, in how many cells of the table it is true, and how many it is about.

    Examples
    --------
    >>> print(Finding("FIT takes what it gets", 11, 12))
    in 11 of 12 cells: FIT takes what it gets
    """

    statement: str
    true: int
    cells: int

    def __str__(self) -> str:
        return f"in {self.true} of {self.cells} cells: {self.statement}"


@dataclass(frozen=True)
class _Place:
    """A scene with a form of warps and a number of matches, whose cells are asked for by criterion."""

    table: Mapping[tuple[str, str, int, str], Cell]
    scene: str
    kind: str
    projection: str
    form: str
    n: int

    @property
    def curved(self) -> bool:
        return self.kind in {"rigid", "deformable"}

    @property
    def bent_by_perspective(self) -> bool:
        """Whether the warps must imitate perspective."""
        return self.form == "linear" and self.projection == "perspective"

    def cell(self, criterion: str, form: str = "") -> Cell:
        return self.table[self.scene, form or self.form, self.n, criterion]

    def worse(self, criterion: str, other: str, form: str = "") -> bool:
        """Whether a criterion's choice transfers worse than another's does, maybe in another form."""
        mine, theirs = self.cell(criterion), self.cell(other, form)
        if math.isnan(mine.jaccard):
            return mine.transfer > theirs.transfer
        return mine.jaccard < theirs.jaccard


@dataclass(frozen=True)
class _Statement:
    """What is stated of places and criteria, and of which of them."""

    text: str
    criteria: Sequence[str]
    about: Callable[[_Place], bool]
    true: Callable[[_Place, str], bool]


def _about_three(place: _Place, name: str) -> bool:
    return place.cell(name).count_median <= _NEAR_THREE


def _more_than_fractional(place: _Place, name: str) -> bool:
    return place.cell(name).count > place.cell(name, "fractional").count


def _no_worse_than_fit(place: _Place, name: str) -> bool:
    return not place.worse(name, "FIT")


_STATEMENTS = (
    _Statement(
        f"flat scene, no perspective, linear warps: local exclusion selects 3 or {_NEAR_THREE} (median)",
        _LOCAL,
        lambda place: (place.kind, place.projection) == ("flat", "affine") and place.form == "linear",
        _about_three,
    ),
    _Statement(
        f"flat scene, fractional warps: local exclusion selects 3 or {_NEAR_THREE} (median)",
        _LOCAL,
        lambda place: place.kind == "flat" and place.form == "fractional",
        _about_three,
    ),
    _Statement(
        "flat scene in perspective: linear warps take more control points than fractional ones",
        ("PRESS", "ER05", "ER10"),
        lambda place: place.kind == "flat" and place.bent_by_perspective,
        _more_than_fractional,
    ),
    _Statement(
        "flat scene in perspective: linear warps transfer worse than fractional ones",
        ("PRESS", "ER05", "ER10"),
        lambda place: place.kind == "flat" and place.bent_by_perspective,
        lambda place, name: place.worse(name, name, "fractional"),
    ),
    _Statement(
        "FIT alone takes nearly all control points that it may have, 90 % at least",
        ("FIT",),
        lambda place: True,
        lambda place, name: place.cell(name).share >= 0.9,
    ),
    _Statement(
        "fractional warps: what local exclusion selects transfers no worse than what FIT selects",
        _LOCAL,
        lambda place: place.form == "fractional",
        _no_worse_than_fit,
    ),
    _Statement(
        "linear warps: what local exclusion selects transfers no worse than what FIT selects",
        _LOCAL,
        lambda place: place.form == "linear",
        _no_worse_than_fit,
    ),
    _Statement(
        "curved scene: the more is held out (PRESS, ER05, ER10) the fewer control points, within one",
        tuple(_NEXT),
        lambda place: place.curved,
        lambda place, name: place.cell(_NEXT[name]).count <= place.cell(name).count + 1,
    ),
    _Statement(
        "curved scene in perspective: for PRESS linear warps take more control points than fractional ones",
        ("PRESS",),
        lambda place: place.curved and place.bent_by_perspective,
        _more_than_fractional,
    ),
    _Statement(
        "curved scene: what local exclusion selects transfers no worse than what PRESS selects",
        _LOCAL,
        lambda place: place.curved,
        lambda place, name: not place.worse(name, "PRESS"),
    ),
)


def findings(
    found: Sequence[Cell], kinds: Mapping[str, str], projections: Mapping[str, str]
) -> list[Finding]:
    """Return the statements, and in how many cells they are true.

    Parameters
    ----------
    found : sequence of Cell
        All cells.
    kinds : mapping of str to str
        Every scene's kind.
    projections : mapping of str to str
        Affine or perspective; scenes of which that is not known are left out.

    Returns
    -------
    list of Finding
        Those that are about any of the cells.

    Examples
    --------
    See the module.
    """
    table = {(cell.scene, cell.form, cell.n, cell.criterion): cell for cell in found}
    where = list(dict.fromkeys(key[:3] for key in table))
    places = [
        _Place(table, scene, kinds[scene], projections.get(scene, ""), form, n) for scene, form, n in where
    ]
    checked = ((statement.text, list(_checked(statement, places))) for statement in _STATEMENTS)
    return [Finding(text, sum(seen), len(seen)) for text, seen in checked if seen]


def _checked(statement: _Statement, places: Sequence[_Place]) -> Iterator[bool]:
    for place in places:
        for name in statement.criteria if statement.about(place) else ():
            try:
                yield statement.true(place, name)
            except KeyError:  # the criterion is undefined there, or the form was not tried
                continue
