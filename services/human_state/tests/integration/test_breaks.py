"""A lasting strain proposes a break to the process of the person, and to no other."""

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest
import uvicorn

from handover.database import connect
from handover.runtime.background_tasks import BackgroundTasks
from handover.security.service_access import ServiceAccess
from handover_body.fusion.baseline import Baseline
from handover_body.monitoring.breaks import BreakProposals
from handover_body.monitoring.monitoring import Monitoring
from handover_body.monitoring.person_monitor import PersonMonitor
from handover_body.monitoring.processors import pipeline_of
from handover_body.people.consent import Purpose
from handover_body.people.people import People, now_us
from handover_body.settings import HumanStateSettings
from handover_body.storage import tables
from handover_body.storage.store import Store
from handover_processes.app import make_app
from services.task_orchestrator.tests.integration.rest import XML, settings_in
from services.task_orchestrator.tests.unit.drawing import activity, boundary, drawing, path
from tests.kit.ports import next_free_port
from tests.kit.waiting import until

WORK = drawing(
    '<bpmn:startEvent id="begin"/>'
    + activity("work")
    + boundary("strained", "work", '<bpmn:messageEventDefinition messageRef="m"/>', interrupting=False)
    + activity("rest")
    + path("begin", "work")
    + path("strained", "rest"),
    beside='<bpmn:message id="m" name="breakProposed"/>',
    name="assembly",
)


@pytest.fixture
async def orchestrator(tmp_path: Path) -> AsyncIterator[httpx.AsyncClient]:
    """The real orchestrator in this process, with a port; no broker."""
    port = next_free_port()
    app = make_app(settings_in(tmp_path, orchestrator_port=port))
    server = uvicorn.Server(uvicorn.Config(app, port=port, log_config=None, timeout_graceful_shutdown=1))
    serving = asyncio.create_task(server.serve())
    await until(lambda: server.started)
    try:
        async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{port}", trust_env=False) as client:
            yield client
    finally:
        server.should_exit = True
        await serving


async def begun(orchestrator: httpx.AsyncClient, key: str) -> str:
    order = {"definition": "assembly", "key": key}
    answer = (await orchestrator.post("/processes", json=order)).raise_for_status()
    return str(answer.json()["id"])


async def proposed(orchestrator: httpx.AsyncClient, process: str) -> int:
    """Return how often the rest of a process has begun."""
    found = (await orchestrator.get(f"/processes/{process}")).raise_for_status().json()
    return int(found["elements"].get("rest", {}).get("running", 0))


def work(monitor: PersonMonitor, bpm: float) -> None:
    """Let ten minutes pass for the strain, in which the heart rate is `bpm`."""
    begun_s = monitor.strain.at_s or 0.0
    for second in range(600):
        exertion = monitor.person.baseline.exertion(bpm)
        monitor.strain = monitor.strain.take(exertion, begun_s + second)


@pytest.mark.nightly
async def test_a_lasting_strain_proposes_one_break(orchestrator: httpx.AsyncClient, tmp_path: Path) -> None:
    settings = HumanStateSettings.load(data_dir=tmp_path, orchestrator_url=str(orchestrator.base_url))
    engine = connect(settings.database("human-state"))
    tables.prepare(engine)
    people, access = People(Store(engine)), ServiceAccess(settings, "human-state")
    await people.put("aino", Baseline(60.0, 180.0, "given"), (90.0, 125.0, 0.2))
    ends_us = now_us() + 3_600_000_000
    aino = await people.consent("aino", frozenset({Purpose.LIVE, Purpose.SPEED_LIMITS}), ends_us, "aino")
    (await orchestrator.post("/definitions", content=WORK, headers=XML)).raise_for_status()
    hers, other = await begun(orchestrator, aino.pseudonym), await begun(orchestrator, "P-other")
    breaks = BreakProposals(settings, access)
    async with BackgroundTasks("test") as tasks:
        monitoring = Monitoring(
            settings, people, access, tasks, pipeline_of=pipeline_of, classifier_of=lambda: None
        )

        def strained(one: PersonMonitor) -> None:
            tasks.start(breaks.propose, one)

        monitoring.on_strain = strained
        people.on_changed = monitoring.apply
        monitoring.apply("aino")
        monitor = monitoring.monitors["aino"]
        tasks.start(monitoring.run)
        work(monitor, 150.0)

        async def is_proposed(times: int) -> bool:
            return await proposed(orchestrator, hers) == times

        await until(lambda: is_proposed(1))
        work(monitor, 70.0)
        await until(lambda: not monitor.was_lasting)
        work(monitor, 150.0)
        await until(lambda: is_proposed(2))
        assert await proposed(orchestrator, other) == 0
        await people.consent("aino", frozenset({Purpose.LIVE}), ends_us, "aino")
        await breaks.propose(monitor)
        assert await proposed(orchestrator, hers) == 2
    breaks.close()
    engine.dispose()
