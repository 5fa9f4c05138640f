"""Contours that warps transfer, and what criteria choose in many scenes: figures 4 to 6 and table 2 of the paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from mexpress._validation import Floats
from mexpress.geometry import nearest
from mexpress.paper.contours import Rings, transferred
from mexpress.paper.table2_cells import Cell
from mexpress.paper.transfer import Trial
from mexpress.plotting import rasters
from mexpress.plotting.figures import (
    BLUE,
    GRAY,
    GREEN,
    ORANGE,
    RED,
    SKY,
    PathLike,
    frame,
    logarithmic,
    new_figure,
    saved,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LOOKS = {
    "FIT": (GRAY, ":"),
    "PRESS": (SKY, "-"),
    "KF10": ("#CC79A7", "-."),
    "ER05": (ORANGE, "-"),
    "ER10": (RED, "-"),
    "NN05PCT": ("#5CBF9F", "--"),
    "NN10PCT": ("#004D38", "--"),
}
"""Criteria that are drawn in a scene; CMPRESS is hardly told from PRESS."""

_FORMS = {"fractional": (BLUE, "-"), "linear": (ORANGE, "--")}

_PART = (0.02, 0.2)
"""Least and largest width of the magnified part, as shares of the contour's size."""

Images = tuple[NDArray[Any], NDArray[Any]]


def plot_scene(
    trials: Mapping[str, Trial], title: str, images: Images | None = None, path: PathLike | None = None
) -> Figure:
    """Plot a scene with the contours that the criteria's choices transfer, the criteria, and the truth.

    Parameters
    ----------
    trials : mapping of str to Trial
        By the form of the warps, the first of which is drawn in the images.
    title : str
        What the figure says is shown.
    images : tuple of two arrays, optional
        Source and target image.
    path : str or path, optional
        Where to save the figure.

    Returns
    -------
    matplotlib.figure.Figure
        Not shown.

    Raises
    ------
    ImportError
        Without matplotlib.

    Examples
    --------
    >>> from mexpress.paper.two_views import Simulated
    >>> from mexpress.paper.transfer import trial
    >>> problem = Simulated("flat", "affine").draw(51, seed=0)
    >>> plot_scene({"linear": trial(problem, False, [3, 4], criteria=["PRESS"])}, "a flat scene")
    <Figure size ...>
    """
    form, first = next(iter(trials.items()))
    source_image, target_image = images or (None, None)
    contours = _contours(first)
    figure = new_figure(15.0, 8.6)
    panels = figure.subplot_mosaic([["source", "target", "part"], ["criteria", "truth", "key"]])
    _draw_source(panels["source"], first, source_image)
    _draw_target(panels["target"], first, contours, target_image)
    _draw_part(panels, first, contours, target_image)
    _draw_criteria(panels["criteria"], first)
    panels["criteria"].set_title(f"criteria, {form} warps", loc="left")
    _draw_truth(panels["truth"], trials)
    _draw_key(panels["key"], first, form)
    figure.suptitle(title, x=0.01, ha="left")
    return saved(figure, path)


def _chosen(judged: Trial) -> dict[str, int]:
    """Return which of the numbers of control points each drawn criterion chooses."""
    counts, selected = judged.selection.counts.tolist(), judged.selection.selected
    return {name: counts.index(selected[name]) for name in _LOOKS if selected.get(name) is not None}


def _contours(judged: Trial) -> dict[str, Rings]:
    """Return the contour that each criterion's choice transfers, where it does."""
    contours = {}
    for name, k in _chosen(judged).items():
        warp = judged.selection.warps.get(int(judged.selection.counts[k]))
        rings = None if warp is None else transferred(warp, judged.problem.source_contour)
        if rings:
            contours[name] = rings
    return contours


def _draw_source(axes: Axes, judged: Trial, image: NDArray[Any] | None) -> None:
    problem = judged.problem
    _draw_image(axes, image)
    axes.plot(*problem.source.T, ".", color=BLUE, ms=4)
    for ring in problem.source_contour:
        axes.plot(*_closed(ring).T, color="black", lw=1.5)
    frame(axes, np.vstack([problem.source, *problem.source_contour]))
    axes.set_title(f"source image, {len(problem.source)} matches", loc="left")


def _draw_target(
    axes: Axes, judged: Trial, contours: Mapping[str, Rings], image: NDArray[Any] | None
) -> None:
    problem = judged.problem
    _draw_image(axes, image)
    for ring in problem.target_contour:
        axes.plot(*_closed(ring).T, color="black", lw=5, alpha=0.35)
    for k, (name, rings) in enumerate(contours.items()):
        colour, style = _LOOKS[name]
        for ring in rings:  # thinner and thinner, so that those below are seen
            axes.plot(*_closed(ring).T, style, color=colour, lw=2.6 - 0.25 * k)
    if not contours:
        axes.plot(*problem.target.T, ".", color=BLUE, ms=4)
    frame(axes, np.vstack([problem.target, *problem.target_contour]))
    axes.set_title("target image" + (", transferred contours" if contours else ""), loc="left")


