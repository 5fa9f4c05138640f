"""One tall problem in a process of its own: what it takes, as a line of JSON. `versus.py` starts it.

Usage: ``python tall.py mexpress|numpy ROWS COLUMNS THREADS``
"""

import json
import re
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

import mexpress as mx


def peak_bytes() -> int:
    """The most memory this process ever held.

    Linux keeps `ru_maxrss` across exec, so that it may be the parent's; ``VmHWM`` is this program's own.
    """
    status = Path("/proc/self/status")
    if status.exists():
        return 1024 * int(re.search(r"VmHWM:\s+(\d+)", status.read_text())[1])
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak


def closed_form(A: np.ndarray, b: np.ndarray, threads: int, clock: Callable[[str], None]) -> None:
    model = mx.LeastSquares(A, b, coupling=2, threads=threads)
    clock("fit")
    scheme = mx.schemes.leave_one_out(model.n_data)
    clock("scheme")
    model.cross_validate(scheme, threads=threads)
    clock("cross-validate")


def factor(A: np.ndarray, _b: np.ndarray, _threads: int, clock: Callable[[str], None]) -> None:
    np.linalg.qr(A)
    clock("numpy.linalg.qr")


def main() -> None:
    who, m, p, threads = sys.argv[1], *map(int, sys.argv[2:])
    rng = np.random.default_rng(0)
    A, b = rng.standard_normal((m, p)), rng.standard_normal(m)
    seconds: dict[str, float] = {}
    before, last = peak_bytes(), time.perf_counter()

    def clock(part: str) -> None:
        nonlocal last
        now = time.perf_counter()
        seconds[part], last = now - last, now

    with threadpool_limits(threads):
        last = time.perf_counter()
        {"mexpress": closed_form, "numpy": factor}[who](A, b, threads, clock)
    print(json.dumps({"seconds": seconds, "before": before, "peak": peak_bytes(), "design": A.nbytes}))


if __name__ == "__main__":
    main()
