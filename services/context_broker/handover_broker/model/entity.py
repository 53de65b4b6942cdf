"""Stored entities: names are expanded to IRIs, attributes are lists of instances.

An instance is a JSON object with `type`, its value member (`value`, `object`, …), metadata with short names,
and sub-attributes with IRIs (which all contain a colon). Entities are immutable: a change creates a new one.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple, Protocol

import orjson

from handover_datamodels import forms

Instance = dict[str, Any]
Attributes = dict[str, list[Instance]]

VALUE_MEMBER: Final = forms.MEMBERS
"""Each kind of attribute with its value member."""

NULL: Final = forms.NULL
"""Marks in a change what is to be deleted."""


class Terms(Protocol):
    """The terms of an @context."""

    def __hash__(self) -> int:
        """Identifies the terms."""

    def expand(self, term: str) -> str:
        """Return the IRI of a short name."""

    def compact(self, iri: str) -> str:
        """Return the short name of an IRI."""


@dataclass(slots=True, eq=False)
class Entity:
    """One entity; `seq` is its sequence number."""

    id: str
    types: tuple[str, ...]
    attributes: Attributes
    created_at: str
    modified_at: str
    seq: int = 0
    scopes: tuple[str, ...] = ()
    """As they were written: the leading slash of a scope is optional."""
    expires_at: str | None = None
    """The expiry of a transient entity (clause 4.22), None if it has none."""
    ends_at: str | None = None
    """The earliest expiry of the entity and its attributes, None if there is none."""
    former_types: tuple[str, ...] = ()
    """Types that it has lost since its creation: rights to its history count for them, too."""
    rendered: dict[Any, bytes] = field(default_factory=dict)
    """Recently rendered forms, by context and form, because most reads repeat."""

    def stored(self) -> bytes:
        """Return the entity as the journal stores it; raises `orjson.JSONEncodeError` if it is nested too
        deeply."""
        former = {"formerTypes": self.former_types} if self.former_types else {}
        return orjson.dumps(
            {
                "id": self.id,
                "types": self.types,
                "attributes": self.attributes,
                "createdAt": self.created_at,
                "modifiedAt": self.modified_at,
                "seq": self.seq,
                "scopes": self.scopes,
                "expiresAt": self.expires_at,
                "endsAt": self.ends_at,
                **former,
            }
        )

    @classmethod
    def restored(cls, stored: bytes) -> "Entity":
        """Return the entity of a stored record."""
        fields = orjson.loads(stored)
        return cls(
            fields["id"],
            tuple(fields["types"]),
            fields["attributes"],
            fields["createdAt"],
            fields["modifiedAt"],
            fields["seq"],
            tuple(fields["scopes"]),
            fields["expiresAt"],
            fields["endsAt"],
            tuple(fields.get("formerTypes", ())),
        )


class Event(NamedTuple):
    """A change of one entity: before and after, None if it does not exist.

    `written` are the attributes (IRIs) in the change, whether their values are new or not. Attributes that
    are not in it are the same objects before and after.
    """

    before: Entity | None
    after: Entity | None
    written: frozenset[str]

    def with_former_types(self) -> "Event":
        """Return the change such that the entity afterwards knows the types that it has lost."""
        before, after = self.before, self.after
        if before is None or after is None or (before.types == after.types and not before.former_types):
            return self
        types = dict.fromkeys((*before.former_types, *before.types))
        former = tuple(kind for kind in types if kind not in after.types)
        if former == after.former_types:
            return self
        return self._replace(after=replace(after, former_types=former, rendered={}))

    @classmethod
    def end_of(cls, entity: Entity) -> "Event":
        """Return the deletion of an entity."""
        return cls(entity, None, frozenset())


def is_deletion(instance: Mapping[str, Any]) -> bool:
    """Return whether an instance in a change is to be deleted."""
    value = instance.get(VALUE_MEMBER[instance["type"]])
    return value == NULL or (isinstance(value, dict) and value.get("@none") == NULL)


def dataset_of(instance: Mapping[str, Any]) -> str | None:
    """Return the datasetId of an instance, None for the default one."""
    dataset: str | None = instance.get("datasetId")
    return dataset
