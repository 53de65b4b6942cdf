"""Parses entities of clients: normalized or concise entities become stored ones.

Every fault is a problem that names the attribute, the rule and the way out (clauses 4.5.1 to 4.5.24, 4.18).
"""

from collections.abc import Mapping
from enum import Enum
from functools import lru_cache
from typing import Any, Final, NamedTuple

from handover.errors import Problem
from handover_broker.model.entity import NULL, VALUE_MEMBER, Attributes, Instance, Terms, is_deletion
from handover_broker.model.geometry import fault_of, looks_like_geometry
from handover_broker.model.nesting import MAX_NESTING, too_deep
from handover_broker.model.problems import bad_request_data
from handover_broker.model.validation import (
    is_time,
    require_future,
    require_name,
    require_scope,
    require_time,
    require_uri,
    shown,
    without_iri,
)
from handover_broker.model.values import SAID

DEFAULT_INSTANCE: Final = "@none"
"""The datasetId that clients may use for the instance without one."""
DEEPEST: Final = 20
"""Maximum depth of sub-attributes."""

KINDS: Final = frozenset(VALUE_MEMBER)
VALUE_MEMBERS: Final = frozenset(VALUE_MEMBER.values())
METADATA: Final = frozenset(
    {"type", "observedAt", "unitCode", "datasetId", "valueType", "objectType", "lang", "expiresAt"}
)
_KIND_OF: Final = {member: kind for kind, member in VALUE_MEMBER.items() if kind != "GeoProperty"}
_TIMES: Final = frozenset({"createdAt", "modifiedAt", "deletedAt"})
_FROM_THE_BROKER: Final = _TIMES | {"instanceId"}
"""Members that only the broker writes; a client may send them back."""
_SAID_BESIDE: Final = METADATA - {"type"}
_NO_ATTRIBUTES: Final = _FROM_THE_BROKER | {"type", "@type"}
_ONLY_SHOWN: Final = frozenset(
    {"previousValue", "previousObject", "previousLanguageMap", "previousJson", "previousVocab",
     "previousValueList", "previousObjectList", "entity", "entityList"}
)  # fmt: skip
"""Members of other representations (clauses 4.5.2.2 and 4.5.3.2)."""
_MISPLACED: Final = VALUE_MEMBERS | _ONLY_SHOWN | {"@context"}
_SEALED: Final = frozenset({"entityIdSealed", "entityTypeSealed"})
_PROOF: Final = "ngsildproof"
_NO_NAMES: Final = (METADATA | VALUE_MEMBERS | _FROM_THE_BROKER | _ONLY_SHOWN | _SEALED) - {
    "type",
    "expiresAt",
    "value",
}
"""Terms of the core context that cannot name an attribute (clause 4.5.1). `value` can nevertheless: the
published Device has an attribute of that name."""
NO_ATTRIBUTES_OF_ENTITIES: Final = (
    _NO_NAMES | _TIMES | {"id", "@id", "type", "@type", "scope", "expiresAt", "@context"}
)
"""Members of an entity that are not attributes."""
NO_SUB_ATTRIBUTES: Final = _NO_ATTRIBUTES | METADATA | _MISPLACED | _SEALED
"""Members of an attribute that are not attributes of it."""
_CORE: Final = "https://uri.etsi.org/ngsi-ld/"
_PLACES: Final = frozenset(
    base + name for base in ("", _CORE) for name in ("location", "observationSpace", "operationSpace")
)
"""Attributes that are GeoProperties by definition (clause 4.7.1); no context can change these names."""
_KINDS_WITH: Final = {
    "unitCode": frozenset({"Property", "GeoProperty", "ListProperty"}),
    "objectType": frozenset({"Relationship", "ListRelationship"}),
    "valueType": KINDS - {"Relationship", "ListRelationship"},
}
_NULL_TEXT: Final = NULL.encode()
_ESCAPE: Final = b"\\u"
"""Characters by which a JSON string may be escaped."""
_LANG_STRING: Final = frozenset({"langString", "rdf:langString"})


class Nulls(Enum):
    """Where a document may contain NULL (clauses 5.2.1 and 5.5.4)."""

    NOWHERE = "nowhere"
    ATTRIBUTES = "attributes"
    VALUES = "values"
    """Also inside the values of Properties, which a merge changes."""


