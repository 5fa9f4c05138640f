"""Criteria against the number of control points, and against the weight of the bending energy."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mexpress._validation import Floats
from mexpress.criteria import UNITLESS, Criterion, parse
from mexpress.plotting.figures import (
    BLUE,
    GRAY,
    GREEN,
    ORANGE,
    RED,
    SKY,
    PathLike,
    figure_of,
    given_axes,
    new_figure,
    saved,
    with_unit,
)
from mexpress.plotting.subjects import SelectionLike

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

_HUES: dict[str, tuple[tuple[str, ...], str]] = {
    "FIT": ((GRAY,), "-"),
    "PRESS": ((SKY,), "-"),
    "CMPRESS": ((BLUE,), "-"),
    "ER": ((ORANGE, RED, "#7A2E00"), "-"),
    "NN": (("#5CBF9F", GREEN, "#004D38"), "--"),
    "DELAUNAY": (("#8C6D1F",), "--"),
    "MATCHED": (("#B3003B",), "-."),
    "KF": (("#E3B5CF", "#CC79A7", "#7B3F63"), "-."),
    "LPO": (("#B9A5DB", "#5B3A9B", "#341F61"), "-."),
    "RS": (("#B9A5DB", "#5B3A9B", "#341F61"), ":"),
    "AIC": (("#000000",), "--"),
    "BIC": (("#000000",), ":"),
    "GCV": (("#000000",), "-."),
}
"""Colours and line style of every family: from the smallest sets that are held out to the largest."""

_OWN = ("#5B3A9B", "#8C6D1F", "#CC79A7", "#44AA99", "#882255")
"""Colours of schemes that are the user's own."""

_FEW = 4
"""Up to so many counts, weights are the axis that tells more."""

_LABELS, _GAP = 1.05, 0.047
"""Where labels are, and their distance, as fractions of the width and the height of the axes."""


def plot_selection(
    selection: SelectionLike,
    path: PathLike | None = None,
    *,
    ax: Axes | None = None,
    unit: str | None = None,
) -> Figure:
    """Plot every criterion against the number of control points, and what each would select.

    A label at the end of every curve names its criterion and what that selects; the criteria that hold out
    smaller or larger neighbourhoods have lighter or darker tones of one colour, and criteria with the same
    curve share a line. With several weights of the bending energy the curves are those of the weight that is best for
    each count, and below them is the map of the selecting criterion over counts and weights; with four counts or
    fewer they are those of the selected count against the weight. AIC and BIC have no unit: the plot shows
    a * AIC + b, with a and b such that it is nearest to FIT (or the chosen criterion, if there is no FIT) by least
    squares, among those with a positive, so that minima stay minima, and with no value below half of FIT's smallest,
    so that the axis may be logarithmic. Where least squares would want a negative a, it is such that both curves have
    the same standard deviation.

    Parameters
    ----------
    selection : Selection
        Result of a sweep, such as `select_warp` or `select_surface`.
    path : str or path, optional
        Where to save the figure; the suffix says how (.png, .pdf, .svg).
    ax : matplotlib.axes.Axes, optional
        Where to draw the curves alone, in place of a figure of its own. Their labels are on the right of the axes, and
        want room there, which ``layout="constrained"`` makes.
    unit : str, optional
        Of the criteria; by default pixels for warps, and for others the unit of the data.

    Returns
    -------
    matplotlib.figure.Figure
        That of `ax`, or a new one, which notebooks show.

    Raises
    ------
    ImportError
        Without matplotlib.

    Examples
    --------
    >>> import mexpress as mx
    >>> source = np.random.default_rng(0).uniform(0, 100, (40, 2))
    >>> target = source + np.sin(source / 20)
    >>> plot_selection(mx.select_warp(source, target, counts=range(3, 12)))
    <Figure size ...>
    """
    several = len(selection.weights) > 1
    line = _over_weights(selection) if several and len(selection.counts) <= _FEW else _over_counts(selection)
    default = "pixels of the target image" if _is_of_warps(selection) else None
    if ax is not None:
        _draw_panel(given_axes(ax), selection, line, unit or default)
        return saved(figure_of(ax), path)
    mapped = several and len(selection.counts) > _FEW
    figure = new_figure(8.6, 8.4 if mapped else 5.0)
    axes, *below = figure.subplots(1 + mapped, 1, squeeze=False, sharex=True)[:, 0]
    _draw_panel(axes, selection, line, unit or default)
    if mapped:
        axes.set_xlabel("")
        _draw_map(below[0], selection, unit or default)
    return saved(figure, path)


