"""The scores of all criteria as curves, with their values where the reader points."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape

from mexpress.report.drawing import WIDTH, axes, line, picture
from mexpress.report.scales import Scale

_LEFT, _RIGHT, _TOP, _BOTTOM, _HEIGHT = 74.0, WIDTH - 20.0, 34.0, 330.0, 384.0

_TALL, _DEEP = 8.0, 30.0
"""Values so many times above and below the selected one leave the picture."""

_COLOURS = 8
"""Colours of curves in the style sheet; the first is that of the criterion that selects."""


@dataclass(frozen=True)
class Curves:
    """Scores of the same models by several criteria.

    Parameters
    ----------
    criterion : str
        The one that selects; "" if none does.
    x : sequence of float
        Where the models are along the axis, increasing.
    names : sequence of str
        What each model is, in words.
    ticks : sequence of (float, str)
        Places along the axis, and what to write there; round values if there are none.
    scores : mapping of str to sequence of float
        By criterion; NaN where undefined.
    best : mapping of str to int or None
        Position of the model that each criterion selects of these.
    axis, unit : str
        What x is, and the unit of the scores.
    chosen : int
        Position of the model that the reader sees first.
    title : str
        Above the picture.
    others : mapping of str to float
        Scores by the criterion of models that are not on the axis, by name.
    """

    criterion: str
    x: Sequence[float]
    names: Sequence[str]
    ticks: Sequence[tuple[float, str]]
    scores: Mapping[str, Sequence[float]]
    best: Mapping[str, int | None]
    axis: str
    unit: str
    chosen: int
    title: str = ""
    others: Mapping[str, float] = field(default_factory=dict)

    def figure(self) -> str:
        """Return the picture with its legend, which has the values of one model: first of that which is selected.

        Examples
        --------
        >>> scores = {"FIT": [3.0, 1.0], "ER10": [4.0, 5.0]}
        >>> best = {"FIT": 1, "ER10": 0}
        >>> curves = Curves("ER10", [3, 9], ["3 points", "9 points"], [], scores, best, "points", "m", 0)
        >>> curves.figure().count("<li")
        2
        """
        known = [value for values in self.scores.values() for value in values if math.isfinite(value)]
        if len(self.x) < 2 or not known:
            return ""
        chosen = self.chosen
        x = Scale(self.x[0], self.x[-1], _LEFT + 12, _RIGHT - 12)
        y = self._height(known, chosen)
        names = [self.criterion, *(name for name in self.scores if name != self.criterion)]
        names = [name for name in names if name in self.scores]
        first = 0 if self.criterion in self.scores else 1
        colours = [(first + k) % _COLOURS for k in range(len(names))]
        drawn = axes(
            Scale(self.x[0], self.x[-1], _LEFT, _RIGHT),
            y,
            (self.axis, self.unit),
            [(x(at), word) for at, word in self.ticks]
            or [(x(at), f"{at:g}") for at in Scale(self.x[0], self.x[-1], 0, 1).ticks()],
        )
        window = f'x="{_LEFT}" y="{_TOP}" width="{_RIGHT - _LEFT}" height="{_BOTTOM - _TOP}"'
        inner = [
            *(
                line([(_LEFT, y(score)), (_RIGHT, y(score))], 'class="curve other"')
                for score in self.others.values()
                if math.isfinite(score) and score > 0
            ),
            *(self._curve(names[k], colours[k], x, y) for k in reversed(range(len(names)))),
            f'<g class="cursor"><path d="M{x(self.x[chosen]):.1f} {_TOP}V{_BOTTOM}"/></g>',
        ]
        view = f'viewBox="{_LEFT} {_TOP} {_RIGHT - _LEFT} {_BOTTOM - _TOP}"'
        drawn.append(f"<svg {window} {view}>{''.join(inner)}</svg>")
        label = f"Scores of {', '.join(names)} against the {self.axis}. Arrow keys move along it."
        svg = picture(label, _HEIGHT, drawn, 'tabindex="0"')
        content = escape(json.dumps(self._content(names, colours, x, y), allow_nan=False))
        title = f"<h3>{escape(self.title)}</h3>" if self.title else ""
        caption = f"<p><output>{escape(self.names[chosen])}</output></p>{self._legend(names, colours)}"
        return f'<figure class="chart" data-curves="{content}">{title}{svg}<figcaption>{caption}</figcaption></figure>'

    def _height(self, known: Sequence[float], chosen: int) -> Scale:
        """Scale of the scores: logarithmic if they span much."""
        low, high = min(known), max(known)
        if self.criterion in self.scores and self.scores[self.criterion][chosen] > 0:
            selected = self.scores[self.criterion][chosen]
            low, high = max(low, selected / _DEEP), min(high, _TALL * selected)
        if low > 0 and high > 3 * low:
            return Scale(low / 1.12, high * 1.12, _BOTTOM, _TOP, logarithmic=True)
        margin = 0.06 * ((high - low) or abs(high) or 1.0)
        return Scale(low - margin, high + margin, _BOTTOM, _TOP)

    def _curve(self, name: str, number: int, x: Scale, y: Scale) -> str:
        look = f'class="curve{" chosen" if name == self.criterion else ""} c{number}"'
        known = [(x(at), _place(y, value)) for at, value in zip(self.x, self.scores[name], strict=True)]
        drawn, best = line(known, look), self.best[name]
        if best is not None and math.isfinite(known[best][1]):
            size = 6 if name == self.criterion else 4
            drawn += f'<circle cx="{known[best][0]:.1f}" cy="{known[best][1]:.1f}" r="{size}" {look}/>'
        return drawn

    def _content(self, names: Sequence[str], colours: Sequence[int], x: Scale, y: Scale) -> dict[str, object]:
        """What the script needs: places, and words for each."""
        heights = [[_place(y, value) for value in self.scores[name]] for name in names]
        return {
            "chosen": self.chosen,
            "colours": list(colours),
            "x": [round(x(at), 1) for at in self.x],
            "names": list(self.names),
            "y": [[round(at, 1) if math.isfinite(at) else None for at in row] for row in heights],
            "values": [[_score(value) for value in self.scores[name]] for name in names],
        }

    def _legend(self, names: Sequence[str], colours: Sequence[int]) -> str:
        items = [
            f'<li class="c{colour}{" chosen" if name == self.criterion else ""}"><i></i><b>{escape(name)}</b> '
            f"<data>{_score(self.scores[name][self.chosen])}</data></li>"
            for name, colour in zip(names, colours, strict=True)
        ]
        items += [
            f'<li class="other"><i></i><b>{escape(name)}</b> {_score(score)} by {escape(self.criterion)}</li>'
            for name, score in self.others.items()
        ]
        return f"<ul>{''.join(items)}</ul>"


def _place(scale: Scale, value: float) -> float:
    """Return where a score is; what is not known, or below all of a logarithmic axis, is nowhere."""
    unknown = not math.isfinite(value) or (scale.logarithmic and value <= 0)
    return math.nan if unknown else scale(value)


def _score(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else "undefined"