def nulls_in(raw: bytes, allowed: Nulls) -> Nulls:
    """Return `allowed`, or `VALUES` if the JSON text `raw` cannot contain NULL.

    Searching the text is much faster than checking all values, which is skipped then.
    """
    return allowed if _NULL_TEXT in raw or _ESCAPE in raw else Nulls.VALUES


class Change(NamedTuple):
    """A parsed change: the id and the types if given, and attributes.

    `scopes` is None if not given, empty to delete them; `expires_at` is None if not given, NULL to remove it.
    """

    id: str | None
    types: tuple[str, ...]
    attributes: Attributes
    scopes: tuple[str, ...] | None = None
    expires_at: str | None = None


def read_entity(document: Any, terms: Terms, nulls: Nulls = Nulls.NOWHERE) -> Change:
    """Return a whole entity; raise a problem if it has no id or type, or contains NULL."""
    change = read_change(document, terms, nulls)
    if change.id is None:
        raise bad_request_data('the entity has no "id"; give it a URI such as urn:ngsi-ld:Task:demo:1')
    if not change.types:
        raise bad_request_data(f'the entity {change.id} has no "type"; name its type, for example "Task"')
    return change


def read_change(document: Any, terms: Terms, nulls: Nulls = Nulls.VALUES) -> Change:
    """Return a part of an entity, for append, update and merge."""
    if not isinstance(document, dict):
        raise bad_request_data(f"an entity is a JSON object, not {shown(document)}")
    entity_id: str | None = None
    types: tuple[str, ...] = ()
    attributes: Attributes = {}
    scopes: tuple[str, ...] | None = None
    expires_at: str | None = None
    for name, value in document.items():
        if name not in NO_ATTRIBUTES_OF_ENTITIES:
            _take_attribute(attributes, name, value, terms, 0)
        elif name in {"id", "@id"}:
            entity_id = _entity_id(value)
        elif name in {"type", "@type"}:
            types = read_types(value, terms)
        elif name == "scope":
            scopes = _scopes(value, nulls)
        elif name == "expiresAt":
            expires_at = _end(value, "expiresAt of the entity", nulls)
        elif name in _NO_NAMES and name not in _TIMES:
            raise bad_request_data(
                f"{shown(name)} is a term of NGSI-LD and cannot name an attribute; choose another name"
            )
    if nulls is not Nulls.VALUES:
        refuse_nulls(attributes, terms, nulls)
    return Change(entity_id, types, attributes, scopes, expires_at)


def refuse_nulls(attributes: Attributes, terms: Terms, nulls: Nulls) -> None:
    """Raise a problem if attributes contain NULL where `nulls` does not allow it."""
    for name, instances in attributes.items():
        for instance in instances:
            if _reports_null(instance, nulls):
                raise bad_request_data(
                    f"attribute {shown(terms.compact(name))} has {NULL}, which only has a meaning where a "
                    "change deletes something, and inside values only in a merge; leave it out"
                )


def _reports_null(instance: Instance, nulls: Nulls) -> bool:
    if nulls is Nulls.NOWHERE:
        if NULL in instance.values():
            return True
    elif is_deletion(instance) or instance["type"] == "LanguageProperty":  # may delete the text of a language
        return False
    for member, value in instance.items():
        if value.__class__ is dict or value.__class__ is list:
            if ":" in member:
                if any(_reports_null(part, nulls) for part in value):
                    return True
            elif member != "json" and _holds_null(value):
                return True
    return False


_PLAIN: Final = frozenset({float, int, str, bool, type(None)})


def _holds_null(value: Any, depth: int = 0) -> bool:
    """Return whether a member of an object in `value` is NULL."""
    if depth > MAX_NESTING:
        raise too_deep()
    if isinstance(value, dict):
        return any(part == NULL or _holds_null(part, depth + 1) for part in value.values())
    if not isinstance(value, list):
        return False
    if depth < MAX_NESTING and _PLAIN.issuperset(map(type, value)):
        return False  # most lists are of numbers, such as a hundred joints of a robot
    return any(_holds_null(part, depth + 1) for part in value)


def read_types(types: Any, terms: Terms) -> tuple[str, ...]:
    """Return the IRIs of one type or a list of types."""
    if types.__class__ is str and types != NULL:
        return (_iri_of(types, "the entity type", terms),)
    names = types if isinstance(types, list) else [types]
    if not names or NULL in names:
        raise bad_request_data("an entity has at least one type; none is given, and none can be deleted")
    return tuple(dict.fromkeys(expand(require_name(name, "the entity type"), terms) for name in names))


