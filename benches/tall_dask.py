"""Time a least-squares fit of dask arrays on a cluster of processes here, with the data around each held out.

    python benches/tall_dask.py [--rows 1000000] [--columns 50] [--around 100] [--workers 4] [--blocks 8]

Prints a table: seconds, the most memory that this process needed beyond what it had before, and what the workers sent
one another, both as shares of the rows' own size; once with rows in an order in which neighbours are near each other,
once with rows in no order. Up to a million rows, `LeastSquares` does the same in memory, and the largest difference of
prediction residuals is printed.
"""

import argparse
import os
import warnings
from functools import partial

import dask.array as da
import numpy as np
from distributed import Client, LocalCluster, wait
from tall import IN_MEMORY, timed

import mexpress as mx


def block_of(places, columns):
    """Waves at places."""
    rng = np.random.default_rng(0)
    waves, phases = rng.normal(0, 6, (2, columns)), rng.uniform(0, 6, columns)
    return np.cos(places @ waves + phases)


def received(dask_worker):
    """Bytes that a worker had from others."""
    return sum(each["total"] for each in dask_worker.transfer_incoming_log)


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--columns", type=int, default=50)
    parser.add_argument("--around", type=int, default=100)
    parser.add_argument("--workers", type=int, default=4)
    parser.add_argument("--blocks", type=int, default=8)
    told = parser.parse_args()
    rng = np.random.default_rng(1)
    places = rng.uniform(0, 1, (told.rows, 2))
    radius = np.sqrt(told.around / told.rows / np.pi)
    sorted_places = places[mx.schemes.exclusion_radius(places, radius).visiting_order]
    size = told.rows * (told.columns + 1) * 8 / 2**30
    print(
        f"{told.rows} x {told.columns}, {size:.2f} GiB, {told.workers} workers; load {os.getloadavg()[0]:.2f}.\n"
    )
    print("| rows | what | seconds | memory here | sent | in memory, seconds | difference |")
    print("|" + "---|" * 7)
    with LocalCluster(
        n_workers=told.workers, threads_per_worker=1, processes=True, dashboard_address=":0"
    ) as cluster:
        for order, points in [("in order", sorted_places), ("in no order", places)]:
            with Client(cluster) as client:
                report(client, order, points, told.columns, told.blocks, radius, size)


def report(client, order, points, columns, blocks, radius, size):
    """Print the lines of an order of the rows."""
    length = -(-len(points) // blocks)
    chunked = da.from_array(points, chunks=(length, 2))
    A = chunked.map_blocks(block_of, columns, dtype=float, chunks=(chunked.chunks[0], (columns,)))
    b = A.sum(axis=1) + da.random.default_rng(2).normal(size=len(points), chunks=length)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Sending large graph", UserWarning)  # the places
        A, b = client.persist([A, b])
    wait([A, b])
    plain = mx.LeastSquares(*(each.compute() for each in (A, b))) if len(points) <= IN_MEMORY else None
    schemes = {
        "fit": None,
        "each datum": mx.schemes.leave_one_out(len(points)),
        "around each": mx.schemes.exclusion_radius(points, radius),
    }
    for what, scheme in schemes.items():
        had = sum(client.run(received).values())
        if scheme is None:
            seconds, memory, model = timed(partial(mx.LeastSquares.from_blocks, (A, b)))
        else:
            seconds, memory, cv = timed(partial(model.cross_validate, scheme))
        sent = (sum(client.run(received).values()) - had) / 2**30
        last = "| |"
        if plain is not None and scheme is not None:
            took, _, expected = timed(partial(plain.cross_validate, scheme))
            last = f"{took:.1f} | {np.abs(expected.residuals - cv.residuals).max():.0e} |"
        shares = f"{memory.more / size:.0%} | {sent / size:.0%}"
        print(f"| {order} | {what} | {seconds:.1f} | {shares} | {last}", flush=True)


if __name__ == "__main__":
    main()
