"""Which entities are about the body of a person: by their types, in any vocabulary, and by their ids.

An entity with one such type is private as a whole, whatever other types it has. The id counts too
(`urn:ngsi-ld:HumanState:…`), because a request may name an entity whose types are not known here.
"""

import re
from collections.abc import Collection, Iterable
from typing import Final

from handover_broker.model.entity import Entity

_REF_PERSON: Final = "refPerson"
_SEPARATORS: Final = re.compile(r"[/#:?]+")
_PLACE_OF_TYPE: Final = 2
"""The place of the type in an id such as urn:ngsi-ld:Device:demo:1."""


def short_name(iri: str) -> str:
    """Return the last part of a name, which may be an IRI of any vocabulary."""
    return next((part for part in reversed(_SEPARATORS.split(iri)) if part), iri)


def has_type_of(types: Iterable[str], names: Collection[str]) -> bool:
    """Return whether one of the types (IRIs) has one of these names, in any vocabulary."""
    return any(short_name(kind) in names for kind in types)


def is_of(entity: Entity, names: Collection[str]) -> bool:
    """Return whether one of the types of an entity has one of these names, in any vocabulary."""
    return has_type_of(entity.types, names)


def type_in(entity_id: str) -> str:
    """Return the type in an id such as urn:ngsi-ld:Device:demo:1; empty if it has none."""
    parts = entity_id.split(":", _PLACE_OF_TYPE + 1)
    return parts[_PLACE_OF_TYPE] if len(parts) > _PLACE_OF_TYPE else ""


def person_of(entity: Entity) -> str | None:
    """Return the Person that an entity is about, if it names one in `refPerson`."""
    for name, instances in entity.attributes.items():
        if short_name(name) == _REF_PERSON and instances:
            person = instances[0].get("object")
            return person if isinstance(person, str) else None
    return None
