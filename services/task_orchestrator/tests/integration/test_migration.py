"""Migration over REST: one process and all of a version, checked before, and after a restart."""

from typing import Any

import httpx
import pytest

from handover.broker import BrokerClient
from handover_processes.settings import OrchestratorSettings
from services.task_orchestrator.tests.integration.rest import deployed, moved, service
from services.task_orchestrator.tests.unit.drawing import ONE_STEP, activity, drawing, end, path, start

TWO_STEPS = start() + activity("work") + activity("check") + end() + path("start", "work", "check", "end")
RENAMED = start() + activity("weld") + end() + path("start", "weld", "end")
ANNA = {"by": " Anna ", "why": "the check was missing"}


async def started(api: httpx.AsyncClient) -> dict[str, Any]:
    answer = await api.post("/processes", json={"definition": "p"})
    found: dict[str, Any] = answer.json()
    return found


async def seen(api: httpx.AsyncClient, process: str) -> dict[str, Any]:
    found: dict[str, Any] = (await api.get(f"/processes/{process}")).json()
    return found


async def test_a_process_continues_in_another_version_with_the_same_task(
    joined: httpx.AsyncClient, broker: BrokerClient
) -> None:
    await deployed(joined)
    process = await started(joined)
    (task,) = process["tasks"]
    await deployed(joined, TWO_STEPS)
    url = f"/processes/{process['id']}/migration"
    checked = (await joined.post(url, params={"dry": True}, json=ANNA)).json()
    assert (checked["possible"], checked["migrated"], checked["findings"]) == (True, False, [])
    assert (await seen(joined, process["id"]))["version"] == 1
    answer = await joined.post(url, json=ANNA)
    assert (answer.status_code, answer.json()["migrated"]) == (200, True)
    assert (answer.json()["source"], answer.json()["target"]) == (1, 2)
    present = await seen(joined, process["id"])
    assert (present["version"], [each["id"] for each in present["tasks"]]) == (2, [task["id"]])
    (act,) = present["acts"]
    assert (act["act"], act["by"], act["to"], act["why"]) == ("migrate", "Anna", "2", ANNA["why"])
    await moved(joined, broker, task["id"], "completed")
    assert (await seen(joined, process["id"]))["waiting"] == ["check"]


CALLING = start() + '<bpmn:callActivity id="c" calledElement="q"/>' + end() + path("start", "c", "end")


async def called_process(api: httpx.AsyncClient, body: str, version: int) -> None:
    """Deploy a version of the caller, and one of the called process."""
    caller = CALLING.replace('id="end"', f'id="end" name="of version {version}"')
    for name, content in (("q", body), ("p", caller)):
        headers = {"Content-Type": "application/xml"}
        answer = await api.post("/definitions", content=drawing(content, name=name), headers=headers)
        assert answer.status_code == 201, answer.text


async def test_a_called_process_is_migrated_with_its_caller(
    joined: httpx.AsyncClient, broker: BrokerClient
) -> None:
    await called_process(joined, ONE_STEP, 1)
    process = await started(joined)
    (task,) = process["tasks"]
    await called_process(joined, TWO_STEPS, 2)
    url = f"/processes/{process['id']}/migration"
    checked = (await joined.post(url, params={"dry": True}, json=ANNA)).json()
    reasons = [finding["reason"] for finding in checked["findings"]]
    assert reasons == ['the called process "q" continues in version 2']
    assert checked["possible"]
    assert (await joined.post(url, json=ANNA)).json()["migrated"]
    await moved(joined, broker, task["id"], "completed")
    assert (await seen(joined, process["id"]))["waiting"] == ["c", "c.check"]


