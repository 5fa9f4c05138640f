"""The selection of a surface.

Examples
--------
>>> import numpy as np
>>> points = np.random.default_rng(0).uniform(0, 1, (200, 2))
>>> select_surface(points, np.sin(6 * points[:, 0]), max_count=40).criterion
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
from mexpress.models import CardinalBasis, Design, Surface
from mexpress.placement import farthest_order, residual_order
from mexpress.schemes import Scheme
from mexpress.selection.candidates import Candidates, CriteriaRequest, checked_placement, default_criterion
from mexpress.selection.data import Samples
from mexpress.selection.fitted import FittedSelection
from mexpress.selection.weights import is_automatic, largest_automatic_count

MOST = 175
"""Control points, as in section 5 of the paper."""


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceSelection(FittedSelection[Surface]):
    """A surface with the number of control points that a criterion chose; see `Selection` for the other fields.

    Parameters
    ----------
    surface : Surface
        The selected one.
    points : (n, 2) array
        Where the data are.
    values : (n,) or (n, d) array
        The data.
    control_points : (l, 2) array
        Those of the largest model, in the order in which they came; unless each count has its own, a model of k
        control points has the first k.
    placement : str
        Where control points went.

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
    """Fit a surface to data with the number of control points that a criterion chooses.

    Control points come one at a time, where the surface so far is farthest from the data (section 5.1 of the paper), so
    the models are nested and every criterion's whole curve costs what one model does: see `placement` for other ways.

    Parameters
    ----------
    points : (n, 2) array
        Where the data are: pixels of a depth map, or parameters of a sheet.
    values : (n,) or (n, d) array
        Depth, or positions in d dimensions.
    criterion : str, optional
        Which criterion selects, see `mexpress.criteria`; ERxx is a percentage of the diagonal of the points'
        bounding box. ER10 if not given: it predicts every datum with all data within 10 % of it held out, as the paper
        advises; no radius is right for every use, so look at several. MATCHED if not given and `smoothing` is
        "auto": it holds out what makes predictions as far from the data as they are in use.
    criteria : sequence of str, or mapping of str to Scheme, optional
        Others to be computed beside it; FIT, PRESS and CMPRESS if not given. A mapping gives schemes of one's own,
        by names that no criterion has: if the criterion is one of them they stand alone, else beside the three.
    max_count : int, optional
        The largest number of control points; 175 if not given. With `smoothing` "auto" as many as there are data, at
        most 900.
    min_distance : float, optional
        How near control points that are placed by residuals may come to each other, in the unit of the points; 2.5 % of
        the diagonal if not given, see `mexpress.placement.by_residual`.
    smoothing : float, list of float or "auto", default 0
        Weight of the surface's bending energy beside the sum of squared residuals: larger is stiffer, down to a plane.
        Of several, the best is selected together with the count. "auto" tries twenty, from negligible to dominant,
        for the fewest and for the most control points.
    seed : int, default 0
        Of everything random: the same seed gives the same result, whatever the number of threads.
    threads : int, optional
        At most so many threads; MEXPRESS_NUM_THREADS or all cores if not given.
    progress : bool, default False
        Whether to show progress on the terminal.
    lifting : str, default "tps"
        The functions that make the surface: "tps", "bspline", "affine", or of one's own, see `mexpress.liftings`.
    placement : {"residual", "nested", "lloyd"}, optional
        Where control points go. "residual", of thin-plate splines alone: where the surface so far is farthest from the
        data. "nested", of thin-plate splines alone: to data in an order of which every beginning is spread evenly.
        "lloyd": over the region of the data, anew for every count, by Lloyd's algorithm, or the grid that the lifting
        has in its place. If not given, it is "residual" for thin-plate splines ("nested" with `smoothing` "auto"), and
        "lloyd" for others.

    Returns
    -------
    SurfaceSelection
        With the surface, the curves, and what every criterion would choose.

    Raises
    ------
    ValueError, TypeError
        If the input is not made of finite data that cover a region, or if the criterion is undefined at every count.

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
    candidates = Candidates(functions, data.design, None, min(most, n), orders.get(spread), smoothing)
    request = CriteriaRequest(default_criterion(criterion, smoothing), criteria, data, seed, threads)
    selection, sweep, ordered = candidates.select(request, "surface" if progress else None)
    surface = sweep.model(*selection.place)
    assert surface is not None  # a score means that it is determined
    return SurfaceSelection(
        **vars(selection),
        surface=surface,
        points=data.points,
        values=data.values,
        control_points=surface.control_points if ordered is None else ordered,
        placement=spread,
    )
