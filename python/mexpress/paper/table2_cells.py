"""What criteria choose in many draws of scenes, and what comes of it: from rows of trials to tables.

Examples
--------
>>> made = [Choice("flat-affine", "linear", 51, draw, "ER10", 3 + draw, 26, 2.0, 0.99, 0.5) for draw in (0, 1)]
>>> cells(made)[0].count, cells(made)[0].count_std
(3.5, 0.5)
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mexpress._validation import Floats
from mexpress.paper.transfer import CRITERIA, MEASURES

BEST = "BEST"
"""Beside the criteria: what would have been the best choice, were the truth known."""

COLUMNS: dict[str, type[str] | type[int] | type[float]] = {
    **{"scene": str, "form": str, "n": int, "draw": int, "count": int},
    **dict.fromkeys((*CRITERIA, *MEASURES), float),
}
"""Of the rows of trials: a row is one number of control points."""

KEY = 4
"""How many of the columns name a trial."""

_WIDTH = 37
"""Characters of a cell."""

Table: TypeAlias = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Choice:
    """What one criterion chooses in one draw, and what comes of it.

    Parameters
    ----------
    scene, form : str
        Name of the scene; fractional or linear.
    n, draw : int
        Number of matches, and which draw of them.
    criterion : str
        Its name, or "BEST".
    count, largest : int
        The chosen number of control points, and the largest one tried.
    fit, jaccard, transfer : float
        There: see `mexpress.paper.transfer.Trial`; NaN if unknown.
    lost : bool
        Whether the denominator vanishes on the contour there.
    """

    scene: str
    form: str
    n: int
    draw: int
    criterion: str
    count: int
    largest: int
    fit: float
    jaccard: float
    transfer: float
    lost: bool = False


@dataclass(frozen=True)
class Cell:
    """One criterion's choices over the draws: means and standard deviations, NaN if unknown.

    Parameters
    ----------
    scene, form, n, criterion
        As `Choice` has them.
    draws, failed : int
        Number of draws, and of those in which the denominator vanishes on the contour so that nothing is transferred.
    count, count_std, count_median, share : float
        Chosen numbers of control points, and their mean as a share of the largest one tried.
    fit, fit_std, jaccard, jaccard_std : float
        There.
    transfer : float
        The median error.
    """

    scene: str
    form: str
    n: int
    criterion: str
    draws: int
    failed: int
    count: float
    count_std: float
    count_median: float
    share: float
    fit: float
    fit_std: float
    jaccard: float
    jaccard_std: float
    transfer: float


def choices(rows: Table) -> Iterator[Choice]:
    """Yield what each criterion chooses in each trial; nothing where it is undefined.

    Parameters
    ----------
    rows : mapping of str to (k,) array
        Columns by name, a trial's rows together.

    Examples
    --------
    >>> names = np.array(["still"] * 2)
    >>> same = {"scene": names, "form": names, "n": np.array([51, 51]), "draw": np.array([0, 0])}
    >>> scores = {name: np.array([2.0, 1.0]) for name in (*CRITERIA, "JACCARD", "TRANSFER", "LOST")}
    >>> made = list(choices({**same, "count": np.array([3, 4]), **scores}))
    >>> [(choice.criterion, choice.count) for choice in made][-2:]
    [('NN10PCT', 4), ('BEST', 3)]
    """
    keys = list(zip(*(rows[name].tolist() for name in list(COLUMNS)[:KEY]), strict=True))
    for (scene, form, n, draw), group in groupby(range(len(keys)), keys.__getitem__):
        members = list(group)
        part = {name: rows[name][members] for name in ("count", "JACCARD", "TRANSFER", "LOST", *CRITERIA)}
        for name in (*CRITERIA, BEST):
            curve = part[name] if name != BEST else _badness(part["JACCARD"], part["TRANSFER"])
            if not np.isnan(curve).all():
                k = int(np.nanargmin(curve))
                fit, jaccard, transfer = (float(part[of][k]) for of in ("FIT", "JACCARD", "TRANSFER"))
                count, largest = int(part["count"][k]), int(part["count"][-1])
                lost = bool(part["LOST"][k] == 1)
                yield Choice(scene, form, n, draw, name, count, largest, fit, jaccard, transfer, lost)


def _badness(jaccard: Floats, transfer: Floats) -> Floats:
    """Return what the best choice has the least of."""
    return transfer if np.isnan(jaccard).all() else -jaccard


def cells(made: Iterable[Choice]) -> list[Cell]:
    """Return the cells of a table, in the order in which their first choices come."""
    groups: dict[tuple[str, str, int, str], list[Choice]] = {}
    for choice in made:
        groups.setdefault((choice.scene, choice.form, choice.n, choice.criterion), []).append(choice)
    return [_cell(*key, group) for key, group in groups.items()]


def _cell(scene: str, form: str, n: int, criterion: str, group: Sequence[Choice]) -> Cell:
    numbers = [(c.count, c.count / c.largest, c.fit, c.jaccard, c.transfer) for c in group]
    count, share, fit, jaccard, transfer = np.array(numbers, dtype=np.float64).T
    return Cell(
        scene,
        form,
        n,
        criterion,
        draws=len(group),
        failed=sum(choice.lost for choice in group),
        count=float(count.mean()),
        count_std=float(count.std()),
        count_median=float(np.median(count)),
        share=float(share.mean()),
        fit=float(fit.mean()),
        fit_std=float(fit.std()),
        jaccard=float(jaccard.mean()),
        jaccard_std=float(jaccard.std()),
        transfer=float(np.median(transfer)),
    )


def table(table_cells: Sequence[Cell], shown: Sequence[str]) -> str:
    """Return cells as text: a block for each scene and form, a line for each criterion.

    Parameters
    ----------
    table_cells : sequence of Cell
        All cells.
    shown : sequence of str
        Criteria.

    Returns
    -------
    str
        With the median transfer error in place of the Jaccard index where no contour is known.

    Examples
    --------
    >>> made = [Choice("flat-affine", "linear", 51, 0, "ER10", 3, 26, 2.0, 0.99, 0.5)]
    >>> print(table(cells(made), ["ER10"]))
    flat-affine, linear warps
                                              n = 51
    criterion         l         FIT        Jaccard
    ER10              3         2.0          0.990
    """
    blocks = []
    for (scene, form), group in groupby(table_cells, lambda cell: (cell.scene, cell.form)):
        mine = {(cell.criterion, cell.n): cell for cell in group}
        sizes = sorted({n for _, n in mine})
        third = "transfer" if all(math.isnan(cell.jaccard) for cell in mine.values()) else "Jaccard"
        lines = [
            f"{scene}, {form} warps",
            " " * 9 + "".join(f"{f'n = {n}':>{_WIDTH}}" for n in sizes),
            "criterion" + f"{'l':>10}{'FIT':>12}{third:>15}" * len(sizes),
        ]
        for name in shown:
            lines.append(f"{name:9}" + "".join(_cell_text(mine.get((name, n)), third) for n in sizes))
        blocks.append("\n".join(line.rstrip() for line in lines))
    return "\n\n".join(blocks)


def _cell_text(cell: Cell | None, third: str) -> str:
    if cell is None:
        return f"{'-':>10}{'-':>12}{'-':>15}"
    several = cell.draws > 1
    count = f"{cell.count:.1f}±{cell.count_std:.1f}" if several else f"{cell.count:.0f}"
    fit = f"{cell.fit:.1f}±{cell.fit_std:.1f}" if several else f"{cell.fit:.1f}"
    last = f"{cell.jaccard:.3f}" + (f"±{cell.jaccard_std:.3f}" if several else "")
    if third == "transfer":
        last = f"{cell.transfer:.4g}"
    elif cell.failed:
        last = "!" + last
    return f"{count:>10}{fit:>12}{last:>15}"


def losses(made: Iterable[Choice], kinds: Mapping[str, str], shown: Sequence[str]) -> str:
    """Return as text what criteria lose of the Jaccard index that the best number of control points has.

    Parameters
    ----------
    made : iterable of Choice
        All choices, with those of BEST: each is compared to it in its own draw.
    kinds : mapping of str to str
        Every scene's kind.
    shown : sequence of str
        Criteria.

    Returns
    -------
    str
        A line for each criterion, a column for each form and kind, and in how many of the draws of fractional warps
        the denominator vanishes on the contour, so that all is lost; nothing if there are no contours.

    Examples
    --------
    >>> best = Choice("flat-affine", "linear", 51, 0, "BEST", 3, 26, 2.0, 0.99, 0.5)
    >>> made = [Choice("flat-affine", "linear", 51, 0, "FIT", 26, 26, 1.0, 0.95, 9.0), best]
    >>> print(losses(made, {"flat-affine": "flat"}, ["FIT"]))
    Percent of the best Jaccard index that is lost, mean over all draws where the criterion is defined
    criterion   linear flat    vanishing
    FIT                4.04       0 of 0
    """
    made = list(made)
    best = {(c.scene, c.form, c.n, c.draw): c.jaccard for c in made if c.criterion == BEST}
    lost: dict[str, dict[str, list[float]]] = {}
    vanishing: dict[str, list[bool]] = {}
    for choice in made:
        top = best.get((choice.scene, choice.form, choice.n, choice.draw), math.nan)
        if top > 0:
            column = lost.setdefault(f"{choice.form} {kinds[choice.scene] or 'unknown'}", {})
            column.setdefault(choice.criterion, []).append(100 * (1 - choice.jaccard / top))
            if choice.form == "fractional":  # others have no denominator
                vanishing.setdefault(choice.criterion, []).append(choice.lost)
    if not lost:
        return ""
    lines = [
        "Percent of the best Jaccard index that is lost, mean over all draws where the criterion is defined",
        "criterion" + "".join(f"{name:>{len(name) + 3}}" for name in lost) + f"{'vanishing':>13}",
    ]
    for criterion in shown:
        parts = (
            f"{np.mean(column[criterion]):{len(name) + 3}.2f}"
            if criterion in column
            else "-".rjust(len(name) + 3)
            for name, column in lost.items()
        )
        judged = vanishing.get(criterion, [])
        lines.append(f"{criterion:9}" + "".join(parts) + f"{f'{sum(judged)} of {len(judged)}':>13}")
    return "\n".join(lines)
