"""The orchestrator's HTTP interface, while the broker is away and beside a real one."""

import asyncio
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover.broker import BrokerClient
from handover.subscriptions.notifications import KEY_HEADER
from handover_processes.settings import OrchestratorSettings
from services.task_orchestrator.tests.integration.rest import (
    KEYED,
    XML,
    a_task,
    deployed,
    moved,
    notify,
    service,
    settings_in,
)
from services.task_orchestrator.tests.unit.drawing import (
    ONE_STEP,
    activity,
    drawing,
    end,
    parameters,
    path,
    start,
)
from tests.kit.waiting import until


async def test_the_same_file_twice_changes_nothing_and_a_changed_one_is_a_new_version(
    api: httpx.AsyncClient,
) -> None:
    first = await api.post("/definitions", content=drawing(ONE_STEP), headers=XML)
    again = await api.post("/definitions", content=drawing(ONE_STEP), headers=XML)
    changed = await api.post("/definitions", content=drawing(parameters(x="1") + ONE_STEP), headers=XML)
    back = await api.post("/definitions", content=drawing(ONE_STEP), headers=XML)
    assert [answer.status_code for answer in (first, again, changed, back)] == [201, 200, 201, 201]
    assert [answer.json()["version"] for answer in (first, again, changed, back)] == [1, 1, 2, 3]
    assert changed.json()["parameters"] == [{"name": "x", "required": False, "default": 1}]
    assert (await api.get("/definitions/p/bpmn", params={"version": 2})).content == drawing(
        parameters(x="1") + ONE_STEP
    )
    assert (await api.get("/definitions/p")).json()["activities"][0]["id"] == "work"
    assert {each["name"] for each in (await api.get("/definitions")).json()} == {"bin-picking", "p"}


async def test_a_running_process_keeps_the_version_it_was_started_with(
    joined: httpx.AsyncClient, broker: BrokerClient
) -> None:
    api = joined
    await deployed(api)
    process = (await api.post("/processes", json={"definition": "p"})).json()
    await deployed(api, ONE_STEP.replace("work", "other"))
    await moved(api, broker, process["tasks"][0]["id"], "completed")
    seen = (await api.get(f"/processes/{process['id']}")).json()
    assert (seen["version"], seen["status"]) == (1, "completed")
    later = (await api.post("/processes", json={"definition": "p"})).json()
    assert (later["version"], later["waiting"]) == (2, ["other"])


async def test_tokens_and_inner_variables_are_shown_and_inner_ones_are_set(api: httpx.AsyncClient) -> None:
    inner = start("in") + activity("work") + path("in", "work")
    body = (
        start() + f'<bpmn:subProcess id="sub">{inner}</bpmn:subProcess>' + end() + path("start", "sub", "end")
    )
    await deployed(api, body)
    seen = (await api.post("/processes", json={"definition": "p"})).json()
    tokens = [(each["element"], each["state"], each["task"]) for each in seen["tokens"]]
    assert tokens == [("sub", "scope", None), ("work", "work", seen["tasks"][0]["id"])]
    (scope,) = seen["scopes"]
    assert (scope["kind"], scope["element"], scope["variables"]) == ("subProcess", "sub", {})
    body_of = {"by": "Olga", "variables": {"n": 3}, "scope": scope["scope"]}
    changed = (await api.post(f"/processes/{seen['id']}/variables", json=body_of)).json()
    assert (changed["scopes"][0]["variables"], changed["variables"]) == ({"n": 3}, {})
    assert (changed["acts"][-1]["act"], changed["acts"][-1]["element"]) == ("setVariables", "sub")
    gone = await api.post(f"/processes/{seen['id']}/variables", json={**body_of, "scope": "99"})
    assert (gone.status_code, "no scope" in gone.json()["detail"]) == (409, True)
    await api.post(f"/processes/{seen['id']}/cancel")
    ended = (await api.get(f"/processes/{seen['id']}")).json()
    assert (ended["tokens"], ended["scopes"]) == ([], [])


