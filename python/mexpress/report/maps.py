"""Maps: values all over a region as colours, or at points as dots, with axes and a colour bar."""

from __future__ import annotations

import base64
import json
import math
import struct
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mexpress._validation import Floats
from mexpress.report.drawing import WIDTH, axes, picture, text
from mexpress.report.scales import Scale, written

_LEFT, _TOP, _WIDE, _HIGH = 74.0, 30.0, WIDTH - 94.0, 430.0
"""Where a map begins, and how large it is at most."""

_BAR, _BELOW = 86.0, 44.0
"""From a map to its colour bar, and from there to the end."""

_READ = 48
"""Cells along the longer side of what the reader can ask for values."""

_STEPS = 256

# Anchors of colours, evenly spread from the smallest value to the largest.
FIELD = (
    "#440154", "#481a6c", "#472f7d", "#414487", "#39568c", "#31688e", "#2a788e", "#23888e",
    "#1f988b", "#22a884", "#35b779", "#54c568", "#7ad151", "#a5db36", "#d2e21b", "#fde725",
)  # fmt: skip
"""Viridis."""
HEAT = ("#3a7ebf", "#45a3a8", "#e3b23c", "#e07a2b", "#c4161c")
"""Told from light and from dark paper at both ends."""
SIGNED = ("#1f5fae", "#6fa3d8", "#c9ccd1", "#e39a78", "#b3261e")
"""The middle is zero."""

Colours = tuple[str, ...]


def colours_of(values: Floats, low: float, high: float, anchors: Colours) -> NDArray[np.uint8]:
    """Return the colours (..., 3) of values; ends are of what is beyond them, and NaN has that of the low end.

    Examples
    --------
    >>> colours_of(np.array([0.0, 5.0, 99.0]), 0, 10, ("#000000", "#ffffff")).tolist()
    [[0, 0, 0], [128, 128, 128], [255, 255, 255]]
    """
    table = np.array([[int(anchor[k : k + 2], 16) for k in (1, 3, 5)] for anchor in anchors], dtype=float)
    share = np.clip(np.nan_to_num((values - low) / ((high - low) or 1.0), nan=0.0, posinf=1.0), 0, 1)
    at = share * (len(anchors) - 1)
    channels = [np.interp(at, np.arange(len(anchors)), table[:, k]) for k in range(3)]
    return np.asarray(np.rint(np.stack(channels, axis=-1)), dtype=np.uint8)


def hexadecimal(colours: NDArray[np.uint8]) -> list[str]:
    """Return colours (n, 3) as CSS has them.

    Examples
    --------
    >>> hexadecimal(np.array([[255, 0, 16]], np.uint8))
    ['#ff0010']
    """
    return [f"#{red:02x}{green:02x}{blue:02x}" for red, green, blue in colours.tolist()]


def png(pixels: NDArray[np.uint8]) -> str:
    """Return an image (height, width, 4) of red, green, blue and opacity as the address of its own content.

    Examples
    --------
    >>> png(np.zeros((2, 3, 4), np.uint8))[:40]
    'data:image/png;base64,iVBORw0KGgoAAAANSU'
    """

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    height, width = pixels.shape[:2]
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    parts = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)),
        (b"IDAT", zlib.compress(rows, 9)),
    )
    content = b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*part) for part in (*parts, (b"IEND", b"")))
    return "data:image/png;base64," + base64.b64encode(content).decode()


