"""Space for a full disk: a file that is deleted when there is no other, and a log that has its space already.

With it a service starts and commits on a full disk for a while: its write-ahead log is overwritten in place.
"""

import errno
import os
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final, TypeVar

from handover.telemetry import get_logger

log = get_logger(__name__)

T = TypeVar("T")

RESERVE_BYTES: Final = 1024 * 1024
"""For the index of the log (32 KiB), the checksums of pages and a larger database file."""
LOG_BYTES: Final = 2 * 1024 * 1024
"""Some hundred commits of four pages."""


def reserve_of(database: Path) -> Path:
    """Return the path of the reserve of a database."""
    return database.with_name(f"{database.name}.reserve")


def keep_reserve(database: Path) -> None:
    """Create the reserve if there is none and the disk has space."""
    reserve = reserve_of(database)
    try:
        has_space = shutil.disk_usage(database.parent).free > 2 * RESERVE_BYTES
        if has_space and not reserve.exists():
            _allocate(reserve, RESERVE_BYTES)
    except OSError:
        with suppress(OSError):
            reserve.unlink(missing_ok=True)  # an incomplete one


def release_reserve(database: Path) -> bool:
    """Delete the reserve; return whether there was one."""
    try:
        reserve_of(database).unlink()
    except FileNotFoundError:
        return False
    return True


def is_lack_of_space(error: Exception) -> bool:
    """Return whether an error may be that of a full disk; SQLite reports some of them as input and output."""
    if isinstance(error, sqlite3.Error):
        return getattr(error, "sqlite_errorcode", 0) & 0xFF in _SPACE
    return isinstance(error, OSError) and error.errno in {errno.ENOSPC, errno.EDQUOT}


_SPACE: Final = frozenset({sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_CANTOPEN})


def with_reserve(database: Path, opened: Callable[[], T]) -> T:
    """Return the result of `opened`; if it fails for want of space, delete the reserve and try again."""
    try:
        return opened()
    except (sqlite3.OperationalError, OSError) as error:
        if not (is_lack_of_space(error) and release_reserve(database)):
            raise
        log.warning("the reserve for a full disk is used", file=str(database), error=str(error))
        return opened()


def reserve_log(file: Path) -> None:
    """Give an open write-ahead log its space. SQLite ignores what follows the last frame of a log."""
    try:
        if file.exists() and file.stat().st_size < LOG_BYTES:
            _allocate(file, LOG_BYTES)
    except OSError:
        return  # a full disk: it has the space that it has


def _allocate(file: Path, size: int) -> None:
    descriptor = os.open(file, os.O_CREAT | os.O_WRONLY, 0o600)
    try:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(descriptor, 0, size)
        else:
            os.lseek(descriptor, 0, os.SEEK_END)
            os.write(descriptor, bytes(size - os.fstat(descriptor).st_size))
    finally:
        os.close(descriptor)
