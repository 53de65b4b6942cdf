"""Entities over the database of the orchestrator, without a broker: who receives them, each once."""

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import text

from handover.broker import BrokerClient
from handover.database import connect
from handover.errors import Problem
from handover_bpmn.model import EntityFilter
from handover_processes.running.orchestrator import Orchestrator
from handover_processes.settings import OrchestratorSettings
from services.task_orchestrator.tests.unit.drawing import activity, boundary, drawing, end, path, start

KEY = EntityFilter("Alert").key


def on(kind: str, inner: str = "", attributes: str = "", message: str = "") -> str:
    extension = f'<bpmn:extensionElements><handover:on type="Alert" {attributes}/></bpmn:extensionElements>'
    reference = f' messageRef="{message}"' if message else ""
    return f"<bpmn:{kind}EventDefinition{reference}>{extension}{inner}</bpmn:{kind}EventDefinition>"


def starting(definition: str) -> str:
    event = f'<bpmn:startEvent id="start">{definition}</bpmn:startEvent>'
    return event + activity("work") + end() + path("start", "work", "end")


def waiting(definition: str) -> str:
    event = f'<bpmn:intermediateCatchEvent id="wait">{definition}</bpmn:intermediateCatchEvent>'
    return start() + event + activity("work") + end() + path("start", "wait", "work", "end")


def alert(name: str, **values: Any) -> dict[str, Any]:
    properties = {key: {"type": "Property", "value": value} for key, value in values.items()}
    return {"id": f"urn:ngsi-ld:Alert:demo:{name}", "type": "Alert", **properties}


@pytest.fixture
def settings(tmp_path: Path, database_url: str | None) -> OrchestratorSettings:
    return OrchestratorSettings(
        _env_file=None, data_dir=tmp_path, broker_url="http://127.0.0.1:9", database_url=database_url
    )


@pytest.fixture
async def orchestrator(settings: OrchestratorSettings) -> AsyncIterator[Orchestrator]:
    async with BrokerClient(settings) as broker, Orchestrator(settings, broker) as working:
        yield working


async def receive(orchestrator: Orchestrator, *entities: dict[str, Any]) -> None:
    taken = await orchestrator.on_disk(
        orchestrator.store.business_keys, sorted(orchestrator.state.entities.business_keys(KEY, entities))
    )
    await orchestrator.writer.apply(
        lambda step: orchestrator.state.entities.receive(step, KEY, entities, taken, orchestrator.clock())
    )


async def judge(orchestrator: Orchestrator, *entities: dict[str, Any]) -> None:
    await orchestrator.writer.apply(
        lambda step: orchestrator.state.entities.judge(step, KEY, entities, {}, orchestrator.clock())
    )


def elements(orchestrator: Orchestrator, definition: str) -> list[str]:
    """Return where the processes of a definition are, in the order of their start."""
    found = [
        each
        for each in orchestrator.state.active_processes.processes.values()
        if each.record.definition == definition
    ]
    found.sort(key=lambda each: each.record.started_at)
    return [element for each in found for element in each.record.waiting]


async def test_a_message_goes_to_one_process_of_each_definition(orchestrator: Orchestrator) -> None:
    for name in ("p", "q"):
        await orchestrator.deployments.deploy(drawing(waiting(on("message")), name=name))
    for name in ("p", "p", "q"):
        await orchestrator.processes.start(name, {})
    await receive(orchestrator, alert("1"))
    assert elements(orchestrator, "p") == ["work", "wait"]
    assert elements(orchestrator, "q") == ["work"]


async def test_a_signal_goes_to_everyone_and_starts_processes(orchestrator: Orchestrator) -> None:
    await orchestrator.deployments.deploy(drawing(waiting(on("signal")), name="p"))
    await orchestrator.deployments.deploy(drawing(starting(on("signal")), name="q"))
    await orchestrator.processes.start("p", {})
    await orchestrator.processes.start("p", {})
    await receive(orchestrator, alert("1"))
    assert elements(orchestrator, "p") == ["work", "work"]
    assert elements(orchestrator, "q") == ["work"]


async def test_a_message_that_a_process_waits_for_does_not_start_another(orchestrator: Orchestrator) -> None:
    inside = (
        f'<bpmn:startEvent id="start">{on("message", message="m")}</bpmn:startEvent>'
        + activity("work")
        + boundary("again", "work", on("message", message="m"))
        + end()
        + path("start", "work", "end")
        + path("again", "end")
    )
    await orchestrator.deployments.deploy(drawing(inside, beside='<bpmn:message id="m" name="m"/>'))
    await receive(orchestrator, alert("1"))
    assert elements(orchestrator, "p") == ["work", "again"]
    await receive(orchestrator, alert("2"))
    assert not elements(orchestrator, "p")


async def test_a_state_of_an_entity_counts_once_and_again_when_it_was_forgotten(
    orchestrator: Orchestrator, settings: OrchestratorSettings
) -> None:
    await orchestrator.deployments.deploy(drawing(starting(on("message"))))
    await receive(orchestrator, alert("1"), alert("1"))
    await receive(orchestrator, alert("1"))
    assert len(elements(orchestrator, "p")) == 1
    await receive(orchestrator, alert("1", severity="high"))
    assert len(elements(orchestrator, "p")) == 2
    await orchestrator.writer.apply(
        lambda step: orchestrator.state.entities.forget(step, KEY, [alert("1")["id"]], orchestrator.clock())
    )
    await receive(orchestrator, alert("1", severity="high"))
    assert len(elements(orchestrator, "p")) == 3