async def test_a_wrong_file_is_answered_with_every_fault(api: httpx.AsyncClient) -> None:
    wrong = ONE_STEP + "<bpmn:callActivity id='c'/><bpmn:complexGateway id='x'/>"
    answer = await api.post("/definitions", content=drawing(wrong), headers=XML)
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    assert {error["element"] for error in answer.json()["faults"]} == {"c", "x"}
    for fault in answer.json()["faults"]:
        assert set(fault) - {"messageCode", "messageParameters"} == {"element", "name", "line", "message"}
    assert (await api.post("/definitions", content=b"x" * 4_194_305, headers=XML)).status_code == 422


async def test_a_file_can_be_tried_out_without_deploying_it(api: httpx.AsyncClient) -> None:
    dry = {"dry": "true"}
    tried = await api.post("/definitions", content=drawing(ONE_STEP), params=dry, headers=XML)
    assert tried.status_code == 200
    process = {"name": "p", "version": 1, "title": "p", "created": True}
    (line,) = tried.json()["allocation"]
    assert (line["element"], line["performer"], line["warning"]) == ("work", "Device:glove-1", None)
    assert tried.json() == {**process, "definitions": [process], "warnings": [], "allocation": [line]}
    assert (await api.get("/definitions/p")).status_code == 404
    await deployed(api)
    again = await api.post("/definitions", content=drawing(ONE_STEP), params=dry, headers=XML)
    assert (again.json()["version"], again.json()["created"]) == (1, False)
    wrong = await api.post("/definitions", content=drawing(""), params=dry, headers=XML)
    assert (wrong.status_code, wrong.json()["faults"][0]["element"]) == (422, "p")


async def test_a_process_is_shown_with_its_tasks_and_their_times(
    joined: httpx.AsyncClient, broker: BrokerClient
) -> None:
    api = joined
    await deployed(api, parameters(bin="bin-1") + ONE_STEP)
    answer = await api.post("/processes", json={"definition": "p", "parameters": {"bin": "bin-2"}})
    assert answer.status_code == 201
    process = answer.json()
    assert answer.headers["location"] == f"/processes/{process['id']}"
    assert process["status"] == "inProgress"
    assert process["waiting"] == ["work"]
    (task,) = process["tasks"]
    for status in ("assigned", "inProgress", "completed"):
        assert (await moved(api, broker, task["id"], status, grip=3)).status_code == 204
    seen = (await api.get(f"/processes/{process['id']}")).json()
    assert seen == (await api.get(f"/processes/{process['entity']}")).json()
    assert seen["status"] == "completed"
    assert seen["variables"] == {"bin": "bin-2", "work": {"grip": 3}}
    assert [move["status"] for move in seen["tasks"][0]["history"]] == ["assigned", "inProgress", "completed"]
    assert [p["id"] for p in (await api.get("/processes", params={"status": "completed"})).json()] == [
        process["id"]
    ]
    assert (await api.get("/processes", params={"status": "failed"})).json() == []


async def test_a_process_says_how_far_it_is_and_what_comes_next(
    joined: httpx.AsyncClient, broker: BrokerClient
) -> None:
    api = joined
    inner = '<handover:involves expression="helper"/><handover:parameter name="description" value="Do it"/>'
    body = start() + activity("work", inner) + activity("rest", inner) + end()
    body += path("start", "work", "rest", "end")
    await deployed(api, parameters(helper="Person:ann") + body)
    process = (await api.post("/processes", json={"definition": "p"})).json()
    people = ["urn:ngsi-ld:Device:demo:glove-1", "urn:ngsi-ld:Person:demo:ann"]
    rest = {"element": "rest", "name": "rest", "description": None, "lane": None, "involves": people}
    assert (process["next"], process["afterNext"]) == ([rest], [])
    assert (process["title"], process["done"], process["activities"], process["acts"]) == ("p", 0, 2, [])
    running = {"running": 1, "completed": 0, "failed": 0, "lastMs": None, "medianMs": None}
    assert process["elements"] == {"work": running}
    (task,) = process["tasks"]
    assert (task["name"], task["description"], task["involves"]) == ("work", "Do it", people)
    assert task["workParameters"] == {"description": "Do it"}
    await moved(api, broker, task["id"], "completed")
    seen = (await api.get(f"/processes/{process['id']}")).json()
    assert (seen["done"], seen["next"], seen["elements"]["work"]["completed"]) == (1, [], 1)
    assert seen["elements"]["work"]["lastMs"] == seen["elements"]["work"]["medianMs"] >= 0
    counts = (await api.get("/definitions/p/statistics")).json()
    assert counts == {
        "name": "p",
        "version": 1,
        "processes": {"running": 1, "completed": 0, "failed": 0},
        "elements": seen["elements"],
    }
    assert (await api.get("/definitions/p/statistics", params={"version": 2})).status_code == 404


