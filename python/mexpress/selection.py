"""How many control points: every criterion for every number of them, and the model that one criterion chooses.

See `select_warp`.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.criteria import Judge, Score, parse
from mexpress.designs import matched, measured_data, surface_design, warp_design
from mexpress.leastsquares import LeastSquares
from mexpress.liftings import make_lifting
from mexpress.nested import Nested, steps
from mexpress.placement import by_residual, covered_region, lloyd
from mexpress.progress import bar
from mexpress.schemes import Scheme
from mexpress.surfaces import Surface
from mexpress.warps import Warp

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Selection", "SurfaceSelection", "WarpSelection", "largest_count", "select_surface", "select_warp"]

DEFAULT_CRITERIA = ("FIT", "PRESS", "CMPRESS")


@dataclass(frozen=True, eq=False, repr=False)
class Selection:
    """Criteria against the number of control points, and what they choose.

    Parameters
    ----------
    criterion : str
        The criterion that selects.
    counts : (k,) int64 array
        Numbers of control points that were tried, increasing.
    curves : dict of str to (k,) array
        Every criterion's score, in the responses' unit (AIC and BIC have none); NaN where undefined.
    undefined : dict of str to dict of int to int64 array
        By criterion and count, the data whose prediction lacks the rank; counts without any are left out.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> curves = {"FIT": np.array([3.0, 2.0, 1.0]), "ER10": np.array([4.0, 3.5, np.nan])}
    >>> selection = mx.Selection("ER10", np.array([3, 4, 5]), curves, {"ER10": {5: np.array([17])}})
    >>> selection
    Selection(ER10 chooses 4 of 3 to 5 control points, ER10=3.5)
    >>> selection.selected
    {'FIT': 5, 'ER10': 4}
    """

    criterion: str
    counts: Integers
    curves: dict[str, Floats]
    undefined: dict[str, dict[int, Integers]]

    def __repr__(self) -> str:
        score = self.curves[self.criterion][self.counts == self.count][0]
        tried = f"{self.counts[0]} to {self.counts[-1]} control points"
        chosen = f"{self.criterion} chooses {self.count} of {tried}, {self.criterion}={score:.4g}"
        return f"{type(self).__name__}({chosen})"

    @property
    def selected(self) -> dict[str, int | None]:
        """What each criterion would choose: its smallest score's count; None if no count has a score.

        Examples
        --------
        See `Selection`.
        """
        return {
            name: None if np.isnan(curve).all() else int(self.counts[np.nanargmin(curve)])
            for name, curve in self.curves.items()
        }

    @property
    def count(self) -> int:
        """The selected number of control points."""
        chosen = self.selected[self.criterion]
        if chosen is None:
            rule = (
                "It must have a score at one count at least; more data, or fewer of them held out, may help."
            )
            check.refuse(
                "criterion", rule, f"{self.criterion}, undefined from {self.counts[0]} control points on"
            )
        return chosen

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Draw the criteria against the number of control points (needs the extra ``plot``).

        Parameters
        ----------
        path : path, optional
            Where to save the figure; its ending says the format.
        """
        from mexpress.plotting import plot_selection  # noqa: PLC0415 - an extra

        return plot_selection(self, path)


