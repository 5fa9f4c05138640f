"""Errors of methods, kept so that only what is missing is computed."""

import math

import numpy as np

from mexpress.io.records import Records

COLUMNS = {"row": str, "draw": int, "method": str, "error": float, "seconds": float}


class Errors(Records):
    """Errors and times by row, draw and method; see `Records` for the files.

    Parameters
    ----------
    path : Path
        Of the CSV file.
    """

    def __init__(self, path):
        super().__init__(path, {}, COLUMNS, key=3)

    def keep(self, row, draw, results):
        """Keep what methods gave for a draw: {method: (error, seconds)}."""
        for method, (error, seconds) in results.items():
            self.add([(row, draw, method, error, round(seconds, 3))])

    def drawn(self, row, method, draws):
        """Return a method's errors, a draw each; NaN where it has none."""
        keys = ((row, draw, method) for draw in range(draws))
        return np.array([self[key][0][3] if key in self else math.nan for key in keys])
