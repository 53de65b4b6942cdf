"""Endpoints that do not respond: cost, limits, and dropped notifications."""

import re
import socket
import threading
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import psutil
import pytest

from services.context_broker.tests.integration import acts

Eventually = Callable[..., Any]


class Closing:
    """A server that accepts connections, counts them and closes them at once."""

    def __init__(self) -> None:
        self.connections = 0
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._socket.getsockname()[1]}/notify"
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._socket.accept()
            except OSError:
                return
            self.connections += 1
            connection.close()

    def stop(self) -> None:
        self._socket.close()


@pytest.fixture
def closing() -> Iterator[Closing]:
    made = Closing()
    yield made
    made.stop()


def subscribe(http: httpx.Client, name: str, url: str, kind: str, **endpoint: Any) -> str:
    received = {"entities": [{"type": kind}], "notification": {"endpoint": endpoint}}
    return f"/subscriptions/{acts.subscribe(http, name, url, **received)}"


def create(http: httpx.Client, kind: str, **attributes: Any) -> str:
    entity_id = f"urn:ngsi-ld:{kind}:demo:1"
    assert http.post("/entities", json={"id": entity_id, "type": kind, **attributes}).status_code == 201
    return entity_id


def waiting(broker: Any, state: str) -> float:
    found: float = broker.metric(rf'handover_broker_notifications_pending\{{state="{state}"\}}')
    return found


@pytest.mark.nightly
def test_a_hundred_subscriptions_to_one_dead_endpoint_cost_one_attempt_at_a_time(
    http: httpx.Client, shared_broker: Any, closing: Closing, eventually: Eventually
) -> None:
    paths = [subscribe(http, f"crowd-{number}", closing.url, "Crowd") for number in range(100)]
    create(http, "Crowd", n=0)
    eventually(lambda: closing.connections >= 100)  # all try once, before anybody knows
    first = closing.connections
    eventually(lambda: closing.connections >= first + 3)
    retries = shared_broker.metric("handover_broker_notification_retries_total")
    assert 3 <= retries < 30
    for path in paths:
        assert http.delete(path).status_code == 204