async def test_processes_are_listed_page_by_page(api: httpx.AsyncClient) -> None:
    await deployed(api)
    ids = [(await api.post("/processes", json={"definition": "p"})).json()["id"] for _ in range(5)]
    first = (await api.get("/processes", params={"limit": 3})).json()
    assert [each["title"] for each in first] == ["p"] * 3
    second = (await api.get("/processes", params={"limit": 3, "before": first[-1]["entity"]})).json()
    assert [each["id"] for each in first + second] == ids[::-1]
    assert (await api.get("/processes", params={"definition": "bin-picking"})).json() == []
    assert (await api.get("/processes", params={"before": "nobody"})).status_code == 404


async def test_processes_are_filtered_by_key_version_and_person(api: httpx.AsyncClient) -> None:
    inner = '<handover:involves expression="helper"/>'
    body = start() + activity("work", inner) + end() + path("start", "work", "end")
    await deployed(api, parameters(helper="Person:ann") + body)

    async def begun(key: str, helper: str) -> str:
        asked = {"definition": "p", "key": key, "parameters": {"helper": helper}}
        return str((await api.post("/processes", json=asked)).json()["id"])

    async def found(**filters: Any) -> list[str]:
        return [row["id"] for row in (await api.get("/processes", params=filters)).json()]

    first, second = await begun("Order 66%", "Person:ann"), await begun("order 7", "Person:bob")
    assert await found(search="order") == [second, first]
    assert await found(search="66%") == [first], "what LIKE takes for a pattern is searched as it is"
    assert await found(search="_") == []
    assert await found(search=second[-8:]) == [second]
    assert await found(involves="urn:ngsi-ld:Person:demo:ann") == [first]
    assert await found(involves="urn:ngsi-ld:Person:demo:an") == []
    assert (await found(version=1), await found(version=2)) == ([second, first], [])
    assert (await api.get("/processes", params={"version": "9" * 20})).status_code == 422


async def test_the_counts_of_a_day_have_ended_processes_and_their_duration(
    joined: httpx.AsyncClient, broker: BrokerClient
) -> None:
    api = joined
    await deployed(api)
    began = datetime.now(UTC).isoformat()
    ids = [(await api.post("/processes", json={"definition": "p"})).json() for _ in range(4)]
    for process in ids[:2]:
        await moved(api, broker, process["tasks"][0]["id"], "completed")
    await api.post(f"/processes/{ids[2]['id']}/cancel")
    counts = (await api.get("/statistics", params={"since": began})).json()
    assert (counts["running"], counts["completed"], counts["failed"]) == (1, 2, 1)
    assert counts["medianMs"] >= 0
    later = (await api.get("/statistics", params={"since": "2999-01-01T00:00:00Z"})).json()
    assert later == {"running": 1, "completed": 0, "failed": 0, "medianMs": None, "since": later["since"]}
    assert later["since"].startswith("2999")
    before = (await api.get("/statistics", params={"since": "2020-01-01T00:00:00Z", "until": began})).json()
    assert (before["completed"], before["failed"]) == (0, 0)
    assert before["since"] <= (await api.get("/definitions/p")).json()["deployedAt"] < began
    assert (await api.get("/statistics", params={"since": "yesterday"})).status_code == 422


