"""The selection of a surface."""

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
from mexpress.models import CardinalBasis, Design, Surface
from mexpress.placement import farthest_order, residual_order
from mexpress.schemes import Scheme
from mexpress.selection.candidates import Candidates, CriteriaRequest, checked_placement, default_criterion
from mexpress.selection.data import Samples
from mexpress.selection.fitted import FittedSelection
from mexpress.selection.weights import is_automatic, largest_automatic_count

MOST = 175
"""Largest number of control points, as in section 5 of the paper."""


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceSelection(FittedSelection[Surface]):
    """A surface with the number of control points that a criterion selects; see `Selection` for the other fields.

    Parameters
    ----------
    surface : Surface
        The selected surface.
    points : (n, 2) array
        Positions of the data.
    values : (n,) or (n, d) array
        Depths, or positions in d dimensions.
    control_points : (l, 2) array
        Control points of the largest model, in their order. A model of k control points has the first k, unless each
        count has its own.
    placement : str
        Placement of the control points, as for `select_surface`.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> points = np.random.default_rng(0).uniform(0, 1, (200, 2))
    >>> selection = mx.select_surface(points, np.sin(6 * points[:, 0]), max_count=40)
    >>> len(selection.surface.control_points) == selection.count
    True
    >>> figure = selection.plot()  # of matplotlib
    """

    surface: Surface
    points: Floats
    values: Floats
    control_points: Floats
    placement: str
    _most_flexible_count: ClassVar[int] = 100

    @property
    def _model(self) -> Surface:
        return self.surface

    def _data(self) -> Samples:
        return Samples(self.points, self.values, None, Region(self.surface.domain))

    def _design(self, basis: CardinalBasis) -> Design[Surface]:
        return self._data().design(basis)


def select_surface(
    points: ArrayLike,
    values: ArrayLike,
    criterion: str | None = None,
    criteria: Sequence[str] | Mapping[str, Scheme] | None = None,
    max_count: int | None = None,
    min_distance: float | None = None,
    smoothing: float | ArrayLike | str = 0.0,
    seed: int = 0,
    threads: int | None = None,
    progress: bool = False,
    lifting: str = "tps",
    placement: str | None = None,
) -> SurfaceSelection:
    """Fit a surface to data with the number of control points that a criterion selects.

    By default, the next control point is always the datum farthest from the surface so far (section 5.1 of the paper).
    The models are then nested, and a criterion's whole curve costs as much as one model.

    Parameters
    ----------
    points : (n, 2) array
        Positions of the data: pixels of a depth map, or parameters of a sheet.
    values : (n,) or (n, d) array
        Depths, or positions in d dimensions.
    criterion : str, optional
        Criterion that selects, see `mexpress.criteria`; ERxx is a percentage of the diagonal of the points' bounding
        box. ER10 by default, as the paper advises: it predicts every datum with all data within 10 % of the diagonal
        held out. No radius is right for every use, so compare several. With `smoothing` "auto", MATCHED by default:
        it matches the distances from predictions to training data to those in use.
    criteria : sequence of str, or mapping of str to Scheme, optional
        Further criteria to compute; FIT, PRESS and CMPRESS by default. A mapping gives schemes by names that no
        criterion has. If the criterion is one of these names, only the schemes are computed, else also the three.
    max_count : int, optional
        Largest number of control points; 175 by default. With `smoothing` "auto", the number of data, at most 900.
    min_distance : float, optional
        Smallest distance of control points with "residual" placement, in the unit of the points; 2.5 % of the diagonal
        by default, see `mexpress.placement.by_residual`.
    smoothing : float, list of float or "auto", default 0
        Weight of the bending energy, which is added to the sum of squared residuals. A larger weight gives a stiffer
        surface, in the limit a plane. Of several weights, the best is selected together with the count. "auto" tries
        twenty, from negligible to dominant, for the smallest and for the largest count.
    seed : int, default 0
        Seed of everything random. The same seed gives the same result with any number of threads.
    threads : int, optional
        Largest number of threads; MEXPRESS_NUM_THREADS or all cores by default.
    progress : bool, default False
        Whether to show progress on the terminal.
    lifting : str, default "tps"
        Name of the lifting: "tps", "bspline", "affine", or a registered name, see `mexpress.liftings`.
    placement : {"residual", "nested", "lloyd"}, optional
        Placement of control points. "residual": the datum farthest from the surface so far is the next one. "nested":
        the next one is always the datum farthest from the control points so far, which spreads them evenly at every
        count. Both are for thin-plate splines only. "lloyd": separately for every count, over the region of the data,
        by Lloyd's algorithm or on the lifting's grid. The default is "residual" for thin-plate splines ("nested" with
        `smoothing` "auto"), and "lloyd" for other liftings.

    Returns
    -------
    SurfaceSelection
        The surface, the curves, and the model that every criterion selects.

    Raises
    ------
    ValueError, TypeError
        If the data are not finite or do not cover a region, or if the criterion is undefined at every count.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> points = rng.uniform(0, 640, (1000, 2))
    >>> depth = 2 + 0.1 * np.sin(points[:, 0] / 100) + rng.normal(0, 0.01, 1000)
    >>> selection = mx.select_surface(points, depth, criterion="ER05", max_count=60)
    >>> selection.selected["FIT"], 10 <= selection.count < 60
    (60, True)
    >>> selection.surface([[320, 320]]).shape
    (1,)
    >>> smooth = mx.select_surface(points[:200], depth[:200], smoothing="auto")
    >>> smooth.smoothing > 0, smooth.maps["MATCHED"].shape
    (True, (2, 20))
    """
    data = Samples.of(points, values)
    n, automatic = len(data.points), is_automatic(smoothing)
    usual = largest_automatic_count(n, 1) if automatic else MOST
    most = usual if max_count is None else check.count(max_count, "max_count", 3)
    check.flag(progress, "progress")
    functions = lifting_named(lifting)
    choices = "residual", "nested", "lloyd"
    spread = checked_placement(placement, functions, choices, "nested" if automatic else "residual")
    orders = {
        "residual": partial(
            residual_order, data.points, data.values, min_distance=min_distance, seed=seed, threads=threads
        ),
        "nested": partial(farthest_order, data.points),
    }
    candidates = Candidates(
        functions, data.design, None, min(most, n), orders.get(spread), smoothing, placed=True
    )
    request = CriteriaRequest(default_criterion(criterion, smoothing), criteria, data, seed, threads)
    selection, sweep, ordered = candidates.select(request, "surface" if progress else None)
    surface = sweep.model(*selection.place)
    assert surface is not None  # a model with a score is determined
    return SurfaceSelection(
        **vars(selection),
        surface=surface,
        points=data.points,
        values=data.values,
        control_points=surface.control_points if ordered is None else ordered,
        placement=spread,
    )
