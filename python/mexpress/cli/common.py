"""What the commands share: options, warnings, and the files of a selection."""

from __future__ import annotations

import argparse
import re
import shutil
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from mexpress import _validation as check
from mexpress._validation import Floats, nearest_name
from mexpress.cli import report as reports
from mexpress.geometry import inside
from mexpress.io import matches
from mexpress.io.missing import DROP, KEEP
from mexpress.io.sources import where
from mexpress.io.text import STANDARD_INPUT
from mexpress.selection import Selection, SurfaceSelection, WarpSelection
from mexpress.selection.defaults import AUTO
from mexpress.selection.fitted import FittedSelection
from mexpress.selection.queries import IMAGE
from mexpress.versions import versions


class Parser(argparse.ArgumentParser):
    """Errors are one line, without the usage, and values may begin with a minus."""

    def error(self, message: str) -> NoReturn:
        """Raise `UsageError`."""
        raise UsageError(f"{message} ({self.prog} --help tells more)")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Refuse what is not known here and not at the top: a command knows its options.

        Words such as -9999,65535 and -3.4e38 are no options, as argparse would have it.
        """
        words: list[str] = []
        for word in sys.argv[1:] if args is None else args:
            if re.match(r"-[.\d]", word) and words and re.fullmatch(r"--[\w-]+", words[-1]):
                words[-1] += f"={word}"
            else:
                words.append(word)
        result, unknown = super().parse_known_args(words, namespace)
        if unknown:
            options = (word for action in self._actions for word in action.option_strings)
            near = nearest_name(unknown[0].partition("=")[0].replace("_", "-"), options)
            self.error(f"unrecognized arguments: {' '.join(unknown)}{near and '.' + near}")
        return result, unknown


class UsageError(Exception):
    """The command line cannot be understood."""


def warn(message: str) -> None:
    """Say on standard error what the results do not."""
    print(f"mexpress: {message}", file=sys.stderr)


@contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Print warnings of the library as `warn` does, and the arguments that they name as options."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        yield
    for one in caught:
        warn(as_options(str(one.message)))


def add_selection(parser: Parser, placements: str) -> None:
    """Add the options that every selection has; `placements` tells of the ways to spread control points."""
    add = parser.add_argument
    add(
        "--criterion",
        help="what selects: FIT, PRESS, CMPRESS, KFkk, ERxx, ... (default: MATCHED, or ER10 without --smoothing auto)",
    )
    add("--criteria", type=_names, metavar="A,B,...", help="also shown (default: FIT,PRESS,CMPRESS)")
    add(
        "--smoothing",
        type=_smoothing,
        default=AUTO,
        metavar="W[,W...]|auto",
        help="weight of the bending energy, larger is stiffer; the best of several, or of twenty with auto; 0 is the "
        "method of the paper (default: auto)",
    )
    add("--lifting", default="tps", help="functions that bend the plane: tps, bspline, affine (default: tps)")
    add("--placement", metavar="NAME", help=f"how control points are spread: {placements}")
    add(
        "--queries",
        type=_queries,
        metavar="FILE|X0,Y0,X1,Y1|image",
        help="where the model will be used: points in a file, a rectangle, or all over the image; far from the data, "
        "models are judged by predictions as far (default: between the data)",
    )
    add("--robust", action="store_true", help="find wrong data and leave them out")
    weights = parser.add_mutually_exclusive_group()
    weights.add_argument(
        "--weights",
        metavar="COLUMN",
        help="name of the weights in a text's first line or an archive, such as confidence; 0 leaves out "
        "(default: weight in a text, weights in an archive, if there)",
    )
    weights.add_argument(
        "--sigma", metavar="COLUMN", help="name of the standard deviations there: the weights are 1 / sigma^2"
    )
    help_of_report = "also write a page, FILE.html, which shows all of it and needs nothing from elsewhere"
    add("--report", type=Path, metavar="FILE", help=help_of_report)
    add_run(parser)


def add_run(parser: Parser) -> None:
    """Add the options of every run that writes into a directory."""
    add = parser.add_argument
    add("--seed", type=whole(0), default=0, metavar="N", help="of everything random (default: 0)")
    add("--out", type=Path, required=True, metavar="DIR", help="where to write; made if it does not exist")
    add("--no-plots", dest="plots", action="store_false", help="write no PNG files")
    add_threads(parser)
    add_json(parser)


def add_matches(parser: Parser) -> None:
    """Add the file of matches, and how it is read."""
    parser.add_argument(
        "matches",
        metavar="MATCHES",
        type=Path,
        help="text with columns x1 y1 x2 y2, and weight if there, .npz, .npy, .parquet, or landmarks of QGIS or "
        "BigWarp; - is standard input",
    )
    add_table(parser, "x1,y1,x2,y2")


def add_threads(parser: Parser) -> None:
    """Add the options of long work."""
    threads = "at most so many (default: MEXPRESS_NUM_THREADS, or all cores)"
    parser.add_argument("--threads", type=whole(1), metavar="N", help=threads)
    parser.add_argument("--quiet", action="store_true", help="show no progress")


def add_json(parser: Parser) -> None:
    """Add the option to print for programs."""
    parser.add_argument("--json", action="store_true", help="print JSON in place of a table")


def add_table(parser: Parser, columns: str) -> None:
    """Add the options that say what a table's columns are, such as `columns`, and what stands for no data."""
    parser.add_argument(
        "--columns",
        type=_names,
        metavar=columns.upper(),
        help=f"which columns are {columns}: their names, or their numbers from 1 (default: by the header)",
    )
    parser.add_argument(
        "--missing",
        type=_missing,
        metavar="V[,V...]|drop",
        help="values that mean no data, such as -9999,65535; drop leaves out rows with empty cells or nan too",
    )


