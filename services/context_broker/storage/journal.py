"""The journal: what must survive, on disk. Everything else in the broker is rebuilt from it at start.

Entities are rows by their place in the order of creation; subscriptions, registrations, @contexts and the
like are documents by kind; what subscribers are owed is the outbox. All looking up is done in memory. What
has been is the history: a row for each change of an entity, and a row for each entity that has departed.
"""

from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final, NamedTuple

from services.context_broker.storage.database import Database, NotStored, Writer
from services.context_broker.temporal.archive import Archive, DepartedRow, HistoryRow, write_archive

__all__ = ["Entries", "Journal", "Kind", "NotStored", "Notice"]

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
)
SCHEMA_VERSION: Final = len(_MIGRATIONS)

OVERHEAD_BYTES: Final = 200
"""What a notice takes besides its body."""


class Kind(StrEnum):
    """What a document is. Documents of a tenant go with it; those of no tenant have the tenant ""."""

    TENANT = "tenant"
    CONTEXT = "context"
    """An @context: by its URL if it was fetched, else by its local identifier, of the tenant that gave it."""
    CONTEXT_USAGE = "contextUsage"
    """How the @context of the same id was used."""
    SUBSCRIPTION = "subscription"
    RELAY = "relay"
    """A subscription that was passed on to a context source."""
    COUNTS = "counts"
    """What became of the notifications of the subscription of the same id."""
    ENTITY_MAP = "entity map"
    IDENTITY = "identity"
    """What tells this broker from all others, made at its first start."""
    SOURCE_SUBSCRIPTION = "source subscription"
    """To registrations of context sources; its counts are kept as those of other subscriptions."""
    SNAPSHOT = "snapshot"
    SNAPSHOT_TELLING = "snapshot telling"
    """A notification of how a snapshot is that is owed to somebody."""
    REGISTRATION = "registration"
    ATTEMPTS = "attempts"
    """What became of the operations passed on to the source of the registration of the same id."""


_SUBSCRIPTION_KINDS: Final = f"'{Kind.SUBSCRIPTION}', '{Kind.SOURCE_SUBSCRIPTION}'"

DocumentKey = tuple[Kind, str, str]
"""Kind, tenant and id."""


class EntityRow(NamedTuple):
    """An entity as it is kept; without `body` it is gone."""

    tenant: str
    id: str
    body: bytes | None


@dataclass(slots=True, eq=False)
class Notice:
    """A notification that is owed.

    Without `body`, or with one that is a list of entities instead of a notification, it waits for its
    throttling to end, to be told then: how the entity is by then, or that list. `headers` (JSON) are those of
    the request that the subscriber wants passed on. `seq` is its place in the outbox, which the journal gives
    it in the commit.
    """

    tenant: str
    subscription: str
    entity: str
    at: float
    body: bytes | None
    seq: int = 0
    headers: bytes | None = None

    @property
    def waits_for_throttling(self) -> bool:
        """Say whether it is told together with others once the throttling ends."""
        return self.body is None or self.body.startswith(b"[")

    @property
    def size(self) -> int:
        """How many bytes it takes, about."""
        return OVERHEAD_BYTES + (0 if self.body is None else len(self.body))


@dataclass(slots=True)
class Entries:
    """What is to be written in one commit; None as a body deletes."""

    entities: dict[int, EntityRow] = field(default_factory=dict)
    """By place in the order of creation."""
    documents: dict[DocumentKey, bytes | None] = field(default_factory=dict)
    owed: list[Notice] = field(default_factory=list)
    settled: list[int] = field(default_factory=list)
    history: list[HistoryRow] = field(default_factory=list)
    cleared: list[tuple[int, int]] = field(default_factory=list)
    """Places, each with the seq below which its history is cleared away."""
    departed: dict[int, DepartedRow] = field(default_factory=dict)
    """By place in the order of creation."""

    def add(self, later: "Entries") -> None:
        """Put what comes later into the same commit."""
        self.entities.update(later.entities)
        self.history.extend(later.history)
        if later.owed:
            self.owed.extend(later.owed)
        if later.settled:
            self.settled.extend(later.settled)
        if later.documents:
            self.documents.update(later.documents)
        if later.departed:
            self.departed.update(later.departed)
        if later.cleared:
            self.cleared.extend(later.cleared)


class Journal:
    """Keeps what must survive in a database. `commit` is called from one thread, and only from there."""

    def __init__(self, database: Database) -> None:
        self.name = database.name
        self.archive = Archive(database)
        self._database = database
        self._last_notice = 0

    def open(self) -> None:
        """Make ready; bring older content up to date. Raises `UsageError` if that cannot be."""
        self._database.open(SCHEMA_VERSION, _MIGRATIONS)
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
        with self._database.transaction() as writer:
            self.write(writer, entries, self._last_notice)
        self._last_notice += len(entries.owed)

    def transaction(self) -> AbstractContextManager[Writer]:
        """Begin a transaction, as a commit is one. Raises `NotStored`."""
        return self._database.transaction()

    @staticmethod
    def write(writer: Writer, entries: Entries, last_notice: int) -> None:
        """Write all of `entries`; what is owed is numbered from `last_notice` on."""
        _write_entities(writer, entries)
        _write_documents(writer, entries)
        _write_outbox(writer, entries, last_notice)
        write_archive(writer, entries.history, entries.cleared, entries.departed)

    def close(self) -> None:
        """Let go."""
        self.archive.close()
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


def _write_outbox(writer: Writer, entries: Entries, last_notice: int) -> None:
    for number, one in enumerate(entries.owed, last_notice + 1):
        one.seq = number
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
