"""The lamp of the tutorial takes real Tasks from a real broker."""

import os
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover.broker import AlreadyExists, BrokerClient, BrokerError, BrokerUnavailable, NotFound
from handover.job import Job, RequestedAction, TaskCancelled
from handover.settings import Settings
from handover.subscriptions.notifications import KEY_HEADER
from handover.tasks.finished_tasks import FinishedTasks
from handover.tasks.outcomes import is_outcome_unknown
from handover.tasks.task_life import UNFINISHED_QUERY
from handover_datamodels.entities import Task, TaskStatus
from tests.kit.cell import Cell
from tests.kit.context_sources import ScriptedSource
from tests.kit.paths import REPOSITORY
from tests.kit.ports import next_free_port
from tests.kit.waiting import until

pytestmark = pytest.mark.slow

LAMP = "urn:ngsi-ld:Device:demo:lamp-1"
HERE = Path(__file__).parent


def a_task(name: str, **parameters: Any) -> Task:
    return Task.from_ngsild(
        {
            "id": f"urn:ngsi-ld:Task:demo:{name}",
            "type": "Task",
            "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:light"},
            "status": {"type": "Property", "value": "pending", "observedAt": "2026-01-01T12:00:00Z"},
            "involves": {"type": "Property", "value": [{"type": "Relationship", "object": LAMP}]},
            "workParameters": {"type": "Property", "value": parameters},
        }
    )


class LampProcess:
    """The lamp of the tutorial, as a process on a port of its own."""

    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        cell.ports["lamp"] = next_free_port()
        source = (HERE / "lamp.py").read_text().replace("9100", str(cell.ports["lamp"]))
        self.file = cell.data_dir / "lamp.py"
        self.file.write_text(source)

    def start(self) -> None:
        with (self.cell.data_dir / "lamp.log").open("ab") as log:
            self.cell.processes["lamp"] = subprocess.Popen(
                [sys.executable, str(self.file)],
                env=self.cell.environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )
        self.cell.wait_ready("lamp")

    def kill(self) -> None:
        self.cell.kill("lamp")


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    """One cell for all of these tests: each has Tasks of its own, and leaves the lamp with nothing to do."""
    return shared_cell


@pytest.fixture(scope="module")
def only_lamp(cell: Cell) -> LampProcess:
    return LampProcess(cell)


@pytest.fixture
def lamp(cell: Cell, only_lamp: LampProcess) -> LampProcess:
    cell.run("context_broker")
    if not cell.runs("lamp"):
        only_lamp.start()
    return only_lamp


@pytest.fixture
async def broker(cell: Cell, lamp: LampProcess) -> AsyncIterator[BrokerClient]:
    async with BrokerClient(Settings.load(broker_url=cell.url("context_broker"))) as client:
        yield client


async def comes_to(broker: BrokerClient, task: Task, status: TaskStatus, within_s: float = 15) -> Task:
    """Wait until the Task is in `status`, and return it."""

    async def in_status() -> Task | None:
        seen = await broker.get(task.id, Task)
        return seen if seen.status.value is status else None

    reached: Task = await until(in_status, within_s, f"{task.id} is not {status}")
    return reached


async def ask(broker: BrokerClient, task: Task, wish: str) -> None:
    await broker.append(
        task.id,
        {"requestedStatus": {"type": "Property", "value": wish, "observedAt": "2026-01-01T12:00:01Z"}},
    )


@pytest.mark.nightly
async def test_a_lamp_takes_a_task_reports_progress_and_completes_it(broker: BrokerClient) -> None:
    task = a_task("one", steps=30)
    await broker.create(task)
    await comes_to(broker, task, TaskStatus.IN_PROGRESS)
    done = await comes_to(broker, task, TaskStatus.COMPLETED)
    assert done.output_parameters is not None
    assert done.output_parameters.value == {"lit": True}
    assert done.output_parameters.observed_at is not None


async def test_a_task_pauses_goes_on_and_is_cancelled_when_asked(broker: BrokerClient) -> None:
    task = a_task("two", steps=100_000)
    await broker.create(task)
    await comes_to(broker, task, TaskStatus.IN_PROGRESS)
    await ask(broker, task, "paused")
    paused = await comes_to(broker, task, TaskStatus.PAUSED)
    assert paused.to_normalized()["status"]["reason"]["value"] == "requested"
    await ask(broker, task, "inProgress")
    await comes_to(broker, task, TaskStatus.IN_PROGRESS)
    await ask(broker, task, "cancelled")
    ended = await comes_to(broker, task, TaskStatus.FAILED)
    assert ended.output_parameters is not None
    assert ended.output_parameters.value["reason"] == "cancelled"


