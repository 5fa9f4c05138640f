"""Worker processes and the loop that minds them.

The standard executor will not do: if one of its processes is killed it ends them all, it cannot stop one call, and it
waits for ever for a result of which a killed process had sent half.
"""

from __future__ import annotations

import atexit
import math
import os
import shutil
import time
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from itertools import count
from multiprocessing.connection import Pipe, wait
from pathlib import Path
from tempfile import mkdtemp, mkstemp

from mexpress.batch.agenda import TICK, Agenda, Results
from mexpress.batch.calls import Task, failed, timed_out, unpacked
from mexpress.batch.parcels import parcel, weight
from mexpress.batch.pickling import dumps, frames, send
from mexpress.batch.process import Process
from mexpress.batch.serving import SPELL, serve
from mexpress.batch.sharing import Bytes, Call, Sharing
from mexpress.batch.spool import Packed, kept, unframed
from mexpress.batch.tray import ROOM, Tray
from mexpress.logger import LOG

_STARTS = 3
"""How many processes may be killed before they are ready."""

_UNABLE = (
    "A worker process ended before it was ready, with exit code {}. It could not import the script: "
    "a script calls this under if __name__ == '__main__'."
)
_DEAD = "The worker process ended, with exit code {}: it crashed, ran out of memory, or was killed."


class Worker:
    """One process, and the problems that it has."""

    def __init__(self, payload: bytes, spool: Path) -> None:
        self.spool = spool
        self.connection, there = Pipe()
        self.process = Process(target=serve, args=(there, spool, payload))
        self.process.start()
        there.close()
        self.ready = self.idle = self.ended = False
        self.given = 0
        self.tray: Tray | None = None
        self.left: dict[int, None] = {}  # in the order in which it takes them
        self.begun = self.heard = 0.0

    def begin(self, indices: Iterable[int], some: list[bytes | memoryview], tray: Tray) -> None:
        """Give it problems. It must be idle, and so reads: neither waits for the other."""
        self.idle = False
        self.left, self.tray = dict.fromkeys(indices), tray
        self.given = len(self.left)
        self.begun = self.heard = time.monotonic()
        with suppress(OSError):  # if it has ended, it will be found
            send(self.connection, some)

    def receive(self) -> list[Packed]:
        """Return outcomes that it has sent. Then it may be idle, with problems left that it gives back."""
        try:
            message = self.connection.recv_bytes()
        except (EOFError, OSError):
            self.ended = True
            return []
        self.heard = time.monotonic()
        if self.ready:
            self.idle = bool(message[0])
            return self._tick_off(unframed(memoryview(message)[1:]))
        if message:
            raise RuntimeError(f"A worker process could not begin: {message.decode()}")
        self.ready = self.idle = True
        return []

    def look(self) -> Iterator[Packed]:
        """See whether it has begun a call since it was heard; return the outcomes that it keeps."""
        begun, outcomes = kept(self.spool)
        self.heard = max(self.heard, begun)
        return outcomes

    def end(self) -> list[Packed]:
        """End it; return outcomes that it had not sent yet, or that nobody has read."""
        if self.ended:
            self.process.join(TICK)  # its exit code is there soon after the end of its connection
        self.process.kill()
        self.process.join()
        found: list[Packed] = []
        while not self.ended and self.connection.poll():
            found += self.receive()
        self.connection.close()
        return found + self._tick_off(self.look())

    def dismiss(self) -> None:
        """Let it go if it is idle, and end it if it is not."""
        if self.idle:
            with suppress(OSError):
                send(self.connection, frames(None))
        else:
            self.process.kill()

    def leave(self) -> None:
        """Wait until it has gone."""
        self.process.join(TICK)
        self.process.kill()
        self.process.join()
        self.connection.close()

    def _tick_off(self, outcomes: Iterable[Packed]) -> list[Packed]:
        new = [(index, packed) for index, packed in outcomes if index in self.left]
        for index, _ in new:
            del self.left[index]
        return new


