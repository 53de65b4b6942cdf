"""Several cells in one tenant of a broker do not mix, and two with one name do not run at once."""

import asyncio
import re
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import psycopg
import pytest
from fastapi import FastAPI
from sqlalchemy.exc import OperationalError

from handover.broker import BrokerClient
from handover.errors import Problem
from handover_processes.running.components import Components
from handover_processes.running.orchestrator import Orchestrator
from handover_processes.settings import OrchestratorSettings
from handover_processes.steps.cell_presence import CellNameInUse, CellPresence
from handover_processes.storage.device_leases import LeaseHolder
from services.task_orchestrator.tests.integration.rest import settings_in
from services.task_orchestrator.tests.unit.drawing import ONE_STEP, activity, drawing, end, path
from tests.kit.waiting import until

TASK = "urn:ngsi-ld:Task"


def settings_of(folder: Path, broker: BrokerClient, name: str) -> OrchestratorSettings:
    url = broker.url.partition("/ngsi-ld")[0]
    return settings_in(folder, broker_url=url, factory=name, reconcile_s=1)


@asynccontextmanager
async def running(settings: OrchestratorSettings) -> AsyncIterator[Components]:
    """All parts of an orchestrator, in this process; no notification reaches it."""
    at = Components(settings)
    async with at.lifespan(FastAPI()):
        yield at


def device(urn: str) -> dict[str, Any]:
    return {
        "id": urn,
        "type": "Device",
        "controlledProperty": {"type": "Property", "value": ["motion"]},
        "skills": {"type": "Property", "value": ["lift"]},
    }


def started_by_devices(name: str, pattern: str) -> bytes:
    event = (
        '<bpmn:startEvent id="start"><bpmn:messageEventDefinition><bpmn:extensionElements>'
        f'<handover:on type="Device" variable="device" {pattern}/>'
        "</bpmn:extensionElements></bpmn:messageEventDefinition></bpmn:startEvent>"
    )
    return drawing(event + activity("work") + end() + path("start", "work", "end"), name=name)


async def cell_is(broker: BrokerClient, name: str, state: str) -> None:
    async def look() -> bool:
        found = await broker.query(type="Cell", id=[f"urn:ngsi-ld:Cell:{name}:{name}"])
        return any(entity["cellState"]["value"] == state for entity in found)

    await until(look, 30, f"the cell {name} is not {state}")


async def test_what_belongs_to_another_cell_is_left_to_it(tmp_path: Path, broker: BrokerClient) -> None:
    """Devices of another cell get no work and start nothing, unless a filter names them by id."""
    await broker.create(device("urn:ngsi-ld:Device:north:arm"))
    await broker.create(device("urn:ngsi-ld:Device:plant:conveyor"))
    async with (
        running(settings_of(tmp_path / "north", broker, "north")),
        running(settings_of(tmp_path / "south", broker, "south")) as south,
    ):
        await cell_is(broker, "north", "running")
        state = south.orchestrator.state
        await south.reconciler.read_agents()
        assert set(state.allocator.rules.agents.by_id) == {"urn:ngsi-ld:Device:plant:conveyor"}
        await south.reconciler.reconcile()
        subscription = await broker.subscription("urn:ngsi-ld:Subscription:south:task-orchestrator")
        patterns = [selector["idPattern"] for selector in subscription["entities"]]
        notified = [
            name
            for name in ("north", "plant", "south")
            if any(re.search(pattern, f"{TASK}:{name}:1") for pattern in patterns)
        ]
        assert notified == ["plant", "south"]

        await south.orchestrator.deployments.deploy(started_by_devices("any", ""))
        named = started_by_devices("named", 'idPattern=".*:north:.*"')
        await south.orchestrator.deployments.deploy(named)

        async def has_baselines() -> bool:
            watched = state.entities.watched()
            return len(watched) == 2 and all(map(state.entities.seen.has_baseline, watched))

        await until(has_baselines, 30, "the filters were not queried")
        for one in ("north:new", "south:new", "plant:new"):
            await broker.create(device(f"urn:ngsi-ld:Device:{one}"))

        def starts(definition: str) -> list[str]:
            found = state.active_processes.processes.values()
            return sorted(
                process.record.variables["device"]["id"].removeprefix("urn:ngsi-ld:Device:")
                for process in found
                if process.record.definition == definition
            )

        async def have_started() -> bool:
            await south.entity_events.reconcile()
            return len(starts("any")) >= 2 and len(starts("named")) >= 1

        await until(have_started, 30, "no process has started")
        assert (starts("any"), starts("named")) == (["plant:new", "south:new"], ["north:new"])
    await cell_is(broker, "north", "stopped")


