"""Earlier versions of NGSI-LD: entities in a form that clients of an earlier version understand.

What a version does not have is left out or converted to a kind that it has (clause 4.3.6.8): a VocabProperty
is a Property for a client of 1.6. Requested with `Prefer: ngsi-ld=<version>` (clause 6.3.21), or known of a
source.
"""

from typing import Any, Final

from handover_broker.model.negotiation import Version

OURS: Final[Version] = (1, 9)
"""The version of this broker."""

_FALLBACKS: Final = {
    "languageMap": ((1, 4), "value", "Property"),
    "json": ((1, 8), "value", "Property"),
    "vocab": ((1, 8), "value", "Property"),
    "valueList": ((1, 8), "value", "Property"),
    "objectList": ((1, 8), "object", "Relationship"),
}
"""Kinds of attributes: their first version, and their form before it."""
_ENTITY_MEMBERS: Final = {"expiresAt": (1, 9), "scope": (1, 4)}
_ATTRIBUTE_MEMBERS: Final = {
    "datasetId": (1, 3),
    "observedAt": (1, 3),
    "unitCode": (1, 3),
    "objectType": (1, 8),
    "valueType": (1, 9),
    "expiresAt": (1, 9),
}
_NO_ATTRIBUTES: Final = frozenset(
    {"id", "type", "@context", "scope", "createdAt", "modifiedAt", "deletedAt", "expiresAt"}
)
_OPAQUE: Final = frozenset(
    {"value", "object", "languageMap", "json", "vocab", "valueList", "objectList", "type", "lang",
     "previousValue", "previousObject", "previousLanguageMap", "previousJson", "previousVocab",
     "previousValueList", "previousObjectList", "entity", "entityList"}
)  # fmt: skip
_HOLDERS: Final = {"Notification": "data", "FeatureCollection": "features"}
"""Types of documents with entities, and the member with these."""
_ONE_OF_EACH: Final[Version] = (1, 3)
"""The first version with several types of an entity, and with several instances of an attribute."""


def conformed(document: Any, version: Version, *, simplified: bool = False) -> Any:
    """Return an entity, a list of entities or a notification as `version` has it, also as GeoJSON.

    A document that conforms already is returned itself, other documents too. Of a `simplified` entity only
    its own members are converted, since the values of its attributes can be anything.
    """
    if version >= OURS:
        return document
    if isinstance(document, list):
        parts = [conformed(part, version, simplified=simplified) for part in document]
        return document if all(new is old for new, old in zip(parts, document, strict=True)) else parts
    if not isinstance(document, dict) or "type" not in document:
        return document
    kind = document["type"]
    if isinstance(kind, str) and kind in _HOLDERS and isinstance(document.get(_HOLDERS[kind]), list):
        holder = _HOLDERS[kind]
        return _with(document, holder, conformed(document[holder], version, simplified=simplified))
    if kind == "Feature" and isinstance(document.get("properties"), dict):
        properties = _entity(document["properties"], version, simplified=simplified)
        return _with(document, "properties", properties)
    return _entity(document, version, simplified=simplified) if "id" in document else document


def _entity(document: dict[str, Any], version: Version, *, simplified: bool) -> dict[str, Any]:
    reduced = _without(document, _ENTITY_MEMBERS, version)
    types = reduced.get("type")
    if version < _ONE_OF_EACH and isinstance(types, list) and types:
        reduced = _with(reduced, "type", types[0])
    if not simplified:
        for name in [name for name in reduced if name not in _NO_ATTRIBUTES]:
            reduced = _with(reduced, name, _attribute(reduced[name], version))
    return reduced


def _attribute(attribute: Any, version: Version) -> Any:
    if isinstance(attribute, list):
        instances = [instance for instance in attribute if isinstance(instance, dict)]
        if version < _ONE_OF_EACH and instances and len(instances) == len(attribute):
            default = next((instance for instance in instances if "datasetId" not in instance), instances[0])
            return _attribute(default, version)
        parts = [_attribute(instance, version) for instance in attribute]
        return attribute if all(new is old for new, old in zip(parts, attribute, strict=True)) else parts
    if not isinstance(attribute, dict):
        return attribute
    reduced = _without(attribute, _ATTRIBUTE_MEMBERS, version)
    for member, (since, instead, kind) in _FALLBACKS.items():
        if version < since and member in reduced:
            reduced = {instead if name == member else name: value for name, value in reduced.items()}
            if member == "objectList" and isinstance(reduced["object"], list):
                reduced["object"] = [_object_of(member_object) for member_object in reduced["object"]]
            if "type" in reduced:
                reduced["type"] = kind
    for name in [name for name in reduced if name not in _OPAQUE]:
        reduced = _with(reduced, name, _attribute(reduced[name], version))
    return reduced


def _object_of(member: Any) -> Any:
    """Return the URI in a member of an objectList."""
    return member.get("object", member) if isinstance(member, dict) else member


def _without(document: dict[str, Any], since: dict[str, Version], version: Version) -> dict[str, Any]:
    """Return the document without members that the version does not have; itself if there are none."""
    late = {name for name, first in since.items() if version < first and name in document}
    return {name: value for name, value in document.items() if name not in late} if late else document


def _with(document: dict[str, Any], name: str, value: Any) -> dict[str, Any]:
    """Return the document with another value of `name`; itself if that is the same."""
    return document if value is document.get(name) else {**document, name: value}
