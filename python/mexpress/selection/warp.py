"""The selection of a warp."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mexpress import _validation as check
from mexpress._validation import Floats, Integers
from mexpress.liftings import Lifting, PiecewiseAffine, ThinPlateSpline, lifting_named
from mexpress.models import CardinalBasis, Design, Warp
from mexpress.placement import farthest_order
from mexpress.progress import Show, shown
from mexpress.schemes import Scheme
from mexpress.selection import rivals, saved
from mexpress.selection.candidates import Candidates, CriteriaRequest, checked_counts, checked_placement
from mexpress.selection.data import Matches, present
from mexpress.selection.defaults import is_automatic, warp_defaults
from mexpress.selection.fitted import FittedSelection, select_of
from mexpress.selection.incomplete import RAISE
from mexpress.selection.queries import Queries
from mexpress.selection.weights import several_weights

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class WarpSelection(FittedSelection[Warp]):
    """A warp as complex as a criterion selects; see `Selection` for the other fields.

    Parameters
    ----------
    data : Matches
        The matches as they were given.
    left_out : (k,) int64 array
        Indices of the matches that `robust` left out as wrong, increasing.
    warps : dict of int to Warp
        The warp of every count that the data determine, at the criterion's best weight for the count; among them the
        selected one.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> source = rng.uniform(0, 100, (20, 2))
    >>> selection = mx.select_warp(source, 2 * source + rng.normal(size=source.shape))
    >>> selection.rival, selection.warp
    ('affine map', Warp(tps, 3 control points))
    >>> figure = selection.plot()  # of matplotlib
    """

    data: Matches
    warps: dict[int, Warp]
    kind: ClassVar[str] = "warp selection"
    _unit: ClassVar[str | None] = "pixels of the target image"
    _most_flexible_count: ClassVar[int] = 30

    @property
    def warp(self) -> Warp:
        """The selected warp."""
        return self.warps[self.count]

    @property
    def source(self) -> Floats:
        """The matches in the source image, (n, 2), in pixels."""
        return self.data.source

    @property
    def target(self) -> Floats:
        """The matches in the target image, (n, 2), in pixels."""
        return self.data.target

    @property
    def image_size(self) -> tuple[float, float] | None:
        """(width, height) of the source image in pixels, if it is known."""
        return self.data.image_size

    @property
    def _model(self) -> Warp:
        return self.warp

    @property
    def _models(self) -> dict[int, Warp]:
        return self.warps

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Rebuild a selection from the arrays of `to_arrays`; other names are ignored."""
        matches = Matches.from_arrays(arrays)
        fields = saved.fields_of(arrays, matches, WarpQuestion.of)
        return cls(**fields, warps=saved.models_of(arrays, Warp, matches, fields["left_out"]))._whole()

    def _design(self, basis: CardinalBasis) -> Design[Warp]:
        matches: Matches = self._kept_data
        return matches.design(basis, self.warp.fractional, _over_data(self.placement))

    def report(
        self,
        path: str | os.PathLike[str],
        source_image: ArrayLike | None = None,
        target_image: ArrayLike | None = None,
        *,
        command: str | None = None,
    ) -> None:
        """Write a page on the selection: one HTML file, which needs nothing from elsewhere.

        The notes come first, then what was asked, all scores as curves that answer the pointer, displacements, errors
        at the matches, the error to expect, what each criterion selects, matches to look at, how to make it again, and
        versions. With both images, they are compared under a slider, before and after the warp (extra ``image``).

        Parameters
        ----------
        path : str or path
            Name of the file; no ending is added.
        source_image, target_image : array_like, (height, width) or (height, width, 3 or 4), optional
            Both or none, as for `plot_registration`.
        command : str, optional
            What was typed to make the selection, to be shown.

        Raises
        ------
        ValueError, TypeError
            If one of the images is missing, or is no image, or the command is no text.
        ImportError
            If there are images, and Pillow is not installed.
        OSError
            If the file cannot be written; an existing file is then unchanged.

        Examples
        --------
        >>> import mexpress as mx
        >>> import numpy as np
        >>> import pathlib, tempfile
        >>> source = np.random.default_rng(0).uniform(0, 100, (40, 2))
        >>> selection = mx.select_warp(source, source + np.sin(source / 30))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     selection.report(f"{folder}/report.html")
        ...     pathlib.Path(f"{folder}/report.html").read_text()[:15]
        '<!DOCTYPE html>'
        """
        from mexpress.report import warp_figures  # noqa: PLC0415 - what few need

        images = None
        if source_image is not None and target_image is not None:
            images = source_image, target_image
        elif source_image is not None or target_image is not None:
            missing = "source_image" if source_image is None else "target_image"
            check.refuse(missing, "Both images must be given, or none.", "none")
        figures = warp_figures(self.warp, self.source, self.target, self.kept, self.left_out, images)
        residuals = self.warp.residuals(self.source, self.target)
        self._report(path, figures, residuals, "pixels", self.image_size, command)

    def plot_warp(self, path: str | os.PathLike[str] | None = None, *, ax: Axes | None = None) -> Figure:
        """Plot how far the selected warp moves points, how it bends a grid, and its errors (extra ``plot``).

        Parameters
        ----------
        path : path, optional
            File for the figure; its ending gives the format.
        ax : matplotlib.axes.Axes, optional
            Where to draw the warped grid and the errors alone, in place of a figure of its own.

        Returns
        -------
        matplotlib.figure.Figure
            That of `ax`, or a new one, which notebooks show.
        """
        from mexpress.plotting import plot_warp  # noqa: PLC0415 - an extra

        return plot_warp(self.warp, self.source, self.target, path, ax=ax, aside=self._aside())

    def plot_registration(
        self,
        source_image: ArrayLike,
        target_image: ArrayLike,
        path: str | os.PathLike[str] | None = None,
        *,
        ax: Axes | None = None,
    ) -> Figure:
        """Plot how well the selected warp registers two images, in the frame of the source image (extra ``plot``).

        Parameters
        ----------
        source_image, target_image : array_like, (height, width) or (height, width, 3 or 4)
            Gray or colour; integers, or floating point numbers, which are stretched to their range if they are not
            from 0 to 1.
        path : path, optional
            File for the figure; its ending gives the format.
        ax : matplotlib.axes.Axes, optional
            Where to draw one image over the other alone, in place of a figure of its own.

        Returns
        -------
        matplotlib.figure.Figure
            That of `ax`, or a new one, which notebooks show.
        """
        from mexpress.plotting import plot_registration  # noqa: PLC0415 - an extra

        images, aside = (source_image, target_image), self._aside()
        return plot_registration(self.warp, *images, self.source, self.target, path=path, ax=ax, aside=aside)


