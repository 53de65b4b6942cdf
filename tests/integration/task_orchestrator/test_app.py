"""The orchestrator's HTTP interface while the broker is away: everything is taken in, nothing is lost."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from datamodels.times import iso
from services.task_orchestrator.app import make_app
from services.task_orchestrator.orchestrator import utc_now
from services.task_orchestrator.settings import OrchestratorSettings
from tests.unit.task_orchestrator.drawing import ONE_STEP, activity, drawing, end, parameters, path, start

NOBODY = "http://127.0.0.1:9"
"""The discard port: no broker answers there."""
XML = {"Content-Type": "application/xml"}


def settings_in(folder: Path, **more: Any) -> OrchestratorSettings:
    return OrchestratorSettings(_env_file=None, data_dir=folder, broker_url=NOBODY, **more)


@asynccontextmanager
async def service(settings: OrchestratorSettings) -> AsyncIterator[httpx.AsyncClient]:
    app = make_app(settings)
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://orchestrator") as client,
    ):
        yield client


@pytest.fixture
async def api(tmp_path: Path) -> AsyncIterator[httpx.AsyncClient]:
    async with service(settings_in(tmp_path)) as client:
        yield client


async def deployed(api: httpx.AsyncClient, body: str = ONE_STEP) -> None:
    assert (await api.post("/definitions", content=drawing(body), headers=XML)).status_code == 201


async def notify(api: httpx.AsyncClient, task: str, status: str, **outputs: Any) -> httpx.Response:
    entity = {
        "id": task,
        "type": "Task",
        "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:work"},
        "status": {"type": "Property", "value": status, "observedAt": iso(utc_now())},
        "outputParameters": {"type": "Property", "value": outputs},
    }
    return await api.post("/notifications", json={"type": "Notification", "data": [entity]})


async def test_the_same_file_twice_changes_nothing_and_a_changed_one_is_a_new_version(
    api: httpx.AsyncClient,
) -> None:
    first = await api.post("/definitions", content=drawing(ONE_STEP))
    again = await api.post("/definitions", content=drawing(ONE_STEP))
    changed = await api.post("/definitions", content=drawing(parameters(x="1") + ONE_STEP))
    back = await api.post("/definitions", content=drawing(ONE_STEP))
    assert [answer.status_code for answer in (first, again, changed, back)] == [201, 200, 201, 201]
    assert [answer.json()["version"] for answer in (first, again, changed, back)] == [1, 1, 2, 3]
    assert changed.json()["parameters"] == [{"name": "x", "required": False, "default": 1}]
    assert (await api.get("/definitions/p/bpmn", params={"version": 2})).content == drawing(
        parameters(x="1") + ONE_STEP
    )
    assert (await api.get("/definitions/p")).json()["activities"][0]["id"] == "work"
    assert {each["name"] for each in (await api.get("/definitions")).json()} == {"bin-picking", "p"}


async def test_a_running_process_keeps_the_version_it_was_started_with(api: httpx.AsyncClient) -> None:
    await deployed(api)
    process = (await api.post("/processes", json={"definition": "p"})).json()
    await deployed(api, ONE_STEP.replace("work", "other"))
    await notify(api, process["tasks"][0]["id"], "completed")
    seen = (await api.get(f"/processes/{process['id']}")).json()
    assert (seen["version"], seen["status"]) == (1, "completed")
    later = (await api.post("/processes", json={"definition": "p"})).json()
    assert (later["version"], later["waiting"]) == (2, ["other"])


async def test_a_wrong_file_is_answered_with_every_fault(api: httpx.AsyncClient) -> None:
    answer = await api.post("/definitions", content=drawing("<bpmn:callActivity id='c'/>"))
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    assert {error["element"] for error in answer.json()["faults"]} == {"p", "c"}
    for fault in answer.json()["faults"]:
        assert set(fault) == {"element", "line", "message"}
    assert (await api.post("/definitions", content=b"x" * 1_048_577)).status_code == 422


async def test_a_file_can_be_tried_out_without_deploying_it(api: httpx.AsyncClient) -> None:
    dry = {"dry": "true"}
    tried = await api.post("/definitions", content=drawing(ONE_STEP), params=dry)
    assert tried.status_code == 200
    assert tried.json() == {"name": "p", "version": 1, "title": "p", "created": True}
    assert (await api.get("/definitions/p")).status_code == 404
    await deployed(api)
    again = await api.post("/definitions", content=drawing(ONE_STEP), params=dry)
    assert (again.json()["version"], again.json()["created"]) == (1, False)
    wrong = await api.post("/definitions", content=drawing(""), params=dry)
    assert (wrong.status_code, wrong.json()["faults"][0]["element"]) == (422, "p")


async def test_a_process_is_shown_with_its_tasks_and_their_times(api: httpx.AsyncClient) -> None:
    await deployed(api, parameters(bin="bin-1") + ONE_STEP)
    answer = await api.post("/processes", json={"definition": "p", "parameters": {"bin": "bin-2"}})
    assert answer.status_code == 201
    process = answer.json()
    assert answer.headers["location"] == f"/processes/{process['id']}"
    assert process["status"] == "inProgress"
    assert process["waiting"] == ["work"]
    (task,) = process["tasks"]
    for status in ("assigned", "inProgress", "completed"):
        assert (await notify(api, task["id"], status, grip=3)).status_code == 204
    seen = (await api.get(f"/processes/{process['id']}")).json()
    assert seen == (await api.get(f"/processes/{process['entity']}")).json()
    assert seen["status"] == "completed"
    assert seen["variables"] == {"bin": "bin-2", "work": {"grip": 3}}
    assert [move["status"] for move in seen["tasks"][0]["history"]] == ["assigned", "inProgress", "completed"]
    assert [p["id"] for p in (await api.get("/processes", params={"status": "completed"})).json()] == [
        process["id"]
    ]
    assert (await api.get("/processes", params={"status": "failed"})).json() == []


async def test_a_process_says_how_far_it_is_and_what_comes_next(api: httpx.AsyncClient) -> None:
    inner = '<handover:involves expression="helper"/><handover:parameter name="description" value="Do it"/>'
    body = start() + activity("work", inner) + activity("rest", inner) + end()
    body += path("start", "work", "rest", "end")
    await deployed(api, parameters(helper="Person:ann") + body)
    process = (await api.post("/processes", json={"definition": "p"})).json()
    people = ["urn:ngsi-ld:Device:demo:glove-1", "urn:ngsi-ld:Person:demo:ann"]
    rest = {"element": "rest", "name": "rest", "description": None, "lane": None, "involves": people}
    assert process["next"] == [rest]
    assert (process["title"], process["done"], process["activities"], process["acts"]) == ("p", 0, 2, [])
    running = {"running": 1, "completed": 0, "failed": 0, "lastMs": None, "medianMs": None}
    assert process["elements"] == {"work": running}
    (task,) = process["tasks"]
    assert (task["name"], task["description"], task["involves"]) == ("work", "Do it", people)
    assert task["workParameters"] == {"description": "Do it"}
    await notify(api, task["id"], "completed")
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


async def failed(api: httpx.AsyncClient) -> dict[str, Any]:
    process = (await api.post("/processes", json={"definition": "p"})).json()
    await notify(api, process["tasks"][0]["id"], "failed", reason="the part slipped")
    seen: dict[str, Any] = (await api.get(f"/processes/{process['id']}")).json()
    return seen


async def test_a_failed_task_is_retried_and_it_is_kept_who_wanted_it(api: httpx.AsyncClient) -> None:
    await deployed(api)
    process = await failed(api)
    task = process["tasks"][0]
    assert (process["status"], process["retry"], task["reason"]) == (
        "failed",
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
    await notify(api, seen["tasks"][1]["id"], "completed")
    assert (await api.get(f"/processes/{process['id']}")).json()["status"] == "completed"


async def test_a_process_that_failed_before_a_restart_can_be_retried_after_it(tmp_path: Path) -> None:
    settings = settings_in(tmp_path)
    async with service(settings) as api:
        await deployed(api)
        process = await failed(api)
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
    assert (running.status_code, "is inProgress" in running.json()["detail"]) == (409, True)
    await api.post(f"/processes/{process['id']}/cancel", json=anna)
    cancelled = await api.post(url, json=anna)
    assert (cancelled.status_code, "cancelled by Anna" in cancelled.json()["detail"]) == (409, True)
    unknown = await api.post(f"/processes/{process['id']}/tasks/nothing/retry", json=anna)
    nowhere = await api.post("/processes/nothing/tasks/nothing/retry", json=anna)
    assert (unknown.status_code, nowhere.status_code) == (404, 404)
    for nobody in ({}, {"by": ""}, {"by": "  "}, {"by": "a\u0000"}, {"by": "a" * 201}, {"by": 7}, []):
        assert (await api.post(url, json=nobody)).status_code == 422


async def test_the_same_key_never_starts_a_second_process(api: httpx.AsyncClient) -> None:
    await deployed(api)
    order = {"definition": "p", "key": "order 7"}
    first, second = await api.post("/processes", json=order), await api.post("/processes", json=order)
    assert (first.status_code, second.status_code) == (201, 200)
    assert first.json()["id"] == second.json()["id"]
    await notify(api, first.json()["tasks"][0]["id"], "completed")
    assert (await api.post("/processes", json=order)).json()["status"] == "completed"


@pytest.mark.parametrize(
    ("body", "status", "detail"),
    [
        ({"definition": "nothing"}, 404, "bin-picking"),
        ({"definition": "p", "version": 9}, 404, "versions 1 to 1"),
        ({"definition": "p", "parameters": {"y": 1}}, 422, '"y" is none of those'),
        ({"definition": "p", "parameters": {"open()": 1}}, 422, "cannot be the name"),
        ({"definition": "p", "colour": "red"}, 422, "colour"),
        ({}, 422, "definition"),
        ([], 422, ""),
    ],
)
async def test_a_process_that_cannot_start_says_why(
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


@pytest.mark.parametrize(
    "body", [b"", b"not JSON", b"[]", b"{}", b'{"data": 7}', b'{"data": [7]}', b"\xff\x00"]
)
async def test_a_notification_that_cannot_be_read_is_refused_and_counted(
    api: httpx.AsyncClient, body: bytes
) -> None:
    before = refused(await api.get("/metrics"))
    assert (await api.post("/notifications", content=body)).status_code == 400
    assert refused(await api.get("/metrics")) == before + 1


def refused(metrics: httpx.Response) -> float:
    return sum(
        float(line.split()[-1])
        for line in metrics.text.splitlines()
        if line.startswith("handover_notifications_refused_total{")
    )


async def test_news_of_tasks_that_are_not_ours_or_do_not_fit_disturb_nothing(api: httpx.AsyncClient) -> None:
    await deployed(api)
    process = (await api.post("/processes", json={"definition": "p"})).json()
    task = process["tasks"][0]["id"]
    assert (await notify(api, "urn:ngsi-ld:Task:demo:other", "completed")).status_code == 204
    assert (await notify(api, task, "exploded")).status_code == 204
    garbage = {"data": [{"id": task, "type": "Task"}, {"id": None}, {}]}
    assert (await api.post("/notifications", json=garbage)).status_code == 204
    assert (await api.get(f"/processes/{process['id']}")).json()["status"] == "inProgress"


async def test_everything_is_there_again_after_a_restart(tmp_path: Path) -> None:
    settings = settings_in(tmp_path)
    async with service(settings) as api:
        await deployed(api)
        before = (await api.post("/processes", json={"definition": "p", "key": "k"})).json()
    async with service(settings) as api:
        assert (await api.get(f"/processes/{before['id']}")).json() == before
        assert (await notify(api, before["tasks"][0]["id"], "completed")).status_code == 204
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
