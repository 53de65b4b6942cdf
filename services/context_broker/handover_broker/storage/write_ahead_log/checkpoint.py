"""Checkpoints: a commit is durable in the write-ahead log at once, and is copied to the tables later.

Many commits in one transaction cost a fraction of as many transactions. What changed often is written once,
and a notification that was delivered meanwhile is not written at all. Every read of the tables is preceded by
a checkpoint, so a reader sees everything that is committed.
"""

import math
import secrets
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, Final

from prometheus_client import Counter, Gauge

from handover.database.sqlite_files import damage
from handover.errors import UsageError
from handover.telemetry import get_logger
from handover_broker.storage import checksums
from handover_broker.storage.database import NotStored, Row, SqliteDatabase, Writer, unusable
from handover_broker.storage.entries import DocumentKind, Entries
from handover_broker.storage.write_ahead_log.frames import ID_BYTES, UnknownVersion
from handover_broker.storage.write_ahead_log.log import WriteAheadLog
from handover_broker.storage.write_ahead_log.log_file import Damaged
from handover_broker.storage.write_ahead_log.records import decode, encode

log = get_logger(__name__)

CHECKPOINT_DELAY_S: Final = 1.0
"""Delay of a checkpoint when there are few commits, so that the tables are never far behind."""
RETRY_S: Final = 1.0
MAX_SAMPLE_S: Final = 0.002
SAMPLES: Final = 16
DECAY: Final = 0.995
MAX_INLINE_BYTES: Final = 64 * 1024
"""Maximum size of a record that the event loop writes itself."""

UNCHECKPOINTED = Gauge(
    "handover_broker_write_ahead_log_commits", "Commits in the write-ahead log that are not in the tables yet"
)
CHECKPOINT_FAILURES = Counter(
    "handover_broker_checkpoint_failures_total",
    "Checkpoints that failed because the tables could not be written",
)

Write = Callable[[Writer, Entries], None]


