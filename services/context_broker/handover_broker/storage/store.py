"""The entities in memory: readers see what is committed, writers build on what is staged.

A change is staged first. Once the journal has it, it becomes visible and its notifications are sent. If the
disk refuses, all staged changes are dropped, so that memory never has more than the disk.
"""

import asyncio
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol

import orjson

from handover.telemetry import get_logger
from handover_broker.model.entity import Entity, Event
from handover_broker.model.nesting import too_deep
from handover_broker.model.problems import not_stored, went_wrong
from handover_broker.query.geo_query import GeoQuery
from handover_broker.query.indexes.attribute_index import AttributeIndex, ids_of
from handover_broker.query.indexes.place_index import PlaceIndex
from handover_broker.query.indexes.q_index import Condition
from handover_broker.query.type_selection import TypeSelection, of_types
from handover_broker.storage.commits import Commits
from handover_broker.storage.entries import EntityRow, Entries, PendingNotification
from handover_broker.storage.expiry_queue import ExpiryQueue
from handover_broker.storage.journal import NotStored
from handover_broker.storage.ordered_entities import OrderedEntities, by_sequence
from handover_broker.storage.type_statistics import TypeStatistics

log = get_logger(__name__)

MAX_INDEXES: Final = 64
"""Maximum indexes of attributes, and of attributes with geometries."""


@dataclass(slots=True, eq=False)
class Staged:
    """A staged change: the entity before and after (None if it does not exist).

    `outcome` is done when the change is durable, or fails with a problem (507).
    """

    store: "Store"
    event: Event
    notices: list[PendingNotification]
    outcome: asyncio.Future[None]

    @property
    def after(self) -> Entity | None:
        """Return the entity after the change."""
        return self.event.after

    def done(self) -> None:
        """Make the change visible: it is durable."""
        self.store.show(self)
        if not self.outcome.done():
            self.outcome.set_result(None)

    def failed(self, error: Exception) -> None:
        """Report that the change was not stored, or that a later step failed."""
        if self.outcome.done():
            return
        if isinstance(error, NotStored):
            self.outcome.set_exception(not_stored(str(error), is_away=error.is_away))
        else:
            self.outcome.set_exception(went_wrong(error, "completing a change that is stored"))


class Recorder(Protocol):
    """Adds the history of a change to its commit."""

    def record(self, tenant: str, event: Event, entries: Entries) -> None:
        """Record a change."""


Announce = Callable[[Event], list[PendingNotification]]
"""Returns the notifications of a change."""


