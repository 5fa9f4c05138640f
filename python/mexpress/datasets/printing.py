"""A page with text, a figure and patterns of lines, drawn dot by dot."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Image: TypeAlias = NDArray[np.uint8]

PAGE = (1188, 840)
"""Width and height of the page in pixels: A4, four pixels to the millimetre."""

PAPER, INK, BLUE, RED = (247, 245, 238), (34, 34, 40), (0, 96, 160), (200, 70, 20)

TITLE = "How complex should this warp be?"

TEXT = (
    "A page is printed flat, and somebody takes a photo of it while it lies bent on a table. Matches between both "
    "tell where some of its points are in the photo; a warp tells where all of them are. With few control points "
    "it is too stiff to follow the bending. With many it follows the noise of every match, and is wrong between "
    "them. The error of the fit cannot tell, since it always falls. So leave a match out, fit the others, and see "
    "how well they predict it. Where matches are dense, its neighbours give the answer away: leave them out as "
    "well. All this needs no second fit, for there is a formula. It says which warp to take, and by how much it "
    "will be wrong."
)

# Five columns of dots a character, the top one in the lowest bit: those characters that the page needs.
FONT = {
    " ": "0000000000", ",": "0050300000", ".": "0060600000", "?": "0201510906", ":": "0036360000",
    ";": "0056360000", "A": "7e1111117e", "H": "7f0808087f", "I": "00417f4100", "M": "7f020c027f",
    "S": "4649493131", "T": "01017f0101", "W": "3f4038403f", "a": "2054545478", "b": "7f48444438",
    "c": "3844444420", "d": "384444487f", "e": "3854545418", "f": "087e090102", "g": "0c5252523e",
    "h": "7f08040478", "i": "00447d4000", "k": "7f10284400", "l": "00417f4000", "m": "7c04180478",
    "n": "7c08040478", "o": "3844444438", "p": "7c14141408", "r": "7c08040408", "s": "4854545420",
    "t": "043f444020", "u": "3c4040207c", "v": "1c2040201c", "w": "3c4030403c", "x": "4428102844",
    "y": "0c5050503c",
}  # fmt: skip

MARGIN, MIDDLE, TOP, BOTTOM = 72, 624, 152, 776
"""Left edges of both columns, and the rows between which they are."""

COLUMN = 492
"""Width of a column."""


@lru_cache(maxsize=1)
def printed() -> Image:
    """Return the page, (840, 1188, 3), red, green and blue; it is made once, and cannot be written to.

    Examples
    --------
    >>> printed().shape
    (840, 1188, 3)
    """
    page = np.full((PAGE[1], PAGE[0], 3), PAPER, dtype=np.float64)
    write(page, [TITLE], (MARGIN, 60), 5, 0)
    page[116:119, MARGIN : MIDDLE + COLUMN] = INK
    write(page, wrapped(TEXT, COLUMN // 12), (MARGIN, TOP), 2, 27)
    draw_board(page, MARGIN, BOTTOM - COLUMN // 6)
    draw_figure(page, MIDDLE, TOP)
    draw_targets(page, MIDDLE, 560)
    softened = page.copy()
    softened[1:-1, 1:-1] = blurred(page)
    image = np.rint(softened).astype(np.uint8)
    image.flags.writeable = False
    return image


def paint(page: NDArray[Any], cover: NDArray[Any], colour: tuple[int, int, int]) -> None:
    """Cover pixels with a colour, each by a share from 0 to 1."""
    page += cover.clip(0, 1)[..., None] * (np.array(colour) - page)


def blurred(page: NDArray[Any]) -> NDArray[Any]:
    """Return the inner pixels, each a mean with its neighbours: ink runs a little."""
    across = page[:, :-2] + 2 * page[:, 1:-1] + page[:, 2:]
    return np.asarray((across[:-2] + 2 * across[1:-1] + across[2:]) / 16)


def wrapped(text: str, width: int) -> list[str]:
    """Return lines of whole words, of `width` characters at most."""
    lines = [""]
    for word in text.split():
        if len(lines[-1]) + len(word) + 1 > width:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".lstrip()
    return lines


def write(page: NDArray[Any], lines: list[str], place: tuple[int, int], dot: int, step: int) -> None:
    """Write lines of text, `step` pixels apart, with dots of a size."""
    x, y = place
    for line in lines:
        columns = np.frombuffer(b"".join(bytes.fromhex(FONT[letter] + "00") for letter in line), np.uint8)
        dots = columns >> np.arange(8, dtype=np.uint8)[:, None] & 1
        ink = np.kron(dots, np.ones((dot, dot)))
        paint(page[y : y + ink.shape[0], x : x + ink.shape[1]], ink, INK)
        y += step


def draw_board(page: NDArray[Any], left: int, top: int) -> None:
    """Draw a chequered strip of two rows of twelve squares."""
    ink = np.kron(np.tile([[1, 0], [0, 1]], 6), np.ones((COLUMN // 12, COLUMN // 12)))
    paint(page[top : top + ink.shape[0], left : left + ink.shape[1]], ink, INK)


def draw_figure(page: NDArray[Any], left: int, top: int) -> None:
    """Draw two criteria against the number of control points: one falls for ever, one rises again."""
    high, wide = 369, COLUMN
    part = page[top : top + high, left : left + wide]
    y, x = np.mgrid[:high, :wide].astype(float)
    for along in (x, y):
        paint(part, 0.35 * ((along % 41) < 2), INK)
    part[[*range(3), *range(-3, 0)]] = INK
    part[:, [*range(3), *range(-3, 0)]] = INK
    share = x / wide
    for height, colour in (
        (0.12 + 0.62 * np.exp(-4 * share), BLUE),
        (0.30 + 0.55 * np.exp(-6 * share) + 0.45 * share**3, RED),
    ):
        curve = high * (1 - height)
        steepness = np.hypot(1, np.gradient(curve, axis=1))
        paint(part, 3 - np.abs(y - curve) / steepness, colour)


def draw_targets(page: NDArray[Any], left: int, top: int) -> None:
    """Draw rings, and a star beside them."""
    size = BOTTOM - top
    right = left + COLUMN - size
    y, x = np.mgrid[:size, :size] - (size - 1) / 2
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    inside = size / 2 - radius
    rings = np.where(inside > 0, 2 - np.abs(radius % 20 - 10), 0)
    star = np.minimum(inside, np.sin(12 * angle) * radius / 12 + 0.5)
    paint(page[top:BOTTOM, left : left + size], rings, BLUE)
    paint(page[top:BOTTOM, right : right + size], star, INK)