@dataclass(frozen=True, eq=False, repr=False)
class WarpSelection(Selection):
    """A warp with the number of control points that a criterion chose; see `Selection` for the other fields.

    Parameters
    ----------
    warps : dict of int to Warp
        The fitted warp of every count that the data determine.
    source, target : (n, 2) array
        The matches, in pixels.
    image_size : tuple of float, optional
        (width, height) of the source image in pixels.

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

    @property
    def warp(self) -> Warp:
        """The warp with the selected number of control points."""
        return self.warps[self.count]


def largest_count(n: int) -> int:
    """The largest number of control points that the paper tries for n data: half of them, at most 100.

    Examples
    --------
    >>> from mexpress.selection import largest_count
    >>> [largest_count(n) for n in (10, 15, 30, 150, 500)]
    [6, 7, 15, 75, 100]
    """
    return {10: 6, 15: 7}.get(n, min(math.floor(n / 2 + 0.5), 100))


def select_warp(
    source: ArrayLike,
    target: ArrayLike,
    criterion: str = "ER10",
    criteria: Sequence[str] | Mapping[str, Scheme] | None = None,
    lifting: str = "tps",
    fractional: bool = True,
    counts: ArrayLike | None = None,
    placement: str = "lloyd",
    smoothing: float = 0.0,
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
    criterion : str, default "ER10"
        Which criterion selects, see `mexpress.criteria`. ER10 predicts every match with all matches within 10 % of the
        diagonal held out, as the paper advises; no radius is right for every use, so look at several.
    criteria : sequence of str, or mapping of str to Scheme, optional
        Others to be computed beside it; FIT, PRESS and CMPRESS if not given. A mapping gives schemes of one's own,
        by names that no criterion has: if the criterion is one of them they stand alone, else beside the three.
    lifting : str, default "tps"
        The functions that bend the plane.
    fractional : bool, default True
        Whether the warp models perspective.
    counts : sequence of int, optional
        Numbers of control points to try; 3 to half the number of matches, at most 100, if not given.
    placement : {"lloyd"}
        How control points are spread over the region that the source points cover.
    smoothing : float, default 0
        Weight of the warp's bending energy beside the sum of squared residuals: larger is stiffer, down to an
        affine map or a homography.
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
    """
    source, target = matched(source, target)
    region = covered_region(source, "source")
    tried = _counts(counts, len(source))
    size = check.image_size(image_size)
    if not isinstance(placement, str) or placement != "lloyd":
        check.refuse("placement", 'It must be "lloyd".', check.describe(placement))
    for name, flag in (("fractional", fractional), ("progress", progress)):
        check.flag(flag, name)
    weight = check.number(smoothing, "smoothing", "It must be a number of at least 0.", 0.0)
    diagonal = None if size is None else math.hypot(*size)
    name, judge = _judge(criterion, criteria, source, diagonal, seed, threads)
    scores: dict[int, dict[str, Score]] = {}
    warps: dict[int, Warp] = {}
    with bar(len(tried), "warp") if progress else nullcontext(lambda: None) as step:
        for count in tried:
            control_points = lloyd(region, count, seed, threads)
            design = warp_design(make_lifting(lifting, control_points), source, target, fractional)
            rows = math.sqrt(weight) * design.bending() if weight else None
            model = LeastSquares(design.A, design.b, design.coupling, penalty=rows, threads=threads)
            scores[count] = judge.scores(model, threads)
            if model.rank == len(model.coefficients):
                warps[count] = design.warp(model.coefficients)
            step()
    selection = WarpSelection(name, *_curves(scores), warps, source, target, size)
    _ = selection.count  # an undefined criterion is an error now, not at the first use of the result
    return selection


def _counts(counts: ArrayLike | None, n: int) -> list[int]:
    """Numbers of control points to try, increasing."""
    if counts is None:
        if n < 4:
            check.refuse("source", "There must be four matches at least.", f"{n}")
        return list(range(3, max(largest_count(n), 3) + 1))
    listed = list(counts) if isinstance(counts, range) else counts
    if isinstance(listed, int | float | np.number):
        check.refuse(
            "counts", "It must be a list of numbers of control points.", check.describe(counts), TypeError
        )
    tried = check.indices(listed, "counts")
    if tried.size == 0 or tried.min() < 3 or tried.max() > n:
        rule = f"They must be one or more, from 3 to the number of matches, {n}."
        check.refuse("counts", rule, check.describe(counts))
    return sorted(tried.tolist())


def _judge(
    criterion: str,
    criteria: Sequence[str] | Mapping[str, Scheme] | None,
    points: Floats,
    diagonal: float | None,
    seed: Any,
    threads: int | None,
    nested: bool = False,
) -> tuple[str, Judge]:
    """The selecting criterion's name, and a judge of it and the others."""
    own = criteria if isinstance(criteria, Mapping) else {}
    if isinstance(criterion, str) and criterion in own:
        return criterion, Judge.of(own, points)
    named = DEFAULT_CRITERIA if criteria is None or own else criteria
    names = check.items(named, "criteria", "It must be a list of names, or schemes by name.")
    chosen = parse(criterion).name
    judge = Judge.of([*names, chosen], points, diagonal, seed, threads, nested)
    return chosen, judge | Judge.of(own, points)


