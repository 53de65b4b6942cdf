"""Notifications: content, order, and endpoints that do not respond."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import pytest

from services.context_broker.tests.integration.acts import Eventually, create, patch, subscribe


def change_data(http: httpx.Client, subscription: str) -> dict[str, Any]:
    """Return the counts of a subscription; there are none before the first attempt."""
    received: dict[str, Any] = http.get(f"/subscriptions/{subscription}").json()["notification"]
    return received


@pytest.mark.nightly
def test_a_notification_has_the_present_entity(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    subscription = subscribe(http, "Present", subscriber.url)
    create(http, "Present", status="pending")
    eventually(lambda: subscriber.received)
    received = subscriber.received[0]
    assert received["type"] == "Notification"
    assert received["id"].startswith("urn:ngsi-ld:Notification:")
    assert received["subscriptionId"] == subscription
    assert received["notifiedAt"].endswith("Z")
    assert received["data"] == [
        {
            "id": "urn:ngsi-ld:Present:demo:1",
            "type": "Present",
            "status": {"type": "Property", "value": "pending"},
        }
    ]
    assert subscriber.headers[0]["content-type"] == "application/json"
    assert "json-ld#context" in subscriber.headers[0]["link"]


def test_only_watched_attributes_are_notified(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    subscribe(http, "Watch", subscriber.url, watchedAttributes=["status", "requestedStatus"])
    entity = create(http, "Watch", other=0)
    patch(http, entity, other=1)
    http.post(f"/entities/{entity}/attrs", json={"status": "pending"})
    patch(http, entity, other=2)
    patch(http, entity, status="completed")
    eventually(lambda: len(subscriber.received) >= 2)
    assert [one["status"]["value"] for one in subscriber.entities()] == ["pending", "completed"]
    assert subscriber.entities()[1]["other"]["value"] == 2


def test_q_id_and_pattern_select_notified_entities(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    selectors = [
        {"type": "Choose", "id": "urn:ngsi-ld:Choose:demo:one"},
        {"type": "Choose", "idPattern": "demo:two.*"},
    ]
    subscribe(http, "Choose", subscriber.url, entities=selectors, q="n>1")
    for name in ("one", "two-b", "three"):
        entity = create(http, "Choose", name, n=1)
        patch(http, entity, n=2)
    create(http, "Choose", "two-last", n=5)
    eventually(lambda: len(subscriber.received) >= 3)
    assert [one["id"].rpartition(":")[2] for one in subscriber.entities()] == ["one", "two-b", "two-last"]


@pytest.mark.parametrize(
    ("form", "status"),
    [
        ("normalized", {"type": "Property", "value": "pending", "unitCode": "X"}),
        ("concise", {"value": "pending", "unitCode": "X"}),
        ("keyValues", "pending"),
        ("simplified", "pending"),
    ],
)
def test_format_and_attributes_shape_notifications(
    http: httpx.Client, subscriber: Any, eventually: Eventually, form: str, status: Any
) -> None:
    kind = f"Form{form}"
    subscribe(http, kind, subscriber.url, notification={"format": form, "attributes": ["status"]})
    create(http, kind, status={"value": "pending", "unitCode": "X"}, other=1)
    eventually(lambda: subscriber.received)
    assert subscriber.entities() == [{"id": f"urn:ngsi-ld:{kind}:demo:1", "type": kind, "status": status}]


def test_clients_of_an_earlier_version_receive_kinds_that_they_know(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    subscribe(http, "Older", subscriber.url, ngsildConformance="1.6")
    accepts = {"endpoint": {"accept": "application/geo+json"}}
    subscribe(
        http,
        "OlderMap",
        subscriber.url,
        ngsildConformance="1.6",
        notification=accepts,
        entities=[{"type": "Older"}],
    )
    create(http, "Older", colour={"type": "VocabProperty", "vocab": "red"})
    eventually(lambda: len(subscriber.received) == 2)
    for received in (one["data"] for one in subscriber.received):
        shown = received[0] if isinstance(received, list) else received["features"][0]["properties"]
        assert shown["colour"] == {"type": "Property", "value": "red"}


def test_words_of_a_query_may_be_terms_of_the_context(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    members = {"expandValues": "colour", "notification": {"format": "concise"}}
    subscribe(http, "Terms", subscriber.url, q="colour==red", **members)
    for name, colour in (("1", "green"), ("2", "red")):
        create(http, "Terms", name, colour={"type": "VocabProperty", "vocab": colour})
    assert eventually(subscriber.entities)[0]["id"] == "urn:ngsi-ld:Terms:demo:2"


def test_json_ld_carries_its_context_and_headers_are_sent_along(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    endpoint = {"accept": "application/ld+json", "receiverInfo": [{"key": "X-Cell", "value": "4"}]}
    subscribe(http, "Ld", subscriber.url, notification={"endpoint": endpoint})
    create(http, "Ld", a=1)
    eventually(lambda: subscriber.received)
    assert "@context" in subscriber.received[0]
    headers = subscriber.headers[0]
    assert headers["content-type"] == "application/ld+json"
    assert headers["x-cell"] == "4"
    assert "link" not in headers


@pytest.mark.nightly
def test_the_order_is_kept_and_the_counts_are_true(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    subscription = subscribe(http, "Order", subscriber.url)
    entity = create(http, "Order", n=0)
    for number in range(1, 300):
        patch(http, entity, n=number)
    eventually(lambda: len(subscriber.received) == 300)
    assert [one["n"]["value"] for one in subscriber.entities()] == list(range(300))
    notification = eventually(
        lambda: (found := change_data(http, subscription)).get("timesSent", 0) == 300 and found
    )
    assert notification["status"] == "ok"
    assert notification["lastSuccess"] == notification["lastNotification"]
    assert "lastFailure" not in notification


def test_paused_expired_and_deleted_subscriptions_are_not_notified(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    subscribe(http, "Quiet", subscriber.url, isActive=False)
    other = {"entities": [{"type": "Quiet"}]}
    soon = (datetime.now(UTC) + timedelta(seconds=1)).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    expired = subscribe(http, "QuietExpired", subscriber.url, expiresAt=soon, **other)
    eventually(lambda: http.get(f"/subscriptions/{expired}").json()["status"] == "expired")
    deleted = subscribe(http, "QuietDeleted", subscriber.url, **other)
    assert http.delete(f"/subscriptions/{deleted}").status_code == 204
    entity = create(http, "Quiet", n=1)
    http.patch("/subscriptions/urn:ngsi-ld:Subscription:demo:Quiet", json={"isActive": True})
    patch(http, entity, n=2)
    eventually(lambda: subscriber.received)
    assert [one["n"]["value"] for one in subscriber.entities()] == [2]


def test_dead_and_hanging_subscribers_delay_no_other(
    http: httpx.Client, subscriber: Any, new_subscriber: Callable[..., Any], eventually: Eventually
) -> None:
    hanging = new_subscriber()
    hanging.go_on.clear()
    same = {"entities": [{"type": "Neighbour"}]}
    dead = subscribe(http, "NeighbourDead", "http://127.0.0.1:9/notify", **same)
    subscribe(http, "NeighbourHanging", hanging.url, **same)
    subscribe(http, "Neighbour", subscriber.url)
    entity = create(http, "Neighbour", n=0)
    for number in range(1, 100):
        patch(http, entity, n=number)
    eventually(lambda: len(subscriber.received) == 100, within_s=4)
    assert hanging.received == []
    received = eventually(lambda: (found := change_data(http, dead)).get("timesFailed", 0) >= 1 and found)
    assert received["status"] == "failed"
    hanging.go_on.set()
    eventually(lambda: len({one["n"]["value"] for one in hanging.entities()}) == 100, within_s=30)
    first_received = list(dict.fromkeys(one["n"]["value"] for one in hanging.entities()))
    assert first_received == list(range(100))


def test_pending_notifications_arrive_when_the_subscriber_returns(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    subscriber.status = 503
    subscription = subscribe(http, "Back", subscriber.url)
    entity = create(http, "Back", n=0)
    patch(http, entity, n=1)
    eventually(lambda: change_data(http, subscription).get("timesFailed", 0) >= 2)
    subscriber.status = 204
    eventually(lambda: len(subscriber.received) == 2)
    assert [one["n"]["value"] for one in subscriber.entities()] == [0, 1]
    sent_again = eventually(
        lambda: (
            (found := http.get(f"/subscriptions/{subscription}").json()["notification"]).get("status") == "ok"
            and found.get("timesSent", 0) == 2
            and found
        )
    )
    assert sent_again.get("timesFailed", 0) >= 2  # each attempt; sent counts notifications, not attempts


def test_a_notification_that_is_refused_for_good_makes_way_for_the_next(
    http: httpx.Client, shared_broker: Any, subscriber: Any, eventually: Eventually
) -> None:
    subscriber.status = 400
    subscription = subscribe(http, "Refuse", subscriber.url)
    entity = create(http, "Refuse", n=0)
    eventually(lambda: change_data(http, subscription).get("timesFailed", 0) == 1)
    assert http.get(f"/subscriptions/{subscription}").json()["notification"].get("timesSent", 0) == 1
    subscriber.status = 200
    patch(http, entity, n=1)
    eventually(lambda: subscriber.received)
    assert [one["n"]["value"] for one in subscriber.entities()] == [1]
    assert shared_broker.metric("handover_broker_notifications_dropped_total") >= 1


def test_throttled_changes_are_sent_together_and_the_last_state_is_never_lost(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    subscribe(http, "Throttle", subscriber.url, throttling=0.5)
    first = create(http, "Throttle", "first", n=0)
    eventually(lambda: subscriber.received)
    second = create(http, "Throttle", "second", n=0)
    for number in range(1, 20):
        patch(http, first, n=number)
        patch(http, second, n=number)
    eventually(lambda: [one["n"]["value"] for one in subscriber.entities()][-2:] == [19, 19])
    assert len(subscriber.received) < 20
    together = [{one["id"] for one in received["data"]} for received in subscriber.received]
    assert {first, second} in together


def test_a_changed_endpoint_counts_at_once_also_for_what_waits(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    subscription = subscribe(http, "Moved", "http://127.0.0.1:9/moved")
    create(http, "Moved", n=0)
    path = f"/subscriptions/{subscription}"
    eventually(lambda: http.get(path).json()["notification"].get("timesFailed", 0) >= 4)
    http.patch(path, json={"notification": {"endpoint": {"uri": subscriber.url}}})
    eventually(lambda: subscriber.received)
    assert subscriber.entities()[0]["n"]["value"] == 0


def test_an_answer_that_is_no_http_is_a_failure_like_any_other(
    http: httpx.Client, eventually: Eventually
) -> None:
    import socketserver
    import threading

    class Gibberish(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            self.request.recv(65536)
            self.request.sendall(b"\x00\x01 not http \r\n\r\n")

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Gibberish) as server:
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
        subscription = subscribe(http, "Gibberish", f"http://127.0.0.1:{server.server_address[1]}/")
        create(http, "Gibberish", n=0)
        path = f"/subscriptions/{subscription}"
        eventually(lambda: http.get(path).json()["notification"].get("timesFailed", 0) >= 2)
        assert http.delete(path).status_code == 204
        server.shutdown()


def batch(http: httpx.Client, act: str, documents: list[Any]) -> None:
    answer = http.post(f"/entityOperations/{act}", json=documents)
    assert answer.is_success, answer.text
    assert answer.status_code != 207, answer.text


@pytest.mark.parametrize("accept", ["application/json", "application/ld+json", "application/geo+json"])
def test_a_batch_makes_one_notification_for_a_subscription(
    http: httpx.Client, subscriber: Any, kind: str, eventually: Eventually, accept: str
) -> None:
    endpoint = {"uri": subscriber.url, "accept": accept}
    triggers = ["entityCreated", "entityUpdated", "entityDeleted"]
    subscription = subscribe(
        http, kind, subscriber.url, notification={"endpoint": endpoint}, notificationTrigger=triggers
    )
    ids = [f"urn:ngsi-ld:{kind}:{number}" for number in range(200)]
    entities = [{"id": entity_id, "type": kind, "a": 0} for entity_id in ids]
    for number, act in enumerate(("create", "upsert", "update", "merge"), start=1):
        batch(http, act, [{**entity, "a": number} for entity in entities])
        eventually(lambda wanted=number: len(subscriber.received) >= wanted)
    batch(http, "delete", ids)
    eventually(lambda: len(subscriber.received) >= 5)
    parts = [one["data"] for one in subscriber.received]
    received = [part["features"] if isinstance(part, dict) else part for part in parts]
    assert [[entity["id"] for entity in part] for part in received] == [ids] * 5
    assert len({one["id"] for one in subscriber.received}) == 5
    eventually(lambda: change_data(http, subscription)["timesSent"] == 5)


def test_a_large_batch_makes_notifications_of_a_maximum_size(
    http: httpx.Client, subscriber: Any, kind: str, eventually: Eventually
) -> None:
    subscribe(http, kind, subscriber.url)
    ids = [f"urn:ngsi-ld:{kind}:{number}" for number in range(600)]
    batch(http, "create", [{"id": one, "type": kind, "a": 1} for one in ids])
    eventually(lambda: len(subscriber.entities()) >= len(ids))
    assert [len(one["data"]) for one in subscriber.received] == [256, 256, 88]
    assert [one["id"] for one in subscriber.entities()] == ids
    large = [{"id": f"{one}:large", "type": kind, "text": "x" * 400_000} for one in ids[:5]]
    batch(http, "create", large)
    eventually(lambda: len(subscriber.entities()) >= len(ids) + len(large))
    assert [len(one["data"]) for one in subscriber.received[3:]] == [2, 2, 1]


def test_a_notification_of_a_batch_is_repeated_as_a_whole(
    http: httpx.Client, subscriber: Any, kind: str, eventually: Eventually
) -> None:
    subscribe(http, kind, subscriber.url)
    subscriber.status = 503
    ids = [f"urn:ngsi-ld:{kind}:{number}" for number in range(20)]
    batch(http, "create", [{"id": one, "type": kind, "a": 0} for one in ids])
    batch(http, "upsert", [{"id": one, "type": kind, "a": 1} for one in ids])
    subscriber.status = 200
    eventually(lambda: len(subscriber.received) >= 2)
    assert [[one["id"] for one in part["data"]] for part in subscriber.received] == [ids, ids]
    assert [one["a"]["value"] for one in subscriber.entities()] == [0] * 20 + [1] * 20
