"""Errors in a file, one line for each row, draw and method, so that only what is missing is computed."""

import csv
import math
from pathlib import Path

import numpy as np

FIELDS = ("row", "draw", "method", "error", "seconds")


class Records:
    """Errors and times by row, draw and method, read from a CSV file and added to it.

    Parameters
    ----------
    path : Path
        The file; made if it does not exist.
    """

    def __init__(self, path: Path):
        self.path, self.errors, self.seconds = path, {}, {}
        if not path.exists():
            self._write("w", [FIELDS])
        with path.open(encoding="utf-8", newline="") as file:
            for line in csv.DictReader(file):
                key = line["row"], int(line["draw"]), line["method"]
                self.errors[key], self.seconds[key] = float(line["error"]), float(line["seconds"])

    def add(self, row, draw, results):
        """Keep what methods gave for a draw: {method: (error, seconds)}."""
        for method, (error, seconds) in results.items():
            self.errors[row, draw, method], self.seconds[row, draw, method] = error, seconds
        lines = [(row, draw, method, f"{e:.9g}", f"{s:.3f}") for method, (e, s) in results.items()]
        self._write("a", lines)

    def has(self, row, draw, method):
        """Return whether a method has an error for a draw."""
        return (row, draw, method) in self.errors

    def drawn(self, row, method, draws):
        """Return a method's errors, a draw each."""
        return np.array([self.errors.get((row, draw, method), math.nan) for draw in range(draws)])

    def _write(self, mode, lines):
        with self.path.open(mode, encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(lines)
