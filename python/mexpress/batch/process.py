"""A process for workers: one thread for each library, deaf to Ctrl-C, and no longer alive than its parent."""

from __future__ import annotations

import multiprocessing
import os
import shutil
import signal
import threading
from multiprocessing.context import SpawnProcess
from pathlib import Path

_THREADS = "MEXPRESS_NUM_THREADS OMP_NUM_THREADS OPENBLAS_NUM_THREADS MKL_NUM_THREADS VECLIB_MAXIMUM_THREADS"
_STARTING = threading.Lock()


class Process(SpawnProcess):
    """A process whose libraries have one thread: they read the inherited variables when they are imported."""

    def start(self) -> None:
        """Start it, with the variables that tell libraries to have one thread."""
        with _STARTING:
            before = {name: os.environ.get(name) for name in _THREADS.split()}
            os.environ.update(dict.fromkeys(before, "1"))
            try:
                super().start()
            finally:
                for name, value in before.items():
                    del os.environ[name]
                    if value is not None:
                        os.environ[name] = value


def prepare(folder: Path) -> threading.Thread:
    """Let this process ignore Ctrl-C, and end with its parent; return the thread that sees to it.

    If the parent was killed, nobody else removes its folder.
    """

    def follow() -> None:
        if (parent := multiprocessing.parent_process()) is not None:
            parent.join()
            shutil.rmtree(folder, ignore_errors=True)
            os._exit(1)

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    thread = threading.Thread(target=follow, daemon=True)
    thread.start()
    return thread
