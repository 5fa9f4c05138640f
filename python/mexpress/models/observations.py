"""The data of a fit, as a model keeps them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from mexpress import _validation as check
from mexpress._validation import Floats


@dataclass(frozen=True, eq=False, repr=False)
class Observations:
    """The data that a model was fitted to: without them it cannot tell what error to expect.

    The arrays are not copied, so that all models of a selection share them: do not change them.

    Parameters
    ----------
    points : (n, 2) array
        Positions of the data.
    values : (n,) or (n, d) array
        Measurements at those positions.
    weights : (n,) array or None
        Positive weights of the data; 1 each if None.
    over_data : bool
        Of a warp with a denominator: whether denominators have mean one over the data, or over the control points.

    Examples
    --------
    >>> import mexpress as mx
    >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
    >>> mx.fit_surface(square, [0, 2, 2, 5], square).data
    Observations(4 data)
    """

    points: Floats
    values: Floats
    weights: Floats | None = None
    over_data: bool = False

    def __repr__(self) -> str:
        weighted = "" if self.weights is None else ", weighted"
        return f"Observations({len(self.points)} data{weighted})"

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that describe the data, by name."""
        arrays: dict[str, NDArray[Any]] = {"points": self.points, "values": self.values}
        if self.weights is not None:
            arrays["weights"] = self.weights
        return {**arrays, "over_data": np.array(self.over_data)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Self | None:
        """Check the arrays of `to_arrays`; None without points, which files of older versions do not have."""
        if "points" not in arrays:
            return None
        points = check.points(arrays["points"], "points")
        values, weights = check.columns(arrays["values"], "values", len(points)), arrays.get("weights")
        if weights is not None:
            weights = check.finite(check.real(weights, "weights"), "weights")
            if weights.shape != (len(points),) or weights.min() <= 0:
                rule = f"They must be {len(points)} positive numbers."
                check.refuse("weights", rule, check.describe(weights))
        return cls(points, values, weights, bool(arrays["over_data"]))
