"""Secrets of subscriptions, registrations and snapshots are never read; services keep their own."""

import json
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover.security.permissions import Role
from services.context_broker.tests.integration.conftest import BrokerProcess, Subscriber
from services.context_broker.tests.integration.secured import SecuredBroker, secured_broker
from tests.kit.context_sources import ScriptedSource
from tests.kit.waiting import wait_for

SECRET = "s3cret-key-of-a-service"
HIDDEN = "********"
AT = "http://user:{secret}@127.0.0.1:9/hook/{secret}0123456789?token={secret}&more={secret}"
INFO = [{"key": "Authorization", "value": f"Bearer {SECRET}"}, {"key": "X-Key", "value": SECRET}]


def subscription(uri: str, **members: Any) -> dict[str, Any]:
    return {
        "id": "urn:ngsi-ld:Subscription:s",
        "type": "Subscription",
        "entities": [{"type": "Task"}],
        "notification": {"endpoint": {"uri": uri, "receiverInfo": INFO}},
        **members,
    }


def documents(to: str) -> dict[str, dict[str, Any]]:
    """Return documents with secrets, by the path they are posted to."""
    return {
        "/subscriptions": subscription(to),
        "/csourceSubscriptions": {**subscription(to), "id": "urn:ngsi-ld:Subscription:c"},
        "/csourceRegistrations": {
            "id": "urn:ngsi-ld:ContextSourceRegistration:r",
            "type": "ContextSourceRegistration",
            "endpoint": f"http://user:{SECRET}@127.0.0.1:9/{SECRET}0123456789",
            "information": [{"entities": [{"type": "Task"}]}],
            "contextSourceInfo": INFO,
        },
        "/snapshots": {
            "id": "urn:ngsi-ld:Snapshot:s",
            "type": "Snapshot",
            "snapshotQueries": [{"type": "Query", "entities": [{"type": "Task"}]}],
            "endpoint": to,
            "receiverInfo": INFO,
        },
    }


@pytest.mark.nightly
def test_no_answer_notification_or_log_has_a_secret(
    own_broker: BrokerProcess, subscriber: Subscriber, source: ScriptedSource
) -> None:
    to = AT.format(secret=SECRET)
    own_broker.start()
    with own_broker.client() as http:
        watching = {"notification": {"endpoint": {"uri": f"{subscriber.url}/n"}}}
        body = {**subscription("http://127.0.0.1:9/"), **watching, "id": "urn:ngsi-ld:Subscription:w"}
        assert http.post("/csourceSubscriptions", json=body).status_code == 201
        for path, document in documents(to).items():
            made = http.post(path, json=document)
            assert made.status_code == 201, (path, made.text)
            assert SECRET not in f"{made.headers}{made.text}"
            one = f"{path}/{document['id']}"
            listing = {"/snapshots": one, "/csourceRegistrations": f"{path}?type=Task"}.get(path, path)
            for at in (listing, one, *([] if path == "/snapshots" else [f"{one}?options=sysAttrs"])):
                answer = http.get(at)
                assert answer.status_code == 200, (at, answer.text)
                assert SECRET not in answer.text, at
        wait_for(lambda: "urn:ngsi-ld:ContextSourceRegistration:r" in str(subscriber.received))
        assert SECRET not in str(subscriber.received)
        http.post("/entities", json={"id": "urn:ngsi-ld:Task:1", "type": "Task"})
        assert SECRET not in f"{http.get('/entities?type=Task').headers}"
        for csf in (f'endpoint~="{SECRET}.*"', 'endpoint~=".*user:s.*"'):
            answer = http.get("/csourceRegistrations", params={"csf": csf, "type": "Task"})
            assert answer.status_code == 200
            assert answer.json() == [], "a filter finds out no secret"
        answer = http.delete("/snapshots", params={"q": f'receiverInfo~="{SECRET}"'})
        assert answer.status_code == 400
        assert SECRET not in http.get(f"{own_broker.url}/metrics").text
    own_broker.kill()
    own_broker.start()
    own_broker.stop()
    assert SECRET not in own_broker.log()


