"""The history of entities on disk: a row for each change, and a row for each entity that is history only.

Rows are written as part of a commit of the journal and read from any number of threads. They are in the order
of time and found by an index: rows in the order of entities would double the cost of a commit.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from handover.database.sqlite_files import damage
from handover_broker.storage import checksums
from handover_broker.storage.checksums import require_row
from handover_broker.storage.database import Database, NotStored, Writer

END_OF_TIME: Final = 2**62
"""Above the seq of every row of history."""


_CHANGE: Final = "entity, seq, observed_from, observed_to, rewritten, body, checksum"


class HistoryRow(NamedTuple):
    """A change of the entity with sequence number `entity`; without `body` the row is deleted.

    `seq` is the time of the change in microseconds since 1970, unique within the entity. `observed` are the
    first and the last observedAt in it, in seconds since 1970, if it has any. `rewritten` is 1 if it was
    changed later, so that a modifiedAt in it may be later than the row.
    """

    entity: int
    seq: int
    observed_from: float | None
    observed_to: float | None
    rewritten: int
    body: bytes | None


@dataclass(frozen=True, slots=True)
class TemporalOnlyRow:
    """An entity that is history only: it was deleted, or never existed as a current one. No `body` deletes
    the row."""

    tenant: str
    id: str
    body: bytes | None


class Archive:
    """Reads history, from any thread; raises `NotStored` when the disk cannot be read."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._is_closed = False

    def close(self) -> None:
        """Abort all reads."""
        self._is_closed = True

    def temporal_only_entities(
        self, tenant: str, entity_id: str | None = None
    ) -> Iterator[tuple[int, str, bytes]]:
        """Yield sequence number, id and body of temporal-only entities, all or those of one id; from any
        thread."""
        statement = "SELECT seq, id, body, checksum FROM temporal_only_entities WHERE tenant = ?"
        if entity_id is None:
            rows = self._scan(f"{statement} ORDER BY seq", (tenant,))
        else:
            rows = self._scan(f"{statement} AND id = ? ORDER BY seq", (tenant, entity_id))
        for entity_seq, name, body, checksum in rows:
            require_row(checksums.of_temporal_only, checksum, (entity_seq, tenant, name, body), self._damaged)
            yield entity_seq, name, body

    def history(
        self,
        entity_seqs: Sequence[int],
        condition: str = "",
        values: Sequence[float] = (),
        *,
        latest_first: bool = False,
    ) -> Iterator[tuple[int, int, float | None, bytes]]:
        """Yield entity, seq, first observedAt and body of changes of entities, in order; from any thread.

        `condition` is SQL on seq, observed_from, observed_to and rewritten.
        """
        marks = ", ".join("?" * len(entity_seqs))
        narrowed = f" AND {condition}" if condition else ""
        order = "entity, seq DESC" if latest_first else "entity, seq"
        statement = f"SELECT {_CHANGE} FROM history WHERE entity IN ({marks})"  # noqa: S608 - ours
        for *row, checksum in self._scan(f"{statement}{narrowed} ORDER BY {order}", (*entity_seqs, *values)):
            require_row(checksums.of_change, checksum, row, self._damaged)
            entity_seq, seq, observed_from, _, _, body = row
            yield entity_seq, seq, observed_from, body

    def changes_after(self, entity_seq: int, after: int, most: int) -> list[tuple[int, bytes]]:
        """Return seq and body of the first `most` changes of an entity after the seq `after`."""
        rows = self._database.read(
            f"SELECT {_CHANGE} FROM history WHERE entity = ? AND seq > ? ORDER BY seq LIMIT ?",  # noqa: S608 - ours
            (entity_seq, after, most),
        )
        for *row, checksum in rows:
            require_row(checksums.of_change, checksum, row, self._damaged)
        return [(int(row[1]), row[5]) for row in rows]

    def bound_of(self, entity_seq: int, most: int, before: int | None = None) -> int | None:
        """Return the seq after the first `most` changes of an entity (below `before`), None if there is
        none."""
        narrowed, values = ("", ()) if before is None else ("AND seq < ? ", (before,))
        rows = self._database.read(
            f"SELECT seq FROM history WHERE entity = ? {narrowed}ORDER BY seq LIMIT 1 OFFSET ?",  # noqa: S608 - ours
            (entity_seq, *values, most),
        )
        return int(rows[0][0]) if rows else None

    def first_change(self, after: int) -> tuple[int, int] | None:
        """Return the first entity after `after` that has history, and the seq of its first change."""
        rows = self._database.read(
            "SELECT entity, seq FROM history WHERE entity > ? ORDER BY entity, seq LIMIT 1", (after,)
        )
        return (int(rows[0][0]), int(rows[0][1])) if rows else None

    def temporal_only_without_history(self, entity_seq: int) -> tuple[str, str] | None:
        """Return tenant and id of a temporal-only entity if it has no history."""
        rows = self._database.read(
            "SELECT tenant, id FROM temporal_only_entities WHERE seq = ? "
            "AND NOT EXISTS (SELECT 1 FROM history WHERE entity = temporal_only_entities.seq)",
            (entity_seq,),
        )
        return (rows[0][0], rows[0][1]) if rows else None

    def _damaged(self, row: Sequence[Any]) -> NotStored:
        return NotStored(
            damage(f"{self._database.name}: the history of entity {row[0]} is not as it was written")
        )

    def _scan(self, statement: str, parameters: Sequence[Any]) -> Iterator[Any]:
        for row in self._database.scan(statement, parameters):
            if self._is_closed:
                raise NotStored("the broker stops")
            yield row


def write_archive(
    writer: Writer,
    history: Sequence[HistoryRow],
    cleared: Sequence[tuple[int, int]],
    temporal_only: Mapping[int, TemporalOnlyRow],
) -> None:
    """Write changes and temporal-only entities as part of a commit, and delete what is to be deleted."""
    written = [(*row[:5], row.body) for row in history if row.body is not None]
    if written:
        writer.run_many(
            "INSERT INTO history (entity, seq, observed_from, observed_to, rewritten, body, checksum) "
            "VALUES (?, ?, ?, ?, ?, ?, ?) ON CONFLICT (entity, seq) DO UPDATE SET observed_from = "
            "excluded.observed_from, observed_to = excluded.observed_to, rewritten = excluded.rewritten, "
            "body = excluded.body, checksum = excluded.checksum",
            [(*row, checksums.of_change(*row)) for row in written],
        )
    deleted = [(row.entity, row.seq) for row in history if row.body is None]
    if deleted:
        writer.run_many("DELETE FROM history WHERE entity = ? AND seq = ?", deleted)
    if cleared:
        writer.run_many("DELETE FROM history WHERE entity = ? AND seq < ?", cleared)
    if temporal_only:
        _write_temporal_only(writer, temporal_only)


def _write_temporal_only(writer: Writer, temporal_only: Mapping[int, TemporalOnlyRow]) -> None:
    written = [
        (seq, row.tenant, row.id, row.body) for seq, row in temporal_only.items() if row.body is not None
    ]
    if written:
        writer.run_many(
            "INSERT INTO temporal_only_entities (seq, tenant, id, body, checksum) VALUES (?, ?, ?, ?, ?) "
            "ON CONFLICT (seq) DO UPDATE SET body = excluded.body, checksum = excluded.checksum",
            [(*row, checksums.of_temporal_only(*row)) for row in written],
        )
    deleted = [(seq,) for seq, row in temporal_only.items() if row.body is None]
    if deleted:
        writer.run_many("DELETE FROM temporal_only_entities WHERE seq = ?", deleted)
