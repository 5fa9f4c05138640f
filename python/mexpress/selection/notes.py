"""What a careful colleague would point out about a selection: sentences with their numbers and what to do.

An argument to change is written as Python has it, ``smoothing="auto"`` or ``max_count=N``, which the command line
translates into options. What is normal is no note: that smoothing determines unknowns which the data leave open, or
that a plain map is the stiffest model.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from mexpress._validation import Floats
from mexpress.caching import cached_property
from mexpress.criteria import WITHOUT_HOLDING_OUT, family, parse
from mexpress.geometry import diagonal, lattice, lengths_of
from mexpress.io.tables import plain
from mexpress.leastsquares.model import LeastSquares, datum_of_row
from mexpress.models import Model, Warp
from mexpress.schemes import Places
from mexpress.selection.data import Data, Matches, is_speck
from mexpress.selection.selection import Selection
from mexpress.suspicion import deviation

_APART, _WORSE = 2.0, 1.2
"""Criteria disagree if one selects twice the parameters of the other, and finds the other's model 20 % worse."""

_TOO_STIFF = 3.0
"""Residuals are far above the noise if their median is three times that of neighbours' differences."""

_HEAVY, _ALONE, _ENERGY = 2.5, 2.0, 0.4
"""Data look wrong if the RMS residual is 2.5 times the median (1.2 to 1.5 under Gaussian noise), and 40 % of the sum of
squares is of data whose residuals are 5 robust standard deviations and twice those of all neighbours: at the edges of a
depth map, neighbours have large ones too."""

_FLEXIBLE = 0.1
"""A model with fewer parameters than this share of the values does not follow single data."""

_NEIGHBOURS = 5
_FEWEST = 20
"""Fewer data say little of their noise."""

_ROUNDING = 1e-7
"""Smaller residuals, as a fraction of the values' spread, are of rounding."""

_MARGIN = 0.01
"""Points outside of the image by less than this share of its longer side are there by noise."""

_SAMPLES = 4000
"""Points at which a warp is searched for folds."""

_INTERPOLATES, _PLAIN = 0.95, 1.1

_LONGITUDE = {"lon", "long", "lng", "longitude"}
_LATITUDE = {"lat", "latitude"}
_UNEQUAL = 0.95
"""Degrees of longitude are shorter than those of latitude if, somewhere, their ratio is less: beyond 18 degrees."""


@dataclass(frozen=True)
class Subject:
    """A selection with what notes need to know of it.

    Parameters
    ----------
    scores : Selection
        The scores of all models.
    data : Matches or Samples
        The data of the fit.
    model : Warp or Surface
        The selected model.
    placement : str
        Placement of its control points.
    searched : bool
        Whether wrong data have been searched for.
    least_squares : callable
        Returns the least-squares problem of the model.
    axes : (str, str), optional
        What x and y of the points are called.
    """

    scores: Selection
    data: Data
    model: Model
    placement: str
    searched: bool
    least_squares: Callable[[], LeastSquares]
    axes: tuple[str, str] | None = None

    @cached_property
    def residuals(self) -> Floats:
        """Values minus predictions, (n, d); NaN where the model has no finite value."""
        with np.errstate(all="ignore"):
            residuals = self.data.values - self.model(self.data.points)
        table = residuals.reshape(len(residuals), -1)
        return np.where(np.isfinite(table), table, np.nan)

    @cached_property
    def sizes(self) -> Floats:
        """Norms of the residuals, (n,)."""
        return lengths_of(self.residuals)

    @cached_property
    def places(self) -> int:
        """Number of different positions of the data."""
        return len(np.unique(self.data.points, axis=0))

    @cached_property
    def exact(self) -> bool:
        """Whether the residuals are of rounding, or too few are known."""
        known = np.isfinite(self.sizes)
        values = self.data.values.reshape(len(known), -1)
        spread = math.sqrt(values.shape[1]) * deviation(values)
        rounding = max(_ROUNDING * spread, 16 * float(np.spacing(np.abs(values).max())))
        return bool(known.sum() < _FEWEST or np.median(self.sizes[known]) <= rounding)

    @cached_property
    def studentised(self) -> Floats:
        """Norms of the residuals over the share of noise that a fit leaves in them, e / sqrt(1 - h), (n,).

        A flexible model follows wrong data, so that their residuals are small; but so is 1 - h there.
        """
        if not self.scores.effective_parameters > _FLEXIBLE * self.data.values.size:
            return self.sizes
        fit = self.least_squares()
        lengths = lengths_of(fit.residuals.reshape(len(fit.residuals), -1))
        lengths /= np.sqrt(np.maximum(1 - fit.leverage, np.finfo(float).eps))
        sizes = np.zeros(fit.n_data)
        np.hypot.at(sizes, datum_of_row(fit), lengths)  # squares of lengths may be no numbers
        return sizes

    @cached_property
    def lonely(self) -> Any:
        """Which data have a residual that is large, and much larger than those of their neighbours, (n,)."""
        sizes, k = np.nan_to_num(self.studentised), _NEIGHBOURS
        around = sizes[Places(self.data.points).neighbours(k)]
        second, largest = np.partition(around, -2, axis=1)[:, -2:].T
        large = sizes > 5 * 1.4826 * np.median(sizes)
        return large & (sizes == largest) & (sizes > _ALONE * second)

    @cached_property
    def looks_wrong(self) -> bool:
        """Whether a few data that stand alone make the residuals large."""
        sizes = self.studentised
        if self.exact or _rms(sizes) <= _HEAVY * np.nanmedian(sizes):
            return False
        squares = (sizes / np.nanmax(sizes)) ** 2
        return bool(squares[self.lonely].sum() > _ENERGY * np.nansum(squares))

    @cached_property
    def by_weight(self) -> bool:
        """Whether several weights of the bending energy competed."""
        return len(self.scores.weights) > 1

    @property
    def datum(self) -> str:
        """What one of the data is called."""
        return "match" if isinstance(self.data, Matches) else "datum"

    @property
    def many(self) -> str:
        """What the data are called."""
        return "matches" if isinstance(self.data, Matches) else "data"

    @property
    def shape(self) -> str:
        """What the model is called."""
        return "warp" if isinstance(self.model, Warp) else "surface"

    @property
    def unit(self) -> str:
        """The unit of errors, if it is known, after a blank."""
        return " pixels" if isinstance(self.model, Warp) else ""

    @property
    def largest(self) -> str:
        """The arguments that limit the number of control points."""
        if isinstance(self.model, Warp):
            return "counts=COUNTS"
        return "max_count=N and min_distance=D" if self.placement == "residual" else "max_count=N"


