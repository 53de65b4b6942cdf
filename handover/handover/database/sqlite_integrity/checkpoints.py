"""Counted commits, and checkpoints that keep the checksums of pages up to date.

A commit increments `handover_commits` in its transaction. When it is durable, its number is written to the
stamp.

A checkpoint holds the write lock. It computes the checksums of the pages in the write-ahead log, stores them
under a pending name, lets SQLite copy the pages, and renames the checksums. SQLite starts the log again only
with the next commit, so until then the log still has all pages that the checkpoint has changed, and they are
not compared after a crash. A checkpoint that a reader or a full disk prevents is repeated later.
"""

import atexit
import sqlite3
import threading
import time
from pathlib import Path
from typing import Final
from weakref import WeakSet
from zlib import crc32

from handover.database.sqlite_integrity.page_checksums import (
    PageChecksums,
    pages_of,
    pending_pages_of,
    read_checksums,
    write_checksums,
)
from handover.database.sqlite_integrity.reserve import (
    is_lack_of_space,
    keep_reserve,
    release_reserve,
    reserve_log,
)
from handover.database.sqlite_integrity.stamp import StampWriter
from handover.database.sqlite_integrity.wal_file import WalFile, read_wal, wal_of
from handover.telemetry import get_logger

log = get_logger(__name__)

INTERVAL_S: Final = 60.0
MIN_INTERVAL_S: Final = 1.0
MAX_LOG_BYTES: Final = 16 * 1024 * 1024
"""A longer write-ahead log is checkpointed at once."""
KEPT_LOG_BYTES: Final = 4 * 1024 * 1024
"""The length to which SQLite cuts a log that starts again."""
_RETRY_S: Final = 0.05
_PURGE_TIMEOUT_S: Final = 5.0
_PRAGMAS: Final = (
    "journal_mode=WAL",
    "synchronous=FULL",
    "foreign_keys=ON",
    "busy_timeout=5000",
    "wal_autocheckpoint=0",
    f"journal_size_limit={KEPT_LOG_BYTES}",
)
_NUMBER: Final = "SELECT number FROM handover_commits"
_COUNT: Final = "UPDATE handover_commits SET number = number + 1"


class CountedConnection(sqlite3.Connection):
    """A connection whose commits are counted once `checkpoints` is set. Use `commit`, not the statement."""

    checkpoints: "Checkpoints | None" = None

    def commit(self) -> None:
        """Commit durably, count the commit, and note its number in the stamp."""
        if self.checkpoints is None or not self.in_transaction:
            super().commit()
            return
        self.execute(_COUNT)
        ((number,),) = self.execute(_NUMBER)
        super().commit()
        self.checkpoints.note(int(number))


def make_durable(connection: sqlite3.Connection) -> None:
    """Set how a connection commits: in a write-ahead log, flushed each time, without own checkpoints."""
    for pragma in _PRAGMAS:
        connection.execute(f"PRAGMA {pragma}").close()


