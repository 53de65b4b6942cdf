"""Transient entities and attributes, current and temporal: they expire on time, also at a restart."""

import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import pytest

from .temporal_requests import PAST, at, read_evolution, readings, values


def soon(seconds: float) -> str:
    return (datetime.now(UTC) + timedelta(seconds=seconds)).isoformat()[:23] + "Z"


def visitor(short: str, /, **members: Any) -> dict[str, Any]:
    return {"id": f"urn:ngsi-ld:Visitor:demo:{short}", "type": "Visitor", **members}


def status(http: httpx.Client, name: str) -> int:
    return http.get(f"/entities/urn:ngsi-ld:Visitor:demo:{name}").status_code


def test_an_entity_ends_when_its_time_has_come(http: httpx.Client, eventually: Callable[..., Any]) -> None:
    assert http.post("/entities", json=visitor("short", expiresAt=soon(0.4))).status_code == 201
    assert http.post("/entities", json=visitor("long", expiresAt=soon(3600))).status_code == 201
    eventually(lambda: status(http, "short") == 404)
    assert status(http, "long") == 200


def test_an_end_may_be_put_off_or_taken_back(http: httpx.Client, eventually: Callable[..., Any]) -> None:
    for name in ("later", "never", "first"):
        assert http.post("/entities", json=visitor(name, expiresAt=soon(0.5))).status_code == 201
    later, never = (f"/entities/urn:ngsi-ld:Visitor:demo:{name}" for name in ("later", "never"))
    assert http.patch(later, json={"expiresAt": soon(3600)}).status_code == 204
    assert http.patch(never, json={"expiresAt": "urn:ngsi-ld:null"}).status_code == 204
    eventually(lambda: status(http, "first") == 404)
    assert (status(http, "later"), status(http, "never")) == (200, 200)
    assert "expiresAt" not in http.get(never, params={"options": "sysAttrs"}).json()


def test_an_attribute_ends_and_the_entity_stays(http: httpx.Client, eventually: Callable[..., Any]) -> None:
    badge = {"type": "Property", "value": "visitor", "expiresAt": soon(0.4)}
    assert http.post("/entities", json=visitor("badge", badge=badge, name="Ada")).status_code == 201
    path = "/entities/urn:ngsi-ld:Visitor:demo:badge"
    eventually(lambda: "badge" not in http.get(path).json())
    assert http.get(path, params={"options": "keyValues"}).json() == visitor("badge", name="Ada")


def test_an_end_that_is_past_is_refused(http: httpx.Client) -> None:
    for members in (
        {"expiresAt": "2020-01-01T00:00:00Z"},
        {"expiresAt": "soon"},
        {"a": {"value": 1, "expiresAt": "2020-01-01T00:00:00Z"}},
    ):
        answer = http.post("/entities", json=visitor("past", **members))
        assert answer.status_code == 400
        assert "expiresAt" in answer.json()["detail"]


@pytest.mark.nightly
def test_entities_that_expired_while_the_broker_was_down_are_deleted_at_its_start(
    own_broker: Any, eventually: Callable[..., Any]
) -> None:
    own_broker.start()
    end = time.time() + 0.3
    with own_broker.client() as http:
        assert http.post("/entities", json=visitor("gone", expiresAt=soon(0.3))).status_code == 201
        assert http.post("/entities", json=visitor("here", a=1)).status_code == 201
    own_broker.kill()
    eventually(lambda: time.time() > end)
    own_broker.start()
    with own_broker.client() as http:
        eventually(lambda: status(http, "gone") == 404)
        assert status(http, "here") == 200


def test_a_subscriber_is_notified_of_an_expiry(
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
    result = eventually(subscriber.entities)
    assert result[0]["id"] == leaver["id"]


def test_the_past_of_an_entity_ends_when_its_time_has_come(
    http: httpx.Client, eventually: Callable[..., Any]
) -> None:
    one = "urn:ngsi-ld:Visitor:demo:remembered"
    end = soon(1.5)
    body = {"id": one, "type": "Visitor", "expiresAt": soon(3600), "a": readings([1, 2])}
    assert http.post(PAST, json=body).status_code == 201
    assert http.post(f"{PAST}/{one}/attrs", json={"expiresAt": end, "a": readings([3], 2)}).status_code == 204
    returned = read_evolution(http, one, options="sysAttrs")
    assert (returned["expiresAt"], values(returned, "a")) == (end, [1, 2, 3])
    assert "expiresAt" not in read_evolution(http, one)
    eventually(lambda: http.get(f"{PAST}/{one}").status_code == 404)
    since = {"type": "Visitor", "id": one, "timerel": "after", "timeAt": at(0), "timeproperty": "observedAt"}
    assert http.get(PAST, params=since).json() == []
    assert http.post(f"{PAST}/{one}/attrs", json={"a": readings([4], 3)}).status_code == 404
    assert http.post(PAST, json={"id": one, "type": "Visitor", "a": readings([5], 4)}).status_code == 201
    assert values(read_evolution(http, one), "a") == [5]


def test_an_instance_of_the_past_ends_when_its_time_has_come(
    http: httpx.Client, eventually: Callable[..., Any]
) -> None:
    one = "urn:ngsi-ld:Visitor:demo:fading"
    fading = [*readings([1]), *readings([2], 1, expiresAt=soon(1.0))]
    assert http.post(PAST, json={"id": one, "type": "Visitor", "a": fading}).status_code == 201
    assert [("expiresAt" in each) for each in read_evolution(http, one, options="sysAttrs")["a"]] == [
        False,
        True,
    ]
    eventually(lambda: values(read_evolution(http, one), "a") == [1])


def test_the_history_of_an_expired_entity_is_still_returned(
    http: httpx.Client, eventually: Callable[..., Any]
) -> None:
    badge = {"type": "Property", "value": "visitor", "expiresAt": soon(0.4)}
    assert http.post("/entities", json=visitor("left", badge=badge)).status_code == 201
    one, listed = "urn:ngsi-ld:Visitor:demo:left", {"timeproperty": "modifiedAt", "options": "sysAttrs"}
    eventually(lambda: "badge" not in http.get(f"/entities/{one}").json())
    assert values(read_evolution(http, one, **listed), "badge") == ["visitor"]
    end = soon(3600)
    assert http.patch(f"/entities/{one}", json={"expiresAt": end}).status_code == 204
    assert read_evolution(http, one, **listed)["expiresAt"] == end


def test_the_end_of_a_current_entity_is_not_set_in_its_past(http: httpx.Client) -> None:
    assert http.post("/entities", json=visitor("present", a=1)).status_code == 201
    refused = http.post(PAST, json=visitor("present", a=readings([1]), expiresAt=soon(3600)))
    assert refused.status_code == 400
    assert "expiresAt" in refused.json()["detail"]
    refused = http.post(PAST, json=visitor("late", a=readings([1]), expiresAt="2020-01-01T00:00:00Z"))
    assert refused.status_code == 400
