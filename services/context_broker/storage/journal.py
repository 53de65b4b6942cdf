"""The journal: what must survive, on disk. Everything else in the broker is rebuilt from it at start.

Entities are rows by their place in the order of creation; subscriptions, registrations, @contexts and the
like are documents by kind; what subscribers are owed is the outbox. All looking up is done in memory. What
has been is the history: a row for each change of an entity, and a row for each entity that has departed.
"""

import math
from collections.abc import Iterator
from contextlib import AbstractContextManager
from typing import Final

from services.context_broker.storage.database import Database, NotStored, SqliteDatabase, Writer
from services.context_broker.storage.entries import OVERHEAD_BYTES, Entries, Kind, Notice
from services.context_broker.storage.filing import Filing
from services.context_broker.temporal.archive import Archive, write_archive

__all__ = ["Journal", "NotStored"]

_MIGRATIONS: Final = (
    """
    CREATE TABLE entities (seq INTEGER PRIMARY KEY, body {bytes} NOT NULL);
    CREATE TABLE subscriptions (id TEXT PRIMARY KEY, body {bytes} NOT NULL);
    CREATE TABLE subscription_counts (id TEXT PRIMARY KEY, body {bytes} NOT NULL);
    CREATE TABLE contexts (url TEXT PRIMARY KEY, body {bytes} NOT NULL);
    CREATE TABLE outbox (
        seq INTEGER PRIMARY KEY, subscription TEXT NOT NULL, entity TEXT NOT NULL, at {number} NOT NULL,
        body {bytes}
    );
    CREATE INDEX outbox_by_subscription ON outbox (subscription, seq);
    """,
    """
    ALTER TABLE entities ADD COLUMN tenant TEXT NOT NULL DEFAULT '';
    ALTER TABLE outbox ADD COLUMN tenant TEXT NOT NULL DEFAULT '';
    ALTER TABLE outbox ADD COLUMN headers {bytes};
    DROP INDEX outbox_by_subscription;
    CREATE INDEX outbox_by_subscription ON outbox (tenant, subscription, seq);
    CREATE TABLE documents (
        kind TEXT NOT NULL, tenant TEXT NOT NULL, id TEXT NOT NULL, body {bytes} NOT NULL,
        PRIMARY KEY (kind, tenant, id)
    );
    INSERT INTO documents SELECT 'subscription', '', id, body FROM subscriptions;
    INSERT INTO documents SELECT 'counts', '', id, body FROM subscription_counts;
    INSERT INTO documents SELECT 'context', '', url, body FROM contexts;
    DROP TABLE subscriptions;
    DROP TABLE subscription_counts;
    DROP TABLE contexts;
    CREATE TABLE history (
        entity BIGINT NOT NULL, seq BIGINT NOT NULL, observed_from {number}, observed_to {number},
        rewritten INTEGER NOT NULL, body {bytes} NOT NULL, PRIMARY KEY (entity, seq)
    );
    CREATE TABLE departed (
        place BIGINT PRIMARY KEY, tenant TEXT NOT NULL, id TEXT NOT NULL, body {bytes} NOT NULL
    );
    CREATE INDEX departed_by_id ON departed (tenant, id);
    """,
    """
    CREATE TABLE log_state (opening TEXT NOT NULL, filed BIGINT NOT NULL);
    INSERT INTO log_state VALUES ('', 0);
    """,
)
SCHEMA_VERSION: Final = len(_MIGRATIONS)

_SUBSCRIPTION_KINDS: Final = f"'{Kind.SUBSCRIPTION}', '{Kind.SOURCE_SUBSCRIPTION}'"