async def failed(api: httpx.AsyncClient, broker: BrokerClient) -> dict[str, Any]:
    process = (await api.post("/processes", json={"definition": "p"})).json()
    await moved(api, broker, process["tasks"][0]["id"], "failed", reason="the part slipped")

    async def with_failure() -> dict[str, Any] | None:
        seen: dict[str, Any] = (await api.get(f"/processes/{process['id']}")).json()
        return seen if seen["incidents"] or seen["retries"] else None

    seen: dict[str, Any] = await until(with_failure, why="the orchestrator did not notice the failed Task")
    return seen


async def test_a_failed_task_is_retried_and_it_is_kept_who_wanted_it(
    joined: httpx.AsyncClient, broker: BrokerClient
) -> None:
    api = joined
    await deployed(api)
    process = await failed(api, broker)
    task = process["tasks"][0]
    assert (process["status"], process["retry"], process["incidents"][0]["reason"]) == (
        "inProgress",
        task["id"],
        "the part slipped",
    )
    answer = await api.post(f"/processes/{process['id']}/tasks/{task['id']}/retry", json={"by": " Anna "})
    seen = answer.json()
    assert (answer.status_code, seen["status"], seen["reason"], seen["retry"]) == (
        200,
        "inProgress",
        None,
        None,
    )
    assert [(each["visit"], each["status"]) for each in seen["tasks"]] == [(1, "failed"), (2, "pending")]
    (act,) = seen["acts"]
    assert (act["by"], act["act"], act["task"]) == ("Anna", "retry", task["id"])
    assert seen["elements"]["work"]["failed"] == 1
    await moved(api, broker, seen["tasks"][1]["id"], "completed")
    assert (await api.get(f"/processes/{process['id']}")).json()["status"] == "completed"


async def test_an_activity_that_waits_for_its_next_attempt_is_shown_and_can_be_retried_at_once(
    joined: httpx.AsyncClient, broker: BrokerClient
) -> None:
    policy = '<handover:retry attempts="2" delay="PT1H"/>'
    await deployed(joined, ONE_STEP.replace("<handover:task", f"{policy}<handover:task", 1))
    process = await failed(joined, broker)
    (waiting,) = process["retries"]
    assert (waiting["element"], waiting["failed"], waiting["attempts"]) == ("work", 1, 2)
    assert (waiting["task"], waiting["reason"]) == (process["tasks"][0]["id"], "the part slipped")
    assert process["incidents"] == []
    answer = await joined.post(
        f"/processes/{process['id']}/tokens/{waiting['token']}/retry", json={"by": "Anna"}
    )
    seen = answer.json()
    assert (answer.status_code, seen["retries"]) == (200, [])
    assert [(each["visit"], each["status"]) for each in seen["tasks"]] == [(1, "failed"), (2, "pending")]
    await moved(joined, broker, seen["tasks"][1]["id"], "failed", reason="again")
    (incident,) = (await joined.get(f"/processes/{process['id']}")).json()["incidents"]
    assert incident["task"] == seen["tasks"][1]["id"]


async def test_an_incident_from_before_a_restart_can_be_retried_after_it(
    at_broker: OrchestratorSettings, broker: BrokerClient
) -> None:
    settings = at_broker
    async with service(settings) as api:
        await deployed(api)
        process = await failed(api, broker)
    async with service(settings) as api:
        short = process["retry"].removeprefix("urn:ngsi-ld:Task:demo:")
        answer = await api.post(f"/processes/{process['id']}/tasks/{short}/retry", json={"by": "Anna"})
        assert answer.json()["waiting"] == ["work"]


