"""Completion of commands, options and names of files by shells: a script that shtab writes, which is an extra.

The script is static: a shell that completes runs no Python.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mexpress.extras import required

SHELLS = ("bash", "zsh", "fish", "tcsh")


class PrintCompletion(argparse.Action):
    """An option that prints the script for a shell, and ends."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        """Print, and leave."""
        print(script(parser, values))
        parser.exit()


def script(parser: argparse.ArgumentParser, shell: str) -> str:
    """Return what makes a shell complete the words of a parser and, where it takes a path, the names of files.

    Raises
    ------
    ImportError
        If shtab is not installed.

    Examples
    --------
    >>> parser = argparse.ArgumentParser(prog="mexpress")
    >>> action = parser.add_argument("model", type=Path)
    >>> "mexpress" in script(parser, "bash"), "_shtab_compgen_files" in action.complete["bash"]
    (True, True)
    """
    shtab = required("shtab", "Completion needs shtab", "completion")
    for action in _actions(parser):
        if action.type is Path:
            action.complete = shtab.DIRECTORY if action.metavar == "DIR" else shtab.FILE  # type: ignore[attr-defined]
    return str(shtab.complete(parser, shell))


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yield the options and arguments of a parser and of its commands."""
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from _actions(command)