class Journal:
    """Keeps what must survive in a database. One thread commits at a time."""

    def __init__(self, database: Database) -> None:
        self.name = database.name
        self.archive = Archive(database)
        self._database = database
        self._filing = Filing(database, _write_tables) if isinstance(database, SqliteDatabase) else None
        self._last_notice = 0

    def open(self) -> None:
        """Make ready; bring older content up to date. Raises `UsageError` if that cannot be."""
        self._database.open(SCHEMA_VERSION, _MIGRATIONS)
        if self._filing is not None:
            self._filing.open()
        ((self._last_notice,),) = self._database.read("SELECT coalesce(max(seq), 0) FROM outbox")
        with self._database.transaction() as writer:
            # A change on its way while its subscription was deleted may have left something owed to it.
            for orphaned in ("outbox WHERE", f"documents WHERE kind = '{Kind.COUNTS}' AND"):
                key = "subscription" if orphaned.startswith("outbox") else "id"
                table = orphaned.partition(" ")[0]
                writer.run(
                    f"DELETE FROM {orphaned} NOT EXISTS (SELECT 1 FROM documents s "  # noqa: S608 - ours
                    f"WHERE s.kind IN ({_SUBSCRIPTION_KINDS}) AND s.tenant = {table}.tenant "
                    f"AND s.id = {table}.{key})"
                )

    def commit(self, entries: Entries) -> None:
        """Write all of `entries` or nothing, and return when it is safe. Raises `NotStored`."""
        if self._filing is None:
            with self._database.transaction() as writer:
                self.write(writer, entries, self._last_notice)
        else:
            _number(entries, self._last_notice)
            self._filing.commit(entries)
        self._last_notice += len(entries.owed)

    @property
    def flush_s(self) -> float:
        """Return how long a commit has waited for the disk of late."""
        return math.inf if self._filing is None else self._filing.flush_s

    def commit_at_once(self, entries: Entries) -> bool:
        """Do as `commit` and return true if nothing but a flush is to be waited for; else do nothing.

        From any thread, while no other commits.
        """
        if self._filing is None:
            return False
        _number(entries, self._last_notice)
        done = self._filing.commit_at_once(entries)
        if done:
            self._last_notice += len(entries.owed)
        return done

    def settle(self) -> None:
        """Return when the tables hold everything committed so far. Raises `NotStored`."""
        if self._filing is not None:
            self._filing.settle()

    def transaction(self) -> AbstractContextManager[Writer]:
        """Begin a transaction, as a commit is one. Raises `NotStored`."""
        return self._database.transaction()

    @staticmethod
    def write(writer: Writer, entries: Entries, last_notice: int) -> None:
        """Write all of `entries`; what is owed is numbered from `last_notice` on."""
        _number(entries, last_notice)
        _write_tables(writer, entries)

    def close(self) -> None:
        """Let go."""
        self.archive.close()
        if self._filing is not None:
            self._filing.close()
        self._database.close()

    def entities(self) -> Iterator[tuple[str, bytes]]:
        """Yield the entities, each with its tenant, in the order of their creation."""
        yield from self._database.scan("SELECT tenant, body FROM entities ORDER BY seq")

    def documents(self, kind: Kind) -> Iterator[tuple[str, str, bytes]]:
        """Yield tenant, id and body of all documents of a kind."""
        yield from self._database.scan(
            "SELECT tenant, id, body FROM documents WHERE kind = ? ORDER BY tenant, id", (kind.value,)
        )

    def owed(self, tenant: str, subscription: str, after: int, limit: int) -> list[Notice]:
        """Return the oldest notifications owed to a subscription after number `after`; from any thread.

        Raises `NotStored` when the disk cannot be read.
        """
        rows = self._database.read(
            "SELECT tenant, subscription, entity, at, body, seq, headers FROM outbox "
            "WHERE tenant = ? AND subscription = ? AND seq > ? ORDER BY seq LIMIT ?",
            (tenant, subscription, after, limit),
        )
        return [Notice(*row) for row in rows]

    def owed_sizes(self, tenant: str, subscription: str, after: int, limit: int) -> list[tuple[int, int]]:
        """Return number and bytes of the oldest notifications owed after number `after`, as `owed`."""
        rows = self._database.read(
            "SELECT seq, coalesce(length(body), 0) FROM outbox "
            "WHERE tenant = ? AND subscription = ? AND seq > ? ORDER BY seq LIMIT ?",
            (tenant, subscription, after, limit),
        )
        return [(seq, size + OVERHEAD_BYTES) for seq, size in rows]

    def owed_in_all(self, tenant: str, subscription: str) -> tuple[int, int]:
        """Return how many notifications are owed to a subscription, and their bytes, as `owed`."""
        ((many, size),) = self._database.read(
            "SELECT count(*), coalesce(sum(length(body)), 0) FROM outbox "
            "WHERE tenant = ? AND subscription = ?",
            (tenant, subscription),
        )
        return many, int(size) + many * OVERHEAD_BYTES

    def owed_to(self, tenant: str) -> set[str]:
        """Return the subscriptions of a tenant to which anything is owed, as `owed`."""
        rows = self._database.read("SELECT DISTINCT subscription FROM outbox WHERE tenant = ?", (tenant,))
        return {subscription for (subscription,) in rows}

    def last_place(self) -> int:
        """Return the highest place in the order of creation."""
        ((last,),) = self._database.read("SELECT coalesce(max(seq), 0) FROM entities")
        ((gone,),) = self._database.read("SELECT coalesce(max(place), 0) FROM departed")
        return max(int(last), int(gone))


