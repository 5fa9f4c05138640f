"""The memory of several benchmarks."""

import ctypes
import threading
from pathlib import Path


class Memory:
    """The most memory of the process while it works, in GiB: its own, and with pages of files."""

    def __enter__(self):
        self.before, self.all = self.now()
        self.own = self.before
        self.done = threading.Event()
        self.thread = threading.Thread(target=self.watch)
        self.thread.start()
        return self

    @staticmethod
    def now():
        """Memory of this moment."""
        told = dict(line.split(":") for line in Path("/proc/self/status").read_text().splitlines())
        own, files = (int(told[name].split()[0]) / 2**20 for name in ("RssAnon", "RssFile"))
        return own, own + files

    def watch(self):
        """Look at the process time and again."""
        while not self.done.wait(0.01):
            own, with_files = self.now()
            self.own, self.all = max(self.own, own), max(self.all, with_files)

    def __exit__(self, *_):
        self.done.set()
        self.thread.join()

    @property
    def more(self):
        """Its own beyond what it had before."""
        return self.own - self.before


def memory_of(call):
    """Memory that a call takes beyond what there was, in MiB; its result is dropped."""
    ctypes.CDLL(None).malloc_trim(0)  # or what earlier calls gave back would be used again unseen
    with Memory() as memory:
        call()
    return 1024 * memory.more