@pytest.mark.parametrize("status", [TaskStatus.ASSIGNED, TaskStatus.IN_PROGRESS])
async def test_a_cancellation_during_the_start_of_a_task_ends_it(
    cell: Cell, broker: BrokerClient, status: TaskStatus
) -> None:
    nobody = "urn:ngsi-ld:Device:demo:nobody-1"
    task = a_task(f"cancelled-when-{status}").to_normalized()
    task["involves"]["value"] = [{"type": "Relationship", "object": nobody}]
    await broker.create(task)

    class CancelledDuringWrite(BrokerClient):
        async def append(self, entity_id: str, attributes: Mapping[str, Any]) -> None:
            await super().append(entity_id, attributes)
            if attributes["status"]["value"] == status:
                await ask(broker, job.task, "cancelled")
                job.observe(await broker.get(entity_id, Task))

    settings = Settings.load(broker_url=cell.url("context_broker"))
    async with CancelledDuringWrite(settings) as client:
        job = Job(Task.from_ngsild(task), nobody, client, FinishedTasks(settings, "nobody"))
        with pytest.raises(TaskCancelled):
            await job.accept()
    assert await job.changed() is RequestedAction.CANCEL


async def test_one_task_is_done_at_a_time_and_one_that_waits_can_be_cancelled(broker: BrokerClient) -> None:
    first, second = a_task("first", steps=100_000), a_task("second", steps=1)
    await broker.create(first)
    await comes_to(broker, first, TaskStatus.IN_PROGRESS)
    await broker.create(second)
    await ask(broker, second, "cancelled")
    await comes_to(broker, second, TaskStatus.FAILED)
    assert (await broker.get(first.id, Task)).status.value is TaskStatus.IN_PROGRESS
    await ask(broker, first, "cancelled")
    await comes_to(broker, first, TaskStatus.FAILED)


@pytest.mark.nightly
async def test_a_task_posted_while_nobody_listened_is_found_by_asking(
    broker: BrokerClient, lamp: LampProcess
) -> None:
    lamp.kill()
    task = a_task("quiet", steps=1)
    await broker.create(task)
    lamp.start()
    await comes_to(broker, task, TaskStatus.COMPLETED)


@pytest.mark.nightly
async def test_a_killed_performer_does_not_execute_again_what_it_had_begun(
    broker: BrokerClient, lamp: LampProcess
) -> None:
    task = a_task("interrupted", steps=60)
    await broker.create(task)
    await comes_to(broker, task, TaskStatus.IN_PROGRESS)
    lamp.kill()
    lamp.start()
    ended = await comes_to(broker, task, TaskStatus.FAILED)
    assert ended.output_parameters is not None
    assert is_outcome_unknown(ended.output_parameters.value)


async def test_a_task_is_finished_though_the_broker_was_killed_meanwhile(
    broker: BrokerClient, cell: Cell, lamp: LampProcess
) -> None:
    task = a_task("outage", steps=20)
    await broker.create(task)
    await comes_to(broker, task, TaskStatus.IN_PROGRESS)
    cell.restart("context_broker")
    await comes_to(broker, task, TaskStatus.COMPLETED)


async def test_what_somebody_else_finished_is_dropped(broker: BrokerClient) -> None:
    task = a_task("taken-away", steps=100_000)
    await broker.create(task)
    await comes_to(broker, task, TaskStatus.IN_PROGRESS)
    await broker.update(
        task.id, {"status": {"type": "Property", "value": "failed", "observedAt": "2030-01-01T00:00:00Z"}}
    )
    after = a_task("after", steps=1)
    await broker.create(after)
    await comes_to(broker, after, TaskStatus.COMPLETED)
    assert (await broker.get(task.id, Task)).status.value is TaskStatus.FAILED


async def test_the_first_resource_with_a_performer_gets_the_task(broker: BrokerClient) -> None:
    other = "urn:ngsi-ld:Device:demo:other-1"
    performer = {"type": "Property", "value": "somebody else"}
    await broker.create({"id": other, "type": "Device", "performer": performer})

    def involving(name: str, *resources: str) -> dict[str, Any]:
        links = [{"type": "Relationship", "object": resource} for resource in resources]
        return {**a_task(name, steps=1).to_normalized(), "involves": {"type": "Property", "value": links}}

    await broker.create(involving("theirs", other, LAMP))
    ours = involving("ours", "urn:ngsi-ld:Material:demo:pallet", LAMP, other)
    await broker.create(ours)
    await comes_to(broker, Task.from_ngsild(ours), TaskStatus.COMPLETED)
    assert (await broker.get("urn:ngsi-ld:Task:demo:theirs", Task)).status.value is TaskStatus.PENDING


