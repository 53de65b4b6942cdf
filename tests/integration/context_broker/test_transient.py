"""Transient entities and attributes: they end on time, also when the broker was down meanwhile."""

import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx


def soon(seconds: float) -> str:
    return (datetime.now(UTC) + timedelta(seconds=seconds)).isoformat()[:23] + "Z"


def guest(short: str, /, **members: Any) -> dict[str, Any]:
    return {"id": f"urn:ngsi-ld:Guest:demo:{short}", "type": "Guest", **members}


def status(http: httpx.Client, name: str) -> int:
    return http.get(f"/entities/urn:ngsi-ld:Guest:demo:{name}").status_code


def test_an_entity_ends_when_its_time_has_come(http: httpx.Client, eventually: Callable[..., Any]) -> None:
    assert http.post("/entities", json=guest("short", expiresAt=soon(0.4))).status_code == 201
    assert http.post("/entities", json=guest("long", expiresAt=soon(3600))).status_code == 201
    eventually(lambda: status(http, "short") == 404)
    assert status(http, "long") == 200


def test_an_end_may_be_put_off_or_taken_back(http: httpx.Client, eventually: Callable[..., Any]) -> None:
    for name in ("later", "never", "first"):
        assert http.post("/entities", json=guest(name, expiresAt=soon(0.5))).status_code == 201
    later, never = (f"/entities/urn:ngsi-ld:Guest:demo:{name}" for name in ("later", "never"))
    assert http.patch(later, json={"expiresAt": soon(3600)}).status_code == 204
    assert http.patch(never, json={"expiresAt": "urn:ngsi-ld:null"}).status_code == 204
    eventually(lambda: status(http, "first") == 404)
    assert (status(http, "later"), status(http, "never")) == (200, 200)
    assert "expiresAt" not in http.get(never, params={"options": "sysAttrs"}).json()


def test_an_attribute_ends_and_the_entity_stays(http: httpx.Client, eventually: Callable[..., Any]) -> None:
    badge = {"type": "Property", "value": "visitor", "expiresAt": soon(0.4)}
    assert http.post("/entities", json=guest("badge", badge=badge, name="Ada")).status_code == 201
    path = "/entities/urn:ngsi-ld:Guest:demo:badge"
    eventually(lambda: "badge" not in http.get(path).json())
    assert http.get(path, params={"options": "keyValues"}).json() == guest("badge", name="Ada")


def test_an_end_that_is_past_is_refused(http: httpx.Client) -> None:
    for members in (
        {"expiresAt": "2020-01-01T00:00:00Z"},
        {"expiresAt": "soon"},
        {"a": {"value": 1, "expiresAt": "2020-01-01T00:00:00Z"}},
    ):
        answer = http.post("/entities", json=guest("past", **members))
        assert answer.status_code == 400
        assert "expiresAt" in answer.json()["detail"]


def test_what_should_have_ended_while_the_broker_was_down_ends_at_its_start(
    own_broker: Any, eventually: Callable[..., Any]
) -> None:
    own_broker.start()
    end = time.time() + 0.3
    with own_broker.client() as http:
        assert http.post("/entities", json=guest("gone", expiresAt=soon(0.3))).status_code == 201
        assert http.post("/entities", json=guest("here", a=1)).status_code == 201
    own_broker.kill()
    eventually(lambda: time.time() > end)
    own_broker.start()
    with own_broker.client() as http:
        eventually(lambda: status(http, "gone") == 404)
        assert status(http, "here") == 200


def test_a_subscriber_is_told_of_an_end(
    http: httpx.Client, subscriber: Any, eventually: Callable[..., Any]
) -> None:
    subscription = {
        "id": "urn:ngsi-ld:Subscription:demo:ends",
        "type": "Subscription",
        "entities": [{"type": "Leaver"}],
        "notificationTrigger": ["entityDeleted"],
        "notification": {"endpoint": {"uri": subscriber.url, "accept": "application/json"}},
    }
    assert http.post("/subscriptions", json=subscription).status_code == 201
    leaver = {"id": "urn:ngsi-ld:Leaver:demo:1", "type": "Leaver", "expiresAt": soon(0.3)}
    assert http.post("/entities", json=leaver).status_code == 201
    told = eventually(subscriber.entities)
    assert told[0]["id"] == leaver["id"]
