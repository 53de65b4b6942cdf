"""Subscriptions: who wants to be told of which changes, and how (clauses 5.2.12 to 5.2.15, 5.8).

A subscription is kept as its document with names expanded; `Subscription` is that made ready for matching.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final
from urllib.parse import urlsplit

from services.context_broker.contexts import Context
from services.context_broker.entity import Entity
from services.context_broker.intake import expand
from services.context_broker.patterns import pattern
from services.context_broker.problems import bad_request_data, not_supported
from services.context_broker.rendering import Form, View
from services.context_broker.selection import Selection, compiled
from services.context_broker.words import moment, require_name, require_time, require_uri, shown

JSON: Final = "application/json"
JSON_LD: Final = "application/ld+json"
_KNOWN: Final = frozenset(
    {"id", "type", "subscriptionName", "description", "entities", "watchedAttributes", "q", "isActive",
     "expiresAt", "throttling", "notification", "jsonldContext", "@context"}
)  # fmt: skip
_FROM_THE_BROKER: Final = frozenset(
    {"status", "createdAt", "modifiedAt", "timesSent", "timesFailed", "lastNotification", "lastSuccess",
     "lastFailure"}
)  # fmt: skip
_LATER: Final = frozenset(
    {"geoQ", "scopeQ", "csf", "timeInterval", "notificationTrigger", "temporalQ", "lang", "datasetId"}
)
_FORMS: Final = {
    "normalized": Form.NORMALIZED,
    "concise": Form.CONCISE,
    "keyValues": Form.KEY_VALUES,
    "simplified": Form.KEY_VALUES,
}


@dataclass(slots=True)
class Counts:
    """What became of the notifications of one subscription; times as text."""

    sent: int = 0
    failed: int = 0
    last_notification: str | None = None
    last_success: str | None = None
    last_failure: str | None = None

    def members(self) -> dict[str, Any]:
        """Return the counts as members of `notification`."""
        told = {
            "timesSent": self.sent,
            "timesFailed": self.failed,
            "lastNotification": self.last_notification,
            "lastSuccess": self.last_success,
            "lastFailure": self.last_failure,
        }
        return {name: value for name, value in told.items() if value is not None}

    def status(self) -> str | None:
        """Return how the last attempt went: ok, failed, or None before the first."""
        if self.last_notification is None:
            return None
        return "failed" if (self.last_failure or "") > (self.last_success or "") else "ok"


@dataclass(frozen=True, slots=True)
class Endpoint:
    """Where notifications go; `headers` are sent with each, `timeout_s` is the subscriber's own wish."""

    uri: str
    accept: str
    headers: tuple[tuple[str, str], ...]
    timeout_s: float | None


@dataclass(slots=True, eq=False)
class Subscription:
    """A subscription ready for matching. `document` is what is kept, with expanded names."""

    id: str
    document: dict[str, Any]
    context: Context
    selectors: tuple[Selection, ...]
    watched: frozenset[str] | None
    query: Selection
    view: View
    endpoint: Endpoint
    throttling_s: float
    counts: Counts = field(default_factory=Counts)

    def is_active(self, now_s: float) -> bool:
        """Say whether it is to be told of changes now."""
        return self.status(now_s) == "active"

    def status(self, now_s: float) -> str:
        """Return active, paused or expired."""
        expires_s = moment(self.document.get("expiresAt", ""))
        if expires_s is not None and expires_s <= now_s:
            return "expired"
        return "active" if self.document.get("isActive", True) else "paused"

    def wants(self, entity: Entity, touched: frozenset[str], now_s: float) -> bool:
        """Say whether a change of the attributes `touched`, after which `entity` is so, is to be told."""
        return (
            (self.watched is None or not self.watched.isdisjoint(touched))
            and (not self.selectors or any(one.wants(entity) for one in self.selectors))
            and self.is_active(now_s)
            and self.query.wants(entity)
        )


