"""Time a least-squares fit of rows in a file, and its cross-validation with the data around each held out.

    python benches/tall.py [--rows 1000000] [--columns 50] [--around 100 1000] [--directory DIR] [--threads 2]

Writes a file of rows, and prints a table: seconds, microseconds a datum, and the most memory of the process, its own
and with pages of the file, which the system takes back when it needs them. Up to a million rows, `LeastSquares` does
the same in memory, and the largest difference of prediction residuals is printed.
"""

import argparse
import os
import tempfile
import time
from pathlib import Path

import numpy as np
from memory import Memory

import mexpress as mx

IN_MEMORY = 1_000_000


def write(folder, rows, columns):
    """Write waves at random places, noisy sums of them, and return the places."""
    rng = np.random.default_rng(0)
    places = rng.uniform(0, 1, (rows, 2))
    waves, phases = rng.normal(0, 6, (2, columns)), rng.uniform(0, 6, columns)
    A = np.lib.format.open_memmap(folder / "A.npy", "w+", np.float64, (rows, columns))
    b = np.lib.format.open_memmap(folder / "b.npy", "w+", np.float64, (rows,))
    for first in range(0, rows, 100_000):
        some = slice(first, first + 100_000)
        A[some] = np.cos(places[some] @ waves + phases)
        b[some] = A[some] @ rng.normal(size=columns) + rng.normal(size=len(A[some]))
    A.flush()
    return places


def timed(call):
    """Seconds of a call, the memory that it took, and its result."""
    start = time.perf_counter()
    with Memory() as memory:
        result = call()
    return time.perf_counter() - start, memory, result


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--columns", type=int, default=50)
    parser.add_argument("--around", type=int, nargs="+", default=[100, 1000])
    parser.add_argument("--directory")
    parser.add_argument("--threads", type=int)
    told = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=told.directory) as name:
        folder = Path(name)
        places = write(folder, told.rows, told.columns)
        A, b = (np.load(folder / f"{each}.npy", mmap_mode="r") for each in "Ab")
        print(f"{told.rows} x {told.columns}; load {os.getloadavg()[0]:.2f}.\n")
        print(
            "| what | seconds | us a datum | GiB, own | GiB, with pages of the file | in memory, seconds | difference |"
        )
        print("|" + "---|" * 7)
        seconds, memory, model = timed(lambda: mx.LeastSquares.from_blocks((A, b), threads=told.threads))
        tell("fit", seconds, told.rows, memory)
        schemes = {"each datum": lambda: mx.schemes.leave_one_out(told.rows)}
        for around in told.around:
            radius = np.sqrt(around / told.rows / np.pi)
            schemes[f"{around} around each"] = lambda r=radius: mx.schemes.exclusion_radius(places, r)
        plain = mx.LeastSquares(A, b, threads=told.threads) if told.rows <= IN_MEMORY else None
        for what, scheme in schemes.items():
            seconds, memory, cv = timed(lambda s=scheme: model.cross_validate(s(), told.threads))
            other = None
            if plain is not None:
                took, _, expected = timed(lambda s=scheme: plain.cross_validate(s(), told.threads))
                other = took, np.abs(expected.residuals - cv.residuals).max()
            tell(what, seconds, told.rows, memory, other)


def tell(what, seconds, rows, memory, other=None):
    """Print a line of the table."""
    last = "| |" if other is None else f"{other[0]:.1f} | {other[1]:.0e} |"
    print(
        f"| {what} | {seconds:.1f} | {1e6 * seconds / rows:.1f} | {memory.own:.2f} | {memory.all:.2f} | {last}",
        flush=True,
    )


if __name__ == "__main__":
    main()
