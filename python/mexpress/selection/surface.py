"""The selection of a surface.

Examples
--------
See `select_surface`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.liftings import Lifting, ThinPlateSpline, lifting_named
from mexpress.models import SurfaceDesign, measured_data, nested_surface_design, surface_design
from mexpress.models.surface import Surface
from mexpress.placement import area, by_residual, farthest_first
from mexpress.schemes import Scheme
from mexpress.selection.candidates import Jury, Models, default_criterion, most_of, slack_of
from mexpress.selection.fitted import ModelSelection
from mexpress.selection.selection import of_sweep
from mexpress.selection.weights import is_auto, weights_of

__all__ = ["SurfaceSelection", "select_surface"]

MOST = 175
"""Control points, as in section 5 of the paper."""


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceSelection(ModelSelection[Surface]):
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

    @property
    def _supplest(self) -> int:
        return 100

    def _data(self) -> tuple[Floats, Floats, float]:
        return self.points, self.values, float(np.hypot(*np.ptp(self.points, axis=0)))

    def _lifting(self) -> Lifting:
        return self.surface.lifting

    def _design(self, lifting: Lifting) -> SurfaceDesign:
        return surface_design(lifting, self.points, self.values)


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
        Of several, the best is selected together with the count. "auto" tries twenty, from no effect to nothing else,
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
    where, measured, region = measured_data(points, values)
    n, auto = len(where), is_auto(smoothing)
    usual = most_of(n, 1) if auto else MOST
    most = usual if max_count is None else check.count(max_count, "max_count", 3)
    check.flag(progress, "progress")
    functions = lifting_named(lifting)
    spread = _placement(placement, functions is ThinPlateSpline, auto)
    ordered = None
    if spread == "residual":
        ordered = where[by_residual(where, measured, most, min_distance, seed, threads)]
    elif spread == "nested":
        ordered = where[farthest_first(where, most)]
    tried = functions.counts(region, min(most, n) if ordered is None else len(ordered))
    if auto:
        tried = sorted({tried[0], tried[-1]})
    weights = weights_of(smoothing, n, area(region), tried[-1])
    models = Models(
        functions,
        tried,
        weights,
        ordered,
        region,
        partial(surface_design, points=where, values=measured),
        partial(nested_surface_design, where, measured),
    )
    jury = Jury(default_criterion(criterion, smoothing), criteria, where, None, seed, threads)
    name, sweep = models.sweep(jury, "surface" if progress else None)
    selection = of_sweep(name, sweep, slack_of(smoothing, n))
    surface = sweep.fitted(*selection.place)
    assert surface is not None  # a score means that it is determined
    kept = surface.control_points if ordered is None else ordered
    return SurfaceSelection(
        **vars(selection),
        surface=surface,
        points=where,
        values=measured,
        control_points=kept,
        placement=spread,
    )


def _placement(placement: str | None, splines: bool, auto: bool) -> str:
    """How control points are spread, checked."""
    if placement is None:
        return ("nested" if auto else "residual") if splines else "lloyd"
    if not isinstance(placement, str) or placement not in {"residual", "nested", "lloyd"}:
        rule = 'It must be "residual", "nested" or "lloyd".'
        check.refuse("placement", rule, check.describe(placement))
    if placement != "lloyd" and not splines:
        check.refuse(
            "placement", 'It must be "lloyd" unless the lifting is "tps".', check.describe(placement)
        )
    return placement
