"""Entities by id, told in the order of their creation.

They mostly come in that order, and are put in order only when somebody asks. What comes late is an entity
that got another type, and news of other brokers, which come in the order of their commits.
"""

from collections.abc import Iterable
from operator import attrgetter

from services.context_broker.model.entity import Entity

_BY_SEQ = attrgetter("seq")


class OrderedEntities:
    """Some of a tenant's entities. `by_id` is there to look up and to count, not to change."""

    __slots__ = ("_highest", "_is_in_order", "by_id")

    def __init__(self) -> None:
        self.by_id: dict[str, Entity] = {}
        self._highest = 0
        """No entity here has a higher place. Kept as a number: to look at the last entity costs more."""
        self._is_in_order = True

    def put(self, entity: Entity) -> None:
        """Take an entity, or how it is now."""
        if entity.seq > self._highest:
            self._highest = entity.seq
        elif self._is_in_order and entity.id not in self.by_id:
            self._is_in_order = False
        self.by_id[entity.id] = entity

    def remove(self, entity_id: str) -> None:
        """Let go of an entity."""
        del self.by_id[entity_id]

    def all(self) -> list[Entity]:
        """Return all of them in the order of creation."""
        if not self._is_in_order:
            self.by_id = {one.id: one for one in by_sequence(self.by_id.values())}
            self._is_in_order = True
        return list(self.by_id.values())


def by_sequence(entities: Iterable[Entity]) -> list[Entity]:
    """Return entities in the order of their creation."""
    return sorted(entities, key=_BY_SEQ)
