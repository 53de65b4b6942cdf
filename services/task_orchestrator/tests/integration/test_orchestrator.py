"""The orchestrator over its database: what could not be written did not happen, in memory either."""

import asyncio
from collections.abc import AsyncIterator
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import text

from handover.broker import BrokerClient
from handover.database import connect
from handover.errors import Problem
from handover_datamodels.times import iso
from handover_processes.process.process import Process
from handover_processes.running.orchestrator import Orchestrator, utc_now
from handover_processes.settings import OrchestratorSettings
from handover_processes.storage.process_filter import ProcessFilter
from services.task_orchestrator.tests.unit.drawing import (
    ONE_STEP,
    activity,
    boundary,
    drawing,
    end,
    flow,
    path,
    start,
    timer,
)
from tests.kit.databases import default_url

NOBODY = "http://127.0.0.1:9"


@pytest.fixture
def settings(tmp_path: Path) -> OrchestratorSettings:
    return OrchestratorSettings(
        _env_file=None, data_dir=tmp_path, broker_url=NOBODY, database_url=default_url(tmp_path)
    )


@pytest.fixture
async def orchestrator(settings: OrchestratorSettings) -> AsyncIterator[Orchestrator]:
    async with BrokerClient(settings) as broker, Orchestrator(settings, broker) as working:
        await working.deployments.deploy(drawing(ONE_STEP))
        yield working


def task_of(process: str) -> str:
    return f"urn:ngsi-ld:Task:demo:{process}-work-1"


def completed(task: str, **outputs: Any) -> dict[str, Any]:
    return {
        "id": task,
        "type": "Task",
        "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:work"},
        "status": {"type": "Property", "value": "completed", "observedAt": iso(utc_now())},
        "outputParameters": {"type": "Property", "value": outputs},
    }


def run_sql(settings: OrchestratorSettings, statement: str, **values: Any) -> None:
    engine = connect(settings.database("orchestrator"))
    with engine.begin() as connection:
        connection.execute(text(statement), values)
    engine.dispose()


async def test_a_change_that_could_not_be_written_is_reverted_and_can_be_received_again(
    orchestrator: Orchestrator, settings: OrchestratorSettings
) -> None:
    process, _ = await orchestrator.processes.start("p", {})
    run_sql(settings, "UPDATE orchestrator_processes SET revision = revision + 1")  # as a second one would
    with pytest.raises(Problem, match="another orchestrator"):
        await orchestrator.broker_changes.receive([completed(task_of(process))])
    assert await orchestrator.broker_changes.receive([completed(task_of(process))]) == 1
    assert process not in orchestrator.state.active_processes.processes
    (record,) = await orchestrator.on_disk(lambda: orchestrator.store.processes([process]))
    assert record.status.value == "completed"


async def test_one_that_cannot_be_written_does_not_hold_up_the_others(
    orchestrator: Orchestrator, settings: OrchestratorSettings
) -> None:
    processes = [(await orchestrator.processes.start("p", {}))[0] for _ in range(5)]
    run_sql(
        settings,
        "INSERT INTO orchestrator_inbox (task, nth, status, received_at) "
        "VALUES (:task, 1, 'assigned', 'then')",
        task=task_of(processes[2]),
    )
    answers = await asyncio.gather(
        *(orchestrator.broker_changes.receive([completed(task_of(process))]) for process in processes),
        return_exceptions=True,
    )
    assert [answer for answer in answers if not isinstance(answer, Problem)] == [1, 1, 1, 1]
    assert isinstance(answers[2], Problem)
    assert answers[2].status == 503
    run_sql(settings, "DELETE FROM orchestrator_inbox WHERE received_at = 'then'")
    assert await orchestrator.broker_changes.receive([completed(task_of(processes[2]))]) == 1


