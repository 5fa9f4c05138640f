"""What notebooks show of results: HTML of titles, facts, tables, curves and notes, from plain data.

It is HTML alone, without script, style sheet or network. All text is escaped. Lines and letters have the colour of the
text around them, on dark pages too.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from html import escape

ACCENT = "#d55e00"
"""Colour of what is chosen; it is told from black and from white."""

_LINE = f'stroke="{ACCENT}" stroke-width="1.8"'

_WIDTH, _HEIGHT, _EDGE = 340, 170, 10
"""Size of a picture in pixels, and what its lines leave free on every side."""

_TALL = 8.0
"""Values so many times above the chosen one leave the picture."""


def card(title: str, *parts: str) -> str:
    """Return the HTML of a result: its title, and parts below it, which are HTML already.

    Examples
    --------
    >>> card("a < b", notes([]))
    '<div style="max-width:60em"><p><b>a &lt; b</b></p></div>'
    """
    return f'<div style="max-width:60em"><p><b>{escape(title)}</b></p>{"".join(parts)}</div>'


def facts(values: Mapping[str, str]) -> str:
    """Return a table of names and what there is to say of each.

    Examples
    --------
    >>> facts({"unit": "m"}).count("<td")
    1
    """
    look = 'style="text-align:left;padding:2px 8px"'
    rows = (
        f"<tr><th {look}>{escape(name)}</th><td {look}>{escape(text)}</td></tr>"
        for name, text in values.items()
    )
    return f"<table>{''.join(rows)}</table>"


def table(heads: Sequence[str], rows: Iterable[Sequence[str]], chosen: Collection[str] = ()) -> str:
    """Return a table; rows whose first cell is among the chosen ones stand out.

    Examples
    --------
    >>> table(["criterion", "score"], [["FIT", "1.5"], ["ER10", "2.5"]], ["ER10"]).count("font-weight:bold")
    1
    """
    text = [_row("th", heads, "")]
    text += [_row("td", row, "font-weight:bold" if row[0] in chosen else "") for row in rows]
    return f"<table>{''.join(text)}</table>"


def _row(tag: str, cells: Sequence[str], style: str) -> str:
    sides = ("left", *("right" for _ in cells[1:]))
    written = (
        f'<{tag} style="text-align:{side};padding:2px 8px">{escape(cell)}</{tag}>'
        for side, cell in zip(sides, cells, strict=True)
    )
    return f'<tr style="{style}">{"".join(written)}</tr>'


def notes(sentences: Sequence[str]) -> str:
    """Return a list of sentences; nothing if there are none.

    Examples
    --------
    >>> notes(["Two data look wrong."])
    '<ul><li>Two data look wrong.</li></ul>'
    """
    items = "".join(f"<li>{escape(sentence)}</li>" for sentence in sentences)
    return f"<ul>{items}</ul>" if items else ""


def curve(
    name: str,
    x: Sequence[float],
    y: Sequence[float],
    chosen: int,
    marks: Sequence[str],
    axis: str,
    rival: tuple[str, float] | None = None,
) -> str:
    """Return a picture of a curve with one of its points marked, and of what was chosen instead, if anything was.

    Parameters
    ----------
    name : str
        Of the values.
    x, y : sequence of float
        The points; x increases. Where y is NaN or infinite, there is no line. The scale is logarithmic if values span
        much.
    chosen : int
        Position of the point that is marked, where y is finite.
    marks : sequence of str
        What to write at the first, the chosen and the last x.
    axis : str
        What x is.
    rival : (str, float), optional
        Name and value of what has no x and was chosen: a line across. The mark is then hollow.

    Returns
    -------
    str
        SVG.

    Examples
    --------
    >>> curve("score", [3, 4, 5], [2.0, 1.0, 1.5], 1, ["3", "4", "5"], "control points").count("<circle")
    1
    """
    low, high = _span([*y, *([] if rival is None else rival[1:])], y[chosen])
    scaled = math.log if low > 0 and high > 3 * low else float
    left, right, top, bottom = 64.0, _WIDTH - 4.0 * _EDGE, 26.0, _HEIGHT - 40.0
    across = (right - left) / ((x[-1] - x[0]) or 1.0)
    up = (bottom - top) / ((scaled(high) - scaled(low)) or 1.0)

    def level(value: float) -> float:
        return bottom - up * (scaled(min(value, high)) - scaled(low))

    places = [
        (left + across * (at - x[0]), level(value)) if math.isfinite(value) else (math.nan, math.nan)
        for at, value in zip(x, y, strict=True)
    ]
    middle, height = places[chosen]
    drawn = [
        _path([(left, top), (left, bottom), (right, bottom)], 'stroke-opacity="0.4"'),
        _path(places, 'stroke-width="1.8"'),
        *(_text(left - 8, at + 4, f"{value:.4g}", "end") for at, value in ((top, high), (bottom, low))),
        *(
            _text(at, bottom + 17, mark)
            for at, mark in ((left, marks[0]), (right, marks[2]))
            if abs(at - middle) > 45
        ),
        _text(left, top - 12, name, "start"),
        _text((left + right) / 2, bottom + 34, axis),
        _text(middle, bottom + 17, marks[1], weight="bold"),
        f'<circle cx="{middle:.1f}" cy="{height:.1f}" r="4.5" fill="{"none" if rival else ACCENT}" {_LINE}/>',
        *([] if rival is None else _across(*rival, (left, right), level(rival[1]), top - 12)),
    ]
    return _picture(f"{name}, {axis}", drawn)


def _across(name: str, value: float, ends: tuple[float, float], height: float, above: float) -> Iterator[str]:
    """Return a line across a picture, and what it is, above the picture."""
    yield f'<path d="{path_data((x, height) for x in ends)}" {_LINE} stroke-dasharray="6 3"/>'
    yield _text(ends[1], above, f"{name}: {value:.4g}", "end", "bold", ACCENT)


def _span(y: Sequence[float], best: float) -> tuple[float, float]:
    """Return the least value, and the largest that is shown."""
    known = [value for value in y if math.isfinite(value)]
    return min(known), min(max(known), _TALL * best) if best > 0 else max(known)


def wires(name: str, lines: Sequence[Sequence[tuple[float, float]]]) -> str:
    """Return a picture of lines in the plane, y downwards, as large as there is room; they break where they are NaN.

    Examples
    --------
    >>> wires("a cross", [[(0, 0), (2, 1)], [(0, 1), (2, 0)]]).count("<path")
    2
    """
    known = [place for line in lines for place in line if all(map(math.isfinite, place))]
    if not known:
        return ""
    (left, right), (top, bottom) = ((min(axis), max(axis)) for axis in zip(*known, strict=True))
    size = min(
        (_WIDTH - 2 * _EDGE) / ((right - left) or 1.0), (_HEIGHT - 2 * _EDGE) / ((bottom - top) or 1.0)
    )
    shown = [[(_EDGE + size * (x - left), _EDGE + size * (y - top)) for x, y in line] for line in lines]
    return _picture(name, [_path(line, 'stroke-opacity="0.75"') for line in shown])


def path_data(places: Iterable[tuple[float, float]]) -> str:
    """Return a line for the attribute d of a path in SVG; it breaks where it is not known.

    Examples
    --------
    >>> path_data([(0, 0), (1, 2), (math.nan, 0), (3, 4), (5, 5)])
    'M0 0L1 2M3 4L5 5'
    """
    steps, pen = [], "M"
    for x, y in places:
        if math.isfinite(x) and math.isfinite(y):
            steps.append(f"{pen}{round(x, 1):g} {round(y, 1):g}")
            pen = "L"
        else:
            pen = "M"
    return "".join(steps)


def _path(places: Sequence[tuple[float, float]], look: str) -> str:
    return f'<path d="{path_data(places)}" fill="none" stroke="currentColor" {look}/>'


def _text(
    x: float,
    y: float,
    text: str,
    anchor: str = "middle",
    weight: str = "normal",
    colour: str = "currentColor",
) -> str:
    where = f'x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" font-weight="{weight}"'
    return f'<text {where} fill="{colour}">{escape(text)}</text>'


def _picture(name: str, drawn: Sequence[str]) -> str:
    size = f'width="{_WIDTH}" height="{_HEIGHT}" viewBox="0 0 {_WIDTH} {_HEIGHT}"'
    look = 'font-family="sans-serif" font-size="12"'
    return f'<svg role="img" {size} {look}><title>{escape(name)}</title>{"".join(drawn)}</svg>'