def test_one_that_is_not_taken_does_not_hold_up_others_at_the_same_endpoint(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    subscriber.refuses = lambda body: body["data"][0]["type"] == "Poison"
    bad = subscribe(http, "poison", subscriber.url, "Poison")
    subscribe(http, "wholesome", subscriber.url, "Wholesome")
    create(http, "Poison", n=0)
    eventually(lambda: http.get(bad).json()["notification"].get("timesFailed", 0) >= 2)
    entity = create(http, "Wholesome", n=0)
    for number in range(1, 50):
        assert http.patch(f"/entities/{entity}/attrs", json={"n": number}).status_code == 204
    eventually(lambda: len(subscriber.received) == 50)
    assert [one["n"]["value"] for one in subscriber.entities()] == list(range(50))
    subscriber.refuses = None
    eventually(lambda: len(subscriber.received) == 51, within_s=30)


def test_the_cooldown_of_a_subscription_applies_after_a_failure(
    http: httpx.Client, closing: Closing, eventually: Eventually
) -> None:
    path = subscribe(http, "cooling", closing.url, "Cooling", cooldown=3_600_000)
    entity = create(http, "Cooling", n=0)
    eventually(lambda: http.get(path).json()["notification"].get("timesFailed", 0) == 1)
    for number in range(1, 20):
        http.patch(f"/entities/{entity}/attrs", json={"n": number})
    assert http.get(path).json()["notification"].get("timesFailed", 0) == 1
    assert closing.connections == 1


def test_pending_notifications_of_an_expired_subscription_are_dropped(
    http: httpx.Client, shared_broker: Any, closing: Closing, eventually: Eventually
) -> None:
    path = subscribe(http, "ending", closing.url, "Ending")
    for name in ("a", "b", "c"):
        body = {"id": f"urn:ngsi-ld:Ending:demo:{name}", "type": "Ending", "n": 0}
        assert http.post("/entities", json=body).status_code == 201
    soon = (datetime.now(UTC) + timedelta(seconds=1)).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    assert http.patch(path, json={"expiresAt": soon}).status_code == 204
    given_up = r'handover_broker_notifications_dropped_total\{reason="expired"\}'
    eventually(lambda: shared_broker.metric(given_up) == 3)
    received = http.get(path).json()
    assert received["status"] == "expired"
    assert received["notification"].get("timesFailed", 0) >= 3
    assert http.patch(path, json={"expiresAt": "2999-01-01T00:00:00Z"}).status_code == 204
    assert http.get(path).json()["status"] == "active"


@pytest.mark.nightly
def test_counts_are_true_after_a_power_cut(
    own_broker: Any, subscriber: Any, closing: Closing, eventually: Eventually
) -> None:
    own_broker.start()
    with own_broker.client() as http:
        good = subscribe(http, "good", subscriber.url, "Counted")
        bad = subscribe(http, "bad", closing.url, "Counted", cooldown=3_600_000)
        create(http, "Counted", n=0)
        eventually(lambda: http.get(good).json()["notification"].get("timesSent", 0) == 1)
        before = eventually(
            lambda: (found := http.get(bad).json()["notification"]).get("timesFailed", 0) == 1 and found
        )
        for _ in range(20):  # each is a commit, and takes the counts along
            create(http, f"Other{_}", n=0)
        own_broker.kill()
        own_broker.start()
        received = http.get(good).json()["notification"]
        assert (received.get("timesSent", 0), received.get("timesFailed", 0), received["status"]) == (
            1,
            0,
            "ok",
        )
        after = http.get(bad).json()["notification"]
        assert after.get("timesFailed", 0) >= before.get("timesFailed", 0)
        assert after["lastFailure"] >= before["lastFailure"]
        assert len(subscriber.received) == 1


@pytest.mark.nightly
@pytest.mark.slow
def test_pending_notifications_of_a_dead_endpoint_do_not_grow_memory(
    own_broker: Any, closing: Closing, eventually: Eventually
) -> None:
    """Some thousand notifications show whether memory grows with their number."""
    own_broker.start()
    with own_broker.client() as http:
        subscribe(http, "million", closing.url, "Million")
        memory = psutil.Process(own_broker.process.pid).memory_info
        things = [f"urn:ngsi-ld:Million:demo:{number}" for number in range(500)]
        taken = []
        for number in range(40):
            batch = [{"id": thing, "type": "Million", "n": number} for thing in things]
            assert http.post("/entityOperations/upsert?options=update", json=batch).is_success
            taken.append(memory().rss)
        assert taken[-1] - taken[9] < 6 * 1024 * 1024, taken
        assert waiting(own_broker, "memory") <= 256
        eventually(lambda: waiting(own_broker, "memory") + waiting(own_broker, "disk") == 20_000)
    own_broker.kill()
    own_broker.start()
    eventually(lambda: waiting(own_broker, "memory") + waiting(own_broker, "disk") == 20_000)


@pytest.mark.nightly
@pytest.mark.slow
def test_pending_notifications_of_a_dead_endpoint_are_limited(
    own_broker: Any, closing: Closing, eventually: Eventually
) -> None:
    """Sixty megabytes of notifications are pending, of which one is allowed."""
    own_broker.extra = {"HANDOVER_BROKER_NOTIFICATION_KEEP_MB": "1"}
    own_broker.start()
    with own_broker.client() as http:
        path = subscribe(http, "flood", closing.url, "Flood")
        entity = create(http, "Flood", n=0)
        memory = psutil.Process(own_broker.process.pid).memory_info
        before = memory().rss
        change = {"id": entity, "type": "Flood", "filling": "x" * 5000}
        for start in range(0, 12_000, 100):
            batch = [{**change, "n": start + number} for number in range(100)]
            answer = http.post("/entityOperations/upsert", params={"options": "update"}, json=batch)
            assert answer.status_code in {201, 204}, answer.text
        eventually(lambda: http.get(path).json()["notification"].get("timesFailed", 0) > 11_500)
        given_up = own_broker.metric(r'handover_broker_notifications_dropped_total\{reason="too many"\}')
        assert given_up > 11_500
        eventually(lambda: waiting(own_broker, "disk") + waiting(own_broker, "memory") < 400)
        assert waiting(own_broker, "memory") <= 256
        assert memory().rss - before < 70 * 1024 * 1024
        assert http.get(f"/entities/{entity}").json()["n"]["value"] == 11_999
        assert re.search(r"dropped", own_broker.log())
