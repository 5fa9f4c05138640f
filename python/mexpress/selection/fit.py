"""Fits of warps and surfaces with given control points.

Examples
--------
See `mexpress.fit_warp` and `mexpress.fit_surface`.
"""

import math

from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.criteria import Judge, parse
from mexpress.liftings import make_lifting
from mexpress.models import Design, matched, measured_data, surface_design, warp_design
from mexpress.models.surface import Surface
from mexpress.models.warp import Warp
from mexpress.placement import area
from mexpress.selection.candidates import Jury, default_criterion, slack_of
from mexpress.selection.selection import of_sweep
from mexpress.selection.sweep import Model, one_by_one
from mexpress.selection.weights import weights_of

__all__ = ["fit_surface", "fit_warp"]


def fit_warp(
    source: ArrayLike,
    target: ArrayLike,
    control_points: ArrayLike,
    lifting: str = "tps",
    fractional: bool = True,
    smoothing: float | ArrayLike | str = 0.0,
    criterion: str | None = None,
    image_size: tuple[float, float] | None = None,
    seed: int = 0,
    threads: int | None = None,
) -> Warp:
    """Fit a warp with given control points to matches, by least squares.

    Parameters
    ----------
    source, target : array_like, (n, 2)
        Matched points in pixels of either image, x then y.
    control_points : array_like, (l, 2)
        In pixels of the source image, 3 or more. With three the warp is affine, or a homography.
    lifting : str
        Name of the functions that bend the plane: "tps", "bspline" (control points on a grid), "affine" (pieces
        between the control points), or of one's own, see `mexpress.liftings`.
    fractional : bool
        Whether the warp has a denominator, that is, models perspective. It then has 3l - 1 parameters instead
        of 2l and minimises the algebraic error, close to the transfer error in pixels.
    smoothing : float, list of float or "auto"
        Weight of the bending energy beside the sum of squared residuals; of several, that of the smallest score.
    criterion, image_size, seed
        What scores several weights, as for `select_warp`.
    threads : int, optional
        Upper bound on threads; the result does not depend on it.

    Returns
    -------
    Warp
        From the source image to the target image.

    Raises
    ------
    ValueError
        If the input is not n matches and l distinct control points that are not on a line, or if the matches
        do not determine the warp: they are too few, or none is near some control point.

    Examples
    --------
    >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
    >>> warp = fit_warp(square, [[0, 0], [100, 0], [20, 100], [80, 100]], square[:3])
    >>> warp
    Warp(fractional tps, 3 control points)
    >>> warp([[50, 0], [100, 100]]).round(6) + 0.0
    array([[ 50.,   0.], [ 80., 100.]])
    """
    fractional, size = check.flag(fractional, "fractional"), check.image_size(image_size)
    design = warp_design(make_lifting(lifting, control_points), source, target, fractional)
    source, _ = matched(source, target)
    diagonal = None if size is None else math.hypot(*size)
    jury = Jury(default_criterion(criterion, smoothing), (), source, diagonal, seed, threads)
    return _fit(design, design.domain, smoothing, jury, "warp", "matches")


def fit_surface(
    points: ArrayLike,
    values: ArrayLike,
    control_points: ArrayLike,
    lifting: str = "tps",
    smoothing: float | ArrayLike | str = 0.0,
    criterion: str | None = None,
    seed: int = 0,
    threads: int | None = None,
) -> Surface:
    """Fit a surface with given control points to data, by least squares.

    Parameters
    ----------
    points : array_like, (n, 2)
        Positions of the data: pixels of a depth map, or the coordinates of a template.
    values : array_like, (n,) or (n, d)
        Depths, or points in space, at these positions.
    control_points : array_like, (l, 2)
        In the unit of the positions, 3 or more, in any order. With three the surface is a plane.
    lifting : str
        Name of the functions that make the surface, as for `fit_warp`.
    smoothing : float, list of float or "auto"
        Weight of the bending energy beside the sum of squared residuals; of several, that of the smallest score.
    criterion, seed
        What scores several weights, as for `select_surface`.
    threads : int, optional
        Upper bound on threads; the result does not depend on it.

    Returns
    -------
    Surface
        With values of the shape of one datum's.

    Raises
    ------
    ValueError
        If the input is not n data and l distinct control points that are not on a line, or if the data do
        not determine the surface: they are too few, or none is near some control point.

    Examples
    --------
    >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
    >>> surface = fit_surface(square, [0, 2, 2, 5], square)
    >>> surface
    Surface(depth, tps, 4 control points)
    >>> surface([[2, 2], [1, 1]]).round(6)
    array([5.  , 2.25])
    """
    design = surface_design(make_lifting(lifting, control_points), points, values)
    where, _, region = measured_data(points, values)
    jury = Jury(default_criterion(criterion, smoothing), (), where, None, seed, threads)
    return _fit(design, region, smoothing, jury, "surface", "data")


def _fit(
    design: Design[Model],
    region: Floats,
    smoothing: float | ArrayLike | str,
    jury: Jury,
    what: str,
    data: str,
) -> Model:
    """Fit one design, with the best of the weights if there are several."""
    parse(jury.criterion)
    check.generator(jury.seed)
    n = len(jury.points)
    weights = weights_of(smoothing, n, area(region), design.count)
    place = 0, 0
    if len(weights) > 1:
        name, judge = jury.judge(nested=False)
        sweep = one_by_one([design], weights, judge, jury.threads, lambda: None)
        place = of_sweep(name, sweep, slack_of(smoothing, n)).place
    else:
        sweep = one_by_one([design], weights, Judge({}, {}), jury.threads, lambda: None)
    model = sweep.fitted(*place)
    if model is None:
        rule = f"The {data} must determine the {what}, so take fewer control points, or smoothing above 0."
        given = f"{design.count}, hence {sweep.unknowns[0]} unknowns, and {n} {data} of rank {sweep.ranks[0]} in all"
        check.refuse("control_points", rule, given)
    return model
