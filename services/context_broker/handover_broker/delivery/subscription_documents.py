"""Subscriptions as documents: received, stored, changed and shown (clauses 5.2.12, 5.8.1 and 5.8.2)."""

import time
from collections.abc import Mapping
from typing import Any, Final

from handover_broker.delivery.subscription import Subscription
from handover_broker.model.context import Context
from handover_broker.model.entity_parser import expand
from handover_broker.model.owner import OWNER
from handover_broker.model.problems import bad_request_data
from handover_broker.model.secrets import hidden_members, kept_members
from handover_broker.model.stored_documents import refuse_null, without_null
from handover_broker.model.validation import moment, require_name, shown
from handover_broker.query.parameters import Use, members_for
from handover_broker.query.q_grammar import readable
from handover_broker.query.type_selection import type_selection

NAMES_IN: Final = "namesIn"
"""In a stored document: the @context of the names in `q`, `geoQ`, `pick` and `omit`, if notifications use
another one."""

CAME_BY: Final = "cameBy"
"""In a stored document: the Via header of its request, which prevents forwarding in circles."""

_KNOWN: Final = frozenset(
    {"id", "type", "subscriptionName", "description", "entities", "watchedAttributes", "notificationTrigger",
     "timeInterval", "isActive", "expiresAt", "throttling", "localOnly", "notification", "jsonldContext",
     "@context", "ngsildConformance"}
) | members_for(Use.SUBSCRIPTION)  # fmt: skip
_KNOWN_IN_NOTIFICATION: Final = frozenset(
    {"attributes", "pick", "omit", "format", "sysAttrs", "showChanges", "join", "joinLevel", "endpoint"}
)
_COUNTED: Final = frozenset(
    {"status", "timesSent", "timesFailed", "lastNotification", "lastSuccess", "lastFailure"}
)
_FROM_THE_BROKER: Final = frozenset({"createdAt", "modifiedAt", "deletedAt"}) | _COUNTED
"""Members that only the broker writes; a subscriber may send them back."""
_ENDPOINT: Final = ("uri", "receiverInfo", "notifierInfo")
"""Where an endpoint has secrets: its address first."""


def kept_document(
    subscription: Any, context: Context, extra: frozenset[str] = frozenset(), *, is_change: bool = False
) -> dict[str, Any]:
    """Return the document to store for a subscription, or a part of one: its names are expanded.

    `extra` are additional members that are allowed. A change may have null, which deletes a member.
    """
    if not isinstance(subscription, dict):
        raise bad_request_data(f"a subscription is a JSON object, not {shown(subscription)}")
    if subscription.get("type", "Subscription") != "Subscription":
        raise bad_request_data(
            f'the type of a subscription is "Subscription", not {shown(subscription["type"])}'
        )
    refuse_null(subscription, "a subscription", deleting=2 if is_change else 0)
    members = _KNOWN | extra
    if "temporalQ" in subscription and "temporalQ" not in extra:
        raise bad_request_data(
            '"temporalQ" chooses context sources and has its place in their subscriptions only; leave it out'
        )
    for name in subscription:
        if name not in members and name not in _FROM_THE_BROKER:
            raise bad_request_data(f"a subscription has no member {shown(name)}; leave it out")
    document = {
        name: value
        for name, value in subscription.items()
        if name in members and name not in {"@context", "type"}
    }
    ends_s = moment(document["expiresAt"]) if isinstance(document.get("expiresAt"), str) else None
    if ends_s is not None and ends_s <= time.time():
        raise bad_request_data(f'"expiresAt" {document["expiresAt"]} is over; give a time to come')
    if isinstance(document.get("entities"), list):
        document["entities"] = [_kept_selector(selector, context) for selector in document["entities"]]
    if document.get("watchedAttributes") is not None:
        document["watchedAttributes"] = _names(document["watchedAttributes"], "watchedAttributes", context)
    for name in ("q", "csf"):
        if isinstance(document.get(name), str):
            document[name] = readable(document[name])
    if isinstance(document.get("notification"), dict):
        document["notification"] = _kept_notification(document["notification"], context)
    return document


def refuse_hidden(document: Mapping[str, Any]) -> None:
    """Raise a problem (400) for a new subscription with a placeholder in place of a secret."""
    notification = document.get("notification")
    endpoint = notification.get("endpoint") if isinstance(notification, dict) else None
    if isinstance(endpoint, dict):
        kept_members(endpoint, {}, *_ENDPOINT)


