"""An entity as the broker keeps it: names expanded to IRIs, attributes always lists of instances.

An instance is a JSON object with `type`, the member that says something (`value`, `object`, …), metadata
under their short names, and attributes of the attribute under their IRIs (which all contain a colon).
Entities are never changed: a change makes a new one, so that what was read stays what it was.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, Protocol

import orjson

from datamodels import forms

Instance = dict[str, Any]
Attributes = dict[str, list[Instance]]

SAYS: Final = forms.MEMBERS
"""Each kind of attribute and the member that holds what it says."""

NULL: Final = forms.NULL
"""What stands in a change where something is to be deleted."""


class Terms(Protocol):
    """An @context as the broker uses it: one that is another object has other names."""

    def __hash__(self) -> int:
        """Tell it from others."""

    def expand(self, term: str) -> str:
        """Return the IRI of a short name."""

    def compact(self, iri: str) -> str:
        """Return the short name of an IRI."""


@dataclass(slots=True, eq=False)
class Entity:
    """One entity; `seq` is its place in the order of creation."""

    id: str
    types: tuple[str, ...]
    attributes: Attributes
    created_at: str
    modified_at: str
    seq: int = 0
    scopes: tuple[str, ...] = ()
    """As they were written: a scope may do without the slash in front."""
    expires_at: str | None = None
    """When a transient entity ends (clause 4.22); None for one that stays."""
    ends_at: str | None = None
    """When it, or the first of its attributes that do, ends; None if nothing of it does."""
    rendered: dict[Any, bytes] = field(default_factory=dict)
    """What readers were last given, by context and form: kept because most reads repeat."""

    def stored(self) -> bytes:
        """Return the entity as the journal keeps it; raises `orjson.JSONEncodeError` if nested too deep."""
        return orjson.dumps(
            [
                self.id,
                self.types,
                self.attributes,
                self.created_at,
                self.modified_at,
                self.seq,
                self.scopes,
                self.expires_at,
                self.ends_at,
            ]
        )

    @classmethod
    def restored(cls, stored: bytes) -> "Entity":
        """Return the entity that `stored` had been."""
        entity_id, types, attributes, created_at, modified_at, seq, *later = orjson.loads(stored)
        scopes, expires_at, ends_at = later or ((), None, None)  # which the first release did not keep
        return cls(
            entity_id,
            tuple(types),
            attributes,
            created_at,
            modified_at,
            seq,
            tuple(scopes),
            expires_at,
            ends_at,
        )


class Event(NamedTuple):
    """A change of one entity: how it was and how it is, None where there is none.

    `written` are the attributes (IRIs) that the change wrote, be their values new or not. Others
    that both ends have are the same objects.
    """

    before: Entity | None
    after: Entity | None
    written: frozenset[str]

    @classmethod
    def end_of(cls, entity: Entity) -> "Event":
        """Return the end of an entity."""
        return cls(entity, None, frozenset())


def is_deletion(instance: Mapping[str, Any]) -> bool:
    """Say whether an instance in a change says that it is to be deleted."""
    said = instance.get(SAYS[instance["type"]])
    return said == NULL or (isinstance(said, dict) and said.get("@none") == NULL)


def dataset_of(instance: Mapping[str, Any]) -> str | None:
    """Return the datasetId that tells an instance from others, None for the default one."""
    dataset: str | None = instance.get("datasetId")
    return dataset