def _draw_part(
    panels: Mapping[str, Axes], judged: Trial, contours: Mapping[str, Rings], image: NDArray[Any] | None
) -> None:
    """Magnify where contours are farthest from the truth, those of criteria that are not far off everywhere."""
    axes = panels["part"]
    if not contours or not judged.problem.target_contour:
        axes.set_axis_off()
        return
    _draw_target(axes, judged, contours, image)
    truth = np.vstack(judged.problem.target_contour)
    drawn = [np.vstack(rings) for name, rings in contours.items() if name != "FIT"] or [truth]
    distances = [nearest(truth, points)[1] for points in drawn]
    farthest = np.max(distances, axis=0)
    centre, size = truth[farthest.argmax()], float(np.ptp(truth, axis=0).max())
    half = float(np.clip(5 * farthest.max(), *np.multiply(_PART, size / 2)))
    (left, top), (right, bottom) = centre - half, centre + half
    axes.set(xlim=(left, right), ylim=(bottom, top))
    axes.set_title("where they are farthest off", loc="left")
    panels["target"].plot(
        [left, right, right, left, left], [top, top, bottom, bottom, top], color="black", lw=0.9
    )


def _draw_image(axes: Axes, image: NDArray[Any] | None) -> None:
    if image is None:
        return
    shown, step = rasters.reduced(rasters.as_image(image, "image"))
    axes.imshow(shown, extent=rasters.extent(shown, step), vmin=0, vmax=1, cmap="gray", alpha=0.6)


def _closed(ring: Floats) -> Floats:
    return np.vstack([ring, ring[:1]])


def _draw_criteria(axes: Axes, judged: Trial) -> None:
    counts = judged.selection.counts
    for name, k in _chosen(judged).items():
        curve = judged.selection.curves[name]
        colour, style = _LOOKS[name]
        axes.plot(counts, curve, style, color=colour, lw=1.5)
        axes.plot(counts[k], curve[k], "o", color=colour, mec="white", ms=8)
    logarithmic(axes)
    axes.set(xlabel="number of control points", ylabel="criterion (pixels)")
    axes.grid(alpha=0.25, lw=0.6)


def _draw_truth(axes: Axes, trials: Mapping[str, Trial]) -> None:
    """Draw what the criteria do not see, against the number of control points."""
    known = any(np.isfinite(judged.jaccard).any() for judged in trials.values())
    for form, judged in trials.items():
        colour, style = _FORMS.get(form, (GREEN, "-"))
        counts, curve = judged.selection.counts, 1 - judged.jaccard if known else judged.transfer
        lost = judged.lost if known else np.isinf(curve)
        curve = np.where(lost, np.nan, curve)
        axes.plot(counts, curve, style, color=colour, lw=1.6, marker=".", ms=4, label=f"{form} warps")
        if lost.any():
            top = axes.get_xaxis_transform()
            label = "none, the denominator vanishes"
            axes.plot(
                counts[lost], np.full(lost.sum(), 0.02), "x", color=colour, ms=5, transform=top, label=label
            )
    _mark_choices(axes, next(iter(trials.values())))
    logarithmic(axes)
    axes.set(xlabel="number of control points")
    axes.set_ylabel("1 - Jaccard index" if known else "RMS error at unseen points (pixels)")
    axes.set_title("truth, of which no criterion knows", loc="left", pad=24)
    axes.legend(loc="lower left", bbox_to_anchor=(-0.02, 0.99), ncols=3, frameon=False, fontsize=8)
    axes.grid(alpha=0.25, lw=0.6)


def _mark_choices(axes: Axes, judged: Trial) -> None:
    """Write the criteria at what they choose, those together that choose the same."""
    names: dict[int, list[str]] = {}
    for name, k in _chosen(judged).items():
        names.setdefault(int(judged.selection.counts[k]), []).append(name)
    first, near = float(judged.selection.counts[0]), 0.04 * float(np.ptp(judged.selection.counts))
    last, side = -np.inf, "right"
    for count, together in sorted(names.items()):
        taken = count - last < near and side == "right"
        side = (
            "left" if taken or count - first < 2 * near else "right"
        )  # of the text: beside, not over the axis
        last = count
        axes.axvline(count, color=_LOOKS[together[0]][0], lw=1, ls=":")
        text: dict[str, Any] = {"rotation": 90, "ha": side, "va": "top", "fontsize": 8, "color": "0.25"}
        axes.text(count, 0.98, ", ".join(together), transform=axes.get_xaxis_transform(), **text)