def kept_document(given: Any, context: Context) -> dict[str, Any]:
    """Return the document to keep for a subscription that was sent: its names expanded."""
    if not isinstance(given, dict):
        raise bad_request_data(f"a subscription is a JSON object, not {shown(given)}")
    if given.get("type", "Subscription") != "Subscription":
        raise bad_request_data(f'the type of a subscription is "Subscription", not {shown(given["type"])}')
    for name in given:
        if name in _LATER:
            raise not_supported(f'this broker does not heed "{name}" in a subscription yet; leave it out')
        if name not in _KNOWN and name not in _FROM_THE_BROKER:
            raise bad_request_data(f"a subscription has no member {shown(name)}; leave it out")
    document = {
        name: value for name, value in given.items() if name in _KNOWN and name not in {"@context", "type"}
    }
    if isinstance(document.get("entities"), list):
        document["entities"] = [_kept_selector(one, context) for one in document["entities"]]
    if document.get("watchedAttributes") is not None:
        document["watchedAttributes"] = _names(document["watchedAttributes"], "watchedAttributes", context)
    if isinstance(document.get("notification"), dict):
        notification = dict(document["notification"])
        if notification.get("attributes") is not None:
            notification["attributes"] = _names(
                notification["attributes"], "notification.attributes", context
            )
        document["notification"] = notification
    return document


def updated_document(before: Mapping[str, Any], change: Mapping[str, Any]) -> dict[str, Any]:
    """Return the document after a change: members are replaced, null deletes, `notification` is merged."""
    after = {**before, **change, "id": before["id"]}
    if isinstance(change.get("notification"), dict):
        after["notification"] = _without_null({**before["notification"], **change["notification"]})
    return _without_null(after)


def subscription(document: dict[str, Any], context: Context) -> Subscription:
    """Return a kept document made ready; raises a problem that names what cannot be used."""
    entities, watched = document.get("entities"), document.get("watchedAttributes")
    if entities is None and watched is None:
        raise bad_request_data(
            'a subscription has "entities" or "watchedAttributes" or both; add one of them'
        )
    if entities is not None and (not isinstance(entities, list) or not entities):
        raise bad_request_data('"entities" is a list with at least one selector such as {"type": "Task"}')
    notification = document.get("notification")
    if not isinstance(notification, dict):
        raise bad_request_data('a subscription has a "notification" with an "endpoint"; add it')
    query = document.get("q")
    if query is not None and not isinstance(query, str):
        raise bad_request_data(f"q is text, not {shown(query)}")
    _check_plain_members(document)
    return Subscription(
        id=document["id"],
        document=document,
        context=context,
        selectors=tuple(_selector(one) for one in entities or ()),
        watched=None if watched is None else frozenset(watched),
        query=Selection(query=None if query is None else compiled(query, context)),
        view=_view(notification),
        endpoint=_endpoint(notification.get("endpoint")),
        throttling_s=_seconds(document.get("throttling", 0), '"throttling"'),
    )


def shown_document(one: Subscription, context: Context, now_s: float, *, sys_attrs: bool) -> dict[str, Any]:
    """Return a subscription as a reader gets it, in the reader's names and with its counts."""
    document = {"id": one.id, "type": "Subscription", **one.document}
    context_document = document.pop("context")
    if not sys_attrs:
        document.pop("createdAt", None)
        document.pop("modifiedAt", None)
    compact = context.terms.compact
    if "entities" in document:
        document["entities"] = [
            {**selector, "type": _with_types(selector["type"], compact)} if "type" in selector else selector
            for selector in document["entities"]
        ]
    if "watchedAttributes" in document:
        document["watchedAttributes"] = [compact(name) for name in document["watchedAttributes"]]
    notification = {**document["notification"], **one.counts.members()}
    if "attributes" in notification:
        notification["attributes"] = [compact(name) for name in notification["attributes"]]
    if (status := one.counts.status()) is not None:
        notification["status"] = status
    document.setdefault("isActive", True)
    document["status"] = one.status(now_s)
    document["notification"] = notification
    if isinstance(context_document, str):
        document.setdefault("jsonldContext", context_document)
    return document


def _without_null(document: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in document.items() if value is not None}


def _with_types(kinds: str, compact: Any) -> str:
    return ",".join(compact(kind) for kind in kinds.split(","))


def _kept_selector(given: Any, context: Context) -> dict[str, Any]:
    if not isinstance(given, dict) or not given:
        raise bad_request_data(
            f'an entity selector is an object such as {{"type": "Task"}}, not {shown(given)}'
        )
    if unknown := sorted(set(given) - {"id", "idPattern", "type"}):
        raise bad_request_data(f"an entity selector has id, idPattern and type, not {shown(unknown[0])}")
    kept = dict(given)
    if "type" in kept:
        kept["type"] = ",".join(type_names(kept["type"], context))
    return kept


def type_names(given: Any, context: Context) -> list[str]:
    """Return the IRIs of a type selection: one type, or several of which any will do (`A,B` or `A|B`)."""
    if not isinstance(given, str) or not given:
        raise bad_request_data(f"a type selection is text such as Task,Alert, not {shown(given)}")
    if any(sign in given for sign in ";()"):
        raise not_supported(
            "this broker does not combine types with ; and brackets yet; list them with commas"
        )
    names = given.replace("|", ",").split(",")
    return [expand(require_name(name, "the type"), context.terms) for name in names]


