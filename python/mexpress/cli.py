"""The command line: `mexpress warp`, `mexpress apply`.

A command is a function that adds its parser and says what to run; enter another one in `COMMANDS`. Errors of
the input are one line on standard error and exit status 2.
"""

from __future__ import annotations

import argparse
import io
import os
import re
import sys
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from mexpress import _validation as check
from mexpress import files, matches, plotting, reports
from mexpress._validation import Floats
from mexpress.placement import lattice
from mexpress.selection import Selection, WarpSelection, select_warp
from mexpress.warps import Warp

__all__ = ["main"]

_SAMPLES = 4000
"""Points at which a warp is searched for folds."""


class _Parser(argparse.ArgumentParser):
    """Errors are one line, without the usage."""

    def error(self, message: str) -> NoReturn:
        raise _UsageError(f"{message} ({self.prog} --help tells more)")


class _UsageError(Exception):
    """The command line cannot be understood."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments; those of the process if not given.

    Returns
    -------
    int
        Exit status: 0, 2 for errors of the input, 130 after Ctrl-C.

    Examples
    --------
    >>> import os, tempfile
    >>> import numpy as np
    >>> from mexpress.matches import write_matches
    >>> source = np.random.default_rng(0).uniform(0, 100, (30, 2))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_matches(f"{folder}/m.csv", source, source + np.sin(source / 20))
    ...     options = ["--counts", "3:6", "--criteria", "FIT", "--no-plots", "--out", folder]
    ...     main(["warp", f"{folder}/m.csv", *options])
    ...     sorted(os.listdir(folder))
    30 matches, fractional tps warps with 3 to 6 control points; pixels; * smallest
    ...
    0
    ['curves.csv', 'm.csv', 'selection.json', 'warp.npz']
    """
    try:
        arguments = _parser().parse_args(argv)
        arguments.run(arguments)
        sys.stdout.flush()
    except KeyboardInterrupt:
        return _failed("interrupted", 130)
    except BrokenPipeError:  # the reader, such as head, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        return _failed(f"{error.filename}: {error.strerror}" if error.filename else str(error))
    except (_UsageError, ImportError) as error:
        return _failed(str(error))
    except (ValueError, TypeError) as error:
        if not str(error).startswith("Invalid "):  # a fault of ours, whose traceback is needed
            raise
        return _failed(str(error))
    return 0


def _failed(message: str, status: int = 2) -> int:
    print("mexpress: error: " + " ".join(message.split()), file=sys.stderr)
    return status