def updated_document(before: Mapping[str, Any], change: Mapping[str, Any]) -> dict[str, Any]:
    """Return the document after a change: members are replaced, null deletes (clause 5.5.8).

    Raises a problem (400) for a notification without an endpoint: a change has to conform to the data type by
    itself (clause 5.8.2.4), so a part of a notification never replaces the whole.
    """
    notification = change.get("notification")
    after = {**before, **change, "id": before["id"]}
    if isinstance(notification, dict):
        if not isinstance(notification.get("endpoint"), dict):
            raise bad_request_data(
                'a change of "notification" replaces all of it and has an "endpoint"; send it complete'
            )
        stored = before["notification"].get("endpoint")
        endpoint = kept_members(
            notification["endpoint"], stored if isinstance(stored, dict) else {}, *_ENDPOINT
        )
        after["notification"] = {**notification, "endpoint": endpoint}
    return without_null(after)


def names_things(change: Mapping[str, Any]) -> bool:
    """Return whether a change contains names, which then are in the context of the change."""
    notification = change.get("notification")
    if isinstance(notification, dict) and not {"pick", "omit", "attributes"}.isdisjoint(notification):
        return True
    return any(name in change for name in ("entities", "watchedAttributes", "q", "geoQ"))


def shown_document(
    subscription: Subscription, context: Context, now_s: float, *, sys_attrs: bool, has_counts: bool = True
) -> dict[str, Any]:
    """Return a subscription for a client, in its names and, unless it may not see them, with the counts."""
    document = {"id": subscription.id, "type": "Subscription", **subscription.document}
    context_document = document.pop("context")
    document.pop(NAMES_IN, None)
    document.pop(CAME_BY, None)
    document.pop(OWNER, None)
    if not sys_attrs:
        document.pop("createdAt", None)
        document.pop("modifiedAt", None)
    compact = context.terms.compact
    if "entities" in document:
        document["entities"] = [
            {**selector, "type": type_selection(selector["type"], str).written(compact)}
            if "type" in selector
            else selector
            for selector in document["entities"]
        ]
    if "watchedAttributes" in document:
        document["watchedAttributes"] = [compact(name) for name in document["watchedAttributes"]]
    notification = {**document["notification"]}
    if has_counts:
        notification |= subscription.counts.members()
    if isinstance(notification.get("endpoint"), dict):
        notification["endpoint"] = hidden_members(notification["endpoint"], *_ENDPOINT)
    if "attributes" in notification:
        notification["attributes"] = [compact(name) for name in notification["attributes"]]
    if has_counts and (status := subscription.counts.status()) is not None:
        notification["status"] = status
    document["status"] = subscription.status(now_s)
    document["notification"] = notification
    named = subscription.context.link or (context_document if isinstance(context_document, str) else None)
    if named is not None:
        document.setdefault("jsonldContext", named)
    return document


def _kept_notification(notified: Mapping[str, Any], context: Context) -> dict[str, Any]:
    for name in notified:
        if name not in _KNOWN_IN_NOTIFICATION and name not in _COUNTED:
            raise bad_request_data(f"notification has no member {shown(name)}; leave it out")
    notification = {name: value for name, value in notified.items() if name not in _COUNTED}
    if notification.get("attributes") is not None:
        notification["attributes"] = _names(notification["attributes"], "notification.attributes", context)
    return notification


def _kept_selector(selector: Any, context: Context) -> dict[str, Any]:
    if not isinstance(selector, dict) or not selector:
        raise bad_request_data(
            f'an entity selector is an object such as {{"type": "Task"}}, not {shown(selector)}'
        )
    if unknown := sorted(set(selector) - {"id", "idPattern", "type"}):
        raise bad_request_data(f"an entity selector has id, idPattern and type, not {shown(unknown[0])}")
    stored = dict(selector)
    if "type" in stored:
        stored["type"] = type_selection(
            stored["type"], context.terms.expand, "the type of an entity selector"
        ).written()
    return stored


def _names(names: Any, what: str, context: Context) -> list[str]:
    if not isinstance(names, list) or not names:
        raise bad_request_data(f"{what} is a list with at least one attribute name, not {shown(names)}")
    return [expand(require_name(name, f"a name in {what}"), context.terms) for name in names]
