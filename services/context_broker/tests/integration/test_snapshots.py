"""Snapshots: creation, clones, changes, purge, expiry and restarts."""

import sqlite3
from collections.abc import Callable
from contextlib import closing
from typing import Any

import httpx
import pytest

from tests.kit.context_sources import ScriptedSource, register

from .conftest import BrokerProcess, Subscriber, wait_for

PATH = "/snapshots"


def create(http: httpx.Client, one: str, kind: str, speed: int, **kept: Any) -> None:
    entity = {"id": one, "type": kind, "speed": {"type": "Property", "value": speed}}
    assert http.post("/entities", json=entity, **kept).status_code == 201


def query(kind: str, **members: Any) -> dict[str, Any]:
    return {"type": "Query", "entities": [{"type": kind}], **members}


def snapshot(http: httpx.Client, *queries: dict[str, Any], **members: Any) -> dict[str, Any]:
    answer = http.post(PATH, json={"type": "Snapshot", "snapshotQueries": list(queries), **members})
    assert answer.status_code == 201, answer.text
    return made(http, answer)


def made(http: httpx.Client, answer: httpx.Response) -> dict[str, Any]:
    at = answer.headers["location"].removeprefix("/ngsi-ld/v1")

    def ready() -> Any:
        document = http.get(at).json()
        return document if document["snapshotStatus"] != "preparing" else None

    found: dict[str, Any] = wait_for(ready)
    return found


def inside(one: dict[str, Any]) -> dict[str, str]:
    return {"NGSILD-Snapshot": one["id"]}


def test_a_snapshot_keeps_the_results_of_its_queries(http: httpx.Client) -> None:
    create(http, "urn:ngsi-ld:Frozen:fast", "Frozen", 80)
    create(http, "urn:ngsi-ld:Frozen:slow", "Frozen", 30)
    one = snapshot(http, query("Frozen", q="speed>50"))
    assert (one["snapshotStatus"], one["snapshotPriority"]) == ("success", 5)
    assert one["snapshotQueriesDetails"] == [{"resultStatus": "success"}]
    assert one["lastUsedAt"] == one["createdAt"] < one["expiresAt"]
    answer = http.get("/entities", params={"type": "Frozen"}, headers=inside(one))
    assert [each["id"] for each in answer.json()] == ["urn:ngsi-ld:Frozen:fast"]
    assert answer.headers["ngsild-snapshot"] == one["id"]
    change = {"speed": {"type": "Property", "value": 1}}
    assert http.patch("/entities/urn:ngsi-ld:Frozen:fast/attrs", json=change).status_code == 204
    frozen = http.get("/entities/urn:ngsi-ld:Frozen:fast", headers=inside(one)).json()
    assert frozen["speed"]["value"] == 80
    assert http.get(f"{PATH}/{one['id']}").json()["lastUsedAt"] > one["lastUsedAt"]


def test_changes_inside_a_snapshot_stay_inside(
    http: httpx.Client, subscriber: Subscriber, eventually: Callable[..., Any]
) -> None:
    create(http, "urn:ngsi-ld:Inside:1", "Inside", 80)
    one = snapshot(http, query("Inside"))
    subscription = {
        "type": "Subscription",
        "entities": [{"type": "Inside"}],
        "notification": {"endpoint": {"uri": subscriber.url}},
    }
    assert http.post("/subscriptions", json=subscription, headers=inside(one)).status_code == 201
    change = {"speed": {"type": "Property", "value": 5}}
    assert http.patch("/entities/urn:ngsi-ld:Inside:1", json=change).status_code == 204
    change = {"speed": {"type": "Property", "value": 10}}
    answer = http.patch("/entities/urn:ngsi-ld:Inside:1", json=change, headers=inside(one))
    assert answer.status_code == 204
    eventually(lambda: subscriber.received)
    assert [each["speed"]["value"] for each in subscriber.entities()] == [10]
    assert subscriber.headers[0]["ngsild-snapshot"] == one["id"]
    assert "ngsild-tenant" not in subscriber.headers[0]
    assert http.get("/entities/urn:ngsi-ld:Inside:1").json()["speed"]["value"] == 5
    create(http, "urn:ngsi-ld:Inside:2", "Inside", 1, headers=inside(one))
    assert http.get("/entities/urn:ngsi-ld:Inside:2").status_code == 404
    assert http.get("/types", headers=inside(one)).json()["typeList"] == ["Inside"]