def expand(name: str, terms: Terms) -> str:
    """Return the IRI of `name`; raise a problem if its @context does not define one."""
    iri = terms.expand(name)
    if ":" not in iri:
        raise without_iri(name, iri)
    return iri


@lru_cache(maxsize=8192)
def _iri_of(name: str, what: str, terms: Terms) -> str:
    """Return the IRI of a name; cached, because names repeat."""
    return expand(require_name(name, what), terms)


def read_attribute(name: str, attribute: Any, terms: Terms, depth: int = 0) -> list[Instance]:
    """Return the instances of the attribute `name`."""
    if depth > DEEPEST:
        raise bad_request_data(f"attribute {shown(name)} is nested deeper than {DEEPEST} attributes")
    if isinstance(attribute, list) and _are_instances(attribute):
        instances = [_read_instance(name, part, terms, depth) for part in attribute]
        datasets = {instance.get("datasetId") for instance in instances}
        if len(datasets) < len(instances):
            raise bad_request_data(
                f"attribute {shown(name)} has two instances with the same datasetId or without one; "
                'give each its own "datasetId", or put the list into the "value" of one Property'
            )
    else:
        instances = [_read_instance(name, attribute, terms, depth)]
    if name in _PLACES:
        for candidate in instances:
            if candidate["type"] != "GeoProperty" and not is_deletion(candidate):
                raise _no_place(name, candidate)
    return instances


def _no_place(name: str, instance: Instance) -> Problem:
    kind = instance["type"]
    value = instance[VALUE_MEMBER[kind]]
    if kind == "Property" and (fault := fault_of(value)) is not None:
        return bad_request_data(f"attribute {shown(name)} is always a GeoProperty, not a Property: {fault}")
    return bad_request_data(
        f'attribute {shown(name)} is always a GeoProperty, not a {kind}; write "type": "GeoProperty"'
        + ("" if kind == "Property" else ' and give it a geometry as its "value"')
    )


def _entity_id(text: Any) -> str:
    if text == NULL:
        raise bad_request_data(f"{NULL} is no id of an entity; choose another")
    return require_uri(text, "the entity id")


def _scopes(scopes: Any, nulls: Nulls) -> tuple[str, ...]:
    if scopes == NULL and nulls is not Nulls.NOWHERE:
        return ()
    return tuple(
        dict.fromkeys(require_scope(scope) for scope in (scopes if isinstance(scopes, list) else [scopes]))
    )


def _end(text: Any, what: str, nulls: Nulls = Nulls.VALUES) -> str:
    if text == NULL and nulls is not Nulls.NOWHERE:
        return NULL
    return require_future(text, what)


def _take_attribute(into: Attributes, name: str, attribute: Any, terms: Terms, depth: int) -> None:
    iri = _iri_of(name, "the attribute name", terms)
    if iri in into:
        raise bad_request_data(f"attribute {shown(name)} is given twice, once by another name of {iri}")
    into[iri] = read_attribute(name, attribute, terms, depth)


def _are_instances(parts: list[Any]) -> bool:
    return bool(parts) and all(
        isinstance(part, dict) and (given_kind(part) in KINDS or "datasetId" in part) for part in parts
    )


def given_kind(part: Mapping[str, Any]) -> str | None:
    """Return the value member of an attribute by its kind, None if there is none, "" if it is ambiguous."""
    kind = part["type"] if "type" in part else part.get("@type")
    return kind if kind is None or isinstance(kind, str) else ""


def _read_instance(name: str, part: Any, terms: Terms, depth: int) -> Instance:
    if not isinstance(part, dict):
        return _plain(name, part, terms)
    kind = _kind(name, part)
    if kind is None:
        return _plain(name, part, terms, "GeoProperty" if looks_like_geometry(part) else "Property")
    value_member = VALUE_MEMBER[kind]
    instance: Instance = {"type": kind}
    below: Attributes = {}
    for member, value in part.items():
        if member == value_member:
            instance[member] = SAID[kind](name, value, terms)
        elif member in _NO_ATTRIBUTES:
            continue
        elif member in _SAID_BESIDE:
            if member != "datasetId" or value != DEFAULT_INSTANCE:
                instance[member] = _metadata(name, kind, member, value, terms)
        elif member in _MISPLACED:
            raise _misplaced(name, kind, member)
        elif member in _SEALED:
            instance[member] = _sealed(name, member, value, terms)
        else:
            _take_attribute(below, member, value, terms, depth + 1)
    if value_member not in instance:
        raise bad_request_data(f'attribute {shown(name)} is a {kind} without "{value_member}"; add it')
    if name == _PROOF and not (isinstance(instance[value_member], dict) or instance[value_member] == NULL):
        raise bad_request_data(f'"{_PROOF}" has an object as its value: the proof')
    return {**instance, **below} if below else instance


