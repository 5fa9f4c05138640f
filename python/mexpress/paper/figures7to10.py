"""Figures 7 to 10: surfaces with more and more control points, and those that the criteria select.

Figure 7 shows the criteria against the number of control points, and the control points in the order in which they
come, of a depth map; figure 8 the surface that each criterion selects. Figures 9 and 10 are the same for an embedding,
a map from a flat sheet into space. The reader's file may be either, for each of the four; `mexpress.read_cloud` says
what it may be. Without a file the data are simulated; then the truth is known, which no criterion sees.

Examples
--------
>>> FIGURE7.name, FIGURE10.data
('figure7', 'FILE')
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mexpress import criteria, plotting
from mexpress._validation import Floats
from mexpress.cli import common
from mexpress.cli import report as reports
from mexpress.models.nested_errors import nested_errors
from mexpress.paper.experiment import Experiment, Options, Outcome
from mexpress.paper.plot_panels import ALIKE, PanelFit, grouped, plot_fits
from mexpress.paper.surface_data import Subject, read_subject, simulated_depth, simulated_embedding
from mexpress.selection import SurfaceSelection, select_surface
from mexpress.selection.fit import fit_surface

CRITERIA = (
    *("FIT", "AIC", "BIC", "GCV", "CMPRESS", "KF10", "ER01", "ER05", "ER10"),
    *("NN01PCT", "NN05PCT", "NN10PCT", "DELAUNAY"),
)

CRITERION = "ER10"
"""Whose choice the plots stress: the paper's advice."""

TRUTH = "TRUTH"
"""The name in tables and plots of what no criterion sees."""

_SIZES = {"depth": (10_000, 2000), "embedding": (1000, 300)}
"""Data by kind of subject, in a full run and in a quick one; of a file at most so many as of a depth map."""

_COUNTS = (175, 100)
"""The largest number of control points, in a full run and in a quick one."""

_IMAGES = "The image's numbers are divided by 1000: metres if they are millimetres.\n"


@dataclass(frozen=True, eq=False)
class _Sweep:
    """Criteria and truth for every number of control points."""

    subject: Subject
    selection: SurfaceSelection
    truth: Floats

    @property
    def shown(self) -> SurfaceSelection:
        """The criteria with the truth beside them, if it is known."""
        if np.isnan(self.truth).all():
            return self.selection
        return replace(self.selection, maps={**self.selection.maps, TRUTH: self.truth})

    def at(self, count: int) -> tuple[float, float]:
        """FIT and true error."""
        k = int(count - self.selection.counts[0])
        return float(self.selection.curves["FIT"][k]), float(self.truth[k])

    def fits(self) -> list[PanelFit]:
        """The selected surfaces, those with the fewest control points first."""
        by_count: dict[int, list[str]] = {}
        for name, count in self.shown.selected.items():
            if count is not None:
                by_count.setdefault(count, []).append(name)
        data = self.subject.points, self.subject.values
        return [
            PanelFit(
                tuple(names),
                count,
                *self.at(count),
                fit_surface(*data, self.selection.control_points[:count]),
            )
            for count, names in sorted(by_count.items())
        ]


def _sweep(kind: str, options: Options) -> _Sweep:
    full, quick = _SIZES["depth" if options.data else kind]
    number = quick if options.quick else full
    if options.data is not None:
        with common.warnings_as_lines():
            subject = read_subject(options.data, number, options.seed)
    else:
        simulated = simulated_depth if kind == "depth" else simulated_embedding
        subject = simulated(number, options.seed)
    selection = select_surface(
        subject.points,
        subject.values,
        "FIT",
        CRITERIA,
        max_count=_COUNTS[options.quick],
        seed=options.seed,
        threads=options.threads,
        progress=options.progress,
        smoothing=0,
    )
    control_points, where = selection.control_points, subject.true_points
    truth = np.full(len(control_points) - 2, np.nan)
    if len(where):
        truth = nested_errors(subject.points, subject.values, control_points, where, subject.true_values)
    return _Sweep(subject, _stressed(selection), truth)


def _stressed(selection: SurfaceSelection) -> SurfaceSelection:
    """Let the paper's criterion select, unless it is undefined everywhere."""
    count = selection.selected[CRITERION]
    if count is None:
        return selection
    surface = fit_surface(selection.points, selection.values, selection.control_points[:count])
    return replace(selection, criterion=CRITERION, surface=surface)


def _run(name: str, kind: str, panels: bool, options: Options) -> Outcome:
    sweep = _sweep(kind, options)
    reports.write_curves(options.out / f"{name}.csv", sweep.shown)
    report = _report(sweep, options.data)
    if not panels:
        return Outcome(report, _summary(sweep), [f"{name}.csv"], _arrival(name, sweep))
    if sweep.subject.dimension not in (1, 3):
        return Outcome(report, _summary(sweep), [f"{name}.csv"])
    fits = sweep.fits()
    plots = {f"{name}.png": lambda path: plot_fits(sweep.subject, fits, path)}
    return Outcome(report + (_alike(fits) if options.plots else ""), _summary(sweep), [f"{name}.csv"], plots)