def table_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return what the readers of tables take."""
    return {"columns": arguments.columns, "missing": arguments.missing}


def selection_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return what `select_warp` and `select_surface` both take."""
    names = "criterion", "criteria", "lifting", "placement", "smoothing", "seed", "threads", "robust"
    queries = arguments.queries
    if isinstance(queries, Path):
        queries = _known_queries(queries, arguments.missing)
    given = {name: getattr(arguments, name) for name in names}
    return {**given, "queries": queries, "progress": not arguments.quiet}


def _known_queries(path: Path, missing: list[float | str] | None) -> Floats:
    """Read queries without those that are not known, as some results of `mexpress apply` are."""
    values = [value for value in missing or [] if value != DROP]
    points = matches.read_points(path, missing=[*values, KEEP])
    known = np.isfinite(points).all(axis=1)
    if not known.any():
        rule = "One point at least must be known."
        check.refuse("queries", rule, f"none of {len(points)} in {path.name}")
    if not known.all():
        warn(f"{(~known).sum()} of {len(points)} queries are not known, and left out")
    return np.asarray(points[known])


def as_weights(arguments: argparse.Namespace, column: Floats | None) -> Floats | None:
    """Return the weights that a file's column means: themselves, or standard deviations."""
    if arguments.sigma is None or column is None:
        return column
    if column.min() <= 0:
        raise UsageError(f"--sigma {arguments.sigma} must be above 0, not {column.min():g}")
    return np.asarray(column**-2.0)


def _queries(text: str) -> tuple[float, ...] | str | Path:
    if text.strip().lower() == IMAGE:
        return IMAGE
    try:
        numbers = tuple(map(float, text.split(",")))
    except ValueError:
        return Path(text)
    if len(numbers) != 4:
        raise argparse.ArgumentTypeError(f"must be a file, X0,Y0,X1,Y1 or image, not {text!r}")
    return numbers


