"""Renders entities for clients: in a form, with names, members and languages as requested.

Forms of clauses 4.5.1 to 4.5.25: normalized, concise and simplified (keyValues).
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import orjson

from handover_broker.model.context import Context
from handover_broker.model.entity import VALUE_MEMBER, Attributes, Entity, Instance, Terms
from handover_broker.model.entity_parser import NO_ATTRIBUTES_OF_ENTITIES, NO_SUB_ATTRIBUTES
from handover_broker.model.geometry import looks_like_geometry
from handover_broker.model.representation.language import in_language
from handover_broker.model.representation.projection import Projection

FORMS_KEPT = 4
"""Rendered forms that are cached with an entity."""

_TIMES = frozenset({"createdAt", "modifiedAt", "deletedAt", "expiresAt"})
_TERM_MEMBERS = ("objectType", "valueType", "entityTypeSealed", "previousVocab")


class Form(StrEnum):
    """A representation of an entity."""

    NORMALIZED = "normalized"
    CONCISE = "concise"
    KEY_VALUES = "keyValues"


@dataclass(frozen=True, slots=True)
class View:
    """How a client requests entities; None does not limit or change anything.

    `attributes` (IRIs) are those of `attrs`, `projection` is that of `pick` and `omit`, `languages` are the
    ranges of `lang`, best first, `datasets` the requested instances by datasetId, with None for the default
    one.
    """

    form: Form = Form.NORMALIZED
    sys_attrs: bool = False
    attributes: frozenset[str] | None = None
    projection: Projection | None = None
    languages: tuple[str, ...] | None = None
    datasets: frozenset[str | None] | None = None

    @property
    def is_whole(self) -> bool:
        """Return whether the whole entity is requested."""
        return (
            self.attributes is None
            and self.projection is None
            and self.languages is None
            and self.datasets is None
        )


def rendered(entity: Entity, context: Context, view: View) -> bytes:
    """Return the entity as JSON text; frequent forms are cached with the entity."""
    if not view.is_whole:
        return orjson.dumps(render(entity, context.terms, view))
    key = (context.key, view.form, view.sys_attrs)
    text = entity.rendered.get(key)
    if text is None:
        if len(entity.rendered) >= FORMS_KEPT:
            entity.rendered.clear()
        # A copy: the bytes of orjson keep their buffer of 4 KB.
        text = entity.rendered[key] = bytes(memoryview(orjson.dumps(render(entity, context.terms, view))))
    return text


def with_context(text: bytes, context: Context) -> bytes:
    """Return the JSON object `text` with the @context of the client in front."""
    return b'{"@context":' + context.text + (b"," if text != b"{}" else b"") + text[1:]


def render(entity: Entity, terms: Terms, view: View) -> dict[str, Any]:
    """Return the entity as a JSON object."""
    compact = terms.compact
    types = [compact(kind) for kind in entity.types]
    result: dict[str, Any] = {"id": entity.id, "type": types[0] if len(types) == 1 else types}
    if entity.scopes:
        result["scope"] = entity.scopes[0] if len(entity.scopes) == 1 else list(entity.scopes)
    if view.sys_attrs:
        if entity.expires_at is not None:
            result["expiresAt"] = entity.expires_at
        result["createdAt"] = entity.created_at
        result["modifiedAt"] = entity.modified_at
    attributes = entity.attributes
    if not view.is_whole:
        attributes = _wanted(attributes, view)
        if (projection := view.projection) is not None:
            result = {member: value for member, value in result.items() if projection.wants(member)}
    write = _WRITERS[view.form]
    for name, instances in attributes.items():
        result[_named(name, terms, NO_ATTRIBUTES_OF_ENTITIES)] = write(instances, terms, view.sys_attrs)
    return result


def _named(iri: str, terms: Terms, reserved: frozenset[str]) -> str:
    """Return the name of an attribute for a client: its IRI, if the short name is that of a member."""
    name = terms.compact(iri)
    return iri if name in reserved else name


def written(instance: Instance, terms: Terms, form: Form, *, sys_attrs: bool) -> Any:
    """Return one instance of an attribute in a form."""
    return _WRITERS[form]([instance], terms, sys_attrs)


def _wanted(attributes: Attributes, view: View) -> Attributes:
    """Return the requested attributes and instances, in the requested language."""
    chosen, projection, datasets, languages = view.attributes, view.projection, view.datasets, view.languages
    result: Attributes = {}
    for name, instances in attributes.items():
        if (chosen is not None and name not in chosen) or not (projection is None or projection.wants(name)):
            continue
        shown = instances
        if datasets is not None:
            shown = [instance for instance in shown if instance.get("datasetId") in datasets]
        if languages is not None:
            shown = [in_language(instance, languages) for instance in shown]
        if shown:
            result[name] = shown
    return result


def _normalized(instances: list[Instance], terms: Terms, sys_attrs: bool) -> Any:
    written = [_normalized_instance(instance, terms, sys_attrs) for instance in instances]
    return written[0] if len(written) == 1 else written


def _normalized_instance(instance: Instance, terms: Terms, sys_attrs: bool) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for member, value in instance.items():
        if ":" in member:
            result[_named(member, terms, NO_SUB_ATTRIBUTES)] = _normalized(value, terms, sys_attrs)
        elif sys_attrs or member not in _TIMES:
            result[member] = value
    _use_terms(result, instance["type"], terms)
    return result


def _use_terms(written: dict[str, Any], kind: str, terms: Terms) -> None:
    """Compact members whose values are terms, with the names of the client."""
    if kind == "VocabProperty":
        written["vocab"] = _compacted(written["vocab"], terms)
    for member in _TERM_MEMBERS:
        if member in written:
            written[member] = _compacted(written[member], terms)


def _compacted(value: Any, terms: Terms) -> Any:
    return [terms.compact(word) for word in value] if isinstance(value, list) else terms.compact(value)


def _concise(instances: list[Instance], terms: Terms, sys_attrs: bool) -> Any:
    if len(instances) > 1:  # instances keep their type, or the list could be the value of a Property
        return [{"type": part["type"], **_concise_members(part, terms, sys_attrs)} for part in instances]
    instance = instances[0]
    kind = instance["type"]
    members = _concise_members(instance, terms, sys_attrs)
    if len(members) == 1 and kind in {"Property", "GeoProperty"}:
        value = members["value"]
        if kind == "GeoProperty" or not isinstance(value, dict | list):
            return value
    needs_type = kind == "Property" and looks_like_geometry(members["value"])
    return {"type": kind, **members} if needs_type else members


def _concise_members(instance: Instance, terms: Terms, sys_attrs: bool) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for member, value in instance.items():
        if ":" in member:
            result[_named(member, terms, NO_SUB_ATTRIBUTES)] = _concise(value, terms, sys_attrs)
        elif member != "type" and (sys_attrs or member not in _TIMES):
            result[member] = value
    _use_terms(result, instance["type"], terms)
    return result


def _key_values(instances: list[Instance], terms: Terms, _: bool) -> Any:
    if len(instances) == 1:
        return _bare(instances[0], terms)
    return {"dataset": {instance.get("datasetId", "@none"): _bare(instance, terms) for instance in instances}}


def _bare(instance: Instance, terms: Terms) -> Any:
    kind = instance["type"]
    value = instance[VALUE_MEMBER[kind]]
    if kind == "VocabProperty":
        return {"vocab": _compacted(value, terms)}
    if kind in {"LanguageProperty", "JsonProperty"}:
        return {VALUE_MEMBER[kind]: value}
    if kind == "ListRelationship":
        return [part["object"] for part in value]
    return value


_WRITERS = {Form.NORMALIZED: _normalized, Form.CONCISE: _concise, Form.KEY_VALUES: _key_values}
