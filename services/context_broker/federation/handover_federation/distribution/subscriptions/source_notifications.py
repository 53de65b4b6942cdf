"""Reads the notification of a source as a change, so that subscribers are notified as of a local one (5.8.6).

A notification has entities as they are, previous values if they were requested, and `urn:ngsi-ld:null` for
what was deleted. For a deleted entity it has the time of deletion and the deleted attributes.
"""

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from handover_broker.delivery.triggers import EntityChange
from handover_broker.model.entity import (
    NULL,
    VALUE_MEMBER,
    Attributes,
    Entity,
    Instance,
    Terms,
    dataset_of,
)
from handover_broker.model.entity_parser import expand
from handover_federation.distribution.reads.fragment_collector import about
from handover_federation.distribution.reads.fragments import (
    Fragment,
    merged,
    read_fragment,
    without_expired,
)
from handover_federation.distribution.reads.source_responses import place_of
from handover_federation.registrations.registration import Registration

_PREVIOUS: Final = {
    f"previous{member[0].upper()}{member[1:]}": kind for kind, member in reversed(list(VALUE_MEMBER.items()))
}
"""Members with a previous value, and the type of attribute they belong to."""
_NO_ATTRIBUTES: Final = frozenset(
    {"id", "@id", "type", "@type", "@context", "scope", "expiresAt", "createdAt", "modifiedAt", "deletedAt"}
)


def change_of_notification(
    document: Mapping[str, Any], registration: Registration, own: Entity | None, terms: Terms
) -> EntityChange | None:
    """Return the change of an entity in a notification, as far as the registration covers it; None if it does
    not.

    The entity is merged with the broker's `own` part. Raises a problem (400) for an invalid entity.
    """
    before, current, gone = _split(document, terms)
    fragment = read_fragment(without_expired(current, time.time()) or current, terms, place_of(current))
    registered = about(registration, fragment)
    if registered is None:
        return None
    lost = about(registration, replace(fragment, attributes=gone))
    old = about(registration, replace(fragment, attributes=before))
    assert lost is not None  # noqa: S101 - as the same entity, with other attributes
    assert old is not None  # noqa: S101 - likewise
    if "deletedAt" in document:
        return EntityChange(
            replace(registered, attributes=lost.attributes), None, lost=frozenset(lost.attributes)
        )
    after = registered
    if own is not None:
        after = merged([Fragment(registered, (1, registration.id)), Fragment(own, (0, ""))])
    was, updated = dict(after.attributes), set[str]()
    for name, instances in old.attributes.items():
        was[name] = _previous_instances(
            after.attributes.get(name, []), registered.attributes[name], instances
        )
        updated.add(name)
    losses = set[str]()
    for name, instances in lost.attributes.items():
        still = {dataset_of(attribute) for attribute in after.attributes.get(name, ())}
        if left := [instance for instance in instances if dataset_of(instance) not in still]:
            was[name] = [*was.get(name, []), *left]
            losses.add(name)
    return EntityChange(
        replace(after, attributes=was), after, updated=frozenset(updated), lost=frozenset(losses)
    )


def _previous_instances(
    now: list[Instance], registered: list[Instance], before: list[Instance]
) -> list[Instance]:
    """Return the previous instances of an attribute where the current ones come from the source."""
    old = {dataset_of(instance): instance for instance in before}
    return [
        old.get(dataset_of(instance), instance) if instance in registered else instance for instance in now
    ]


def _split(document: Mapping[str, Any], terms: Terms) -> tuple[Attributes, dict[str, Any], Attributes]:
    """Return previous attributes (where given), the current document, and deleted attributes."""
    before: Attributes = {}
    current: dict[str, Any] = {}
    gone: Attributes = {}
    for name, value in document.items():
        if name in _NO_ATTRIBUTES:
            if name != "deletedAt":
                current[name] = value
            continue
        instances = (
            value if isinstance(value, list) and all(isinstance(part, dict) for part in value) else [value]
        )
        iri = expand(name, terms)
        left = []
        for instance in instances:
            if (was := _previous_instance(instance)) is not None:
                before.setdefault(iri, []).append(was)
            if (lost := _deleted_instance(instance, was)) is not None:
                gone.setdefault(iri, []).append(lost)
            else:
                left.append(_current_value(instance))
        if left:
            current[name] = left if isinstance(value, list) and instances is value else left[0]
    for iri in gone.keys() & before.keys():
        stays = {dataset_of(lost_instance) for lost_instance in gone[iri]}
        before[iri] = [earlier for earlier in before[iri] if dataset_of(earlier) not in stays]
    return {iri: some for iri, some in before.items() if some}, current, gone


def _previous_instance(value: Any) -> Instance | None:
    if not isinstance(value, Mapping):
        return None
    for member, kind in _PREVIOUS.items():
        if member in value:
            return {
                "type": _kind(value, kind),
                VALUE_MEMBER[_kind(value, kind)]: value[member],
                **_dataset(value),
            }
    return None


def _kind(instance: Mapping[str, Any], kind: str) -> str:
    """Return the type of an instance; a GeoProperty has the same value member as a Property."""
    named = instance.get("type")
    return named if isinstance(named, str) and VALUE_MEMBER.get(named) == VALUE_MEMBER[kind] else kind


def _deleted_instance(value: Any, was: Instance | None) -> Instance | None:
    """Return the deleted instance, None if it was not deleted."""
    if value == NULL:
        return {"type": "Property", "value": NULL}
    if not isinstance(value, Mapping):
        return None
    for kind, member in VALUE_MEMBER.items():
        if value.get(member) == NULL or (member == "languageMap" and value.get(member) == {"@none": NULL}):
            shown_kind = _kind(value, kind)
            times = {
                time_member: value[time_member]
                for time_member in ("createdAt", "modifiedAt")
                if isinstance(value.get(time_member), str)
            }
            return {
                **(was or {"type": shown_kind, VALUE_MEMBER[shown_kind]: NULL, **_dataset(value)}),
                **times,
            }
    return None


def _current_value(instance: Any) -> Any:
    if not isinstance(instance, Mapping):
        return instance
    return {member: value for member, value in instance.items() if member not in _PREVIOUS}


def _dataset(instance: Mapping[str, Any]) -> dict[str, str]:
    named = instance.get("datasetId")
    return {"datasetId": named} if isinstance(named, str) else {}
