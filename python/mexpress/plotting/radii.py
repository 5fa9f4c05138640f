"""A model's score against the radius within which data are held out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mexpress.plotting.figures import BLUE, GRAY, ORANGE, RED, PathLike, new_figure, saved, with_unit
from mexpress.radii import RadiusCurve

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ADVICE = (5.0, 10.0)


def plot_radii(curve: RadiusCurve, path: PathLike | None = None, *, unit: str | None = None) -> Figure:
    """Plot the score against the exclusion radius, over the distances at which the model will be used.

    Above, the score; below, how much of the region that the data cover is within a distance of a datum. Where
    the lower curve has risen to most of the domain, larger radii ask more of the model than its use within
    this region does. The band is the paper's advice, 5 to 10 % of the diagonal.

    Parameters
    ----------
    curve : RadiusCurve
        From `mexpress.radii.score_by_radius`.
    path : str or path, optional
        Where to save the figure; the suffix says how (.png, .pdf, .svg).
    unit : str, optional
        Of the score.

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
    >>> from mexpress.radii import RadiusCurve
    >>> reach = np.linspace(0, 4, 50)
    >>> plot_radii(RadiusCurve(np.array([0.0, 5.0]), np.array([1.0, 1.5]), np.array([1.0, 9.0]), reach))
    <Figure size ...>
    """
    figure = new_figure(7.2, 5.4)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[2.4, 1])
    above.plot(curve.percents, curve.scores, "o-", color=RED, ms=5)
    small: dict[str, Any] = {"color": GRAY, "fontsize": 8}
    for percent, score, held in zip(curve.percents, curve.scores, curve.held, strict=True):
        if np.isfinite(score):
            number = f"{held:.1f}" if held < 10 else f"{held:.0f}"
            above.annotate(number, (percent, score), (0, 8), textcoords="offset points", ha="center", **small)
    above.set_ylabel(with_unit("prediction error", unit))
    above.set_title("Prediction error against exclusion radius", loc="left")
    above.margins(y=0.16)
    note = "small numbers: mean number of data held out"
    above.text(0.99, 0.04, note, transform=above.transAxes, ha="right", **small)
    share = 100 * np.arange(1, len(curve.reach) + 1) / len(curve.reach)
    below.plot(np.append(0, curve.reach), np.append(0, share), color=BLUE)
    below.set(ylim=(0, 105), xlabel="radius (% of the diagonal)", ylabel="% of the domain\nwithin the radius")
    for axes in (above, below):
        axes.axvspan(*_ADVICE, color=ORANGE, alpha=0.15, lw=0)
        for part in (50, 95):
            axes.axvline(np.percentile(curve.reach, part), color=BLUE, lw=0.8, ls=":")
        axes.grid(alpha=0.25, lw=0.6)
    for part in (50, 95):
        place = float(np.percentile(curve.reach, part))
        look: dict[str, Any] = {"textcoords": "offset points", "va": "top", "color": BLUE, "fontsize": 8}
        below.annotate(f"{part} %: {place:.2g}", (place, part), (6, -4), **look)
    below.text(np.mean(_ADVICE), 12, "the paper's advice", ha="center", **small)
    return saved(figure, path)
