"""The stamp of a database: the number of its header and of its last commit, in a file beside it.

    6b8b4567
    00000000000000000042 1c291ca3

The second line has the number of the last commit, overwritten in place after each one, and its CRC-32. A
power cut may leave an older number, never one that was not committed.
"""

import os
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from zlib import crc32

from handover.files.durable_files import replace_durably
from handover.telemetry import get_logger

log = get_logger(__name__)

_DIGITS: Final = 20
_HEADER_BYTES: Final = 9


class InvalidStamp(ValueError):
    """The file is no stamp: its content was changed."""


@dataclass(frozen=True, slots=True)
class Stamp:
    """`commits` is None in a stamp of a version that counted no commits."""

    application_id: int
    commits: int | None


def stamp_of(database: Path) -> Path:
    """Return the path of the stamp of a database."""
    return database.with_name(f"{database.name}.stamp")


def read_stamp(database: Path) -> Stamp | None:
    """Return the stamp of a database, or None. Raises `InvalidStamp`, `OSError`."""
    try:
        content = stamp_of(database).read_bytes()
    except FileNotFoundError:
        return None
    lines = content.split(b"\n")
    try:
        application_id = int(lines[0], 16)
        if len(lines) == 2 and not lines[1]:
            return Stamp(application_id, None)
        if content == _content(application_id, int(lines[1].split(b" ")[0])):
            return Stamp(application_id, int(lines[1].split(b" ")[0]))
    except (ValueError, IndexError):
        pass
    raise InvalidStamp(f"{stamp_of(database)} is damaged")


def write_stamp(database: Path, stamp: Stamp) -> None:
    """Replace the stamp of a database durably. Raises `OSError`."""
    replace_durably(stamp_of(database), _content(stamp.application_id, stamp.commits or 0), mode=0o600)


class StampWriter:
    """Writes the number of the last commit into an existing stamp; thread-safe."""

    def __init__(self, database: Path) -> None:
        self._file = os.open(stamp_of(database), os.O_WRONLY | getattr(os, "O_BINARY", 0))
        self._lock = threading.Lock()
        self._commits = 0
        self._has_failed = False

    def note(self, commits: int) -> None:
        """Write the number of a commit that is durable; an older one has no effect.

        An error of the disk is logged once: the number is then too low, and less damage would be detected.
        """
        with self._lock:
            if commits <= self._commits:
                return
            self._commits = commits
            try:
                os.lseek(self._file, _HEADER_BYTES, os.SEEK_SET)
                os.write(self._file, _line(commits))
                self._has_failed = False
            except OSError as error:
                if not self._has_failed:
                    log.warning("the number of the last commit cannot be written", error=str(error))
                self._has_failed = True

    def sync(self) -> None:
        """Flush the number to the disk."""
        with self._lock:
            os.fsync(self._file)

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)


def _content(application_id: int, commits: int) -> bytes:
    return b"%08x\n" % application_id + _line(commits)


def _line(commits: int) -> bytes:
    number = b"%0*d" % (_DIGITS, commits)
    return number + b" %08x\n" % crc32(number)
