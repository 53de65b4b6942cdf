"""Log files of bounded size: a process replaces the file behind its own standard error.

The launcher names the file in `LOG_FILE`. A process that logs to it renames a full file to `….log.1`, in
place of an older one, and continues in a new file. Standard output and error are moved by file descriptor, so
that what native libraries print is in the new file too. Several processes may share a file: one that finds it
renamed follows. Nothing is copied, so no line is lost in between.
"""

import logging
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Final

from handover.settings import PREFIX

if sys.platform != "win32":
    import fcntl

LOG_FILE: Final = f"{PREFIX}LOG_FILE"
"""Set by the launcher: the file to which it has sent the standard output and error of the process."""
MAX_LOG_BYTES: Final = 10 * 1024 * 1024
FILE_MODE: Final = 0o600
_STREAMS: Final = (1, 2)


def open_log(path: Path) -> int:
    """Return a file descriptor that appends to the log file `path`; raises `OSError`."""
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    return os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, FILE_MODE)


def older(path: Path) -> Path:
    """Return the file with the lines before those in the log file `path`."""
    return path.with_name(f"{path.name}.1")


def rotate(path: Path, max_bytes: int = MAX_LOG_BYTES) -> None:
    """Rename the log file `path` if it has `max_bytes`; raises `OSError`."""
    if path.stat().st_size >= max_bytes:
        path.replace(older(path))


def own_log() -> Path | None:
    """Return the log file of this process; None if its standard error goes elsewhere."""
    named = os.environ.get(LOG_FILE)
    if not named or sys.platform == "win32":  # an open file has no other name there
        return None
    own = os.fstat(2)
    for path in (Path(named), older(Path(named))):  # another process may have renamed it just now
        with suppress(OSError):
            if os.path.samestat(path.stat(), own):
                return Path(named)
    return None


class LogFileHandler(logging.StreamHandler):  # type: ignore[type-arg]  # of whatever standard error is
    """Writes to standard error, which is the log file `path`, and replaces a file of `max_bytes`."""

    def __init__(self, path: Path, max_bytes: int = MAX_LOG_BYTES) -> None:
        super().__init__()
        self._path = path
        self._max_bytes = max_bytes

    def emit(self, record: logging.LogRecord) -> None:
        """Write `record`, to a new file if the present one is full."""
        with suppress(OSError):  # a full disk: the lines go to the present file as long as it accepts them
            if os.fstat(2).st_size >= self._max_bytes:
                self._renew()
        super().emit(record)

    def _renew(self) -> None:
        """Continue in the file at the path, after renaming it if it is still the full one."""
        present = os.fstat(2)
        named = open_log(self._path)
        try:
            fcntl.flock(named, fcntl.LOCK_EX)  # of this file: descriptors that were inherited share a lock
            status = os.fstat(named)
            if os.path.samestat(self._path.stat(), status) and os.path.samestat(status, present):
                rotate(self._path, self._max_bytes)
            new = open_log(self._path)
        finally:
            os.close(named)
        try:
            for stream in _STREAMS:
                if os.path.samestat(os.fstat(stream), present):
                    os.dup2(new, stream)
        finally:
            os.close(new)
