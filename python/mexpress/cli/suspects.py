"""`mexpress suspects`: which matches look wrong."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from mexpress import _validation as check
from mexpress.cli import common
from mexpress.cli import report as reports
from mexpress.io import matches
from mexpress.selection import WarpSelection, select_warp
from mexpress.selection.data import present
from mexpress.selection.incomplete import DROP, spread
from mexpress.selection.robust import THRESHOLD
from mexpress.suspicion import Suspects


def add_suspects(commands: argparse._SubParsersAction[common.Parser]) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "suspects",
        help="list matches that look wrong",
        description="List the matches that the warp which is selected without them contradicts, the worst first. A "
        "score is how far a match is from its prediction, in units of the noise or, where they are larger, of the "
        "errors of the matches around. Matches are counted from 0, as rows of the data. `mexpress warp --robust` "
        "leaves such matches out.",
    )
    add = parser.add_argument
    common.add_matches(parser)
    add("--no-fractional", dest="fractional", action="store_false", help="without perspective")
    add(
        "--threshold",
        type=float,
        default=THRESHOLD,
        metavar="T",
        help=f"list matches with a score above it (default: {THRESHOLD:g})",
    )
    add(
        "--radius",
        type=float,
        default=0.0,
        metavar="PERCENT",
        help="predict each match without all others within so much of the diagonal, for wrong matches in clusters "
        "(default: 0)",
    )
    common.add_threads(parser)
    common.add_json(parser)
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> None:
    check.positive(arguments.threshold, "threshold")  # before the long work
    check.number(arguments.radius, "radius", "It must be a number of at least 0.", 0.0)
    with common.warnings_as_lines():
        given = matches.read_weighted_matches(arguments.matches, None, **common.table_options(arguments))
        selection = select_warp(
            spread(given.source, given.known),
            spread(given.target, given.known),
            fractional=arguments.fractional,
            weights=None if given.weights is None else spread(given.weights, given.known),
            missing=DROP,
            threads=arguments.threads,
            progress=not arguments.quiet,
        )
        found = selection.suspects(arguments.threshold, arguments.radius, arguments.threads)
    content = listed(selection, found)
    _warn_of_unscored(selection, found, arguments.radius)
    if arguments.json:
        print(reports.as_json(content))
        return
    n = int(np.isfinite(found.scores).sum())
    suspects = content["suspects"]
    if not n and not suspects:
        print("no match has a score, so none is judged")
        return
    print(f"{len(suspects)} of {n} matches look wrong: scores above {found.threshold:g}")
    if suspects:
        print(f"\n{'match':>7} {'score':>10} {'x1':>11} {'y1':>11} {'x2':>11} {'y2':>11}")
    for each in suspects:
        places = " ".join(f"{number:11.6g}" for number in each["source"] + each["target"])
        print(f"{each['match']:7} {each['score']:10.3g} {places}")


def _warn_of_unscored(selection: WarpSelection, found: Suspects, radius: float) -> None:
    """Say how many matches have no score, and why, but for those of weight 0 and those that are missing."""
    some = present(selection.data)
    lost = int(np.isnan(found.scores[some]).sum())
    if lost:
        common.warn(
            f"{lost} of {len(some)} matches have no score: those farther away than --radius {radius:g} do not "
            "determine their predictions; a smaller one may do"
        )


def listed(selection: WarpSelection, found: Suspects) -> dict[str, Any]:
    """Return suspects as plain values.

    Returns
    -------
    dict
        ``threshold``; ``sigma``, the noise in pixels; ``doubt``, reasons to doubt all this, or an empty text;
        ``suspects``, the worst first: ``match``, which counts the rows of the data from 0, ``score``, ``source`` and
        ``target``; and the ``scores`` of all matches, NaN where there is none.

    Examples
    --------
    >>> source = np.random.default_rng(0).uniform(0, 100, (60, 2))
    >>> target = source + np.sin(source / 30)
    >>> target[7] += 20
    >>> selection = select_warp(source, target)
    >>> [each["match"] for each in listed(selection, selection.suspects())["suspects"]]
    [7]
    """
    return {
        "threshold": found.threshold,
        "sigma": found.sigma,
        "doubt": found.doubt,
        "suspects": [
            {
                "match": match,
                "score": float(found.scores[match]),
                "source": selection.source[match].tolist(),
                "target": selection.target[match].tolist(),
            }
            for match in found.indices.tolist()
        ],
        "scores": found.scores.tolist(),
    }
