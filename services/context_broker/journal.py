"""The journal: what must survive, on disk. Everything else in the broker is rebuilt from it at start.

`Journal` is all that the rest of the broker knows of storage. `SqliteJournal` is the file `broker.db`: a
write-ahead log flushed at every commit, so that neither `kill -9` nor a power cut takes back what was
acknowledged. Entities are rows by their place in the order of creation; all looking up is done in memory.
"""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from handover.errors import UsageError

SCHEMA_VERSION = 1
_SCHEMA = """
CREATE TABLE entities (seq INTEGER PRIMARY KEY, body BLOB NOT NULL);
CREATE TABLE subscriptions (id TEXT PRIMARY KEY, body BLOB NOT NULL) WITHOUT ROWID;
CREATE TABLE subscription_counts (id TEXT PRIMARY KEY, body BLOB NOT NULL) WITHOUT ROWID;
CREATE TABLE contexts (url TEXT PRIMARY KEY, body BLOB NOT NULL) WITHOUT ROWID;
CREATE TABLE outbox (
    seq INTEGER PRIMARY KEY, subscription TEXT NOT NULL, entity TEXT NOT NULL, at REAL NOT NULL, body BLOB
);
CREATE INDEX outbox_by_subscription ON outbox (subscription, seq);
"""


class NotStored(Exception):
    """The disk did not take a commit (nothing of it is there), or cannot be read."""


@dataclass(frozen=True, slots=True)
class Notice:
    """A notification that is owed. Without `body` it waits for its throttling to end, to be told then."""

    seq: int
    subscription: str
    entity: str
    at: float
    body: bytes | None


@dataclass(slots=True)
class Entries:
    """What is to be written in one commit; None as a body deletes."""

    entities: dict[int, bytes | None] = field(default_factory=dict)
    subscriptions: dict[str, bytes | None] = field(default_factory=dict)
    counts: dict[str, bytes] = field(default_factory=dict)
    contexts: dict[str, bytes] = field(default_factory=dict)
    owed: list[Notice] = field(default_factory=list)
    settled: list[int] = field(default_factory=list)

    def add(self, later: "Entries") -> None:
        """Put what comes later into the same commit."""
        self.entities.update(later.entities)
        self.subscriptions.update(later.subscriptions)
        self.counts.update(later.counts)
        self.contexts.update(later.contexts)
        self.owed.extend(later.owed)
        self.settled.extend(later.settled)


class Journal(Protocol):
    """Where a broker keeps what must survive. `commit` is called from one thread, and only from there."""

    def open(self) -> None:
        """Make ready; bring older content up to date. Raises `UsageError` if that cannot be."""

    def commit(self, entries: Entries) -> None:
        """Write all of `entries` or nothing, and return when it is safe. Raises `NotStored`."""

    def close(self) -> None:
        """Let go."""

    def entities(self) -> Iterator[bytes]:
        """Yield the entities in the order of their creation."""

    def subscriptions(self) -> Iterator[tuple[bytes, bytes | None]]:
        """Yield the subscriptions, each with its counts if it has any."""

    def contexts(self) -> Iterator[tuple[str, bytes]]:
        """Yield the fetched @contexts by URL."""

    def owed(self, subscription: str, after: int, limit: int) -> list[Notice]:
        """Return the oldest notifications owed to a subscription after number `after`; from any thread.

        Raises `NotStored` when the disk cannot be read.
        """

    def last_notice(self) -> int:
        """Return the highest number that a notification owed has."""