async def test_notifications_that_cannot_be_read_are_refused_and_nothing_stops(
    broker: BrokerClient, cell: Cell
) -> None:
    notifications = f"{cell.url('lamp')}/notifications"
    async with httpx.AsyncClient(timeout=120) as http:
        keyed = key_of(cell)
        for body in (b"not JSON", b"[]", b'{"data": 3}', b"\xff\xfe", b'{"data": [3]}'):
            headers = keyed | {"Content-Type": "application/json"}
            answer = await http.post(notifications, content=body, headers=headers)
            assert answer.status_code == 400
            assert answer.headers["content-type"] == "application/problem+json"
        read = await http.post(notifications, json={"data": [{"type": "Task"}]}, headers=keyed)
        assert read.status_code == 204
        assert "handover_notifications_refused_total" in (await http.get(f"{cell.url('lamp')}/metrics")).text
    task = a_task("still-working", steps=1)
    await broker.create(task)
    await comes_to(broker, task, TaskStatus.COMPLETED)


def key_of(cell: Cell) -> dict[str, str]:
    """The header that the lamp's subscription has the broker send; no answer of the broker shows it."""
    (file,) = cell.data_dir.glob("*.notification-key")
    return {KEY_HEADER: file.read_text()}


async def shown_key(broker: BrokerClient) -> str | None:
    """What the broker shows instead of the key; None if the subscription has none."""
    (subscription,) = await broker.subscriptions()
    pairs = subscription["notification"]["endpoint"].get("receiverInfo", [{"value": None}])
    value: str | None = pairs[0]["value"]
    return value


@pytest.mark.nightly
async def test_a_notification_neither_begins_nor_cancels_a_task_the_broker_does(
    broker: BrokerClient, cell: Cell
) -> None:
    running = a_task("not-cancelled", steps=200)
    await broker.create(running)
    await comes_to(broker, running, TaskStatus.IN_PROGRESS)
    invented = a_task("invented", steps=1).to_normalized()
    cancelled = {
        **running.to_normalized(),
        "requestedStatus": {"type": "Property", "value": "cancelled", "observedAt": "2030-01-01T12:00:00Z"},
    }
    async with httpx.AsyncClient(timeout=120) as http:
        notifications = f"{cell.url('lamp')}/notifications"
        forged = {"data": [invented, cancelled]}
        assert (await http.post(notifications, json=forged)).status_code == 403
        answer = await http.post(notifications, json=forged, headers=key_of(cell))
        assert answer.status_code == 204
    await comes_to(broker, running, TaskStatus.COMPLETED)
    with pytest.raises(NotFound):
        await broker.retrieve(invented["id"])


@pytest.mark.nightly
async def test_the_key_is_kept_and_a_subscription_with_another_gets_it(
    broker: BrokerClient, cell: Cell, lamp: LampProcess
) -> None:
    keyed = key_of(cell)
    (file,) = cell.data_dir.glob("*.notification-key")
    assert await shown_key(broker) == "********"
    assert file.stat().st_mode & 0o777 == 0o600
    lamp.kill()
    (subscription,) = await broker.subscriptions()
    old = {"uri": f"{cell.url('lamp')}/notifications", "accept": "application/json"}
    names = ("id", "type", "entities", "watchedAttributes")
    made = {name: subscription[name] for name in names} | {"notification": {"endpoint": old}}
    await broker.ensure_subscription(made)
    assert await shown_key(broker) is None
    lamp.start()
    assert (await shown_key(broker), key_of(cell)) == ("********", keyed)
    task = a_task("after-the-key", steps=1)
    await broker.create(task)
    await comes_to(broker, task, TaskStatus.COMPLETED)


async def test_the_client_says_what_went_wrong(broker: BrokerClient, cell: Cell, lamp: LampProcess) -> None:
    task = a_task("twice", steps=1)
    await broker.create(task)
    with pytest.raises(AlreadyExists):
        await broker.create(task)
    with pytest.raises(NotFound, match="nowhere"):
        await broker.retrieve("urn:ngsi-ld:Task:demo:nowhere")
    cell.kill("context_broker")
    with pytest.raises(BrokerUnavailable, match="does not answer"):
        await broker.retrieve(task.id)


