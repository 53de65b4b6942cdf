"""Entities by id, in the order of their creation.

They are mostly added in that order, and sorted only when a query needs it. An entity that gets another type
is added late.
"""

from collections.abc import Iterable
from operator import attrgetter

from handover_broker.model.entity import Entity

_BY_SEQ = attrgetter("seq")


class OrderedEntities:
    """Some entities of a tenant. `by_id` is for reading only."""

    __slots__ = ("_highest", "_is_in_order", "by_id")

    def __init__(self) -> None:
        self.by_id: dict[str, Entity] = {}
        self._highest = 0
        """The highest sequence number. Looking at the last entity would cost more."""
        self._is_in_order = True

    def put(self, entity: Entity) -> None:
        """Add or replace an entity."""
        if entity.seq > self._highest:
            self._highest = entity.seq
        elif self._is_in_order and entity.id not in self.by_id:
            self._is_in_order = False
        self.by_id[entity.id] = entity

    def remove(self, entity_id: str) -> None:
        """Remove an entity."""
        del self.by_id[entity_id]

    def all(self) -> list[Entity]:
        """Return all of them in the order of creation."""
        if not self._is_in_order:
            self.by_id = {entity.id: entity for entity in by_sequence(self.by_id.values())}
            self._is_in_order = True
        return list(self.by_id.values())


def by_sequence(entities: Iterable[Entity]) -> list[Entity]:
    """Return entities in the order of creation."""
    return sorted(entities, key=_BY_SEQ)
