"""Where the time of local exclusion goes, as a share of the rate of a product of matrices; and a tall design.

Usage: ``python benches/versus.py [local] [tall] [--rounds 7]``; all parts if none is named. `grid.py` has more sizes
and peers.

What competes is run in turns (A B A B); the tables show the median of the rounds, with the least and the most.
Everyone must give the same residuals to 1e-8 before it is timed. With one thread, BLAS and mexpress get one each.
With all, mexpress gets all, and the others what is faster for them: a BLAS of all threads, or all threads with
pairs of their own each and a BLAS of one.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from machine import CORES
from peers import cvmatrix_folds, numpy_stacked
from tables import show
from threadpoolctl import threadpool_limits

import mexpress as mx

THREADS = sorted({1, CORES})

# OpenBLAS threads that have finished spin for a while before they sleep, and would slow down whoever is next.
REST = 0.2


@dataclass
class Runner:
    """Something to time: a model is made, then cross-validated.

    Parameters
    ----------
    name : str
        As the table has it.
    threads : int
        That it may use.
    fit : callable
        Makes the model.
    predict : callable
        Takes the model and gives the prediction residuals.
    blas : int
        Threads of the BLAS.
    flop : float
        Of the predictions.
    """

    name: str
    threads: int
    fit: Callable[[], object]
    predict: Callable[[object], np.ndarray]
    blas: int
    flop: float = np.nan
    fits: list[float] = field(default_factory=list)
    times: list[float] = field(default_factory=list)

    def run(self) -> np.ndarray:
        """Once, and note the times."""
        time.sleep(REST)
        with threadpool_limits(self.blas):
            start = time.perf_counter()
            model = self.fit()
            middle = time.perf_counter()
            found = self.predict(model)
            end = time.perf_counter()
        self.fits.append(middle - start)
        self.times.append(end - middle)
        return found

    def forget(self) -> None:
        """Times so far were for warming up."""
        self.fits.clear()
        self.times.clear()

    @property
    def whole(self) -> np.ndarray:
        """Fit and predictions."""
        return np.add(self.fits, self.times)


def closed_form(A: np.ndarray, b: np.ndarray, scheme: mx.schemes.Scheme, threads: int, flop: float) -> Runner:
    return Runner(
        "mexpress",
        threads,
        lambda: mx.LeastSquares(A, b, threads=threads),
        lambda model: model.cross_validate(scheme, threads=threads).residuals,
        threads,
        flop,
    )


def peer(
    name: str,
    make: Callable[[int], object],
    scheme: mx.schemes.Scheme,
    threads: int,
    flop: float,
    ways: str = "blas pairs",
) -> Runner:
    """An adapter in the faster of its ways to use threads; `make` takes the number of workers."""
    held, validated = list(scheme.held_out), list(scheme.validated)
    settings = {"blas": (1, threads), "pairs": (min(threads, len(held)), 1)}
    runners = [
        Runner(
            name,
            threads,
            lambda workers=workers: make(workers),
            lambda model: model.residuals(held, validated),
            blas,
            flop,
        )
        for workers, blas in dict.fromkeys(settings[way] for way in ways.split())
    ]
    if len(runners) == 1:
        return runners[0]
    for runner in runners * 3:
        runner.run()
    best = min(runners, key=lambda runner: min(runner.whole))
    best.forget()
    return best


class MatrixProduct:
    """The rate of numpy's product of two 1500 x 1500 matrices: what this machine can do."""

    SIZE = 1500

    def __init__(self) -> None:
        self.a = np.random.default_rng(0).standard_normal((self.SIZE, self.SIZE))
        self.times: dict[int, list[float]] = {threads: [] for threads in THREADS}

    def run(self) -> None:
        """Once with each number of threads."""
        for threads, times in self.times.items():
            time.sleep(REST)
            with threadpool_limits(threads):
                start = time.perf_counter()
                self.a @ self.a
                times.append(time.perf_counter() - start)

    def rate(self, threads: int) -> float:
        """Flop a second."""
        return 2 * self.SIZE**3 / float(np.median(self.times[threads]))


def compete(runners: list[Runner], rounds: int, product: MatrixProduct | None = None) -> None:
    """Agreement first, then rounds in turns."""
    expected = runners[0].run()
    for runner in runners:
        error = float(np.abs(runner.run() - expected).max())
        if not error < 1e-8:
            raise AssertionError(f"{runner.name} differs by {error}")
        runner.forget()
    for _ in range(rounds):
        if product:
            product.run()
        for runner in runners:
            runner.run()


def span(seconds: list[float] | np.ndarray, unit: float = 1e3) -> str:
    middle, low, high = np.median(seconds) * unit, np.min(seconds) * unit, np.max(seconds) * unit
    digits = 1 if middle >= 10 else 2
    return f"{middle:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def waves(points: np.ndarray, p: int) -> np.ndarray:
    """The p lowest cosines of the unit square; the first is constant."""
    orders = sorted((i + j, i, j) for i in range(p) for j in range(p))[:p]
    x, y = np.pi * points.T
    return np.stack([np.cos(i * x) * np.cos(j * y) for _, i, j in orders], axis=1)