def _smoothing(text: str) -> float | list[float] | str:
    if text.strip().lower() == AUTO:
        return AUTO
    try:
        weights = [float(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"must be a weight, weights such as 0,10,100, or auto, not {text!r}"
        ) from None
    return weights[0] if len(weights) == 1 else weights


def _missing(text: str) -> list[float | str]:
    words = text.strip().lower().split(",")
    try:
        return [word if word == DROP else float(word) for word in words]
    except ValueError:
        message = f"must be numbers that mean no data, such as -9999,65535, or drop, not {text!r}"
        raise argparse.ArgumentTypeError(message) from None


def _names(text: str) -> list[str]:
    return [name for name in re.split(r"[,\s]+", text) if name]


def model_of(loaded: Any) -> Any:
    """Return what was loaded, or the model of a selection."""
    if isinstance(loaded, WarpSelection):
        return loaded.warp
    return loaded.surface if isinstance(loaded, SurfaceSelection) else loaded


def print_selection(selection: FittedSelection[Any], where: str, remark: str = "") -> None:
    """Print the table, a remark on it, what is selected, and how much was left out; `where` says which data."""
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    print(reports.table(selection, width=width))
    if remark:
        print(f"({remark})")
    name, grid = selection.criterion, _of_grid(selection)
    if selection.rival is None:
        print(f"\n{name} selects {grid}: {name} {selection.score:.4g}.")
    else:
        score = f"{selection.maps[name][selection.place]:.4g} with {grid}"
        print(f"\n{name} selects the {selection.rival}: {name} {selection.score:.4g}; it is {score}.")
    if len(selection.left_out):
        left_out, n = len(selection.left_out), len(selection.data.points)
        print(f"Left out as wrong: {left_out} of {n}; {where} says which.")


def _of_grid(selection: Selection) -> str:
    """Say which count and weight the criterion selects."""
    k, w = selection.place
    text = f"{selection.counts[k]} control points"
    if len(selection.weights) > 1:
        text += f" and smoothing {selection.weights[w]:.3g}"
        if selection.parameters is not None:
            text += f", {selection.parameters[k, w]:.1f} effective parameters"
    return text


def warn_of_notes(selection: FittedSelection[Any]) -> None:
    """Print what is doubtful about a selection."""
    for note in selection.notes:
        warn(as_options(note))


def as_options(note: str) -> str:
    """Write the arguments in a note as options.

    Examples
    --------
    >>> as_options('Try smoothing="auto", fractional=False or robust=True; criteria=["ER01", "ER05"] tells more.')
    'Try --smoothing auto, --no-fractional or --robust; --criteria ER01,ER05 tells more.'
    """

    def option(match: re.Match[str]) -> str:
        name, value = match[1].replace("_", "-"), re.sub(r'["\[\] ]', "", match[2])
        return {"True": f"--{name}", "False": f"--no-{name}"}.get(value, f"--{name} {value}")

    return re.sub(r'\b(\w+)=("[^"]*"|\[[^]]*\]|\w+)', option, note)


def as_typed(message: str, arguments: argparse.Namespace) -> str:
    """Write the names of arguments in a message as the options and files that were typed.

    Examples
    --------
    >>> typed = argparse.Namespace(matches=Path("m.csv"), image_size=None)
    >>> as_typed("Invalid image_size. It must be given. Given none.", typed)
    'Invalid --image-size. It must be given. Given none.'
    >>> as_typed("Invalid source. They must cover a region. Given 4 points on a line.", typed)
    'Invalid source in m.csv. They must cover a region. Given 4 points on a line.'
    """
    typed = vars(arguments)
    name = message.split()[1].rstrip(".")  # of "Invalid name. ..."
    option = "data" if name == "max_data" else name
    files = [value for value in typed.values() if isinstance(value, Path)]
    if name in _OPTIONAL or (option in typed and not isinstance(typed[option], Path | None)):
        message = message.replace(name, f"--{option.replace('_', '-')}", 1)
    elif name in _OF_FILE and not any(where(file) in message for file in files):
        place = where(files[0]) if str(files[0]) == STANDARD_INPUT else files[0]
        message = message.replace(name, f"{name} in {place}", 1)
    return as_options(message)


_OPTIONAL = {"image_size", "out"}
"""Options that a message may be about although they were not typed, or that are files themselves."""

_OF_FILE = {"source", "target", "points", "values", "weights", "matches", "cloud"}
"""What the first file that is typed holds."""


def whole(low: int) -> Callable[[str], int]:
    """Return what reads an option's whole number of at least some other."""

    def read(text: str) -> int:
        if not re.fullmatch(r"[+-]?\d+", text.strip(), re.ASCII) or int(text) < low:
            raise argparse.ArgumentTypeError(f"must be a whole number of at least {low}, not {text!r}")
        return int(text)

    return read


def write_selection(
    arguments: argparse.Namespace, selection: FittedSelection[Any], more: dict[str, Any]
) -> list[str]:
    """Write what every selection has; return the names of the files."""
    command = {
        name: _json(value) for name, value in vars(arguments).items() if name not in {"run", "json", "typed"}
    }
    reports.write_summary(
        arguments.out / "selection.json",
        {"command": command, "versions": versions(), **selection.to_dict(), **more},
    )
    reports.write_curves(arguments.out / "curves.csv", selection)
    return ["selection.json", "curves.csv"]


def print_end(arguments: argparse.Namespace, summary: str, written: list[str]) -> None:
    """Say which files were written or, for programs, what the summary among them says."""
    if arguments.json:
        print((arguments.out / summary).read_text(encoding="utf-8"), end="")
    else:
        print(f"\n{arguments.out}: {', '.join(written)}")


def _json(value: Any) -> Any:
    return str(value) if isinstance(value, Path) else value


def draw(arguments: argparse.Namespace, plots: dict[str, Callable[[Path], Any]]) -> list[str]:
    """Draw every plot into the file of its name, if plots are wanted and can be made; return the names."""
    if not arguments.plots:
        return []
    try:
        for name, plot in plots.items():
            plot(arguments.out / name)
    except ImportError as error:  # the numbers are worth more than the plots
        warn(f"no plots. {error}")
        return []
    return list(plots)


def write_report(arguments: argparse.Namespace, write: Callable[..., None]) -> None:
    """Write a page with what was typed, if one is wanted and can be made."""
    if arguments.report is None:
        return
    try:
        write(arguments.report, command=arguments.typed)
    except ImportError as error:  # the numbers are worth more than the page
        warn(f"no report. {error}")
        return
    if not arguments.json:
        print(f"\n{arguments.report}: all of it on one page")


def missing_text(n_missing: int) -> str:
    """Return what to say after a number of data of those that are not there."""
    return f" ({n_missing} more are missing)" if n_missing else ""


def sizes_summary(sizes: Floats) -> dict[str, float]:
    """Return what there is to know about the sizes (n,) of errors."""
    return {
        "rms": float(np.sqrt((sizes**2).mean())),
        "median": float(np.median(sizes)),
        "largest": float(sizes.max()),
    }


def sizes_text(sizes: dict[str, float]) -> str:
    """Return such a summary as text."""
    numbers = ((name, f"{size:.3g}" if np.isfinite(size) else "undefined") for name, size in sizes.items())
    return ", ".join(f"{name} {number}" for name, number in numbers)


def warn_outside(domain: Floats, points: Floats, total: int, region: str) -> None:
    """Warn of how many points are outside a model's domain, the corners of a convex polygon."""
    outside = len(points) - np.count_nonzero(inside(domain, *points.T))
    if outside:
        warn(f"{outside} of {total} points are outside {region} extrapolates there")
