"""What writers send, read with care: normalized or concise entities become the form that the broker keeps.

Every fault is a problem that names the attribute, the rule and the way out (clauses 4.5.1 to 4.5.5, 4.5.16).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from services.context_broker.entity import NULL, SAYS, Attributes, Instance, Terms, is_deletion
from services.context_broker.geometry import fault_of, looks_like_geometry
from services.context_broker.problems import bad_request_data, not_supported
from services.context_broker.words import require_name, require_time, require_uri, shown

DEFAULT_INSTANCE: Final = "@none"
"""The datasetId by which a writer or a reader may name the instance that has none."""
DEEPEST = 20
"""Attributes of attributes of attributes … that are read."""

_KIND_OF: Final = {said: kind for kind, said in SAYS.items() if kind != "GeoProperty"}
_KINDS: Final = tuple(SAYS)
_SAYING: Final = frozenset(SAYS.values())
_FROM_THE_BROKER: Final = frozenset(
    {"createdAt", "modifiedAt", "deletedAt", "instanceId", "previousValue", "previousObject",
     "previousLanguageMap", "previousJson", "previousVocab", "previousValueList", "previousObjectList",
     "entity", "entityList"}
)  # fmt: skip
"""Members that only the broker writes; a writer that sends back what it read is not refused."""
METADATA: Final = frozenset(
    {"type", "observedAt", "unitCode", "datasetId", "valueType", "objectType", "lang"}
)
_ENTITY_TIMES: Final = frozenset({"createdAt", "modifiedAt", "deletedAt"})
_LATER: Final = frozenset({"scope", "expiresAt"})


@dataclass(frozen=True, slots=True)
class Change:
    """What a writer said about an entity: its id if given, its types if given, and attributes."""

    id: str | None
    types: tuple[str, ...]
    attributes: Attributes


def read_entity(document: Any, terms: Terms) -> Change:
    """Return a whole entity; raise a problem if it has no id, no type, or tells of deletions."""
    change = read_change(document, terms)
    if change.id is None:
        raise bad_request_data('the entity has no "id"; give it a URI such as urn:ngsi-ld:Task:demo:1')
    if not change.types:
        raise bad_request_data(f'the entity {change.id} has no "type"; name its type, for example "Task"')
    refuse_deletions(change, terms)
    return change


def refuse_deletions(change: Change, terms: Terms) -> None:
    """Raise a problem if a whole entity tells of something to delete."""
    for name, instances in change.attributes.items():
        if any(is_deletion(instance) for instance in instances):
            raise bad_request_data(
                f"attribute {shown(terms.compact(name))} is {NULL}, which only has a meaning in a change; "
                "leave the attribute out"
            )


def read_change(document: Any, terms: Terms) -> Change:
    """Return part of an entity, as append, update and merge take it."""
    if not isinstance(document, Mapping):
        raise bad_request_data(f"an entity is a JSON object, not {shown(document)}")
    entity_id: str | None = None
    types: tuple[str, ...] = ()
    attributes: Attributes = {}
    for name, given in document.items():
        if name in {"id", "@id"}:
            entity_id = require_uri(given, "the entity id")
        elif name in {"type", "@type"}:
            types = read_types(given, terms)
        elif name in _LATER:
            raise not_supported(f'this broker does not keep "{name}" yet; leave it out')
        elif name != "@context" and name not in _ENTITY_TIMES:
            _take_attribute(attributes, name, given, terms, 0)
    return Change(entity_id, types, attributes)


def read_types(given: Any, terms: Terms) -> tuple[str, ...]:
    """Return the IRIs of one type or a list of them."""
    names = given if isinstance(given, list) else [given]
    if not names:
        raise bad_request_data("an entity has at least one type; the list is empty")
    return tuple(dict.fromkeys(expand(require_name(name, "the entity type"), terms) for name in names))


def expand(name: str, terms: Terms) -> str:
    """Return the IRI of `name`; raise a problem if its @context makes no IRI of it."""
    iri = terms.expand(name)
    if ":" not in iri:
        raise bad_request_data(f"the @context makes no IRI of {shown(name)}; map it to one or add a @vocab")
    return iri


def read_attribute(name: str, given: Any, terms: Terms, depth: int = 0) -> list[Instance]:
    """Return the instances of the attribute `name`."""
    if depth > DEEPEST:
        raise bad_request_data(f"attribute {shown(name)} is nested deeper than {DEEPEST} attributes")
    if isinstance(given, list) and _are_instances(given):
        instances = [_read_instance(name, one, terms, depth) for one in given]
        datasets = {instance.get("datasetId") for instance in instances}
        if len(datasets) < len(instances):
            raise bad_request_data(
                f"attribute {shown(name)} has two instances with the same datasetId or without one; "
                'give each its own "datasetId", or put the list into the "value" of one Property'
            )
        return instances
    return [_read_instance(name, given, terms, depth)]


def _take_attribute(into: Attributes, name: str, given: Any, terms: Terms, depth: int) -> None:
    iri = expand(require_name(name, "the attribute name"), terms)
    if iri in into:
        raise bad_request_data(f"attribute {shown(name)} is given twice, once by another name of {iri}")
    into[iri] = read_attribute(name, given, terms, depth)


def _are_instances(given: list[Any]) -> bool:
    return bool(given) and all(
        isinstance(one, dict) and (one.get("type") in _KINDS or "datasetId" in one) for one in given
    )


def _read_instance(name: str, given: Any, terms: Terms, depth: int) -> Instance:
    if not isinstance(given, dict):
        return _plain(name, given)
    kind = _kind(name, given)
    if kind is None:
        if looks_like_geometry(given):
            return _plain(name, given, "GeoProperty")
        return _plain(name, given)
    says = SAYS[kind]
    instance: Instance = {"type": kind}
    below: Attributes = {}
    for member, value in given.items():
        if member == says:
            instance[member] = _SAID[kind](name, value, terms)
        elif member in METADATA:
            if member != "type":
                instance[member] = _metadata(name, member, value, terms)
        elif member in _SAYING:
            raise bad_request_data(f'attribute {shown(name)} is a {kind}: it has "{says}", not "{member}"')
        elif member not in _FROM_THE_BROKER:
            _take_attribute(below, member, value, terms, depth + 1)
    if says not in instance:
        raise bad_request_data(f'attribute {shown(name)} is a {kind} without "{says}"; add it')
    return {**instance, **below} if below else instance


def _plain(name: str, value: Any, kind: str = "Property") -> Instance:
    return {"type": kind, "value": _SAID[kind](name, value, None)}


def _kind(name: str, given: Mapping[str, Any]) -> str | None:
    """Return the kind of an attribute; None when it is a bare value in concise form."""
    kind = given.get("type")
    if isinstance(kind, str) and kind in SAYS:
        return kind
    if kind is not None:
        if looks_like_geometry(given):
            return None
        raise bad_request_data(
            f"attribute {shown(name)} has the type {shown(kind)}, which is no kind of attribute; "
            f'the kinds are {", ".join(SAYS)} (an object that is a value belongs into "value")'
        )
    says = next((member for member in given if member in _KIND_OF), None)
    if says is not None:
        is_place = says == "value" and looks_like_geometry(given["value"])
        return "GeoProperty" if is_place else _KIND_OF[says]
    if not given or not METADATA.isdisjoint(given):
        raise bad_request_data(
            f'attribute {shown(name)} says nothing; give it a "value", an "object" or another of '
            f"{', '.join(sorted(_SAYING))}"
        )
    return None


def _metadata(name: str, member: str, value: Any, terms: Terms) -> Any:
    what = f"{member} of attribute {shown(name)}"
    if member == "observedAt":
        return value if value == NULL else require_time(value, what)
    if member == "datasetId":
        return require_uri(value, what)
    if member == "objectType":
        return [*read_types(value, terms)] if isinstance(value, list) else read_types(value, terms)[0]
    if not isinstance(value, str) or not value:
        raise bad_request_data(f"{what} must be text, not {shown(value)}")
    return value


def _value(name: str, value: Any, _: Terms | None) -> Any:
    if value is None:
        raise bad_request_data(
            f"attribute {shown(name)} is null, which NGSI-LD cannot keep; leave it out, or say {NULL} in a "
            "change to delete it"
        )
    return value


def _object(name: str, value: Any, _: Terms | None) -> Any:
    what = f"the object of relationship {shown(name)}"
    if isinstance(value, list) and value:
        return [require_uri(one, what) for one in value]
    return require_uri(value, what)


def _geometry(name: str, value: Any, _: Terms | None) -> Any:
    fault = None if value == NULL else fault_of(value)
    if fault:
        raise bad_request_data(f"attribute {shown(name)} is a GeoProperty: {fault}")
    return value


def _language_map(name: str, value: Any, _: Terms | None) -> Any:
    if value == NULL:
        return value
    if not isinstance(value, dict) or not value or not all(_is_wording(said) for said in value.values()):
        raise bad_request_data(
            f'the languageMap of {shown(name)} maps language tags to text, for example {{"en": "gripper"}}'
        )
    return value


def _is_wording(said: Any) -> bool:
    return isinstance(said, str) or (isinstance(said, list) and all(isinstance(word, str) for word in said))


def _vocab(name: str, value: Any, terms: Terms | None) -> Any:
    words = value if isinstance(value, list) else [value]
    if not words or not all(isinstance(word, str) and word for word in words):
        raise bad_request_data(f"the vocab of {shown(name)} is a term or a list of terms, not {shown(value)}")
    if terms is None or value == NULL:
        return value
    return [terms.expand(word) for word in words] if isinstance(value, list) else terms.expand(value)


def _value_list(name: str, value: Any, _: Terms | None) -> Any:
    if value != NULL and not isinstance(value, list):
        raise bad_request_data(f"the valueList of {shown(name)} must be a list, not {shown(value)}")
    return value


def _object_list(name: str, value: Any, terms: Terms | None) -> Any:
    if value == NULL:
        return value
    if not isinstance(value, list):
        raise bad_request_data(f"the objectList of {shown(name)} must be a list, not {shown(value)}")
    return [
        {"object": _object(name, one.get("object") if isinstance(one, dict) else one, terms)} for one in value
    ]


_SAID: Final = {
    "Property": _value,
    "Relationship": _object,
    "GeoProperty": _geometry,
    "LanguageProperty": _language_map,
    "JsonProperty": _value,
    "VocabProperty": _vocab,
    "ListProperty": _value_list,
    "ListRelationship": _object_list,
}
