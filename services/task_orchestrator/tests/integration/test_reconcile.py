"""Reconciliation finds what a lost notification would have brought, at a cost that does not grow with it."""

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from structlog.testing import capture_logs

from handover.broker import BrokerClient
from handover_datamodels.times import iso
from handover_processes.running import reconcile
from handover_processes.running.orchestrator import Orchestrator, utc_now
from handover_processes.running.reconcile import Reconciler
from services.task_orchestrator.tests.integration.rest import settings_in
from services.task_orchestrator.tests.unit.drawing import ONE_STEP, drawing
from tests.kit.waiting import until


class Recorder(httpx.AsyncBaseTransport):
    """Records the queries of Tasks, without those that only count."""

    def __init__(self) -> None:
        self.queries: list[str] = []
        self.can_count = True
        self.refuses_counts = False
        self._transport = httpx.AsyncHTTPTransport(trust_env=False)

    async def handle_async_request(self, request: httpx.Request) -> httpx.Response:
        asked = request.url.params
        counts = asked.get("count") == "true"
        if request.method == "GET" and asked.get("type") == "Task" and not counts:
            self.queries.append(str(request.url))
        if counts and self.refuses_counts:
            return httpx.Response(400, json={"title": "limit must be positive"})
        response = await self._transport.handle_async_request(request)
        if counts and not self.can_count:
            del response.headers["ngsild-results-count"]
        return response

    async def aclose(self) -> None:
        await self._transport.aclose()


class Bench:
    """An orchestrator whose notifications nobody sends, with many open Tasks."""

    def __init__(
        self, broker: BrokerClient, orchestrator: Orchestrator, client: BrokerClient, recorder: Recorder
    ) -> None:
        self.broker = broker
        self.recorder = recorder
        self.orchestrator = orchestrator
        self.reconciler = Reconciler(orchestrator, client)

    async def start(self) -> str:
        """Start a process; return its Task once the broker has it."""
        process, _ = await self.orchestrator.processes.start("p", {})
        task = f"urn:ngsi-ld:Task:demo:{process}-work-1"

        async def is_delivered() -> bool:
            return not self.orchestrator.outbox.is_pending(task)

        await until(is_delivered, 30, f"{task} is not in the broker")
        return task

    async def queries(self) -> int:
        """Reconcile; return how many queries of Tasks that took."""
        self.recorder.queries.clear()
        await self.reconciler.reconcile()
        return len(self.recorder.queries)

    async def report(self, task: str, status: str) -> None:
        """Write a status as a performer does."""
        reported = {"type": "Property", "value": status, "observedAt": iso(utc_now())}
        await self.broker.append(task, {"status": reported})

    def known(self, task: str) -> str | None:
        """Return the status of an open Task that the orchestrator knows; None: it has ended."""
        owner = self.orchestrator.state.active_processes.owner(task)
        return None if owner is None else owner.tasks[task].status.value


