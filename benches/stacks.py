"""Time many small problems in one call against numpy's stacked factorisations, and a loop over `LeastSquares`.

    python benches/stacks.py [--rounds 5] [--problems 100000] [--threads 1 2]

Prints a table: microseconds a problem, how many times as fast as numpy, and the rate as a share of that of a product of
matrices on one thread. Every peer does the same work: scores and prediction residuals of all problems; their largest
difference is in the last column, and before it the memory that calls take beyond the problems.
"""

import argparse
import os
from functools import partial

import numpy as np
from memory import memory_of
from timing import shortest

import mexpress as mx

FLOPS = 3e7
"""Columns squared times rows, of all problems together, times a hundred: fewer problems where they are large."""

SHAPES = [(60, 6), (60, 20), (200, 6), (200, 20), (500, 30), (300, 60)]


def stacked(A, b, scheme):
    """Prediction residuals by numpy: a stacked QR, and a stacked solution for each held-out set."""
    Q = np.linalg.qr(A).Q
    residuals = b - np.squeeze(Q @ (np.swapaxes(Q, 1, 2) @ b[..., None]), -1)
    if (scheme.held_out.sizes == 1).all():
        return residuals / (1 - np.square(Q).sum(axis=2))
    found = np.empty((len(A), len(scheme.validated.indices)))
    ends = scheme.validated.offsets
    for pair, held in enumerate(scheme.held_out):
        block, e = Q[:, held], residuals[:, held]
        if len(held) <= Q.shape[2]:
            system = np.eye(len(held)) - block @ np.swapaxes(block, 1, 2)
            predicted = np.linalg.solve(system, e[..., None])
        else:
            system = np.eye(Q.shape[2]) - np.swapaxes(block, 1, 2) @ block
            change = np.linalg.solve(system, np.swapaxes(block, 1, 2) @ e[..., None])
            predicted = e[..., None] + block @ change
        some = np.searchsorted(held, scheme.validated[pair])
        found[:, ends[pair] : ends[pair + 1]] = predicted[:, some, 0]
    return found


def loop(A, b, scheme):
    """Prediction residuals of some of the problems, one after another."""
    return [
        mx.LeastSquares(*each, threads=1).cross_validate(scheme, 1).residuals
        for each in zip(A, b, strict=True)
    ]


def product_rate():
    """Multiply-adds a second, times two, of a product of two matrices of 1,000 x 1,000, on the threads numpy uses."""
    a = np.random.default_rng(0).normal(size=(1000, 1000))
    return 2e9 / shortest(lambda: a @ a, 5)[0]


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--problems", type=int, default=100_000)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    told = parser.parse_args()
    rng, rate = np.random.default_rng(0), product_rate()
    print(f"Load {os.getloadavg()[0]:.2f}; product of matrices {rate / 1e9:.0f} Gflop/s.\n")
    columns = [f"{threads} thread{'s' if threads > 1 else ''}, us" for threads in told.threads]
    heads = ["rows", "columns", "what is held out", "problems", "loop, us", "numpy, us", *columns]
    heads += ["times as fast as numpy", "Gflop/s", "MiB", "MiB, numpy", "difference"]
    print("| " + " | ".join(heads) + " |\n|" + "---|" * len(heads))
    for m, p in SHAPES:
        k = int(min(told.problems, max(64, 100 * FLOPS / (m * p * p))))
        A, b = rng.normal(size=(k, m, p)), rng.normal(size=(k, m))
        near = mx.schemes.nearest(rng.uniform(size=(m, 2)), m // 10)
        for name, scheme in (
            ("each datum", mx.schemes.leave_one_out(m)),
            ("ten folds", mx.schemes.k_fold(m, 10, seed=0)),
            (f"{m // 10} nearest", near),
        ):
            few = slice(0, min(k, 500))
            alone = shortest(partial(loop, A[few], b[few], scheme), 1)[0] / len(A[few])
            theirs, expected = shortest(partial(stacked, A, b, scheme), told.rounds)
            calls = [
                partial(mx.cross_validate_batch, A, b, scheme, threads=threads) for threads in told.threads
            ]
            own = [shortest(call, told.rounds) for call in calls]
            memory = f"{memory_of(calls[-1]):.0f} | {memory_of(partial(stacked, A, b, scheme)):.0f}"
            difference = np.abs(own[0][1].residuals - expected).max() / np.abs(expected).max()
            times = " | ".join(f"{1e6 * seconds / k:.2f}" for seconds, _ in own)
            ratios = " / ".join(f"{theirs / seconds:.1f}" for seconds, _ in own)
            flops = 4 * m * p * p * k / own[0][0] / 1e9
            first = f"{m} | {p} | {name} | {k:,} | {1e6 * alone:.0f} | {1e6 * theirs / k:.1f}"
            print(f"| {first} | {times} | {ratios} | {flops:.1f} | {memory} | {difference:.0e} |", flush=True)


if __name__ == "__main__":
    main()
