"""Subscriptions forwarded to other brokers, their notifications and their deletion."""

from collections.abc import Callable
from typing import Any

import httpx
import pytest

from tests.kit.context_sources import ScriptedSource, put, register

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


def test_subscribers_are_notified_of_changes_at_sources(
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
    eventually(lambda: near.get(path).json()["notification"].get("timesSent") == 2)
    near.delete(path)
    eventually(lambda: not subscriptions(far, kind))


def test_subscriptions_follow_added_and_deleted_registrations(
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


def test_a_notification_has_the_merged_entity_within_the_registration(
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


def test_brokers_that_register_each_other_do_not_subscribe_in_a_loop(
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


def test_forwarding_is_retried_until_the_source_is_back(
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


@pytest.mark.nightly
def test_forwarded_subscriptions_survive_a_restart(
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
    notified = {
        "data": [{"id": f"urn:ngsi-ld:{kind}:1", "type": kind, "n": {"type": "Property", "value": 1}}]
    }
    uri = sent["notification"]["endpoint"]["uri"]
    assert httpx.post(uri, json=notified, trust_env=False, timeout=120).status_code == 200
    eventually(lambda: subscriber.received)
    with own_broker.client() as client:
        source.answers["DELETE", f"/ngsi-ld/v1/subscriptions/{sent['id']}"] = 204, None
        client.delete(registration)
    eventually(lambda: any(one[0] == "DELETE" for one in source.asked))
    eventually(lambda: httpx.post(uri, json=notified, trust_env=False, timeout=120).status_code == 404)
    assert len([one for one in source.asked if one[0] == "POST"]) == 1


def test_local_only_subscriptions_are_not_forwarded(
    near: httpx.Client, source: ScriptedSource, kind: str, subscriber: Any
) -> None:
    register(near, source.url, {"type": kind}, operations=OPERATIONS)
    subscribe(near, kind, subscriber.url, localOnly=True)
    document = {"type": "Subscription", "entities": [{"type": kind}],
                "notification": {"endpoint": {"uri": subscriber.url}}}  # fmt: skip
    assert near.post("/subscriptions?local=true", json=document).status_code == 201
    assert source.asked == []


def test_previous_and_deleted_values_of_a_source_are_notified(
    near: httpx.Client, far: httpx.Client, kind: str, subscriber: Any, eventually: Eventually
) -> None:
    register(near, str(far.base_url), {"type": kind}, operations=OPERATIONS)
    one = put(far, f"urn:ngsi-ld:{kind}:1", kind, n=1, m=2, o=3)
    put(near, one, kind, here=9)
    notification = {"endpoint": {"uri": subscriber.url}, "showChanges": True, "sysAttrs": False}
    triggers = ["attributeUpdated", "attributeDeleted", "entityDeleted"]
    path = subscribe(near, kind, subscriber.url, notification=notification, notificationTrigger=triggers)
    far.patch(f"/entities/{one}/attrs", json={"n": 5})
    eventually(lambda: len(subscriber.received) == 1)
    far.delete(f"/entities/{one}/attrs/m")
    eventually(lambda: len(subscriber.received) == 2)
    far.delete(f"/entities/{one}")
    eventually(lambda: len(subscriber.received) == 3)
    changed, lost, gone = subscriber.entities()
    assert changed["n"] == {"type": "Property", "value": 5, "previousValue": 1}
    assert changed["here"]["value"] == 9
    assert "createdAt" not in changed
    assert lost["m"]["value"] == "urn:ngsi-ld:null"
    assert lost["m"]["previousValue"] == 2
    assert lost["o"]["value"] == 3
    assert gone["deletedAt"]
    assert gone["o"]["previousValue"] == 3
    near.delete(path)


def test_deletions_at_a_source_are_notified_in_the_requested_representation(
    near: httpx.Client, far: httpx.Client, kind: str, subscriber: Any, eventually: Eventually
) -> None:
    register(near, str(far.base_url), {"type": kind}, operations=OPERATIONS)
    one = put(far, f"urn:ngsi-ld:{kind}:1", kind, n=1, m=2)
    notification = {"endpoint": {"uri": subscriber.url}, "format": "keyValues"}
    triggers = ["attributeDeleted", "entityDeleted"]
    path = subscribe(near, kind, subscriber.url, notification=notification, notificationTrigger=triggers)
    far.delete(f"/entities/{one}/attrs/m")
    eventually(lambda: len(subscriber.received) == 1)
    far.delete(f"/entities/{one}")
    eventually(lambda: len(subscriber.received) == 2)
    lost, gone = subscriber.entities()
    assert lost == {"id": one, "type": kind, "n": 1, "m": "urn:ngsi-ld:null"}
    assert (gone["n"], gone["type"]) == ("urn:ngsi-ld:null", kind)
    near.delete(path)


def sent_to(source: ScriptedSource) -> dict[str, Any]:
    """Return the subscription that a source was given last."""
    document: dict[str, Any] = [one[4] for one in source.asked if one[0] == "POST"][-1]
    return document


def test_a_forwarded_subscription_is_limited_to_the_registration(
    near: httpx.Client, source: ScriptedSource, kind: str, subscriber: Any
) -> None:
    source.answers["POST", "/ngsi-ld/v1/subscriptions"] = 201, None
    register(near, source.url, {"type": kind}, ["a", "b"], operations=OPERATIONS)
    entities = [{"type": f"{kind},Other"}, {"type": "Other"}, {"type": f"(Big;{kind})", "idPattern": "x"}]
    path = subscribe(near, kind, subscriber.url, entities=entities)
    sent = sent_to(source)
    assert sent["entities"] == [{"type": kind}, {"type": f"(Big;{kind})", "idPattern": "x"}]
    assert sent["watchedAttributes"] == ["a", "b"]
    near.delete(path)
    path = subscribe(near, kind, subscriber.url, watchedAttributes=["b", "c"], entities=[{"type": kind}])
    assert sent_to(source)["watchedAttributes"] == ["b"]
    near.delete(path)
    one = f"urn:ngsi-ld:{kind}:1"
    register(near, source.url, {"type": f"{kind}x", "id": one}, operations=OPERATIONS)
    path = subscribe(near, f"{kind}x", subscriber.url, timeInterval=3600)
    assert sent_to(source)["entities"] == [{"id": one, "type": f"{kind}x"}]
    near.delete(path)


def test_an_older_source_receives_members_of_its_version(
    near: httpx.Client, source: ScriptedSource, kind: str, subscriber: Any
) -> None:
    source.answers["POST", "/ngsi-ld/v1/subscriptions"] = 201, None
    info = [{"key": "ngsildConformance", "value": "1.3"}]
    register(near, source.url, {"type": kind}, operations=OPERATIONS, contextSourceInfo=info)
    notification = {"endpoint": {"uri": subscriber.url}, "showChanges": True}
    more = {"notification": notification, "notificationTrigger": ["entityUpdated"], "scopeQ": "/A"}
    path = subscribe(near, kind, subscriber.url, **more)
    sent = sent_to(source)
    assert sent.keys() == {"id", "type", "entities", "notification"}
    assert sent["entities"] == [{"type": kind}]
    assert sent["notification"].keys() == {"format", "endpoint"}
    near.delete(path)


def test_a_source_without_delete_has_its_subscription_paused(
    near: httpx.Client, source: ScriptedSource, kind: str, subscriber: Any, eventually: Eventually
) -> None:
    source.answers["POST", "/ngsi-ld/v1/subscriptions"] = 201, None
    path = register(near, source.url, {"type": kind}, operations=["createSubscription"])
    near.delete(subscribe(near, kind, subscriber.url))
    assert [one[0] for one in source.asked] == ["POST"]
    uri = sent_to(source)["notification"]["endpoint"]["uri"]
    assert httpx.post(uri, json={"data": []}, trust_env=False, timeout=120).status_code == 404
    near.delete(path)
    register(near, source.url, {"type": kind}, operations=["createSubscription", "updateSubscription"])
    subscription = subscribe(near, kind, subscriber.url)
    source.answers["PATCH", f"/ngsi-ld/v1/subscriptions/{sent_to(source)['id']}"] = 204, None
    near.delete(subscription)
    assert (source.asked[-1][0], source.asked[-1][4]["isActive"]) == ("PATCH", False)


def test_a_ring_of_brokers_notifies_a_change_once(
    brokers: list[Any], kind: str, subscriber: Any, eventually: Eventually
) -> None:
    clients = [one.client() for one in brokers]
    paths = [
        register(client, brokers[(place + 1) % 3].url, {"type": kind}, operations=OPERATIONS)
        for place, client in enumerate(clients)
    ]
    path = subscribe(clients[0], kind, subscriber.url)
    assert [len(subscriptions(client, kind)) for client in clients] == [1, 1, 1]
    for place, client in enumerate(clients):
        put(client, f"urn:ngsi-ld:{kind}:{place}", kind, n=place)
    eventually(lambda: len(subscriber.received) == 3)
    clients[0].delete(path)
    eventually(lambda: not any(subscriptions(client, kind) for client in clients))
    assert sorted(one["n"]["value"] for one in subscriber.entities()) == [0, 1, 2]
    for client, each in zip(clients, paths, strict=True):
        client.delete(each)
        client.close()