@dataclass(frozen=True)
class Map:
    """A picture of a part of the plane.

    Parameters
    ----------
    x, y : Scale
        The axes.
    """

    x: Scale
    y: Scale

    @classmethod
    def over(cls, points: Floats, y_down: bool) -> Map:
        """Return the map that shows points with a margin, y downwards as an image has it or upwards.

        Examples
        --------
        >>> Map.over(np.array([[0.0, 0.0], [100.0, 100.0]]), y_down=True).y(0) < 100
        True
        """
        low, high = points.min(axis=0), points.max(axis=0)
        margin = 0.03 * float((high - low).max())
        (left, bottom), (right, top) = (low - margin).tolist(), (high + margin).tolist()
        size = min(_WIDE / (right - left), _HIGH / (top - bottom))
        begin = _LEFT + (_WIDE - size * (right - left)) / 2
        ends = (_TOP, _TOP + size * (top - bottom))
        x = Scale(left, right, begin, begin + size * (right - left))
        return cls(x, Scale(bottom, top, *(ends if y_down else ends[::-1])))

    @property
    def bottom(self) -> float:
        """Where the map ends."""
        return max(self.y.start, self.y.stop)

    def places(self, points: Floats) -> list[tuple[float, float]]:
        """Return where points (n, 2) are on the page."""
        return [(self.x(x), self.y(y)) for x, y in points.tolist()]

    def has(self, points: Floats) -> list[bool]:
        """Tell which points (n, 2) are on the map."""
        return [self.x.low <= x <= self.x.high and self.y.low <= y <= self.y.high for x, y in points.tolist()]

    def cells(self, longer: int) -> tuple[Floats, Floats]:
        """Return x and y of the centres of square cells all over the map, as the page has them: from the top left."""
        wide, high = self.x.stop - self.x.start, abs(self.y.stop - self.y.start)
        columns, rows = (max(2, round(longer * side / max(wide, high))) for side in (wide, high))
        x = self.x.low + (np.arange(columns) + 0.5) / columns * (self.x.high - self.x.low)
        y = self.y.low + (np.arange(rows) + 0.5) / rows * (self.y.high - self.y.low)
        return x, y if self.y.start < self.y.stop else y[::-1]

    def field(self, pixels: NDArray[np.uint8]) -> str:
        """Return pixels (rows, columns, 4) that fill the map."""
        top = min(self.y.start, self.y.stop)
        size = f'width="{self.x.stop - self.x.start:.1f}" height="{self.bottom - top:.1f}"'
        where = f'x="{self.x.start:.1f}" y="{top:.1f}" {size} preserveAspectRatio="none"'
        return f'<image {where} href="{png(pixels)}"/>'

    def figure(
        self,
        title: str,
        drawn: Iterable[str],
        bar: str,
        caption: str,
        names: tuple[str, str],
        values: Floats | None = None,
        unit: str = "",
    ) -> str:
        """Return the map with its axes, a colour bar below, and a caption; the reader can ask it for values.

        Parameters
        ----------
        title, caption : str
            In words; the caption is HTML.
        drawn : iterable of str
            What is on the map, in SVG.
        bar : str
            The colour bar, of `colour_bar`.
        names : tuple of str
            What x and y are.
        values : (rows, columns) array, optional
            What the colours say, as `cells` are.
        unit : str
            Of the values.
        """
        height = self.bottom + _BAR + _BELOW
        moved = f'<g transform="translate(0 {self.bottom + _BAR:.1f})">{bar}</g>'
        top = min(self.y.start, self.y.stop)
        box = f"{self.x.start:.1f} {top:.1f} {self.x.stop - self.x.start:.1f} {self.bottom - top:.1f}"
        x, y, wide, high = box.split()
        window = f'<svg x="{x}" y="{y}" width="{wide}" height="{high}" viewBox="{box}">{"".join(drawn)}</svg>'
        svg = picture(title, height, [window, *axes(self.x, self.y, names), moved])
        asked, answer = "", ""
        if values is not None:
            asked = f' data-map="{escape(json.dumps(self._content(values, unit)))}"'
            answer = '<output class="value" aria-hidden="true"></output>'
        return (
            f'<figure class="map"{asked}><h3>{escape(title)}</h3>{svg}{answer}'
            f"<figcaption>{caption}</figcaption></figure>"
        )

    def _content(self, values: Floats, unit: str) -> dict[str, Any]:
        """What the script needs to answer: cells that are coarse enough to be few."""
        step = -(-max(values.shape) // _READ)
        some = values[step // 2 :: step, step // 2 :: step]
        box = [self.x.start, min(self.y.start, self.y.stop), self.x.stop, self.bottom]
        return {
            "box": [round(side, 1) for side in box],
            "rows": [
                [float(f"{value:.3g}") if math.isfinite(value) else None for value in row]
                for row in some.tolist()
            ],
            "unit": unit,
        }


def colour_bar(low: float, high: float, anchors: Colours, name: str) -> str:
    """Return a colour bar as wide as a map can be.

    Examples
    --------
    >>> colour_bar(0, 1, FIELD, "error (pixels)").count("<image")
    1
    """
    scale = Scale(low, high, _LEFT, _LEFT + _WIDE)
    pixels = np.full((1, _STEPS, 4), 255, np.uint8)
    pixels[0, :, :3] = colours_of(np.linspace(0, 1, _STEPS), 0, 1, anchors)
    drawn = [
        f'<image x="{_LEFT}" y="0" width="{_WIDE}" height="12" preserveAspectRatio="none" href="{png(pixels)}"/>',
        text(_LEFT, -8, name, "start", 'class="name"'),
    ]
    ticks = scale.ticks()
    drawn += [text(scale(at), 30, word) for at, word in zip(ticks, written(ticks), strict=True)]
    return "".join(drawn)


def dots(
    places: Sequence[tuple[float, float]], colours: Sequence[str], words: Sequence[str], size: float
) -> list[str]:
    """Return a dot at each place, with words for who points at it.

    Examples
    --------
    >>> dots([(1, 2)], ["#ffffff"], ["match 0"], 4)
    ['<circle cx="1.0" cy="2.0" r="4" fill="#ffffff" class="dot"><title>match 0</title></circle>']
    """
    return [
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{size:g}" fill="{colour}" class="dot">'
        f"<title>{escape(word)}</title></circle>"
        for (x, y), colour, word in zip(places, colours, words, strict=True)
    ]


def crosses(places: Iterable[tuple[float, float]], words: Iterable[str]) -> list[str]:
    """Return a cross at each place.

    Examples
    --------
    >>> crosses([(10, 20)], ["match 0"])
    ['<path d="M5.0 15.0l10 10m0-10l-10 10" class="cross"><title>match 0</title></path>']
    """
    return [
        f'<path d="M{x - 5:.1f} {y - 5:.1f}l10 10m0-10l-10 10" class="cross"><title>{escape(word)}</title></path>'
        for (x, y), word in zip(places, words, strict=True)
    ]