class Store:
    """All entities of one tenant.

    `announce` returns the notifications of a change, `deliver` sends them once they are committed. `places`
    returns the next sequence number; `recorder` records history (None: no history); `ends` deletes transient
    entities; `on_deletion` is called with each entity whose deletion is durable.
    """

    def __init__(
        self,
        tenant: str,
        commits: Commits,
        places: Iterator[int],
        announce: Announce,
        deliver: Callable[[list[PendingNotification]], None],
        *,
        recorder: Recorder | None = None,
        ends: ExpiryQueue | None = None,
        on_deletion: Callable[[Entity], None] = lambda _: None,
    ) -> None:
        self.tenant = tenant
        self._commits = commits
        self._places = places
        self._announce = announce
        self._deliver = deliver
        self._recorder = recorder
        self.type_statistics = TypeStatistics()
        self._ends = ends
        self._on_deletion = on_deletion
        self._every = OrderedEntities()
        self._by_type: dict[str, OrderedEntities] = {}
        self._indexes: dict[str, AttributeIndex] = {}
        self._place_indexes: dict[str, PlaceIndex] = {}
        self._staged: dict[str, Staged] = {}

    def take(self, entity: Entity) -> None:
        """Add an entity from the journal."""
        self._put(None, entity)

    # For readers

    def __len__(self) -> int:
        return len(self._every.by_id)

    def shows(self, entity: Entity) -> bool:  # noqa: ARG002 - a restricted store decides
        """Return whether the reader of this store may see `entity`."""
        return True

    def may_see_private(self, *, somewhere: bool = True) -> bool:  # noqa: ARG002 - likewise
        """Return whether the reader may see entities about the body of some person, or else of every
        person.
        """
        return True

    def types_of(self, entity_id: str) -> tuple[str, ...]:
        """Return the types of an entity as the last write left it, visible or not, to decide on rights."""
        entity = self.latest(entity_id)
        return () if entity is None else entity.types

    def hides(self, entity_id: str, types: Iterable[str] = ()) -> bool:  # noqa: ARG002 - likewise
        """Return whether the reader may not see an entity that has these types at a context source."""
        return False

    def require_shown(self, entity: Entity) -> None:
        """Raise a problem (403) if the caller may not see an entity that it is about to change."""

    def statistics(self) -> TypeStatistics:
        """Return the counts of the types and attributes that the reader may see."""
        return self.type_statistics

    def note_read(self, entities: Iterable[Entity]) -> None:
        """Note that a response contains `entities`; a recording store does."""

    def entities_of(self, is_wanted: Callable[[str], bool]) -> Iterator[Entity]:
        """Yield the entities with a type (an IRI) that is wanted."""
        for kind, ranks in self._by_type.items():
            if is_wanted(kind):
                yield from ranks.by_id.values()

    def get(self, entity_id: str) -> Entity | None:
        """Return the committed entity."""
        return self._every.by_id.get(entity_id)

    def candidates(
        self,
        ids: Iterable[str] | None = None,
        types: TypeSelection | None = None,
        conditions: Iterable[Condition] = (),
        places: GeoQuery | None = None,
    ) -> list[Entity]:
        """Return entities among which all hits are, narrowed by the indexes, in the order of creation.

        An argument that is None does not narrow them.
        """
        if ids is not None:
            entities = [
                entity for entity_id in dict.fromkeys(ids) if (entity := self._every.by_id.get(entity_id))
            ]
            return by_sequence(entities)
        count = len(self._every.by_id)
        chosen: Iterable[str] | None = None
        for condition in conditions:
            index = self._index(condition.attribute)
            if index is not None:
                checkpointed = index.found(condition)
                if (size := sum(map(len, checkpointed))) < count:
                    count, chosen = size, ids_of(checkpointed)
        if places is not None and places.box is not None and count:
            place_index = self._place_index(places.attribute)
            if place_index is not None and len(touched := place_index.found(places.box)) < count:
                count, chosen = len(touched), touched
        if types is not None and not types.is_every and self._count_of(types) <= count:
            return self._of_types(types)
        if chosen is not None:
            return by_sequence(self._every.by_id[entity_id] for entity_id in chosen)
        return self._every.all()

    def _count_of(self, types: TypeSelection) -> int:
        return sum(len(self._rarest(alternative)) for alternative in types.alternatives)

    def _rarest(self, kinds: frozenset[str]) -> dict[str, Entity]:
        """Return the entities of the rarest of the types."""
        having = (self._by_type.get(kind) for kind in kinds)
        return min((ranks.by_id if ranks is not None else {} for ranks in having), key=len)

    def _of_types(self, types: TypeSelection) -> list[Entity]:
        if len(types.alternatives) == 1 and len(types.alternatives[0]) == 1:
            (kind,) = types.alternatives[0]
            ranks = self._by_type.get(kind)
            return ranks.all() if ranks is not None else []
        hits: dict[str, Entity] = {}
        for kinds in types.alternatives:
            hits.update(self._rarest(kinds))
        return by_sequence(hits.values())

    def overlay(
        self, ids: Iterable[str] | None, types: Iterable[str] | None, others: Mapping[str, Entity | None]
    ) -> "OverlayStore":
        """Return a store for one response: the entities with these ids or else types (None: all), and
        `others`.

        `others` are entities merged with context sources; None hides one. The store is read-only.
        """
        overlay = OverlayStore(self, others)
        for own in self.candidates(ids, None if types is None else of_types(tuple(types))):
            if own.id not in others:
                overlay.take(own)
        for entity in by_sequence(other for other in others.values() if other is not None):
            overlay.take(entity)
        return overlay

    # For writers

    def latest(self, entity_id: str) -> Entity | None:
        """Return the entity as the last write left it, committed or not."""
        staged = self._staged.get(entity_id)
        return staged.after if staged is not None else self._every.by_id.get(entity_id)

    def next_seq(self) -> int:
        """Return the next sequence number."""
        return next(self._places)

    def stage(self, event: Event) -> asyncio.Future[None]:
        """Start to write a change; the future is done when it is durable, or fails with a problem (507)."""
        event = event.with_former_types()
        before, after = event.before, event.after
        entries = Entries()
        entity = after or before
        assert entity is not None  # noqa: S101 - a change has at least one end
        try:
            entries.entities[entity.seq] = EntityRow(
                self.tenant, entity.id, None if after is None else after.stored()
            )
            if self._recorder is not None:
                self._recorder.record(self.tenant, event, entries)
        except orjson.JSONEncodeError:
            raise too_deep() from None
        entries.pending = self._announce(event)
        outcome = asyncio.get_running_loop().create_future()
        staged = self._staged[entity.id] = Staged(self, event, entries.pending, outcome)
        self._commits.submit(entries, staged.done, staged.failed)
        return outcome

    def show(self, staged: Staged) -> None:
        """Make a durable change visible, and send its notifications."""
        event = staged.event
        entity = event.after or event.before
        assert entity is not None  # noqa: S101 - a change has at least one end
        entity_id = entity.id
        before = self._every.by_id.get(entity_id)
        if self._staged.get(entity_id) is staged:
            del self._staged[entity_id]
        self._put(before, event.after, event.written if before is event.before else None)
        if staged.notices:
            self._deliver(staged.notices)
        if event.after is None:
            self._on_deletion(entity)

    def forget_staged(self) -> None:
        """Drop all staged changes: the disk has refused them."""
        self._staged.clear()

    # Order and indexes

    def _put(
        self, before: Entity | None, after: Entity | None, written: frozenset[str] | None = None
    ) -> None:
        if before is not None and (after is None or after.seq != before.seq):
            self._every.remove(before.id)  # a new entity of the same id goes to the end of the order
        if after is not None:
            self._every.put(after)
        try:
            if after is not None and after.ends_at is not None and self._ends is not None:
                self._ends.watch(self, after)
            elif (
                after is None and before is not None and before.ends_at is not None and self._ends is not None
            ):
                self._ends.forget(self, before.id)
            self.type_statistics.note(before, after, written)
            self._file_by_type(before, after)
            for index in self._indexes.values():
                index.refile(before, after)
            for place_index in self._place_indexes.values():
                place_index.refile(before, after)
        except Exception:
            log.exception(
                "indexes are rebuilt", entity=None if (entity := after or before) is None else entity.id
            )
            self._derive()

    def _derive(self) -> None:
        """Rebuild from the entities what is derived from them; indexes are rebuilt when they are needed.

        The entities themselves are as on disk at this point.
        """
        self._indexes.clear()
        self._place_indexes.clear()
        self.type_statistics, self._by_type = TypeStatistics(), {}
        for entity in self._every.all():
            self.type_statistics.note(None, entity)
            self._file_by_type(None, entity)

    def _file_by_type(self, before: Entity | None, after: Entity | None) -> None:
        if before is not None and (after is None or before.types != after.types or before.seq != after.seq):
            for kind in before.types:
                self._by_type[kind].remove(before.id)
        if after is None:
            return
        for kind in after.types:
            ranks = self._by_type.get(kind)
            if ranks is None:
                ranks = self._by_type[kind] = OrderedEntities()
            ranks.put(after)

    def _index(self, attribute: str) -> AttributeIndex | None:
        """Return the index of an attribute, created at its first use."""
        index = self._indexes.get(attribute)
        if index is None and _has_room(self._indexes):
            index = self._indexes[attribute] = AttributeIndex(attribute, self._every.by_id.values())
        return index

    def _place_index(self, attribute: str) -> PlaceIndex | None:
        """Return the geometry index of an attribute, created at its first use."""
        index = self._place_indexes.get(attribute)
        if index is None and _has_room(self._place_indexes):
            index = self._place_indexes[attribute] = PlaceIndex(attribute, self._every.by_id.values())
        return index


class OverlayStore(Store):
    """Entities merged with those of context sources, on top of the store of the tenant."""

    def __init__(self, store: Store, others: Mapping[str, Entity | None]) -> None:
        super().__init__(store.tenant, store._commits, store._places, store._announce, store._deliver)
        self.origins: Mapping[str, list[str]] = {}
        """By entity, the registrations it comes from, and `@none` for this broker (clause 5.2.39)."""
        self._store = store
        self._others = others

    def note_read(self, entities: Iterable[Entity]) -> None:
        """Note it as the store of the tenant does."""
        self._store.note_read(entities)

    def get(self, entity_id: str) -> Entity | None:
        """Return the merged entity, or the committed one."""
        entity = super().get(entity_id)
        return self._store.get(entity_id) if entity is None and entity_id not in self._others else entity


def _has_room(indexes: dict[str, Any]) -> bool:
    """Return whether one more index is allowed; an index of an attribute that no entity has is replaced."""
    if len(indexes) >= MAX_INDEXES:
        unused = next((attribute for attribute, index in indexes.items() if not len(index)), None)
        if unused is None:
            return False
        del indexes[unused]
    return True