def _number(entries: Entries, last_notice: int) -> None:
    """Give what is owed its places in the outbox."""
    for number, one in enumerate(entries.owed, last_notice + 1):
        one.seq = number


def _write_tables(writer: Writer, entries: Entries) -> None:
    _write_entities(writer, entries)
    _write_documents(writer, entries)
    _write_outbox(writer, entries)
    write_archive(writer, entries.history, entries.cleared, entries.departed)


def _write_entities(writer: Writer, entries: Entries) -> None:
    gone = [(seq,) for seq, row in entries.entities.items() if row.body is None]
    kept = [(seq, row.tenant, row.body) for seq, row in entries.entities.items() if row.body is not None]
    if kept:
        writer.run_many(
            "INSERT INTO entities (seq, tenant, body) VALUES (?, ?, ?) "
            "ON CONFLICT (seq) DO UPDATE SET body = excluded.body",
            kept,
        )
    if gone:
        writer.run_many("DELETE FROM entities WHERE seq = ?", gone)


def _write_documents(writer: Writer, entries: Entries) -> None:
    gone = [(kind.value, *of) for (kind, *of), body in entries.documents.items() if body is None]
    kept = [(kind.value, *of, body) for (kind, *of), body in entries.documents.items() if body is not None]
    if kept:
        writer.run_many(
            "INSERT INTO documents (kind, tenant, id, body) VALUES (?, ?, ?, ?) "
            "ON CONFLICT (kind, tenant, id) DO UPDATE SET body = excluded.body",
            kept,
        )
    if gone:
        writer.run_many("DELETE FROM documents WHERE kind = ? AND tenant = ? AND id = ?", gone)
    for kind, tenant, name in gone:
        if kind in (Kind.SUBSCRIPTION, Kind.SOURCE_SUBSCRIPTION):
            writer.run("DELETE FROM outbox WHERE tenant = ? AND subscription = ?", (tenant, name))


def _write_outbox(writer: Writer, entries: Entries) -> None:
    if entries.owed:
        writer.run_many(
            "INSERT INTO outbox (seq, tenant, subscription, entity, at, body, headers) "
            "VALUES (?, ?, ?, ?, ?, ?, ?)",
            [
                (one.seq, one.tenant, one.subscription, one.entity, one.at, one.body, one.headers)
                for one in entries.owed
            ],
        )
    if entries.settled:
        writer.run_many("DELETE FROM outbox WHERE seq = ?", [(seq,) for seq in entries.settled])
