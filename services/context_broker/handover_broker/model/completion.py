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
    for name, given in document.items():
        instances = None if _is_member(name) else entity.attributes.get(terms.expand(name))
        if instances is None:
            result[name] = given
        elif language is not None and instances[0]["type"] == "LanguageProperty" and _is_wording(given):
            result[name] = {"type": "LanguageProperty", "languageMap": {language: given}}
        else:
            result[name] = _completed_attribute(given, instances, terms)
    return result


def completed_part(given: Mapping[str, Any], instance: Instance) -> dict[str, Any]:
    """Return a part of an attribute with the kind and the value of the present instance."""
    kind = given_kind(given)
    value_member = VALUE_MEMBER[instance["type"]]
    if kind is None and any(member in VALUE_MEMBERS and member != value_member for member in given):
        return dict(given)
    if kind not in (None, instance["type"]):
        return dict(given)
    values = {} if value_member in given else {value_member: instance[value_member]}
    return {"type": instance["type"], **values, **given}


def instance_for(given: Mapping[str, Any], instances: list[Instance]) -> Instance | None:
    """Return the instance of a part of an attribute, by its datasetId; None if there is none."""
    dataset = given.get("datasetId")
    wanted = None if dataset == DEFAULT_INSTANCE else dataset
    return next((instance for instance in instances if instance.get("datasetId") == wanted), None)


def normalized(
    document: Mapping[str, Any], entity: Entity | None, terms: Terms, language: str | None = None
) -> dict[str, Any]:
    """Return a simplified document in normalized form, each attribute with its kind in `entity`.

    Texts without a language tag are in `language`, or in none.
    """
    known = {} if entity is None else entity.attributes
    return {
        name: given
        if _is_member(name)
        else _normalized_attribute(given, known.get(terms.expand(name), []), language)
        for name, given in document.items()
    }


def _is_member(name: str) -> bool:
    return name in ENTITY_MEMBERS or name.startswith("@")


def _is_wording(given: Any) -> bool:
    return given != NULL and (
        isinstance(given, str) or (isinstance(given, list) and all(isinstance(one, str) for one in given))
    )


def _completed_attribute(given: Any, instances: list[Instance], terms: Terms) -> Any:
    if isinstance(given, list) and all(isinstance(one, dict) for one in given):
        return [_completed_instance(one, instances, terms) for one in given]
    return _completed_instance(given, instances, terms) if isinstance(given, dict) else given


def _completed_instance(given: dict[str, Any], instances: list[Instance], terms: Terms) -> dict[str, Any]:
    was = instance_for(given, instances)
    if was is None:
        return given
    kind = given_kind(given)
    if VALUE_MEMBERS.isdisjoint(given):
        if kind not in KINDS and (kind is not None or METADATA.isdisjoint(given)):
            return given  # a bare value that is an object
        given = completed_part(given, was)
    if kind not in (None, was["type"]):
        return given
    return {
        member: value
        if member in METADATA or member in VALUE_MEMBERS or member.startswith("@")
        else _completed_attribute(value, was.get(terms.expand(member), []), terms)
        for member, value in given.items()
    }


def _normalized_attribute(given: Any, instances: list[Instance], language: str | None) -> Any:
    by_dataset = bare_instances(given)
    if by_dataset is not None:
        return [
            {**_normalized_instance(value, _kind_in(instances, dataset), language), "datasetId": dataset}
            for dataset, value in by_dataset.items()
        ]
    return _normalized_instance(given, _kind_in(instances, DEFAULT_INSTANCE), language)


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
