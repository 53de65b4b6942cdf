"""The content of a snapshot: entities that are written to, and deleted from, a tenant of its own."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

from handover_broker.model.attribute_selection import select_attributes
from handover_broker.model.entity import Entity
from handover_broker.storage.entries import DocumentKey, DocumentKind, EntityRow, Entries
from handover_broker.storage.history_archive import END_OF_TIME, TemporalOnlyRow
from handover_broker.tenants import Tenant

ENTITIES_PER_COMMIT = 2000
"""Entities in one commit, so that other commits are not delayed."""


@dataclass(slots=True)
class SnapshotContent:
    """The entities of a snapshot in creation. Of an entity in several query results the first counts."""

    entities: list[Entity] = field(default_factory=list)
    _known: set[str] = field(default_factory=set)

    def add(self, originals: Iterable[Entity], attributes: frozenset[str] | None) -> None:
        """Add entities with the `attributes` (IRIs, None for all). Their expiry is removed."""
        for original in originals:
            if original.id not in self._known:
                self._known.add(original.id)
                entity = original if attributes is None else select_attributes(original, attributes)
                self.entities.append(replace(entity, expires_at=None, rendered={}))

    def keep_only(self, count: int) -> None:
        """Remove all but the first `count` entities."""
        self._known.difference_update(entity.id for entity in self.entities[count:])
        del self.entities[count:]


async def write_content(inner: Tenant, content: SnapshotContent) -> None:
    """Write the content of a snapshot; it becomes visible all at once. Raises `NotStored`."""
    copies = [replace(original, seq=inner.store.next_seq(), rendered={}) for original in content.entities]
    for start in range(0, len(copies), ENTITIES_PER_COMMIT):
        rows = {
            copy.seq: EntityRow(inner.name, copy.id, copy.stored())
            for copy in copies[start : start + ENTITIES_PER_COMMIT]
        }
        await inner.commits.store(Entries(entities=rows))
    for entity in copies:
        inner.store.take(entity)


def deletion_entries(inner: Tenant, temporal_only: Sequence[tuple[int, str]]) -> Iterator[Entries]:
    """Yield the commits that delete all documents and entities of a snapshot.

    `temporal_only` are sequence number and id of the entities that have a history only.
    """
    for start in range(0, len(temporal_only), ENTITIES_PER_COMMIT):
        gone_by = temporal_only[start : start + ENTITIES_PER_COMMIT]
        yield Entries(
            temporal_only={
                place: TemporalOnlyRow(inner.name, entity_id, None) for place, entity_id in gone_by
            },
            cleared=[(place, END_OF_TIME) for place, _ in gone_by],
        )
    entities = inner.store.candidates()
    for start in range(0, len(entities), ENTITIES_PER_COMMIT):
        some = entities[start : start + ENTITIES_PER_COMMIT]
        yield Entries(
            entities={entity.seq: EntityRow(inner.name, entity.id, None) for entity in some},
            cleared=[(entity.seq, END_OF_TIME) for entity in some],
        )
    gone: dict[DocumentKey, bytes | None] = dict.fromkeys(inner.federation.document_keys())
    for subscription in inner.notifier.all():
        gone[DocumentKind.SUBSCRIPTION, inner.name, subscription.id] = None
        gone[DocumentKind.COUNTS, inner.name, subscription.id] = None
    if gone:
        yield Entries(documents=gone)
