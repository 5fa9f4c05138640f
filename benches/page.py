"""Run the commands that docs/benchmarks.md names, and put what they print where they are named.

    python benches/page.py [WORD ...] [--list]

What a command printed stands in the page between two comments, ``<!-- printed by: benches/grid.py local -->`` and
``<!-- end -->``. All such commands are run, or those that contain one of the words; each replaces its own part of the
page, under a line that says when it ran, on what machine, and how long it took. Prose is outside of the comments, and
stays. ``--list`` runs nothing: it shows the commands, with the minutes that they took last.
"""

import argparse
import datetime
import os
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from machine import machine

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "benchmarks.md"
PART = re.compile(r"^<!-- printed by: (\S.*?) -->\n(.*?)^<!-- end -->$", re.DOTALL | re.MULTILINE)
MINUTES = re.compile(r"([\d.]+) minutes")


def parts(page: str) -> Iterator[tuple[str, str]]:
    """The commands of a page, and what they printed."""
    return ((match[1], match[2].strip()) for match in PART.finditer(page))


def replaced(page: str, command: str, printed: str) -> str:
    """The page with what a command printed, everywhere where it is named."""

    def part(match: re.Match[str]) -> str:
        if match[1] != command:
            return match[0]
        return f"<!-- printed by: {command} -->\n\n{printed.strip()}\n\n<!-- end -->"

    return PART.sub(part, page)


def run(command: str) -> str:
    """What a command prints, under a line that tells where and when."""
    load = f"load {os.getloadavg()[0]:.2f} when it started; " if hasattr(os, "getloadavg") else ""
    start = time.perf_counter()
    ended = subprocess.run(
        [sys.executable, *shlex.split(command)], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True
    )
    minutes = (time.perf_counter() - start) / 60
    today = datetime.date.today().isoformat()
    return f"`{command}`, {today}, {minutes:.1f} minutes; {load}{machine()}.\n\n{ended.stdout.strip()}\n"


def main() -> None:
    """Run what is asked for. A command that fails leaves its part of the page as it was."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "words", nargs="*", metavar="WORD", help="of the commands to run; all if none is given"
    )
    parser.add_argument("--list", action="store_true", help="show the commands alone")
    told = parser.parse_args()
    commands = {
        command: printed
        for command, printed in parts(PAGE.read_text())
        if not told.words or any(word in command for word in told.words)
    }
    if not commands:
        parser.error(f"no command of {PAGE.name} contains {' or '.join(told.words)}")
    failed = []
    for command, before in commands.items():
        if told.list:
            taken = MINUTES.search(before)
            print(f"{taken[1] if taken else '?':>6} minutes  {command}")
            continue
        print(command, file=sys.stderr, flush=True)
        try:
            printed = run(command)
        except subprocess.CalledProcessError:
            failed.append(command)
        else:
            PAGE.write_text(replaced(PAGE.read_text(), command, printed))
    if failed:
        sys.exit(f"failed: {'; '.join(failed)}")


if __name__ == "__main__":
    main()
