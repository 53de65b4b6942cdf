"""The content of notifications: entities after, before or without a change.

Clauses 5.3.1 and 5.8.6. Deleted attributes are `urn:ngsi-ld:null`, in the format of the subscription.
"""

from collections.abc import Iterable
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any, Final
from uuid import uuid4

import orjson

from handover.errors import Problem
from handover.telemetry import get_logger
from handover_broker.delivery.disclosure import taken_headers
from handover_broker.delivery.endpoint import GEO_JSON, JSON_LD
from handover_broker.delivery.subscription import Subscription
from handover_broker.delivery.triggers import (
    ATTRIBUTE_DELETED,
    SCOPE,
    EntityChange,
    lost_instances,
)
from handover_broker.model.context import link_header
from handover_broker.model.entity import NULL, VALUE_MEMBER, Attributes, Entity, Instance, dataset_of
from handover_broker.model.negotiation import Version
from handover_broker.model.representation.rendering import Form, View, render, rendered, with_context
from handover_broker.model.validation import tenant_headers, timestamp, timestamp_now
from handover_broker.query.linked import Shown, joined
from handover_broker.query.q_match import Lookup, no_lookup

log = get_logger(__name__)

_PREVIOUS: Final = {kind: f"previous{member[0].upper()}{member[1:]}" for kind, member in VALUE_MEMBER.items()}


def notification(subscription: Subscription, entities: Iterable[bytes]) -> bytes:
    """Return a notification with `entities`, each a JSON object."""
    head: dict[str, str] = {
        "id": f"urn:ngsi-ld:Notification:{uuid4()}",
        "type": "Notification",
        "subscriptionId": subscription.id,
        "notifiedAt": timestamp_now(),
    }
    accept = subscription.endpoint.accept
    data = b"[" + b",".join(entities) + b"]"
    if accept == GEO_JSON:
        data = b'{"type":"FeatureCollection","features":' + data + b"}"
        if not _prefers_plain_json(subscription):
            data = with_context(data, subscription.context)
    if subscription.version is not None:
        data = _conformed(data, subscription.version, subscription.view)
    body = orjson.dumps(head)[:-1] + b',"data":' + data + b"}"
    return with_context(body, subscription.context) if accept == JSON_LD else body


def _conformed(data: bytes, version: Version, view: View) -> bytes:
    """Return data in the form of an earlier version of NGSI-LD (clause 4.3.6.8)."""
    from handover_broker.model.representation import conformance  # noqa: PLC0415 - few ask for another version

    simplified = view.form is Form.KEY_VALUES
    return orjson.dumps(conformance.conformed(orjson.loads(data), version, simplified=simplified))


def entity_data(subscription: Subscription, entity: Entity, lookup: Lookup = no_lookup) -> bytes:
    """Return the present state of an entity for a subscriber: JSON objects separated by commas.

    There is one object, or more with linked entities, which `lookup` finds.
    """
    if subscription.join is None and subscription.endpoint.accept != GEO_JSON:
        return rendered(entity, subscription.context, subscription.view)
    return _written(subscription, _documents(subscription, entity, lookup))


def change_data(subscription: Subscription, change: EntityChange, lookup: Lookup = no_lookup) -> bytes:
    """Return the change of one entity for a subscriber, in the form of `entity_data`."""
    after = change.after
    if after is not None and not subscription.shows_changes:
        gone = change.lost if subscription.triggers.reports_deletions else frozenset()
        if not gone:
            return entity_data(subscription, after, lookup)
    deleted_at = timestamp(datetime.now(UTC))
    entity = _with_changes(subscription, change, deleted_at)
    documents = _documents(subscription, entity, lookup if after is not None else no_lookup)
    if after is None:
        documents[0] = (entity, _with_end(documents[0][1], subscription.view, deleted_at))
    elif SCOPE in change.lost and subscription.triggers.reports_deletions:
        documents[0] = (entity, _without_scope(documents[0][1], subscription.view))
    return _written(subscription, documents)


def headers(subscription: Subscription, tenant: str, taken: bytes | None = None) -> list[tuple[str, str]]:
    """Return the headers of a notification; those in `taken` (JSON) are copied from the request that made
    the change."""
    endpoint = subscription.endpoint
    own = [*endpoint.headers, *taken_headers(taken)]
    own_names = {name.lower() for name, _ in own}
    result = [("Content-Type", endpoint.accept)]
    if tenant:
        result += [header for header in tenant_headers(tenant) if header[0].lower() not in own_names]
    if endpoint.accept != JSON_LD and subscription.context.link and "link" not in own_names:
        result.append(("Link", link_header(subscription.context.link)))
    return [*result, *((name, value) for name, value in own)]


