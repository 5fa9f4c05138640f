"""Files that one process at a time writes.

Examples
--------
>>> import tempfile
>>> with tempfile.TemporaryDirectory() as folder:
...     lock = Lock(Path(f"{folder}/rows.csv.lock"))
...     try:
...         Lock(Path(f"{folder}/rows.csv.lock"))
...     except BlockingIOError:
...         print("somebody has it")
...     lock.release()
...     Lock(Path(f"{folder}/rows.csv.lock")).release()
somebody has it
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

__all__ = ["Lock"]


class Lock:
    """A lock that the system takes back when its process ends, however it ends: none is ever stale.

    Parameters
    ----------
    path : Path
        Of the file to lock, which is there as long as it is locked, or after a crash.

    Raises
    ------
    BlockingIOError
        If a process has it, this one among them.
    OSError
        If the file cannot be made.

    Examples
    --------
    See the module.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        while True:
            self._file = path.open("ab")
            try:
                self._lock()
                if self._is_there():
                    return
            except OSError as error:
                self._file.close()
                raise BlockingIOError(*error.args) from error
            self._file.close()  # removed by who had it, between our opening and locking it

    def _lock(self) -> None:
        if sys.platform == "win32":
            self._file.seek(0)
            msvcrt.locking(self._file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _is_there(self) -> bool:
        """Whether what is locked is what others will open."""
        with suppress(FileNotFoundError):
            return os.path.samestat(os.fstat(self._file.fileno()), self._path.stat())
        return False

    def release(self) -> None:
        """Remove the file, and let others have it.

        Examples
        --------
        See the module.
        """
        if sys.platform == "win32":  # which removes no file that somebody has opened
            self._file.close()
            with suppress(PermissionError, FileNotFoundError):
                self._path.unlink()
        else:
            self._path.unlink(missing_ok=True)
            self._file.close()
