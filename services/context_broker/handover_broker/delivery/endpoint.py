"""Endpoints: where notifications of a subscription are sent, and how (clauses 5.2.15 and 5.2.22)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final
from urllib.parse import urlsplit

from handover_broker.delivery.mqtt_address import MQTT_SCHEMES, MqttAddress, mqtt_address
from handover_broker.model.problems import bad_request_data
from handover_broker.model.secrets import without_secrets
from handover_broker.model.validation import require_uri, shown

JSON: Final = "application/json"
JSON_LD: Final = "application/ld+json"
GEO_JSON: Final = "application/geo+json"
FROM_THE_REQUEST: Final = "urn:ngsi-ld:request"
"""The value of a header that is copied from the request that made the change."""
CREDENTIALS: Final = frozenset({"authorization", "proxy-authorization", "cookie", "x-csrf-token"})
"""Headers of requests that are passed on to nobody while accounts exist: they are keys of the client."""
MAX_PAIRS: Final = 50
"""Headers that a subscriber may request."""

_OURS: Final = frozenset({"host", "content-length", "content-type", "transfer-encoding", "connection"})
"""Headers that describe the message; another value would make it unreadable."""
_KNOWN: Final = frozenset(
    {"uri", "accept", "timeout", "cooldown", "receiverInfo", "notifierInfo", "@context", "type"}
)

Pairs = tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Endpoint:
    """Where notifications are sent.

    `headers` are sent with each; `taken` are names of headers that are copied from the request that made the
    change. `timeout_s` is the subscriber's timeout, `cooldown_s` the minimum pause after a failure. `mqtt` is
    set for MQTT.
    """

    uri: str
    accept: str = JSON
    headers: Pairs = ()
    taken: tuple[str, ...] = ()
    timeout_s: float | None = None
    cooldown_s: float = 0.0
    mqtt: MqttAddress | None = None

    @property
    def host(self) -> str:
        """The host that receives notifications."""
        return urlsplit(self.uri).hostname or ""

    @property
    def shown(self) -> str:
        """The address without secrets, for logs."""
        return without_secrets(self.uri)

    @property
    def key(self) -> tuple[object, ...]:
        """What identifies the endpoint."""
        return (self.uri, self.headers, self.taken, self.mqtt)


def endpoint(document: Any) -> Endpoint:
    """Return the endpoint of a subscription; raise a problem (400) for one that cannot be used."""
    if not isinstance(document, Mapping) or "uri" not in document:
        raise bad_request_data('notification.endpoint is an object with a "uri"; add it')
    if unknown := sorted(set(document) - _KNOWN):
        raise bad_request_data(
            f"notification.endpoint has no member {shown(unknown[0])}; it has {', '.join(sorted(_KNOWN))}"
        )
    uri = require_uri(document["uri"], "notification.endpoint.uri")
    notifier = _pairs(document.get("notifierInfo"), "notifierInfo")
    mqtt = mqtt_address(uri, notifier) if uri.startswith(MQTT_SCHEMES) else None
    if mqtt is None:
        _check_http(uri)
    accept = document.get("accept", JSON)
    if accept not in (JSON, JSON_LD, GEO_JSON):
        raise bad_request_data(
            f"notification.endpoint.accept is {JSON}, {JSON_LD} or {GEO_JSON}, not {shown(accept)}"
        )
    headers = _pairs(document.get("receiverInfo"), "receiverInfo")
    for key, value in headers:
        _check_header(key, value)
    return Endpoint(
        uri,
        accept,
        tuple(pair for pair in headers if pair[1] != FROM_THE_REQUEST),
        tuple(key for key, value in headers if value == FROM_THE_REQUEST),
        _milliseconds(document.get("timeout"), "timeout") or None,
        _milliseconds(document.get("cooldown"), "cooldown"),
        mqtt,
    )


def _check_http(uri: str) -> None:
    try:
        parts = urlsplit(uri)
        usable = parts.scheme in {"http", "https"} and bool(parts.hostname) and parts.port != 0
    except ValueError:
        usable = False
    if not usable or not uri.isascii():
        raise bad_request_data(
            "notification.endpoint.uri is an address such as http://127.0.0.1:9000/notify or "
            f"mqtt://127.0.0.1/topic, not {shown(uri)}"
        )


def _pairs(listed: Any, what: str) -> Pairs:
    if listed is None:
        return ()
    if not isinstance(listed, list) or len(listed) > MAX_PAIRS:
        raise bad_request_data(
            f'{what} is a list of at most {MAX_PAIRS} objects such as {{"key": "X-Cell", "value": "4"}}'
        )
    pairs: list[tuple[str, str]] = []
    for pair in listed:
        key, value = (pair.get("key"), pair.get("value")) if isinstance(pair, dict) else (None, None)
        if not isinstance(key, str) or not isinstance(value, str):
            raise bad_request_data(f'each {what} has a "key" and a "value" of text, not {shown(pair)}')
        pairs.append((key, value))
    return tuple(pairs)


def _check_header(key: str, value: str) -> None:
    is_token = bool(key) and key.isascii() and key.replace("-", "").replace("_", "").isalnum()
    if not is_token or not (value.isascii() and (value.isprintable() or not value)):
        raise bad_request_data(f"receiverInfo {shown(key)} cannot be an HTTP header; use plain characters")
    if key.lower() in _OURS:
        raise bad_request_data(
            f"receiverInfo {shown(key)} describes the message, which the broker does itself; leave it "
            'out ("accept" chooses the Content-Type)'
        )


def _milliseconds(duration: Any, what: str) -> float:
    """Return a duration in milliseconds as seconds."""
    if duration is None:
        return 0.0
    if not isinstance(duration, int | float) or isinstance(duration, bool) or not 0 <= duration < 1e12:
        raise bad_request_data(
            f"notification.endpoint.{what} is a number of milliseconds from 0 on, not {shown(duration)}"
        )
    return duration / 1000
