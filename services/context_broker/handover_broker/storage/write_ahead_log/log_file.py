"""One of the two files of the log; it has its full size before the first frame is written."""

import os
import time
from pathlib import Path
from typing import BinaryIO, Final

from handover.files.durable_files import sync_folder
from handover_broker.storage.write_ahead_log.frames import (
    FILE_BYTES,
    PAGE_BYTES,
    SECTOR_BYTES,
    FileContent,
    FileHeader,
    UnknownVersion,
    decode_file,
    decode_header,
    encode_header,
)

_DSYNC: Final = getattr(os, "O_DSYNC", 0)
"""With this flag a write returns when it is durable, without a second call."""


class Damaged(Exception):
    """Acknowledged changes cannot be read, or may be incomplete; the message names the file."""


class LogFile:
    """A file of frames of one log."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.end = PAGE_BYTES
        """Offset of the next frame."""
        self.last_number = 0
        """The number of the last frame."""
        self._handle: BinaryIO | None = None

    def header(self) -> FileHeader | None:
        """Return the header; None if it cannot be read. Raises `UnknownVersion`."""
        try:
            with self.path.open("rb") as file:
                sector = file.read(SECTOR_BYTES)
        except FileNotFoundError:
            return None
        try:
            return decode_header(sector)
        except UnknownVersion as error:
            raise UnknownVersion(f"{self.path} is of {error.what}") from None

    def content(self) -> FileContent:
        """Return the frames of the log that the header names."""
        header = self.header()
        return decode_file(self.path.read_bytes(), b"" if header is None else header.log_id)

    def content_of(self, database_id: bytes, log_id: bytes) -> FileContent:
        """Return the frames of a log that was not closed. Raises `Damaged` and `UnknownVersion`."""
        if not self.path.exists():
            raise Damaged(f"{self.path} is missing, which holds changes that are not in the tables yet")
        if (size := self.path.stat().st_size) != FILE_BYTES:
            raise Damaged(
                f"{self.path} has {size} bytes instead of {FILE_BYTES}: it was cut, or is of another version"
            )
        header = self.header()
        if header is None:
            raise Damaged(f"{self.path}: its first page is damaged")
        if header.database_id != database_id:
            raise Damaged(f"{self.path} belongs to another database")
        if header.log_id != log_id or header.is_closed:
            raise Damaged(f"{self.path} is not of the last start of the database: one of the two is older")
        return self.content()

    def prepare(self, header: FileHeader) -> None:
        """Open the file, clear it, extend it to its full size, and write its header."""
        self.end, self.last_number = PAGE_BYTES, 0
        if self._handle is None:
            self._handle = open(  # noqa: SIM115 - it stays open
                self.path, "r+b" if self.path.exists() else "w+b", buffering=0, opener=_open_synced
            )
        try:
            content = self._handle.read() if self._handle.seek(0) == 0 else b""
            used = FILE_BYTES if len(content) < FILE_BYTES else len(content.rstrip(b"\0"))
            if used > PAGE_BYTES:
                self._handle.seek(PAGE_BYTES)
                _write(self._handle, bytes(used - PAGE_BYTES))
            if len(content) > FILE_BYTES:
                self._handle.truncate(FILE_BYTES)
            self._handle.seek(0)
            _write(self._handle, encode_header(header))
            if not _DSYNC or len(content) != FILE_BYTES:
                os.fsync(self._handle.fileno())
                sync_folder(self.path.parent)
        except OSError:
            self.close()
            raise

    def measure_write_s(self) -> float:
        """Return how long it takes to write a page; the file must not have changes that are needed."""
        started_s = time.perf_counter()
        self.write(PAGE_BYTES, bytes(PAGE_BYTES))
        return time.perf_counter() - started_s

    def write(self, offset: int, content: bytes) -> None:
        """Write at an offset and return when it is durable."""
        handle = self._handle
        assert handle is not None  # noqa: S101 - prepare() has opened it
        handle.seek(offset)
        _write(handle, content)
        if not _DSYNC:
            os.fsync(handle.fileno())

    def close(self) -> None:
        """Close the file."""
        if self._handle is not None:
            self._handle.close()
            self._handle = None


def _open_synced(path: str, flags: int) -> int:
    return os.open(path, flags | _DSYNC, 0o644)


def _write(file: BinaryIO, content: bytes) -> None:
    rest = memoryview(content)
    while rest:
        rest = rest[file.write(rest) :]