async def test_a_retry_that_cannot_be_says_why(api: httpx.AsyncClient) -> None:
    await deployed(api)
    process = (await api.post("/processes", json={"definition": "p"})).json()
    url = f"/processes/{process['id']}/tasks/{process['tasks'][0]['id']}/retry"
    anna = {"by": "Anna"}
    running = await api.post(url, json=anna)
    assert (running.status_code, "not a failed Task" in running.json()["detail"]) == (409, True)
    await api.post(f"/processes/{process['id']}/cancel", json=anna)
    cancelled = await api.post(url, json=anna)
    assert cancelled.status_code == 409
    unknown = await api.post(f"/processes/{process['id']}/tasks/nothing/retry", json=anna)
    nowhere = await api.post("/processes/nothing/tasks/nothing/retry", json=anna)
    assert (unknown.status_code, nowhere.status_code) == (404, 404)
    for nobody in ({}, {"by": ""}, {"by": "  "}, {"by": "a\u0000"}, {"by": "a" * 201}, {"by": 7}, []):
        assert (await api.post(url, json=nobody)).status_code == 422


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("path", "more", "act"),
    [
        ("variables", {"variables": {"n": 3}}, "setVariables"),
        ("tokens/{token}/retry", {}, "retry"),
        ("tokens/{token}/skip", {"variables": {"n": 3}}, "skip"),
        ("tokens/{token}/move", {"to": "end"}, "move"),
        ("tokens/{token}/cancel", {}, "cancelBranch"),
    ],
)
async def test_a_decision_about_an_incident_returns_the_process_with_the_act(
    joined: httpx.AsyncClient, broker: BrokerClient, path: str, more: dict[str, Any], act: str
) -> None:
    await deployed(joined)
    process = await failed(joined, broker)
    (incident,) = process["incidents"]
    answer = await joined.post(
        f"/processes/{process['id']}/{path.format(token=incident['token'])}",
        json={"by": "Anna", "why": "the part is in the box", **more},
    )
    assert answer.status_code == 200
    (done,) = answer.json()["acts"]
    assert (done["act"], done["by"], done["verified"]) == (act, "Anna", False)
    assert (done["why"], done["to"]) == ("the part is in the box", more.get("to"))


async def test_a_message_and_a_signal_that_no_process_waits_for_are_answered(api: httpx.AsyncClient) -> None:
    message = await api.post("/messages", json={"name": "go", "ttl": "PT0S"})
    assert message.json() == {"outcome": "discarded", "process": None}
    assert (await api.post("/signals", json={"name": "siren"})).json() == {"processes": []}


async def test_the_mapping_is_returned_with_the_person_who_confirmed_it(api: httpx.AsyncClient) -> None:
    await deployed(api)
    entries = [
        {"kind": "lane", "name": "robots", "resource": "Device:ur10-1", "parameters": {"speed": 0.5}},
        {"kind": "topic", "name": "grip", "skills": ["grip", "lift"], "definition": "grip"},
        {"kind": "candidateGroup", "name": "quality", "role": "inspector"},
    ]
    assert (await api.get("/mapping")).json()["entries"] == []
    stored = await api.put("/mapping", json={"by": "Anna", "why": "new cell", "entries": entries})
    assert (stored.status_code, (await api.get("/mapping")).json()) == (200, stored.json())
    assert stored.json()["entries"] == entries


async def test_the_same_key_never_starts_a_second_process(
    joined: httpx.AsyncClient, broker: BrokerClient
) -> None:
    api = joined
    await deployed(api)
    order = {"definition": "p", "key": "order 7"}
    first, second = await api.post("/processes", json=order), await api.post("/processes", json=order)
    assert (first.status_code, second.status_code) == (201, 200)
    assert first.json()["id"] == second.json()["id"]
    await moved(api, broker, first.json()["tasks"][0]["id"], "completed")
    assert (await api.post("/processes", json=order)).json()["status"] == "completed"


async def test_the_same_request_never_starts_a_second_process_and_is_no_business_key(
    joined: httpx.AsyncClient,
) -> None:
    await deployed(joined)
    body = {"definition": "p", "request": "0123456789ab"}
    answers = await asyncio.gather(*(joined.post("/processes", json=body) for _ in range(4)))
    assert sorted(each.status_code for each in answers) == [200, 200, 200, 201]
    assert {each.json()["id"] for each in answers} == {"p-0123456789ab"}
    assert answers[0].json()["key"] is None
    await joined.post("/processes/p-0123456789ab/cancel")
    assert (await joined.post("/processes", json=body)).status_code == 200


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("body", "status", "detail"),
    [
        ({"definition": "nothing"}, 404, "bin-picking"),
        ({"definition": "p", "version": 9}, 404, "versions 1 to 1"),
        ({"definition": "p", "parameters": {"y": 1}}, 422, '"y" is no parameter of'),
        ({"definition": "p", "parameters": {"open()": 1}}, 422, "cannot be the name"),
        ({"definition": "p", "colour": "red"}, 422, "colour"),
        ({}, 422, "definition"),
        ([], 422, ""),
    ],
)
async def test_a_process_that_cannot_start_is_refused_with_the_reason(
    api: httpx.AsyncClient, body: Any, status: int, detail: str
) -> None:
    await deployed(api, parameters(bin="bin-1") + ONE_STEP)
    answer = await api.post("/processes", json=body)
    assert answer.status_code == status
    assert detail in answer.json()["detail"]
    assert (await api.get("/processes")).json() == []