def _misplaced(name: str, kind: str, member: str) -> Problem:
    if member in VALUE_MEMBERS:
        return bad_request_data(
            f'attribute {shown(name)} is a {kind}: it has "{VALUE_MEMBER[kind]}", not "{member}"'
        )
    return bad_request_data(f"attribute {shown(name)} cannot be given {shown(member)}; leave it out")


def _plain(name: str, value: Any, terms: Terms, kind: str = "Property") -> Instance:
    return {"type": kind, "value": SAID[kind](name, value, terms)}


def _kind(name: str, part: Mapping[str, Any]) -> str | None:
    """Return the kind of an attribute; None for a bare value in concise form."""
    kind: str | None = part.get("type")
    if kind.__class__ is str and kind in KINDS:
        return kind
    kind = given_kind(part)
    if kind in KINDS:
        return kind
    if "@value" in part:
        return None
    if kind is not None:
        if looks_like_geometry(part):
            return None
        raise bad_request_data(
            f"attribute {shown(name)} has the type {shown(part.get('type', kind))}, which is no kind of "
            f"attribute; the kinds are {', '.join(VALUE_MEMBER)} (an object that is a value belongs "
            'into "value")'
        )
    value_member = next((member for member in part if member in _KIND_OF), None)
    if value_member is not None:
        is_place = value_member == "value" and looks_like_geometry(part["value"])
        return "GeoProperty" if is_place else _KIND_OF[value_member]
    if not part or not METADATA.isdisjoint(part):
        raise bad_request_data(
            f'attribute {shown(name)} says nothing; give it a "value", an "object" or another of '
            f"{', '.join(sorted(VALUE_MEMBERS))}"
        )
    return None


def _metadata(name: str, kind: str, member: str, value: Any, terms: Terms) -> Any:
    if member == "observedAt" and is_time(value):
        return value
    what = f"{member} of attribute {shown(name)}"
    if member in _KINDS_WITH and kind not in _KINDS_WITH[member]:
        raise bad_request_data(f"attribute {shown(name)} is a {kind}, which has no {member}; leave it out")
    if member == "datasetId":
        if value == NULL:
            raise bad_request_data(f"{what} cannot be deleted; delete the instance and append another")
        return require_uri(value, what)
    return value if value == NULL else _METADATA_READERS[member](value, what, kind, terms)


def _observed_at(value: Any, what: str, _: str, __: Terms) -> str:
    return require_time(value, what)


def _expires_at(value: Any, what: str, _: str, __: Terms) -> str:
    return require_future(value, what)


def _object_type(value: Any, _: str, __: str, terms: Terms) -> Any:
    types = read_types(value, terms)
    return [*types] if isinstance(value, list) else types[0]


def _text(value: Any, what: str, _: str, __: Terms) -> str:
    if not isinstance(value, str) or not value:
        raise bad_request_data(f"{what} must be text, not {shown(value)}")
    return value


def _value_type(value: Any, what: str, kind: str, terms: Terms) -> str:
    text = _text(value, what, kind, terms)
    if kind == "LanguageProperty" and text not in _LANG_STRING:
        raise bad_request_data(f"{what} is langString or left out, not {shown(value)}")
    return terms.expand(text)


_METADATA_READERS: Final = {
    "observedAt": _observed_at,
    "expiresAt": _expires_at,
    "objectType": _object_type,
    "valueType": _value_type,
    "unitCode": _text,
    "lang": _text,
}


def _sealed(name: str, member: str, value: Any, terms: Terms) -> Any:
    if name != _PROOF:
        raise bad_request_data(
            f'attribute {shown(name)} cannot be given {shown(member)}; it belongs to "{_PROOF}"'
        )
    if not isinstance(value, str) or not value:
        raise bad_request_data(f"{member} of {shown(name)} must be text, not {shown(value)}")
    return terms.expand(value) if member == "entityTypeSealed" else value