async def test_a_second_cell_with_one_name_sends_nothing_until_the_first_has_ended(
    tmp_path: Path, broker: BrokerClient
) -> None:
    first, second = (settings_of(tmp_path / each, broker, "north") for each in ("first", "second"))
    async with running(second) as late:
        await cell_is(broker, "north", "running")
        async with BrokerClient(first) as client, Orchestrator(first, client) as refused:
            with pytest.raises(CellNameInUse, match="HANDOVER_FACTORY"):
                await refused.cell.require()
            await refused.deployments.deploy(drawing(ONE_STEP))
            process, _ = await refused.processes.start("p", {})
            task = f"urn:ngsi-ld:Task:north:{process}-work-1"
            await late.reconciler.reconcile()  # the one that has the name goes on
            await late.reconciler.probe()
            with pytest.raises(CellNameInUse):
                await refused.cell.require()
            assert await broker.query(type="Task", id=[task]) == []
            arm, holder = "urn:ngsi-ld:Device:north:arm", LeaseHolder("a", "1", "arm", "here", 1)
            with pytest.raises(CellNameInUse):
                await refused.leases.acquire([arm], holder, 10.0)
            assert (await late.orchestrator.leases.acquire([arm], holder, 10.0))[0].is_granted

            await late.orchestrator.cell.__aexit__()

            async def is_there() -> bool:
                return bool(await broker.query(type="Task", id=[task]))

            await until(is_there, 30, "what had waited was not sent")
            assert (await refused.leases.acquire([arm], holder, 10.0))[0].is_granted


@pytest.mark.nightly
@pytest.mark.parametrize("was_stopped", [False, True])
async def test_of_two_cells_with_one_name_that_start_together_one_runs(
    tmp_path: Path, broker: BrokerClient, monkeypatch: pytest.MonkeyPatch, was_stopped: bool
) -> None:
    monkeypatch.setattr("handover_processes.steps.cell_presence.SETTLE_S", 4.0)  # for a slow machine
    names = ["first", "second", *(["before"] if was_stopped else [])]
    made = [Components(settings_of(tmp_path / name, broker, "north")).orchestrator for name in names]
    for each in made:
        await each.state.load()

    class Slow(BrokerClient):
        """All orchestrators have read before one of them writes."""

        async def retrieve(self, entity_id: str) -> dict[str, Any]:
            try:
                return await super().retrieve(entity_id)
            finally:
                await asyncio.sleep(0.3)

    presences = [CellPresence(each.state, Slow(each.settings), each.on_disk) for each in made]
    if was_stopped:
        before = presences.pop()
        async with before, asyncio.timeout(120):
            await before.wait()
    async with AsyncExitStack() as running:
        for presence in presences:
            await running.enter_async_context(presence)

        async def claims() -> list[bool]:
            done = await asyncio.gather(*(one.require() for one in presences), return_exceptions=True)
            assert all(one is None or isinstance(one, CellNameInUse) for one in done), done
            return sorted(isinstance(one, CellNameInUse) for one in done)

        for _ in range(5):
            assert await claims() == [False, True]


@pytest.mark.nightly
async def test_a_cell_that_was_killed_leaves_its_name_after_it_was_silent(
    tmp_path: Path, broker: BrokerClient
) -> None:
    """It is recognized by itself, not by a clock; and by its identity, one that was restarted is at once."""
    first, second = (settings_of(tmp_path / each, broker, "north") for each in ("first", "second"))
    at, other = Components(first).orchestrator, Components(second).orchestrator
    for each in (at, other):
        await each.state.load()

    def presence(of: Orchestrator) -> CellPresence:
        client = BrokerClient(of.settings)
        return CellPresence(of.state, client, of.on_disk, heartbeat_s=0.2, watch_s=2.0)

    killed, heir = presence(at), presence(other)
    await killed.__aenter__()
    await cell_is(broker, "north", "running")
    await heir.__aenter__()
    for _ in range(15):  # more than 2 s: the other one is described again and again
        with pytest.raises(CellNameInUse):
            await heir.require()
        await asyncio.sleep(0.2)
    await killed._tasks.__aexit__()  # without a good-bye, as a process that was killed
    async with asyncio.timeout(120):
        await heir.wait()
    again = presence(at)
    await again.__aenter__()
    with pytest.raises(CellNameInUse):
        await again.require()
    await heir.__aexit__()
    async with asyncio.timeout(120):
        await again.wait()
    await again.__aexit__()


async def test_a_cell_is_described_again_after_its_database_was_away(
    tmp_path: Path, broker: BrokerClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    working = Components(settings_of(tmp_path, broker, "north")).orchestrator
    await working.state.load()
    count, is_away = working.store.counts_since, True

    def counts_since(since: datetime, now: datetime) -> Any:
        if is_away:
            raise OperationalError("SELECT", {}, psycopg.OperationalError("refused"))
        return count(since, now)

    monkeypatch.setattr(working.store, "counts_since", counts_since)
    client = BrokerClient(working.settings)
    async with CellPresence(working.state, client, working.on_disk, heartbeat_s=0.2) as presence:
        with pytest.raises(Problem, match="Database unavailable"):
            await presence.require()
        is_away = False
        await cell_is(broker, "north", "running")
        async with asyncio.timeout(120):
            await presence.wait()
