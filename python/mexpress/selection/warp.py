"""The selection of a warp."""

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
    """A warp with the number of control points that a criterion selects; see `Selection` for the other fields.

    Parameters
    ----------
    warps : dict of int to Warp
        The warp of every count that the data determine, at the criterion's best weight for the count.
    source, target : (n, 2) array
        The matches, in pixels.
    image_size : tuple of float, optional
        (width, height) of the source image in pixels.
    placement : str
        Placement of the control points, as for `select_warp`.

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
    """Fit a warp to point matches with the number of control points that a criterion selects.

    Parameters
    ----------
    source, target : (n, 2) array
        Matches, x then y, in pixels of either image; without wrong matches.
    criterion : str, optional
        Criterion that selects, see `mexpress.criteria`. ER10 by default, as the paper advises: it predicts every match
        with all matches within 10 % of the diagonal held out. No radius is right for every use, so compare several.
        With `smoothing` "auto", MATCHED by default: it matches the distances from predictions to training data to
        those in use.
    criteria : sequence of str, or mapping of str to Scheme, optional
        Further criteria to compute; FIT, PRESS and CMPRESS by default. A mapping gives schemes by names that no
        criterion has. If the criterion is one of these names, only the schemes are computed, else also the three.
    lifting : str, default "tps"
        Name of the lifting: "tps", "bspline", "affine", or a registered name, see `mexpress.liftings`.
    fractional : bool, default True
        Whether the warp models perspective.
    counts : sequence of int, optional
        Numbers of control points to try; 3 to half the number of matches, at most 100, by default. With `smoothing`
        "auto", only the smallest and the number of matches, at most 300 (900 without perspective): the weight
        controls the flexibility, and the choice among fewer models is less random.
    placement : {"lloyd", "nested"}, optional
        Placement of control points. "lloyd": separately for every count, over the region that the source points
        cover, by Lloyd's algorithm ("bspline" and "affine" have grids instead). "nested", for thin-plate splines
        only: the next control point is always the source point farthest from those so far, so the models are nested
        and all counts are scored at once. The default is "lloyd" with one weight and "nested" with several weights.
    smoothing : float, list of float or "auto", default 0
        Weight of the bending energy, which is added to the sum of squared residuals. A larger weight gives a stiffer
        warp, in the limit an affine map or a homography. Of several weights, the best is selected together with the
        count. "auto" tries twenty, from negligible to dominant.
    image_size : (width, height), optional
        Size of the source image in pixels; ERxx is a percentage of its diagonal. The source points' bounding box by
        default.
    seed : int, default 0
        Seed of everything random. The same seed gives the same result with any number of threads.
    threads : int, optional
        Largest number of threads; MEXPRESS_NUM_THREADS or all cores by default.
    progress : bool, default False
        Whether to show progress on the terminal.

    Returns
    -------
    WarpSelection
        The warp, the curves, and the model that every criterion selects.

    Raises
    ------
    ValueError, TypeError
        If the matches are not finite or do not cover a region, or if the criterion is undefined at every count.

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
    """Whether denominators have mean one over the data, as nested models need it; None for the lifting's default."""
    return True if placement == "nested" else None
