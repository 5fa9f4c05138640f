"""`mexpress warp`: select and fit the warp between two images."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mexpress.cli import common
from mexpress.io import matches
from mexpress.io.images import read_image
from mexpress.selection import WarpSelection, select_warp
from mexpress.selection.incomplete import DROP, spread
from mexpress.selection.notes import failures

_IMAGE_SIZE_HELP = (
    "size of the source image in pixels, such as 1920x1080: ERxx is in percent of its diagonal "
    "(default: that of --source-image, else of the matches' bounding box)"
)


def add_warp(commands: argparse._SubParsersAction[common.Parser]) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "warp",
        help="select and fit the warp between two images",
        description="Fit warps from stiff to flexible to matched points of two images, and select one: by default of "
        "those that many weights of the bending energy give, and an affine map. The output directory gets "
        "selection.json, curves.csv, warp.npz, curves.png, warp.png, and with both images registered.png.",
    )
    add = parser.add_argument
    common.add_matches(parser)
    add("--image-size", type=_image_size, metavar="WxH", help=_IMAGE_SIZE_HELP)
    add("--no-fractional", dest="fractional", action="store_false", help="without perspective")
    add(
        "--counts",
        type=_counts,
        metavar="A:B[:STEP]",
        help="numbers of control points, B included; or a list, 3,5,9 (default: 3 and as many as matches, at most "
        "250 to 900; without --smoothing auto, 3 to half as many, at most 100)",
    )
    common.add_selection(parser, "nested or lloyd (default: nested, or lloyd with one weight)")
    add("--source-image", type=Path, metavar="FILE", help="for registered.png and the report")
    add("--target-image", type=Path, metavar="FILE", help="for registered.png and the report")
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> None:
    with common.warnings_as_lines():
        given = matches.read_weighted_matches(
            arguments.matches, arguments.weights or arguments.sigma, **common.table_options(arguments)
        )
    weights = common.as_weights(arguments, given.weights)
    images = _images(arguments)
    size = arguments.image_size
    if size is None and images:
        size = images[0].shape[1::-1]
    arguments.out.mkdir(parents=True, exist_ok=True)
    # Among all rows of the file, so that indices are those of its rows.
    selection = select_warp(
        spread(given.source, given.known),
        spread(given.target, given.known),
        fractional=arguments.fractional,
        counts=arguments.counts,
        image_size=size,
        weights=None if weights is None else spread(weights, given.known),
        missing=DROP,
        **common.selection_options(arguments),
    )
    health = _health(selection)
    n_missing = int((~given.known).sum())
    if not arguments.json:
        _print(selection, health, n_missing)
    common.warn_of_notes(selection)
    more = {"n_matches": len(given.source), "n_missing": n_missing, "image_size": size, "warp": health}
    written = common.write_selection(arguments, selection, more)
    selection.warp.save(arguments.out / "warp.npz")
    written += ["warp.npz", *common.draw(arguments, _plots(selection, images))]
    common.write_report(arguments, lambda path, command: selection.report(path, *images, command=command))
    common.print_end(arguments, "selection.json", written)


def _images(arguments: argparse.Namespace) -> list[NDArray[Any]]:
    """Read both images, if both are given: before the long work, so that a wrong name costs no time."""
    paths = [arguments.source_image, arguments.target_image]
    if paths == [None, None]:
        return []
    if None in paths:
        raise common.UsageError("--source-image and --target-image belong together")
    return [read_image(path) for path in paths]


def _health(selection: WarpSelection) -> dict[str, Any]:
    """Return what there is to know about a warp besides its score."""
    warp, kept = selection.warp, selection.kept
    errors = np.hypot(*(selection.target[kept] - warp(selection.source[kept])).T)
    errors[np.isnan(errors)] = np.inf  # beyond the horizon
    folded, vanishing = failures(warp)
    return {
        "file": "warp.npz",
        "lifting": warp.lifting.name,
        "fractional": warp.fractional,
        "control_points": warp.control_points.tolist(),
        "transfer_error": common.sizes_summary(errors),
        "folded": folded,
        "vanishing": vanishing,
    }


def _print(selection: WarpSelection, health: dict[str, Any], n_missing: int) -> None:
    counts, n = selection.counts, len(selection.source) - n_missing
    form = "fractional " if health["fractional"] else ""
    tried = (
        f"{counts[0]} to {counts[-1]} control points" if len(counts) > 1 else f"{counts[0]} control points"
    )
    print(
        f"{n} matches{common.missing_text(n_missing)}, {form}{health['lifting']} warps with {tried}; pixels; "
        "* smallest\n"
    )
    remark = "PRESS averages over the rows of the design, the others over the matches."
    common.print_selection(selection, "selection.json", remark if "PRESS" in selection.curves else "")
    errors = common.sizes_text(health["transfer_error"])
    print(f"Distance of the warped source points to the target points, in pixels: {errors}.")


def _plots(selection: WarpSelection, images: list[NDArray[Any]]) -> dict[str, Callable[[Path], Any]]:
    plots: dict[str, Callable[[Path], Any]] = {"curves.png": selection.plot, "warp.png": selection.plot_warp}
    if images:
        plots["registered.png"] = partial(selection.plot_registration, images[0], images[1])
    return plots


def _image_size(text: str) -> tuple[float, float]:
    parts = re.fullmatch(r"(\d+(?:\.\d+)?)[xX×](\d+(?:\.\d+)?)", text.strip())
    size = (float(parts[1]), float(parts[2])) if parts else (0.0, 0.0)
    if min(size) <= 0:
        raise argparse.ArgumentTypeError(f"must be WIDTHxHEIGHT in pixels, such as 1920x1080, not {text!r}")
    return size


def _counts(text: str) -> list[int]:
    try:
        if ":" not in text:
            return [int(part) for part in text.split(",")]
        first, last, *step = map(int, text.split(":"))
        (stride,) = step or (1,)
        counts = list(range(first, last + 1, stride))
    except ValueError:
        counts = []
    if not counts:
        message = f"must be first:last, first:last:step or a list such as 3,5,9, not {text!r}"
        raise argparse.ArgumentTypeError(message)
    return counts
