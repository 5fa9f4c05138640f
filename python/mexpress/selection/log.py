"""What selections tell the logger "mexpress". Nothing of it is printed by default."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar

from mexpress.logger import LOG

P = ParamSpec("P")
SelectionT = TypeVar("SelectionT", bound=Any)


def logged(
    select: Callable[Concatenate[Any, P], SelectionT],
) -> Callable[Concatenate[Any, P], SelectionT]:
    """Return a function that selects for data, and tells of it.

    That it begins, and what it selected, are of the level INFO. The notes of the selection follow as warnings, but only
    where INFO is enabled: they can take half as long as the selection, and whoever does not listen need not wait.

    Examples
    --------
    >>> import sys
    >>> import mexpress as mx
    >>> import numpy as np
    >>> source = np.random.default_rng(0).uniform(0, 100, (60, 2))
    >>> handler, level = logging.StreamHandler(sys.stdout), LOG.level
    >>> LOG.addHandler(handler)
    >>> LOG.setLevel("INFO")
    >>> selection = mx.select_warp(source, source[:, ::-1], image_size=(100, 50))
    Selecting for Matches(60 matches, diagonal 111.803).
    In ... s: WarpSelection(MATCHED chooses ...).
    ... of 60 source points are outside of the image of 100 x 50 pixels: ...
    >>> LOG.setLevel(level)
    >>> LOG.removeHandler(handler)
    """

    @wraps(select)
    def told(data: Any, /, *args: P.args, **kwargs: P.kwargs) -> SelectionT:
        LOG.info("Selecting for %r.", data)
        start = time.perf_counter()
        selection = select(data, *args, **kwargs)
        seconds, wrong = time.perf_counter() - start, len(selection.left_out)
        LOG.info("In %.2g s: %r%s.", seconds, selection, f"; {wrong} left out as wrong" if wrong else "")
        if LOG.isEnabledFor(logging.INFO):
            for note in selection.notes:
                LOG.warning("%s", note)
        return selection

    return told
