"""What the page of a selection says: what came out, notes, what was asked, all scores, and how to make it again."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mexpress import notebook, report
from mexpress._validation import Floats, Integers
from mexpress.criteria import UNITLESS
from mexpress.plotting.curves import weight_positions
from mexpress.selection.selection import Selection, weights_tell_more
from mexpress.versions import versions

_LISTED = 12
"""Data with the largest residuals, and queries, that are listed one by one."""


@dataclass(frozen=True)
class Account:
    """A selection with all that its page tells.

    Parameters
    ----------
    scores : Selection
        The selection.
    kind : {"warp", "surface"}
        What was selected.
    model : str
        It, in words.
    unit : str, optional
        Of scores and residuals, if it is known.
    points : (n, 2) array
        Where the data are.
    residuals : (n,) array
        How far each datum is from the model; NaN where it is missing.
    kept, left_out : integer array
        Indices of the data in the fit, and of those that were left out as wrong.
    notes : sequence of str
        What is doubtful.
    asked : mapping
        The arguments, as plain values by name.
    schemes : sequence of str
        Names of the user's own schemes.
    weighted : bool
        Whether the data have weights.
    image_size : (width, height), optional
        Of the source image.
    searched : bool
        Whether wrong data were searched for.
    command : str, optional
        What was typed, if it was made from the command line.
    """

    scores: Selection
    kind: str
    model: str
    unit: str | None
    points: Floats
    residuals: Floats
    kept: Integers
    left_out: Integers
    notes: Sequence[str]
    asked: Mapping[str, Any]
    schemes: Sequence[str]
    weighted: bool
    image_size: tuple[float, float] | None
    searched: bool
    command: str | None

    def page(self, table: str, figures: Sequence[str]) -> str:
        """Return the page, with the table of criteria and figures of the model, which are HTML."""
        sections = [
            report.section("Notes", self._notes(), "notes"),
            report.section("What was asked", notebook.facts(self._question()), "asked"),
            report.section("Scores of the models that were tried", self._curves()),
            report.section(f"The {self.kind}", f'<div class="figures">{"".join(figures)}</div>'),
            report.section("Criteria", self._criteria(table)),
            report.section("Data to look at", self._outliers()),
            report.section("How to make it again", self._again()),
            report.section("Versions", notebook.facts(versions()), "asked"),
        ]
        return report.page(f"{self.kind} selection", self._result(), self._numbers(), sections)

    @property
    def _many(self) -> str:
        return "matches" if self.kind == "warp" else "data"

    def _result(self) -> str:
        scores = self.scores
        unit = f" {self.unit}" if self.unit and scores.criterion not in UNITLESS else ""
        return f"{scores.sentence}: {scores.score:.4g}{unit}"

    def _numbers(self) -> list[tuple[str, str]]:
        """The numbers that matter most."""
        sizes, parameters = self.residuals[self.kept], self.scores.effective_parameters
        rms = float(np.sqrt(np.mean(sizes**2)))
        return [
            (f"{self._many} in the fit", f"{len(self.kept)}"),
            ("left out as wrong", f"{len(self.left_out)}" if self.searched else "not searched"),
            ("control points", f"{self.scores.count}"),
            ("effective parameters", "not known" if math.isnan(parameters) else f"{parameters:.1f}"),
            (self._with_unit("RMS residual"), f"{rms:.3g}"),
            (self._with_unit("median residual"), f"{np.median(sizes):.3g}"),
        ]

    def _with_unit(self, name: str) -> str:
        return f"{name} ({self.unit})" if self.unit else name

    def _notes(self) -> str:
        return notebook.notes(self.notes) or "<p>None: no check found anything doubtful.</p>"

    def _question(self) -> dict[str, str]:
        """What was asked, in words."""
        scores, n, kept = self.scores, len(self.points), len(self.kept)
        data = f"{n} {self._many}"
        absent = n - kept - len(self.left_out)
        data += f", of which {len(self.left_out)} were left out as wrong" if len(self.left_out) else ""
        data += f"; {absent} are missing or have weight 0" if absent else ""
        low, high = np.nanmin(self.points, axis=0), np.nanmax(self.points, axis=0)
        counts, weights = scores.counts, scores.weights
        tried = f"{counts[0]} to {counts[-1]}, {len(counts)} of them" if len(counts) > 2 else _listed(counts)
        smoothing = f"{weights[0]:.3g}"
        if len(weights) > 1:
            smoothing = f"{len(weights)} weights, {weights[0]:.3g} to {weights[-1]:.3g}"
        said = {
            "data": data,
            "extent": f"x {low[0]:.4g} to {high[0]:.4g}, y {low[1]:.4g} to {high[1]:.4g}",
            "image": "" if self.image_size is None else "{:g} x {:g} pixels".format(*self.image_size),
            "criterion": scores.criterion,
            "also computed": ", ".join(name for name in scores.maps if name != scores.criterion),
            "control points": tried,
            "smoothing": smoothing,
            "also tried": ", ".join(scores.rivals),
            "lifting": str(self.asked["lifting"]),
            "fractional": _yes(self.asked["fractional"]) if "fractional" in self.asked else "",
            "placement": str(self.asked["placement"]),
            "weights": "one for each" if self.weighted else "all 1",
            "robust": _yes(self.searched),
            "queries": self._queries(),
            "selected model": self.model,
        }
        return {name: text for name, text in said.items() if text}

    def _queries(self) -> str:
        queries = self.asked["queries"]
        if queries is None:
            return "between the data"
        if isinstance(queries, str):
            return "all over the image"
        rectangle = "rectangle " + ", ".join(f"{side:g}" for side in np.ravel(queries)[:4])
        return rectangle if np.ndim(queries) == 1 else f"{len(queries)} points"

    def _curves(self) -> str:
        """The criteria as curves: those with a unit, and below them those without."""
        names = list(self.scores.maps)
        groups = [
            [name for name in names if name not in UNITLESS],
            [name for name in names if name in UNITLESS],
        ]
        figures = [self._axes(group).figure() for group in groups if group]
        return "".join(figures) or "<p>One model was tried.</p>"

    def _axes(self, names: Sequence[str]) -> report.Curves:
        scores = self.scores
        k, w = scores.place
        if weights_tell_more(scores):
            axis = f"weight of the bending energy, at {scores.counts[k]} control points"
            at, ticks = weight_positions(scores.weights), _powers(scores.weights)
            curves = {name: scores.maps[name][k] for name in names}
            words = [self._words(k, j) for j in range(len(scores.weights))]
            own = w
        else:
            axis, at, ticks = "number of control points", scores.counts.astype(float), []
            curves = {name: scores.curves[name] for name in names}
            words = [self._words(j, scores.best_weight(j)) for j in range(len(scores.counts))]
            own = k
        best = {
            name: None if np.isnan(curve).all() else int(np.nanargmin(curve))
            for name, curve in curves.items()
        }
        if scores.criterion in best:
            best[scores.criterion] = own
        others = {
            name: found[scores.criterion]
            for name, rival in scores.rivals.items()
            if scores.criterion in names and scores.criterion in (found := rival.best_scores())
        }
        unit = "score (no unit)" if names[0] in UNITLESS else self._with_unit("score")
        plain = {name: curve.tolist() for name, curve in curves.items()}
        return report.Curves(
            scores.criterion, at.tolist(), words, ticks, plain, best, axis, unit, own, others=others
        )

    def _words(self, k: int, w: int | None) -> str:
        """Say which model has a count and a weight."""
        scores = self.scores
        words = f"{scores.counts[k]} control points"
        if w is None or len(scores.weights) == 1:
            return words
        words += f", smoothing {scores.weights[w]:.3g}"
        parameters = math.nan if scores.parameters is None else float(scores.parameters[k, w])
        return words + ("" if math.isnan(parameters) else f", {parameters:.1f} effective parameters")

    def _criteria(self, table: str) -> str:
        lost = [
            f"{name} has no score at {len(by_count)} of {len(self.scores.counts)} numbers of control points."
            for name, by_count in self.scores.undefined.items()
            if by_count
        ]
        said = "<p>What each criterion would select; that in bold has selected.</p>"
        return f'{said}<div class="scroll">{table}</div>{notebook.notes(lost)}'

    def _outliers(self) -> str:
        """Data that were left out, and the largest residuals of the others."""
        parts = []
        if len(self.left_out):
            worst = self.left_out[np.argsort(-self.residuals[self.left_out], kind="stable")]
            parts.append(f"<div><h3>Left out as wrong: {len(worst)}</h3>{self._rows(worst)}</div>")
        worst = self.kept[np.argsort(-self.residuals[self.kept], kind="stable")][:_LISTED]
        hint = "" if self.searched else "<p>robust=True searches for wrong data, and leaves them out.</p>"
        parts.append(f"<div><h3>Largest residuals in the fit</h3>{self._rows(worst)}{hint}</div>")
        return f'<div class="figures">{"".join(parts)}</div>'

    def _rows(self, some: Integers) -> str:
        rows = [
            [f"{i}", *(f"{at:.6g}" for at in self.points[i]), f"{self.residuals[i]:.3g}"]
            for i in some[:_LISTED].tolist()
        ]
        more = f"<p>{len(some) - _LISTED} more: left_out has them all.</p>" if len(some) > _LISTED else ""
        table = notebook.table(["index from 0", "x", "y", self._with_unit("residual")], rows)
        return f'<div class="scroll">{table}</div>{more}'

    def _again(self) -> str:
        typed = "" if self.command is None else f"<h3>Command</h3>{report.code(self.command)}"
        said = "<p>sel.save(FILE) keeps all of the selection with its data, and mexpress.load reads it.</p>"
        return f"{typed}<h3>Python</h3>{report.code(self._call())}{said}"

    def _call(self) -> str:
        """The call that gives this selection, every argument written out."""
        names = ("source", "target") if self.kind == "warp" else ("points", "values")
        given = [f"{name}={_literal(name, value)}" for name, value in self.asked.items() if value is not None]
        own = "{" + ", ".join(f"{name!r}: ..." for name in self.schemes) + "}"
        also = [name for name in self.scores.maps if name != self.scores.criterion]
        given.insert(1, f"criteria={own if self.schemes else also}")
        if self.image_size is not None:
            given.append(f"image_size=({self.image_size[0]:g}, {self.image_size[1]:g})")
        given += ["weights=weights"] if self.weighted else []
        given += ["robust=True"] if self.searched else []
        given += ['missing="drop"'] if np.isnan(self.residuals).any() else []
        lines = "".join(f"    {argument},\n" for argument in given)
        data = f"    {names[0]}, {names[1]},  # {len(self.points)} {self._many}\n"
        return f"import mexpress as mx\n\nsel = mx.select_{self.kind}(\n{data}{lines})"


def _yes(value: bool) -> str:
    return "yes" if value else "no"


def _listed(values: Integers) -> str:
    return " and ".join(f"{value}" for value in values.tolist())


def _powers(weights: Floats) -> list[tuple[float, str]]:
    """Return places on the axis of weights, and what to write there."""
    at, above = weight_positions(weights), weights[weights > 0]
    powers = np.arange(math.ceil(math.log10(above[0]) - 1e-9), math.floor(math.log10(above[-1]) + 1e-9) + 1)
    ticks = [(float(power), f"1e{power}") for power in powers[:: -(-len(powers) // 6) or 1].tolist()]
    return ([(float(at[0]), "0")] if weights[0] == 0 else []) + (
        ticks or [(float(at[-1]), f"{weights[-1]:.3g}")]
    )


def _literal(name: str, value: Any) -> str:
    """Return an argument as it is written in Python; what is long is called by its name."""
    if name == "counts" and len(value) > 2 and np.ptp(np.diff(value)) == 0:
        step = value[1] - value[0]
        return f"range({value[0]}, {value[-1] + 1}{f', {step}' if step != 1 else ''})"
    text = repr(value)
    return text if len(text) <= 120 or isinstance(value, str) or name == "smoothing" else name
