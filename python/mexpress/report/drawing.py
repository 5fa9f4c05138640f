"""Parts of pictures in SVG: lines, texts and axes, in units of which a picture is 560 wide."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from mexpress.notebook import path_data
from mexpress.report.scales import Scale, written

WIDTH = 560.0

_APART = 80.0, 40.0
"""From tick to tick at least, along x and y."""


def text(x: float, y: float, words: str, anchor: str = "middle", look: str = "") -> str:
    """Return a text.

    Examples
    --------
    >>> text(1, 2, "a < b")
    '<text x="1.0" y="2.0" text-anchor="middle">a &lt; b</text>'
    """
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{look and " " + look}>{escape(words)}</text>'


def line(places: Iterable[tuple[float, float]], look: str) -> str:
    """Return a line, which breaks where it is not known.

    Examples
    --------
    >>> line([(0, 0), (1, 2), (float("nan"), 0), (3, 4), (5, 5)], 'class="curve"')
    '<path d="M0 0L1 2M3 4L5 5" class="curve"/>'
    """
    return f'<path d="{path_data(places)}" {look}/>'


def axes(
    x: Scale, y: Scale, names: tuple[str, str], at: Sequence[tuple[float, str]] | None = None
) -> list[str]:
    """Return the frame of a picture with its ticks; `at` are those of x, if they are not values of its scale.

    Examples
    --------
    >>> len(axes(Scale(0, 1, 60, 540), Scale(0, 1, 300, 20), ("x", "y")))
    27
    """
    left, right, top, bottom = x.start, x.stop, min(y.start, y.stop), max(y.start, y.stop)
    drawn = [
        f'<rect x="{left:.1f}" y="{top:.1f}" width="{right - left:.1f}" height="{bottom - top:.1f}" class="frame"/>'
    ]
    values = x.ticks(round(min(6, max(1, (right - left) / _APART[0]))))
    heights = y.ticks(round(min(6, max(1, (bottom - top) / _APART[1]))))
    for place, word in at or [(x(value), word) for value, word in zip(values, written(values), strict=True)]:
        drawn += [
            line([(place, bottom), (place, bottom + 5)], 'class="tick"'),
            text(place, bottom + 22, word),
        ]
    for value, word in zip(heights, written(heights), strict=True):
        drawn += [
            line([(left - 5, y(value)), (left, y(value))], 'class="tick"'),
            text(left - 9, y(value) + 5, word, "end"),
        ]
    drawn += [
        text((left + right) / 2, bottom + 46, names[0], look='class="name"'),
        text(left, top - 10, names[1], "start", 'class="name"'),
    ]
    return drawn


def picture(name: str, height: float, drawn: Iterable[str], look: str = "") -> str:
    """Return a picture of a name, which those hear who do not see it.

    Examples
    --------
    >>> picture("nothing", 10, [])
    '<svg role="img" aria-label="nothing" viewBox="0 0 560 10"></svg>'
    """
    size = f'viewBox="0 0 {WIDTH:.0f} {height:.0f}"'
    return f'<svg role="img" aria-label="{escape(name)}" {size}{look and " " + look}>{"".join(drawn)}</svg>'
