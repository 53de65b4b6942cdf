"""The store of a tenant as a caller with restricted rights sees it.

Every read and every change of entities goes through a `Store`, so that links, filters and batches need no
checks of their own: an entity that the caller may not see is absent, and a change of it, or one that the
caller may not make, fails with a problem.
"""

import asyncio
from collections.abc import Callable, Iterable, Mapping
from typing import Protocol

from handover.errors import Problem
from handover.security.permissions import Permission
from handover_broker.access.rights import Rights
from handover_broker.model.entity import Entity, Event
from handover_broker.query.geo_query import GeoQuery
from handover_broker.query.indexes.q_index import Condition
from handover_broker.query.type_selection import TypeSelection
from handover_broker.storage.store import OverlayStore, Store
from handover_broker.storage.type_statistics import TypeStatistics


class Recording(Protocol):
    """Notes which entities a request reads and changes."""

    def note_read(self, entities: Iterable[Entity]) -> None:
        """Note that the response contains `entities`."""

    def note_change(self, event: Event, *, is_refused: bool) -> None:
        """Note a change, or that it was refused."""


class RestrictedStore(Store):
    """A view of `store`: `rights` select visible entities, `refusal` gives the reason against a change.

    `recording` notes what is read and changed, if the caller is recorded.
    """

    def __init__(
        self,
        store: Store,
        rights: Rights,
        refusal: Callable[[Event], Problem | None],
        recording: Recording | None = None,
    ) -> None:
        super().__init__(store.tenant, store._commits, store._places, store._announce, store._deliver)
        self._store = store
        self._rights = rights
        self._shows = rights.shows
        self._refusal = refusal
        self._recording = recording

    def __len__(self) -> int:
        return len(self.candidates())

    def shows(self, entity: Entity) -> bool:
        """Return whether the caller may see `entity`."""
        return self._shows(entity)

    def hides(self, entity_id: str, types: Iterable[str] = ()) -> bool:
        """Return whether the caller may not see an entity that has these types elsewhere."""
        own = self._store.latest(entity_id)
        is_private = self._rights.is_private(entity_id, types)
        if not self._rights.may_see(entity_id, is_private=is_private):
            return True
        return own is not None and not self._shows(own)

    def may_see_private(self, *, somewhere: bool = True) -> bool:
        """Return whether the caller may see entities about the body of some person, or else of every
        person.
        """
        if somewhere:
            return self._rights.caller.may_somewhere(Permission.READ_HEALTH_DATA)
        return self._rights.may_everywhere(Permission.READ_HEALTH_DATA)

    def types_of(self, entity_id: str) -> tuple[str, ...]:
        """Return the types of an entity as the last write left it, visible or not."""
        return self._store.types_of(entity_id)

    def require_shown(self, entity: Entity) -> None:
        """Raise a problem (403) if the caller may not see an entity that it is about to change."""
        if self._shows(entity):
            return
        if self._recording is not None:
            self._recording.note_change(Event(entity, entity, frozenset()), is_refused=True)
        is_private = self._rights.is_private(entity.id, entity.types)
        permission = Permission.READ_HEALTH_DATA if is_private else Permission.WRITE_ENTITIES
        raise self._rights.denied(permission, entity.id)

    def statistics(self) -> TypeStatistics:
        """Return the counts of the types of which the caller may see all entities."""
        counts = self._store.statistics()
        if self._rights.may_everywhere(Permission.READ_HEALTH_DATA):
            return counts
        return counts.without(lambda kind: self._rights.is_private("", (kind,)))

    def note_read(self, entities: Iterable[Entity]) -> None:
        """Note that a response contains `entities`."""
        if self._recording is not None:
            self._recording.note_read(entities)

    def get(self, entity_id: str) -> Entity | None:
        """Return the committed entity if the caller may see it."""
        return self._visible(self._store.get(entity_id))

    def candidates(
        self,
        ids: Iterable[str] | None = None,
        types: TypeSelection | None = None,
        conditions: Iterable[Condition] = (),
        places: GeoQuery | None = None,
    ) -> list[Entity]:
        """Return the visible ones of the candidates."""
        return [
            candidate
            for candidate in self._store.candidates(ids, types, conditions, places)
            if self._shows(candidate)
        ]

    def overlay(
        self, ids: Iterable[str] | None, types: Iterable[str] | None, others: Mapping[str, Entity | None]
    ) -> OverlayStore:
        """Return the store for one response, with the visible ones of the entities of context sources.

        An entity that is hidden here is hidden too as a context source has it.
        """
        return super().overlay(
            ids,
            types,
            {
                entity_id: None if entity is None or self.hides(entity_id, entity.types) else entity
                for entity_id, entity in others.items()
            },
        )

    def latest(self, entity_id: str) -> Entity | None:
        """Return the entity as the last write left it. Raises a problem (403) if the caller may not see it.

        So no other answer depends on what the caller may not see. Ids of entities about the bodies of persons
        are refused whether such an entity exists or not.
        """
        entity = self._store.latest(entity_id)
        if entity is not None:
            self.require_shown(entity)
        elif self._rights.is_private(entity_id, ()):
            self.require_shown(Entity(entity_id, (), {}, "", ""))
        return entity

    def stage(self, event: Event) -> asyncio.Future[None]:
        """Start to write a change; the future fails with a problem (403) if the caller may not make it."""
        refusal = self._refusal(event)
        if self._recording is not None:
            self._recording.note_change(event, is_refused=refusal is not None)
        if refusal is None:
            return self._store.stage(event)
        refused: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        refused.set_exception(refusal)
        return refused

    def _visible(self, entity: Entity | None) -> Entity | None:
        return entity if entity is not None and self._shows(entity) else None