@pytest.mark.nightly
async def test_one_poisoned_process_stops_neither_the_reconciliation_nor_the_timers_of_the_others(
    orchestrator: Orchestrator, monkeypatch: pytest.MonkeyPatch
) -> None:
    await orchestrator.deployments.deploy(
        drawing(ONE_STEP + boundary("late", "work", timer("PT0S")) + flow("late", "end"))
    )
    poisoned, healthy, other = [(await orchestrator.processes.start("p", {}))[0] for _ in range(3)]
    for name in ("tick", "receive"):
        original = getattr(Process, name)

        def act(self: Process, *arguments: Any, original: Any = original) -> Any:
            if self.record.id == poisoned:
                raise ZeroDivisionError("poison")
            return original(self, *arguments)

        monkeypatch.setattr(Process, name, act)
    assert (
        await orchestrator.broker_changes.receive([completed(task_of(each)) for each in (poisoned, healthy)])
        == 1
    )
    await orchestrator.timers.tick()
    records = await orchestrator.on_disk(orchestrator.store.processes, [poisoned, healthy, other])
    assert {record.id: record.status.value for record in records} == {
        poisoned: "inProgress",
        healthy: "completed",
        other: "completed",
    }


@pytest.mark.parametrize("status", [["done"], {"code": 1}, 7, None])
async def test_a_foreign_task_with_a_status_of_another_type_does_not_keep_out_the_others(
    orchestrator: Orchestrator, status: Any
) -> None:
    process, _ = await orchestrator.processes.start("p", {})
    foreign = {"id": "urn:x:foreign", "type": "Task", "status": {"type": "Property", "value": status}}
    assert await orchestrator.broker_changes.receive([foreign, completed(task_of(process))]) == 1


async def test_a_process_whose_start_could_not_be_written_does_not_exist(
    orchestrator: Orchestrator, settings: OrchestratorSettings
) -> None:
    run_sql(settings, "ALTER TABLE orchestrator_outbox RENAME TO mislaid")
    with pytest.raises(Problem, match="nothing was changed"):
        await orchestrator.processes.start("p", {})
    run_sql(settings, "ALTER TABLE mislaid RENAME TO orchestrator_outbox")
    await orchestrator.processes.start("p", {})
    assert len(orchestrator.state.active_processes.processes) == 1
    assert len(await orchestrator.on_disk(orchestrator.store.page)) == 1


def failed(task: str) -> dict[str, Any]:
    return completed(task, reason="no") | {
        "status": {"type": "Property", "value": "failed", "observedAt": iso(utc_now())}
    }


async def test_of_many_who_retry_at_once_one_does(orchestrator: Orchestrator) -> None:
    process, _ = await orchestrator.processes.start("p", {})
    await orchestrator.broker_changes.receive([failed(task_of(process))])
    people = [f"person {n}" for n in range(5)]
    answers = await asyncio.gather(
        *(orchestrator.processes.retry(process, task_of(process), by) for by in people),
        return_exceptions=True,
    )
    refused = [answer for answer in answers if isinstance(answer, Problem)]
    assert {problem.status for problem in refused} == {409}
    assert len(refused) == 4
    assert len(orchestrator.state.active_processes.processes[process].tasks) == 1
    assert len(orchestrator.state.active_processes.processes[process].record.acts) == 1


async def test_a_retry_that_could_not_be_written_did_not_happen(
    orchestrator: Orchestrator, settings: OrchestratorSettings
) -> None:
    process, _ = await orchestrator.processes.start("p", {})
    await orchestrator.broker_changes.receive([failed(task_of(process))])
    run_sql(settings, "ALTER TABLE orchestrator_outbox RENAME TO mislaid")
    with pytest.raises(Problem, match="nothing was changed"):
        await orchestrator.processes.retry(process, task_of(process), "Anna")
    run_sql(settings, "ALTER TABLE mislaid RENAME TO orchestrator_outbox")
    assert orchestrator.state.active_processes.processes[process].record.acts == ()
    await orchestrator.processes.retry(process, task_of(process), "Anna")
    assert [act.by for act in orchestrator.state.active_processes.processes[process].record.acts] == ["Anna"]


async def test_a_refused_retry_loads_no_process(orchestrator: Orchestrator) -> None:
    process, _ = await orchestrator.processes.start("p", {})
    await orchestrator.broker_changes.receive([completed(task_of(process))])
    with pytest.raises(Problem, match="not a failed Task"):
        await orchestrator.processes.retry(process, task_of(process), "Anna")
    assert orchestrator.state.active_processes.processes == {}