async def test_a_called_process_that_cannot_be_migrated_keeps_its_version_and_says_why(
    joined: httpx.AsyncClient, broker: BrokerClient
) -> None:
    await called_process(joined, ONE_STEP, 1)
    process = await started(joined)
    (task,) = process["tasks"]
    await called_process(joined, RENAMED, 2)
    url = f"/processes/{process['id']}/migration"
    checked = (await joined.post(url, params={"dry": True}, json=ANNA)).json()
    reasons = [finding["reason"] for finding in checked["findings"]]
    assert reasons == ['the called process "q" keeps version 1: its new version has no element "work"']
    assert (await joined.post(url, json=ANNA)).json()["migrated"]
    await moved(joined, broker, task["id"], "completed")
    assert (await seen(joined, process["id"]))["status"] == "completed"


async def test_a_migration_that_is_impossible_names_every_obstacle(joined: httpx.AsyncClient) -> None:
    await deployed(joined)
    process = await started(joined)
    await deployed(joined, RENAMED)
    url = f"/processes/{process['id']}/migration"
    refused = await joined.post(url, json=ANNA)
    assert refused.status_code == 409
    assert "version 2" in refused.json()["detail"]
    (finding,) = refused.json()["findings"]
    assert (finding["element"], finding["obstacle"]) == ("work", True)
    assert finding["task"] == process["tasks"][0]["id"]
    assert finding["reasonCode"] == "migration.no_element"
    mapped = await joined.post(url, json={**ANNA, "mapping": {"work": "weld"}})
    assert mapped.status_code == 200
    present = await seen(joined, process["id"])
    assert (present["waiting"], present["tasks"][0]["element"]) == (["weld"], "weld")
    assert present["acts"][0]["mapping"] == {"work": "weld"}
    again = await joined.post(url, json=ANNA)
    assert (again.status_code, "already" in again.json()["detail"]) == (409, True)


@pytest.mark.nightly
async def test_a_migrated_process_is_resumed_in_its_version(
    at_broker: OrchestratorSettings, broker: BrokerClient
) -> None:
    async with service(at_broker) as api:
        await deployed(api)
        process = await started(api)
        await deployed(api, RENAMED)
        request = {**ANNA, "version": 2, "mapping": {"work": "weld"}}
        await api.post(f"/processes/{process['id']}/migration", json=request)
        before = await seen(api, process["id"])
    async with service(at_broker) as api:
        assert await seen(api, process["id"]) == before
        await moved(api, broker, process["tasks"][0]["id"], "completed")
        assert (await seen(api, process["id"]))["status"] == "completed"


async def test_all_processes_of_a_version_are_migrated_each_if_it_can(
    joined: httpx.AsyncClient, broker: BrokerClient
) -> None:
    await deployed(joined, TWO_STEPS)
    first, second, ended = [await started(joined) for _ in range(3)]
    await moved(joined, broker, first["tasks"][0]["id"], "completed")
    await joined.post(f"/processes/{ended['id']}/cancel")
    await deployed(joined)
    url, request = "/definitions/p/migration", {**ANNA, "source": 1}
    checked = (await joined.post(url, params={"dry": True}, json=request)).json()
    assert (checked["migrated"], checked["refused"]) == (0, 1)
    report = (await joined.post(url, json=request)).json()
    assert (report["migrated"], report["refused"], report["target"]) == (1, 1, 2)
    by_id = {each["process"]: each for each in report["processes"]}
    assert by_id.keys() == {first["id"], second["id"]}
    assert [each["element"] for each in by_id[first["id"]]["findings"]] == ["check"]
    assert (await seen(joined, first["id"]))["version"] == 1
    assert (await seen(joined, second["id"]))["version"] == 2


async def test_a_migration_to_what_is_not_there_is_refused(joined: httpx.AsyncClient) -> None:
    await deployed(joined)
    process = await started(joined)
    url = f"/processes/{process['id']}/migration"
    assert (await joined.post(url, json={**ANNA, "version": 7})).status_code == 404
    assert (await joined.post("/processes/nothing/migration", json=ANNA)).status_code == 404
    assert (await joined.post("/definitions/p/migration", json={**ANNA, "source": 1})).status_code == 422
    assert (await joined.post(url, json={"why": "nobody"})).status_code == 422