def test_a_clone_is_independent(http: httpx.Client) -> None:
    create(http, "urn:ngsi-ld:Cloned:1", "Cloned", 80)
    one = snapshot(http, query("Cloned"), snapshotPriority=2)
    answer = http.post(f"{PATH}/{one['id']}/clone", json={"type": "Snapshot", "snapshotPriority": 9})
    assert answer.status_code == 201
    clone = made(http, answer)
    assert (clone["snapshotStatus"], clone["snapshotPriority"]) == ("success", 9)
    assert clone["snapshotQueries"] == one["snapshotQueries"]
    assert http.delete("/entities/urn:ngsi-ld:Cloned:1", headers=inside(clone)).status_code == 204
    assert http.get("/entities/urn:ngsi-ld:Cloned:1", headers=inside(one)).status_code == 200
    assert http.delete(f"{PATH}/{one['id']}").status_code == 204
    assert http.get("/entities/urn:ngsi-ld:Cloned:1", headers=inside(one)).status_code == 404
    assert http.get("/entities", params={"type": "Cloned"}, headers=inside(clone)).json() == []
    assert http.post(f"{PATH}/{clone['id']}/clone", json={"snapshotQueries": []}).status_code == 400


def test_snapshots_are_purged_by_their_members(http: httpx.Client) -> None:
    low, high = (snapshot(http, query("Nothing"), snapshotPriority=each) for each in (1, 8))
    assert low["snapshotStatus"] == "empty"
    assert http.delete(PATH).status_code == 400
    refused = http.delete(PATH, params={"q": "speed>50"})
    assert refused.status_code == 400
    assert refused.json()["type"].endswith("BadRequestData")
    assert http.delete(PATH, params={"q": 'snapshotPriority<2;snapshotStatus=="empty"'}).status_code == 204
    assert http.get(f"{PATH}/{low['id']}").status_code == 404
    assert http.get(f"{PATH}/{high['id']}").status_code == 200


def test_a_change_of_a_snapshot_sets_priority_lifetime_and_endpoint(http: httpx.Client) -> None:
    one = snapshot(http, query("Nothing"), snapshotLifetime="PT1H")
    at = f"{PATH}/{one['id']}"
    changed = http.patch(at, json={"snapshotPriority": 9, "snapshotLifetime": "PT2H"})
    assert changed.status_code == 200
    assert changed.json()["snapshotPriority"] == 9
    assert changed.json()["expiresAt"] > one["expiresAt"]
    assert http.patch(at, json={"snapshotQueries": []}).status_code == 400
    assert http.patch(at, json={"snapshotPriority": 11}).status_code == 400
    assert http.patch(f"{PATH}/urn:ngsi-ld:Snapshot:absent", json={}).status_code == 404


def test_the_endpoint_is_notified_of_creation_and_deletion(
    http: httpx.Client, subscriber: Subscriber, eventually: Callable[..., Any]
) -> None:
    create(http, "urn:ngsi-ld:Announced:1", "Announced", 80)
    info = [{"key": "X-Cell", "value": "4"}]
    one = snapshot(http, query("Announced"), endpoint=subscriber.url, receiverInfo=info)
    eventually(lambda: subscriber.received)
    notified = subscriber.received[0]
    assert (notified["type"], notified["snapshotId"]) == ("SnapshotNotification", one["id"])
    assert notified["snapshotStatus"] == "success"
    assert notified["notifiedAt"] < notified["expiresAt"]
    assert subscriber.headers[0]["x-cell"] == "4"
    http.delete(f"{PATH}/{one['id']}")
    eventually(lambda: len(subscriber.received) == 2)
    assert subscriber.received[1]["expiresAt"] <= subscriber.received[1]["notifiedAt"]


