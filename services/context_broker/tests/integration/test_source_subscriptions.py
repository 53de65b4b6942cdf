"""Subscriptions to registrations: initial notification, changes, and nothing lost."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import pytest

from .conftest import BrokerProcess, Subscriber

PATH = "/csourceSubscriptions"


def subscribe(http: httpx.Client, uri: str, kind: str, **members: Any) -> str:
    document = {
        "type": "Subscription",
        "entities": [{"type": kind}],
        "notification": {"endpoint": {"uri": uri}},
        **members,
    }
    answer = http.post(PATH, json=document)
    assert answer.status_code == 201, answer.text
    return str(answer.headers["location"].rpartition("/")[2])


def register(http: httpx.Client, name: str, kind: str, **members: Any) -> str:
    one = f"urn:ngsi-ld:ContextSourceRegistration:{name}"
    information = [{"entities": [{"type": kind}], "propertyNames": ["speed"]}]
    document = {"id": one, "endpoint": "http://127.0.0.1:9", "information": information, **members}
    answer = http.post("/csourceRegistrations", json=document)
    assert answer.status_code == 201, answer.text
    return one


def notified(subscriber: Subscriber) -> list[tuple[str, list[str]]]:
    return [(one["triggerReason"], [each["id"] for each in one["data"]]) for one in list(subscriber.received)]


def test_a_new_subscriber_is_notified_of_all_matches_then_of_changes(
    http: httpx.Client, subscriber: Subscriber, eventually: Callable[..., Any]
) -> None:
    first = register(http, "first", "Notified")
    one = subscribe(http, subscriber.url, "Notified", watchedAttributes=["speed"])
    eventually(lambda: notified(subscriber) == [("newlyMatching", [first])])
    body = subscriber.received[0]
    assert (body["type"], body["subscriptionId"]) == ("ContextSourceNotification", one)
    assert body["data"][0]["information"][0]["entities"] == [{"type": "Notified"}]
    register(http, "unheard", "Other")
    second = register(http, "second", "Notified")
    http.patch(f"/csourceRegistrations/{first}", json={"description": "changed"})
    http.patch(f"/csourceRegistrations/{first}", json={"information": [{"entities": [{"type": "Other"}]}]})
    http.delete(f"/csourceRegistrations/{second}")
    expected = [
        ("newlyMatching", [first]),
        ("newlyMatching", [second]),
        ("updated", [first]),
        ("noLongerMatching", [first]),
        ("noLongerMatching", [second]),
    ]
    eventually(lambda: notified(subscriber) == expected, why=lambda: str(notified(subscriber)))
    eventually(lambda: http.get(f"{PATH}/{one}").json()["notification"].get("timesSent") == 5)
    assert http.get("/subscriptions").json() == []
    assert one in [each["id"] for each in http.get(PATH).json()]
    assert http.delete(f"{PATH}/{one}").status_code == 204
    assert http.get(f"{PATH}/{one}").status_code == 404


@pytest.mark.nightly
def test_a_throttled_subscriber_is_notified_of_several_at_once(
    http: httpx.Client, subscriber: Subscriber, eventually: Callable[..., Any]
) -> None:
    one = subscribe(http, subscriber.url, "Seldom", throttling=1.5)
    first = register(http, "seldom-1", "Seldom")
    eventually(lambda: notified(subscriber) == [("newlyMatching", [first])])
    second, third = register(http, "seldom-2", "Seldom"), register(http, "seldom-3", "Seldom")
    for text in ("changed", "changed again"):
        http.patch(f"/csourceRegistrations/{third}", json={"description": text})
    http.delete(f"/csourceRegistrations/{second}")
    expected = [
        ("newlyMatching", [first]),
        ("newlyMatching", [second, third]),
        ("updated", [third]),
        ("noLongerMatching", [second]),
    ]
    eventually(lambda: notified(subscriber) == expected, why=lambda: str(notified(subscriber)))
    assert subscriber.received[2]["data"][0]["description"] == "changed again"
    eventually(lambda: http.get(f"{PATH}/{one}").json()["notification"].get("timesSent") == 4)


def test_subscribers_are_notified_of_an_expired_registration(
    http: httpx.Client, subscriber: Subscriber, eventually: Callable[..., Any]
) -> None:
    subscribe(http, subscriber.url, "Ending")
    soon = (datetime.now(UTC) + timedelta(seconds=2)).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    one = register(http, "ending", "Ending", expiresAt=soon)
    eventually(lambda: notified(subscriber) == [("newlyMatching", [one]), ("noLongerMatching", [one])])


def test_a_paused_subscription_is_not_notified(http: httpx.Client, subscriber: Subscriber) -> None:
    paused = subscribe(http, subscriber.url, "Paused", isActive=False)
    register(http, "paused", "Paused")
    assert http.get(f"{PATH}/{paused}").json()["status"] == "paused"
    assert notified(subscriber) == []


def test_changes_of_entities_are_not_notified(
    http: httpx.Client, subscriber: Subscriber, eventually: Callable[..., Any]
) -> None:
    subscribe(http, subscriber.url, "Business")
    entity = {"id": "urn:ngsi-ld:Business:1", "type": "Business", "speed": {"type": "Property", "value": 1}}
    assert http.post("/entities", json=entity).status_code == 201
    one = register(http, "business", "Business")
    eventually(lambda: notified(subscriber) == [("newlyMatching", [one])])


@pytest.mark.nightly
def test_pending_registration_notifications_survive_a_crash(
    own_broker: BrokerProcess, subscriber: Subscriber, eventually: Callable[..., Any]
) -> None:
    subscriber.status = 503
    own_broker.start()
    with own_broker.client() as http:
        subscribe(http, subscriber.url, "Pending")
        one = register(http, "pending", "Pending")
    own_broker.kill()
    subscriber.status = 200
    own_broker.start()
    eventually(lambda: notified(subscriber))
    assert notified(subscriber)[0] == (
        "newlyMatching",
        [one],
    )  # once, or again if the last attempt was under way


def test_an_invalid_registration_subscription_is_refused(http: httpx.Client) -> None:
    document = {"entities": [{"type": "A"}], "notification": {"endpoint": {"uri": "http://127.0.0.1:9"}}}
    assert http.post(PATH, json={**document, "notification": {}}).status_code == 400
    assert http.post(PATH, json=[]).status_code == 400
    assert http.get(f"{PATH}/urn:ngsi-ld:Subscription:absent").status_code == 404


def test_a_subscription_with_an_interval_is_notified_periodically(
    http: httpx.Client, subscriber: Subscriber, eventually: Callable[..., Any]
) -> None:
    one = register(http, "round", "Round")
    subscribe(http, subscriber.url, "Round", timeInterval=1)
    eventually(lambda: len(notified(subscriber)) >= 3)
    assert set(map(str, notified(subscriber))) == {str(("newlyMatching", [one]))}


def test_attributes_restrict_if_watched_and_notified_ones_are_named(
    http: httpx.Client, new_subscriber: Callable[..., Subscriber], eventually: Callable[..., Any]
) -> None:
    wide, narrow = new_subscriber(), new_subscriber()
    subscribe(http, wide.url, "Named", watchedAttributes=["speed"])
    also_notified = {"endpoint": {"uri": narrow.url}, "attributes": ["heading"]}
    subscribe(http, narrow.url, "Named", watchedAttributes=["speed"], notification=also_notified)
    entities = [{"type": "Named"}]
    ids = [
        register(
            http, f"named-{name}", "Named", information=[{"entities": entities, "propertyNames": [name]}]
        )
        for name in ("colour", "heading", "speed")
    ]
    eventually(lambda: notified(wide) == [("newlyMatching", [one]) for one in ids], why=str(notified(wide)))
    eventually(
        lambda: notified(narrow) == [("newlyMatching", [one]) for one in ids[1:]], why=str(notified(narrow))
    )
