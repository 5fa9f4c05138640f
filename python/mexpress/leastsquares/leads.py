"""The column that takes most of a response, which is taken where rows are read: what it leaves keeps its digits.

Rows that are known by a triangle alone are known to rounding of their largest numbers. A response with a large mean
is nearly a multiple of the ones; of what these leave, triangles keep all digits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from mexpress._validation import Floats, Integers

_WORTH = 15 / 16
"""Share of a response's square from which a column takes most of it: a quarter of its length is left at most."""

_LARGEST = 1e300
"""Multiples of columns may exceed responses, where weights are small, and must not overflow."""


@dataclass(frozen=True, eq=False)
class Leads:
    """A column of the design for each response, and its multiple that is nearest to the response.

    Parameters
    ----------
    columns : (r,) int64 array
        The columns.
    multiples : (r,) array
        Their multiples, in half the digits; zero for a response of which no column takes most.

    Examples
    --------
    >>> rows = np.array([[1.0, 0.0, 7e8 + 1], [1.0, 1.0, 7e8 - 2], [1.0, -1.0, 7e8]])
    >>> leads = Leads.of(np.linalg.qr(rows).R, 2)
    >>> leads.columns
    array([0])
    >>> np.abs(leads.left(rows)).max() < 20
    np.True_
    """

    columns: Integers
    multiples: Floats

    @classmethod
    def of(cls, triangle: Floats, p: int) -> Self | None:
        """Those of the triangle of rows ``[A, b]``, A of p columns; None if no column takes most of any response."""
        largest = np.abs(triangle).max(axis=0)
        unit = triangle / np.where(largest > 0, largest, 1.0)
        lengths = np.linalg.norm(unit, axis=0)
        unit /= np.where(lengths > 0, lengths, 1.0)
        # No product of matrices, whose digits may depend on the number of threads.
        cosines = np.einsum("ij,ik->jk", unit[:, :p], unit[:, p:])
        columns = np.abs(cosines).argmax(axis=0)
        shares = np.take_along_axis(cosines, columns[None], axis=0)[0]
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            lengths *= largest
            multiples = shares * (lengths[p:] / lengths[columns])
        most = (np.square(shares) > _WORTH) & (lengths[p:] < _LARGEST) & np.isfinite(multiples)
        return cls(columns, _half(np.where(most, multiples, 0.0))) if most.any() else None

    def left(self, rows: Floats) -> Floats:
        """What is left of the responses of rows ``[A, b]``, (m, r).

        The products with both halves of an entry are exact, so all is rounded to digits of what is left.
        """
        p = rows.shape[1] - len(self.columns)
        high = _half(rows[:, self.columns])
        low = rows[:, self.columns] - high
        left: Floats = rows[:, p:] - self.multiples * high - self.multiples * low
        return left


def _half(numbers: Floats) -> Floats:
    """Numbers with the first 26 of their 53 digits."""
    return (numbers.view(np.int64) & -(1 << 27)).view(np.float64)
