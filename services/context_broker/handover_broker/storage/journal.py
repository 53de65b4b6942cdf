"""The journal: everything durable. The rest of the broker is rebuilt from it at the start.

Entities are rows by sequence number; subscriptions, registrations, @contexts and the like are documents by
kind; pending notifications are the outbox. Queries use memory only. History has a row for each change of an
entity, and a row for each entity that is history only.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

from handover.database.sqlite_files import damage
from handover.errors import UsageError
from handover.telemetry import get_logger
from handover_broker.storage import checksums
from handover_broker.storage.checksums import require_row
from handover_broker.storage.database import Database, NotStored, Row, SqliteDatabase, Writer
from handover_broker.storage.entries import OVERHEAD_BYTES, DocumentKind, Entries, PendingNotification
from handover_broker.storage.history_archive import Archive, write_archive
from handover_broker.storage.write_ahead_log.checkpoint import Checkpointer

__all__ = ["Journal", "NotStored"]

log = get_logger(__name__)

SCHEMA_VERSION: Final = 1
"""Versions are counted from the first release on."""
SCRIPT: Final = """
    CREATE TABLE entities (
        seq INTEGER PRIMARY KEY, tenant TEXT NOT NULL, body {bytes} NOT NULL, checksum INTEGER NOT NULL
    );
    CREATE TABLE documents (
        kind TEXT NOT NULL, tenant TEXT NOT NULL, id TEXT NOT NULL, body {bytes} NOT NULL,
        checksum INTEGER NOT NULL, PRIMARY KEY (kind, tenant, id)
    ) {keyed};
    CREATE TABLE outbox (
        seq INTEGER PRIMARY KEY, tenant TEXT NOT NULL, subscription TEXT NOT NULL, entity TEXT NOT NULL,
        at {number} NOT NULL, body {bytes}, headers {bytes}, checksum INTEGER NOT NULL
    );
    CREATE INDEX outbox_by_subscription ON outbox (tenant, subscription, seq);
    CREATE TABLE history (
        entity BIGINT NOT NULL, seq BIGINT NOT NULL, observed_from {number}, observed_to {number},
        rewritten INTEGER NOT NULL, body {bytes} NOT NULL, checksum INTEGER NOT NULL,
        PRIMARY KEY (entity, seq)
    );
    CREATE TABLE temporal_only_entities (
        seq BIGINT PRIMARY KEY, tenant TEXT NOT NULL, id TEXT NOT NULL, body {bytes} NOT NULL,
        checksum INTEGER NOT NULL
    );
    CREATE INDEX temporal_only_by_id ON temporal_only_entities (tenant, id);
    CREATE TABLE log_state (
        name TEXT PRIMARY KEY, database_id TEXT NOT NULL, log_id TEXT NOT NULL, checkpointed BIGINT NOT NULL,
        is_open INTEGER NOT NULL, checksum INTEGER NOT NULL
    );
    CREATE TABLE totals (name TEXT PRIMARY KEY, number BIGINT NOT NULL, checksum BIGINT NOT NULL);
    INSERT INTO totals VALUES ('entities', 0, 0);
    INSERT INTO totals VALUES ('documents', 0, 0);
"""
"""`totals` has the number of rows of a table and the sum of their checksums, so that a missing or an old row
is detected. Only SQLite has them, where one process writes."""

_NOTICE: Final = "seq, tenant, subscription, entity, at, body, headers, checksum"
_ORPHANS: Final = """
    NOT EXISTS (SELECT 1 FROM documents s WHERE s.kind IN ({kinds}) AND s.tenant = {table}.tenant
    AND s.id = {table}.{key})
