"""The common part of warps and surfaces: parameters of a lifting over the region of their data."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress import notebook
from mexpress._validation import Floats
from mexpress.geometry import Region, lengths_of
from mexpress.liftings import Lifting, check_lifting, make_lifting
from mexpress.models import files
from mexpress.models.observations import Observations

_GRID_SAMPLES, _GRID_EVERY = 61, 5
"""Samples along a line of the grid in a small picture, and which of them have a line across."""


@dataclass(frozen=True, eq=False, repr=False)
class Model(ABC):
    """A fitted `Warp` or `Surface`: callable, picklable, and fully described by a few arrays.

    Parameters
    ----------
    lifting : Lifting
        A lifting with l control points.
    parameters : array_like, (l, ...)
        One column per function.
    domain : array_like, (k, 2), or Region
        Points of the fit, or the region that they cover. The model keeps their convex hull and extrapolates outside it.
    smoothing : float
        Weight of the bending energy in its fit.
    data : Observations, optional
        The data of its fit.
    """

    lifting: Lifting
    parameters: Floats
    domain: Floats
    smoothing: float = 0.0
    data: Observations | None = None
    kind: ClassVar[str]

    def __init_subclass__(cls) -> None:
        if "kind" in vars(cls):  # files of a subclass of Warp or Surface load as a Warp or Surface
            files.KINDS[cls.kind] = cls

    def __post_init__(self) -> None:
        check_lifting(self.lifting)
        parameters = self._checked_parameters().copy()
        domain = Region.of(self.domain, "domain").corners.copy()
        for name, array in (("parameters", parameters), ("domain", domain)):
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        rule = "It must be a number of at least 0."
        object.__setattr__(self, "smoothing", check.number(self.smoothing, "smoothing", rule, 0.0))
        if not (self.data is None or isinstance(self.data, Observations)):
            check.refuse("data", "They must be Observations.", check.describe(self.data), TypeError)

    @abstractmethod
    def _checked_parameters(self) -> Floats:
        """Parameters of a shape that suits the lifting."""

    @abstractmethod
    def __call__(self, points: ArrayLike) -> Floats:
        """Return the model's values at points, (k, 2); NaN at points that are not known."""

    def __reduce__(self) -> tuple[Any, ...]:
        # Caches are not pickled, and unpickled arrays are read-only again.
        return type(self), (self.lifting, self.parameters, self.domain, self.smoothing, self.data)

    def _repr_html_(self) -> str:
        low, high = self.domain.min(axis=0), self.domain.max(axis=0)
        said = {
            "form": self._form(),
            "lifting": self.lifting.name,
            "control points": f"{len(self.control_points)}",
            "smoothing": f"{self.smoothing:.3g}",
            "domain": f"x {low[0]:.4g} to {high[0]:.4g}, y {low[1]:.4g} to {high[1]:.4g}",
        }
        if self.data is not None:
            misses = self(self.data.points) - self.data.values
            errors = lengths_of(misses.reshape(len(misses), -1))
            rms = float(np.sqrt((errors**2).mean()))
            said["data"] = f"{len(errors)}; residuals: RMS {rms:.3g}, median {np.median(errors):.3g}"
        return notebook.card(type(self).__name__, notebook.facts(said), self._picture())

    @abstractmethod
    def _form(self) -> str:
        """What kind of function the model is, in words."""

    @abstractmethod
    def _picture(self) -> str:
        """A small picture of the model, as SVG."""

    def _lines(self) -> list[Floats]:
        """Lines of a grid over the bounding box of the domain, (k, 2)."""
        low, high = self.domain.min(axis=0), self.domain.max(axis=0)
        x, y = (np.linspace(low[k], high[k], _GRID_SAMPLES) for k in (0, 1))
        some = slice(None, None, _GRID_EVERY)
        upright = [np.column_stack([np.full_like(y, at), y]) for at in x[some]]
        return upright + [np.column_stack([x, np.full_like(x, at)]) for at in y[some]]

    def _description(self) -> str:
        smoothing = f", smoothing {self.smoothing:.3g}" if self.smoothing else ""
        return f"{self.lifting.name}, {len(self.control_points)} control points{smoothing}"

    @property
    def control_points(self) -> Floats:
        """Control points, (l, 2), in the unit of the points."""
        return self.lifting.control_points

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model to a file for `mexpress.load`.

        Parameters
        ----------
        path : str or path
            Name of the file; no ending is added.

        Examples
        --------
        >>> import mexpress as mx
        >>> import tempfile
        >>> square = [[0, 0], [2, 0], [0, 2], [2, 2]]
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     mx.fit_surface(square, [0, 2, 2, 5], square).save(f"{folder}/surface.npz")
        ...     mx.load(f"{folder}/surface.npz")
        Surface(depth, tps, 4 control points)
        """
        files.save(self, path)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that describe the model, by name.

        Examples
        --------
        >>> import mexpress as mx
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> arrays = mx.fit_warp(square, square, square[:3]).to_arrays()
        >>> list(arrays)[:5]
        ['lifting', 'control_points', 'parameters', 'domain', 'smoothing']
        >>> list(arrays)[5:]
        ['points', 'values', 'over_data']
        """
        return {
            "lifting": np.array(self.lifting.name),
            "control_points": self.control_points,
            "parameters": self.parameters,
            "domain": self.domain,
            "smoothing": np.array(self.smoothing),
            **({} if self.data is None else self.data.to_arrays()),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Rebuild a model from the arrays of `to_arrays`.

        Parameters
        ----------
        arrays : mapping of str to ndarray
            The result of `to_arrays`; other names are ignored.

        Examples
        --------
        >>> import mexpress as mx
        >>> square = [[0, 0], [100, 0], [0, 100], [100, 100]]
        >>> mx.Warp.from_arrays(mx.fit_warp(square, square, square[:3]).to_arrays())
        Warp(fractional tps, 3 control points)
        """
        lifting = make_lifting(str(arrays["lifting"]), arrays["control_points"])
        smoothing, data = float(arrays["smoothing"]), Observations.from_arrays(arrays)
        return cls(lifting, arrays["parameters"], arrays["domain"], smoothing, data)


def row_by_row(
    points: Floats, function: Callable[[Floats], NDArray[Any]], unknown: float | bool = np.nan
) -> NDArray[Any]:
    """Return a function's values at points (k, 2), row by row; `unknown` where a position is NaN.

    Examples
    --------
    >>> row_by_row(np.array([[3.0, 4.0], [np.nan, 4.0]]), lambda points: np.hypot(*points.T))
    array([ 5., nan])
    """
    known = ~np.isnan(points).any(axis=1)
    if known.all():
        return function(points)
    values = function(points[known])
    everywhere = np.full((len(points), *values.shape[1:]), unknown, dtype=values.dtype)
    everywhere[known] = values
    return everywhere


def nearest_constant(numerators: Floats, denominators: Floats) -> Floats:
    """Return the constants c, (d,), for which numerators (l, d) are closest to c times denominators (l, 1).

    Far from zero a model is evaluated without its constant part, which is then added: it would take the digits of the
    rest.

    Examples
    --------
    >>> nearest_constant(np.array([[5.0, 1.0], [7.0, 1.0]]), np.ones((2, 1))).round(9)
    array([6., 1.])
    """
    return np.asarray(np.linalg.lstsq(denominators, numerators, rcond=None)[0][0])
