"""The selection of a surface."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Self

from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.geometry import lengths_of
from mexpress.liftings import Lifting, PiecewiseAffine, ThinPlateSpline, lifting_named
from mexpress.models import CardinalBasis, Design, Surface
from mexpress.placement import farthest_order, residual_order
from mexpress.progress import Show, shown
from mexpress.schemes import Scheme
from mexpress.selection import rivals, saved
from mexpress.selection.candidates import Candidates, CriteriaRequest, checked_placement
from mexpress.selection.data import Samples, present
from mexpress.selection.defaults import is_automatic, surface_defaults
from mexpress.selection.fitted import FittedSelection, select_of
from mexpress.selection.incomplete import RAISE
from mexpress.selection.queries import Queries

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class SurfaceSelection(FittedSelection[Surface]):
    """A surface as complex as a criterion selects; see `Selection` for the other fields.

    Parameters
    ----------
    data : Samples
        The data as they were given.
    left_out : (k,) int64 array
        Indices of the data that `robust` left out as wrong, increasing.
    surface : Surface
        The selected surface.
    control_points : (l, 2) array
        Control points of the largest model, in their order. A model of k control points has the first k, unless each
        count has its own.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> points = np.random.default_rng(0).uniform(0, 1, (200, 2))
    >>> selection = mx.select_surface(points, np.sin(6 * points[:, 0]))
    >>> selection.surface
    Surface(depth, tps, 200 control points, smoothing 4.73e-06)
    >>> figure = selection.plot()  # of matplotlib
    """

    data: Samples
    surface: Surface
    control_points: Floats
    kind: ClassVar[str] = "surface selection"
    _most_flexible_count: ClassVar[int] = 100

    @property
    def points(self) -> Floats:
        """Positions of the data, (n, 2)."""
        return self.data.points

    @property
    def values(self) -> Floats:
        """Depths, (n,), or positions in d dimensions, (n, d)."""
        return self.data.values

    @property
    def _model(self) -> Surface:
        return self.surface

    @property
    def _models(self) -> dict[int, Surface]:
        return {len(self.surface.control_points): self.surface}

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays that describe the selection, by name."""
        return {**super().to_arrays(), "control_points": self.control_points}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Rebuild a selection from the arrays of `to_arrays`; other names are ignored."""
        data = Samples.from_arrays(arrays)
        fields = saved.fields_of(arrays, data, SurfaceQuestion.of)
        (surface,) = saved.models_of(arrays, Surface, data, fields["left_out"]).values()
        control_points = check.points(arrays["control_points"], "control_points")
        return cls(**fields, surface=surface, control_points=control_points)._whole()

    def _design(self, basis: CardinalBasis) -> Design[Surface]:
        data: Samples = self._kept_data
        return data.design(basis)

    def report(
        self,
        path: str | os.PathLike[str],
        *,
        image_size: tuple[float, float] | None = None,
        unit: str | None = None,
        command: str | None = None,
    ) -> None:
        """Write a page on the selection: one HTML file, which needs nothing from elsewhere.

        The notes come first, then what was asked, all scores as curves that answer the pointer, the surface in space to
        be turned, residuals, the error to expect, what each criterion selects, data to look at, how to make it again,
        and versions.

        Parameters
        ----------
        path : str or path
            Name of the file; no ending is added.
        image_size : (width, height), optional
            Of the depth map in pixels, if the points are its pixels: y then points down.
        unit : str, optional
            Of the values.
        command : str, optional
            What was typed to make the selection, to be shown.

        Raises
        ------
        ValueError, TypeError
            If the image's size is no size, or the unit or the command no text.
        OSError
            If the file cannot be written; an existing file is then unchanged.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> import pathlib, tempfile
        >>> points = np.random.default_rng(0).uniform(0, 1, (60, 2))
        >>> selection = mx.select_surface(points, np.sin(6 * points[:, 0]))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     selection.report(f"{folder}/report.html", unit="m")
        ...     pathlib.Path(f"{folder}/report.html").read_text()[:15]
        '<!DOCTYPE html>'
        """
        from mexpress.report import surface_figures  # noqa: PLC0415 - what few need

        y_down = check.image_size(image_size) is not None
        check.text(unit, "unit")
        figures = surface_figures(
            self.surface,
            self.points,
            self.values,
            self.kept,
            self.left_out,
            names=self.axes or (("x (pixels)", "y") if y_down else ("x", "y")),
            y_down=y_down,
            unit=unit or "unit of the data",
        )
        residuals = lengths_of((self.values - self.surface(self.points)).reshape(len(self.points), -1))
        self._report(path, figures, residuals, unit, None, command)

    def plot_surface(
        self,
        path: str | os.PathLike[str] | None = None,
        *,
        ax: Axes | None = None,
        image_size: tuple[float, float] | None = None,
        unit: str | None = None,
    ) -> Figure:
        """Plot the selected surface with the data of its fit, as maps and in space (extra ``plot``).

        Parameters
        ----------
        path : path, optional
            File for the figure; its ending gives the format.
        ax : matplotlib.axes.Axes, optional
            Where to draw one panel alone, in place of a figure of its own: the surface in space in axes made with
            ``projection="3d"``, a depth's map in others.
        image_size : (width, height), optional
            Of the depth map in pixels, if the points are its pixels: y then points down.
        unit : str, optional
            Of the values.

        Returns
        -------
        matplotlib.figure.Figure
            That of `ax`, or a new one, which notebooks show.
        """
        from mexpress.plotting import plot_surface  # noqa: PLC0415 - an extra

        points, values = self.points[self.kept], self.values[self.kept]
        return plot_surface(self.surface, points, values, path, ax=ax, image_size=image_size, unit=unit)

    def plot_residuals(
        self,
        path: str | os.PathLike[str] | None = None,
        *,
        ax: Axes | None = None,
        image_size: tuple[float, float] | None = None,
        unit: str | None = None,
    ) -> Figure:
        """Plot the residuals of the selected surface where the data are (extra ``plot``).

        Parameters
        ----------
        path : path, optional
            File for the figure; its ending gives the format.
        ax : matplotlib.axes.Axes, optional
            Where to draw, in place of a figure of its own.
        image_size : (width, height), optional
            Of the depth map in pixels, if the points are its pixels: y then points down.
        unit : str, optional
            Of the values.

        Returns
        -------
        matplotlib.figure.Figure
            That of `ax`, or a new one, which notebooks show.
        """
        from mexpress.plotting import plot_residuals  # noqa: PLC0415 - an extra

        look: dict[str, Any] = {"ax": ax, "image_size": image_size, "unit": unit}
        return plot_residuals(self.surface, self.points, self.values, path, **look, aside=self._aside())

    def plot_control_points(
        self,
        path: str | os.PathLike[str] | None = None,
        *,
        ax: Axes | None = None,
        image_size: tuple[float, float] | None = None,
        unit: str | None = None,
    ) -> Figure:
        """Plot the control points over the data (extra ``plot``).

        Parameters
        ----------
        path : path, optional
            File for the figure; its ending gives the format.
        ax : matplotlib.axes.Axes, optional
            Where to draw, in place of a figure of its own.
        image_size : (width, height), optional
            Of the depth map in pixels, if the points are its pixels: y then points down.
        unit : str, optional
            Of the values.

        Returns
        -------
        matplotlib.figure.Figure
            That of `ax`, or a new one, which notebooks show.
        """
        from mexpress.plotting import plot_control_points  # noqa: PLC0415 - an extra

        return plot_control_points(self, path, ax=ax, image_size=image_size, unit=unit)


def select_surface(
    points: ArrayLike,
    values: ArrayLike,
    criterion: str | None = None,
    criteria: Sequence[str] | Mapping[str, Scheme] | None = None,
    max_count: int | None = None,
    min_distance: float | None = None,
    smoothing: float | ArrayLike | str = "auto",
    seed: int = 0,
    threads: int | None = None,
    progress: bool | Callable[..., Any] = False,
    lifting: str = "tps",
    placement: str | None = None,
    *,
    weights: ArrayLike | None = None,
    robust: bool = False,
    queries: ArrayLike | str | None = None,
    missing: str = RAISE,
) -> SurfaceSelection:
    """Fit a surface to data, as complex as predicts held-out data best.

    By default twenty weights of the bending energy compete, from an all but interpolating surface to a plane: the best
    prediction. ``smoothing=0`` is the method of the paper, where the number of control points alone makes a surface
    complex: the next control point is always the datum farthest from the surface so far (its section 5.1). The models
    are then nested, and a criterion's whole curve costs as much as one model. See `mexpress.selection.defaults` for
    what else that changes.

    Parameters
    ----------
    points : (n, 2) array
        Positions of the data: pixels of a depth map, or parameters of a sheet. Degrees of longitude and latitude are
        to be projected first: a note of the result says so if a frame's columns are called lon and lat.
    values : (n,) or (n, d) array
        Depths, or positions in d dimensions.
    criterion : str, optional
        Criterion that selects, see `mexpress.criteria`; ERxx is a percentage of the diagonal of the points' bounding
        box. MATCHED by default: it matches the distances from predictions to training data to those in use. Where
        neighbouring data share their noise, take ER10. With `smoothing` 0 or given weights, ER10 by default, as the
        paper advises: it predicts every datum with all data within 10 % of the diagonal held out. No radius is right
        for every use, so compare several.
    criteria : sequence of str, or mapping of str to Scheme, optional
        Further criteria to compute; FIT, PRESS and CMPRESS by default. A mapping gives schemes by names that no
        criterion has. If the criterion is one of these names, only the schemes are computed, else also the three.
    max_count : int, optional
        Largest number of control points: the number of data by default, at most 900. With `smoothing` 0 or given
        weights, 175.
    min_distance : float, optional
        Smallest distance of control points with "residual" placement, in the unit of the points; 2.5 % of the diagonal
        by default, see `mexpress.placement.by_residual`. An error with another placement.
    smoothing : float, list of float or "auto", default "auto"
        Weight of the bending energy, which is added to the sum of squared residuals. A larger weight gives a stiffer
        surface, in the limit a plane. Of several weights, the best is selected together with the count. "auto" tries
        twenty, from negligible to dominant, for the smallest and for the largest count.
    seed : int, default 0
        Seed of everything random. The same seed gives the same result with any number of threads.
    threads : int, optional
        Largest number of threads; MEXPRESS_NUM_THREADS or all cores by default.
    progress : bool or callable, default False
        Whether to show progress on the terminal; or what makes a bar, such as ``tqdm.tqdm``. It is called with
        ``total`` and ``desc``, the number of steps and what they are. What it returns has ``update(1)`` called after
        each step, and ``close()`` at the end. What they raise ends the work.
    lifting : str, default "tps"
        Name of the lifting: "tps", "bspline", "affine", or a registered name, see `mexpress.liftings`.
    placement : {"residual", "nested", "lloyd"}, optional
        Placement of control points. "residual": the datum farthest from the surface so far is the next one. "nested":
        the next one is always the datum farthest from the control points so far, which spreads them evenly at every
        count. Both are for thin-plate splines only. "lloyd": separately for every count, over the region of the data,
        by Lloyd's algorithm or on the lifting's grid. The default is "nested" for thin-plate splines ("residual" with
        `smoothing` 0 or given weights), and "lloyd" for other liftings.
    weights : (n,) array, optional
        Weight of every datum, in the fit and in the scores, such as one over the square of its standard deviation. A
        datum of weight 0 is absent. 1 each by default. "residual" placement does not know them.
    robust : bool, default False
        Whether to find wrong data and leave them out: those that the selection without them contradicts, see
        `mexpress.selection.robust`. It costs two to six selections. Those left out are `left_out` of the result.
    queries : (q, 2) array, or (left, top, right, bottom), optional
        Where the surface will be used: positions, or all over a rectangle. If they are far from the data, models are
        judged by predictions as far from their training data as the queries are from the data, and piecewise affine
        surfaces compete. Between the data by default.
    missing : {"raise", "drop"}, default "raise"
        Whether rows with something missing, which is masked, NaN or infinite, are an error, or dropped. Those dropped
        have weight 0: indices in the result are of all rows that were given.

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
    >>> selection = mx.select_surface(points[:200], depth[:200])
    >>> selection.maps["MATCHED"].shape, 3 < selection.effective_parameters < 200
    ((2, 20), True)
    >>> selection.surface([[320, 320]]).shape
    (1,)
    >>> paper = mx.select_surface(points, depth, criterion="ER05", smoothing=0, max_count=60)
    >>> paper.selected["FIT"], 10 <= paper.count < 60
    (60, True)
    """
    data = Samples.of(points, values, weights, missing)
    check.flag(robust, "robust")
    question = SurfaceQuestion.of(
        data, criterion, lifting, max_count, min_distance, placement, smoothing, queries, seed, threads
    )
    found = select_of(data, question, criteria, robust, shown(progress, "surface"))
    return replace(found, axes=check.axes_of(points))


@dataclass(frozen=True, eq=False)
class SurfaceQuestion:
    """What `select_surface` is asked of data, checked, whichever of the data remain."""

    criterion: str
    lifting: type[Lifting]
    max_count: int | None
    min_distance: float | None
    placement: str
    smoothing: float | ArrayLike | str
    queries: ArrayLike | str | None
    seed: Any
    threads: int | None

    @classmethod
    def of(
        cls,
        data: Samples,
        criterion: str | None,
        lifting: str,
        max_count: int | None,
        min_distance: float | None,
        placement: str | None,
        smoothing: float | ArrayLike | str,
        queries: ArrayLike | str | None,
        seed: Any,
        threads: int | None = None,
    ) -> SurfaceQuestion:
        """Check what `select_surface` is asked of data."""
        functions = lifting_named(lifting)
        usual = surface_defaults(len(present(data)), smoothing)
        choices = "residual", "nested", "lloyd"
        spread = checked_placement(placement, functions, choices, usual.placement)
        if min_distance is not None and spread != "residual":
            rule = 'It applies to placement="residual" alone, which must then be given, or smoothing=0.'
            check.refuse("min_distance", rule, f'{check.describe(min_distance)} with placement "{spread}"')
        largest = None if max_count is None else check.count(max_count, "max_count", 3)
        chosen = usual.criterion if criterion is None else criterion
        return cls(chosen, functions, largest, min_distance, spread, smoothing, queries, seed, threads)

    def select(
        self, data: Samples, criteria: Sequence[str] | Mapping[str, Scheme] | None, show: Show
    ) -> SurfaceSelection:
        """Select a surface for data."""
        queries = None if self.queries is None else Queries.of(self.queries, data, self.seed)
        request = CriteriaRequest(self.criterion, criteria, data, self.seed, self.threads, queries)
        splines, automatic = self.lifting is ThinPlateSpline, is_automatic(self.smoothing)
        free = automatic and self.max_count is None
        plain = {} if splines or not free else {"plane": rivals.plain_map(data.design, data)}
        bridges = free and splines and request.far
        bridge = self._candidates(data, PiecewiseAffine, "lloyd") if bridges else None
        grid = self._candidates(data, self.lifting, self.placement)
        outcome = rivals.select(grid, plain, bridge, request, show)
        ordered = outcome.ordered if outcome.selection.rival is None else None
        return SurfaceSelection(
            **vars(outcome.selection),
            data=data,
            surface=outcome.model,
            control_points=outcome.model.control_points if ordered is None else ordered,
            question=self,
        )

    def _candidates(self, data: Samples, lifting: type[Lifting], placement: str) -> Candidates[Surface]:
        orders = {
            "residual": partial(
                residual_order,
                data.points,
                data.values,
                min_distance=self.min_distance,
                seed=self.seed,
                threads=self.threads,
            ),
            "nested": partial(farthest_order, data.points),
        }
        n = len(data.points)
        largest = surface_defaults(n, self.smoothing).largest if self.max_count is None else self.max_count
        order = orders.get(placement)
        return Candidates(lifting, data.design, None, min(largest, n), order, self.smoothing, placed=True)
