"""Completes changes from the present entity: the kinds of attributes and their values.

A part of an attribute without its value (clauses 5.5.8 and 5.5.12) and bare values of the simplified form
(clause 5.6.17) are incomplete: the present attribute determines what they are.
"""

from collections.abc import Mapping
from typing import Any, Final

from handover_broker.model.entity import NULL, VALUE_MEMBER, Entity, Instance, Terms
from handover_broker.model.entity_parser import (
    DEFAULT_INSTANCE,
    KINDS,
    METADATA,
    VALUE_MEMBERS,
    given_kind,
)
from handover_broker.model.geometry import looks_like_geometry
from handover_broker.model.representation.projection import ENTITY_MEMBERS
from handover_datamodels.forms import bare_instances

_WRAPPED: Final = {"languageMap": "LanguageProperty", "json": "JsonProperty", "vocab": "VocabProperty"}
"""Members that are alone in an object of the simplified form."""


def completed(
    document: Mapping[str, Any], entity: Entity, terms: Terms, language: str | None = None
) -> dict[str, Any]:
    """Return a merge in which each part of an attribute of `entity` has its kind and value.

    A string for a LanguageProperty is its text in `language`.
    """
    result: dict[str, Any] = {}
    for name, attribute in document.items():
        instances = None if _is_member(name) else entity.attributes.get(terms.expand(name))
        if instances is None:
            result[name] = attribute
        elif language is not None and instances[0]["type"] == "LanguageProperty" and _is_wording(attribute):
            result[name] = {"type": "LanguageProperty", "languageMap": {language: attribute}}
        else:
            result[name] = _completed_attribute(attribute, instances, terms)
    return result


def completed_part(part: Mapping[str, Any], instance: Instance) -> dict[str, Any]:
    """Return a part of an attribute with the kind and the value of the present instance."""
    kind = given_kind(part)
    value_member = VALUE_MEMBER[instance["type"]]
    if kind is None and any(member in VALUE_MEMBERS and member != value_member for member in part):
        return dict(part)
    if kind not in (None, instance["type"]):
        return dict(part)
    values = {} if value_member in part else {value_member: instance[value_member]}
    return {"type": instance["type"], **values, **part}


def instance_for(part: Mapping[str, Any], instances: list[Instance]) -> Instance | None:
    """Return the instance of a part of an attribute, by its datasetId; None if there is none."""
    dataset = part.get("datasetId")
    wanted = None if dataset == DEFAULT_INSTANCE else dataset
    return next((instance for instance in instances if instance.get("datasetId") == wanted), None)


def normalized(
    document: Mapping[str, Any], entity: Entity | None, terms: Terms, language: str | None = None
) -> dict[str, Any]:
    """Return a simplified document in normalized form, each attribute with its kind in `entity`.

    Texts without a language tag are in `language`, or in none.
    """
    attributes = {} if entity is None else entity.attributes
    return {
        name: attribute
        if _is_member(name)
        else _normalized_attribute(attribute, attributes.get(terms.expand(name), []), language)
        for name, attribute in document.items()
    }


def _is_member(name: str) -> bool:
    return name in ENTITY_MEMBERS or name.startswith("@")


def _is_wording(text: Any) -> bool:
    return text != NULL and (
        isinstance(text, str) or (isinstance(text, list) and all(isinstance(text, str) for text in text))
    )


def _completed_attribute(attribute: Any, instances: list[Instance], terms: Terms) -> Any:
    if isinstance(attribute, list) and all(isinstance(instance, dict) for instance in attribute):
        return [_completed_instance(instance, instances, terms) for instance in attribute]
    return _completed_instance(attribute, instances, terms) if isinstance(attribute, dict) else attribute


def _completed_instance(part: dict[str, Any], instances: list[Instance], terms: Terms) -> dict[str, Any]:
    was = instance_for(part, instances)
    if was is None:
        return part
    kind = given_kind(part)
    if VALUE_MEMBERS.isdisjoint(part):
        if kind not in KINDS and (kind is not None or METADATA.isdisjoint(part)):
            return part  # a bare value that is an object
        part = completed_part(part, was)
    if kind not in (None, was["type"]):
        return part
    return {
        member: value
        if member in METADATA or member in VALUE_MEMBERS or member.startswith("@")
        else _completed_attribute(value, was.get(terms.expand(member), []), terms)
        for member, value in part.items()
    }


def _normalized_attribute(attribute: Any, instances: list[Instance], language: str | None) -> Any:
    by_dataset = bare_instances(attribute)
    if by_dataset is not None:
        return [
            {**_normalized_instance(value, _kind_in(instances, dataset), language), "datasetId": dataset}
            for dataset, value in by_dataset.items()
        ]
    return _normalized_instance(attribute, _kind_in(instances, DEFAULT_INSTANCE), language)


def _kind_in(instances: list[Instance], dataset: str) -> str | None:
    kinds = {instance.get("datasetId", DEFAULT_INSTANCE): str(instance["type"]) for instance in instances}
    return kinds.get(dataset, next(iter(kinds.values()), None))


def _normalized_instance(value: Any, kind: str | None, language: str | None) -> dict[str, Any]:
    if isinstance(value, dict) and len(value) == 1:
        (member,) = value
        if member in _WRAPPED and kind in {None, _WRAPPED[member]}:
            return {"type": _WRAPPED[member], member: value[member]}
    if kind is None:
        kind = "GeoProperty" if looks_like_geometry(value) else "Property"
    if kind == "LanguageProperty" and _is_wording(value):
        return {"type": kind, "languageMap": {language or DEFAULT_INSTANCE: value}}
    return {"type": kind, VALUE_MEMBER[kind]: value}
