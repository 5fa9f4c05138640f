"""The selection of a warp.

Examples
--------
See `select_warp`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.liftings import Lifting, ThinPlateSpline, lifting_named
from mexpress.models import WarpDesign, matched, nested_warp_design, warp_design
from mexpress.models.warp import Warp
from mexpress.placement import area, covered_region, farthest_first
from mexpress.schemes import Scheme
from mexpress.selection.candidates import (
    Jury,
    Models,
    default_criterion,
    largest_count,
    most_of,
    slack_of,
    wished_counts,
)
from mexpress.selection.fitted import ModelSelection
from mexpress.selection.selection import of_sweep
from mexpress.selection.weights import is_auto, weights_of

__all__ = ["WarpSelection", "select_warp"]


@dataclass(frozen=True, eq=False, repr=False)
class WarpSelection(ModelSelection[Warp]):
    """A warp with the number of control points that a criterion chose; see `Selection` for the other fields.

    Parameters
    ----------
    warps : dict of int to Warp
        The fitted warp of every count that is determined, with the weight that the criterion prefers there.
    source, target : (n, 2) array
        The matches, in pixels.
    image_size : tuple of float, optional
        (width, height) of the source image in pixels.
    placement : str
        How control points were spread.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> source = np.random.default_rng(0).uniform(0, 100, (20, 2))
    >>> selection = mx.select_warp(source, 2 * source + 1, counts=[3, 4, 5])
    >>> selection.warp is selection.warps[selection.count]
    True
    >>> figure = selection.plot()  # of matplotlib
    """

    warps: dict[int, Warp]
    source: Floats
    target: Floats
    image_size: tuple[float, float] | None
    placement: str

    @property
    def warp(self) -> Warp:
        """The selected warp."""
        return self.warps[self.count]

    @property
    def _supplest(self) -> int:
        return 30

    @property
    def _unit(self) -> str:
        return "pixels of the target image"

    def _data(self) -> tuple[Floats, Floats, float]:
        return self.source, self.target, _diagonal(self.source, self.image_size)

    def _lifting(self) -> Lifting:
        return self.warp.lifting

    def _design(self, lifting: Lifting) -> WarpDesign:
        over_data = _over_data(self.placement)
        return warp_design(lifting, self.source, self.target, self.warp.fractional, over_data)


def select_warp(
    source: ArrayLike,
    target: ArrayLike,
    criterion: str | None = None,
    criteria: Sequence[str] | Mapping[str, Scheme] | None = None,
    lifting: str = "tps",
    fractional: bool = True,
    counts: ArrayLike | None = None,
    placement: str | None = None,
    smoothing: float | ArrayLike | str = 0.0,
    image_size: tuple[float, float] | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: bool = False,
) -> WarpSelection:
    """Fit a warp to point matches with the number of control points that a criterion chooses.

    Parameters
    ----------
    source, target : (n, 2) array
        Matches, x then y, in pixels of either image; free of wrong ones.
    criterion : str, optional
        Which criterion selects, see `mexpress.criteria`. ER10 if not given: it predicts every match with all matches
        within 10 % of the diagonal held out, as the paper advises; no radius is right for every use, so look at
        several. MATCHED if not given and `smoothing` is "auto": it holds out what makes predictions as far from the
        matches as they are in use.
    criteria : sequence of str, or mapping of str to Scheme, optional
        Others to be computed beside it; FIT, PRESS and CMPRESS if not given. A mapping gives schemes of one's own,
        by names that no criterion has: if the criterion is one of them they stand alone, else beside the three.
    lifting : str, default "tps"
        The functions that bend the plane: "tps", "bspline", "affine", or of one's own, see `mexpress.liftings`.
    fractional : bool, default True
        Whether the warp models perspective.
    counts : sequence of int, optional
        Numbers of control points to try; 3 to half the number of matches, at most 100, if not given. With
        `smoothing` "auto" the fewest, and as many as there are matches, at most 300 (900 without perspective):
        stiffness does the rest, and fewer models leave less to chance.
    placement : {"lloyd", "nested"}, optional
        How control points are spread. "lloyd": over the region that the source points cover, anew for every count,
        by Lloyd's algorithm. "nested", of thin-plate splines alone: at source points, in an order of which every
        beginning is spread evenly, so that the models are nested and all counts are judged at once. If not given, it
        is "lloyd" with one weight of smoothing and "nested" with several. Liftings on grids, "bspline" and "affine",
        have their grids in place of "lloyd".
    smoothing : float, list of float or "auto", default 0
        Weight of the warp's bending energy beside the sum of squared residuals: larger is stiffer, down to an
        affine map or a homography. Of several, the best is selected together with the count. "auto" tries twenty,
        from no effect to nothing else.
    image_size : (width, height), optional
        Of the source image in pixels; ERxx is a percentage of its diagonal. The source points' bounding box if
        not given.
    seed : int, default 0
        Of everything random: the same seed gives the same result, whatever the number of threads.
    threads : int, optional
        At most so many threads; MEXPRESS_NUM_THREADS or all cores if not given.
    progress : bool, default False
        Whether to show progress on the terminal.

    Returns
    -------
    WarpSelection
        With the warp, the curves, and what every criterion would choose.

    Raises
    ------
    ValueError, TypeError
        If the input is not made of finite matches that cover a region, or if the criterion is undefined at
        every count.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> source = rng.uniform(0, 640, (60, 2))
    >>> bend = np.column_stack([0 * source[:, 0], 8 * np.sin(source[:, 0] / 100)])
    >>> target = 1.2 * source + bend + rng.normal(0, 0.5, source.shape)
    >>> selection = mx.select_warp(source, target, criterion="ER05", image_size=(640, 640), counts=range(3, 20))
    >>> selection.selected["FIT"], 6 <= selection.count < 19
    (18, True)
    >>> selection.warp([[320, 320]]).shape
    (1, 2)
    >>> smooth = mx.select_warp(source, target, smoothing="auto")
    >>> smooth.smoothing > 0, smooth.maps["MATCHED"].shape
    (True, (2, 20))
    """
    source, target = matched(source, target)
    region, n = covered_region(source, "source"), len(source)
    wished = wished_counts(counts, n, "matches")
    if wished is None and n < 4:
        check.refuse("source", "There must be four matches at least.", f"{n}")
    size = check.image_size(image_size)
    for name, flag in (("fractional", fractional), ("progress", progress)):
        check.flag(flag, name)
    functions = lifting_named(lifting)
    auto, extent = is_auto(smoothing), area(region)
    most = most_of(n, 3 if fractional else 1) if auto else largest_count(n)
    tried = functions.counts(region, most) if wished is None else wished.tolist()
    if auto and wished is None:
        tried = sorted({tried[0], tried[-1]})
    weights = weights_of(smoothing, n, extent, tried[-1])
    spread = _placement(placement, functions is ThinPlateSpline, len(weights) > 1)
    ordered = None
    if spread == "nested":
        ordered = source[farthest_first(source, tried[-1])]
        tried = sorted({min(count, len(ordered)) for count in tried})
    models = Models(
        functions,
        tried,
        weights,
        ordered,
        region,
        partial(
            warp_design, source=source, target=target, fractional=fractional, over_data=_over_data(spread)
        ),
        partial(nested_warp_design, source, target, fractional=fractional),
    )
    diagonal = _diagonal(source, size)
    jury = Jury(default_criterion(criterion, smoothing), criteria, source, diagonal, seed, threads)
    name, sweep = models.sweep(jury, "warp" if progress else None)
    selection = of_sweep(name, sweep, slack_of(smoothing, n))
    warps = {}
    for k, count in enumerate(selection.counts.tolist()):
        w = selection.best_weight(k)
        warp = sweep.fitted(k, len(weights) - 1 if w is None else w)
        if warp is not None:
            warps[count] = warp
    return WarpSelection(
        **vars(selection), warps=warps, source=source, target=target, image_size=size, placement=spread
    )


def _diagonal(source: Floats, size: tuple[float, float] | None) -> float:
    """What ERxx is a percentage of: the image's diagonal, or that of the points' bounding box."""
    return float(np.hypot(*np.ptp(source, axis=0))) if size is None else math.hypot(*size)


def _over_data(placement: str) -> bool | None:
    """Whether denominators have mean one over the data, as nested models need it; None is as the lifting likes it."""
    return True if placement == "nested" else None


def _placement(placement: str | None, splines: bool, several: bool) -> str:
    """How control points are spread, checked."""
    if placement is None:
        return "nested" if splines and several else "lloyd"
    if not isinstance(placement, str) or placement not in {"lloyd", "nested"}:
        check.refuse("placement", 'It must be "lloyd" or "nested".', check.describe(placement))
    if placement == "nested" and not splines:
        check.refuse(
            "placement", 'It must be "lloyd" unless the lifting is "tps".', check.describe(placement)
        )
    return placement
