"""The clock of several benchmarks."""

import time

import numpy as np

SLOW = 2.0
"""What takes more seconds than this is timed once."""


def shortest(call, rounds):
    """Shortest time of a call in seconds, and its result."""
    best, result = np.inf, None
    for _ in range(rounds):
        start = time.perf_counter()
        result = call()
        best = min(best, time.perf_counter() - start)
        if best > SLOW:
            break
    return best, result
