"""The lock of a SQLite file: one process at a time owns a database of ours.

SQLite lets several processes write one file, but a service keeps state in memory, so two of them on one
folder would both act. A process that serves therefore locks `<database>.lock` beside each database that it
owns, until it ends; `handover.database.connect` does it for every service. The operating system releases the
lock at any end of the process, `kill -9` included. Programs that only read (`handover check`, a backup) need
no lock.

The lock is a record lock (`fcntl`), as SQLite's own: it works where SQLite works, and a forked child does not
keep it alive. Such a lock ends when the process closes any descriptor of the file, so the file is opened only
here. It contains who holds the lock, for the message to the second process.
"""

import os
import socket
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import orjson

from handover.errors import UsageError
from handover.settings import Settings

POLL_S: Final = 1.0
"""Pause between two attempts of a process that stands by."""
LOCK_SUFFIX: Final = ".lock"
STANDBY_SETTING: Final = "HANDOVER_STANDBY"


_SERVER_URL: Final = "database_url"
_SHORT_NAMES: Final = {"context-broker": "broker"}
"""Names in messages and lock files, where they differ from that of the service."""


class FileInUse(UsageError):
    """Another process owns the database."""


@dataclass(frozen=True, slots=True)
class Holder:
    """The process that holds a lock, as the lock file names it."""

    service: str
    pid: int
    host: str
    since: str

    def __str__(self) -> str:
        return f"process {self.pid} on {self.host}, since {self.since}"


@dataclass
class _HeldLock:
    descriptor: int
    uses: int = 1


@dataclass
class _Process:
    """What this process is and holds."""

    service: str | None = None
    is_shared: bool = False
    """Whether services share one SQLite file by HANDOVER_DATABASE_URL: then each has a lock of its own."""
    held: dict[Path, _HeldLock] = field(default_factory=dict)
    turn: threading.Lock = field(default_factory=threading.Lock)


_process = _Process()


def serve_alone(settings: Settings, service: str, say: Callable[[str], None]) -> None:
    """Declare that this process runs `service`: from now on it locks each database that it owns.

    Without a database server it locks its name in the data directory as well, first of all: with the setting
    `standby` it waits there for the present holder, which `say` reports once, before it opens anything.
    Raises `FileInUse`.
    """
    name = _process.service = _SHORT_NAMES.get(service, service)
    _process.is_shared = bool(settings.database_url)
    if any(getattr(settings, field) for field in type(settings).model_fields if field.endswith(_SERVER_URL)):
        return
    try:
        hold(settings.data_dir / service, name, say if settings.standby else None)
    except OSError as error:
        raise UsageError(
            f"the data directory {settings.data_dir.absolute()} cannot be locked: {error.strerror}; use a "
            "file system with locks, or set HANDOVER_DATA_DIR to another directory"
        ) from None


def lock_own(path: Path) -> None:
    """Lock a database for the rest of the process, if it serves; see `hold`."""
    if _process.service is not None:
        suffix = f".{_process.service}" if _process.is_shared else ""
        hold(path.with_name(f"{path.name}{suffix}"), _process.service)


def hold(
    path: Path, service: str, stand_by: Callable[[str], None] | None = None, *, is_only_use: bool = False
) -> Callable[[], None]:
    """Lock the database `path` for this process, and return the function that releases it.

    A process may hold it several times, unless `is_only_use`. `stand_by` waits for another process that
    holds it, and gets one line about that. Raises `FileInUse` otherwise, and `OSError` if the lock file
    cannot be used.
    """
    file = path.with_name(f"{path.name}{LOCK_SUFFIX}").absolute()
    is_reported = False
    while not _acquire(file, service, is_only_use=is_only_use):
        in_use = _in_use(file, service)
        if stand_by is None:
            raise FileInUse(
                f"{in_use}; stop it, give this one another HANDOVER_DATA_DIR, or set {STANDBY_SETTING}=true "
                "to wait for its end"
            )
        if not is_reported:
            stand_by(f"standby: {in_use}; this one starts when it ends")
            is_reported = True
        time.sleep(POLL_S)
    is_released = threading.Event()

    def release() -> None:
        if not is_released.is_set():
            is_released.set()
            _release(file)

    return release


def holders_in(folder: Path) -> list[str]:
    """Return a line about each other process that has a database or a service in `folder`."""
    holders = []
    for file in sorted(folder.glob(f"*{LOCK_SUFFIX}")):
        name = file.name.removesuffix(LOCK_SUFFIX)
        try:
            hold(file.with_name(name), name, is_only_use=True)()
        except FileInUse:
            holder = _named_in(file)
            holders.append(f"{name}: {holder}" if holder is not None else name)
    return holders


def _in_use(file: Path, service: str) -> str:
    holder = _named_in(file)
    who = "a process that the lock file does not name" if holder is None else str(holder)
    database = file.with_suffix("")
    where = database if database.suffix else database.parent  # a service locks its name in its folder
    return f"another {holder.service if holder else service} runs on {where}: {who}"


def _acquire(file: Path, service: str, *, is_only_use: bool) -> bool:
    with _process.turn:
        if (held := _process.held.get(file)) is not None:
            held.uses += not is_only_use
            return not is_only_use
        file.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            is_locked = _lock(descriptor)
        except OSError:
            os.close(descriptor)
            raise
        if not is_locked:
            os.close(descriptor)
            return False
        _write_holder(descriptor, service)
        _process.held[file] = _HeldLock(descriptor)
        return True


def _release(file: Path) -> None:
    with _process.turn:
        lock = _process.held.get(file)
        if lock is None:
            return
        lock.uses -= 1
        if not lock.uses:
            del _process.held[file]
            os.close(lock.descriptor)


def _write_holder(descriptor: int, service: str) -> None:
    since = datetime.now(UTC).isoformat(timespec="seconds")
    text = orjson.dumps(
        {"service": service, "pid": os.getpid(), "host": socket.gethostname(), "since": since}
    )
    try:
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, text + b"\n", 0)
    except OSError:  # a full disk: the lock holds without a name
        return


def _named_in(file: Path) -> Holder | None:
    try:
        read = orjson.loads(file.read_bytes())
        return Holder(str(read["service"]), int(read["pid"]), str(read["host"]), str(read["since"]))
    except (OSError, ValueError, TypeError, KeyError):
        return None


if sys.platform == "win32":
    import msvcrt

    def _lock(descriptor: int) -> bool:
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except PermissionError:
            return False
        return True

else:
    import fcntl

    def _lock(descriptor: int) -> bool:
        try:
            fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (BlockingIOError, PermissionError):  # POSIX permits EAGAIN and EACCES
            return False
        return True

    os.register_at_fork(after_in_child=_process.held.clear)
