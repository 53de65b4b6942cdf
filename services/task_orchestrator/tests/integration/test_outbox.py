"""The outbox writes messages of many processes together; what the broker refuses delays nothing else."""

from collections.abc import AsyncIterator
from typing import Any

import httpx
import pytest

from handover.broker import BrokerClient, NotFound
from handover.settings import Settings
from handover_processes.records.messages import Message, MessageKind
from handover_processes.steps.outbox import Outbox
from tests.kit.cell import Cell
from tests.kit.waiting import until

pytestmark = pytest.mark.slow


def task(name: str, status: str = "pending", kind: str = "Task") -> dict[str, Any]:
    return {
        "id": f"urn:ngsi-ld:Task:demo:{name}",
        "type": kind,
        "status": {"type": "Property", "value": status},
    }


@pytest.fixture
async def broker(shared_cell: Cell) -> AsyncIterator[BrokerClient]:
    shared_cell.run("context_broker")
    async with BrokerClient(Settings.load(broker_url=shared_cell.url("context_broker"))) as client:
        yield client


async def deliver(broker: BrokerClient, messages: list[Message], *, kept: int = 0) -> list[tuple[int, str]]:
    """Deliver all messages but those that are `kept`; return those that were rejected, with the reason."""
    rejected: list[tuple[int, str]] = []

    async def on_rejected(message: Message, reason: str) -> None:
        rejected.append((message.seq, reason))

    delivered: set[int] = set()

    async def all_delivered() -> bool:
        delivered.update(outbox.take_delivered())
        return len(delivered) == len(messages) - kept

    async def at_once() -> None:
        return

    async with Outbox(Settings.load(), broker, on_rejected, may_deliver=at_once) as outbox:
        outbox.send(messages)
        await until(all_delivered, 15, "the messages are not delivered")
        assert not any(outbox.is_pending(message.subject) for message in messages)
    return rejected


def create(seq: int, stream: str, entity: dict[str, Any]) -> Message:
    return Message(seq, stream, MessageKind.CREATE, entity["id"], entity)


async def test_a_refused_entity_is_reported_and_the_others_are_written(broker: BrokerClient) -> None:
    await broker.create(task("outbox-old", "completed"))
    bad = {**task("outbox-bad"), "status": {"type": "No such type", "value": 1}}
    messages = [
        create(1, "p-1", task("outbox-1")),
        create(2, "p-1", task("outbox-2")),
        create(3, "p-2", task("outbox-old")),
        create(4, "p-3", bad),
        create(5, "p-3", task("outbox-3")),
        *(create(10 + number, f"q-{number}", task(f"outbox-q{number}")) for number in range(250)),
    ]
    ((seq, reason),) = await deliver(broker, messages)
    assert (seq, bool(reason)) == (4, True)
    found = await broker.query(type="Task", id_pattern="^urn:ngsi-ld:Task:demo:outbox-")
    states = {entity["id"].rpartition(":")[2]: entity["status"]["value"] for entity in found}
    assert states.pop("outbox-old") == "completed"  # written twice, created once
    assert set(states) == {"outbox-1", "outbox-2", "outbox-3", *(f"outbox-q{n}" for n in range(250))}


async def test_messages_of_a_stream_are_written_in_their_order(broker: BrokerClient) -> None:
    streams = [f"ordered-{number}" for number in range(20)]
    messages = []
    for stream in streams:
        entity = task(stream)
        for status in ("pending", "assigned", "inProgress"):
            body = [{**entity, "status": {"type": "Property", "value": status}}]
            messages.append(Message(len(messages), stream, MessageKind.UPSERT, entity["id"], body))
        end = {"status": {"type": "Property", "value": "completed"}}
        messages.append(Message(len(messages), stream, MessageKind.APPEND, entity["id"], end))
        again = [{**entity, "status": {"type": "Property", "value": "paused"}}]
        messages.append(Message(len(messages), stream, MessageKind.UPSERT, entity["id"], again))
    assert await deliver(broker, messages) == []
    found = await broker.query(type="Task", id_pattern="^urn:ngsi-ld:Task:demo:ordered-")
    assert [entity["status"]["value"] for entity in found] == ["paused"] * len(streams)


