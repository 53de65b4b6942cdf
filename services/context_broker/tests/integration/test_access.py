"""With accounts, callers see and change what their grants include, and nothing else."""

import sqlite3
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover.security import revocations
from handover.security.access_tokens import SigningKey, key_set
from handover.security.audit_reading import audit_chains
from handover.security.caller import Caller, CallerKind
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover.security.permissions import OWNER_GRANTS, Grant, Role
from handover.settings import Settings
from handover_broker.app import create_broker
from handover_broker.settings import BrokerSettings
from tests.kit.waiting import until

ROOT = "http://localhost"
KEY = SigningKey.generate()
ROBOT = "urn:ngsi-ld:Device:demo:ur10-1"
OTHER_ROBOT = "urn:ngsi-ld:Device:demo:ur10-2"
ANNA = "urn:ngsi-ld:Person:demo:anna"
STATE = "urn:ngsi-ld:HumanState:demo:anna"
HEALTH = {
    "type": "HumanState",
    "refPerson": {"type": "Relationship", "object": ANNA},
    "heartRate": {"type": "Property", "value": 72, "observedAt": "2026-11-01T10:00:00Z"},
}


def entity(entity_id: str, kind: str, **attributes: Any) -> dict[str, Any]:
    return {"id": entity_id, "type": kind, **attributes}


def token(*grants: Grant, kind: CallerKind = CallerKind.USER, subject: str = "subject-1") -> dict[str, str]:
    caller = Caller(kind, subject, "Anna", grants)
    return {"Authorization": f"Bearer {KEY.issue(caller, valid_s=86_400)}"}


SERVICE = token(Grant(Role.SERVICE), kind=CallerKind.SERVICE)
OWNER = token(*OWNER_GRANTS)
ENGINEER = token(Grant(Role.ENGINEER))
ENGINEER_OF_ONE = token(Grant(Role.ENGINEER, ROBOT))
VIEWER = token(Grant(Role.VIEWER))
RESEARCHER = token(Grant(Role.RESEARCHER))
NOBODY = token()


