"""The log in front of an SQLite file: every commit is a frame, flushed before anybody hears that it is safe.

SQLite writes whole pages for a change of some hundred bytes, and calls back into the interpreter for each
statement. A frame is one write, to space that the file has already: to flush a file that grows costs the
disk four times as much. There are two files of one size, used by turns; what is in one is overwritten once it
is filed in the tables. So the log stays small, and is read in no time after a crash.

A frame begins on a page of its own, so that a write cut short by a power cut harms no earlier frame. Its head
tells which opening of the broker wrote it: a log beside a database that was restored from elsewhere is of
another opening, and is passed over.
"""

import os
import struct
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, Final
from zlib import crc32

PAGE: Final = 4096
SIZE: Final = 512 * PAGE
"""Bytes of a file: a thousand changes or two, which wait in memory too until they are filed."""

TRIES: Final = 3

_HEAD: Final = struct.Struct("<8s8sQII")
"""Mark, opening, number, length of the record, and the checksum of all of these and the record."""
_MARK: Final = b"HANDOVER"
_SUM_AT: Final = _HEAD.size - 4
_SYNCED: Final = getattr(os, "O_DSYNC", 0)
"""Where there is this, a write returns when it is safe, and needs no second call."""


class Damaged(Exception):
    """A frame that was acknowledged cannot be read."""


class Log:
    """Frames in two files beside `path`, numbered from 1 on. Written by one thread at a time."""

    def __init__(self, path: Path) -> None:
        self._files = (_File(path.with_suffix(".log-1")), _File(path.with_suffix(".log-2")))
        self._active = 0
        self._opening = b""
        self._filed = 0
        self.number = 0
        """Of the last frame."""

    def read(self, opening: bytes, filed: int) -> list[bytes]:
        """Return the records after number `filed` that an opening wrote.

        A last one that was cut short is passed over, since nobody was told that it is safe. Raises `Damaged`
        where one is missing before others, and OSError.
        """
        found = dict(frame for file in self._files for frame in file.frames(opening))
        missing = filed + 1
        while missing in found:
            missing += 1
        last = max(found, default=0)
        if last > missing:
            raise Damaged(
                f"change {missing} cannot be read, and {last} is there; to go on without the changes "
                f"from {missing} on, move {' and '.join(str(file.path) for file in self._files)} away"
            )
        return [found[number] for number in range(filed + 1, missing)]

    def begin(self, opening: bytes) -> None:
        """Begin anew for an opening (8 bytes that no other has); what is there is overwritten."""
        self._opening = opening
        self._active = self._filed = self.number = 0
        self._files[0].prepare()

    def tried_s(self) -> float:
        """Return how long it takes to write a frame; before the first one."""
        return min(self._files[0].tried_s() for _ in range(TRIES))

    @property
    def is_tight(self) -> bool:
        """Say whether the file that is not in use holds what is not filed yet."""
        return self._files[1 - self._active].last > self._filed

    def has_room(self, record: bytes) -> bool:
        """Say whether a record fits; if not, it does when everything is filed (unless it `never_fits`)."""
        return self._roomy(_pages(len(record))) is not None

    @staticmethod
    def never_fits(record: bytes) -> bool:
        """Say whether a record is too long for a file."""
        return _pages(len(record)) > SIZE

    def append(self, record: bytes) -> None:
        """Write a record for which there is room and return when it is safe; raises OSError if it is not."""
        room = self._roomy(_pages(len(record)))
        assert room is not None  # noqa: S101 - whoever writes has asked for room
        file = self._files[room]
        number = self.number + 1
        head = bytearray(_HEAD.pack(_MARK, self._opening, number, len(record), 0))
        head[_SUM_AT:] = crc32(record, crc32(head)).to_bytes(4, "little")
        start = 0 if file.last <= self._filed else file.end
        frame = b"".join((head, record, bytes(_pages(len(record)) - _HEAD.size - len(record))))
        try:
            file.write(start, frame)
        except OSError:
            with suppress(OSError):  # else it might be there after a crash, though it was refused
                file.write(start, bytes(PAGE))
            raise
        file.end = start + len(frame)
        file.last = self.number = number
        self._active = room

    def filed(self, number: int) -> None:
        """Note that the tables hold everything up to frame `number`."""
        self._filed = number

    def close(self) -> None:
        """Let go of the files."""
        for file in self._files:
            file.close()

    def _roomy(self, length: int) -> int | None:
        """Return which file has room, the one in use before the other."""
        file = self._files[self._active]
        taken = 0 if file.last <= self._filed else file.end
        if taken + length <= SIZE:
            return self._active
        return None if self.is_tight or length > SIZE else 1 - self._active


class _File:
    """One of the two: as long as it ever gets before the first frame is written."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.end = 0
        """Where the next frame begins."""
        self.last = 0
        """Number of the last frame."""
        self._file: BinaryIO | None = None

    def frames(self, opening: bytes) -> Iterator[tuple[int, bytes]]:
        """Yield number and record of every whole frame of an opening, whatever lies between them."""
        try:
            content = self.path.read_bytes()
        except FileNotFoundError:
            return
        at = 0
        while at + _HEAD.size <= len(content):
            mark, of, number, length, checksum = _HEAD.unpack_from(content, at)
            record = content[at + _HEAD.size : at + _HEAD.size + length]
            head = content[at : at + _SUM_AT]
            if (mark, of) == (_MARK, opening) and crc32(record, crc32(head + bytes(4))) == checksum:
                yield number, record
                at += _pages(length)
            else:
                at += PAGE

    def prepare(self) -> None:
        """Open the file, and make it as long as it is to be."""
        self.end = self.last = 0
        if self._file is not None:
            return
        file = open(  # noqa: SIM115 - it stays open
            self.path, "r+b" if self.path.exists() else "w+b", buffering=0, opener=_open_synced
        )
        try:
            missing = SIZE - file.seek(0, os.SEEK_END)
            if missing > 0:
                _write(file, bytes(missing))
                os.fsync(file.fileno())
        except OSError:
            file.close()
            raise
        _flush_folder(self.path.parent)
        self._file = file

    def tried_s(self) -> float:
        """Return how long it takes to write a page; nothing that is needed may be in the file."""
        began_s = time.perf_counter()
        self.write(0, bytes(PAGE))
        return time.perf_counter() - began_s

    def write(self, at: int, frame: bytes) -> None:
        """Write a frame and return when it is safe."""
        if self._file is None:
            self.prepare()
        file = self._file
        assert file is not None  # noqa: S101 - it has been prepared
        file.seek(at)
        _write(file, frame)
        if not _SYNCED:
            os.fsync(file.fileno())

    def close(self) -> None:
        """Let go."""
        if self._file is not None:
            self._file.close()
            self._file = None


def _open_synced(path: str, flags: int) -> int:
    return os.open(path, flags | _SYNCED, 0o644)


def _write(file: BinaryIO, content: bytes) -> None:
    rest = memoryview(content)
    while rest:
        rest = rest[file.write(rest) :]


def _flush_folder(folder: Path) -> None:
    """See that the name of a new file survives a power cut, where folders can be flushed."""
    if os.name != "nt":
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _pages(length: int) -> int:
    """Return the bytes that the frame of a record of so many takes: whole pages."""
    return -(-(_HEAD.size + length) // PAGE) * PAGE
