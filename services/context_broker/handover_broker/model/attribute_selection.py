"""Entities with a part of their attributes."""

from handover_broker.model.entity import Entity


def select_attributes(
    entity: Entity, names: frozenset[str] | None, without: frozenset[str] = frozenset()
) -> Entity:
    """Return the entity with the attributes `names` (IRIs, None for all), except those in `without`."""
    selected = {
        name: instances
        for name, instances in entity.attributes.items()
        if (names is None or name in names) and name not in without
    }
    if len(selected) == len(entity.attributes):
        return entity
    return Entity(
        entity.id,
        entity.types,
        selected,
        entity.created_at,
        entity.modified_at,
        entity.seq,
        entity.scopes,
        entity.expires_at,
    )
