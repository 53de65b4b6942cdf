"""The three representations of an entity: normalized, concise and keyValues (bare values).

Functions on JSON objects, for any entity type (ETSI GS CIM 009, clauses 4.5.1 to 4.5.17). Concise and
normalized are equivalent; keyValues loses attribute types, times and other metadata.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Any, Final


class Form(StrEnum):
    """A representation of an entity."""

    NORMALIZED = "normalized"
    CONCISE = "concise"
    KEY_VALUES = "keyValues"


@dataclass(frozen=True, slots=True)
class Bare:
    """A value without its attribute, as in keyValues; it is never interpreted as an attribute."""

    value: Any


MEMBERS: Final = MappingProxyType(
    {
        "Property": "value",
        "Relationship": "object",
        "GeoProperty": "value",
        "LanguageProperty": "languageMap",
        "JsonProperty": "json",
        "VocabProperty": "vocab",
        "ListProperty": "valueList",
        "ListRelationship": "objectList",
    }
)
"""The attribute types and their value members."""

_KINDS: Final = MappingProxyType({m: k for k, m in MEMBERS.items() if k != "GeoProperty"})

METADATA: Final = frozenset(
    {
        "type", "observedAt", "unitCode", "datasetId", "instanceId", "createdAt", "modifiedAt", "deletedAt",
        "lang", "valueType", "objectType", "previousValue", "previousObject", "previousLanguageMap",
        "previousJson", "previousVocab", "previousValueList", "previousObjectList", "entity", "entityList",
        "ngsildproof",
    }
)  # fmt: skip
"""Members of an attribute that are not attributes of the attribute."""

ENTITY_MEMBERS: Final = frozenset(
    {"id", "type", "scope", "createdAt", "modifiedAt", "deletedAt", "expiresAt", "@context"}
)
"""Members of an entity that are not attributes."""

GEOMETRIES: Final = frozenset(
    {"Point", "MultiPoint", "LineString", "MultiLineString", "Polygon", "MultiPolygon", "GeometryCollection"}
)

NULL: Final = "urn:ngsi-ld:null"
"""The value that marks a deletion in a change."""


def kind_of(attribute: Any) -> str | None:
    """Return the type of a normalized attribute; None for other values."""
    kind = attribute.get("type") if isinstance(attribute, Mapping) else None
    if isinstance(kind, str) and (member := MEMBERS.get(kind)) is not None and member in attribute:
        return kind
    return None


def is_geometry(value: Any) -> bool:
    """Return whether `value` is a GeoJSON geometry."""
    if not isinstance(value, Mapping) or value.get("type") not in GEOMETRIES:
        return False
    return isinstance(value.get("coordinates", value.get("geometries")), list | tuple)


def are_instances(value: Any) -> bool:
    """Return whether `value` is a list of attributes: instances with different `datasetId`s."""
    return isinstance(value, list) and bool(value) and all(kind_of(item) for item in value)


def normalized_attribute(attribute: Any) -> Any:
    """Return an attribute of any form in normalized form (a list if it has several instances)."""
    if isinstance(attribute, Bare):
        return _from_bare(attribute.value)
    if are_instances(attribute):
        return [normalized_attribute(instance) for instance in attribute]
    if not isinstance(attribute, Mapping):
        return {"type": "Property", "value": attribute}
    kind = kind_of(attribute) or _concise_kind(attribute)
    if kind is None:
        return {"type": "GeoProperty" if is_geometry(attribute) else "Property", "value": attribute}
    return {"type": kind, **with_normalized_members(attribute, MEMBERS[kind])}


def with_normalized_members(attribute: Mapping[str, Any], member: str) -> dict[str, Any]:
    """Return an attribute with normalized sub-attributes; `member` and metadata are unchanged."""
    return {
        key: value if key == member or _is_metadata(key) else normalized_attribute(value)
        for key, value in attribute.items()
        if key != "type"
    }


def to_concise(entity: Mapping[str, Any]) -> dict[str, Any]:
    """Return a normalized entity in concise form; `normalized_attribute` is the inverse for an attribute."""
    return {
        name: attribute if is_entity_member(name) else _concise(attribute)
        for name, attribute in entity.items()
    }


def to_key_values(entity: Mapping[str, Any], link_lists: Collection[str] = ()) -> dict[str, Any]:
    """Return a normalized entity as bare values.

    `link_lists` names the Properties whose value is a list of Relationships; they become lists of URIs.
    """
    bare = {
        name: attribute if is_entity_member(name) else _bare(attribute) for name, attribute in entity.items()
    }
    return bare | {name: [link["object"] for link in bare[name]] for name in link_lists}


def _is_metadata(name: str) -> bool:
    return name in METADATA or name.startswith("@")


def is_entity_member(name: str) -> bool:
    """Return whether a member of an entity is no attribute."""
    return name in ENTITY_MEMBERS or name.startswith("@")


def _concise_kind(attribute: Mapping[str, Any]) -> str | None:
    if "type" in attribute:
        return None
    kind = next((kind for member, kind in _KINDS.items() if member in attribute), None)
    return "GeoProperty" if kind == "Property" and is_geometry(attribute["value"]) else kind


def bare_instances(value: Any) -> dict[str, Any] | None:
    """Return the values of an attribute with several instances by datasetId; None if it has only one."""
    if not isinstance(value, Mapping) or len(value) != 1 or not isinstance(value.get("dataset"), Mapping):
        return None
    instances = dict(value["dataset"])
    named = all(name == "@none" or ":" in name for name in instances)
    return instances if instances and named else None


def _from_bare(value: Any) -> Any:
    instances = bare_instances(value)
    if instances is not None:
        return [
            _from_bare(said) if name == "@none" else {**_from_bare(said), "datasetId": name}
            for name, said in instances.items()
        ]
    if isinstance(value, Mapping) and len(value) == 1:
        (member,) = value
        if member in {"languageMap", "json", "vocab"}:
            return {"type": _KINDS[member], member: value[member]}
    return {"type": "GeoProperty" if is_geometry(value) else "Property", "value": value}


def _concise(attribute: Any) -> Any:
    if isinstance(attribute, list):
        return [_concise_instance(instance) for instance in attribute]
    kind = kind_of(attribute)
    if kind is None:
        return attribute
    alone = len(attribute) == 2  # only its type and its value
    if alone and kind == "GeoProperty" and is_geometry(attribute["value"]):
        return attribute["value"]
    if alone and kind == "Property" and not _is_ambiguous(attribute["value"]):
        return attribute["value"]
    short = _concise_members(attribute, MEMBERS[kind])
    return short if _concise_kind(short) == kind else {"type": kind, **short}


def _concise_instance(attribute: Mapping[str, Any]) -> dict[str, Any]:
    """Return one of several instances with its type; without it the list could be a Property value."""
    kind = attribute["type"]
    return {"type": kind, **_concise_members(attribute, MEMBERS[kind])}


def _concise_members(attribute: Mapping[str, Any], member: str) -> dict[str, Any]:
    return {
        key: value if key == member or _is_metadata(key) else _concise(value)
        for key, value in attribute.items()
        if key != "type"
    }


def _is_ambiguous(value: Any) -> bool:
    """Return whether a bare value could be interpreted as something else than a Property value."""
    if isinstance(value, str):
        return value.startswith("urn:")
    read: dict[str, Any] | list[Any] = normalized_attribute(value)
    return read != {"type": "Property", "value": value}


def _bare(attribute: Any) -> Any:
    if isinstance(attribute, list):
        return {"dataset": {item.get("datasetId", "@none"): _bare(item) for item in attribute}}
    kind = kind_of(attribute)
    if kind is None:
        return attribute
    said = attribute[MEMBERS[kind]]
    return {MEMBERS[kind]: said} if kind in {"LanguageProperty", "JsonProperty", "VocabProperty"} else said