async def test_a_cancelled_process_is_failed_and_cannot_be_cancelled_again(api: httpx.AsyncClient) -> None:
    await deployed(api)
    process = (await api.post("/processes", json={"definition": "p"})).json()["id"]
    cancelled = (await api.post(f"/processes/{process}/cancel")).json()
    assert (cancelled["status"], cancelled["reason"]) == ("failed", "cancelled")
    assert [(act["by"], act["act"]) for act in cancelled["acts"]] == [(None, "cancel")]
    other = (await api.post("/processes", json={"definition": "p"})).json()["id"]
    named = (await api.post(f"/processes/{other}/cancel", json={"by": "Anna"})).json()
    assert (named["reason"], named["acts"][0]["by"], named["retry"]) == ("cancelled by Anna", "Anna", None)
    assert (await api.post(f"/processes/{process}/cancel")).status_code == 409
    assert (await api.post("/processes/nothing/cancel")).status_code == 404
    assert (await api.get("/processes/nothing")).status_code == 404


@pytest.mark.nightly
@pytest.mark.parametrize(
    "body", [b"", b"not JSON", b"[]", b"{}", b'{"data": 7}', b'{"data": [7]}', b"\xff\x00"]
)
async def test_a_notification_that_cannot_be_read_is_refused_and_counted(
    api: httpx.AsyncClient, body: bytes
) -> None:
    before = refused(await api.get("/metrics"))
    headers = KEYED | {"Content-Type": "application/json"}
    assert (await api.post("/notifications", content=body, headers=headers)).status_code == 400
    assert refused(await api.get("/metrics")) == before + 1


def refused(metrics: httpx.Response) -> float:
    return sum(
        float(line.split()[-1])
        for line in metrics.text.splitlines()
        if line.startswith("handover_notifications_refused_total{")
    )


async def test_news_of_tasks_that_are_not_ours_or_do_not_fit_disturb_nothing(
    joined: httpx.AsyncClient,
) -> None:
    await deployed(joined)
    process = (await joined.post("/processes", json={"definition": "p"})).json()
    task = process["tasks"][0]["id"]
    other = a_task("urn:ngsi-ld:Task:demo:other", "completed")
    assert (await notify(joined, other, a_task(task, "exploded"))).status_code == 204
    assert (await notify(joined, {"id": task, "type": "Task"}, {"id": None}, {})).status_code == 204
    assert (await joined.get(f"/processes/{process['id']}")).json()["status"] == "inProgress"


async def test_a_notification_never_moves_a_process_the_broker_does(
    joined: httpx.AsyncClient, broker: BrokerClient
) -> None:
    await deployed(joined)
    process = (await joined.post("/processes", json={"definition": "p"})).json()
    task = process["tasks"][0]["id"]
    await broker.upsert([a_task(task, "pending")])
    assert (await notify(joined, a_task(task, "completed"))).status_code == 204
    seen = (await joined.get(f"/processes/{process['id']}")).json()
    assert (seen["status"], seen["tasks"][0]["status"]) == ("inProgress", "pending")
    await broker.upsert([a_task(task, "completed")])
    assert (await notify(joined, a_task(task, "assigned"))).status_code == 204
    assert (await joined.get(f"/processes/{process['id']}")).json()["status"] == "completed"


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 403),
        ({KEY_HEADER: "guessed"}, 403),
        ({KEY_HEADER: "gr\xfc\xdfe"}, 403),
        (KEYED | {"Origin": "http://orchestrator"}, 403),
        (KEYED | {"Content-Type": "text/plain"}, 415),
        (KEYED | {"Content-Type": "application/ld+json; charset=utf-8"}, 204),
    ],
)
async def test_only_the_broker_notifies(api: httpx.AsyncClient, headers: dict[str, str], status: int) -> None:
    before = refused(await api.get("/metrics"))
    sent = [(name.encode(), value.encode("latin-1")) for name, value in headers.items()]
    answer = await api.post("/notifications", json={"data": []}, headers=sent)
    assert answer.status_code == status
    assert refused(await api.get("/metrics")) == before + (status == 403)
    if status != 204:
        assert answer.headers["content-type"] == "application/problem+json"