def test_the_tutorial_shows_the_lamp() -> None:
    tutorial = (REPOSITORY / "docs" / "tutorials" / "first-component.md").read_text()
    shown = tutorial.split("```python\n", 1)[1].split("```", 1)[0]
    assert shown == (HERE / "lamp.py").read_text()


@pytest.mark.nightly
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_lamp_ends_on_a_signal(lamp: LampProcess, cell: Cell, number: signal.Signals) -> None:
    process, said_before = cell.processes["lamp"], len(cell.log("lamp"))
    os.kill(process.pid, number)
    assert process.wait(timeout=120) in (0, -signal.SIGTERM)
    assert "Application shutdown complete" in cell.log("lamp")[said_before:]
    assert "Traceback" not in cell.log("lamp")


async def test_what_another_broker_refuses_of_an_update_is_said() -> None:
    source = ScriptedSource()
    left = [{"attributeName": "colour", "reason": "there is none"}]
    path = "/ngsi-ld/v1/entities/urn:ngsi-ld:Task:demo:bare/attrs"
    source.answers["PATCH", path] = 207, {"updated": [], "notUpdated": left}
    async with BrokerClient(Settings.load(broker_url=source.url)) as broker:
        with pytest.raises(BrokerError, match="colour: there is none"):
            await broker.update("urn:ngsi-ld:Task:demo:bare", {"colour": {"value": "red"}})
    source.stop()


@pytest.mark.nightly
async def test_the_broker_selects_the_unfinished_tasks_of_a_resource(broker: BrokerClient) -> None:
    other = a_task("of-another").to_normalized()
    other["involves"] = {
        "type": "Property",
        "value": [{"type": "Relationship", "object": "urn:ngsi-ld:Device:demo:another"}],
    }
    both = {**other, "id": "urn:ngsi-ld:Task:demo:of-both", "status": {"type": "Property", "value": "paused"}}
    both["involves"] = {
        "type": "Property",
        "value": [
            *other["involves"]["value"],
            {"type": "Relationship", "object": "urn:ngsi-ld:Device:demo:b"},
        ],
    }
    await broker.upsert([other, both])
    q = f'{UNFINISHED_QUERY};(involves[object]=="urn:ngsi-ld:Device:demo:b"|involves[object]=="urn:x:none")'
    assert [entity["id"] for entity in await broker.query(type="Task", q=q)] == [both["id"]]


@pytest.mark.nightly
async def test_a_subscription_that_others_change_is_restored_with_an_alert(
    broker: BrokerClient, cell: Cell
) -> None:
    subscription_id = (await broker.subscriptions())[0]["id"]
    path = f"{cell.url('context_broker')}/ngsi-ld/v1/subscriptions/{subscription_id}"

    async def alert() -> dict[str, Any] | None:
        found = await broker.query(type="Alert")
        return next((one for one in found if "subscriptionChanged" in str(one.get("subCategory"))), None)

    async def is_restored_after(method: str, change: dict[str, Any] | None) -> None:
        async def is_restored() -> bool:
            present = {one["id"]: one for one in await broker.subscriptions()}.get(subscription_id, {})
            endpoint = present.get("notification", {}).get("endpoint", {})
            is_ours = endpoint.get("uri") == f"{cell.url('lamp')}/notifications"
            is_like_ours = present.get("isActive") is not False and "q" not in present
            return is_ours and "receiverInfo" in endpoint and is_like_ours and await alert() is not None

        async with httpx.AsyncClient(timeout=120) as http:
            answer = await http.request(method, path, json=change)
            assert answer.status_code == 204, answer.text
        await until(is_restored, why=f"the lamp restores its subscription after {method} {change}")

        async def is_over() -> bool:
            raised = await alert()
            return raised is not None and "validTo" in raised

        await until(is_over, why="the Alert returns to normal")
        found = await alert()
        assert found is not None
        await broker.delete(found["id"])

    thief = {"notification": {"endpoint": {"uri": "http://127.0.0.1:9/thief"}}}
    keyless = {"notification": {"endpoint": {"uri": f"{cell.url('lamp')}/notifications"}}}
    for change in (thief, keyless, {"isActive": False}, {"q": "status==1"}):
        await is_restored_after("PATCH", change)
    await is_restored_after("DELETE", None)
    task = a_task("after-the-restored", steps=1)
    await broker.create(task)
    await comes_to(broker, task, TaskStatus.COMPLETED)
