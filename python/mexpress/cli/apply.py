"""`mexpress apply`: evaluate a saved model at points, or move an image."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from mexpress import _validation as check
from mexpress._validation import Floats
from mexpress.cli import common
from mexpress.cli.apply_image import apply_image, whole_size
from mexpress.geometry import inside
from mexpress.io import matches
from mexpress.io.endings import is_image, is_text
from mexpress.io.missing import DROP, KEEP
from mexpress.models import FittedModel
from mexpress.models.surface import Surface
from mexpress.models.warp import Warp
from mexpress.selection.files import load


def add_apply(commands: argparse._SubParsersAction[common.Parser]) -> None:
    """Add the command."""
    parser = commands.add_parser(
        "apply",
        help="evaluate a saved model at points, or move an image",
        description="Map points from the source image to the target image with the warp in a file, or evaluate "
        "the surface in a file at points: a depth or a point in space, as columns x, y, z. Points that are "
        "nan have rows of nan, so that results are read like any points. If the model has the data of its fit, a "
        "column error has the error to expect: the root mean square difference from a measurement, its norm if there "
        "are several values. An image is moved as its points would be: a source image into the frame of the target "
        "image, or with --inverse a target image into that of the source image.",
    )
    add = parser.add_argument
    add(
        "model",
        metavar="MODEL",
        type=Path,
        help="warp.npz of `mexpress warp`, or surface.npz of `mexpress surface`",
    )
    add(
        "points",
        metavar="POINTS",
        type=Path,
        help="text with columns x y, .npz, .npy or .parquet; an image; - is standard input",
    )
    common.add_table(parser, "x,y")
    add(
        "--inverse",
        action="store_true",
        help="of a warp: from the target image to the source image; nan where impossible, and no errors",
    )
    add(
        "--size",
        type=whole_size,
        metavar="WxH",
        help="of an image: size of the result in pixels (default: that of the image)",
    )
    add("--out", type=Path, metavar="FILE", help="where to write (default: standard output, but of an image)")
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> None:
    model = _load(arguments.model)
    if is_image(arguments.points):
        apply_image(model, arguments)
        return
    if arguments.size is not None:
        raise common.UsageError("--size belongs to an image, and POINTS is none")
    if arguments.out is not None and not is_text(arguments.out):
        raise common.UsageError(
            f"--out must be text, such as points.csv, for points, not {arguments.out.name}"
        )
    points = _read(arguments)
    known = np.asarray(np.isfinite(points).all(axis=1))
    if not known.all():
        common.warn(f"{(~known).sum()} of {len(points)} points are not known, and nan in the result")
    if isinstance(model, Warp):
        mapped = model.inverse(points) if arguments.inverse else model(points)
        _write(mapped, None if arguments.inverse else _error(model, points), arguments.out)
        if not arguments.inverse:
            _warn_of_gaps(model, np.where(np.isnan(mapped), np.nan, points))
        _warn_doubtful(model, points, mapped, arguments.inverse)
    else:
        if arguments.inverse:
            raise common.UsageError("--inverse belongs to a warp: a surface has no inverse")
        table = model(points)
        # A depth with its position is a point in space, which can be read again.
        if table.shape[1:] in ((), (1,)):
            table = np.column_stack([np.where(known[:, None], points, np.nan), table])
        _write(table, _error(model, points), arguments.out)
        _warn_of_gaps(model, points)
        common.warn_outside(model.domain, points[known], len(points), "the region of the data: the surface")


def _load(path: Path) -> FittedModel:
    """Load a model, or that of a selection; the files are given in the wrong order at times."""
    try:
        model = common.model_of(load(path))
    except ValueError as error:
        order = "It must be a saved model, such as warp.npz, and come first; the points come second."
        given = str(error).partition(" Given ")[2].removesuffix(".")
        check.refuse("MODEL", order, given)
    if not isinstance(model, Warp | Surface):
        check.refuse("MODEL", "It must be a warp or a surface.", f"{model!r} in {path}")
    return model


def _read(arguments: argparse.Namespace) -> Floats:
    """Read the points: a row of the result for each, NaN if something is missing, unless such rows are dropped."""
    missing = arguments.missing or []
    return matches.read_points(
        arguments.points,
        columns=arguments.columns,
        missing=missing if DROP in missing else [*missing, KEEP],
    )


def _error(model: FittedModel, points: Floats) -> Floats | None:
    """Return the error to expect, if the model has its data."""
    return None if model.data is None else model.error(points)


def _warn_of_gaps(model: FittedModel, points: Floats) -> None:
    """Warn of gaps in the data that are too wide for errors to be known."""
    if model.data is None:
        return
    wide = (inside(model.domain, *points.T) & ~model.covers(points)).sum()
    if wide:
        common.warn(
            f"{wide} of {len(points)} points are in gaps of the data wider than errors could be tested in"
        )


def _write(table: Floats, error: Floats | None, path: Path | None) -> None:
    names = {2: ["x", "y"], 3: ["x", "y", "z"]}
    columns = names.get(table.shape[1]) or [f"value{k}" for k in range(1, table.shape[1] + 1)]
    if error is not None:
        table, columns = np.column_stack([table, error]), [*columns, "error"]
    if path is None:
        matches.write_points_csv(sys.stdout, table, columns)
        return
    with path.open("w", encoding="utf-8", newline="\n") as file:
        matches.write_points_csv(file, table, columns)


def _warn_doubtful(warp: Warp, points: Floats, mapped: Floats, inverse: bool) -> None:
    known, there = (np.isfinite(some).all(axis=1) for some in (points, mapped))
    total, lost = len(points), np.count_nonzero(known & ~there)
    source = mapped[there] if inverse else points[known]
    common.warn_outside(warp.domain, source, total, "the region of the matches: the warp")
    vanishing = warp.vanishes(source).sum() if len(source) else 0
    if vanishing:
        what = "are where the warp's denominator vanishes, and have no image"
        common.warn(f"{vanishing} of {total} points {what}")
    if lost > vanishing:
        common.warn(f"{lost - vanishing} of {total} points have no {'origin' if inverse else 'image'}")