class Crew:
    """The workers of one run."""

    def __init__(self, task: Task, calls: Sequence[Call], agenda: Agenda, timeout: float | None) -> None:
        self.agenda, self.timeout = agenda, timeout
        self.owner = os.getpid()
        self.folder = Path(mkdtemp(prefix="mexpress-"))
        self.files = (self.folder / f"{number}.memory" for number in count())
        self.trays: list[Tray] = []
        self.calls = calls
        self.next: tuple[Sequence[int], list[bytes | memoryview], Tray] | None = None
        self.workers: list[Worker] = []
        self.starts = 0
        atexit.register(self.close)  # before multiprocessing waits for all processes
        try:
            self.sharing = Sharing(calls, task.options, self._store, mapped=True)
            self.payload = dumps((task.function, self.sharing.light((), task.options), self.sharing.sources))
        except BaseException:
            self.close()
            raise

    def _store(self, array: Bytes) -> Path:
        descriptor, name = mkstemp(".array", dir=self.folder)
        with open(descriptor, "wb") as file:
            array.tofile(file)
        return Path(name)

    def close(self) -> None:
        """End all workers, unless this is a forked child, which has none."""
        atexit.unregister(self.close)
        if os.getpid() != self.owner:
            return
        for worker in self.workers:
            worker.dismiss()
        for worker in self.workers:
            worker.leave()
        shutil.rmtree(self.folder, ignore_errors=True)

    def employ(self, number: int) -> Results:
        """Have as many workers as there is work for, and give problems to those that are idle."""
        while len(self.workers) < min(number, len(self.agenda.unsettled)):
            self.workers.append(Worker(self.payload, next(self.files)))
        refused: Results = []
        for worker in self.workers:
            if worker.idle:
                refused += self._prepare(number)
                self._occupy(worker)
        return refused + self._prepare(number)  # while all are busy, for the first that will not be

    def _prepare(self, number: int) -> Results:
        """Have problems ready to be sent, if any are left; return those that cannot be, if they have failed."""
        results: Results = []
        while not self.next and (chunk := self.agenda.take(number, SPELL, self._room)):
            tray = self.trays.pop() if self.trays else Tray(next(self.files))
            tray.clear()
            some, refused = parcel(chunk, self.calls, self.sharing, tray)
            if some.indices:
                self.next = some.indices, frames(some), tray
            else:
                self.trays.append(tray)
            results += self.agenda.settle((index, failed(index, error)) for index, error in refused)
        return results

    def _room(self, index: int) -> int:
        """Return how many problems like this one have room on a tray."""
        return max(1, ROOM // max(1, weight(self.calls[index], self.sharing)))

    def _occupy(self, worker: Worker) -> None:
        """Give an idle worker what is ready to be sent."""
        if self.next:
            worker.begin(*self.next)
            self.next = None

    def _free(self, worker: Worker) -> None:
        """Take back the tray of a worker that no longer looks at it."""
        if worker.tray:
            self.trays.append(worker.tray)
            worker.tray = None

    def hear(self) -> Iterator[Results]:
        """Wait until a worker says something, ends, or takes too long."""
        ready = wait([worker.connection for worker in self.workers], self._patience())
        for worker in list(self.workers):
            if worker.connection in ready:
                results = self._settled(worker.receive())
                if worker.idle:
                    self.agenda.put_back(worker.left)
                    self.agenda.learn(worker.given - len(worker.left), worker.heard - worker.begun)
                    worker.left = {}
                    self._free(worker)
                    self._occupy(worker)  # before anybody looks at results
                yield results
            if worker.ended or not worker.process.is_alive():
                yield self._lose(worker)
            elif self._is_late(worker):
                yield self._stop(worker)

    def _wait(self, worker: Worker) -> float:
        """Return the seconds that are left to the call that a worker makes."""
        if self.timeout is None or not worker.left:
            return math.inf
        return worker.heard + self.timeout - time.monotonic()

    def _patience(self) -> float:
        return max(0.0, min([TICK, *map(self._wait, self.workers)]))

    def _is_late(self, worker: Worker) -> bool:
        if self._wait(worker) > 0 or worker.connection.poll():  # it may wait until what it says is heard
            return False
        worker.look()
        return self._wait(worker) <= 0

    def _settled(self, outcomes: Iterable[Packed]) -> Results:
        return self.agenda.settle((index, unpacked(index, packed)) for index, packed in outcomes)

    def _lose(self, worker: Worker) -> Results:
        """Take leave of a worker that has ended; the problem that it worked on may be why."""
        self.workers.remove(worker)
        results = self._settled(worker.end())
        self._free(worker)
        code = worker.process.exitcode
        LOG.warning("A worker process ended, with exit code %s.", code)
        if worker.ready and worker.left:
            index, *others = worker.left
            self.agenda.put_back(others)
            results += self.agenda.lose(index, RuntimeError(_DEAD.format(code)))
        elif not worker.ready:
            self.starts += 1
            if self.starts == _STARTS or (code or 0) >= 0:
                raise RuntimeError(_UNABLE.format(code))
        return results

    def _stop(self, worker: Worker) -> Results:
        """End a worker whose call takes too long, unless it came to an end in the meantime."""
        self.workers.remove(worker)
        heard = worker.heard
        results = self._settled(worker.end())
        self._free(worker)
        if worker.left and worker.heard == heard:
            late = next(iter(worker.left))
            del worker.left[late]
            results += self.agenda.settle([(late, timed_out(late, self.timeout or 0))])
        self.agenda.put_back(worker.left)
        return results


def by_processes(
    task: Task, calls: Sequence[Call], agenda: Agenda, number: int, timeout: float | None
) -> Generator[Results, None, None]:
    """Make calls in so many processes of one thread each."""
    with closing(Crew(task, calls, agenda, timeout)) as crew:
        while agenda.unsettled:
            yield crew.employ(number)
            yield from crew.hear()