def local(rounds: int) -> None:
    """Local exclusion: the neighbourhood of every datum held out."""
    n, p, q = 2000, 60, 101
    rng = np.random.default_rng(0)
    points = rng.random((n, 2))
    A = waves(points, p)
    b = np.sin(5 * points[:, 0]) * np.cos(4 * points[:, 1]) + 0.1 * rng.standard_normal(n)
    scheme = mx.schemes.nearest(points, q)
    kernel = min(q * p * p + p**3 / 3, q * q * p + q**3 / 3)
    symmetric, full = q * p * p + 2 * p**3 / 3, 2 * q * p * p + 2 * p**3 / 3
    dual = 2 * q * q * p + 2 * q**3 / 3
    runners = []
    for threads in THREADS:
        runners += [
            closed_form(A, b, scheme, threads, n * kernel),
            peer(
                "numpy, looped, primal",
                lambda w: numpy_stacked.Looped(A, b, w),
                scheme,
                threads,
                n * symmetric,
            ),
            peer(
                "numpy, stacked, primal", lambda w: numpy_stacked.Primal(A, b, w), scheme, threads, n * full
            ),
            peer(
                "numpy, stacked, dual",
                lambda w: numpy_stacked.Dual(A, b, w),
                scheme,
                threads,
                n * dual,
                "pairs",
            ),
        ]
        for centred, stacked in ((False, False), (False, True), (True, False)):
            runners.append(
                peer(
                    "cvmatrix" + ", centred" * centred + (", stacked" if stacked else ", looped") + " solve",
                    lambda w, c=centred, s=stacked: cvmatrix_folds.Folds(
                        A, b, centred=c, stacked=s, workers=w
                    ),
                    scheme,
                    threads,
                    n * symmetric,
                )
            )
    product = MatrixProduct()
    compete(runners, rounds, product)
    rows = []
    for runner in runners:
        ours = next(r for r in runners if r.threads == runner.threads)
        rate = runner.flop / float(np.median(runner.times))
        rows.append(
            [
                runner.name,
                str(runner.threads),
                span(runner.fits),
                span(runner.times),
                f"{np.median(runner.times) / np.median(ours.times):.1f}",
                f"{np.median(runner.whole) / np.median(ours.whole):.1f}",
                f"{runner.flop / 1e9:.2f}",
                f"{rate / 1e9:.1f}",
                f"{100 * rate / product.rate(runner.threads):.0f} %",
            ]
        )
    show(
        f"Local exclusion: n = {n}, p = {p}, {q} held out around each datum, one response",
        [
            "",
            "threads",
            "fit, ms",
            "cross-validate, ms",
            "times mexpress",
            "with fit",
            "Gflop",
            "Gflop/s",
            "of product's rate",
        ],
        rows,
    )
    for threads in THREADS:
        print(f"numpy's product of matrices, {threads} thread(s): {product.rate(threads) / 1e9:.1f} Gflop/s")
    print(
        "Flop: Gram matrix and factorisation of every pair, a multiply-add counted twice. Symmetric products, q p^2,"
        "\nfor mexpress, loops and cvmatrix; whole ones, 2 q p^2, for stacks. Cholesky p^3/3 against LU 2 p^3/3."
    )


def tall(rounds: int) -> None:
    """CMPRESS of a tall design, against one QR factorisation of numpy's."""
    m, p = 1_000_000, 50
    script = Path(__file__).parent / "peers" / "tall.py"
    found: dict[tuple[str, int], list[dict]] = {
        (who, threads): [] for threads in THREADS for who in ("mexpress", "numpy")
    }
    for _ in range(min(rounds, 3)):
        for (who, threads), results in found.items():
            command = [sys.executable, str(script), who, str(m), str(p), str(threads)]
            results.append(json.loads(subprocess.run(command, check=True, capture_output=True).stdout))
    rows = []
    for (who, threads), results in found.items():
        totals = [sum(result["seconds"].values()) for result in results]
        base = [sum(result["seconds"].values()) for result in found["numpy", threads]]
        parts = [
            f"{part} {np.median([r['seconds'][part] for r in results]):.3f}" for part in results[0]["seconds"]
        ]
        design = results[0]["design"]
        rows.append(
            [
                who if who == "mexpress" else "numpy.linalg.qr",
                str(threads),
                span(totals, 1),
                ", ".join(parts) if len(parts) > 1 else "",
                f"{np.median(totals) / np.median(base):.2f}",
                f"{max(r['peak'] for r in results) / design:.2f}",
                f"{max(r['peak'] - r['before'] for r in results) / design:.2f}",
            ]
        )
    show(
        f"CMPRESS: m = {m:,} rows, p = {p}, two rows a datum; a process each",
        ["", "threads", "seconds", "of which", "of qr's time", "peak memory / A", "beyond A, b"],
        rows,
    )


def main() -> None:
    parts = {"local": local, "tall": tall}
    parser = argparse.ArgumentParser(description="Time mexpress against its peers.")
    parser.add_argument("parts", nargs="*", help=", ".join(parts))
    parser.add_argument("--rounds", type=int, default=7)
    given = parser.parse_args()
    if unknown := set(given.parts) - set(parts):
        parser.error(f"no such part: {', '.join(sorted(unknown))}")
    for name in given.parts or parts:
        parts[name](given.rounds)


if __name__ == "__main__":
    main()