def select_warp(
    source: ArrayLike,
    target: ArrayLike,
    criterion: str | None = None,
    criteria: Sequence[str] | Mapping[str, Scheme] | None = None,
    lifting: str = "tps",
    fractional: bool = True,
    counts: ArrayLike | None = None,
    placement: str | None = None,
    smoothing: float | ArrayLike | str = "auto",
    image_size: tuple[float, float] | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: bool | Callable[..., Any] = False,
    *,
    weights: ArrayLike | None = None,
    robust: bool = False,
    queries: ArrayLike | str | None = None,
    missing: str = RAISE,
) -> WarpSelection:
    """Fit a warp to point matches, as complex as predicts held-out matches best.

    By default twenty weights of the bending energy compete, from an all but interpolating warp to a homography, and an
    affine map: the best prediction. ``smoothing=0`` is the method of the paper, where the number of control points
    alone makes a warp complex; see `mexpress.selection.defaults` for what else that changes.

    Parameters
    ----------
    source, target : (n, 2) array
        Matches, x then y, in pixels of either image; with `robust`, also wrong ones.
    criterion : str, optional
        Criterion that selects, see `mexpress.criteria`. MATCHED by default: it matches the distances from predictions
        to training data to those in use. Where neighbouring matches share their noise, take ER10. With `smoothing` 0
        or given weights, ER10 by default, as the paper advises: it predicts every match with all matches within 10 % of
        the diagonal held out. No radius is right for every use, so compare several.
    criteria : sequence of str, or mapping of str to Scheme, optional
        Further criteria to compute; FIT, PRESS and CMPRESS by default. A mapping gives schemes by names that no
        criterion has. If the criterion is one of these names, only the schemes are computed, else also the three.
    lifting : str, default "tps"
        Name of the lifting: "tps", "bspline", "affine", or a registered name, see `mexpress.liftings`.
    fractional : bool, default True
        Whether the warp models perspective.
    counts : sequence of int, optional
        Numbers of control points to try. By default only 3 and the number of matches, at most 300 (250 for more than
        1,000 matches, 900 without perspective): the weight controls the flexibility, and the choice among fewer models
        is less random. With `smoothing` 0 or given weights, 3 to half the number of matches, at most 100.
    placement : {"lloyd", "nested"}, optional
        Placement of control points. "lloyd": separately for every count, over the region that the source points
        cover, by Lloyd's algorithm ("bspline" and "affine" have grids instead). "nested", for thin-plate splines
        only: the next control point is always the source point farthest from those so far, so the models are nested
        and all counts are scored at once. The default is "nested" with several weights, "lloyd" with one.
    smoothing : float, list of float or "auto", default "auto"
        Weight of the bending energy, which is added to the sum of squared residuals. A larger weight gives a stiffer
        warp, in the limit an affine map or a homography. Of several weights, the best is selected together with the
        count. "auto" tries twenty, from negligible to dominant.
    image_size : (width, height), optional
        Size of the source image in pixels; ERxx is a percentage of its diagonal. The source points' bounding box by
        default.
    seed : int, default 0
        Seed of everything random. The same seed gives the same result with any number of threads.
    threads : int, optional
        Largest number of threads; MEXPRESS_NUM_THREADS or all cores by default.
    progress : bool or callable, default False
        Whether to show progress on the terminal; or what makes a bar, such as ``tqdm.tqdm``. It is called with
        ``total`` and ``desc``, the number of steps and what they are. What it returns has ``update(1)`` called after
        each step, and ``close()`` at the end. What they raise ends the work.
    weights : (n,) array, optional
        Weight of every match, in the fit and in the scores, such as a match's confidence, or one over the square of
        its standard deviation. A match of weight 0 is absent. 1 each by default.
    robust : bool, default False
        Whether to find wrong matches and leave them out: those that the selection without them contradicts, see
        `mexpress.selection.robust`. It costs two to six selections. Those left out are `left_out` of the result.
    queries : (q, 2) array, (left, top, right, bottom), or "image", optional
        Where the warp will be used: positions in pixels of the source image, all over a rectangle, or all over the
        image of `image_size`. If they are far from the matches, models are judged by predictions as far from their
        training data as the queries are from the matches, and piecewise affine warps compete. Between the matches by
        default.
    missing : {"raise", "drop"}, default "raise"
        Whether rows with something missing, which is masked, NaN or infinite, are an error, or dropped. Those dropped
        have weight 0: indices in the result are of all rows that were given.

    Returns
    -------
    WarpSelection
        The warp, the curves, and the model that every criterion selects.

    Raises
    ------
    ValueError, TypeError
        If the matches are not finite or do not cover a region, or if the criterion is undefined at every count.

    Examples
    --------
    >>> import mexpress as mx
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> source = rng.uniform(0, 640, (60, 2))
    >>> bend = np.column_stack([0 * source[:, 0], 8 * np.sin(source[:, 0] / 100)])
    >>> target = 1.2 * source + bend + rng.normal(0, 0.5, source.shape)
    >>> selection = mx.select_warp(source, target)
    >>> selection.maps["MATCHED"].shape, 8 < selection.effective_parameters < 179
    ((2, 20), True)
    >>> paper = mx.select_warp(source, target, criterion="ER05", smoothing=0, counts=range(3, 20))
    >>> paper.selected["FIT"], 6 <= paper.count < 19
    (18, True)
    >>> selection.warp([[320, 320]]).shape
    (1, 2)
    """
    matches = Matches.of(source, target, image_size, weights, missing)
    check.flag(robust, "robust")
    question = WarpQuestion.of(
        matches, criterion, lifting, fractional, counts, placement, smoothing, queries, seed, threads
    )
    return select_of(matches, question, criteria, robust, shown(progress, "warp"))