@pytest.mark.nightly
def test_pending_snapshot_notifications_survive_a_crash(
    own_broker: BrokerProcess, subscriber: Subscriber, eventually: Callable[..., Any]
) -> None:
    subscriber.status = 503
    own_broker.start()
    with own_broker.client() as http:
        create(http, "urn:ngsi-ld:Pending:1", "Pending", 80)
        one = snapshot(http, query("Pending"), endpoint=subscriber.url)
        http.patch(f"{PATH}/{one['id']}", json={"snapshotPriority": 9})
        assert http.delete(f"{PATH}/{one['id']}").status_code == 204
    own_broker.kill()
    subscriber.status = 200
    own_broker.start()
    eventually(lambda: len(subscriber.received) >= 3)
    notified = [(one["snapshotStatus"], one["snapshotPriority"]) for one in subscriber.received]
    assert notified[-3:] == [("success", 5), ("success", 9), ("success", 9)]
    assert subscriber.received[-1]["expiresAt"] <= subscriber.received[-1]["notifiedAt"]
    so_far = len(subscriber.received)
    own_broker.stop()
    own_broker.start()
    with own_broker.client() as http:  # its notification would follow any pending one
        snapshot(http, query("Pending"), endpoint=subscriber.url, snapshotPriority=3)
    eventually(lambda: len(subscriber.received) > so_far)
    assert subscriber.received[so_far]["snapshotPriority"] == 3


@pytest.mark.parametrize(
    "members",
    [
        {},
        {"snapshotQueries": []},
        {"snapshotQueries": 3},
        {"snapshotQueries": [query("A", temporalQ={"timerel": "after", "timeAt": "2020-01-01T00:00:00Z"})]},
        {"snapshotTemporalQueries": [query("A")]},
        {"snapshotQueries": [query("A")], "type": "Task"},
        {"snapshotQueries": [query("A")], "snapshotPriority": 11},
        {"snapshotQueries": [query("A")], "snapshotLifetime": "soon"},
        {"snapshotQueries": [query("A")], "snapshotStatus": "success"},
        {"snapshotQueries": [query("A")], "endpoint": "nowhere"},
        {"snapshotQueries": [query("A")], "receiverInfo": 3},
        {"snapshotQueries": [query("A")], "colour": "red"},
        {"snapshotQueries": [query("A")], "id": "no uri"},
    ],
)
def test_invalid_snapshots_are_refused(http: httpx.Client, members: dict[str, Any]) -> None:
    assert http.post(PATH, json=members).status_code == 400


def test_a_failed_query_is_reported_in_the_snapshot(http: httpx.Client) -> None:
    create(http, "urn:ngsi-ld:Half:1", "Half", 80)
    one = snapshot(http, query("Half"), query("Half", q="((("))
    assert one["snapshotStatus"] == "partial"
    assert one["snapshotQueriesDetails"][1]["problemDetails"]["status"] == 400


def test_a_snapshot_has_history_if_requested(http: httpx.Client) -> None:
    create(http, "urn:ngsi-ld:Passed:1", "Passed", 80)
    change = {"speed": {"type": "Property", "value": 90}}
    assert http.patch("/entities/urn:ngsi-ld:Passed:1/attrs", json=change).status_code == 204
    when = {"timerel": "after", "timeAt": "2020-01-01T00:00:00Z", "timeproperty": "createdAt"}
    body = {
        "snapshotQueries": [query("Passed")],
        "snapshotTemporalQueries": [query("Passed", temporalQ=when)],
    }
    one = made(http, http.post(PATH, json=body))
    assert one["snapshotStatus"] == "success", one
    assert one["snapshotTemporalQueriesDetails"] == [{"resultStatus": "success"}]
    http.patch("/entities/urn:ngsi-ld:Passed:1/attrs", json={"speed": {"type": "Property", "value": 100}})
    clone = made(http, http.post(f"{PATH}/{one['id']}/clone", json={}))
    for each in (one, clone):
        notified = http.get("/temporal/entities/urn:ngsi-ld:Passed:1", headers=inside(each)).json()
        assert sorted(instance["value"] for instance in notified["speed"]) == [80, 90]
    assert len(http.get("/temporal/entities/urn:ngsi-ld:Passed:1").json()["speed"]) == 3