def notes(subject: Subject) -> tuple[str, ...]:
    """Return sentences on what is doubtful about a selection, in a fixed order; none if nothing is.

    Examples
    --------
    >>> import mexpress as mx
    >>> source = np.random.default_rng(0).uniform(0, 100, (40, 2))
    >>> mx.select_warp(source, 2 * source, image_size=(100, 100)).notes
    ()
    >>> mx.select_warp(source, 2 * source, image_size=(100, 50)).notes[0][:56]
    '19 of 40 source points are outside of the image of 100 x'
    """
    checks: tuple[Callable[[Subject], Iterator[str]], ...] = (
        _outside_image,
        _speck_of_image,
        _degrees,
        _wrong_data,
        _failures,
        _wide_radius,
        _disagreement,
        _stiffness,
        _end_of_trials,
        _undefined,
    )
    return tuple(note for check in checks for note in check(subject))


def failures(warp: Warp) -> tuple[float, float]:
    """Return the shares of a warp's domain where it folds, and where its denominator vanishes.

    Examples
    --------
    >>> import mexpress as mx
    >>> square = [[0, 0], [9, 0], [0, 9], [9, 9]]
    >>> failures(mx.fit_warp(square, square, square[:3]))
    (0.0, 0.0)
    """
    inside = lattice(warp.domain, _SAMPLES)
    vanishes = warp.vanishes(inside)
    return float((warp.folds(inside) & ~vanishes).mean()), float(vanishes.mean())


def _outside_image(subject: Subject) -> Iterator[str]:
    if subject.data.image_size is None:
        return
    points, (width, height) = subject.data.points, subject.data.image_size
    margin = _MARGIN * max(width, height)
    outside = int(((points < -margin) | (points > [width + margin, height + margin])).any(axis=1).sum())
    if outside:
        x, y = points.max(axis=0)
        yield (
            f"{outside} of {len(points)} source points are outside of the image of {width:g} x {height:g} pixels: the "
            f"largest x is {x:.5g}, the largest y {y:.5g}. Give points as (x, y), not (row, column), in pixels of the "
            "image of image_size=SIZE."
        )


def _speck_of_image(subject: Subject) -> Iterator[str]:
    if subject.data.image_size is not None and is_speck(subject.data):
        extent, (width, height) = diagonal(subject.data.points), subject.data.image_size
        yield (
            f"The source points extend over {extent:.3g} only, in an image of {width:g} x {height:g} pixels. Give "
            "points in pixels, not as fractions of the image, or no image_size=SIZE."
        )