class Checkpointer:
    """The write-ahead log, and the checkpoints that copy it to the tables.

    `write` writes entries whose notifications have numbers; `tidy` deletes what is not needed any more.
    """

    def __init__(self, database: SqliteDatabase, write: Write, tidy: Callable[[Writer], None]) -> None:
        self._database = database
        self._write = write
        self._tidy = tidy
        self._log = WriteAheadLog(database.path)
        self.recovered: list[Entries] = []
        """Commits that an earlier process has left in the log, until the first checkpoint."""
        self._log_error: str | None = None
        """Why nothing can be written: the log could not be created."""
        self._tables_error: str | None = None
        """Why the tables cannot be written."""
        self._write_error: str | None = None
        """Why the log could not be written the last time."""
        self._database_id = self._log_id = b""
        self._is_open = False
        """Whether the log of `_log_id` is valid, according to the tables."""
        self._has_begun = False
        self._waiting: list[bytes] = []
        """Encoded commits: decoded they take ten times the memory."""
        self._guard = threading.Lock()
        """Guards the log and what waits for a checkpoint."""
        self._checkpoint_lock = threading.Lock()
        """Held while the tables are written."""
        self._is_requested = threading.Event()
        self._is_stopping = threading.Event()
        self._flush_s = 0.0
        self._thread = threading.Thread(target=self._run, name="checkpoint", daemon=True)

    @property
    def path(self) -> Path:
        """Return the path of the database."""
        return self._database.path

    @property
    def flush_s(self) -> float:
        """Return the recent average time that a flush has blocked the event loop."""
        return math.inf if self._log_error is not None else self._flush_s

    def require_database(self) -> None:
        """Raise `UsageError` if there is a log without the database that it belongs to."""
        if self._log.exists() and not (self.path.exists() and self.path.stat().st_size):
            state = "is empty" if self.path.exists() else "is missing"
            logs = " and ".join(path.name for path in self._log.paths)
            raise UsageError(damage(f"{self.path} {state}, while {logs} beside it belong to it"))

    def open(self) -> None:
        """Write what an earlier process has left in the log to the tables, and start a new log.

        Raises `UsageError` for damage and for a log of another version. Without space on the disk the broker
        serves reads only until there is some.
        """
        try:
            self.recover()
        except Damaged as error:
            logs = " and ".join(path.name for path in self._log.paths)
            raise UsageError(
                f"{damage(str(error))}; if {self.path.name} itself was restored, move {logs} away"
            ) from None
        except UnknownVersion as error:
            raise UsageError(str(error)) from None
        except (NotStored, OSError) as error:
            raise unusable(self.path, error) from None
        try:
            self._begin()
        except NotStored as error:
            log.warning("no space on the disk: reads only", database=str(self.path), error=str(error))
            self._is_requested.set()
        self._database.before_reading = self.settle
        UNCHECKPOINTED.set_function(lambda: len(self._waiting))
        self._thread.start()

    def require_space(self) -> None:
        """Raise `NotStored` with the reason while the log or the tables cannot be written."""
        if (reason := self._log_error or self._write_error or self._tables_error) is not None:
            raise NotStored(reason)

    def scan_tables(self, statement: str, parameters: Sequence[Any] = ()) -> Iterator[Row]:
        """Yield the rows of a query from the tables, without the commits left in the log."""
        return self._database.scan_tables(statement, parameters)

    def last_of(self, statement: str) -> int:
        """Return the number that a query returns from the tables."""
        ((last,),) = self.scan_tables(statement)
        return int(last)

    def recover(self) -> None:
        """Read the state of the log from the tables, and the commits that are in the log only.

        Raises `Damaged` and `UnknownVersion`; nothing is written.
        """
        states = list(
            self.scan_tables("SELECT database_id, log_id, checkpointed, is_open, checksum FROM log_state")
        )
        if not states:  # a new database
            self._database_id = secrets.token_bytes(ID_BYTES)
        else:
            *state, checksum = states[0]
            if not checksums.holds(checksums.of_state, checksum, state):
                raise Damaged(f"{self.path}: the state of its log is not as it was written")
            database_id, log_id, checkpointed, is_open = state
            self._database_id, self._log_id = bytes.fromhex(database_id), bytes.fromhex(log_id)
            self._is_open = bool(is_open)
        if self._is_open:
            records = self._log.read(self._database_id, self._log_id, checkpointed)
            self.recovered = [
                self._decoded(number, record) for number, record in enumerate(records, checkpointed + 1)
            ]
        elif (foreign := self._log.describe_foreign(self._database_id, self._log_id)) is not None:
            raise Damaged(f"{foreign}: {self.path.name} is an older copy, or of another place")

    def _decoded(self, number: int, record: bytes) -> Entries:
        try:
            return decode(record)
        except UnknownVersion as error:
            raise UnknownVersion(f"{self._log.names}: change {number} has {error.what}") from None

    def _begin(self) -> None:
        """Write what is left to the tables, and start a new log. Raises `NotStored`.

        While the log files are overwritten, the tables say that no log is valid: the process may be killed at
        any time.
        """
        with self._checkpoint_lock:
            if self._has_begun:
                return
            try:
                if self.recovered or self._is_open:
                    with self._database.transaction() as writer:
                        for merged in merge_commits(self.recovered):
                            self._write(writer, merged)
                        self._write_state(writer, 0, is_open=False)
                    if self.recovered:
                        log.info(
                            "wrote commits of an earlier process to the tables", commits=len(self.recovered)
                        )
                    self.recovered, self._is_open = [], False
                log_id = secrets.token_bytes(ID_BYTES)
                self._log.begin(self._database_id, log_id)
                flush_s = self._log.measure_write_s()
                with self._database.transaction() as writer:
                    self._tidy(writer)
                    self._log_id = log_id
                    self._write_state(writer, 0, is_open=True)
                self._database.checkpoint()
            except (NotStored, OSError) as error:
                self._log_error = str(error)
                self._log.close()
                raise NotStored(str(error)) from error
            self._is_open = self._has_begun = True
            self._flush_s, self._log_error = flush_s, None

    def _write_state(self, writer: Writer, checkpointed: int, *, is_open: bool) -> None:
        """Write the state of the log to the tables: both ids and the last checkpoint."""
        row = (self._database_id.hex(), self._log_id.hex(), checkpointed, int(is_open))
        writer.run(
            "INSERT INTO log_state (name, database_id, log_id, checkpointed, is_open, checksum) "
            "VALUES ('log', ?, ?, ?, ?, ?) ON CONFLICT (name) DO UPDATE SET log_id = excluded.log_id, "
            "checkpointed = excluded.checkpointed, is_open = excluded.is_open, checksum = excluded.checksum",
            (*row, checksums.of_state(*row)),
        )

    def commit_at_once(self, entries: Entries) -> bool:
        """Do as `commit` and return true if there is space and the record is small; else do nothing."""
        if self._log_error is not None:
            return False
        record = encode(entries)
        if len(record) > MAX_INLINE_BYTES or not self._log.has_space(record):
            return False
        started_s = time.perf_counter()
        self._append(record)
        # A single slow flush must not change the average much.
        self._flush_s += (min(time.perf_counter() - started_s, MAX_SAMPLE_S) - self._flush_s) / SAMPLES
        return True

    def commit(self, entries: Entries) -> None:
        """Write entries to the log and return when they are durable; from one thread at a time. Raises
        `NotStored`."""
        if self._log_error is not None:
            self._begin()
        record = encode(entries)
        if self._log.is_too_large(record):
            self._checkpoint(entries)
            return
        if not self._log.has_space(record):
            self._checkpoint()
        self._append(record)
        # A thread also waits for the interpreter, so it cannot measure the disk. Assume that the disk becomes
        # a little quicker with each commit, until the event loop measures it again.
        self._flush_s *= DECAY

    def _append(self, record: bytes) -> None:
        needed_checkpoint = self._log.needs_checkpoint
        try:
            with self._guard:
                self._log.append(record)
                self._waiting.append(record)
        except OSError as error:
            self._write_error = str(error)
            self._is_requested.set()
            raise NotStored(f"{self._database.name}: {error}") from error
        self._write_error = None
        if len(self._waiting) == 1 or self._log.needs_checkpoint is not needed_checkpoint:
            self._is_requested.set()

    def settle(self) -> None:
        """Write all commits so far to the tables; from any thread. Raises `NotStored`."""
        if self.recovered:
            raise NotStored(f"{self._database.name}: {self._log_error}")
        if self._waiting:
            self._checkpoint()

    def close(self) -> None:
        """Write a last checkpoint, and close the log."""
        self._is_stopping.set()
        self._is_requested.set()
        if self._thread.is_alive():
            self._thread.join()
        is_complete = False
        if self._has_begun:
            try:
                self.settle()
                with self._database.transaction() as writer:
                    self._write_state(writer, 0, is_open=False)
                is_complete = True
            except NotStored as error:
                log.warning(
                    "the commits in the log are written to the tables at the next start", error=str(error)
                )
        self._log.close(is_copied=is_complete)

    def _checkpoint(self, too_large: Entries | None = None) -> None:
        """Write the waiting commits to the tables, and a commit that is too large for the log."""
        with self._checkpoint_lock:
            with self._guard:
                waiting, number = self._waiting.copy(), self._log.number
            if not waiting and too_large is None:
                return
            # Decoded one at a time: all at once would be so many objects that the garbage collector starts,
            # which stops the event loop.
            commits: Iterable[Entries] = map(decode, waiting)
            if too_large is not None:
                commits = chain(commits, (too_large,))
            merged_commits = merge_commits(commits)
            with self._database.transaction() as writer:
                for merged in merged_commits:
                    self._write(writer, merged)
                self._write_state(writer, number, is_open=True)
            with self._guard:
                del self._waiting[: len(waiting)]
                self._log.note_checkpoint(number)

    def _run(self) -> None:
        """Write checkpoints in a thread of its own, when there is enough or after a delay."""
        while not self._is_stopping.is_set():
            self._is_requested.wait()
            self._is_requested.clear()
            if not self._is_stopping.is_set() and not self._log.needs_checkpoint:
                self._is_requested.wait(CHECKPOINT_DELAY_S)
                self._is_requested.clear()
            try:
                if not self._has_begun:
                    self._begin()
                    log.info("there is space on the disk again", database=str(self.path))
                if self._write_error is not None:
                    with self._guard:
                        self._log.probe()
                    self._write_error = None
                self.settle()
                self._tables_error = None
            except Exception as error:  # noqa: BLE001 - without this thread the log would become full
                CHECKPOINT_FAILURES.inc()
                if self._log_error is None:
                    self._tables_error = str(error)
                    log.warning("checkpoint failed: the tables cannot be written", error=str(error))
                self._is_stopping.wait(RETRY_S)
                self._is_requested.set()


def merge_commits(commits: Iterable[Entries]) -> list[Entries]:
    """Merge commits, as far as their order does not matter.

    Notifications that were delivered meanwhile are left out.
    """
    merged: list[Entries] = []
    last = None
    for commit in commits:
        deletes = bool(commit.cleared) or _deletes_subscription(commit)
        if last is None or deletes:
            last = Entries()
            merged.append(last)
        last.add(commit)
        if deletes:
            last = None
    for entries in merged:
        delivered = set(entries.settled).intersection(pending.seq for pending in entries.pending)
        if delivered:
            entries.pending = [pending for pending in entries.pending if pending.seq not in delivered]
            entries.settled = [seq for seq in entries.settled if seq not in delivered]
        latest = {row[:2]: row for row in entries.history}
        entries.history = list(latest.values())
    return merged


def _deletes_subscription(entries: Entries) -> bool:
    """Return whether the commit deletes a subscription: a later one may have the same id."""
    return any(
        body is None and kind in (DocumentKind.SUBSCRIPTION, DocumentKind.SOURCE_SUBSCRIPTION)
        for (kind, _, _), body in entries.documents.items()
    )