def _draw_panel(axes: Axes, selection: SelectionLike, line: _Line, unit: str | None) -> None:
    """Draw all curves, and say what is selected."""
    _draw_curves(axes, selection, line)
    axes.set_ylabel(with_unit("criterion", unit))
    k, w = selection.place
    best = f"{selection.counts[k]} control points"
    best += f" and smoothing {selection.weights[w]:.3g}" if len(selection.weights) > 1 else ""
    if selection.rival is not None:
        best = f"the {selection.rival}, not {best}"
    axes.set_title(f"{selection.criterion} selects {best}", loc="left")
    axes.set_xlabel("number of control points")
    if line.weights:
        draw_weights(axes.xaxis, selection.weights)
        _write_parameters(axes, selection)
        axes.set_xlabel(f"weight of the bending energy, at {selection.counts[k]} control points")


@dataclass(frozen=True)
class _Line:
    """What curves are drawn against: positions, scores there, which position each criterion selects, and its name."""

    x: Floats
    curves: Mapping[str, Floats]
    best: dict[str, int | None]
    names: list[str]
    weights: bool


def _over_counts(selection: SelectionLike) -> _Line:
    counts = selection.counts.tolist()
    best = {
        name: _smallest(selection.curves[name])
        if count is None or selection.selected_rival[name] is not None
        else counts.index(count)
        for name, count in selection.selected.items()
    }
    best[selection.criterion] = selection.place[0]
    return _Line(selection.counts.astype(float), selection.curves, best, [str(c) for c in counts], False)


def _over_weights(selection: SelectionLike) -> _Line:
    """At the selected count; each criterion's mark is what it would select there."""
    k = selection.place[0]
    curves = {name: scores[k] for name, scores in selection.maps.items()}
    best = {name: _smallest(curve) for name, curve in curves.items()}
    best[selection.criterion] = selection.place[1]
    names = [f"{float(f'{weight:.3g}'):g}" for weight in selection.weights]
    return _Line(weight_positions(selection.weights), curves, best, names, True)


def _smallest(curve: Floats) -> int | None:
    return None if np.isnan(curve).all() else int(np.nanargmin(curve))


def _draw_curves(axes: Axes, selection: SelectionLike, line: _Line) -> None:
    curves, rescaled = _on_one_axis(line.curves, selection.criterion)
    looks = _looks(list(curves))
    _set_limits(axes, curves, line.x, selection)
    labels: dict[str, tuple[float, str, bool]] = {}
    for names in _alike(curves, selection.criterion):
        colour, style = looks[names[0]]
        chosen = selection.criterion in names
        best, curve = line.best[selection.criterion if chosen else names[0]], curves[names[0]]
        rival = selection.selected_rival[selection.criterion if chosen else names[0]]
        _draw(axes, (line.x, curve), best, (colour, "-" if chosen else style), chosen, rival is not None)
        choice = rival or ("none" if best is None else line.names[best])
        labels[f"{_label(names, rescaled, selection)}: {choice}"] = (_end(axes, curve), colour, chosen)
    _write_labels(axes, labels)
    if selection.rival is not None:
        _draw_rival(axes, selection, looks[selection.criterion][0])
    axes.grid(alpha=0.25, lw=0.6)


def weight_positions(weights: Floats) -> Floats:
    """Return where weights are on a logarithmic axis, 0 one mean step below the smallest other."""
    at = np.log10(weights, out=np.full(len(weights), np.nan), where=weights > 0)
    known = at[np.isfinite(at)]
    step = max((known[-1] - known[0]) / max(len(known) - 1, 1), 0.5)
    return np.asarray(np.where(np.isfinite(at), at, known[0] - step))