@dataclass(frozen=True, eq=False)
class WarpQuestion:
    """What `select_warp` is asked of matches, checked, whichever of the matches remain."""

    criterion: str
    lifting: type[Lifting]
    fractional: bool
    counts: Integers | None
    placement: str
    smoothing: float | ArrayLike | str
    queries: ArrayLike | str | None
    seed: Any
    threads: int | None

    @classmethod
    def of(
        cls,
        matches: Matches,
        criterion: str | None,
        lifting: str,
        fractional: bool,
        counts: ArrayLike | None,
        placement: str | None,
        smoothing: float | ArrayLike | str,
        queries: ArrayLike | str | None,
        seed: Any,
        threads: int | None = None,
    ) -> WarpQuestion:
        """Check what `select_warp` is asked of matches."""
        wished = checked_counts(counts, len(matches.source), "matches")
        check.flag(fractional, "fractional")
        functions = lifting_named(lifting)
        several = several_weights(smoothing)
        usual = warp_defaults(len(present(matches)), smoothing, fractional, several)
        spread = checked_placement(placement, functions, ("lloyd", "nested"), usual.placement)
        chosen = usual.criterion if criterion is None else criterion
        return cls(chosen, functions, fractional, wished, spread, smoothing, queries, seed, threads)

    def select(
        self, matches: Matches, criteria: Sequence[str] | Mapping[str, Scheme] | None, show: Show
    ) -> WarpSelection:
        """Select a warp for matches."""
        n = len(matches.source)
        if self.counts is None and n < 4:
            rule = "There must be four matches at least, not counting those that are dropped or of weight 0."
            check.refuse("source", rule, f"{n}")
        queries = None if self.queries is None else Queries.of(self.queries, matches, self.seed)
        request = CriteriaRequest(self.criterion, criteria, matches, self.seed, self.threads, queries)
        plain = self._plain(matches) if self._automatic else {}
        bridge = self._candidates(matches, PiecewiseAffine, "lloyd") if self._bridges(request) else None
        grid = self._candidates(matches, self.lifting, self.placement)
        outcome = rivals.select(grid, plain, bridge, request, show)
        warps = outcome.sweep.best_models(outcome.selection)
        warps[outcome.selection.count] = outcome.model
        return WarpSelection(**vars(outcome.selection), data=matches, warps=warps, question=self)

    @property
    def _automatic(self) -> bool:
        return is_automatic(self.smoothing) and self.counts is None

    def _bridges(self, request: CriteriaRequest) -> bool:
        return self._automatic and request.far and self.lifting is ThinPlateSpline

    def _candidates(self, matches: Matches, lifting: type[Lifting], placement: str) -> Candidates[Warp]:
        n = len(matches.source)
        usual = warp_defaults(n, self.smoothing, self.fractional)
        return Candidates(
            lifting,
            partial(matches.design, fractional=self.fractional, over_data=_over_data(placement)),
            None if self.counts is None else np.unique(np.minimum(self.counts, n)),
            usual.largest,
            partial(farthest_order, matches.source) if placement == "nested" else None,
            self.smoothing,
        )

    def _plain(self, matches: Matches) -> dict[str, Candidates[Warp]]:
        """Plain maps that are not in the grid: a thin-plate spline of three control points is one."""
        forms = {"affine map": False} | ({"homography": True} if self.fractional else {})
        in_grid = self.fractional if self.lifting is ThinPlateSpline else None
        return {
            name: rivals.plain_map(partial(matches.design, fractional=form), matches)
            for name, form in forms.items()
            if form != in_grid
        }


def _over_data(placement: str) -> bool | None:
    """Whether denominators have mean one over the data, as nested models need it; None for the lifting's default."""
    return True if placement == "nested" else None
