"""Reads the notification of a source as a change, so that subscribers are notified as of a local one (5.8.6).

A notification has entities as they are, previous values if they were requested, and `urn:ngsi-ld:null` for
what was deleted. For a deleted entity it has the time of deletion and the deleted attributes.
"""

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from services.context_broker.delivery.triggers import EntityChange
from services.context_broker.federation.distribution.fragment_collector import about
from services.context_broker.federation.distribution.fragments import (
    Fragment,
    merged,
    read_fragment,
    without_expired,
)
from services.context_broker.federation.distribution.source_responses import place_of
from services.context_broker.federation.registrations.registration import Registration
from services.context_broker.model.entity import NULL, SAYS, Attributes, Entity, Instance, Terms, dataset_of
from services.context_broker.model.entity_parser import expand

_PREVIOUS: Final = {
    f"previous{says[0].upper()}{says[1:]}": kind for kind, says in reversed(list(SAYS.items()))
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
    before, kept, gone = _split(document, terms)
    fragment = read_fragment(without_expired(kept, time.time()) or kept, terms, place_of(kept))
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
        still = {dataset_of(one) for one in after.attributes.get(name, ())}
        if left := [one for one in instances if dataset_of(one) not in still]:
            was[name] = [*was.get(name, []), *left]
            losses.add(name)
    return EntityChange(
        replace(after, attributes=was), after, updated=frozenset(updated), lost=frozenset(losses)
    )


def _previous_instances(
    now: list[Instance], registered: list[Instance], before: list[Instance]
) -> list[Instance]:
    """Return the previous instances of an attribute where the current ones come from the source."""
    old = {dataset_of(one): one for one in before}
    return [old.get(dataset_of(one), one) if one in registered else one for one in now]


def _split(document: Mapping[str, Any], terms: Terms) -> tuple[Attributes, dict[str, Any], Attributes]:
    """Return previous attributes (where given), the current document, and deleted attributes."""
    before: Attributes = {}
    kept: dict[str, Any] = {}
    gone: Attributes = {}
    for name, said in document.items():
        if name in _NO_ATTRIBUTES:
            if name != "deletedAt":
                kept[name] = said
            continue
        instances = said if isinstance(said, list) and all(isinstance(one, dict) for one in said) else [said]
        iri = expand(name, terms)
        left = []
        for one in instances:
            if (was := _previous_instance(one)) is not None:
                before.setdefault(iri, []).append(was)
            if (lost := _deleted_instance(one, was)) is not None:
                gone.setdefault(iri, []).append(lost)
            else:
                left.append(_current_value(one))
        if left:
            kept[name] = left if isinstance(said, list) and instances is said else left[0]
    for iri in gone.keys() & before.keys():
        stays = {dataset_of(one) for one in gone[iri]}
        before[iri] = [one for one in before[iri] if dataset_of(one) not in stays]
    return {iri: some for iri, some in before.items() if some}, kept, gone


def _previous_instance(said: Any) -> Instance | None:
    if not isinstance(said, Mapping):
        return None
    for member, kind in _PREVIOUS.items():
        if member in said:
            return {"type": _kind(said, kind), SAYS[_kind(said, kind)]: said[member], **_dataset(said)}
    return None


def _kind(said: Mapping[str, Any], kind: str) -> str:
    """Return the type of an instance; a GeoProperty has the same value member as a Property."""
    given = said.get("type")
    return given if isinstance(given, str) and SAYS.get(given) == SAYS[kind] else kind


def _deleted_instance(said: Any, was: Instance | None) -> Instance | None:
    """Return the deleted instance, None if it was not deleted."""
    if said == NULL:
        return {"type": "Property", "value": NULL}
    if not isinstance(said, Mapping):
        return None
    for kind, member in SAYS.items():
        if said.get(member) == NULL or (member == "languageMap" and said.get(member) == {"@none": NULL}):
            found = _kind(said, kind)
            times = {one: said[one] for one in ("createdAt", "modifiedAt") if isinstance(said.get(one), str)}
            return {**(was or {"type": found, SAYS[found]: NULL, **_dataset(said)}), **times}
    return None


def _current_value(said: Any) -> Any:
    if not isinstance(said, Mapping):
        return said
    return {member: value for member, value in said.items() if member not in _PREVIOUS}


def _dataset(said: Mapping[str, Any]) -> dict[str, str]:
    named = said.get("datasetId")
    return {"datasetId": named} if isinstance(named, str) else {}
