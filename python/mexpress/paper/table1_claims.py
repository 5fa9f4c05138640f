"""The paper's qualitative claims on table 1, each with what speaks for or against it.

Examples
--------
>>> Claim("FIT has no minimum", "it selects the largest number in 450 of 450 problems", True).text
'holds: FIT has no minimum (it selects the largest number in 450 of 450 problems)'
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mexpress.paper.published import LOCAL
from mexpress.paper.table1_cells import Curves
from mexpress.selection import largest_count


@dataclass(frozen=True)
class Claim:
    """One claim, what the run found on it, and whether it holds."""

    claim: str
    evidence: str
    holds: bool

    @property
    def text(self) -> str:
        """One line."""
        return f"{'holds' if self.holds else 'does NOT hold'}: {self.claim} ({self.evidence})"


def claims(curves: Mapping[int, Curves]) -> list[Claim]:
    """Judge every claim.

    Parameters
    ----------
    curves : dict of int to Curves
        By number of correspondences: 15, 30, 150 and 500.

    Returns
    -------
    list of Claim
        In the paper's order.
    """
    counts = {
        name: {n: of.cell(name).count for n, of in curves.items()}
        for name in ("TEST", "PRESS", "CMPRESS", "KF10", "KF05", *LOCAL, "NN02PTS", "NN05PTS")
    }
    return [_overfit(curves, counts), _folds(counts), _resist(counts), _underfit(counts), _fit(curves)]


Counts = Mapping[str, Mapping[int, float]]


def _overfit(curves: Mapping[int, Curves], counts: Counts) -> Claim:
    press, cmpress, test = counts["PRESS"], counts["CMPRESS"], counts["TEST"][500]
    grows = all(rise > 0 for which in (press, cmpress) for rise in np.diff(list(which.values())))
    alike = all(abs(press[n] - cmpress[n]) <= 0.15 * press[n] for n in press)
    cells = [curves[500].cell(name) for name in ("PRESS", "CMPRESS")]
    # Few problems make an uncertain mean.
    least = min(cell.count + 2 * cell.count_std / len(curves[500].values["FIT"]) ** 0.5 for cell in cells)
    return Claim(
        "PRESS and CMPRESS overfit as n grows: they select alike, ever more, and at n = 500 at least 80 % of the "
        f"{largest_count(500)} that are allowed and 95 % of what TEST selects, to two standard errors",
        f"PRESS {_listed(press)}; CMPRESS {_listed(cmpress)} for n = {', '.join(map(str, press))}; TEST {test:.1f} "
        "at n = 500",
        bool(grows and alike and least >= max(0.95 * test, 0.8 * largest_count(500))),
    )


def _folds(counts: Counts) -> Claim:
    reference = counts["CMPRESS"]
    shares = {name: [counts[name][n] / reference[n] for n in (30, 150, 500)] for name in ("KF10", "KF05")}
    less = np.mean(shares["KF05"]) < np.mean(shares["KF10"]) < 1
    little = min(shares["KF05"]) >= 0.7
    return Claim(
        "k-fold overfits a little less than CMPRESS, the less the fewer the folds",
        f"{_percent(shares)} of what CMPRESS selects at n = 30, 150, 500",
        bool(less and little),
    )


def _resist(counts: Counts) -> Claim:
    numbers = {name: counts[name][500] for name in LOCAL}
    few = all(numbers[name] < 0.5 * counts["CMPRESS"][500] for name in ("ER10", "NN05PCT", "NN10PCT"))
    return Claim(
        "ER05, ER10, NN05PCT and NN10PCT resist: they select fewer at n = 500, the last three less than half",
        ", ".join(f"{name} {count:.1f}" for name, count in numbers.items())
        + f" beside CMPRESS {counts['CMPRESS'][500]:.1f}",
        bool(few and numbers["ER05"] < 0.9 * counts["CMPRESS"][500]),
    )


def _underfit(counts: Counts) -> Claim:
    shares = {
        name: [counts[name][n] / counts["TEST"][n] for n in (15, 30, 500)] for name in ("NN02PTS", "NN05PTS")
    }
    small = max(shares["NN02PTS"][:2]) < 0.9 and max(shares["NN05PTS"][:2]) < 0.75
    vanishes = all(of[-1] > np.mean(of[:-1]) for of in shares.values())
    return Claim(
        "NN02PTS and NN05PTS, whose sets do not grow with n, underfit at small n",
        f"{_percent(shares)} of what TEST selects at n = 15, 30, 500",
        bool(small and vanishes),
    )


def _fit(curves: Mapping[int, Curves]) -> Claim:
    shares = {n: of.cell("FIT").count / of.counts[-1] for n, of in curves.items()}
    means = [of.mean("FIT")[0] for of in curves.values()]
    falls = all(mean[-1] == mean.min() and (np.diff(mean) < 0.01 * mean[:-1]).all() for mean in means)
    evidence = (
        f"{', '.join(f'{100 * share:.1f}' for share in shares.values())} % of the largest number "
        f"for n = {', '.join(map(str, shares))}"
    )
    if lost := sum(int(np.isnan(of.values["FIT"]).sum()) for of in curves.values()):
        evidence += f"; FIT is undefined {lost} times, which are left out"
    return Claim(
        "FIT alone has no minimum: its mean is lowest at the largest number, which it selects nearly always, and "
        "rises by less than 1 % from any number to the next",
        evidence,
        bool(falls and all(share > 0.97 for share in shares.values())),
    )


def _listed(by_size: Mapping[int, float]) -> str:
    return ", ".join(f"{number:.1f}" for number in by_size.values())


def _percent(shares: Mapping[str, Sequence[float]]) -> str:
    return "; ".join(
        f"{name} {', '.join(f'{100 * share:.0f}' for share in of)} %" for name, of in shares.items()
    )