"""
_SUBSCRIPTION_KINDS: Final = f"'{DocumentKind.SUBSCRIPTION}', '{DocumentKind.SOURCE_SUBSCRIPTION}'"


class Journal:
    """Durable storage in a database. One thread commits at a time."""

    def __init__(self, database: Database) -> None:
        self.name = database.name
        self.archive = Archive(database)
        self._database = database
        self._checkpointer = (
            Checkpointer(database, _checkpoint, lambda writer: _tidy(writer, _checkpoint))
            if isinstance(database, SqliteDatabase)
            else None
        )
        self._last_notice = 0
        self.is_closed = False

    def open(self) -> None:
        """Open the database. Raises `UsageError` if that is impossible or the content is damaged.

        Without space on the disk it is opened for reading; commits are refused until there is space.
        """
        if self._checkpointer is not None:
            self._checkpointer.require_database()
        self._database.open(SCHEMA_VERSION, SCRIPT)
        if self._checkpointer is not None:
            self._checkpointer.open()
            last = self._checkpointer.last_of("SELECT coalesce(max(seq), 0) FROM outbox")
            self._last_notice = max(
                last,
                *(notice.seq for entries in self._checkpointer.recovered for notice in entries.pending),
                0,
            )

    def try_lock(self) -> bool:
        """Become the broker that writes the database, if there is no other. Raises `NotStored`."""
        return self._begin_if(self._database.try_lock())

    def wait_for_lock(self) -> bool:
        """Wait until this is the broker that writes the database; `close` ends the wait with False."""
        return self._begin_if(self._database.wait_for_lock())

    def _begin_if(self, is_locked: bool) -> bool:
        if is_locked and self._checkpointer is None:
            with self._database.transaction() as writer:
                _tidy(writer, _write_tables)
            self._last_notice = self._database.read("SELECT coalesce(max(seq), 0) FROM outbox")[0][0]
        return is_locked

    def check_connection(self) -> None:
        """Note in `unreachable` and `lost` whether the database can be written. Takes seconds at most."""
        self._database.check_connection()

    @property
    def unreachable(self) -> str | None:
        """Return why the database could not be reached the last time."""
        return self._database.unreachable

    @property
    def lost(self) -> str | None:
        """Return why this broker has to load the database again: another one has written it."""
        return self._database.lost

    def require_space(self) -> None:
        """Raise `NotStored` with the reason while the disk refuses commits."""
        if self._checkpointer is not None:
            self._checkpointer.require_space()

    def commit(self, entries: Entries) -> None:
        """Write all of `entries` or nothing, and return when they are durable. Raises `NotStored`."""
        _number(entries, self._last_notice)
        if self._checkpointer is not None:
            self._checkpointer.commit(entries)
        else:
            try:
                self._write(entries)
            except NotStored as error:  # the connection may have ended while it was idle
                log.warning("a commit is tried once more", error=str(error))
                self._write(entries)
        self._last_notice += len(entries.pending)

    def _write(self, entries: Entries) -> None:
        with self._database.transaction() as writer:
            _write_tables(writer, entries)

    @property
    def flush_s(self) -> float:
        """Return the recent average time of a flush."""
        return math.inf if self._checkpointer is None else self._checkpointer.flush_s

    def commit_at_once(self, entries: Entries) -> bool:
        """Do as `commit` and return true if only a flush has to be waited for; else do nothing.

        From any thread, while no other one commits.
        """
        if self._checkpointer is None:
            return False
        _number(entries, self._last_notice)
        done = self._checkpointer.commit_at_once(entries)
        if done:
            self._last_notice += len(entries.pending)
        return done

    def settle(self) -> None:
        """Write everything committed so far to the tables. Raises `NotStored`."""
        if self._checkpointer is not None:
            self._checkpointer.settle()

    @property
    def is_on_disk(self) -> bool:
        """Return whether the database is a file of this machine."""
        return self._checkpointer is not None

    def close(self) -> None:
        """Close the database; from any thread. Doing it twice is harmless."""
        if self.is_closed:
            return
        self.is_closed = True
        self.archive.close()
        if self._checkpointer is not None:
            self._checkpointer.close()
        self._database.close()

    def entities(self) -> Iterator[tuple[str, bytes]]:
        """Yield the entities with their tenants, in the order of their creation.

        Raises `UsageError` for a damaged or missing one.
        """
        recovered = self._recovered()
        number = total = 0
        for seq, tenant, body, checksum in self._scan(
            "SELECT seq, tenant, body, checksum FROM entities ORDER BY seq"
        ):
            require_row(checksums.of_entity, checksum, (seq, tenant, body), self._damaged)
            number, total = number + 1, total + checksum
            row = recovered.entities.pop(seq, None)
            if row is None:
                yield tenant, body
            elif row.body is not None:
                yield row.tenant, row.body
        self._require_total("entities", number, total)
        for _, row in sorted(recovered.entities.items()):
            if row.body is not None:
                yield row.tenant, row.body

    def documents(self, kind: DocumentKind) -> Iterator[tuple[str, str, bytes]]:
        """Yield tenant, id and body of all documents of a kind. Raises `UsageError` for a damaged one."""
        recovered = {key[1:]: body for key, body in self._recovered().documents.items() if key[0] is kind}
        for tenant, name, body, checksum in self._scan(
            "SELECT tenant, id, body, checksum FROM documents WHERE kind = ? ORDER BY tenant, id",
            (kind.value,),
        ):
            require_row(checksums.of_document, checksum, (kind.value, tenant, name, body), self._damaged)
            recovered_body = recovered.pop((tenant, name), body)
            if recovered_body is not None:
                yield tenant, name, recovered_body
        for (tenant, name), changed in sorted(recovered.items()):
            if changed is not None:
                yield tenant, name, changed

    def _recovered(self) -> Entries:
        """Return what was in the log at the start and cannot be written to the tables for lack of space."""
        merged = Entries()
        for commit in () if self._checkpointer is None else self._checkpointer.recovered:
            merged.add(commit)
        return merged

    def _scan(self, statement: str, parameters: Sequence[Any] = ()) -> Iterator[Row]:
        """Yield rows of the tables, after a checkpoint if one is possible."""
        if self._checkpointer is not None and self._checkpointer.recovered:
            return self._checkpointer.scan_tables(statement, parameters)
        return self._database.scan(statement, parameters)

    def _damaged(self, row: Sequence[Any]) -> UsageError:
        where = self._database.path if isinstance(self._database, SqliteDatabase) else self.name
        what = "an entity" if len(row) == 3 else f"the {row[0]} {row[2]}"
        return UsageError(damage(f"{where}: {what} is not as it was written"))

    def _require_total(self, table: str, number: int, total: int) -> None:
        if self._checkpointer is None:
            return
        ((wanted, checksum),) = self._scan("SELECT number, checksum FROM totals WHERE name = ?", (table,))
        if (number, total) != (wanted, checksum):
            fault = f"the table {table} has {number} rows, and not the {wanted} that were written"
            raise UsageError(damage(f"{self._checkpointer.path}: {fault}"))

    def pending(self, tenant: str, subscription: str, after: int, limit: int) -> list[PendingNotification]:
        """Return the oldest pending notifications of a subscription after number `after`; from any thread.

        Raises `NotStored` when the disk cannot be read.
        """
        rows = self._database.read(
            f"SELECT {_NOTICE} FROM outbox "  # noqa: S608 - ours
            "WHERE tenant = ? AND subscription = ? AND seq > ? ORDER BY seq LIMIT ?",
            (tenant, subscription, after, limit),
        )
        for *row, checksum in rows:
            require_row(checksums.of_notice, checksum, row, self._damaged_notice)
        return [
            PendingNotification(tenant, subscription, entity, at, body, seq, headers)
            for seq, _, _, entity, at, body, headers, _ in rows
        ]

    def _damaged_notice(self, row: Sequence[Any]) -> NotStored:
        return NotStored(damage(f"{self.name}: notification {row[0]} is not as it was written"))

    def pending_sizes(self, tenant: str, subscription: str, after: int, limit: int) -> list[tuple[int, int]]:
        """Return number and bytes of the oldest pending notifications after number `after`, as `pending`."""
        rows = self._database.read(
            "SELECT seq, coalesce(length(body), 0) FROM outbox "
            "WHERE tenant = ? AND subscription = ? AND seq > ? ORDER BY seq LIMIT ?",
            (tenant, subscription, after, limit),
        )
        return [(seq, size + OVERHEAD_BYTES) for seq, size in rows]

    def pending_total(self, tenant: str, subscription: str) -> tuple[int, int]:
        """Return how many notifications of a subscription are pending, and their bytes, as `pending`."""
        ((many, size),) = self._database.read(
            "SELECT count(*), coalesce(sum(length(body)), 0) FROM outbox "
            "WHERE tenant = ? AND subscription = ?",
            (tenant, subscription),
        )
        return many, int(size) + many * OVERHEAD_BYTES

    def pending_subscriptions(self, tenant: str) -> set[str]:
        """Return the subscriptions of a tenant with pending notifications, as `pending`."""
        rows = self._scan("SELECT DISTINCT subscription FROM outbox WHERE tenant = ?", (tenant,))
        recovered = {notice.subscription for notice in self._recovered().pending if notice.tenant == tenant}
        return recovered | {subscription for (subscription,) in rows}

    def last_sequence(self) -> int:
        """Return the highest sequence number."""
        ((last,),) = self._scan("SELECT coalesce(max(seq), 0) FROM entities")
        ((gone,),) = self._scan("SELECT coalesce(max(seq), 0) FROM temporal_only_entities")
        recovered = self._recovered()
        return max(int(last), int(gone), *recovered.entities, *recovered.temporal_only)


def _number(entries: Entries, last_notice: int) -> None:
    """Assign numbers of the outbox to the pending notifications."""
    for number, pending in enumerate(entries.pending, last_notice + 1):
        pending.seq = number


def _write_tables(writer: Writer, entries: Entries) -> None:
    _write_entities(writer, entries)
    _write_documents(writer, entries)
    _write_outbox(writer, entries)
    write_archive(writer, entries.history, entries.cleared, entries.temporal_only)


def _checkpoint(writer: Writer, entries: Entries) -> None:
    """Write tables of SQLite, and update their totals."""
    seqs = list(entries.entities)
    keys = [(kind.value, tenant, name) for kind, tenant, name in entries.documents]
    before = [
        _total(writer, "entities", "seq", seqs),
        _total(writer, "documents", "kind, tenant, id", keys),
    ]
    _write_tables(writer, entries)
    after = [_total(writer, "entities", "seq", seqs), _total(writer, "documents", "kind, tenant, id", keys)]
    for table, (number, total), (was, was_total) in zip(
        ("entities", "documents"), after, before, strict=True
    ):
        if (number, total) != (was, was_total):
            writer.run(
                "UPDATE totals SET number = number + ?, checksum = checksum + ? WHERE name = ?",
                (number - was, total - was_total, table),
            )


def _total(writer: Writer, table: str, key: str, keys: Sequence[Any]) -> tuple[int, int]:
    """Return the number of some rows, and the sum of their checksums."""
    number = total = 0
    for start in range(0, len(keys), _AT_ONCE):
        some = keys[start : start + _AT_ONCE]
        is_wide = isinstance(some[0], tuple)
        statement = total_of(table, key, len(some))
        ((count, sums),) = writer.run(statement, [part for row in some for part in row] if is_wide else some)
        number, total = number + count, total + sums
    return number, total


def total_of(table: str, key: str, count: int) -> str:
    """Return the query for the total of so many rows, each found by its key.

    `WHERE (a, b) IN (VALUES …)` would read the whole table if the key has more than one column.
    """
    width = key.count(",") + 1
    row = f"({', '.join('?' * width)})"
    wanted = ", ".join(f"wanted.column{number}" for number in range(1, width + 1))
    return (
        f"SELECT count(*), coalesce(sum(checksum), 0) FROM (VALUES {', '.join([row] * count)}) AS wanted "  # noqa: S608 - ours
        f"CROSS JOIN {table} ON ({key}) = ({wanted})"
    )


_AT_ONCE: Final = 256


def _tidy(writer: Writer, write: Callable[[Writer, Entries], None]) -> None:
    """Delete notifications of deleted subscriptions, which a concurrent change may have left."""
    kinds = _SUBSCRIPTION_KINDS
    orphans = _ORPHANS.format(kinds=kinds, table="outbox", key="subscription")
    writer.run(f"DELETE FROM outbox WHERE {orphans}")  # noqa: S608 - ours
    orphans = _ORPHANS.format(kinds=kinds, table="documents", key="id")
    counts = writer.run(
        f"SELECT tenant, id FROM documents WHERE kind = '{DocumentKind.COUNTS}' AND {orphans}"  # noqa: S608 - ours
    )
    if counts:
        write(
            writer, Entries(documents={(DocumentKind.COUNTS, tenant, name): None for tenant, name in counts})
        )


def _write_entities(writer: Writer, entries: Entries) -> None:
    gone = [(seq,) for seq, row in entries.entities.items() if row.body is None]
    written = [
        (seq, row.tenant, row.body, checksums.of_entity(seq, row.tenant, row.body))
        for seq, row in entries.entities.items()
        if row.body is not None
    ]
    if written:
        writer.run_many(
            "INSERT INTO entities (seq, tenant, body, checksum) VALUES (?, ?, ?, ?) "
            "ON CONFLICT (seq) DO UPDATE SET body = excluded.body, checksum = excluded.checksum",
            written,
        )
    if gone:
        writer.run_many("DELETE FROM entities WHERE seq = ?", gone)


def _write_documents(writer: Writer, entries: Entries) -> None:
    gone = [(kind.value, *of) for (kind, *of), body in entries.documents.items() if body is None]
    written = [
        (kind.value, tenant, name, body, checksums.of_document(kind.value, tenant, name, body))
        for (kind, tenant, name), body in entries.documents.items()
        if body is not None
    ]
    if written:
        writer.run_many(
            "INSERT INTO documents (kind, tenant, id, body, checksum) VALUES (?, ?, ?, ?, ?) "
            "ON CONFLICT (kind, tenant, id) DO UPDATE SET body = excluded.body, checksum = excluded.checksum",
            written,
        )
    if gone:
        writer.run_many("DELETE FROM documents WHERE kind = ? AND tenant = ? AND id = ?", gone)
    for kind, tenant, name in gone:
        if kind in (DocumentKind.SUBSCRIPTION, DocumentKind.SOURCE_SUBSCRIPTION):
            writer.run("DELETE FROM outbox WHERE tenant = ? AND subscription = ?", (tenant, name))


def _write_outbox(writer: Writer, entries: Entries) -> None:
    if entries.pending:
        rows = [
            (
                notice.seq,
                notice.tenant,
                notice.subscription,
                notice.entity,
                notice.at,
                notice.body,
                notice.headers,
            )
            for notice in entries.pending
        ]
        writer.run_many(
            "INSERT INTO outbox (seq, tenant, subscription, entity, at, body, headers, checksum) "
            "VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            [(*row, checksums.of_notice(*row)) for row in rows],
        )
    if entries.settled:
        writer.run_many("DELETE FROM outbox WHERE seq = ?", [(seq,) for seq in entries.settled])
