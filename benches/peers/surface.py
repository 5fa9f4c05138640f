"""One selection of a surface in a process of its own: what it takes, as a line of JSON. `nested.py` starts it.

Usage: ``python surface.py DATA.npz MAX_COUNT THREADS CRITERION...``
"""

import json
import sys
import time

import numpy as np
from tall import peak_bytes

import mexpress as mx


def main() -> None:
    path, most, threads, *criteria = sys.argv[1:]
    with np.load(path) as data:
        points, values = data["points"], data["values"]

    def select(count: int, most: int) -> mx.SurfaceSelection:
        return mx.select_surface(
            points[:count],
            values[:count],
            criteria[0],
            criteria,
            most,
            threads=int(threads),
            smoothing=0,
        )

    select(500, 10)  # threads and code are there afterwards
    before, start = peak_bytes(), time.perf_counter()
    selection = select(len(points), int(most))
    seconds = time.perf_counter() - start
    curves = {name: curve.tolist() for name, curve in selection.curves.items()}
    found = {"seconds": seconds, "before": before, "peak": peak_bytes(), "selected": selection.selected}
    print(json.dumps(found | {"counts": selection.counts.tolist(), "curves": curves}))


if __name__ == "__main__":
    main()