def mqtt_message(subscription: Subscription, tenant: str, body: bytes, taken: bytes | None) -> bytes:
    """Return a notification as an MQTT message: the HTTP headers are in `metadata`."""
    metadata = dict(headers(subscription, tenant, taken))
    return b'{"metadata":' + orjson.dumps(metadata) + b',"body":' + body + b"}"


def _documents(subscription: Subscription, entity: Entity, lookup: Lookup) -> list[Shown]:
    """Return an entity in the form of the subscription, with its linked entities if they are asked for."""
    terms, view, join = subscription.context.terms, subscription.view, subscription.join
    if join is not None:
        try:
            return joined([entity], terms, view, join, lookup)
        except Problem as problem:  # too many links: the entity itself is sent without them
            log.warning("linked entities are left out", subscription=subscription.id, why=problem.detail)
    return [(entity, render(entity, terms, view))]


def _written(subscription: Subscription, documents: list[Shown]) -> bytes:
    if subscription.endpoint.accept != GEO_JSON:
        return b",".join(orjson.dumps(document) for _, document in documents)
    from handover_broker.model.representation import geojson  # noqa: PLC0415 - it knows requests, which know of us

    place, datasets = subscription.context.terms.expand(geojson.LOCATION), subscription.view.datasets
    return b",".join(
        orjson.dumps(geojson.feature_of(document, geojson.geometry(entity, place, datasets)))
        for entity, document in documents
    )


def _prefers_plain_json(subscription: Subscription) -> bool:
    """Return whether the subscriber of GeoJSON asks for a body without @context (clause 5.3.1)."""
    return any(
        name.lower() == "prefer" and value.replace(" ", "") == "body=json"
        for name, value in subscription.endpoint.headers
    )


def _with_changes(subscription: Subscription, change: EntityChange, deleted_at: str) -> Entity:
    """Return the entity with its deleted attributes, and with previous values if the subscription shows
    them."""
    entity, shows, view = change.entity, subscription.shows_changes, subscription.view
    attributes = dict(change.after.attributes) if change.after is not None else {}
    if change.before is not None:
        old = change.before.attributes
        if shows:
            for name in change.updated.intersection(old):  # scopes have no member for a previous value
                attributes[name] = _with_previous(attributes[name], old[name])
        if _reports_deletions(subscription, change):
            watched = subscription.triggers.watched if change.after is None else None
            for name in change.lost.intersection(old):
                if watched is None or name in watched:
                    _add_gone(attributes, name, old[name], view, deleted_at, shows=shows)
    return replace(entity, attributes=attributes, rendered={})


def _with_end(document: dict[str, Any], view: View, deleted_at: str) -> dict[str, Any]:
    if view.projection is not None and not view.projection.wants("deletedAt"):
        return document
    head: dict[str, Any] = {member: document[member] for member in ("id", "type") if member in document}
    return {**head, "deletedAt": deleted_at, **document}


def _without_scope(document: dict[str, Any], view: View) -> dict[str, Any]:
    if view.projection is not None and not view.projection.wants("scope"):
        return document
    return {**document, "scope": NULL}


def _reports_deletions(subscription: Subscription, change: EntityChange) -> bool:
    """Return whether deleted attributes are listed; those of a deleted entity only if that was asked for."""
    if change.after is None and subscription.shows_changes:
        return True
    return ATTRIBUTE_DELETED in subscription.triggers.kinds


def _with_previous(new: list[Instance], old: list[Instance]) -> list[Instance]:
    before = {dataset_of(instance): instance for instance in old}
    return [
        instance
        if (was := before.get(dataset_of(instance))) is None or was is instance
        else {**instance, _PREVIOUS[was["type"]]: was[VALUE_MEMBER[was["type"]]]}
        for instance in new
    ]


def _add_gone(
    attributes: Attributes, name: str, old: list[Instance], view: View, deleted_at: str, *, shows: bool
) -> None:
    instances = attributes.get(name, [])
    gone = [_gone(instance, view, deleted_at, shows=shows) for instance in lost_instances(old, instances)]
    attributes[name] = [*instances, *gone]


def _gone(instance: Instance, view: View, deleted_at: str, *, shows: bool) -> Instance:
    kind = instance["type"] if view.form is not Form.KEY_VALUES else "Property"
    gone: Instance = {
        "type": kind,
        VALUE_MEMBER[kind]: {"@none": NULL} if kind == "LanguageProperty" else NULL,
    }
    if shows:
        gone[_PREVIOUS[kind]] = instance[VALUE_MEMBER[instance["type"]]]
    for member in ("datasetId", "createdAt", "modifiedAt"):
        if member in instance:
            gone[member] = instance[member]
    gone["deletedAt"] = deleted_at
    return gone