def _degrees(subject: Subject) -> Iterator[str]:
    """Names alone tell degrees: pixels, metres and fractions may have the same numbers."""
    names = [plain(name) for name in subject.axes or ()]
    if not (_LONGITUDE.intersection(names) and _LATITUDE.intersection(names)):
        return
    latitude = 0 if names[0] in _LATITUDE else 1
    latitudes, longitudes = subject.data.points[:, latitude], subject.data.points[:, 1 - latitude]
    if np.abs(latitudes).max() > 90 or longitudes.min() < -180 or longitudes.max() > 360:
        return
    ratios = np.cos(np.radians(latitudes))
    if ratios.min() >= _UNEQUAL:
        return
    mean = float(latitudes.mean())
    ratio = math.cos(math.radians(mean))
    wide = ratios.max() - ratios.min() > 1 - _UNEQUAL
    span = f" ({ratios.min():.2f} to {ratios.max():.2f} over all points)" if wide else ""
    scaled = "" if wide else f"; multiplying the longitudes by {ratio:.3f} comes close"
    yield (
        f"The points are longitudes and latitudes in degrees. At their mean latitude of {mean:.3g} a degree of "
        f"longitude is {ratio:.2f} of one of latitude{span}, but counts as much in the {subject.shape} and in what is "
        f"held out. Project the points first, with pyproj for example{scaled}."
    )


def _wrong_data(subject: Subject) -> Iterator[str]:
    if subject.searched or not subject.looks_wrong:
        return
    number, sizes = int(subject.lonely.sum()), subject.studentised
    yield (
        f"Half of the studentised residuals are below {np.nanmedian(sizes):.3g}{subject.unit}, but their RMS is "
        f"{_rms(sizes):.3g}, because of {number} {subject.datum if number == 1 else subject.many} unlike "
        f"{'its' if number == 1 else 'their'} neighbours (largest {np.nanmax(sizes):.3g}): "
        "this looks like wrong data. robust=True finds and leaves out wrong data."
    )


def _rms(sizes: Floats) -> float:
    unit = float(np.nanmax(sizes)) or 1.0  # squares of sizes may be no numbers
    return unit * math.sqrt(np.nanmean((sizes / unit) ** 2))


def _failures(subject: Subject) -> Iterator[str]:
    if not isinstance(subject.model, Warp):
        return
    folded, vanishing = failures(subject.model)
    usual = [] if subject.by_weight else ['smoothing="auto"']
    usual += [] if subject.searched else ["robust=True if matches may be wrong"]
    for share, what, remedies in (
        (folded, "folds", usual),
        (vanishing, "has a denominator that vanishes", ["fractional=False", *usual]),
    ):
        if share > 0:
            advice = f" Try {', or '.join(remedies)}." if remedies else ""
            region = f"over {100 * share:.2g} % of the region of the matches"
            yield f"The warp {what} {region}: do not trust it there.{advice}"


def _wide_radius(subject: Subject) -> Iterator[str]:
    extent = diagonal(subject.data.points)
    for name in _too_wide(subject):
        radius = parse(name).amount / 100 * subject.data.diagonal
        yield (
            f"{name} holds out all {subject.many} within {radius:.4g}, but they extend over {extent:.4g} only: it "
            f"predicts from next to nothing. Take ER{10 * extent / subject.data.diagonal:.2g} or less."
        )


def _too_wide(subject: Subject) -> list[str]:
    """Radii that reach from the middle of the data over all of them."""
    limit = 50 * diagonal(subject.data.points) / subject.data.diagonal
    return [name for name in subject.scores.maps if family(name) == "ER" and parse(name).amount >= limit]


def _disagreement(subject: Subject) -> Iterator[str]:
    """Of the criteria that hold out data, name the one to which the selected model is worst."""
    scores, wide = subject.scores, _too_wide(subject)
    criterion = scores.criterion
    if family(criterion) in WITHOUT_HOLDING_OUT:
        return
    most = _WORSE
    found = ""
    for name in scores.maps:
        choice = scores.choice(name)
        if name == criterion or family(name) in WITHOUT_HOLDING_OUT or name in wide or choice is None:
            continue
        entrant, k, w = choice
        best, own = entrant.maps[name][k, w], scores.winner.maps[name][scores.winner.place]
        sizes = _complexity(subject, scores.winner, *scores.winner.place), _complexity(subject, *choice)
        if own > most * best and max(sizes) >= _APART * min(sizes):
            most = own / best
            stiff, flexible = (criterion, name) if sizes[0] < sizes[1] else (name, criterion)
            what = "effective parameters" if subject.by_weight else "control points"
            found = (
                f"{criterion} selects {sizes[0]:.0f} {what}, {name} {sizes[1]:.0f}, and by {name} the error is "
                f"{own:.3g} instead of {best:.3g}{subject.unit}. Either neighbouring {subject.many} share noise, which "
                f"{flexible} takes for the {subject.shape}, or {_strict(subject, stiff)}. "
                f"{_ways_out(subject, stiff, flexible)}"
            )
    if found:
        yield found