def _names(given: Any, what: str, context: Context) -> list[str]:
    if not isinstance(given, list) or not given:
        raise bad_request_data(f"{what} is a list with at least one attribute name, not {shown(given)}")
    return [expand(require_name(name, f"a name in {what}"), context.terms) for name in given]


def _check_plain_members(document: Mapping[str, Any]) -> None:
    for name in ("description", "subscriptionName", "jsonldContext"):
        if name in document and not isinstance(document[name], str):
            raise bad_request_data(f'"{name}" is text, not {shown(document[name])}')
    if not isinstance(document.get("isActive", True), bool):
        raise bad_request_data(f'"isActive" is true or false, not {shown(document["isActive"])}')
    if "expiresAt" in document:
        require_time(document["expiresAt"], '"expiresAt"')


def _selector(kept: Mapping[str, Any]) -> Selection:
    ids = kept.get("id")
    wanted = kept.get("idPattern")
    if wanted is not None and not isinstance(wanted, str):
        raise bad_request_data(f"idPattern is text, not {shown(wanted)}")
    return Selection(
        ids=None if ids is None else (require_uri(ids, "the id of an entity selector"),),
        id_pattern=None if wanted is None else pattern(wanted),
        types=tuple(kept["type"].split(",")) if "type" in kept else None,
    )


def _view(notification: Mapping[str, Any]) -> View:
    form = notification.get("format", "normalized")
    if not isinstance(form, str) or form not in _FORMS:
        raise bad_request_data(f"notification.format is one of {', '.join(_FORMS)}, not {shown(form)}")
    attributes = notification.get("attributes")
    sys_attrs = notification.get("sysAttrs", False)
    if not isinstance(sys_attrs, bool):
        raise bad_request_data(f"notification.sysAttrs is true or false, not {shown(sys_attrs)}")
    return View(_FORMS[form], sys_attrs, None if attributes is None else frozenset(attributes))


def _endpoint(given: Any) -> Endpoint:
    if not isinstance(given, dict) or "uri" not in given:
        raise bad_request_data('notification.endpoint is an object with a "uri"; add it')
    uri = require_uri(given["uri"], "notification.endpoint.uri")
    if uri.startswith(("mqtt://", "mqtts://")):
        raise not_supported("this broker does not notify over MQTT yet; give an http or https endpoint")
    _check_http(uri)
    accept = given.get("accept", JSON)
    if accept not in (JSON, JSON_LD):
        raise bad_request_data(f"notification.endpoint.accept is {JSON} or {JSON_LD}, not {shown(accept)}")
    timeout_ms = given.get("timeout")
    timeout_s = None if timeout_ms is None else _seconds(timeout_ms, "notification.endpoint.timeout") / 1000
    return Endpoint(uri, accept, tuple(_headers(given.get("receiverInfo", []))), timeout_s or None)


def _check_http(uri: str) -> None:
    try:
        parts = urlsplit(uri)
        usable = parts.scheme in {"http", "https"} and bool(parts.hostname) and parts.port != 0
    except ValueError:
        usable = False
    if not usable or not uri.isascii():
        raise bad_request_data(
            f"notification.endpoint.uri is an address such as http://127.0.0.1:9000/notify, not {shown(uri)}"
        )


def _headers(given: Any) -> list[tuple[str, str]]:
    if not isinstance(given, list):
        raise bad_request_data('receiverInfo is a list of objects such as {"key": "X-Cell", "value": "4"}')
    headers: list[tuple[str, str]] = []
    for pair in given:
        key, value = (pair.get("key"), pair.get("value")) if isinstance(pair, dict) else (None, None)
        if not isinstance(key, str) or not isinstance(value, str):
            raise bad_request_data(f'each receiverInfo has a "key" and a "value" of text, not {shown(pair)}')
        is_token = bool(key) and key.isascii() and key.replace("-", "").replace("_", "").isalnum()
        if not is_token or not (value.isascii() and value.isprintable()):
            raise bad_request_data(
                f"receiverInfo {shown(key)} cannot be an HTTP header; use plain characters"
            )
        headers.append((key, value))
    return headers


def _seconds(given: Any, what: str) -> float:
    if not isinstance(given, int | float) or isinstance(given, bool) or given < 0:
        raise bad_request_data(f"{what} is a number from 0 on, not {shown(given)}")
    return float(given)
