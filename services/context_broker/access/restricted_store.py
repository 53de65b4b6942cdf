"""The store of a tenant as a caller with restricted rights sees it.

Every read and every change of entities goes through a `Store`, so that links, filters and batches need no
checks of their own: an entity that the caller may not see is absent, and a change that it may not make fails
with a problem.
"""

import asyncio
from collections.abc import Callable, Iterable, Mapping
from typing import Protocol

from handover.errors import Problem
from services.context_broker.model.entity import Entity, Event
from services.context_broker.query.geo_query import GeoQuery
from services.context_broker.query.q_index import Condition
from services.context_broker.query.type_selection import TypeSelection
from services.context_broker.storage.store import OverlayStore, Store


class Recording(Protocol):
    """Notes which entities a request reads and changes."""

    def note_read(self, entities: Iterable[Entity]) -> None:
        """Note that the response contains `entities`."""

    def note_change(self, event: Event, *, is_refused: bool) -> None:
        """Note a change, or that it was refused."""


class RestrictedStore(Store):
    """A view of `store`: `shows` selects visible entities, `refusal` gives the reason against a change.

    `recording` notes what is read and changed, if the caller is recorded.
    """

    def __init__(
        self,
        store: Store,
        shows: Callable[[Entity], bool],
        refusal: Callable[[Event], Problem | None],
        recording: Recording | None = None,
    ) -> None:
        super().__init__(store.tenant, store._commits, store._places, store._announce, store._deliver)
        self.type_statistics = store.type_statistics
        self._store = store
        self._shows = shows
        self._refusal = refusal
        self._recording = recording

    def __len__(self) -> int:
        return len(self.candidates())

    def shows(self, entity: Entity) -> bool:
        """Return whether the caller may see `entity`."""
        return self._shows(entity)

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
        return [one for one in self._store.candidates(ids, types, conditions, places) if self._shows(one)]

    def overlay(
        self, ids: Iterable[str] | None, types: Iterable[str] | None, others: Mapping[str, Entity | None]
    ) -> OverlayStore:
        """Return the store for one response, with the visible ones of the entities of context sources."""
        return super().overlay(ids, types, {one: self._visible(entity) for one, entity in others.items()})

    def latest(self, entity_id: str) -> Entity | None:
        """Return the entity as the last write left it, visible or not: `stage` decides on a change."""
        return self._store.latest(entity_id)

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