@pytest.fixture
async def http(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[httpx.AsyncClient]:
    monkeypatch.setattr(revocations, "MAX_SILENCE_S", 1e9)  # no accounts service answers here
    (tmp_path / "security").mkdir()
    (tmp_path / "security" / PUBLIC_KEYS_FILE).write_bytes(key_set(KEY))
    application = create_broker(
        BrokerSettings(data_dir=tmp_path, outbound_allow="127.0.0.1:9", _env_file=None)
    )
    await application._serve()
    guard = application._broker.guard  # type: ignore[attr-defined]
    guard._followed.apply({"position": 0, "revoked": []})
    transport = httpx.ASGITransport(application)
    async with httpx.AsyncClient(transport=transport, base_url="http://localhost/ngsi-ld/v1") as client:
        for one in (
            entity(ROBOT, "Device", worksWith={"type": "Relationship", "object": STATE}),
            entity(OTHER_ROBOT, "Device"),
            entity(ANNA, "Person"),
            {"id": STATE, **HEALTH},
        ):
            assert (await client.post("/entities", json=one, headers=SERVICE)).status_code == 201
        yield client
    await application._broker.stop()


async def ids(http: httpx.AsyncClient, headers: dict[str, str], **parameters: str) -> set[str]:
    answer = await http.get("/entities", params={"local": "true", **parameters}, headers=headers)
    assert answer.status_code == 200, answer.text
    return {one["id"] for one in answer.json()}


async def test_nothing_is_answered_without_a_token(http: httpx.AsyncClient) -> None:
    for method, path in (
        ("GET", "/entities"),
        ("POST", "/entities"),
        ("GET", "/subscriptions"),
        ("GET", "/types"),
    ):
        answer = await http.request(method, path, headers={"Content-Length": "0"})
        assert answer.status_code == 401, path


async def test_entities_about_the_body_are_visible_with_a_permission_only(http: httpx.AsyncClient) -> None:
    everything = {ROBOT, OTHER_ROBOT, ANNA, STATE}
    assert await ids(http, SERVICE) == everything
    assert await ids(http, RESEARCHER) == everything
    assert await ids(http, VIEWER) == everything - {STATE}
    assert await ids(http, ENGINEER, type="HumanState") == set()
    assert (await http.get(f"/entities/{STATE}", headers=VIEWER)).status_code == 404
    assert (await http.get(f"/entities/{STATE}", headers=RESEARCHER)).status_code == 200
    posted = {"type": "Query", "entities": [{"type": "HumanState"}]}
    answer = await http.post("/entityOperations/query", json=posted, headers=VIEWER)
    assert answer.json() == []
    history = {"type": "HumanState", "timerel": "after", "timeAt": "1970-01-01T00:00:00Z"}
    assert (await http.get("/temporal/entities", params=history, headers=VIEWER)).json() == []
    assert len((await http.get("/temporal/entities", params=history, headers=RESEARCHER)).json()) == 1
    assert (await http.get(f"/temporal/entities/{STATE}", headers=VIEWER)).status_code == 404
    joined = {"join": "inline", "joinLevel": "1"}
    answer = await http.get(f"/entities/{ROBOT}", params=joined, headers=VIEWER)
    assert "heartRate" not in answer.text, "a link leads to it"
    answer = await http.get(f"/entities/{ROBOT}", params=joined, headers=RESEARCHER)
    assert "heartRate" in answer.text


async def test_a_grant_for_one_robot_shows_and_changes_that_robot_only(http: httpx.AsyncClient) -> None:
    assert await ids(http, ENGINEER_OF_ONE) == {ROBOT}
    change = {"deviceState": {"type": "Property", "value": "busy"}}
    path = "/entities/{}/attrs"
    mine = await http.patch(path.format(ROBOT), json=change, headers=ENGINEER_OF_ONE)
    assert mine.status_code in {204, 207}
    for other in (OTHER_ROBOT, ANNA, STATE):
        answer = await http.post(path.format(other), json=change, headers=ENGINEER_OF_ONE)
        assert answer.status_code == 403, other
        assert (await http.delete(f"/entities/{other}", headers=ENGINEER_OF_ONE)).status_code == 403
    batch = [entity(ROBOT, "Device", **change), entity(OTHER_ROBOT, "Device", **change)]
    answer = await http.post("/entityOperations/upsert", json=batch, headers=ENGINEER_OF_ONE)
    assert answer.status_code == 403
    found = (await http.get(f"/entities/{OTHER_ROBOT}", headers=SERVICE)).json()
    assert "deviceState" not in found
    for method, target in (
        ("GET", "/subscriptions"),
        ("GET", "/types"),
        ("DELETE", "/entities?type=Device"),
        ("GET", "/csourceRegistrations"),
    ):
        assert (await http.request(method, target, headers=ENGINEER_OF_ONE)).status_code == 403, target


async def test_a_person_is_changed_by_services_and_with_the_permission_for_people(
    http: httpx.AsyncClient,
) -> None:
    assert (await http.delete(f"/entities/{ANNA}", headers=ENGINEER)).status_code == 403
    purge = await http.delete("/entities", params={"type": "Person"}, headers=ENGINEER)
    assert purge.status_code == 207
    assert purge.json()["errors"][0]["error"]["status"] == 403
    batch = await http.post("/entityOperations/delete", json=[ANNA], headers=ENGINEER)
    assert batch.status_code == 207
    assert (await http.get(f"/entities/{ANNA}", headers=VIEWER)).status_code == 200
    assert (await http.delete(f"/entities/{ANNA}", headers=OWNER)).status_code == 204


async def test_a_subscription_needs_types_unless_its_owner_may_read_health_data(
    http: httpx.AsyncClient,
) -> None:
    def subscription(**members: Any) -> dict[str, Any]:
        return {
            "type": "Subscription",
            "notification": {"endpoint": {"uri": "http://127.0.0.1:9/notifications"}},
            **members,
        }

    for refused in (
        subscription(entities=[{"type": "HumanState"}]),
        subscription(entities=[{"type": "Device"}, {"type": "(Task|HumanState)"}]),
        subscription(entities=[{"type": "https://example.org/vocabulary/HumanState"}]),
        subscription(entities=[{"type": "*"}]),
        subscription(watchedAttributes=["heartRate"]),
    ):
        answer = await http.post("/subscriptions", json=refused, headers=ENGINEER)
        assert answer.status_code == 403, refused
        assert (await http.post("/subscriptions", json=refused, headers=VIEWER)).status_code == 403
    accepted = subscription(id="urn:ngsi-ld:Subscription:1", entities=[{"type": "Device"}])
    assert (await http.post("/subscriptions", json=accepted, headers=ENGINEER)).status_code == 201
    change = {"entities": [{"type": "HumanState"}]}
    at = "/subscriptions/urn:ngsi-ld:Subscription:1"
    assert (await http.patch(at, json=change, headers=ENGINEER)).status_code == 403
    assert (await http.patch(at, json={"description": "mine"}, headers=ENGINEER)).status_code == 204
    assert (await http.patch(at, json=change, headers=OWNER)).status_code == 204


async def test_a_grant_for_a_tenant_is_for_that_tenant(http: httpx.AsyncClient) -> None:
    clinic = {"NGSILD-Tenant": "clinic"}
    one = entity(ROBOT, "Device")
    assert (await http.post("/entities", json=one, headers=SERVICE | clinic)).status_code == 201
    of_clinic = token(Grant(Role.ENGINEER, "clinic/*"))
    assert await ids(http, of_clinic | clinic) == {ROBOT}
    assert await ids(http, of_clinic) == set()
    assert (await http.delete(f"/entities/{ROBOT}", headers=of_clinic)).status_code == 403
    assert await ids(http, ENGINEER_OF_ONE | clinic) == set()
    assert (await http.delete(f"/entities/{ROBOT}", headers=ENGINEER_OF_ONE | clinic)).status_code == 403
    assert (await http.delete(f"/entities/{ROBOT}", headers=of_clinic | clinic)).status_code == 204


@pytest.mark.nightly
@pytest.mark.parametrize("caller", [NOBODY, VIEWER, RESEARCHER, ENGINEER_OF_ONE])
async def test_no_operation_of_a_caller_without_a_grant_changes_anything(
    http: httpx.AsyncClient, caller: dict[str, str]
) -> None:
    async def content() -> list[dict[str, Any]]:
        found = await http.get("/entities", params={"local": "true", "options": "sysAttrs"}, headers=SERVICE)
        return [one for one in found.json() if one["id"] != ROBOT]

    before = await content()
    value = {"state": {"type": "Property", "value": 1}}
    bodies: list[Any] = [
        entity(OTHER_ROBOT, "Device", **value),
        [entity(OTHER_ROBOT, "Device", **value)],
        [OTHER_ROBOT],
    ]
    from handover_broker.app import operations_of

    for operation in operations_of(BrokerSettings(_env_file=None)):
        if operation.method == "GET" or operation.name == "receiveSourceNotification":
            continue
        path = (
            operation.path.replace("{id}", OTHER_ROBOT)
            .replace("{name}", "state")
            .replace("{instance}", "urn:x:1")
        )
        for body in bodies:
            answer = await http.request(
                operation.method, f"/{path.replace('{contextId}', 'x')}", json=body, headers=caller
            )
            is_query = "query" in operation.path or "entityMaps" in operation.path
            assert is_query or answer.status_code in {400, 401, 403, 404}, (operation.title, answer.text)
    assert await content() == before


PIN_TASK = "urn:ngsi-ld:Task:demo:sign-off"
TASK_DEFINITION = "urn:ngsi-ld:TaskDefinition:demo:sign-off"
COMPLETED = {"status": {"type": "Property", "value": "completed"}}
ANSWERED = {**COMPLETED, "outputParameters": {"type": "Property", "value": {"by": "screen"}}}


def task(inputs: dict[str, Any], **attributes: Any) -> dict[str, Any]:
    return entity(
        PIN_TASK,
        "Task",
        isDefinedBy={"type": "Relationship", "object": TASK_DEFINITION},
        status={"type": "Property", "value": "inProgress"},
        workParameters={"type": "Property", "value": inputs},
        **attributes,
    )


@pytest.mark.parametrize("is_defined", [False, True])
async def test_a_task_that_demands_a_pin_is_answered_by_services_only(
    http: httpx.AsyncClient, is_defined: bool
) -> None:
    demand = {"requirePin": {"type": "Property", "value": True}} if is_defined else {}
    await http.post("/entities", json=entity(TASK_DEFINITION, "TaskDefinition", **demand), headers=SERVICE)
    made = await http.post(
        "/entities", json=task({} if is_defined else {"requirePin": True}), headers=SERVICE
    )
    assert made.status_code == 201, made.text
    before = (await http.get(f"/entities/{PIN_TASK}", headers=SERVICE)).json()
    path = f"/entities/{PIN_TASK}"
    whole = {**task({"requirePin": False}), **COMPLETED}
    for method, target, body in (
        ("PATCH", f"{path}/attrs", COMPLETED),
        ("PATCH", f"{path}/attrs", {"workParameters": {"type": "Property", "value": {"requirePin": False}}}),
        ("POST", f"{path}/attrs", ANSWERED),
        ("PATCH", f"{path}/attrs/status", {"value": "completed"}),
        ("PUT", f"{path}/attrs/status", {"type": "Property", "value": "failed"}),
        ("DELETE", f"{path}/attrs/workParameters", None),
        ("PATCH", path, ANSWERED),
        ("PUT", path, whole),
        ("DELETE", path, None),
        ("DELETE", "/entities?type=Task", None),
        ("POST", "/entityOperations/upsert", [whole]),
        ("POST", "/entityOperations/update", [{"id": PIN_TASK, "type": "Task", **ANSWERED}]),
        ("POST", "/entityOperations/merge", [{"id": PIN_TASK, "type": "Task", **ANSWERED}]),
        ("POST", "/entityOperations/delete", [PIN_TASK]),
    ):
        answer = await http.request(method, target, json=body, headers=OWNER)
        assert "urn:handover:pin-required" in answer.text, (method, target, answer.status_code, answer.text)
        assert (await http.get(path, headers=SERVICE)).json() == before, (method, target)
    other = {"note": {"type": "Property", "value": "seen"}}
    assert (await http.post(f"{path}/attrs", json=other, headers=OWNER)).status_code == 204
    assert (await http.patch(path, json=ANSWERED, headers=SERVICE)).status_code == 204
    assert (await http.patch(f"{path}/attrs", json=ANSWERED, headers=OWNER)).status_code == 403, (
        "it has ended"
    )
    assert (await http.delete(path, headers=OWNER)).status_code == 204, "an ended one"


async def test_no_client_says_who_performed_a_task(http: httpx.AsyncClient) -> None:
    def answer(**outputs: str) -> dict[str, Any]:
        return {"outputParameters": {"type": "Property", "value": {"by": "screen", **outputs}}}

    forged = await http.post("/entities", json=task({}, **answer(performedBy=ANNA)), headers=OWNER)
    assert (forged.status_code, "performedBy" in forged.json()["detail"]) == (403, True)
    assert (await http.post("/entities", json=task({}), headers=OWNER)).status_code == 201
    path = f"/entities/{PIN_TASK}"
    assert (await http.patch(path, json=answer(performedBy=ANNA), headers=OWNER)).status_code == 403
    assert (await http.patch(path, json=answer(operator="Anna"), headers=OWNER)).status_code == 204
    assert (await http.patch(path, json=answer(performedBy=ANNA), headers=SERVICE)).status_code == 204
    assert (await http.put(path, json=task({}, **answer()), headers=OWNER)).status_code == 403, "it is kept"
    assert (await http.patch(path, json=COMPLETED, headers=OWNER)).status_code == 204
    assert (await http.get(path, headers=SERVICE)).json()["outputParameters"]["value"]["performedBy"] == ANNA


AUDITOR = token(Grant(Role.ADMIN), subject="auditor")


async def records(http: httpx.AsyncClient, **chosen: str) -> list[tuple[str, str, str]]:
    """Return action, resource and outcome of the audit records, oldest first."""
    answer = await http.get(f"{ROOT}/audit", params=chosen, headers=AUDITOR)
    assert answer.status_code == 200, answer.text
    return [(one["action"], one["resource"], one["outcome"]) for one in reversed(answer.json())]


async def test_a_refusal_names_the_permission_and_the_roles_that_have_it(http: httpx.AsyncClient) -> None:
    answer = await http.delete(f"/entities/{OTHER_ROBOT}", headers=VIEWER)
    assert (answer.status_code, answer.json()["permission"]) == (403, "writeEntities")
    assert (answer.json()["roles"], answer.json()["resource"]) == (["engineer", "performer"], OTHER_ROBOT)
    subscription = {
        "type": "Subscription",
        "watchedAttributes": ["heartRate"],
        "notification": {"endpoint": {"uri": "http://127.0.0.1:9/notifications"}},
    }
    refused = (await http.post("/subscriptions", json=subscription, headers=ENGINEER)).json()
    assert (refused["permission"], refused["roles"]) == ("readHealthData", ["researcher"])
    assert "add `entities`" in refused["detail"]


async def test_who_changes_an_entity_is_recorded_and_services_are_not(http: httpx.AsyncClient) -> None:
    assert await records(http) == [], "what a service has created"
    change = {"deviceState": {"type": "Property", "value": "busy"}}
    path = f"/entities/{ROBOT}/attrs"
    for caller in (SERVICE, token(Grant(Role.ENGINEER), kind=CallerKind.DEVICE), ENGINEER_OF_ONE):
        assert (await http.patch(path, json=change, headers=caller)).status_code == 204
    refused = await http.patch(f"/entities/{OTHER_ROBOT}/attrs", json=change, headers=ENGINEER_OF_ONE)
    assert refused.status_code == 403
    assert (await http.patch("/entities/urn:a:b/attrs", json=change, headers=ENGINEER)).status_code == 404
    assert (await http.get(f"/entities/{ROBOT}", headers=ENGINEER)).status_code == 200
    batch = [
        entity(ROBOT, "Device", **change),
        entity(OTHER_ROBOT, "Device", **change),
        entity(ANNA, "Person"),
    ]
    answer = await http.post("/entityOperations/upsert", json=batch, headers=ENGINEER)
    assert answer.status_code == 207, answer.text
    patch, upsert = "PATCH entities/{id}/attrs", "POST entityOperations/upsert"
    expected = [
        (patch, ROBOT, "done"),
        (patch, OTHER_ROBOT, "refused"),
        (patch, "urn:a:b", "failed"),
        (upsert, ROBOT, "done"),
        (upsert, OTHER_ROBOT, "done"),
        (upsert, ANNA, "refused"),
    ]
    assert await records(http) == expected
    assert (await http.get(f"{ROOT}/audit", headers=ENGINEER)).status_code == 403
    assert (await http.get(f"{ROOT}/audit/verification", headers=AUDITOR)).json()["fault"] is None


async def test_subscribing_and_other_changes_of_a_tenant_are_recorded(http: httpx.AsyncClient) -> None:
    body = {
        "id": "urn:ngsi-ld:Subscription:1",
        "type": "Subscription",
        "entities": [{"type": "HumanState"}],
        "notification": {"endpoint": {"uri": "http://127.0.0.1:9/notifications"}},
    }
    assert (await http.post("/subscriptions", json=body, headers=OWNER)).status_code == 201
    assert (await http.get("/subscriptions", headers=OWNER)).status_code == 200
    clinic = {"NGSILD-Tenant": "clinic"}
    assert (await http.post("/entities", json=entity(ROBOT, "Device"), headers=OWNER | clinic)).is_success
    assert await records(http) == [
        ("POST subscriptions", body["id"], "done"),
        ("POST entities", f"clinic/{ROBOT}", "done"),
    ]


EVER = "timerel=after&timeAt=1970-01-01T00:00:00Z"
READS = {
    "one": ("GET", f"/entities/{STATE}", None),
    "its values only": ("GET", f"/entities/{STATE}?options=keyValues&pick=heartRate", None),
    "all": ("GET", "/entities?local=true", None),
    "batch": ("POST", "/entityOperations/query", {"type": "Query", "entities": [{"type": "HumanState"}]}),
    "linked": ("GET", f"/entities/{ROBOT}?join=inline&joinLevel=1", None),
    "linked, flat": ("GET", f"/entities/{ROBOT}?join=flat&joinLevel=1", None),
    "as a map": ("GET", "/entities?type=HumanState", {"Accept": "application/geo+json"}),
    "history": ("GET", f"/temporal/entities/{STATE}", None),
    "histories": (
        "GET",
        "/temporal/entities?type=HumanState&timerel=after&timeAt=1970-01-01T00:00:00Z",
        None,
    ),
}


@pytest.mark.nightly
@pytest.mark.parametrize("read", READS.values(), ids=READS)
async def test_who_reads_about_the_body_of_a_person_is_recorded_once(
    http: httpx.AsyncClient, read: tuple[str, str, dict[str, Any] | None]
) -> None:
    method, path, more = read
    headers = more if method == "GET" and more else {}
    body = None if method == "GET" else more
    for caller in (RESEARCHER, RESEARCHER, SERVICE, VIEWER):
        answer = await http.request(method, path, json=body, headers=caller | headers)
        assert answer.status_code in {200, 404}, answer.text
    ((_, resource, outcome),) = await records(http)
    assert (resource, outcome) == (ANNA, "done")
    assert len(await records(http, subject="subject-1", resource="anna")) == 1


async def test_reading_other_entities_is_not_recorded(http: httpx.AsyncClient) -> None:
    assert await ids(http, RESEARCHER, type="Device") == {ROBOT, OTHER_ROBOT}
    assert (await http.get(f"/entities/{ROBOT}", headers=RESEARCHER)).status_code == 200
    assert await records(http) == []


async def test_a_deleted_person_is_named_nowhere_in_the_audit_log(
    http: httpx.AsyncClient, tmp_path: Path
) -> None:
    await http.get(f"/entities/{STATE}", headers=RESEARCHER)
    change = {"state": {"type": "Property", "value": "away"}}
    assert (await http.post(f"/entities/{ANNA}/attrs", json=change, headers=OWNER)).status_code == 204
    assert {resource for _, resource, _ in await records(http)} == {ANNA}
    assert (await http.delete(f"/entities/{ANNA}", headers=OWNER)).status_code == 204
    assert {resource for _, resource, _ in await records(http)} == {ANNA}, "data about the body remains"
    assert (await http.delete(f"/entities/{STATE}", headers=SERVICE)).status_code == 204

    async def is_forgotten() -> bool:
        return "anna" not in (await http.get(f"{ROOT}/audit", headers=AUDITOR)).text

    await until(is_forgotten, why="the name is still there")
    assert len(await records(http)) == 3
    verified = (await http.get(f"{ROOT}/audit/verification", headers=AUDITOR)).json()
    assert (verified["records"], verified["fault"], verified["withoutOutcome"]) == (5, None, [])
    (chain,) = audit_chains.chains_of(Settings(data_dir=tmp_path, _env_file=None))
    assert (chain.service, len(audit_chains.records_of([chain]))) == ("context-broker", 5)


async def test_a_request_that_cannot_be_recorded_is_refused(http: httpx.AsyncClient, tmp_path: Path) -> None:
    assert (await http.get(f"/entities/{STATE}", headers=RESEARCHER)).status_code == 200
    with sqlite3.connect(tmp_path / "context-broker-audit.db") as database:
        database.execute("DROP TABLE context_broker_audit")
    change = {"state": {"type": "Property", "value": "away"}}
    refused = await http.post(f"/entities/{ROBOT}/attrs", json=change, headers=ENGINEER)
    assert (refused.status_code, refused.json()["title"]) == (503, "Not recorded")
    assert (await http.get("/entities?type=HumanState", headers=OWNER)).status_code == 503
    assert (await http.get(f"/entities/{STATE}", headers=SERVICE)).status_code == 200


PERFORMER = token(Grant(Role.PERFORMER, ROBOT), kind=CallerKind.SCRIPT, subject="script-1")
TASK = "urn:ngsi-ld:Task:demo:p-1-work-1"
OTHER_TASK = "urn:ngsi-ld:Task:demo:p-1-other-1"


def task_of(task_id: str, device: str) -> dict[str, Any]:
    links = [{"type": "Relationship", "object": device}]
    return entity(
        task_id,
        "Task",
        isDefinedBy={"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:work"},
        status={"type": "Property", "value": "pending"},
        involves={"type": "Property", "value": links},
    )


def subscription(name: str, kind: str = "Task") -> dict[str, Any]:
    return {
        "id": f"urn:ngsi-ld:Subscription:demo:{name}",
        "type": "Subscription",
        "entities": [{"type": kind}],
        "notification": {"endpoint": {"uri": "http://127.0.0.1:9/notifications"}},
    }


@pytest.fixture
async def tasks(http: httpx.AsyncClient) -> httpx.AsyncClient:
    for one in (task_of(TASK, ROBOT), task_of(OTHER_TASK, OTHER_ROBOT)):
        assert (await http.post("/entities", json=one, headers=SERVICE)).status_code == 201
    return http


async def test_a_performer_sees_its_device_and_its_tasks_alone(tasks: httpx.AsyncClient) -> None:
    assert await ids(tasks, PERFORMER) == {ROBOT, TASK}
    assert (await tasks.get(f"/entities/{OTHER_TASK}", headers=PERFORMER)).status_code in {403, 404}


STATUS = {"status": {"type": "Property", "value": "assigned"}}


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("method", "path", "body", "is_allowed"),
    [
        ("PATCH", f"/entities/{TASK}/attrs", STATUS, True),
        ("POST", f"/entities/{TASK}/attrs", {"outputParameters": {"type": "Property", "value": {}}}, True),
        ("POST", f"/entities/{ROBOT}/attrs", {"performer": {"type": "Property", "value": "arm"}}, True),
        ("POST", "/entityOperations/upsert", [entity(ROBOT, "Device")], True),
        ("PATCH", f"/entities/{OTHER_TASK}/attrs", STATUS, False),
        ("PATCH", f"/entities/{TASK}/attrs", {"involves": {"type": "Property", "value": []}}, False),
        ("POST", f"/entities/{TASK}/attrs", {"workParameters": {"type": "Property", "value": {}}}, False),
        ("DELETE", f"/entities/{TASK}", None, False),
        ("PUT", f"/entities/{TASK}", task_of(TASK, OTHER_ROBOT), False),
        ("POST", "/entities", task_of(f"{TASK}9", ROBOT), False),
        ("POST", f"/entities/{OTHER_ROBOT}/attrs", STATUS, False),
        ("POST", "/csourceRegistrations", {"type": "ContextSourceRegistration"}, False),
    ],
)
async def test_a_performer_writes_status_and_result_of_its_tasks_and_its_device(
    tasks: httpx.AsyncClient, method: str, path: str, body: Any, is_allowed: bool
) -> None:
    answer = await tasks.request(method, path, json=body, headers=PERFORMER)
    if is_allowed:
        assert answer.status_code in {201, 204}, answer.text
        return
    texts = answer.text
    assert answer.status_code == 403, texts
    before = (await tasks.get(f"/entities/{TASK}", headers=SERVICE)).json()
    assert before["status"]["value"] == "pending"
    assert before["involves"] == task_of(TASK, ROBOT)["involves"]


async def test_a_performer_keeps_its_own_subscriptions_alone(tasks: httpx.AsyncClient) -> None:
    own, other = subscription("own"), subscription("other")
    for one, headers in ((own, PERFORMER), (other, SERVICE)):
        assert (await tasks.post("/subscriptions", json=one, headers=headers)).status_code == 201
    listed = (await tasks.get("/subscriptions", headers=PERFORMER)).json()
    assert [one["id"] for one in listed] == [own["id"]]
    change = {"description": "changed"}
    for one, status in ((other, 404), (own, 204)):
        path = f"/subscriptions/{one['id']}"
        assert (await tasks.patch(path, json=change, headers=PERFORMER)).status_code == status
        assert (await tasks.delete(path, headers=PERFORMER)).status_code == status
    refused = await tasks.post("/subscriptions", json=subscription("body", "HumanState"), headers=PERFORMER)
    assert refused.status_code == 403
