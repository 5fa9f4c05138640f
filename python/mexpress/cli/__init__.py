"""The command line: `mexpress warp`, `surface`, `apply`, `info`, `suspects`, `reproduce`.

A command is a function that adds its parser and says what to run. It is found by its entry point in the group
``mexpress.commands``, where other packages may have theirs. Errors of the input are one line on standard error and exit
status 2.
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Sequence
from importlib.metadata import EntryPoint, entry_points, version
from pathlib import Path

from mexpress.cli.common import Parser, UsageError, as_typed, warn
from mexpress.cli.completion import SHELLS, PrintCompletion

__all__ = ["main"]


_ORDER = ["warp", "surface", "apply", "info", "suspects", "reproduce"]
"""Our commands, as help lists them."""


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
    >>> from mexpress.io.matches import write_matches
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
    words = sys.argv[1:] if argv is None else argv
    arguments = argparse.Namespace()
    try:
        arguments = _parser(words).parse_args(words)
        arguments.typed = shlex.join(["mexpress", *words])
        arguments.run(arguments)
        sys.stdout.flush()
    except KeyboardInterrupt:
        return _failed("interrupted", 130)
    except BrokenPipeError:  # the reader, such as head, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        return _failed(_of_file(error) if error.filename else str(error))
    except (UsageError, ImportError) as error:
        return _failed(str(error))
    except (ValueError, TypeError) as error:
        if not str(error).startswith("Invalid "):  # a fault of ours, whose traceback is needed
            raise
        return _failed(as_typed(str(error), arguments))
    return 0


def _of_file(error: OSError) -> str:
    """Say what is wrong with a file, or with the directory that it should be in."""
    path = Path(os.fsdecode(error.filename))
    if isinstance(error, FileExistsError | NotADirectoryError):
        return f"{path}: a file, where a directory should be"
    if isinstance(error, FileNotFoundError) and not path.parent.exists():
        return f"{path}: there is no directory {path.parent}"
    return f"{path}: {error.strerror}"


def _failed(message: str, status: int = 2) -> int:
    print("mexpress: error: " + " ".join(message.split()), file=sys.stderr)
    return status


def _parser(words: Sequence[str]) -> argparse.ArgumentParser:
    parser = Parser(prog="mexpress", description="How many control points should this model have?")
    parser.add_argument("--version", action="version", version=f"mexpress {version('mexpress')}")
    parser.add_argument(
        "--print-completion",
        action=PrintCompletion,
        choices=SHELLS,
        help="print what makes a shell complete commands and options, and exit",
    )
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for point in _wanted(words):
        try:
            point.load()(commands)
        except Exception as error:  # another package's fault must not cost the other commands
            warn(f"no command {point.name}. {type(error).__name__}: {error}")
    return parser


def _wanted(words: Sequence[str]) -> list[EntryPoint]:
    """Return the command that the first word names, for which no other is imported; else all, ours first."""
    every = entry_points(group="mexpress.commands")
    ours = [point for point in every if point.module.startswith("mexpress.")]
    others = [point for point in every if point not in ours]
    points = sorted(ours, key=lambda point: _ORDER.index(point.name)) + sorted(
        others, key=lambda point: point.name
    )
    return [point for point in points if point.name in words[:1]] or points
