"""What a benchmark ran on."""

import os
import platform
import re
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_info

import mexpress as mx

CORES = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def machine() -> str:
    """Processor, cores and versions, in a line."""
    info = Path("/proc/cpuinfo")
    model = re.search(r"model name\s*:\s*(.*)", info.read_text()) if info.exists() else None
    blas = {
        f"{pool['internal_api']} {pool['version']} ({pool.get('architecture')})"
        for pool in threadpool_info()
        if pool["user_api"] == "blas"
    }
    versions = f"Python {platform.python_version()}, numpy {np.__version__} with {', '.join(sorted(blas))}"
    processor = model[1] if model else platform.processor() or platform.machine()
    return f"{processor}, {CORES} to use; {versions}, mexpress {mx.__version__}"
