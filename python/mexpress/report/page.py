"""The page: its head with style and script, and sections with headings."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from importlib.resources import files

_NO_SCRIPT = (
    "<noscript><p>Scripts are off: curves, maps and pictures are shown, but do not answer.</p></noscript>"
)


def page(kind: str, result: str, facts: Sequence[tuple[str, str]], sections: Sequence[str]) -> str:
    """Return a whole page.

    Parameters
    ----------
    kind : str
        What was made, such as "warp selection".
    result : str
        What came out, in a sentence.
    facts : sequence of (str, str)
        The numbers that matter most, with their names.
    sections : sequence of str
        HTML of `section`.

    Examples
    --------
    >>> page("warp selection", "ER10 selects < 9", [("matches", "40")], [])[:15]
    '<!DOCTYPE html>'
    """
    own = files("mexpress.report")
    style, script = (own.joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    tiles = "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(text)}</dd></div>" for name, text in facts)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark"><link rel="icon" href="data:,">'
        f"<title>{escape(kind)}: {escape(result)}</title>\n<style>\n{style}</style></head>\n"
        f"<body><header><p>mexpress, {escape(kind)}</p><h1>{escape(result)}</h1><dl>{tiles}</dl></header>\n"
        f"<main>{_NO_SCRIPT}\n{chr(10).join(sections)}\n</main>\n<script>\n{script}</script></body></html>\n"
    )


def section(title: str, content: str, kind: str = "") -> str:
    """Return a section with its heading; nothing without content.

    Examples
    --------
    >>> section("Notes", "<p>None.</p>")
    '<section><h2>Notes</h2><p>None.</p></section>'
    """
    look = f' class="{kind}"' if kind else ""
    return f"<section{look}><h2>{escape(title)}</h2>{content}</section>" if content else ""


def code(text: str) -> str:
    """Return a program or a command, to be copied.

    Examples
    --------
    >>> code("a < b")
    '<pre tabindex="0"><code>a &lt; b</code></pre>'
    """
    return f'<pre tabindex="0"><code>{escape(text)}</code></pre>'