async def test_what_ended_longer_ago_than_it_is_to_be_kept_is_forgotten(
    settings: OrchestratorSettings,
) -> None:
    async with BrokerClient(settings) as broker:
        async with Orchestrator(settings, broker) as before:
            await before.deployments.deploy(drawing(ONE_STEP))
            ended, _ = await before.processes.start("p", {})
            await before.broker_changes.receive([completed(task_of(ended))])
            running, _ = await before.processes.start("p", {})
            newest, _ = await before.processes.start("p", {})
            await before.broker_changes.receive([completed(task_of(newest))])

        async def kept(days: float, retention_h: float = 0) -> set[str]:
            lifespan = settings.model_copy(update={"keep_days": days, "retention_h": retention_h})
            later = utc_now() + timedelta(days=100)
            async with Orchestrator(lifespan, broker, clock=lambda: later) as orchestrator:
                await orchestrator.on_disk(orchestrator.store.probe)
                await asyncio.sleep(0)
                return {record.id for record in await orchestrator.on_disk(orchestrator.store.page)}

        everything = {ended, running, newest}
        assert await kept(0) == everything
        assert await kept(101) == everything
        assert await kept(99, retention_h=24) == everything, "its entities have not left the broker"
        assert await kept(99) == {running}
        async with Orchestrator(settings, broker) as after:
            following, _ = await after.processes.start("p", {})
            numbers = {record.id: record.number for record in await after.on_disk(after.store.page)}
        assert numbers == {running: 2, following: 4}, "the number of a deleted process is used again"


async def test_a_hundred_changes_at_once_are_all_applied_and_written(orchestrator: Orchestrator) -> None:
    processes = [
        answer[0]
        for answer in await asyncio.gather(*(orchestrator.processes.start("p", {}) for _ in range(100)))
    ]
    received = await asyncio.gather(
        *(orchestrator.broker_changes.receive([completed(task_of(process))]) for process in processes)
    )
    assert received == [1] * 100
    assert orchestrator.state.active_processes.processes == {}
    records = await orchestrator.read(orchestrator.store.page, ProcessFilter(status="completed"))
    assert {record.id for record in records} == set(processes)


async def test_the_same_key_at_the_same_moment_starts_one_process(orchestrator: Orchestrator) -> None:
    answers = await asyncio.gather(*(orchestrator.processes.start("p", {}, key="k") for _ in range(10)))
    assert len({process for process, _ in answers}) == 1
    assert sorted(created for _, created in answers) == [False] * 9 + [True]


@pytest.mark.parametrize("parameters", [{"x": 2**70}, {"x": "\ud800"}, {"1st": 1}, {"a b": 1}])
async def test_parameters_that_cannot_be_kept_are_refused(
    orchestrator: Orchestrator, parameters: dict[str, Any]
) -> None:
    with pytest.raises(Problem) as refusal:
        await orchestrator.processes.start("p", parameters)
    assert refusal.value.status == 422
    assert orchestrator.state.active_processes.processes == {}


async def test_timers_and_their_tasks_are_there_after_a_restart(settings: OrchestratorSettings) -> None:
    now = utc_now()
    wait = f'<bpmn:intermediateCatchEvent id="wait">{timer("PT1H")}</bpmn:intermediateCatchEvent>'
    body = start() + wait + activity("work") + end() + path("start", "wait", "work", "end")
    async with BrokerClient(settings) as broker:
        async with Orchestrator(settings, broker, clock=lambda: now) as before:
            await before.deployments.deploy(drawing(body))
            process, _ = await before.processes.start("p", {})
            assert before.timers.next_due() == now + timedelta(hours=1)
        async with Orchestrator(settings, broker, clock=lambda: now + timedelta(minutes=59)) as early:
            await early.timers.tick()
            assert early.state.active_processes.processes[process].tasks == {}
        async with Orchestrator(settings, broker, clock=lambda: now + timedelta(hours=1)) as after:
            await after.timers.tick()
            assert list(after.state.active_processes.processes[process].tasks) == [task_of(process)]
            (due,) = after.state.active_processes.processes[process].timers()
            assert due.subject == task_of(process)


async def test_messages_pending_before_a_crash_are_delivered_after_it(settings: OrchestratorSettings) -> None:
    async with BrokerClient(settings) as broker:
        async with Orchestrator(settings, broker) as before:
            await before.deployments.deploy(drawing(ONE_STEP))
            process, _ = await before.processes.start("p", {})
            pending = await before.on_disk(before.store.outbox)
        async with Orchestrator(settings, broker) as after:
            assert await after.on_disk(after.store.outbox) == pending
            assert after.outbox.is_pending(task_of(process))
            assert after.broker_changes.awaited() == []