class Checkpoints:
    """Counts the commits of a prepared database and checkpoints it, at the start, each minute and at the end.

    Thread-safe. It keeps two connections open, so that SQLite does not checkpoint when others are closed.
    """

    def __init__(self, database: Path) -> None:
        self.database = database.absolute()
        self._stamp = StampWriter(database)
        self._writer = self._connected()
        self._copier = self._connected()
        self._turn = threading.Lock()
        self._wake = threading.Event()
        self._closing = threading.Event()
        self.is_closed = False
        self._is_postponed = False
        self._commits = 0
        self._checkpointed = -1
        self._thread = threading.Thread(target=self._run, name="checkpoints", daemon=True)
        self._thread.start()
        _open.add(self)

    def count(self, connection: CountedConnection) -> None:
        """Count the commits of a connection from now on."""
        connection.checkpoints = self

    def note(self, commits: int) -> None:
        """Note the number of a durable commit."""
        if self.is_closed:
            return
        self._stamp.note(commits)
        self._commits = max(self._commits, commits)
        try:
            is_long = wal_of(self.database).stat().st_size > MAX_LOG_BYTES
        except OSError:
            return
        if is_long:
            self._wake.set()

    def checkpoint(self) -> bool:
        """Copy the log into the database; return whether all of it was copied."""
        with self._turn:
            return self.is_closed or self._checkpoint()

    def purge(self) -> None:
        """Remove deleted data from the log too. Waits up to 5 s for readers, which may need them."""
        end_s = time.monotonic() + _PURGE_TIMEOUT_S
        while not self.checkpoint():
            if time.monotonic() > end_s:
                log.warning("deleted data are still in the log, because a reader uses it", file=self._name)
                return
            time.sleep(_RETRY_S)
        with self._turn:
            if not self.is_closed:
                self._writer.execute("PRAGMA journal_size_limit=0").close()
                self._writer.execute(_COUNT).close()  # the log starts again with this commit, and is cut

    def close(self) -> None:
        """Checkpoint and close the files; later commits are not counted."""
        with self._turn:
            if self.is_closed:
                return
            self._checkpoint()
            self.is_closed = True
        self._closing.set()
        self._wake.set()
        if self._thread is not threading.current_thread():
            self._thread.join()
        self._stamp.close()
        self._writer.close()
        self._copier.close()
        _open.discard(self)

    @property
    def _name(self) -> str:
        return self.database.name

    def _connected(self) -> CountedConnection:
        connection = sqlite3.connect(
            self.database,
            timeout=5.0,
            isolation_level=None,
            check_same_thread=False,
            factory=CountedConnection,
        )
        make_durable(connection)
        connection.execute(_NUMBER).close()  # a connection is in the log once it has read
        return connection

    def _run(self) -> None:
        while not self._closing.is_set():
            with self._turn:
                if not self.is_closed and self._commits != self._checkpointed:
                    self._checkpoint()
            self._wake.wait(INTERVAL_S)
            self._wake.clear()
            self._closing.wait(MIN_INTERVAL_S)

    def _checkpoint(self) -> bool:
        try:
            self._writer.execute("BEGIN IMMEDIATE")
            try:
                is_complete = self._copied()
            finally:
                self._writer.rollback()
            self._stamp.sync()
        except (sqlite3.Error, OSError, ValueError) as error:
            if is_lack_of_space(error):
                release_reserve(self.database)
            if not self._is_postponed:
                log.warning("checkpoint postponed", file=self._name, error=str(error))
            self._is_postponed = True
            return False
        self._is_postponed = False
        reserve_log(wal_of(self.database))
        if is_complete:
            keep_reserve(self.database)
        return is_complete

    def _copied(self) -> bool:
        """Copy the log while nobody writes; return whether that was completed."""
        ((commits,),) = self._writer.execute(_NUMBER)
        before = read_checksums(pages_of(self.database))
        wal = read_wal(self.database)
        if wal is None or before is None:
            self._checkpointed = int(commits)
            return wal is None
        pending = pending_pages_of(self.database)
        count, checksums = _changed(wal, before, int(commits), None)
        write_checksums(pending, checksums)
        try:
            ((_, frames, copied),) = self._copier.execute("PRAGMA wal_checkpoint(PASSIVE)")
        except sqlite3.Error:
            pending.unlink()
            raise
        if frames != copied or frames < 0:
            pending.unlink()
            return False
        if count != frames:  # interrupted frames of a power cut stand behind the valid ones
            write_checksums(pending, _changed(wal, before, int(commits), int(frames))[1])
        pending.replace(pages_of(self.database))
        self._checkpointed = int(commits)
        return True


_open: "WeakSet[Checkpoints]" = WeakSet()


def is_open(database: Path) -> bool:
    """Return whether this process has the database open."""
    return any(checkpoints.database == database.absolute() for checkpoints in _open)


@atexit.register
def _close_all() -> None:
    for checkpoints in list(_open):
        checkpoints.close()


def _changed(
    wal: WalFile, before: PageChecksums, commits: int, limit: int | None
) -> tuple[int, PageChecksums]:
    """Return the number of committed frames of a log, and the checksums after they are copied."""
    pages: dict[int, int] = {}
    uncommitted: dict[int, int] = {}
    size, count = len(before.values), 0
    for number, frame in enumerate(wal.frames(), start=1):
        if limit is not None and number > limit:
            break
        uncommitted[frame.page] = crc32(frame.content)
        if frame.database_pages:
            pages |= uncommitted
            uncommitted.clear()
            size, count = frame.database_pages, number
    return count, before.changed(commits, pages, size)