@pytest.fixture
async def bench(
    broker: BrokerClient, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> AsyncIterator[Bench]:
    monkeypatch.setattr(reconcile, "MAX_READ_TASKS", 2)
    recorder = Recorder()
    settings = settings_in(tmp_path / "orchestrator", broker_url=broker.url.partition("/ngsi-ld")[0])
    async with (
        BrokerClient(settings, transport=recorder) as client,
        Orchestrator(settings, client) as orchestrator,
    ):
        await orchestrator.deployments.deploy(drawing(ONE_STEP))
        yield Bench(broker, orchestrator, client, recorder)


async def test_many_tasks_are_compared_once_and_then_counted(bench: Bench) -> None:
    for _ in range(4):
        await bench.start()
    assert await bench.queries() == 1
    assert await bench.queries() == 0
    bench.recorder.can_count = False
    assert await bench.queries() == 1, "a broker that does not count is asked for all"
    bench.recorder.refuses_counts = True
    assert await bench.queries() == 1, "so is one that refuses to count"


async def test_the_end_of_a_task_without_a_notification_is_found_by_the_number(bench: Bench) -> None:
    tasks = [await bench.start() for _ in range(4)]
    await bench.queries()
    await bench.report(tasks[1], "completed")
    await bench.queries()
    assert [bench.known(task) for task in tasks] == ["pending", None, "pending", "pending"]
    assert await bench.queries() == 0


async def test_a_task_that_the_broker_has_lost_is_found_by_the_number_and_posted_again(bench: Bench) -> None:
    tasks = [await bench.start() for _ in range(4)]
    await bench.queries()
    await bench.broker.delete(tasks[2])
    await bench.queries()

    async def is_back() -> bool:
        return len(await bench.broker.query(type="Task")) == 4

    await until(is_back, 30, "the Task is not posted again")


async def test_a_broker_that_has_lost_a_started_task_gets_its_process_again_and_the_service_is_ready(
    bench: Bench,
) -> None:
    task = await bench.start()
    await bench.report(task, "inProgress")
    await bench.queries()
    kinds = ("Task", "Process", "ProcessDefinition", "TaskDefinition")
    lost = [str(each["id"]) for kind in kinds for each in await bench.broker.query(type=kind)]
    await bench.broker.delete_batch(lost)
    for _ in range(3):  # a started Task is not posted again: it stays missing
        await bench.queries()
        await bench.reconciler.probe()
    assert bench.known(task) == "inProgress"

    async def are_back() -> bool:
        found = [await bench.broker.query(type=kind) for kind in kinds[1:]]
        alerts = await bench.broker.query(type="Alert")
        return all(found) and [each["subCategory"]["value"] for each in alerts] == ["taskLost"]

    await until(are_back, 30, "process and definitions are not written again, with one Alert")


async def test_tasks_of_others_are_expected_once_they_were_seen(bench: Bench) -> None:
    for _ in range(4):
        await bench.start()
    await bench.queries()
    pending: dict[str, Any] = {"type": "Property", "value": "pending"}
    await bench.broker.create({"id": "urn:ngsi-ld:Task:demo:foreign", "type": "Task", "status": pending})
    assert await bench.queries() > 0
    assert await bench.queries() == 0


async def test_a_status_that_no_number_shows_is_found_by_the_next_comparison(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench.reconciler._unfinished, "_max_age_s", 0.0)
    tasks = [await bench.start() for _ in range(4)]
    await bench.queries()
    await bench.report(tasks[3], "inProgress")
    await bench.queries()
    assert bench.known(tasks[3]) == "inProgress"


def _property(value: Any) -> dict[str, Any]:
    return {"type": "Property", "value": value}


AGAINST_THE_MODEL = {
    "another word": {"status": _property("done")},
    "another type of value": {"status": _property(["completed"])},
    "another kind of attribute": {
        "status": {"type": "Relationship", "object": "urn:ngsi-ld:Status:completed"}
    },
    "text as outputs": {"status": _property("completed"), "outputParameters": _property("all fine")},
}


async def test_a_task_that_was_written_against_the_data_model_has_one_alert_until_it_is_corrected(
    bench: Bench,
) -> None:
    glove = {
        "id": "urn:ngsi-ld:Device:demo:glove-1",
        "type": "Device",
        "performer": _property("glove-program"),
    }
    await bench.broker.create(
        {**glove, "controlledProperty": _property(["gesture"]), "capacity": _property(9)}
    )
    await bench.reconciler.read_agents()
    tasks = {name: await bench.start() for name in AGAINST_THE_MODEL}
    for name, task in tasks.items():
        await bench.broker.append(task, AGAINST_THE_MODEL[name])

    async def alerts() -> dict[str, dict[str, Any]]:
        return {each["alertSource"]["object"]: each for each in await bench.broker.query(type="Alert")}

    with capture_logs() as lines:
        for _ in range(3):
            await bench.reconciler.reconcile()
    logged = [line["task"] for line in lines if "data model" in line["event"]]
    assert sorted(logged) == sorted(tasks.values())

    async def are_raised() -> bool:
        return set(await alerts()) == set(tasks.values())

    await until(are_raised, 30, "a Task has no Alert")
    for task, alert in (await alerts()).items():
        assert alert["subCategory"]["value"] == "taskUnreadable"
        assert task in alert["description"]["value"]
        assert "glove-program" in alert["description"]["value"], "the writer is named"
        assert 'attribute "' in alert["description"]["value"], "the rule is named"

    corrected = [*tasks.values()]
    for task in corrected[:-1]:
        await bench.report(task, "completed")
    await bench.broker.append(
        corrected[-1], {"status": _property("pending"), "outputParameters": _property({})}
    )
    await bench.reconciler.reconcile()
    assert [bench.known(task) for task in corrected] == [None, None, None, "pending"]

    async def are_cleared() -> bool:
        return all("validTo" in alert for alert in (await alerts()).values())

    await until(are_cleared, 30, "an Alert stays")
