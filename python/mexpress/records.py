"""A file that gets record after record, from which long work that was interrupted goes on."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path

from mexpress import _validation as check

_HEAD = struct.Struct("<IQ")


class Records:
    """Records of bytes in a file with a title. What follows the last whole one is cut off: work ended while it wrote.

    Parameters
    ----------
    path : Path
        The file; it is made if it is not there.
    title : bytes
        What it begins with. A file that begins with something else is refused, and left as it is.
    rule : str
        What a file must be, for the message.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     for _ in range(2):
    ...         records = Records(Path(folder, "file"), b"squares", "It must hold squares.")
    ...         print(list(records))
    ...         records.add([b"4", b"9"])
    []
    [b'4', b'9']
    """

    def __init__(self, path: Path, title: bytes, rule: str) -> None:
        self.path, self.start = path, len(title)
        with path.open("a+b", buffering=0) as file:
            file.seek(0)
            given = file.read(len(title))
            if not title.startswith(given):
                check.refuse("resume", rule, f"{path}, which begins with {check.describe(given[:40])}")
            file.write(title[len(given) :])
            file.truncate(self.start + sum(_HEAD.size + len(record) for record in self))

    def __iter__(self) -> Iterator[bytes]:
        with self.path.open("rb") as file:
            end = file.seek(0, os.SEEK_END)
            file.seek(self.start)
            while len(head := file.read(_HEAD.size)) == _HEAD.size:
                checksum, length = _HEAD.unpack(head)
                # What is no head may tell of more bytes than memory has.
                record = file.read(min(length, end - file.tell()))
                # No record is empty: zeros of a lost page would be many.
                if not length or len(record) != length or zlib.crc32(record) != checksum:
                    return
                yield record

    def add(self, records: Iterable[bytes]) -> None:
        """Write records of a byte or more, at once."""
        parts = [part for record in records for part in (_HEAD.pack(zlib.crc32(record), len(record)), record)]
        # Without a buffer, a disk that is full takes a part and tells nobody.
        with self.path.open("ab") as file:
            file.write(b"".join(parts))