def test_snapshots_belong_to_their_tenant(http: httpx.Client) -> None:
    tenant = {"NGSILD-Tenant": "cell9"}
    create(http, "urn:ngsi-ld:Owned:1", "Owned", 80, headers=tenant)
    answer = http.post(PATH, json={"snapshotQueries": [query("Owned")]}, headers=tenant)
    at = answer.headers["location"].removeprefix("/ngsi-ld/v1")
    one = wait_for(
        lambda: next(
            (
                notified
                for notified in [http.get(at, headers=tenant).json()]
                if notified["snapshotStatus"] == "success"
            ),
            None,
        )
    )
    assert len(http.get("/entities", params={"type": "Owned"}, headers={**tenant, **inside(one)}).json()) == 1
    assert http.get("/entities", params={"type": "Owned"}, headers=inside(one)).status_code == 404
    assert http.get(at).status_code == 404
    assert (
        http.get("/entities", params={"type": "Owned"}, headers={"NGSILD-Snapshot": "x"}).status_code == 400
    )


@pytest.mark.nightly
def test_snapshots_survive_a_crash_and_expire(
    own_broker: BrokerProcess, eventually: Callable[..., Any]
) -> None:
    own_broker.start()
    with own_broker.client() as http:
        create(http, "urn:ngsi-ld:Kept:1", "Kept", 80)
        stays = snapshot(http, query("Kept"))
        goes = snapshot(http, query("Kept"), snapshotLifetime="PT4S")
        http.delete("/entities/urn:ngsi-ld:Kept:1")
    own_broker.kill()
    own_broker.start()
    with own_broker.client() as http:
        assert http.get("/entities/urn:ngsi-ld:Kept:1").status_code == 404
        assert http.get("/entities/urn:ngsi-ld:Kept:1", headers=inside(stays)).status_code == 200
        eventually(lambda: http.get(f"{PATH}/{goes['id']}").status_code == 404)
        eventually(lambda: own_broker.metric("handover_broker_entities") == 1)
        assert http.delete(f"{PATH}/{stays['id']}").status_code == 204
        assert own_broker.metric("handover_broker_entities") == 0


@pytest.mark.nightly
@pytest.mark.parametrize("own_broker", ["sqlite"], indirect=True)
def test_leftovers_of_a_snapshot_are_deleted_after_a_crash(
    own_broker: BrokerProcess, eventually: Callable[..., Any]
) -> None:
    own_broker.start()
    with own_broker.client() as http:
        create(http, "urn:ngsi-ld:Left:1", "Left", 80)
        snapshot(http, query("Left"))
    own_broker.stop()
    with closing(
        sqlite3.connect(own_broker.data_dir / "broker.db")
    ) as database:  # as if the power was cut while deleting
        database.execute("DELETE FROM documents WHERE kind = 'snapshot'")
        database.commit()
    own_broker.start()
    eventually(lambda: own_broker.metric("handover_broker_entities") == 1)
    own_broker.kill()
    own_broker.start()
    assert own_broker.metric("handover_broker_entities") == 1


@pytest.mark.nightly
def test_a_snapshot_interrupted_by_a_crash_has_failed_with_a_reason(
    own_broker: BrokerProcess,
    subscriber: Subscriber,
    source: ScriptedSource,
    eventually: Callable[..., Any],
) -> None:
    own_broker.start()
    source.go_on.clear()  # so that the snapshot is not made before the power is cut
    with own_broker.client() as http:
        register(http, source.url, {"type": "Cut"}, operations=["queryBatch"])
        answer = http.post(PATH, json={"snapshotQueries": [query("Cut")], "endpoint": subscriber.url})
        at = answer.headers["location"].removeprefix("/ngsi-ld/v1")
        eventually(lambda: source.asked)
        assert http.get(at).json()["snapshotStatus"] == "preparing"
    own_broker.kill()
    own_broker.start()
    with own_broker.client() as http:
        one = made(http, answer)
    assert one["snapshotStatus"] == "failure"
    (reason,) = one["snapshotQueriesDetails"]
    assert "stopped while it created" in reason["problemDetails"]["detail"]
    eventually(lambda: subscriber.received)
    assert subscriber.received[0]["snapshotStatus"] == "failure"
    assert subscriber.received[0]["snapshotQueriesDetails"] == [reason]