def _arrival(name: str, sweep: _Sweep) -> dict[str, Callable[[Path], object]]:
    subject = sweep.subject
    look: dict[str, Any] = {"image_size": subject.image_size, "unit": subject.unit}
    return {
        f"{name}_curves.png": lambda path: plotting.plot_selection(sweep.shown, path, unit=subject.unit),
        f"{name}_control_points.png": lambda path: plotting.plot_control_points(
            sweep.selection, path, **look
        ),
    }


def _alike(fits: Sequence[PanelFit]) -> str:
    """Return which surfaces share a panel of the plot."""
    groups = [group for group in grouped(fits) if len(group) > 1]
    sentences = (
        f"\nThe one with {group[0].count} is drawn for "
        + ", ".join(f"{name} {fit.count}" for fit in group for name in fit.names)
        + "."
        for group in groups
    )
    rule = f"\n\nSurfaces whose numbers of control points differ by less than {ALIKE:.0%} share a panel of the plot."
    return "".join([rule, *sentences]) if groups else ""


def _report(sweep: _Sweep, data: Path | None) -> str:
    subject, selection, known = sweep.subject, sweep.selection, not np.isnan(sweep.truth).all()
    kind = "depths" if subject.dimension == 1 else f"points in R^{subject.dimension}"
    unit = subject.unit or "the unit of the data"
    lines = [
        f"{subject.name}: {len(subject.points)} {kind}, surfaces with {selection.counts[0]} to "
        f"{selection.counts[-1]} control points; errors in {unit}",
        "",
        f"{'criterion':>10}{'points':>8}{'its score':>11}{'FIT':>10}" + ("{:>11}".format("true RMS") * known),
    ]
    for name, count in sweep.shown.selected.items():
        lines.append(_line(sweep, name, count, known))
    notes = f"{TRUTH}: the number that is in truth best; no criterion knows it.\n" if known else ""
    if data is not None and subject.unit is not None:
        notes += _IMAGES
    if subject.dimension not in (1, 3):
        notes += f"Points in R^{subject.dimension} cannot be drawn: only their criteria are.\n"
    return "\n".join([*lines, "", notes + _lost(selection)]).rstrip()


def _line(sweep: _Sweep, name: str, count: int | None, known: bool) -> str:
    if count is None:
        return f"{name:>10}{'-':>8}  undefined at every number"
    fit, truth = sweep.at(count)
    score = sweep.shown.curves[name][count - sweep.selection.counts[0]]
    scored = "" if name in criteria.UNITLESS else f"{score:.4g}"
    return f"{name:>10}{count:8}{scored:>11}{fit:10.4g}" + (f"{truth:11.4g}" if known else "")


def _lost(selection: SurfaceSelection) -> str:
    """Return where criteria are undefined."""
    lines = [
        f"{name} is undefined from {min(by_count)} control points on, for up to "
        f"{max(len(data) for data in by_count.values())} data."
        for name, by_count in selection.undefined.items()
    ]
    return "\n".join(lines)


def _summary(sweep: _Sweep) -> dict[str, Any]:
    subject, selection = sweep.subject, sweep.selection
    return {
        "subject": subject.name,
        "n_data": len(subject.points),
        "dimension": subject.dimension,
        "unit": subject.unit,
        "image_size": subject.image_size,
        "largest_count": int(selection.counts[-1]),
        "choices": {name: _choice(sweep, count) for name, count in sweep.shown.selected.items()},
        "undefined": {
            name: {"from": min(by_count), "data": max(len(data) for data in by_count.values())}
            for name, by_count in selection.undefined.items()
        },
        "control_points": selection.control_points.tolist(),
    }


def _choice(sweep: _Sweep, count: int | None) -> Mapping[str, float | None]:
    if count is None:
        return {"count": None, "FIT": None, "true_rms": None}
    fit, truth = sweep.at(count)
    return {"count": count, "FIT": fit, "true_rms": truth}


def _figure(number: int, summary: str, kind: str, panels: bool) -> Experiment:
    name = f"figure{number}"
    return Experiment(name, summary, "FILE", lambda options: _run(name, kind, panels, options))


FIGURE7 = _figure(7, "criteria and control points of surfaces fitted to a depth map", "depth", False)
FIGURE8 = _figure(8, "the surface that each criterion selects for a depth map", "depth", True)
FIGURE9 = _figure(9, "criteria and control points of surfaces fitted to an embedding", "embedding", False)
FIGURE10 = _figure(10, "the surface that each criterion selects for an embedding", "embedding", True)