def _curves(
    scores: Mapping[int, Mapping[str, Score]],
) -> tuple[Integers, dict[str, Floats], dict[str, dict[int, Integers]]]:
    """Counts, curves and undefined data, from scores by count."""
    names = next(iter(scores.values())).keys()
    curves = {name: np.array([by_name[name].value for by_name in scores.values()]) for name in names}
    undefined = {
        name: {n: by_name[name].undefined for n, by_name in scores.items() if by_name[name].undefined.size}
        for name in names
    }
    return np.array(list(scores), dtype=np.int64), curves, {k: v for k, v in undefined.items() if v}


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceSelection(Selection):
    """A surface with the number of control points that a criterion chose; see `Selection` for the other fields.

    Parameters
    ----------
    surface : Surface
        Fitted with the selected number of control points.
    points : (n, 2) array
        Where the data are.
    values : (n,) or (n, d) array
        The data.
    control_points : (l, 2) array
        In the order in which they came; a model of l control points has the first l.

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


def select_surface(
    points: ArrayLike,
    values: ArrayLike,
    criterion: str = "ER10",
    criteria: Sequence[str] | Mapping[str, Scheme] | None = None,
    max_count: int = 175,
    min_distance: float | None = None,
    smoothing: float = 0.0,
    seed: int = 0,
    threads: int | None = None,
    progress: bool = False,
) -> SurfaceSelection:
    """Fit a surface to data with the number of control points that a criterion chooses.

    Control points come one at a time, where the surface so far is farthest from the data (section 5.1 of the paper), so
    the models are nested and every criterion's whole curve costs what one model does.

    Parameters
    ----------
    points : (n, 2) array
        Where the data are: pixels of a depth map, or parameters of a sheet.
    values : (n,) or (n, d) array
        Depth, or positions in d dimensions.
    criterion : str, default "ER10"
        Which criterion selects, see `mexpress.criteria`; ERxx is a percentage of the diagonal of the points'
        bounding box. ER10 predicts every datum with all data within 10 % of it held out, as the paper advises;
        no radius is right for every use, so look at several.
    criteria : sequence of str, or mapping of str to Scheme, optional
        Others to be computed beside it; FIT, PRESS and CMPRESS if not given. A mapping gives schemes of one's own,
        by names that no criterion has: if the criterion is one of them they stand alone, else beside the three.
    max_count : int, default 175
        The largest number of control points.
    min_distance : float, optional
        How near control points may come to each other, in the unit of the points; 2.5 % of the diagonal if not given,
        see `mexpress.placement.by_residual`.
    smoothing : float, default 0
        Weight of the surface's bending energy beside the sum of squared residuals: larger is stiffer, down to a plane.
    seed : int, default 0
        Of everything random: the same seed gives the same result, whatever the number of threads.
    threads : int, optional
        At most so many threads; MEXPRESS_NUM_THREADS or all cores if not given.
    progress : bool, default False
        Whether to show progress on the terminal.

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
    """
    where, measured, _ = measured_data(points, values)
    most = check.count(max_count, "max_count", 3)
    weight = check.number(smoothing, "smoothing", "It must be a number of at least 0.", 0.0)
    check.flag(progress, "progress")
    name, judge = _judge(criterion, criteria, where, None, seed, threads, nested=True)
    with bar(1 + steps(len(where)), "surface") if progress else nullcontext(lambda: None) as step:
        arrived = where[by_residual(where, measured, most, min_distance, seed, threads)]
        design = surface_design(where, measured, arrived)
        stiff = math.sqrt(weight) * design.bending() if weight else None
        nested = Nested(design.A, design.b, penalty=stiff, threads=threads)
        step()
        counts = np.arange(3, len(arrived) + 1)
        scores = judge.curves(nested, counts, threads, step)
    by_count = {int(n): {key: curve[k] for key, curve in scores.items()} for k, n in enumerate(counts)}
    selected = Selection(name, *_curves(by_count))
    count = selected.count
    surface = design.surface(nested.coefficients(count), count)
    return SurfaceSelection(
        name, selected.counts, selected.curves, selected.undefined, surface, where, measured, arrived
    )