async def test_an_entity_whose_consequences_could_not_be_written_is_received_again(
    orchestrator: Orchestrator, settings: OrchestratorSettings
) -> None:
    await orchestrator.deployments.deploy(drawing(starting(on("message"))))
    engine = connect(settings.database("orchestrator"))
    with engine.begin() as connection:
        connection.execute(text("ALTER TABLE orchestrator_entities_seen RENAME TO mislaid"))
    with pytest.raises(Problem, match="nothing was changed"):
        await receive(orchestrator, alert("1"))
    assert not elements(orchestrator, "p")
    with engine.begin() as connection:
        connection.execute(text("ALTER TABLE mislaid RENAME TO orchestrator_entities_seen"))
    engine.dispose()
    await receive(orchestrator, alert("1"))
    assert len(elements(orchestrator, "p")) == 1


async def test_what_was_seen_is_known_after_a_restart(settings: OrchestratorSettings) -> None:
    async with BrokerClient(settings) as broker:
        async with Orchestrator(settings, broker) as first:
            await first.deployments.deploy(drawing(starting(on("message"))))
            await receive(first, alert("1"))
        async with Orchestrator(settings, broker) as second:
            await receive(second, alert("1"), alert("2"))
            assert len(elements(second, "p")) == 2


async def test_a_business_key_starts_one_process_even_after_its_end(orchestrator: Orchestrator) -> None:
    correlated = on("message", attributes='correlation="entity.order"')
    event = f'<bpmn:startEvent id="start">{correlated}</bpmn:startEvent>'
    await orchestrator.deployments.deploy(drawing(event + end() + path("start", "end")))
    await receive(orchestrator, alert("1", order=7), alert("2", order=7), alert("3"))
    await receive(orchestrator, alert("4", order=7))
    (record,) = await orchestrator.on_disk(orchestrator.store.page)
    assert (record.key, record.status.value) == ("7", "completed")


async def test_a_condition_at_a_start_event_starts_a_process_each_time_that_it_becomes_true(
    orchestrator: Orchestrator,
) -> None:
    hot = on("conditional", "<bpmn:condition>entity.heat &gt; 50</bpmn:condition>")
    await orchestrator.deployments.deploy(drawing(starting(hot)))
    for heat, count in ((60, 1), (70, 1), (10, 1), (51, 2)):
        await judge(orchestrator, alert("1", heat=heat))
        assert len(elements(orchestrator, "p")) == count


async def test_a_condition_at_a_start_event_that_cannot_be_evaluated_is_logged_once_until_it_can(
    orchestrator: Orchestrator, capsys: pytest.CaptureFixture[str]
) -> None:
    hot = on("conditional", "<bpmn:condition>entity.heat &gt; 50</bpmn:condition>")
    await orchestrator.deployments.deploy(drawing(starting(hot)))
    cases: list[tuple[dict[str, Any], int]] = [
        ({}, 1),
        ({}, 0),
        ({"heat": 10}, 0),
        ({}, 1),
        ({"heat": "x"}, 1),
    ]
    for values, count in cases:
        await judge(orchestrator, alert("1", **values))
        lines = [line for line in capsys.readouterr().out.splitlines() if "cannot be evaluated" in line]
        assert len(lines) == count
        for line in lines:
            assert all(
                part in line for part in ("definition=p", "element=start", "Alert:demo:1", "entity.heat")
            )
    assert not elements(orchestrator, "p")


async def test_own_tasks_and_alerts_about_own_processes_start_nothing(orchestrator: Orchestrator) -> None:
    await orchestrator.deployments.deploy(drawing(starting(on("message"))))
    source = {"type": "Relationship", "object": "urn:ngsi-ld:Process:demo:p-0123456789ab"}
    await receive(
        orchestrator,
        {"id": "urn:ngsi-ld:Task:demo:p-0123456789ab-work-1", "type": "Task"},
        alert("1") | {"alertSource": source},
    )
    assert not elements(orchestrator, "p")
    other = source | {"object": "urn:ngsi-ld:Process:demo:other-0123456789ab"}
    await receive(orchestrator, alert("2") | {"alertSource": other})
    assert elements(orchestrator, "p") == ["work"]


async def test_a_later_version_replaces_the_filter_and_what_it_has_seen(orchestrator: Orchestrator) -> None:
    await orchestrator.deployments.deploy(drawing(starting(on("message"))))
    assert set(orchestrator.state.entities.watched()) == {KEY}
    await orchestrator.writer.apply(
        lambda step: orchestrator.state.entities.set_baseline(step, KEY, [alert("1")], is_complete=True)
    )
    await receive(orchestrator, alert("1"))
    assert not elements(orchestrator, "p")
    await orchestrator.deployments.deploy(
        drawing(start() + activity("work") + end() + path("start", "work", "end"))
    )
    assert not orchestrator.state.entities.watched()
    assert orchestrator.state.entities.has_unused()
    await orchestrator.writer.apply(orchestrator.state.entities.remove_unused)
    assert not await orchestrator.on_disk(orchestrator.store.entities_seen)
    assert not orchestrator.state.entities.has_unused()
