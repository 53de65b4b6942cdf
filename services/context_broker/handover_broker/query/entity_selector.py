"""Entity selectors: the entities of a subscription by id, id pattern and type (clause 5.2.33)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from handover_broker.model.entity import Entity
from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import require_uri, shown
from handover_broker.query.patterns import Pattern, fits, pattern
from handover_broker.query.type_selection import TypeSelection, type_selection


@dataclass(frozen=True, slots=True)
class EntitySelector:
    """Entities with one of the ids, or with an id that matches the pattern, and of the types; None matches
    all."""

    ids: frozenset[str] | None = None
    id_pattern: Pattern | None = None
    types: TypeSelection | None = None
    plain: str | None = None
    """The type, if there is exactly one: comparing it is faster than a selection."""

    def wants(self, entity: Entity) -> bool:
        """Return whether the entity matches."""
        return (
            (self.ids is None or entity.id in self.ids)
            and (
                self.plain in entity.types
                if self.plain is not None
                else self.types is None or self.types.wants(entity.types)
            )
            and (self.id_pattern is None or fits(self.id_pattern, entity.id))
        )

    def kinds(self) -> list[str] | None:
        """Return types (IRIs) of which each match has at least one; None if it can have any."""
        if self.types is None or self.types.is_every:
            return None
        return [min(alternative) for alternative in self.types.alternatives]


def entity_selector(stored: Mapping[str, Any]) -> EntitySelector:
    """Return the selector of a stored document (types are IRIs); raise a problem (400) if it is invalid."""
    ids, wanted, kinds = stored.get("id"), stored.get("idPattern"), stored.get("type")
    if wanted is not None and not isinstance(wanted, str):
        raise bad_request_data(f"idPattern is text, not {shown(wanted)}")
    listed = ids if isinstance(ids, list) and ids else [ids]
    types = None if kinds is None else type_selection(kinds, str)
    named = () if types is None else tuple(types.names())
    return EntitySelector(
        ids=None
        if ids is None
        else frozenset(require_uri(entity_id, "the id of an entity selector") for entity_id in listed),
        id_pattern=None if wanted is None or ids is not None else pattern(wanted),  # an id takes precedence
        types=types,
        plain=named[0] if len(named) == 1 else None,
    )
