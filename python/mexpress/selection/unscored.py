"""Why a criterion has no score at any count: which argument is the cause, and what to do."""

from __future__ import annotations

from typing import NoReturn

import numpy as np

from mexpress import _validation as check
from mexpress.criteria import WITHOUT_HOLDING_OUT, family, parse
from mexpress.geometry import diagonal
from mexpress.selection.candidates import CriteriaRequest
from mexpress.selection.data import Data, Matches, is_speck
from mexpress.selection.selection import Selection

_LESS = {
    "KF": "more folds",
    "NN..PTS": "fewer neighbours",
    "NN..PCT": "a smaller percentage",
    "LPO": "a smaller number",
    "RS..PCT": "a smaller percentage",
}
"""How criteria, by their families, hold out less."""

_SOME = 100
"""Of so many data that cannot be predicted, the number that is left is counted."""


def refuse_unscored(scores: Selection, request: CriteriaRequest) -> NoReturn:
    """Refuse the argument because of which a criterion has no score at any count.

    Examples
    --------
    >>> import mexpress as mx
    >>> source = np.random.default_rng(0).uniform(0, 1, (30, 2))
    >>> mx.select_warp(source, source, criterion="ER80", smoothing=0)
    Traceback (most recent call last):
    ValueError: Invalid criterion. It must leave enough matches ...: take a smaller radius, such as ER10, ...
    """
    data = request.data
    if isinstance(data, Matches) and not np.ptp(data.target, axis=0).any():
        rule = "Its points must not all be equal, unless fractional=False."
        check.refuse("target", rule, f"{len(data.target)} times {data.target[0].tolist()}")
    if np.isnan(scores.maps.get("CMPRESS", 0.0)).all() or family(scores.criterion) in WITHOUT_HOLDING_OUT:
        _refuse_few(scores, data)
    _refuse_other_unit(scores, data)
    _refuse_criterion(scores, request)


def _refuse_few(scores: Selection, data: Data) -> NoReturn:
    name, many, model = _words(data)
    n, places = len(data.points), len(np.unique(data.points, axis=0))
    count = scores.counts[0]
    ways = [f"more {many}", *_weaker(scores, places - 1)]
    if isinstance(data, Matches) and count == 3 and places == 4:
        ways.append("fractional=False")
    rule = (
        f"All but one of its points must determine a {model} of {count} control points: take {_either(ways)}."
    )
    given = f"{n} {many}" + (f" in {places} places" if places < n else "")
    check.refuse(name, rule, given + _present(data))


def _refuse_other_unit(scores: Selection, data: Data) -> None:
    """Refuse the size of an image whose pixels are not the unit of the points."""
    if data.image_size is None or family(scores.criterion) != "ER" or not is_speck(data):
        return
    (width, height), radius = data.image_size, parse(scores.criterion).amount / 100 * data.diagonal
    rule = (
        f"Its unit must be that of source: {scores.criterion} holds out all matches within {radius:.4g}, a share of "
        "its diagonal, so give points in pixels, or leave it out."
    )
    given = f"{width:g} x {height:g} with points that extend over {diagonal(data.points):.3g}"
    check.refuse("image_size", rule, given)


def _refuse_criterion(scores: Selection, request: CriteriaRequest) -> NoReturn:
    data, name = request.data, scores.criterion
    _, many, model = _words(data)
    if family(name) == "ER":
        most = min(10 * diagonal(data.points) / data.diagonal, parse(name).amount / 2)
        less = f"a smaller radius, such as ER{most:.2g}"
    else:
        less = _LESS.get(family(name), "another, such as CMPRESS")
    left = _fewest_left(scores, request)
    rule = (
        f"It must leave enough {many} to determine a {model} of {scores.counts[0]} control points: take "
        f"{_either([less, *_weaker(scores, left), f'more {many}'])}."
    )
    given = f"{name}, which leaves {left} of {len(data.points)} {many} to predict one from"
    check.refuse("criterion", rule, given + _present(data))


def _fewest_left(scores: Selection, request: CriteriaRequest) -> int:
    """Return the smallest number of data that the criterion leaves."""
    name, points = scores.criterion, request.data.points
    if family(name) == "ER":  # whose neighbourhoods may be too large for a list
        lost = scores.undefined.get(name, {}).get(int(scores.counts[0]), np.arange(len(points)))[:_SOME]
        radius = parse(name).amount / 100 * request.data.diagonal
        return min(int((np.hypot(*(points - points[i]).T) > radius).sum()) for i in lost)
    return len(points) - int(request.listed[1].schemes[name].held_out.sizes.max())


def _weaker(scores: Selection, left: int) -> list[str]:
    """Return the ways in which models need fewer data; not even a plane is determined by less than three."""
    if left < 3:
        return []
    ways = ['smoothing="auto"'] if scores.weights[0] == 0 else []
    return [*ways, 'fewer control points, 3 at least with lifting="tps"'] if scores.counts[0] > 3 else ways


def _words(data: Data) -> tuple[str, str, str]:
    """Return what the argument with the positions, the data and the model are called."""
    return ("source", "matches", "warp") if isinstance(data, Matches) else ("points", "data", "surface")


def _present(data: Data) -> str:
    return "" if data.weights is None else ", those of weight 0 apart"


def _either(ways: list[str]) -> str:
    return ", or ".join(ways)
