"""What a selection does unless it is told otherwise: the best prediction, or the method of the paper.

==================  ================================================  ==============================================
                    smoothing "auto", the default                     smoothing 0, or weights: the paper
==================  ================================================  ==============================================
criterion           MATCHED                                           ER10
counts of warps     3, and as many as matches, at most 300            3 to half the matches, at most 100
                    (250 for more than 1,000 matches, 900
                    without perspective)
counts of surfaces  3, and as many as data, at most 900               3 to 175
placement           "nested"                                          "lloyd" for warps ("nested" with several
                                                                      weights), "residual" for surfaces
beside the grid     a plain affine map and a homography               nothing
==================  ================================================  ==============================================
"""

import math
from dataclasses import dataclass
from typing import Any

AUTO = "auto"
"""Smoothing that is chosen together with the number of control points."""

CRITERIA = ("FIT", "PRESS", "CMPRESS")
"""Criteria that are shown beside the one that selects."""

_MOST_UNKNOWNS, _OF_MANY = 900, 750
"""Largest number of unknowns with an automatic weight: the time grows with its square, and with n. The second one is
for the three functions of a warp with perspective, of more matches than `_MANY`."""

_MANY = 1000

_MOST_OF_SURFACES = 175
"""As in section 5 of the paper."""


@dataclass(frozen=True)
class Defaults:
    """Defaults of one call.

    Parameters
    ----------
    criterion : str
        What selects.
    largest : int
        Largest number of control points.
    placement : str
        Placement of the control points of thin-plate splines; other liftings have "lloyd".

    Examples
    --------
    >>> warp_defaults(50, "auto"), surface_defaults(50, 0.0).criterion
    (Defaults(criterion='MATCHED', largest=50, placement='nested'), 'ER10')
    """

    criterion: str
    largest: int
    placement: str


def warp_defaults(n: int, smoothing: Any, fractional: bool = True, several: bool = False) -> Defaults:
    """Return the defaults for n matches; `several` says that there are several weights."""
    if is_automatic(smoothing):
        unknowns = _OF_MANY if fractional and n > _MANY else _MOST_UNKNOWNS
        return Defaults("MATCHED", max(3, min(n, unknowns // (3 if fractional else 1))), "nested")
    return Defaults("ER10", largest_count(n), "nested" if several else "lloyd")


def surface_defaults(n: int, smoothing: Any) -> Defaults:
    """Return the defaults for n data of a surface."""
    if is_automatic(smoothing):
        return Defaults("MATCHED", min(n, _MOST_UNKNOWNS), "nested")
    return Defaults("ER10", min(n, _MOST_OF_SURFACES), "residual")


def is_automatic(smoothing: Any) -> bool:
    """Return whether the weight is "auto"."""
    return isinstance(smoothing, str) and smoothing == AUTO


def largest_count(n: int) -> int:
    """The largest number of control points that the paper tries for n data: half of them, at most 100.

    Examples
    --------
    >>> [largest_count(n) for n in (10, 15, 30, 150, 500)]
    [6, 7, 15, 75, 100]
    """
    return {10: 6, 15: 7}.get(n, min(math.floor(n / 2 + 0.5), 100))
