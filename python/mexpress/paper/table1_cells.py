"""What criteria select on many simulated problems, beside what the paper found.

Examples
--------
>>> curves = Curves(np.array([3, 4]), {"FIT": np.array([[9.0, 5.0]]), "PRESS": np.array([[8.0, 9.0]])})
>>> curves.cell("PRESS")
Cell(count=3.0, count_std=0.0, fit=9.0, fit_std=0.0)
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mexpress._validation import Floats, Integers
from mexpress.paper.published import PUBLISHED, Cell


@dataclass(frozen=True, eq=False)
class Curves:
    """Every criterion's curves for one number of correspondences.

    Parameters
    ----------
    counts : (k,) int64 array
        Numbers of control points, increasing.
    values : dict of str to (c, k) array
        Of FIT, the criteria and TEST: a row for each problem, in pixels, NaN where undefined.
    """

    counts: Integers
    values: Mapping[str, Floats]

    def selected(self, name: str) -> tuple[Floats, Floats]:
        """Return the count with the smallest score and FIT there, for each problem that has a score.

        Examples
        --------
        >>> curves = Curves(np.array([3, 4]), {"FIT": np.array([[9.0, 5.0], [8.0, 4.0]])})
        >>> curves.selected("FIT")
        (array([4., 4.]), array([5., 4.]))
        """
        curve = self.values[name]
        known = np.flatnonzero(~np.isnan(curve).all(axis=1))
        best = np.nanargmin(curve[known], axis=1) if known.size else known
        return self.counts[best].astype(np.float64), self.values["FIT"][known, best]

    def mean(self, name: str) -> tuple[Floats, Floats]:
        """Return mean and standard deviation over the problems that have a score, for each count.

        NaN where fewer than half of them have one.

        Examples
        --------
        >>> curves = Curves(np.array([3, 4]), {"FIT": np.array([[9.0, 5.0], [8.0, 4.0]])})
        >>> curves.mean("FIT")
        (array([8.5, 4.5]), array([0.5, 0.5]))
        """
        curve = self.values[name]
        known = ~np.isnan(curve)
        enough = 2 * known.sum(axis=0) >= len(curve)
        usable = np.where(known & enough, curve, 0.0)
        number = np.where(enough, np.maximum(known.sum(axis=0), 1), np.nan)
        mean = usable.sum(axis=0) / number
        spread = np.where(known & enough, curve - mean, 0.0)
        return mean, np.sqrt((spread**2).sum(axis=0) / number)

    def lowest(self, name: str) -> int | None:
        """Return the count where a criterion's mean is smallest; None if too few problems have a score at any.

        Examples
        --------
        >>> Curves(np.array([3, 4]), {"FIT": np.array([[9.0, 5.0]])}).lowest("FIT")
        4
        """
        mean = self.mean(name)[0]
        return None if np.isnan(mean).all() else int(self.counts[np.nanargmin(mean)])

    def cell(self, name: str) -> Cell:
        """Return mean and standard deviation of what a criterion selects, over the problems; NaN without any."""
        count, fit = self.selected(name)
        if not count.size:
            return Cell(*[math.nan] * 4)
        return Cell(float(count.mean()), float(count.std()), float(fit.mean()), float(fit.std()))


@dataclass(frozen=True)
class Comparison:
    """What a criterion selects here, with FIT in the paper's unit, and in the paper.

    Examples
    --------
    >>> Comparison("TEST", 15, Cell(6.0, 1.0, 80.0, 9.0), PUBLISHED["TEST"][15]).within
    (True, False)
    """

    name: str
    n: int
    ours: Cell
    paper: Cell

    @property
    def within(self) -> tuple[bool | None, bool | None]:
        """Whether our means, of count and FIT, are within the paper's standard deviation; None if it has none."""
        return (
            _within(self.ours.count, self.paper.count, self.paper.count_std),
            _within(self.ours.fit, self.paper.fit, self.paper.fit_std),
        )


def _within(ours: float, mean: float, deviation: float) -> bool | None:
    return None if math.isnan(mean) else abs(ours - mean) <= deviation


def fit_scale(curves: Mapping[int, Curves]) -> float:
    """Return the one factor that brings FIT closest to the paper's on the row TEST, in its standard deviations.

    The paper gives the algebraic error an arbitrary scale, so FIT is comparable up to a factor.

    Examples
    --------
    >>> curves = Curves(np.array([3, 4]), {name: np.array([[9.0, 8.5]]) for name in ("FIT", "TEST")})
    >>> fit_scale({15: curves})
    5.0
    """
    papers = [PUBLISHED["TEST"][n] for n in curves]
    deviations = np.array([paper.fit_std for paper in papers])
    ours = np.array([of.cell("TEST").fit for of in curves.values()]) / deviations
    theirs = np.array([paper.fit for paper in papers]) / deviations
    return float(ours @ theirs / (ours @ ours))


def compared(curves: Mapping[int, Curves]) -> list[Comparison]:
    """Compare every cell of table 1 for which there are curves, by number of correspondences, FIT times `fit_scale`.

    Examples
    --------
    >>> curves = Curves(np.array([3, 4]), {name: np.array([[9.0, 5.0]]) for name in ("FIT", *PUBLISHED)})
    >>> len(compared({15: curves}))
    14
    """
    scale = fit_scale(curves)

    def cell(of: Curves, name: str) -> Cell:
        ours = of.cell(name)
        return replace(ours, fit=scale * ours.fit, fit_std=scale * ours.fit_std)

    return [
        Comparison(name, n, cell(of, name), cells[n])
        for n, of in curves.items()
        for name, cells in PUBLISHED.items()
    ]


def table(comparisons: list[Comparison]) -> str:
    """Return our cells beside the paper's as lines of text, a block for each number of correspondences.

    Examples
    --------
    >>> cell = PUBLISHED["ER10"][500]
    >>> print(table([Comparison("ER10", 500, Cell(40.0, 5.0, 15.2, 3.0), cell)]))
    n = 500        control points              FIT
                 here        paper           here        paper
    ER10      40.0 ± 5.0   23.9 ± 7.7 !   15.2 ± 3.0   14.9 ± 6.9
    """
    blocks = []
    for n in dict.fromkeys(comparison.n for comparison in comparisons):
        lines = [f"n = {n}        control points              FIT"]
        lines.append("             here        paper           here        paper")
        lines += [_line(comparison) for comparison in comparisons if comparison.n == n]
        blocks.append("\n".join(lines))
    return "\n\n".join(blocks)


def _line(comparison: Comparison) -> str:
    ours, paper = comparison.ours, comparison.paper
    count, fit = ("!" if within is False else " " for within in comparison.within)
    parts = (
        f"{comparison.name:8}",
        _written(ours.count, ours.count_std),
        f"{_written(paper.count, paper.count_std)} {count}",
        _written(ours.fit, ours.fit_std),
        f"{_written(paper.fit, paper.fit_std)} {fit}",
    )
    return " ".join(parts).rstrip()


def _written(mean: float, deviation: float) -> str:
    return "-".center(12) if math.isnan(mean) else f"{mean:5.1f} ± {deviation:<4.1f}"