def _strict(subject: Subject, stiff: str) -> str:
    if family(stiff) == "MATCHED":
        return f"{stiff} judges predictions in gaps that the {subject.many} leave"
    return f"{stiff} holds out more than lets predict this {subject.shape}"


def _complexity(subject: Subject, entrant: Selection, k: int, w: int) -> float:
    known = entrant.parameters
    return float(entrant.counts[k] if known is None or not subject.by_weight else known[k, w])


def _ways_out(subject: Subject, stiff: str, flexible: str) -> str:
    radii = 'criteria=["ER01", "ER05", "ER10"] shows the errors by radius, and so does plot_radii().'
    if not subject.by_weight:
        return f'smoothing="auto" is misled less; {radii}'
    other = flexible if subject.scores.criterion == stiff else stiff
    return f'criterion="{other}" follows the other; {radii}'


def _stiffness(subject: Subject) -> Iterator[str]:
    if subject.exact or subject.looks_wrong:
        return
    pairs = Places(subject.data.points).neighbours(2)
    differences = lengths_of(np.subtract(*subject.residuals[pairs.T])) / math.sqrt(2)
    size, noise = float(np.nanmedian(subject.sizes)), float(np.nanmedian(differences))
    if size > _TOO_STIFF * noise:
        yield (
            f"The median residual is {size:.3g}{subject.unit}, but neighbouring {subject.many} show noise of only "
            f"{noise:.3g}: the {subject.shape} is too stiff, unless neighbours share their noise. "
            f"Try {_looser(subject)}."
        )


def _looser(subject: Subject) -> str:
    scores = subject.scores
    if not subject.by_weight:
        return 'smoothing="auto"'
    if scores.rival is None and scores.count == scores.counts[-1] < subject.places:
        return f"more control points, {subject.largest}"
    return 'criterion="CMPRESS"' if scores.criterion != "CMPRESS" else "a smaller weight, smoothing=W"


def _end_of_trials(subject: Subject) -> Iterator[str]:
    if subject.scores.rival is None and subject.scores.count > 3:
        yield from _end_of_weights(subject) if subject.by_weight else _end_of_counts(subject)


def _end_of_counts(subject: Subject) -> Iterator[str]:
    count, counts = subject.scores.count, subject.scores.counts
    if counts[0] < count == counts[-1] < len(subject.data.points):
        yield (
            f"{count} control points are selected, the largest number tried: more may be better, see {subject.largest}."
        )
    if count == counts[0] < counts[-1]:
        yield f"{count} control points are selected, the smallest number tried: fewer may be better, see counts=COUNTS."


def _end_of_weights(subject: Subject) -> Iterator[str]:
    scores, parameters = subject.scores, subject.scores.effective_parameters
    interpolates = parameters > _INTERPOLATES * subject.data.values.size
    if scores.smoothing == scores.weights[0] and not interpolates:
        weight = f"smoothing {scores.smoothing:.3g}"
        if scores.count == scores.counts[-1] < subject.places:
            yield (
                f"{scores.count} control points and {weight} are selected, the largest number and the smallest weight "
                f"tried: more may be better, see {subject.largest}."
            )
        elif scores.smoothing > 0:
            yield f"{weight.capitalize()} is selected, the smallest tried: less may be better, see smoothing=W."
    if scores.smoothing == scores.weights[-1] and parameters > _PLAIN * _plain_parameters(subject.model):
        yield f"Smoothing {scores.smoothing:.3g} is selected, the largest tried: more may be better, see smoothing=W."


def _plain_parameters(model: Model) -> int:
    """Parameters of a plane, an affine map or a homography: what the largest weights leave."""
    three = 3 * (model.parameters.size // len(model.parameters))
    return three - 1 if isinstance(model, Warp) and model.fractional else three


def _undefined(subject: Subject) -> Iterator[str]:
    counts, wide = subject.scores.counts, _too_wide(subject)
    if subject.scores.rival is not None:  # the grid is not what was selected
        return
    for name, by_count in subject.scores.undefined.items():
        if name in wide:
            continue
        first = min(by_count)
        some = ", ".join(map(str, by_count[first][:5])) + (", ..." if len(by_count[first]) > 5 else "")
        where = f"at {len(by_count)} of {len(counts)} numbers of control points, first at {first}"
        if len(counts) > len(by_count) == (counts >= first).sum():
            where = f"from {first} control points on"
        remedy = "fewer control points" if subject.by_weight else 'smoothing="auto", fewer control points'
        yield (
            f"{name} has no score {where}: what it leaves does not determine the {subject.shape} for {subject.datum} "
            f"{some} (from 0). Try {remedy}, or a criterion that holds out less."
        )