async def test_many_notifications_at_once_cost_few_queries(
    joined: httpx.AsyncClient, broker: BrokerClient
) -> None:
    await deployed(joined)
    tasks = [
        (await joined.post("/processes", json={"definition": "p"})).json()["tasks"][0]["id"]
        for _ in range(30)
    ]
    done = [a_task(task, "completed") for task in tasks]
    await broker.upsert(done)
    assert len(await broker.query(type="Task", q='status=="completed"')) == len(tasks)
    before = await queries(broker)
    assert before > 0
    answers = await asyncio.gather(*(notify(joined, entity) for entity in done))
    assert {answer.status_code for answer in answers} == {204}
    assert await queries(broker) - before < len(tasks) / 2
    assert len((await joined.get("/processes", params={"status": "completed"})).json()) == len(tasks)


async def queries(broker: BrokerClient) -> float:
    """How many queries for entities the broker has answered."""
    async with httpx.AsyncClient(trust_env=False, timeout=120) as http:
        text = (await http.get(f"{broker.url}/metrics")).text
    return sum(
        float(line.split()[-1])
        for line in text.splitlines()
        if "requests_total{" in line and 'operation="GET entities"' in line
    )


@pytest.mark.nightly
async def test_everything_is_there_again_after_a_restart(
    at_broker: OrchestratorSettings, broker: BrokerClient
) -> None:
    settings = at_broker
    async with service(settings) as api:
        await deployed(api)
        before = (await api.post("/processes", json={"definition": "p", "key": "k"})).json()
    async with service(settings) as api:
        assert (await api.get(f"/processes/{before['id']}")).json() == before
        assert (await moved(api, broker, before["tasks"][0]["id"], "completed")).status_code == 204
        assert (await api.get(f"/processes/{before['id']}")).json()["status"] == "completed"
        versions = {each["name"]: each["version"] for each in (await api.get("/definitions")).json()}
        assert versions == {"bin-picking": 1, "p": 1}


async def test_a_folder_is_deployed_at_start_and_a_wrong_file_in_it_harms_nobody(tmp_path: Path) -> None:
    folder = tmp_path / "processes"
    folder.mkdir()
    (folder / "good.bpmn").write_bytes(drawing(ONE_STEP, name="good"))
    (folder / "wrong.bpmn").write_bytes(drawing("", name="wrong"))
    async with service(settings_in(tmp_path, process_dir=folder)) as api:
        assert {each["name"] for each in (await api.get("/definitions")).json()} == {"bin-picking", "good"}


async def test_a_file_deployed_by_hand_is_not_undone_by_the_folder_at_the_next_start(tmp_path: Path) -> None:
    folder = tmp_path / "processes"
    folder.mkdir()
    (folder / "p.bpmn").write_bytes(drawing(ONE_STEP))
    settings = settings_in(tmp_path, process_dir=folder)
    async with service(settings) as api:
        await deployed(api, parameters(x="1") + ONE_STEP)
    async with service(settings) as api:
        assert (await api.get("/definitions/p")).json()["version"] == 2


async def test_readiness_says_that_the_broker_is_away(api: httpx.AsyncClient) -> None:
    answer = await api.get("/readyz")
    assert answer.status_code == 503
    assert set(answer.json()) == {"status", "broker", "subscription"}
    assert (await api.get("/healthz")).status_code == 200
