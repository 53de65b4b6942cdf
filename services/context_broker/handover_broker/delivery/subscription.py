"""Subscriptions: which changes are notified, where and how (clauses 5.2.12 to 5.2.15).

A `Subscription` is a stored document (see `subscription_documents.py`), compiled for matching.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import orjson

from handover_broker.delivery.endpoint import GEO_JSON, JSON, JSON_LD, Endpoint, endpoint
from handover_broker.delivery.triggers import EntityChange, Triggers, read_kinds
from handover_broker.model.context import Context
from handover_broker.model.entity import Entity
from handover_broker.model.entity_parser import expand
from handover_broker.model.negotiation import Version, version_of
from handover_broker.model.owner import Owner
from handover_broker.model.problems import bad_request_data
from handover_broker.model.representation.language import preferences
from handover_broker.model.representation.projection import Projection, read_projection
from handover_broker.model.representation.rendering import Form, View
from handover_broker.model.validation import moment, require_time, require_uri, shown
from handover_broker.query.earlier_names import renamed, with_earlier_names
from handover_broker.query.entity_selector import EntitySelector, entity_selector
from handover_broker.query.geo_query import GeoQuery, geo_query_document
from handover_broker.query.linked import Join, check_depth, join_of
from handover_broker.query.q_match import Lookup, no_lookup
from handover_broker.query.scope_query import ScopeQuery, scope_query
from handover_broker.query.selection import Query, compiled

__all__ = ["GEO_JSON", "JSON", "JSON_LD", "Counts", "Endpoint", "Subscription", "subscription"]

MAX_SELECTORS: Final = 1000
"""Maximum entity selectors of one subscription: each is tried on each change of its types."""
_FORMS: Final = {
    "normalized": Form.NORMALIZED,
    "concise": Form.CONCISE,
    "keyValues": Form.KEY_VALUES,
    "simplified": Form.KEY_VALUES,
}


@dataclass(slots=True)
class Counts:
    """Statistics of the notifications of one subscription; times as text.

    `sent` counts notifications with at least one attempt; `failed` counts attempts, and what was dropped
    before any.
    """

    sent: int = 0
    failed: int = 0
    last_notification: str | None = None
    last_success: str | None = None
    last_failure: str | None = None

    def stored(self) -> bytes:
        """Return the document for the journal."""
        return orjson.dumps(
            {
                "sent": self.sent,
                "failed": self.failed,
                "lastNotification": self.last_notification,
                "lastSuccess": self.last_success,
                "lastFailure": self.last_failure,
            }
        )

    @classmethod
    def restored(cls, stored: bytes) -> "Counts":
        """Return the counts of a stored document."""
        fields = orjson.loads(stored)
        return cls(
            fields["sent"],
            fields["failed"],
            fields["lastNotification"],
            fields["lastSuccess"],
            fields["lastFailure"],
        )

    def reset(self) -> None:
        """Count from the start."""
        self.sent = self.failed = 0
        self.last_notification = self.last_success = self.last_failure = None

    def members(self) -> dict[str, Any]:
        """Return the counts as members of `notification`; none before the first attempt."""
        if not (self.sent or self.failed):
            return {}
        members = {
            "timesSent": self.sent,
            "timesFailed": self.failed,
            "lastNotification": self.last_notification,
            "lastSuccess": self.last_success,
            "lastFailure": self.last_failure,
        }
        return {name: value for name, value in members.items() if value is not None}

    def status(self) -> str | None:
        """Return the result of the last attempt: ok, failed, or None before the first."""
        if self.last_notification is None:
            return None
        return "failed" if (self.last_failure or "") > (self.last_success or "") else "ok"


@dataclass(slots=True, eq=False)
class Subscription:
    """A compiled subscription. `document` is what is stored, with expanded names.

    Notifications use `context`; the names that the subscriber wrote are those of `names`. `interval_s` is set
    for a periodic subscription, `expires_s` (seconds since 1970) for one that expires. `join` adds linked
    entities, `version` makes notifications conform to an earlier version of the standard. The right of the
    `owner` decides what is sent; it is None in subscriptions that were stored before owners were recorded.
    """

    id: str
    document: dict[str, Any]
    context: Context
    names: Context
    selectors: tuple[EntitySelector, ...]
    triggers: Triggers
    view: View
    endpoint: Endpoint
    query: Query | None = None
    places: GeoQuery | None = None
    scopes: ScopeQuery | None = None
    throttling_s: float = 0.0
    interval_s: float | None = None
    expires_s: float = math.inf
    is_on: bool = True
    shows_changes: bool = False
    join: Join | None = None
    version: Version | None = None
    owner: Owner | None = None
    counts: Counts = field(default_factory=Counts)

    def is_active(self, now_s: float) -> bool:
        """Return whether it is active now."""
        return self.is_on and now_s < self.expires_s

    def status(self, now_s: float) -> str:
        """Return active, paused or expired."""
        if now_s >= self.expires_s:
            return "expired"
        return "active" if self.is_on else "paused"

    def selects(self, entity: Entity, lookup: Lookup = no_lookup) -> bool:
        """Return whether it selects an entity; `lookup` finds linked entities."""
        selectors = self.selectors
        if len(selectors) == 1:  # as in nearly all subscriptions
            return selectors[0].wants(entity) and self.admits(entity, lookup)
        return (not selectors or any(selector.wants(entity) for selector in selectors)) and self.admits(
            entity, lookup
        )

    def admits(self, entity: Entity, lookup: Lookup = no_lookup) -> bool:
        """Return whether an entity matches by its attributes, geometry and scopes."""
        return (
            (self.query is None or self.query.holds(entity, lookup))
            and (self.scopes is None or self.scopes.wants(entity.scopes))
            and (self.places is None or self.places.wants(entity))
        )

    def wants(self, change: EntityChange, now_s: float, lookup: Lookup = no_lookup) -> bool:
        """Return whether a change is to be notified; `lookup` finds linked entities."""
        return self.triggers.match(change) and self.is_active(now_s) and self.selects(change.entity, lookup)


def subscription(document: dict[str, Any], context: Context, names: Context | None = None) -> Subscription:
    """Return the compiled subscription of a stored document; raises a problem that names what cannot be used.

    `names` is the context of the names in the document, if it differs from that of notifications.
    """
    names = names or context
    kind = _only_type(document.get("entities"))
    read_in = with_earlier_names(names, kind)
    entities, watched = document.get("entities"), document.get("watchedAttributes")
    if entities is None and watched is None and document.get("localOnly") is not True:
        raise bad_request_data(
            'a subscription has "entities" or "watchedAttributes" or both, unless it has "localOnly": true; '
            "add one of them"
        )
    if entities is not None and (not isinstance(entities, list) or not 0 < len(entities) <= MAX_SELECTORS):
        raise bad_request_data(
            f'"entities" is a list of 1 to {MAX_SELECTORS} selectors such as {{"type": "Task"}}'
        )
    notification = document.get("notification")
    if not isinstance(notification, dict):
        raise bad_request_data('a subscription has a "notification" with an "endpoint"; add it')
    _check_plain_members(document)
    view = _view(document, notification, read_in, kind)
    shows_changes = _flag(notification, "showChanges", default=False, what="notification.showChanges")
    if shows_changes and view.form is Form.KEY_VALUES:
        raise bad_request_data(
            "notification.showChanges does not go with the format keyValues; choose normalized or concise"
        )
    expanded, _ = _short_names(document, "expandValues"), _short_names(document, "jsonKeys")
    query = None if "q" not in document else _compiled(document["q"], read_in, expanded)
    if "csf" in document:
        compiled(document["csf"], names, what="csf")
    join = join_of({name: notification.get(name) for name in ("join", "joinLevel")})
    check_depth(join, view.projection, 0)
    return Subscription(
        id=document["id"],
        document=document,
        context=context,
        names=names,
        selectors=tuple(entity_selector(entity) for entity in entities or ()),
        triggers=Triggers(
            read_kinds(document.get("notificationTrigger")),
            None if watched is None else renamed(kind, watched),
        ),
        query=query,
        places=None if "geoQ" not in document else geo_query_document(document["geoQ"], _expanding(names)),
        scopes=None if "scopeQ" not in document else scope_query(document["scopeQ"]),
        view=view,
        endpoint=endpoint(notification.get("endpoint")),
        throttling_s=_seconds(document.get("throttling", 0), '"throttling"'),
        interval_s=_interval(document),
        expires_s=math.inf if "expiresAt" not in document else moment(document["expiresAt"]) or math.inf,
        is_on=_flag(document, "isActive", default=True, what='"isActive"'),
        shows_changes=shows_changes,
        join=join,
        version=_version(document.get("ngsildConformance")),
        owner=Owner.restored(document),
    )


def _check_plain_members(document: Mapping[str, Any]) -> None:
    for name in ("description", "subscriptionName", "jsonldContext", "csf"):
        if name in document and not isinstance(document[name], str):
            raise bad_request_data(f'"{name}" is text, not {shown(document[name])}')
    for name in ("localOnly", "splitEntities"):
        _flag(document, name, default=False, what=f'"{name}"')
    if "expiresAt" in document:
        require_time(document["expiresAt"], '"expiresAt"')


def _compiled(q: Any, context: Context, expanded: frozenset[str]) -> Query:
    if not isinstance(q, str):
        raise bad_request_data(f"q is text, not {shown(q)}")
    return compiled(q, context, expanded)


def _short_names(document: Mapping[str, Any], member: str) -> frozenset[str]:
    listed = document.get(member, [])
    names = listed.split(",") if isinstance(listed, str) else listed
    if not isinstance(names, list) or not all(isinstance(name, str) and name for name in names):
        raise bad_request_data(f'"{member}" is text with names of attributes and commas, not {shown(listed)}')
    return frozenset(names)


def _version(text: Any) -> Version | None:
    version = version_of(text) if isinstance(text, str) else None
    if text is not None and version is None:
        raise bad_request_data(f'"ngsildConformance" is a version such as "1.6", not {shown(text)}')
    return version


def _expanding(context: Context) -> Callable[[str], str]:
    return lambda name: expand(name, context.terms)


def _only_type(entities: Any) -> str | None:
    """Return the type of all entity selectors, None if there are several types or none."""
    if not isinstance(entities, list) or not entities:
        return None
    kinds = [entity.get("type") if isinstance(entity, dict) else None for entity in entities]
    return kinds[0] if isinstance(kinds[0], str) and all(kind == kinds[0] for kind in kinds) else None


def _view(
    document: Mapping[str, Any], notification: Mapping[str, Any], context: Context, kind: str | None
) -> View:
    form = notification.get("format", "normalized")
    if not isinstance(form, str) or form not in _FORMS:
        raise bad_request_data(f"notification.format is one of {', '.join(_FORMS)}, not {shown(form)}")
    attributes = notification.get("attributes")
    projection = _projection(notification, context)
    if attributes is not None and projection is not None:
        raise bad_request_data(
            "notification has attributes as well as pick or omit; pick says all that attributes does"
        )
    lang = document.get("lang")
    if lang is not None and not isinstance(lang, str):
        raise bad_request_data(f"lang is text such as fr,en;q=0.5, not {shown(lang)}")
    return View(
        _FORMS[form],
        _flag(notification, "sysAttrs", default=False, what="notification.sysAttrs"),
        None if attributes is None else renamed(kind, attributes),
        projection,
        None if lang is None else preferences(lang),
        _datasets(document.get("datasetId")),
    )


def _projection(notification: Mapping[str, Any], context: Context) -> Projection | None:
    texts: list[str | None] = []
    for name in ("pick", "omit"):
        members = notification.get(name)
        if members is not None and (
            not isinstance(members, list)
            or not members
            or not all(isinstance(member, str) for member in members)
        ):
            raise bad_request_data(
                f"notification.{name} is a list with at least one name of an attribute or member, "
                f"not {shown(members)}"
            )
        texts.append(None if members is None else ",".join(members))
    return read_projection(texts[0], texts[1], context.terms)


def _datasets(listed: Any) -> frozenset[str | None] | None:
    if listed is None:
        return None
    datasets = listed if isinstance(listed, list) and listed else [listed]
    return frozenset(
        None if dataset == "@none" else require_uri(dataset, "a datasetId") for dataset in datasets
    )


def _interval(document: Mapping[str, Any]) -> float | None:
    if "timeInterval" not in document:
        return None
    for other in ("watchedAttributes", "throttling", "notificationTrigger"):
        if other in document:
            raise bad_request_data(
                f'a subscription with "timeInterval" has no "{other}", which is for changes; leave one out'
            )
    interval_s = _seconds(document["timeInterval"], '"timeInterval"')
    if interval_s < 1:
        raise bad_request_data(f'"timeInterval" is at least 1 second, not {shown(interval_s)}')
    return interval_s


def _flag(document: Mapping[str, Any], name: str, *, default: bool, what: str) -> bool:
    flag = document.get(name, default)
    if not isinstance(flag, bool):
        raise bad_request_data(f"{what} is true or false, not {shown(flag)}")
    return flag


def _seconds(number: Any, what: str) -> float:
    if not isinstance(number, int | float) or isinstance(number, bool) or not 0 <= number < 1e12:
        raise bad_request_data(f"{what} is a number of seconds from 0 on, not {shown(number)}")
    return float(number)