def _draw_key(axes: Axes, judged: Trial, form: str) -> None:
    axes.set_axis_off()
    if judged.problem.target_contour:
        axes.plot([], [], color="black", lw=5, alpha=0.35, label="true contour")
    for name, k in _chosen(judged).items():
        colour, style = _LOOKS[name]
        result = f"Jaccard {judged.jaccard[k]:.3f}" if np.isfinite(judged.jaccard[k]) else ""
        if judged.lost[k]:
            result = "no contour: denominator vanishes"
        elif not result:
            result = f"error {judged.transfer[k]:.3g}"
        label = f"{name}: {judged.selection.counts[k]} control points, {result}{_ends(judged, name)}"
        axes.plot([], [], style, color=colour, lw=2, label=label)
    axes.legend(loc="center left", frameon=False, title=f"what {form} warps are selected", alignment="left")


def _ends(judged: Trial, name: str) -> str:
    """Say where a curve ends: from there on the criterion is undefined."""
    defined = np.flatnonzero(~np.isnan(judged.selection.curves[name]))
    counts = judged.selection.counts
    return (
        ""
        if defined[-1] + 1 == len(counts)
        else f"\n(undefined from {counts[defined[-1] + 1]} control points on)"
    )


def plot_choices(cells: Sequence[Cell], criteria: Sequence[str], path: PathLike | None = None) -> Figure:
    """Plot what criteria choose in scenes, and what comes of it: a row for each scene.

    Parameters
    ----------
    cells : sequence of Cell
        Means over draws; bars are a standard deviation to either side.
    criteria : sequence of str
        Which to show.
    path : str or path, optional
        Where to save the figure.

    Returns
    -------
    matplotlib.figure.Figure
        Not shown.

    Raises
    ------
    ImportError
        Without matplotlib.

    Examples
    --------
    >>> cell = Cell("flat", "linear", 51, "ER10", 3, 0, 3.0, 0.0, 3.0, 0.1, 2.0, 0.1, 0.99, 0.001, 0.5)
    >>> plot_choices([cell], ["ER10"])
    <Figure size ...>
    """
    scenes = list(dict.fromkeys(cell.scene for cell in cells))
    series = sorted({(cell.form, cell.n) for cell in cells})
    sizes = sorted({n for _, n in series})
    figure = new_figure(13.0, 2.3 * len(scenes) + 0.9)
    # Errors of different images have little in common.
    shared: Literal["col", "none"] = "col" if all(np.isfinite(c.jaccard) for c in cells) else "none"
    rows = figure.subplots(len(scenes), 2, sharex=True, sharey=shared, squeeze=False)
    for scene, panels in zip(scenes, rows, strict=True):
        for k, (form, n) in enumerate(series):
            mine = {c.criterion: c for c in cells if (c.scene, c.form, c.n) == (scene, form, n)}
            look = _look(form, sizes.index(n) / max(len(sizes) - 1, 1), f"{form} warps, n = {n}")
            shift = 0.11 * (k - (len(series) - 1) / 2)
            _draw_choices(panels, [mine.get(name) for name in criteria], shift, look)
        for axes in panels:
            logarithmic(axes)
        panels[0].set_ylabel("control points")
        panels[0].set_title(scene, loc="left")
    for axes in rows[-1]:
        axes.set_xticks(range(len(criteria)), criteria, rotation=30, ha="right")
    handles = {
        label: handle
        for axes in rows[:, 0]
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=6, frameon=False)
    return saved(figure, path)


def _look(form: str, shade: float, label: str) -> dict[str, Any]:
    """How a series is drawn: a form has a colour and a marker, more matches are darker."""
    colour, marker = (
        (np.array([0, 0.45, 0.70]), "o") if form == "fractional" else (np.array([0.84, 0.37, 0]), "s")
    )
    tone = tuple((1 - 0.65 * (1 - shade)) * colour + 0.65 * (1 - shade))
    return {"color": tone, "marker": marker, "ls": "none", "ms": 5, "lw": 1.1, "label": label}


def _draw_choices(
    panels: Sequence[Axes], cells: Sequence[Cell | None], shift: float, look: dict[str, Any]
) -> None:
    """Draw a series into a scene's panels: counts, and what is lost of the Jaccard index, or the error."""
    there = [(k + shift, cell) for k, cell in enumerate(cells) if cell is not None]
    if not there:
        return
    x = [at for at, _ in there]
    panels[0].errorbar(x, [c.count for _, c in there], [c.count_std for _, c in there], **look)
    known = np.isfinite([c.jaccard for _, c in there]).any()
    y = [1 - c.jaccard if known else c.transfer for _, c in there]
    panels[1].plot(x, y, **look)
    panels[1].set_ylabel("1 - Jaccard" if known else "error (pixels)")
    for axes in panels:
        axes.grid(axis="y", alpha=0.25, lw=0.6)