class SlowDefinitions(httpx.AsyncBaseTransport):
    """Requests to a broker that refuses the first three with a definition; lists what was written."""

    def __init__(self) -> None:
        self.refused = 0
        self.written: list[str] = []
        self._transport = httpx.AsyncHTTPTransport(trust_env=False)

    async def handle_async_request(self, request: httpx.Request) -> httpx.Response:
        is_definition = b'"TaskDefinition"' in request.content
        if is_definition and self.refused < 3:
            self.refused += 1
            return httpx.Response(503, json={"title": "Starting"})
        response = await self._transport.handle_async_request(request)
        if request.method == "POST" and b'"Task' in request.content:
            self.written.append("definition" if is_definition else "other")
        return response

    async def aclose(self) -> None:
        await self._transport.aclose()


async def test_a_task_waits_until_its_definition_is_acknowledged(shared_cell: Cell) -> None:
    shared_cell.run("context_broker")
    transport = SlowDefinitions()
    definition = {
        "id": "urn:ngsi-ld:TaskDefinition:demo:slow",
        "type": "TaskDefinition",
        "name": {"type": "Property", "value": "Slow"},
    }
    link = {"type": "Relationship", "object": definition["id"]}
    messages = [
        Message(1, "definition p", MessageKind.DEFINE, str(definition["id"]), [definition]),
        create(2, "p-1", {**task("slow-1"), "isDefinedBy": link}),
        create(3, "p-1", {**task("slow-2"), "isDefinedBy": link}),
        create(4, "p-2", {**task("slow-3"), "isDefinedBy": link}),
    ]
    settings = Settings.load(broker_url=shared_cell.url("context_broker"))
    async with BrokerClient(settings, transport=transport) as client:
        assert await deliver(client, messages) == []
        assert transport.refused == 3
        assert transport.written[0] == "definition"
        found = await client.query(type="Task", id_pattern="^urn:ngsi-ld:Task:demo:slow-")
    assert len(found) == 3


async def test_a_definition_that_is_refused_for_good_rejects_its_tasks_only(broker: BrokerClient) -> None:
    bad = {"id": "urn:ngsi-ld:TaskDefinition:demo:bad", "type": "TaskDefinition", "name": {"type": "Wrong"}}
    link = {"type": "Relationship", "object": bad["id"]}
    messages = [
        Message(1, "definition p", MessageKind.DEFINE, str(bad["id"]), [bad]),
        create(2, "p-1", {**task("after-bad"), "isDefinedBy": link}),
        create(3, "p-2", task("beside-bad")),
    ]
    ((seq, why),) = await deliver(broker, messages, kept=1)
    assert seq == 2
    assert f"the broker does not accept {bad['id']}: " in why
    assert await broker.retrieve("urn:ngsi-ld:Task:demo:beside-bad")
    with pytest.raises(NotFound):
        await broker.retrieve("urn:ngsi-ld:Task:demo:after-bad")


async def test_a_refused_definition_is_forgotten_once_a_later_version_is_accepted(
    broker: BrokerClient,
) -> None:
    bad = {
        "id": "urn:ngsi-ld:TaskDefinition:demo:mended",
        "type": "TaskDefinition",
        "name": {"type": "Wrong"},
    }
    good = {**bad, "name": {"type": "Property", "value": "Mended"}}
    link = {"type": "Relationship", "object": bad["id"]}
    messages = [
        Message(1, "definition p", MessageKind.DEFINE, str(bad["id"]), [bad]),
        Message(2, "definition p", MessageKind.DEFINE, str(bad["id"]), [good]),
        create(3, "p-1", {**task("after-mended"), "isDefinedBy": link}),
    ]
    assert await deliver(broker, messages) == []
    assert await broker.retrieve("urn:ngsi-ld:Task:demo:after-mended")