def _note(message: str) -> None:
    print(f"mexpress: {message}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="mexpress", description="How many control points should this model have?")
    parser.add_argument("--version", action="version", version=f"mexpress {version('mexpress')}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for add in COMMANDS:
        add(commands)
    return parser


def _add_warp(commands: argparse._SubParsersAction[_Parser]) -> None:
    parser = commands.add_parser(
        "warp",
        help="select and fit the warp between two images",
        description="Fit warps with more and more control points to matched points of two images, and "
        "select one. The output directory gets selection.json, curves.csv, warp.npz, curves.png, warp.png, and "
        "with both images registered.png.",
    )
    add = parser.add_argument
    add("matches", metavar="MATCHES", type=Path, help="text with columns x1 y1 x2 y2, .npz or .npy")
    add("--image-size", type=_image_size, metavar="WxH", help=_IMAGE_SIZE_HELP)
    add("--lifting", default="tps", help="functions that bend the plane (default: tps)")
    add("--no-fractional", dest="fractional", action="store_false", help="without perspective")
    add("--placement", default="lloyd", help="how control points are spread (default: lloyd)")
    _add_selection(parser)
    add("--source-image", type=Path, metavar="FILE", help="for registered.png")
    add("--target-image", type=Path, metavar="FILE", help="for registered.png")
    parser.set_defaults(run=_warp)


_IMAGE_SIZE_HELP = (
    "size of the source image in pixels, such as 1920x1080: ERxx is in percent of its diagonal "
    "(default: that of --source-image, else of the matches' bounding box)"
)


def _add_selection(parser: _Parser) -> None:
    """Add what every selection has."""
    add = parser.add_argument
    add(
        "--criterion",
        default="ER10",
        help="what selects: FIT, PRESS, CMPRESS, KFkk, ERxx, ... (default: ER10)",
    )
    add("--criteria", type=_names, metavar="A,B,...", help="also shown (default: FIT,PRESS,CMPRESS)")
    add(
        "--counts",
        type=_counts,
        metavar="A:B[:STEP]",
        help="numbers of control points, B included; or a list, 3,5,9",
    )
    add("--seed", type=int, default=0, metavar="N", help="of everything random (default: 0)")
    add(
        "--threads",
        type=int,
        metavar="N",
        help="at most so many (default: MEXPRESS_NUM_THREADS, or all cores)",
    )
    add("--out", type=Path, required=True, metavar="DIR", help="where to write; made if it does not exist")
    add("--no-plots", dest="plots", action="store_false", help="write no PNG files")
    add("--quiet", action="store_true", help="show no progress")


def _add_apply(commands: argparse._SubParsersAction[_Parser]) -> None:
    parser = commands.add_parser(
        "apply",
        help="map points with a saved model",
        description="Map points from the source image to the target image with the warp in a file.",
    )
    add = parser.add_argument
    add("model", metavar="MODEL", type=Path, help="warp.npz that `mexpress warp` wrote")
    add("points", metavar="POINTS", type=Path, help="text with columns x y, .npz or .npy")
    add(
        "--inverse",
        action="store_true",
        help="from the target image to the source image; nan where impossible",
    )
    add("--out", type=Path, metavar="FILE", help="where to write (default: standard output)")
    parser.set_defaults(run=_apply)


COMMANDS: tuple[Callable[[argparse._SubParsersAction[_Parser]], None], ...] = (_add_warp, _add_apply)


def _warp(arguments: argparse.Namespace) -> None:
    source, target = matches.read_matches(arguments.matches)
    images = _images(arguments)
    size = arguments.image_size
    if size is None and images:
        size = images[0].shape[1::-1]
    arguments.out.mkdir(parents=True, exist_ok=True)
    selection = select_warp(
        source,
        target,
        criterion=arguments.criterion,
        criteria=arguments.criteria,
        lifting=arguments.lifting,
        fractional=arguments.fractional,
        counts=arguments.counts,
        placement=arguments.placement,
        image_size=size,
        seed=arguments.seed,
        threads=arguments.threads,
        progress=not arguments.quiet,
    )
    health = _health(selection)
    _print_warp(selection, health)
    written = _write_selection(
        arguments, selection, {"n_matches": len(source), "image_size": size, "warp": health}
    )
    selection.warp.save(arguments.out / "warp.npz")
    written += ["warp.npz", *_draw_warp(arguments, selection, images)]
    print(f"\n{arguments.out}: {', '.join(written)}")


def _images(arguments: argparse.Namespace) -> list[Any]:
    """Read both images, if both are given: before the long work, so that a wrong name costs no time."""
    given = [arguments.source_image, arguments.target_image]
    if given == [None, None]:
        return []
    if None in given:
        raise _UsageError("--source-image and --target-image belong together")
    return [_read_image(path) for path in given]


def _read_image(path: Path) -> Any:
    try:
        from skimage.io import imread  # noqa: PLC0415  an extra, imported where used
    except ImportError as error:
        raise ImportError("Reading images needs scikit-image: pip install 'mexpress[image]'") from error
    content = path.read_bytes()  # readers leave files open that they do not understand
    try:
        image = np.asarray(imread(io.BytesIO(content)))
    except Exception as error:  # whatever the reader of this format raises
        check.refuse("image", "It must be a file that scikit-image reads.", f"{path}: {error}")
    if image.ndim not in (2, 3):
        check.refuse("image", "It must be one gray or colour image.", f"shape {image.shape} in {path}")
    return image


def _health(selection: WarpSelection) -> dict[str, Any]:
    """Return what there is to know about a warp besides its score."""
    warp = selection.warp
    errors = np.hypot(*(selection.target - warp(selection.source)).T)
    inside = lattice(warp.domain, _SAMPLES)
    vanishes = warp.vanishes(inside)
    return {
        "file": "warp.npz",
        "lifting": warp.lifting.name,
        "fractional": warp.fractional,
        "control_points": warp.control_points.tolist(),
        "transfer_error": {
            "rms": _finite(np.sqrt((errors**2).mean())),
            "median": _finite(np.median(errors)),
            "largest": _finite(errors.max()),
        },
        "folded": float((warp.folds(inside) & ~vanishes).mean()),
        "vanishing": float(vanishes.mean()),
    }


def _finite(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def _print_warp(selection: WarpSelection, health: dict[str, Any]) -> None:
    counts = selection.counts
    form = "fractional " if health["fractional"] else ""
    tried = (
        f"{counts[0]} to {counts[-1]} control points" if len(counts) > 1 else f"{counts[0]} control points"
    )
    print(
        f"{len(selection.source)} matches, {form}{health['lifting']} warps with {tried}; pixels; * smallest\n"
    )
    print(reports.table(selection))
    if "PRESS" in selection.curves:
        print("(PRESS averages over the rows of the design, the others over the matches.)")
    best = selection.curves[selection.criterion][counts == selection.count][0]
    print(
        f"\n{selection.criterion} selects {selection.count} control points: {selection.criterion} {best:.4g}."
    )
    errors = ", ".join(
        f"{name} {'undefined' if error is None else f'{error:.3g}'}"
        for name, error in health["transfer_error"].items()
    )
    print(f"Distance of the warped source points to the target points, in pixels: {errors}.")
    if selection.count == counts[-1] and len(counts) > 1:
        _note(f"{selection.count} is the largest number tried: more may be better, see --counts.")
    _note_undefined(selection)
    for key, what in (("folded", "folds"), ("vanishing", "has a denominator that vanishes")):
        if health[key] > 0:
            share = f"{100 * health[key]:.2g} %"
            _note(f"the warp {what} over {share} of the region of the matches: do not trust it there.")


def _note_undefined(selection: Selection) -> None:
    for name, by_count in selection.undefined.items():
        first = min(by_count)
        some = ", ".join(map(str, by_count[first][:5])) + (", ..." if len(by_count[first]) > 5 else "")
        _note(
            f"{name} has no score at {len(by_count)} of {len(selection.counts)} numbers of control points, "
            f"first at {first}: what it leaves does not determine the warp for match {some} (from 0)."
        )


def _write_selection(arguments: argparse.Namespace, selection: Selection, more: dict[str, Any]) -> list[str]:
    """Write what every selection has; return the names of the files."""
    command = {name: _json(value) for name, value in vars(arguments).items() if name != "run"}
    reports.write_summary(
        arguments.out / "selection.json", {"command": command, **reports.summary(selection), **more}
    )
    reports.write_curves(arguments.out / "curves.csv", selection)
    return ["selection.json", "curves.csv"]


def _json(value: Any) -> Any:
    return str(value) if isinstance(value, Path) else value


def _draw_warp(arguments: argparse.Namespace, selection: WarpSelection, images: list[Any]) -> list[str]:
    """Draw what can be drawn; return the names of the files."""
    if not arguments.plots:
        return []
    warp, source, target = selection.warp, selection.source, selection.target
    try:
        plotting.plot_selection(selection, arguments.out / "curves.png")
    except ImportError as error:  # the numbers are worth more than the plots
        _note(f"no plots. {error}")
        return []
    plotting.plot_warp(warp, source, target, arguments.out / "warp.png")
    if not images:
        return ["curves.png", "warp.png"]
    path = arguments.out / "registered.png"
    plotting.plot_registration(warp, images[0], images[1], source, target, path=path)
    return ["curves.png", "warp.png", "registered.png"]


def _apply(arguments: argparse.Namespace) -> None:
    model = files.load(arguments.model)
    points = matches.read_points(arguments.points)
    if not isinstance(model, Warp):
        check.refuse("model", "It must be a warp.", f"{model!r} in {arguments.model}")
    mapped = model.inverse(points) if arguments.inverse else model(points)
    if arguments.out is None:
        matches.write_points_csv(sys.stdout, mapped)
    else:
        with arguments.out.open("w", encoding="utf-8", newline="\n") as file:
            matches.write_points_csv(file, mapped)
    _note_doubtful(model, mapped if arguments.inverse else points, mapped)


def _note_doubtful(warp: Warp, source: Floats, mapped: Floats) -> None:
    lost = ~np.isfinite(mapped).all(axis=1)
    source = source[np.isfinite(source).all(axis=1)]
    outside = ~_within(warp.domain, source)
    vanishing = warp.vanishes(source) if len(source) else outside
    for number, what in (
        (lost.sum(), "have no image"),
        (outside.sum(), "are outside the region of the matches: the warp extrapolates there"),
        (vanishing.sum(), "are where the warp's denominator vanishes: their images mean nothing"),
    ):
        if number:
            _note(f"{number} of {len(mapped)} points {what}")


def _within(corners: Floats, points: Floats) -> Any:
    """Tell which points are in a convex polygon, whose corners are counter-clockwise."""
    edges = np.roll(corners, -1, axis=0) - corners
    about = points[:, None] - corners
    turns = edges[:, 0] * about[..., 1] - edges[:, 1] * about[..., 0]
    slack = 1e-9 * np.ptp(corners, axis=0).max() * np.hypot(*edges.T)
    return (turns >= -slack).all(axis=1)


def _image_size(text: str) -> tuple[float, float]:
    parts = re.fullmatch(r"(\d+(?:\.\d+)?)[xX×](\d+(?:\.\d+)?)", text.strip())
    size = (float(parts[1]), float(parts[2])) if parts else (0.0, 0.0)
    if min(size) <= 0:
        raise argparse.ArgumentTypeError(f"must be WIDTHxHEIGHT in pixels, such as 1920x1080, not {text!r}")
    return size


def _names(text: str) -> list[str]:
    return [name for name in re.split(r"[,\s]+", text) if name]


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
