"""Subscriptions passed on to other brokers: what changes there is told; they are taken back in the end."""

from collections.abc import Callable
from typing import Any

import httpx

from tests.context_sources import ScriptedSource, put, register

OPERATIONS = ["createSubscription", "updateSubscription", "deleteSubscription", "retrieveOps"]
Eventually = Callable[..., Any]


def subscribe(client: httpx.Client, kind: str, url: str, **more: Any) -> str:
    document = {
        "type": "Subscription",
        "entities": [{"type": kind}],
        "notification": {"endpoint": {"uri": url}},
        **more,
    }
    answer = client.post("/subscriptions", json=document)
    assert answer.status_code == 201, answer.text
    return answer.headers["location"].removeprefix("/ngsi-ld/v1")


def subscriptions(client: httpx.Client, kind: str) -> list[dict[str, Any]]:
    return [
        one
        for one in client.get("/subscriptions?limit=1000").json()
        if {"type": kind} in one.get("entities", [])
    ]


def test_changes_elsewhere_are_told(
    near: httpx.Client,
    far: httpx.Client,
    kind: str,
    subscriber: Any,
    eventually: Eventually,
) -> None:
    register(near, str(far.base_url), {"type": kind}, operations=OPERATIONS)
    path = subscribe(near, kind, subscriber.url, q="n>5")
    assert len(subscriptions(far, kind)) == 1
    entity_id = put(far, f"urn:ngsi-ld:{kind}:1", kind, n=9)
    eventually(lambda: subscriber.received)
    put(far, f"urn:ngsi-ld:{kind}:2", kind, n=1)
    far.patch(f"/entities/{entity_id}/attrs", json={"n": 7})
    eventually(lambda: len(subscriber.received) > 1)
    assert [(one["id"], one["n"]["value"]) for one in subscriber.entities()] == [
        (entity_id, 9),
        (entity_id, 7),
    ]
    assert {one["subscriptionId"] for one in subscriber.received} == {path.rpartition("/")[2]}
    assert near.get(path).json()["notification"]["timesSent"] == 2
    near.delete(path)
    eventually(lambda: not subscriptions(far, kind))


def test_registrations_that_come_and_go_are_heeded(
    near: httpx.Client,
    far: httpx.Client,
    kind: str,
    subscriber: Any,
    eventually: Eventually,
) -> None:
    path = subscribe(near, kind, subscriber.url)
    registration = register(near, str(far.base_url), {"type": kind}, operations=OPERATIONS)
    eventually(lambda: len(subscriptions(far, kind)) == 1)
    near.patch(path, json={"watchedAttributes": ["n"]})
    eventually(lambda: [one.get("watchedAttributes") for one in subscriptions(far, kind)] == [["n"]])
    near.patch(path, json={"isActive": False})
    eventually(lambda: not subscriptions(far, kind))
    near.patch(path, json={"isActive": True})
    eventually(lambda: len(subscriptions(far, kind)) == 1)
    near.delete(registration)
    eventually(lambda: not subscriptions(far, kind))
    near.delete(path)


def test_what_is_told_is_the_whole_entity_as_far_as_it_is_registered(
    near: httpx.Client,
    far: httpx.Client,
    kind: str,
    subscriber: Any,
    eventually: Eventually,
) -> None:
    register(near, str(far.base_url), {"type": kind}, ["there"], operations=OPERATIONS)
    entity_id = put(near, f"urn:ngsi-ld:{kind}:1", kind, here=1)
    path = subscribe(near, kind, subscriber.url, q="here==1;there==2")
    put(far, entity_id, kind, there=2, hidden=3)
    eventually(lambda: subscriber.received)
    (entity,) = subscriber.entities()
    assert (entity["here"]["value"], entity["there"]["value"]) == (1, 2)
    assert "hidden" not in entity
    near.delete(path)


def test_brokers_that_know_each_other_do_not_subscribe_in_circles(
    near: httpx.Client,
    far: httpx.Client,
    kind: str,
    subscriber: Any,
    eventually: Eventually,
) -> None:
    register(near, str(far.base_url), {"type": kind}, operations=OPERATIONS)
    back = register(far, str(near.base_url), {"type": kind}, operations=OPERATIONS)
    path = subscribe(near, kind, subscriber.url)
    put(near, f"urn:ngsi-ld:{kind}:near", kind, n=1)
    put(far, f"urn:ngsi-ld:{kind}:far", kind, n=1)
    eventually(lambda: len(subscriber.received) == 2)
    assert len(subscriptions(near, kind)) == 1
    assert len(subscriptions(far, kind)) == 1
    near.delete(path)
    far.delete(back)


def test_a_source_that_is_away_is_told_later(
    near: httpx.Client, source: ScriptedSource, kind: str, subscriber: Any
) -> None:
    register(near, source.url, {"type": kind}, operations=OPERATIONS)
    source.answers["POST", "/ngsi-ld/v1/subscriptions"] = 500, {}
    document = {
        "type": "Subscription",
        "entities": [{"type": kind}],
        "notification": {"endpoint": {"uri": subscriber.url}},
    }
    answer = near.post("/subscriptions", json=document)
    assert answer.status_code == 201
    assert answer.headers["ngsild-warning"].startswith("199")
    source.answers["POST", "/ngsi-ld/v1/subscriptions"] = 201, {}
    path = answer.headers["location"].removeprefix("/ngsi-ld/v1")
    assert near.patch(path, json={"description": "again"}).status_code == 204
    sent = [one for one in source.asked if one[0] == "POST"]
    assert sent[-1][4]["notification"]["endpoint"]["uri"].startswith("http://127.0.0.1:")
    assert sent[-1][4]["id"] != path.rpartition("/")[2]


def test_what_is_passed_on_is_known_after_a_restart(
    own_broker: Any, source: ScriptedSource, kind: str, subscriber: Any, eventually: Eventually
) -> None:
    own_broker.start()
    source.answers["POST", "/ngsi-ld/v1/subscriptions"] = 201, {}
    with own_broker.client() as client:
        registration = register(client, source.url, {"type": kind}, operations=OPERATIONS)
        subscribe(client, kind, subscriber.url)
    (sent,) = (one[4] for one in source.asked if one[0] == "POST")
    own_broker.kill()
    own_broker.start()
    told = {"data": [{"id": f"urn:ngsi-ld:{kind}:1", "type": kind, "n": {"type": "Property", "value": 1}}]}
    uri = sent["notification"]["endpoint"]["uri"]
    assert httpx.post(uri, json=told, trust_env=False).status_code == 200
    eventually(lambda: subscriber.received)
    with own_broker.client() as client:
        source.answers["DELETE", f"/ngsi-ld/v1/subscriptions/{sent['id']}"] = 204, None
        client.delete(registration)
    eventually(lambda: any(one[0] == "DELETE" for one in source.asked))
    eventually(lambda: httpx.post(uri, json=told, trust_env=False).status_code == 404)
    assert len([one for one in source.asked if one[0] == "POST"]) == 1


def test_what_is_for_this_broker_alone_is_not_passed_on(
    near: httpx.Client, source: ScriptedSource, kind: str, subscriber: Any
) -> None:
    register(near, source.url, {"type": kind}, operations=OPERATIONS)
    subscribe(near, kind, subscriber.url, localOnly=True)
    document = {"type": "Subscription", "entities": [{"type": kind}],
                "notification": {"endpoint": {"uri": subscriber.url}}}  # fmt: skip
    assert near.post("/subscriptions?local=true", json=document).status_code == 201
    assert source.asked == []