def test_what_was_read_can_be_changed_and_written_but_no_secret_follows_an_address(
    http: httpx.Client, subscriber: Subscriber, source: ScriptedSource
) -> None:
    at = f"/subscriptions/{subscription('x')['id']}"
    uri = f"{subscriber.url}/n?token={SECRET}"
    assert http.post("/subscriptions", json=subscription(uri)).status_code == 201
    read = http.get(at).json()
    assert HIDDEN in read["notification"]["endpoint"]["uri"]
    change = {name: value for name, value in read.items() if name not in {"id", "jsonldContext"}}
    assert http.patch(at, json={**change, "description": "mine"}).status_code == 204
    http.post("/entities", json={"id": "urn:ngsi-ld:Task:1", "type": "Task", "status": {"value": "pending"}})
    wait_for(lambda: subscriber.received)
    assert subscriber.headers[-1]["authorization"] == f"Bearer {SECRET}"
    elsewhere = {"endpoint": {**read["notification"]["endpoint"], "uri": "http://127.0.0.1:9/thief"}}
    refused = http.patch(at, json={"notification": elsewhere})
    assert (refused.status_code, "give the value" in refused.text) == (400, True), refused.text
    half = {"endpoint": {"uri": f"http://127.0.0.1:9/n?token={HIDDEN}"}}
    assert http.patch(at, json={"notification": half}).status_code == 400
    again = subscription(f"http://127.0.0.1:9/n?token={HIDDEN}", id="urn:ngsi-ld:Subscription:t")
    assert http.post("/subscriptions", json=again).status_code == 400

    registration = {**documents("")["/csourceRegistrations"], "endpoint": "http://127.0.0.1:9"}
    assert http.post("/csourceRegistrations", json=registration).status_code == 201
    at = f"/csourceRegistrations/{registration['id']}"
    refused = http.patch(at, json={"endpoint": source.url})
    assert (refused.status_code, "contextSourceInfo" in refused.text) == (400, True)
    assert http.patch(at, json={"endpoint": source.url, "contextSourceInfo": None}).status_code == 204
    http.get("/entities?type=Task")
    wait_for(lambda: source.asked)
    assert SECRET not in str(source.asked)
    http.delete(at)

    snapshot = documents("http://127.0.0.1:9/ready")["/snapshots"]
    assert http.post("/snapshots", json=snapshot).status_code == 201
    at = f"/snapshots/{snapshot['id']}"
    assert http.patch(at, json={"endpoint": f"{subscriber.url}/thief"}).status_code == 400
    shown = http.get(at).json()
    kept = {"endpoint": shown["endpoint"], "receiverInfo": shown["receiverInfo"], "snapshotPriority": 7}
    assert http.patch(at, json=kept).status_code == 200
    assert http.get(at).json()["snapshotPriority"] == 7


@pytest.fixture(scope="module")
def secured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SecuredBroker]:
    with secured_broker(tmp_path_factory.mktemp("secured")) as made:
        yield made


@pytest.mark.nightly
def test_a_subscription_of_a_service_is_changed_by_that_service_alone(secured: SecuredBroker) -> None:
    to, service = "http://127.0.0.1:9/n", secured.service("trajectory-tool")
    other, engineer = secured.service("human-state"), secured.caller(Role.ENGINEER)
    admin = secured.caller(Role.ENGINEER, Role.ADMIN)
    for path, given in documents(to).items():
        if path == "/snapshots":
            continue
        document = {**given, "endpoint": to} if "endpoint" in given else given
        at = f"{path}/{document['id']}"
        assert service.post(path, json=document).status_code == 201
        before = service.get(at).json()
        for caller in (engineer, other, admin):
            for change in (
                {"description": "mine"},
                {"isActive": False},
                {"notification": {"endpoint": {"uri": "http://127.0.0.1:9/thief"}}},
            ):
                answer = caller.patch(at, json=change)
                assert answer.status_code in {400, 403}, (at, change, answer.text)
            if caller is not admin:
                refused = caller.delete(at)
                assert refused.status_code == 403, at
                assert "trajectory-tool" in refused.json()["detail"]
        assert service.get(at).json() == before
        assert service.patch(at, json={"description": "changed"}).status_code == 204
        assert admin.delete(at).status_code == 204, "of a service that is no more"
    assert engineer.post("/subscriptions", json=subscription(to)).status_code == 201
    at = f"/subscriptions/{subscription(to)['id']}"
    assert service.patch(at, json={"description": "of the service"}).status_code == 204
    assert engineer.delete(at).status_code == 403, "who changes it last is its owner"