def draw_weights(axis: Axis, weights: Floats) -> None:
    """Label an axis on which weights have their positions by powers of ten, and 0."""
    at = weight_positions(weights)
    above = at[weights > 0]
    decades = np.arange(math.ceil(above[0] - 1e-9), math.floor(above[-1] + 1e-9) + 1)
    decades = decades[:: max(1, -(-len(decades) // 8))]
    marks = [(float(d), f"$10^{{{d}}}$") for d in decades] or [(float(above[0]), f"{weights[-1]:.2g}")]
    marks += [(float(at[0]), "0")] if weights[0] == 0 else []
    axis.set_ticks([place for place, _ in marks], [text for _, text in marks])


def _write_parameters(axes: Axes, selection: SelectionLike) -> None:
    """Write how many effective parameters the selected count has, along the top."""
    if selection.parameters is None:
        return
    at, parameters = weight_positions(selection.weights), selection.parameters[selection.place[0]]
    shown = np.unique(np.linspace(0, len(at) - 1, 7).round().astype(int))
    top = axes.secondary_xaxis("top")
    top.set_xticks(at[shown], ["-" if np.isnan(parameters[k]) else f"{parameters[k]:.3g}" for k in shown])
    top.set_xlabel("effective parameters", fontsize=9, color=GRAY)
    top.tick_params(labelsize=9, labelcolor=GRAY, color=GRAY)


def _draw_map(axes: Axes, selection: SelectionLike, unit: str | None) -> None:
    """Draw the selecting criterion over counts and weights, up to three times its smallest score."""
    name, scores = selection.criterion, selection.maps[selection.criterion]
    x, y = selection.counts.astype(float), weight_positions(selection.weights)
    low, high = float(np.nanmin(scores)), float(np.nanmax(scores))
    top = high if name in UNITLESS or low <= 0 else min(high, 3 * low)
    shades = axes.pcolormesh(
        x,
        y,
        scores.T,
        shading="nearest",
        cmap="viridis",
        vmin=low,
        vmax=max(top, low + 1e-9 * (abs(low) or 1.0)),
    )
    figure = axes.get_figure()
    assert figure is not None
    label = name if name in UNITLESS else with_unit(name, unit)
    beside = axes.inset_axes((1.02, 0.0, 0.03, 1.0))
    figure.colorbar(shades, cax=beside, label=label, extend="max" if top < high else "neither")
    for other, (k, w) in _choices(selection).items():
        chosen = other == name
        axes.plot(
            x[k], y[w], "o", ms=11 if chosen else 6, mfc=RED if chosen else "none", mec="white", mew=1.5
        )
        left = x[k] > 0.7 * x[-1] + 0.3 * x[0]
        text = axes.annotate(other, (x[k], y[w]), (-8 if left else 8, 8), textcoords="offset points")
        text.set(
            ha="right" if left else "left", weight="bold" if chosen else "normal", fontsize=9, color="white"
        )
        text.set_bbox({"facecolor": "black", "alpha": 0.45, "edgecolor": "none", "pad": 1.5})
    draw_weights(axes.yaxis, selection.weights)
    axes.set_xlabel("number of control points")
    axes.set_ylabel("weight of the bending energy")


def _choices(selection: SelectionLike) -> dict[str, tuple[int, int]]:
    """Positions of what each criterion selects; those that select the same together."""
    counts, weights = selection.counts.tolist(), selection.weights.tolist()
    at: dict[tuple[int, int], list[str]] = {}
    for name, count in selection.selected.items():
        if count is not None and name != selection.criterion and selection.selected_rival[name] is None:
            weight = selection.selected_smoothing[name]
            at.setdefault((counts.index(count), weights.index(weight)), []).append(name)
    others = {", ".join(names): place for place, names in at.items() if place != selection.place}
    return {**others, selection.criterion: selection.place}


def _on_one_axis(curves: Mapping[str, Floats], criterion: str) -> tuple[dict[str, Floats], set[str]]:
    """Bring curves without a unit onto one that has one; their names are returned too."""
    anchor = next((n for n in ("FIT", criterion, *curves) if n in curves and n not in UNITLESS), None)
    names = {name for name in curves if name in UNITLESS} if anchor is not None else set()
    onto = np.asarray(curves[anchor or criterion], dtype=np.float64)
    moved = {
        name: _rescaled(curve, onto) if name in names else np.asarray(curve, dtype=np.float64)
        for name, curve in curves.items()
    }
    return moved, names


def _rescaled(curve: Floats, onto: Floats) -> Floats:
    """Return a * curve + b that is nearest to another curve, a > 0, not below half of that one's minimum."""
    usable = np.isfinite(curve) & np.isfinite(onto)
    if not usable.any():
        return np.full_like(curve, np.nan)
    x, y = curve[usable] - curve[usable].min(), onto[usable]
    spread, lowest = float(np.std(x)) or 1.0, 0.5 * float(y.min())
    scale = float(((x - x.mean()) * y).mean()) / spread**2
    if scale <= 0:  # would turn the curve over, its minimum into a maximum
        scale = float(np.std(y)) / spread
    offset = float(y.mean() - scale * x.mean())
    if offset < lowest:
        offset, scale = lowest, float((x * (y - lowest)).sum() / (x**2).sum())
    return np.asarray(offset + scale * (curve - curve[usable].min()))


def _alike(curves: Mapping[str, Floats], criterion: str) -> list[list[str]]:
    """Return the names of curves, those together that cannot be told apart; the chosen criterion last."""
    groups: list[list[str]] = []
    for name, curve in curves.items():
        same = (g for g in groups if np.allclose(curves[g[0]], curve, rtol=1e-6, atol=0, equal_nan=True))
        group = next(same, None)
        if group is None:
            groups.append([name])
        else:
            group.append(name)
    return sorted(groups, key=lambda group: criterion in group)


def _looks(names: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Return every criterion's colour and line style."""
    parsed = {name: _criterion(name) for name in names}
    families: dict[str, list[str]] = {}
    for name, criterion in sorted(parsed.items(), key=lambda item: (item[1].family, item[1].amount)):
        families.setdefault(
            criterion.family[:2] if criterion.family[:2] == "NN" else criterion.family, []
        ).append(name)
    looks = {}
    for family, members in families.items():
        tones, style = _HUES.get(family, (_OWN, "-"))
        for k, name in enumerate(members):
            looks[name] = (
                (_tone(tones, k, len(members)), style) if family in _HUES else (tones[k % len(tones)], style)
            )
    return looks


def _criterion(name: str) -> Criterion:
    try:
        return parse(name)
    except ValueError:  # a scheme of the user's own
        return Criterion(name, "own", 0.0)


def _tone(tones: Sequence[str], k: int, number: int) -> str:
    """Return the k-th of a number of colours from the first tone to the last."""
    at = 0.5 if number == 1 else k / (number - 1)
    channels = np.array([[int(tone[i : i + 2], 16) for i in (1, 3, 5)] for tone in tones])
    mixed = (np.interp(at, np.linspace(0, 1, len(tones)), channel) for channel in channels.T)
    return "#" + "".join(f"{round(value):02X}" for value in mixed)


def _draw_rival(axes: Axes, selection: SelectionLike, colour: str) -> None:
    """Draw the score of a selected rival, which has no count and no weight, as a line across."""
    axes.axhline(selection.score, color=colour, ls="--", lw=1.8, zorder=5)
    text = axes.annotate(
        f"{selection.rival}: {selection.criterion} {selection.score:.4g}",
        (0.01, selection.score),
        (0, 4),
        xycoords=("axes fraction", "data"),
        textcoords="offset points",
    )
    text.set(color=colour, weight="bold", fontsize=9.5, zorder=7)
    text.set_bbox({"facecolor": "white", "alpha": 0.7, "edgecolor": "none", "pad": 1})


def _set_limits(axes: Axes, curves: Mapping[str, Floats], x: Floats, selection: SelectionLike) -> None:
    """Logarithms when the values span much; values far above the selected one leave the frame."""
    first, last = float(x[0]), float(x[-1])
    margin = 0.02 * (last - first) or 0.5
    axes.set_xlim(first - margin, last + margin)
    defined = [curve[np.isfinite(curve)] for curve in curves.values()]
    defined += [] if selection.rival is None else [np.array([selection.score])]
    values = np.concatenate(defined)
    if not values.size:
        return
    low, high = float(values.min()), float(values.max())
    chosen = curves[selection.criterion]
    least = float(chosen[np.isfinite(chosen)].min(initial=np.inf))
    top = max(1.5 * max(float(c[0]) for c in defined if c.size), 10 * least if np.isfinite(least) else low)
    if low <= 0 or high < 5 * low:
        room = 0.05 * (min(high, top) - low) or 0.05 * abs(high) or 1.0
        axes.set_ylim(low - room, min(high, max(top, low + room)) + room)
        return
    axes.set_yscale("log", subs=(2, 5) if top < 1000 * low else ())
    axes.set_ylim(low / 1.15, min(top, 1.15 * high))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("{x:g}")


def _draw(
    axes: Axes,
    line: tuple[Floats, Floats],
    best: int | None,
    look: tuple[str, str],
    chosen: bool,
    beaten: bool,
) -> None:
    """Draw a curve, mark its best, hollow if a rival is better, and make the chosen criterion's stand out."""
    x, curve = line
    colour, style = look
    axes.plot(x, curve, style, color=colour, lw=2.8 if chosen else 1.4, zorder=4 if chosen else 3)
    if best is None:
        return
    face, edge = ("white", colour) if beaten else (colour, "white")
    axes.plot(x[best], curve[best], "o", color=colour, ms=10 if chosen else 6, mfc=face, mec=edge, zorder=6)
    if chosen and not beaten:
        axes.axvline(x[best], color=colour, lw=1, alpha=0.4, zorder=1)


def _is_of_warps(selection: SelectionLike) -> bool:
    return hasattr(selection, "warp")


def _label(names: Sequence[str], rescaled: set[str], selection: SelectionLike) -> str:
    notes = [" (rescaled)" if name in rescaled else "" for name in names]
    if _is_of_warps(selection):  # which have two rows a match
        notes = [" (per row)" if name == "PRESS" else note for name, note in zip(names, notes, strict=True)]
    return " = ".join(name + note for name, note in zip(names, notes, strict=True))


def _end(axes: Axes, curve: Floats) -> float:
    """Return where a curve ends, as a fraction of the height of the axes; NaN if it is nowhere."""
    known = curve[np.isfinite(curve)]
    if not known.size:
        return np.nan
    end = axes.transData.transform((0.0, known[-1]))
    return float(np.clip(axes.transAxes.inverted().transform(end)[1], 0.0, 1.0))


def _write_labels(axes: Axes, labels: Mapping[str, tuple[float, str, bool]]) -> None:
    """Write labels beside the ends of the curves, moved apart where they are too near to each other."""
    ends = np.array([end for end, _, _ in labels.values()])
    places = _apart(np.nan_to_num(ends, nan=0.0), min(_GAP, 1 / len(ends)))
    beside: dict[str, Any] = {"transform": axes.transAxes, "clip_on": False}
    axes.text(_LABELS, 1.035, "criterion: what it selects", fontsize=9, color=GRAY, **beside)
    for (text, (end, colour, chosen)), place in zip(labels.items(), places, strict=True):
        if np.isfinite(end):
            axes.plot((1, _LABELS - 0.01), (end, place), color=colour, lw=0.8, **beside)
        weight = "bold" if chosen else "normal"
        axes.text(_LABELS, place, text, va="center", fontsize=9.5, weight=weight, color=colour, **beside)


def _apart(wanted: Floats, gap: float) -> Floats:
    """Return the places from 0 to 1 that are nearest to those wanted, by least squares, and a gap apart."""
    order = np.argsort(wanted, kind="stable")
    steps = gap * np.arange(len(wanted))
    free = wanted[order] - steps
    number = range(len(free))
    # What is left is to make a sequence that does not fall (isotonic regression, by its minimax formula).
    means = [[free[i : j + 1].mean() if j >= i else np.inf for j in number] for i in number]
    rising = np.array([max(min(means[i][k:]) for i in range(k + 1)) for k in number])
    places = np.empty_like(wanted)
    places[order] = np.clip(rising, 0, 1 - steps[-1]) + steps
    return places
