"""Definitions are paused, suspended, activated and deleted, and all of that survives a restart."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import datetime, timedelta
from pathlib import Path

import httpx
import pytest

from handover.broker import BrokerClient
from handover_processes.records.messages import MessageOutcome
from handover_processes.records.processes import ActKind
from handover_processes.running.orchestrator import Orchestrator
from handover_processes.settings import OrchestratorSettings
from handover_processes.storage.process_filter import ProcessFilter
from services.task_orchestrator.tests.integration.rest import XML, service, settings_in
from services.task_orchestrator.tests.unit.drawing import NOW, ONE_STEP, activity, drawing, end, path

CALL = '<bpmn:callActivity id="call" calledElement="p"/>'
GO = '<bpmn:message id="go" name="go"/>'
CYCLE = "<bpmn:timerEventDefinition><bpmn:timeCycle>R/PT1S</bpmn:timeCycle></bpmn:timerEventDefinition>"
BY = {"by": "Olga", "why": "shift change"}


def started_by(definition: str) -> str:
    return f'<bpmn:startEvent id="s">{definition}</bpmn:startEvent>' + activity("work") + end()


class Clock:
    def __init__(self) -> None:
        self.now = NOW

    def __call__(self) -> datetime:
        return self.now


@asynccontextmanager
async def orchestrating(settings: OrchestratorSettings, clock: Clock) -> AsyncIterator[Orchestrator]:
    async with BrokerClient(settings) as broker, Orchestrator(settings, broker, clock=clock) as working:
        yield working


async def processes_of(orchestrator: Orchestrator, name: str) -> int:
    filters = ProcessFilter(definition=name)
    return len(await orchestrator.read(orchestrator.store.page, filters, before=None, limit=100))


async def passes(orchestrator: Orchestrator, clock: Clock) -> None:
    clock.now += timedelta(seconds=10)
    await orchestrator.timers.tick()


async def test_timer_starts_wait_during_a_pause(tmp_path: Path) -> None:
    settings, clock = settings_in(tmp_path), Clock()
    xml = drawing(started_by(CYCLE) + path("s", "work", "end"))
    async with orchestrating(settings, clock) as orchestrator:
        await orchestrator.deployments.deploy(xml)
        await orchestrator.deployments.deploy(drawing(started_by(CYCLE) + path("s", "work", "end"), name="q"))
        await passes(orchestrator, clock)
        assert [await processes_of(orchestrator, name) for name in "pq"] == [1, 1]
        await orchestrator.processes.pause_all(ActKind.PAUSE, by="Olga", why=None, definition="p")
        await orchestrator.holds.pause_starts("p", "Olga", None)
        await passes(orchestrator, clock)
        assert [await processes_of(orchestrator, name) for name in "pq"] == [1, 2]
        await orchestrator.holds.pause_starts(None, "Olga", None)
        due = orchestrator.timers.next_due()  # that of a Task: what waits keeps nobody busy
        assert due is not None
        assert due > clock.now
    async with orchestrating(settings, clock) as orchestrator:  # a pause survives a restart
        await passes(orchestrator, clock)
        assert [await processes_of(orchestrator, name) for name in "pq"] == [1, 2]
        await orchestrator.holds.resume_starts("p")  # all definitions are still paused
        await passes(orchestrator, clock)
        await orchestrator.holds.resume_starts(None)
        await passes(orchestrator, clock)
        assert [await processes_of(orchestrator, name) for name in "pq"] == [2, 3]


async def test_no_process_of_a_suspended_definition_starts(tmp_path: Path) -> None:
    settings, clock = settings_in(tmp_path), Clock()
    waiting = '<bpmn:messageEventDefinition messageRef="go"/>'
    async with orchestrating(settings, clock) as orchestrator:
        xml = drawing(started_by(waiting) + path("s", "work", "end"), beside=GO)
        await orchestrator.deployments.deploy(xml)
        await orchestrator.holds.suspend("p", "Olga", None)
        assert (await orchestrator.processes.publish("go", variables={}))[0] is MessageOutcome.STORED
    async with orchestrating(settings, clock) as orchestrator:
        assert (await orchestrator.processes.publish("go", variables={}))[0] is MessageOutcome.STORED
        assert await processes_of(orchestrator, "p") == 0
        await orchestrator.holds.activate("p")
        assert await processes_of(orchestrator, "p") == 2  # both messages have waited
        assert not orchestrator.state.events.stored.named(["go"])


@pytest.mark.nightly
async def test_a_definition_is_suspended_and_deleted_over_rest(tmp_path: Path) -> None:
    async with service(settings_in(tmp_path)) as api:
        await _deploy(api, drawing(ONE_STEP))
        frame = '<bpmn:startEvent id="start"/>' + CALL + end() + path("start", "call", "end")
        await _deploy(api, drawing(frame, name="caller"))
        process = (await api.post("/processes", json={"definition": "p"})).json()["id"]
        view = (await api.post("/definitions/p/suspend", json=BY)).json()
        assert [(hold["kind"], hold["by"], hold["why"]) for hold in view["holds"]] == [
            ("suspended", "Olga", "shift change")
        ]
        refused = await api.post("/processes", json={"definition": "p"})
        assert (refused.status_code, "Olga has suspended" in refused.json()["detail"]) == (409, True)
        caller = (await api.post("/processes", json={"definition": "caller"})).json()
        assert "Olga has suspended" in caller["incidents"][0]["reason"]
        runs = await api.delete("/definitions/p", params=BY)
        assert (runs.status_code, "1 processes of" in runs.json()["detail"]) == (409, True)
        await api.post(f"/processes/{process}/cancel")
        assert (await api.post("/definitions/p/activate", json=BY)).json()["holds"] == []
        assert (await api.delete("/definitions/p", params=BY)).status_code == 204
        assert [each["name"] for each in (await api.get("/definitions")).json()] == ["bin-picking", "caller"]
        assert (await api.get("/definitions/p")).status_code == 404
        assert (await api.post("/processes", json={"definition": "p"})).status_code == 404
        assert (await api.get(f"/processes/{process}")).json()["status"] == "failed"  # it can still be read
        assert (await api.delete("/definitions/none", params=BY)).status_code == 404
        again = (await api.post("/processes", json={"definition": "caller"})).json()["incidents"][0]
        assert "Olga has suspended or deleted it" in again["reason"]
        for number in range(7):
            await _deploy(api, drawing(ONE_STEP, name=f"other-{number}"))
        missing = CALL.replace('"p"', '"other"')
        frame = '<bpmn:startEvent id="start"/>' + missing + end() + path("start", "call", "end")
        await _deploy(api, drawing(frame, name="lost"))
        lost = (await api.post("/processes", json={"definition": "lost"})).json()["incidents"][0]
        assert "deployed are: other-" in lost["reason"]
        assert lost["reason"].endswith(" and 5 more")
    async with service(settings_in(tmp_path)) as api:
        assert (await api.get("/definitions/p")).status_code == 404
        assert (await _deploy(api, drawing(ONE_STEP)))["version"] == 2
        assert (await api.post("/processes", json={"definition": "p"})).status_code == 201


def called_by_number(version: int) -> bytes:
    binding = f'camunda:calledElementBinding="version" camunda:calledElementVersion="{version}"'
    call = CALL.replace("/>", f' xmlns:camunda="http://camunda.org/schema/1.0/bpmn" {binding}/>')
    frame = '<bpmn:startEvent id="start"/>' + call + end() + path("start", "call", "end")
    return drawing(frame, name="caller").replace(b'xmlns:handover="urn:handover:bpmn" ', b"")


@pytest.mark.nightly
async def test_an_earlier_version_is_deleted_unless_something_needs_it(tmp_path: Path) -> None:
    settings = settings_in(tmp_path)
    first, second = drawing(ONE_STEP), drawing(ONE_STEP.replace('id="work"', 'id="work" name="Work"'))

    async def refused(version: int) -> tuple[int, str]:
        answer = await api.delete(f"/definitions/p/versions/{version}", params=BY)
        return answer.status_code, answer.json()["detail"]

    async with service(settings) as api:
        await _deploy(api, first)
        status, why = await refused(1)
        assert (status, "is the latest" in why) == (409, True), why
        process = (await api.post("/processes", json={"definition": "p"})).json()["id"]
        await _deploy(api, second)
        assert await refused(1) == (
            409,
            f'{process} run version 1 of "p"; cancel or migrate them, or wait until they have ended',
        )
        await api.post(f"/processes/{process}/cancel")
        await _deploy(api, called_by_number(1))
        caller = (await api.post("/processes", json={"definition": "caller"})).json()["id"]
        status, why = await refused(1)
        assert (status, why.startswith(caller)) == (409, True), why  # it runs within its caller
        await api.post(f"/processes/{caller}/cancel")
        status, why = await refused(1)
        assert (status, 'calls version 1 of "p" at "call"' in why) == (409, True), why
        await _deploy(api, called_by_number(2))
        assert (await refused(9))[0] == (await refused(2))[0] - 5 == 404
        assert (await api.delete("/definitions/p/versions/1", params=BY)).status_code == 204
        assert (await api.delete("/definitions/p/versions/1", params=BY)).status_code == 204
    async with service(settings) as api:
        kept = (await api.get("/definitions/p", params={"version": 1})).json()
        assert (kept["deletedVersions"], kept["activities"][0]["id"]) == ([1], "work")
        assert (await api.get(f"/processes/{process}")).json()["status"] == "failed"
        again = await api.post("/processes", json={"definition": "p", "version": 1})
        assert (again.status_code, "Olga has deleted it" in again.json()["detail"]) == (409, True)
        running = (await api.post("/processes", json={"definition": "p"})).json()
        assert running["version"] == 2
        back = await api.post(f"/processes/{running['id']}/migration", json={"by": "Olga", "version": 1})
        assert (back.status_code, "Olga has deleted it" in back.json()["detail"]) == (409, True)
        assert (await _deploy(api, first))["version"] == 3


async def _deploy(api: httpx.AsyncClient, xml: bytes) -> dict[str, object]:
    answer = await api.post("/definitions", content=xml, headers=XML)
    assert answer.status_code == 201, answer.text
    return dict(answer.json())
