"""R's mgcv: neighbourhood cross-validation (NCV), a Newton step from the fit of all data for each held-out set.

For least squares the step is exact. `gam(..., method="NCV", nei=...)` evaluates it for each weight of a penalty that
it tries, among much else; here the routine that does it, C_Rncv, is called by itself for a model without penalty, after
the Cholesky factorisation that it starts from, and the seconds are R's own for these two. For small problems, the score
of `gam` itself is compared with the routine's.
"""

import atexit
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np


class Worker:
    """R, which waits for folders of problems."""

    def __init__(self) -> None:
        program = shutil.which("Rscript")
        if not program:
            raise ModuleNotFoundError("There is no Rscript.")
        script = str(Path(__file__).with_suffix(".R"))
        self.process = subprocess.Popen(
            [program, script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.version = self.process.stdout.readline().strip()
        if not self.version:
            raise ModuleNotFoundError("R has no mgcv, or one without NCV.")
        atexit.register(self.process.stdin.close)

    def work(self, folder: str) -> tuple[float, float]:
        """Seconds of the fit and of the evaluation."""
        self.process.stdin.write(f"{folder}\n")
        self.process.stdin.flush()
        fit, evaluation = map(float, self.process.stdout.readline().split())
        return fit, evaluation


class Ncv:
    """What C_Rncv predicts.

    Attributes
    ----------
    seconds : tuple of float
        Of the fit and of the evaluation.
    """

    def __init__(self, A: np.ndarray, b: np.ndarray, workers: int = 1) -> None:
        self.A, self.b, self.workers = A, b, workers

    @staticmethod
    @cache
    def start() -> Worker:
        """R, once."""
        return Worker()

    def residuals(self, held_out: Sequence[np.ndarray], validated: Sequence[np.ndarray]) -> np.ndarray:
        """Predict the validated rows of every pair, in order."""
        held, known = (np.concatenate(list(sets)).astype(np.int32) for sets in (held_out, validated))
        ends, places = (
            np.cumsum([len(each) for each in sets], dtype=np.int32) for sets in (held_out, validated)
        )
        sizes = np.array([*self.A.shape, len(ends), len(held), len(known), self.workers], dtype=np.int32)
        files = {
            "sizes": sizes,
            "A": self.A.ravel("F"),
            "b": self.b,
            "k": held,
            "m": ends,
            "i": known,
            "mi": places,
        }
        with tempfile.TemporaryDirectory() as name:
            for file, numbers in files.items():
                numbers.tofile(Path(name) / file)
            self.seconds = self.start().work(name)
            return self.b[known] - np.fromfile(Path(name) / "predicted")