def test_credentials_of_a_client_are_passed_on_to_nobody(
    secured: SecuredBroker, subscriber: Subscriber, source: ScriptedSource
) -> None:
    engineer, service = secured.caller(Role.ENGINEER), secured.service()
    taken = [{"key": key, "value": "urn:ngsi-ld:request"} for key in ("Authorization", "Cookie", "X-Cell")]
    body = {**subscription("x"), "id": "urn:ngsi-ld:Subscription:taken"}
    body["notification"] = {"endpoint": {"uri": f"{subscriber.url}/n", "receiverInfo": taken}}
    assert engineer.post("/subscriptions", json=body).status_code == 201
    registration = {
        "type": "ContextSourceRegistration",
        "endpoint": source.url,
        "information": [{"entities": [{"type": "Task"}]}],
        "operations": ["createEntity"],
        "contextSourceInfo": taken,
    }
    assert engineer.post("/csourceRegistrations", json=registration).status_code == 201
    task = {
        "id": "urn:ngsi-ld:Task:taken",
        "type": "Task",
        "status": {"type": "Property", "value": "pending"},
    }
    service.post("/entities", json=task, headers={"X-Cell": "4", "Cookie": "session=1"})
    wait_for(lambda: subscriber.headers and source.asked)
    for headers in (subscriber.headers[0], source.asked[0][3]):
        assert headers["x-cell"] == "4"
        assert "authorization" not in headers
        assert "cookie" not in headers


@pytest.mark.nightly
def test_subscriptions_of_the_present_version_have_no_owner_until_somebody_changes_them(
    tmp_path: Path, subscriber: Subscriber
) -> None:
    with secured_broker(tmp_path) as secured:
        researcher = secured.caller(Role.ENGINEER, Role.RESEARCHER)
        body = subscription(f"{subscriber.url}/n", entities=[{"type": "HumanState"}])
        assert researcher.post("/subscriptions", json=body).status_code == 201
        secured.cell.processes["context_broker"].terminate()
        secured.cell.processes.pop("context_broker").wait(60)
        as_of_an_earlier_version(tmp_path / "broker.db")
        secured.cell.start("context_broker", within_s=90)
        service = secured.service()
        state = {"id": "urn:ngsi-ld:HumanState:demo:1", "type": "HumanState"}
        state["heartRate"] = {"type": "Property", "value": 71}  # type: ignore[assignment]
        assert service.post("/entities", json=state).status_code == 201
        at = f"/subscriptions/{body['id']}"
        assert researcher.patch(at, json={"description": "mine"}).status_code == 204
        state["heartRate"] = {"type": "Property", "value": 72}  # type: ignore[assignment]
        assert service.post("/entityOperations/upsert", json=[state]).status_code == 204
        wait_for(lambda: subscriber.received)
        assert "71" not in str([one["data"] for one in subscriber.received])
        assert "has no owner" in secured.cell.log("context_broker")


def as_of_an_earlier_version(database: Path) -> None:
    """Remove the owner from the stored subscriptions."""
    from handover_broker.storage import checksums

    with sqlite3.connect(database) as connection:
        rows = connection.execute("SELECT kind, tenant, id, body FROM documents").fetchall()
        for kind, tenant, name, body in rows:
            if kind == "subscription":
                document = json.loads(body)
                del document["owner"]
                written = json.dumps(document).encode()
                checksum = checksums.of_document(kind, tenant, name, written)
                connection.execute(
                    "UPDATE documents SET body = ?, checksum = ? WHERE kind = ? AND id = ?",
                    (written, checksum, kind, name),
                )