class SqliteJournal:
    """The journal in one SQLite file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._writer: sqlite3.Connection | None = None
        self._guard: sqlite3.Connection | None = None

    def open(self) -> None:
        """Open or make the file."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._keep_others_out()
            writer = self._connected()
            self._bring_up_to_date(writer)
        except (sqlite3.Error, OSError) as error:
            raise UsageError(
                f"the broker cannot use {self.path}: {error}; "
                "give it another HANDOVER_DATA_DIR, or make room there"
            ) from None

    def commit(self, entries: Entries) -> None:
        """Write all of `entries` or nothing."""
        try:
            writer = self._connected()
            writer.execute("BEGIN IMMEDIATE")
            _write(writer, entries)
            writer.execute("COMMIT")
        except sqlite3.Error as error:
            self._start_over()
            raise NotStored(f"{self.path.name}: {error}") from error

    def close(self) -> None:
        """Close the file; what is in its log is moved into it."""
        for connection in (self._writer, self._guard):
            if connection is not None:
                connection.close()
        self._writer = self._guard = None

    def entities(self) -> Iterator[bytes]:
        """Yield the entities in the order of their creation."""
        with closing(self._reader()) as reader:
            for (body,) in reader.execute("SELECT body FROM entities ORDER BY seq"):
                yield body

    def subscriptions(self) -> Iterator[tuple[bytes, bytes | None]]:
        """Yield the subscriptions with their counts."""
        with closing(self._reader()) as reader:
            yield from reader.execute(
                "SELECT s.body, c.body FROM subscriptions s LEFT JOIN subscription_counts c USING (id) "
                "ORDER BY id"
            )

    def contexts(self) -> Iterator[tuple[str, bytes]]:
        """Yield the fetched @contexts."""
        with closing(self._reader()) as reader:
            yield from reader.execute("SELECT url, body FROM contexts")

    def owed(self, subscription: str, after: int, limit: int) -> list[Notice]:
        """Return the oldest notifications owed to a subscription."""
        try:
            with closing(self._reader()) as reader:
                rows = reader.execute(
                    "SELECT seq, subscription, entity, at, body FROM outbox "
                    "WHERE subscription = ? AND seq > ? ORDER BY seq LIMIT ?",
                    (subscription, after, limit),
                )
                return [Notice(*row) for row in rows]
        except sqlite3.Error as error:
            raise NotStored(f"{self.path.name} cannot be read: {error}") from error

    def last_notice(self) -> int:
        """Return the highest number in the outbox."""
        with closing(self._reader()) as reader:
            (last,) = reader.execute("SELECT coalesce(max(seq), 0) FROM outbox").fetchone()
            return int(last)

    def _keep_others_out(self) -> None:
        """Hold a lock for as long as the process lives: two brokers on one file would undo each other."""
        guard = sqlite3.connect(
            self.path.with_suffix(".lock"), isolation_level=None, check_same_thread=False, timeout=0
        )
        try:
            guard.execute("BEGIN EXCLUSIVE")
        except sqlite3.OperationalError:
            guard.close()
            raise UsageError(
                f"another broker is at work on {self.path}; "
                "stop it, or give this one another HANDOVER_DATA_DIR"
            ) from None
        self._guard = guard

    def _connected(self) -> sqlite3.Connection:
        if self._writer is None:
            writer = sqlite3.connect(self.path, isolation_level=None, check_same_thread=False, timeout=5)
            # FULL flushes the log at every commit: that is what makes an acknowledgement true.
            for pragma in ("journal_mode=WAL", "synchronous=FULL", "wal_autocheckpoint=4000"):
                writer.execute(f"PRAGMA {pragma}")
            self._writer = writer
        return self._writer

    def _reader(self) -> sqlite3.Connection:
        return sqlite3.connect(self.path, isolation_level=None, timeout=5)

    def _bring_up_to_date(self, writer: sqlite3.Connection) -> None:
        (version,) = writer.execute("PRAGMA user_version").fetchone()
        if version > SCHEMA_VERSION:
            raise UsageError(f"{self.path} was written by a newer version of Handover; use that version")
        if version == 0:
            writer.executescript(f"BEGIN; {_SCHEMA} PRAGMA user_version = {SCHEMA_VERSION}; COMMIT;")
        # A change that was on its way while a subscription was deleted may have left something owed to it.
        writer.execute("DELETE FROM outbox WHERE subscription NOT IN (SELECT id FROM subscriptions)")

    def _start_over(self) -> None:
        """Leave a connection on which something failed; the next commit makes a new one."""
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.close()


def _write(writer: sqlite3.Connection, entries: Entries) -> None:
    gone = [(seq,) for seq, body in entries.entities.items() if body is None]
    kept = [(seq, body) for seq, body in entries.entities.items() if body is not None]
    if kept:
        writer.executemany("INSERT OR REPLACE INTO entities VALUES (?, ?)", kept)
    if gone:
        writer.executemany("DELETE FROM entities WHERE seq = ?", gone)
    if entries.owed:
        writer.executemany(
            "INSERT INTO outbox VALUES (?, ?, ?, ?, ?)",
            [(one.seq, one.subscription, one.entity, one.at, one.body) for one in entries.owed],
        )
    if entries.settled:
        writer.executemany("DELETE FROM outbox WHERE seq = ?", [(seq,) for seq in entries.settled])
    for subscription, body in entries.subscriptions.items():
        if body is None:
            for table, column in (
                ("subscriptions", "id"),
                ("subscription_counts", "id"),
                ("outbox", "subscription"),
            ):
                writer.execute(f"DELETE FROM {table} WHERE {column} = ?", (subscription,))  # noqa: S608 - names are ours
        else:
            writer.execute("INSERT OR REPLACE INTO subscriptions VALUES (?, ?)", (subscription, body))
    if entries.counts:
        writer.executemany(
            "INSERT OR REPLACE INTO subscription_counts SELECT ?1, ?2 "
            "WHERE EXISTS (SELECT 1 FROM subscriptions WHERE id = ?1)",
            entries.counts.items(),
        )
    if entries.contexts:
        writer.executemany("INSERT OR REPLACE INTO contexts VALUES (?, ?)", entries.contexts.items())
