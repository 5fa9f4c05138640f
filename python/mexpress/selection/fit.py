"""Fits of warps and surfaces with given control points."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mexpress import _validation as check
from mexpress.criteria import Scorer, parse
from mexpress.liftings import make_lifting
from mexpress.models import CardinalBasis, Design, ModelT, Surface, Warp
from mexpress.selection.candidates import CriteriaRequest
from mexpress.selection.data import Matches, Samples, those_present, total_weight
from mexpress.selection.defaults import surface_defaults, warp_defaults
from mexpress.selection.incomplete import RAISE
from mexpress.selection.sweep import sweep_designs
from mexpress.selection.unscored import refuse_unscored
from mexpress.selection.weights import smoothing_weights, tie_slack


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
    weights: ArrayLike | None = None,
    *,
    missing: str = RAISE,
) -> Warp:
    """Fit a warp with given control points to matches, by least squares.

    Parameters
    ----------
    source, target : array_like, (n, 2)
        Matched points in pixels of either image, x then y.
    control_points : array_like, (l, 2)
        Control points in pixels of the source image, 3 or more. With three, the warp is affine or a homography.
    lifting : str
        Name of the lifting: "tps", "bspline" (control points on a grid), "affine" (pieces between the control
        points), or a registered name, see `mexpress.liftings`.
    fractional : bool
        Whether the warp has a denominator, to model perspective. It then has 3l - 1 parameters instead of 2l, and the
        fit minimises the algebraic error, which is close to the transfer error in pixels.
    smoothing : float, list of float or "auto"
        Weight of the bending energy, which is added to the sum of squared residuals; of several weights, the best.
    criterion, image_size, seed
        Criterion that scores several weights, and its options, as for `select_warp`.
    threads : int, optional
        Largest number of threads; the result does not depend on it.
    weights : array_like, (n,), optional
        Weight of every match, such as a match's confidence; a match of weight 0 is absent. 1 each by default.
    missing : {"raise", "drop"}
        Whether rows with something missing, which is masked, NaN or infinite, are an error, or dropped.

    Returns
    -------
    Warp
        The warp from the source image to the target image.

    Raises
    ------
    ValueError
        If the input is not n matches and l distinct control points that are not on a line, or if the matches do not
        determine the warp: there are too few of them, or none near some control point.

    Examples
    --------
    >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
    >>> warp = fit_warp(square, [[0, 0], [100, 0], [20, 100], [80, 100]], square[:3])
    >>> warp
    Warp(fractional tps, 3 control points)
    >>> warp([[50, 0], [100, 100]]).round(6) + 0.0
    array([[ 50.,   0.], [ 80., 100.]])
    """
    fractional = check.flag(fractional, "fractional")
    basis = CardinalBasis(make_lifting(lifting, control_points))
    matches = those_present(Matches.of(source, target, image_size, weights, missing))
    chosen = warp_defaults(len(matches.source), smoothing).criterion if criterion is None else criterion
    request = CriteriaRequest(chosen, (), matches, seed, threads)
    return _fit(matches.design(basis, fractional), smoothing, request, "warp", "matches")


def fit_surface(
    points: ArrayLike,
    values: ArrayLike,
    control_points: ArrayLike,
    lifting: str = "tps",
    smoothing: float | ArrayLike | str = 0.0,
    criterion: str | None = None,
    seed: int = 0,
    threads: int | None = None,
    weights: ArrayLike | None = None,
    *,
    missing: str = RAISE,
) -> Surface:
    """Fit a surface with given control points to data, by least squares.

    Parameters
    ----------
    points : array_like, (n, 2)
        Positions of the data: pixels of a depth map, or the coordinates of a template.
    values : array_like, (n,) or (n, d)
        Depths or points in space at these positions.
    control_points : array_like, (l, 2)
        Control points in the unit of the positions, 3 or more, in any order. With three, the surface is a plane.
    lifting : str
        Name of the lifting, as for `fit_warp`.
    smoothing : float, list of float or "auto"
        Weight of the bending energy, which is added to the sum of squared residuals; of several weights, the best.
    criterion, seed
        Criterion that scores several weights, and its option, as for `select_surface`.
    threads : int, optional
        Largest number of threads; the result does not depend on it.
    weights : array_like, (n,), optional
        Weight of every datum, such as one over the square of its standard deviation; a datum of weight 0 is absent. 1
        each by default.
    missing : {"raise", "drop"}
        As for `fit_warp`.

    Returns
    -------
    Surface
        A surface whose values have the shape of one datum's value.

    Raises
    ------
    ValueError
        If the input is not n data and l distinct control points that are not on a line, or if the data do not
        determine the surface: there are too few of them, or none near some control point.

    Examples
    --------
    >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
    >>> surface = fit_surface(square, [0, 2, 2, 5], square)
    >>> surface
    Surface(depth, tps, 4 control points)
    >>> surface([[2, 2], [1, 1]]).round(6)
    array([5.  , 2.25])
    """
    basis = CardinalBasis(make_lifting(lifting, control_points))
    data = those_present(Samples.of(points, values, weights, missing))
    chosen = surface_defaults(len(data.points), smoothing).criterion if criterion is None else criterion
    request = CriteriaRequest(chosen, (), data, seed, threads)
    return _fit(data.design(basis), smoothing, request, "surface", "data")


def _fit(
    design: Design[ModelT],
    smoothing: float | ArrayLike | str,
    request: CriteriaRequest,
    what: str,
    data: str,
) -> ModelT:
    """Fit one design, with the best weight if there are several."""
    parse(request.criterion)
    check.generator(request.seed)
    n = len(request.data.points)
    weights = smoothing_weights(smoothing, total_weight(request.data), request.data.domain.area, design.count)
    name, scorer = request.listed if len(weights) > 1 else ("", Scorer({}, {}))
    sweep = sweep_designs([design], weights, scorer, request.threads, lambda: None)
    place = (0, 0)
    if name:
        selection = sweep.selection(name, tie_slack(smoothing, n))
        if np.isnan(selection.maps[name]).all():
            refuse_unscored(selection, request)
        place = selection.place
    model = sweep.model(*place)
    if model is None:
        rule = f"The {data} must determine the {what}, so take fewer control points, or smoothing above 0."
        unknowns, rank = design.A.shape[1], design.fit(threads=request.threads).rank
        given = f"{design.count}, hence {unknowns} unknowns, and {n} {data} of rank {rank} in all"
        check.refuse("control_points", rule, given)
    return model
