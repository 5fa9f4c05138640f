"""The selection of a warp.

Examples
--------
>>> import numpy as np
>>> source = np.random.default_rng(0).uniform(0, 100, (20, 2))
>>> select_warp(source, 2 * source + 1, counts=[3, 4, 5]).criterion
'ER10'
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.geometry import Region
from mexpress.liftings import lifting_named
from mexpress.models import CardinalBasis, Design, Warp
from mexpress.placement import farthest_order
from mexpress.schemes import Scheme
from mexpress.selection.candidates import (
    Candidates,
    CriteriaRequest,
    checked_counts,
    checked_placement,
    default_criterion,
    largest_count,
)
from mexpress.selection.data import Matches
from mexpress.selection.fitted import FittedSelection
from mexpress.selection.weights import is_automatic, largest_automatic_count, several_weights


@dataclass(frozen=True, eq=False, repr=False)
class WarpSelection(FittedSelection[Warp]):
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
    _unit: ClassVar[str | None] = "pixels of the target image"
    _most_flexible_count: ClassVar[int] = 30

    @property
    def warp(self) -> Warp:
        """The selected warp."""
        return self.warps[self.count]

    @property
    def _model(self) -> Warp:
        return self.warp

    def _data(self) -> Matches:
        return Matches(self.source, self.target, None, Region(self.warp.domain), self.image_size)

    def _design(self, basis: CardinalBasis) -> Design[Warp]:
        return self._data().design(basis, self.warp.fractional, _over_data(self.placement))


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
        from negligible to dominant.
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
    matches = Matches.of(source, target, image_size)
    n, automatic = len(matches.source), is_automatic(smoothing)
    wished = checked_counts(counts, n, "matches")
    if wished is None and n < 4:
        check.refuse("source", "There must be four matches at least.", f"{n}")
    for name, flag in (("fractional", fractional), ("progress", progress)):
        check.flag(flag, name)
    functions = lifting_named(lifting)
    usual = "nested" if several_weights(smoothing) else "lloyd"
    spread = checked_placement(placement, functions, ("lloyd", "nested"), usual)
    candidates = Candidates(
        functions,
        partial(matches.design, fractional=fractional, over_data=_over_data(spread)),
        wished,
        largest_automatic_count(n, 3 if fractional else 1) if automatic else largest_count(n),
        partial(farthest_order, matches.source) if spread == "nested" else None,
        smoothing,
    )
    request = CriteriaRequest(default_criterion(criterion, smoothing), criteria, matches, seed, threads)
    selection, sweep, _ = candidates.select(request, "warp" if progress else None)
    warps = {}
    for k, count in enumerate(selection.counts.tolist()):
        w = selection.best_weight(k)
        warp = sweep.model(k, -1 if w is None else w)
        if warp is not None:
            warps[count] = warp
    return WarpSelection(
        **vars(selection),
        warps=warps,
        source=matches.source,
        target=matches.target,
        image_size=matches.image_size,
        placement=spread,
    )


def _over_data(placement: str) -> bool | None:
    """Whether denominators have mean one over the data, as nested models need it; None is as the lifting likes it."""
    return True if placement == "nested" else None
