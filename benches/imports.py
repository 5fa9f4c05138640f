"""How long imports take: processes that import numpy, mexpress, or some of it, and end.

`python benches/imports.py` runs each of them forty times in turn, with compiled bytecode, as after an installation.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time

from tables import show

_PROGRAMS = (
    "pass",
    "import numpy",
    "import mexpress",
    "from mexpress import LeastSquares, schemes",
    "from mexpress import select_warp",
    "from mexpress import *",
)


def seconds(program: str, environment: dict[str, str]) -> float:
    """Return how long a process takes."""
    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", program], env=environment, check=True)
    return time.perf_counter() - start


def main() -> None:
    """Print medians, minima, and ratios of the medians to that of numpy."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=40)
    rounds = parser.parse_args().rounds
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "PYTHONPYCACHEPREFIX": folder}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        for program in _PROGRAMS:
            seconds(program, environment)
        times = {program: [] for program in _PROGRAMS}
        for _ in range(rounds):
            for program, taken in times.items():
                taken.append(seconds(program, environment))
    numpy = statistics.median(times["import numpy"])
    rows = [
        [
            f"`{program}`",
            f"{1e3 * statistics.median(taken):.1f}",
            f"{1e3 * min(taken):.1f}",
            f"{statistics.median(taken) / numpy:.2f}",
        ]
        for program, taken in times.items()
    ]
    show("Imports", ["", "median, ms", "shortest, ms", "times numpy"], rows)


if __name__ == "__main__":
    main()
