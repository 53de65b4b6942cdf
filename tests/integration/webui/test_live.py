"""Everything live over one WebSocket: what happens in the cell arrives, whatever dies and comes back."""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from typing import Any

import httpx
import orjson
import pytest
import uvicorn
from starlette.applications import Starlette
from starlette.routing import WebSocketRoute
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect as connect_now

from webui.audience import Audience
from webui.live import Live
from webui.world import World

pytestmark = pytest.mark.slow

TASK = "urn:ngsi-ld:Task:demo:wipe-1"
JOINTS = "robot/ur10-1/joints"


def entity(entity_id: str, status: str, at: str) -> dict[str, Any]:
    return {
        "id": entity_id,
        "type": "Task",
        "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:wipe"},
        "status": {"type": "Property", "value": status, "observedAt": at},
        "involves": {
            "type": "Property",
            "value": [{"type": "Relationship", "object": "urn:ngsi-ld:Device:demo:mop-1"}],
        },
        "workParameters": {"type": "Property", "value": {"description": "Wipe the table"}},
    }


class Broker:
    """The broker, as another program writes to it."""

    def __init__(self, http: httpx.Client) -> None:
        self._http = http

    def put(self, what: dict[str, Any]) -> None:
        self._http.post("/entities", json=what).raise_for_status()

    def move(self, task: str, status: str, at: str, **outputs: Any) -> None:
        change: dict[str, Any] = {"status": {"type": "Property", "value": status, "observedAt": at}}
        if outputs:
            change["outputParameters"] = {"type": "Property", "value": outputs}
        self._http.post(f"/entities/{task}/attrs", json=change).raise_for_status()

    def delete(self, entity_id: str) -> None:
        self._http.delete(f"/entities/{entity_id}").raise_for_status()


@pytest.fixture
def broker(cell: Any) -> Iterator[Broker]:
    url = f"{cell.url('context_broker')}/ngsi-ld/v1"
    context = '<https://w3id.org/handover/context.jsonld>; rel="http://www.w3.org/ns/json-ld#context"'
    with httpx.Client(base_url=url, headers={"Link": context}, timeout=120, trust_env=False) as http:
        yield Broker(http)


def task_moves(viewer: Any, task: str = TASK) -> list[str]:
    return [event["key"] for event in viewer.events if event["values"].get("task") == task]


def test_a_page_begins_with_everything_and_is_told_of_every_move(
    whole_cell: Any, look: Callable[[], Any], broker: Broker
) -> None:
    viewer = look()
    assert viewer.kinds == ["snapshot"]
    assert viewer.topics["cell"]["factory"] == "demo"
    assert viewer.topics["glove/glove-1"]["connected"] is False
    assert viewer.topics["robot/ur10-1"]["deviceState"] == "idle"
    assert viewer.topics["operator"] == {"running": False, "glove": "glove-1", "detail": None}
    viewer.read_until(lambda: "definition/bin-picking" in viewer.topics)
    assert viewer.topics["definition/bin-picking"]["title"] == "Bin picking"
    viewer.read_until(lambda: viewer.topics.get("device/urn:ngsi-ld:Device:demo:ur10-1"))
    names = ("context-broker", "task-orchestrator", "gesture-controller", "trajectory-tool")
    viewer.read_until(lambda: all(viewer.service(name)["state"] == "up" for name in names))

    broker.put(entity(TASK, "pending", "2999-01-01T00:00:00.000Z"))
    viewer.read_until(lambda: task_moves(viewer) == ["task.pending"])
    broker.move(TASK, "assigned", "2999-01-01T00:00:01.000Z")
    broker.move(TASK, "inProgress", "2999-01-01T00:00:02.000Z")
    broker.move(TASK, "pending", "2999-01-01T00:00:00.000Z")  # a late writer: not believed
    broker.move(TASK, "failed", "2999-01-01T00:00:03.000Z", reason="the mop is lost")
    viewer.read_until(lambda: "task.failed" in task_moves(viewer))
    assert task_moves(viewer) == ["task.pending", "task.assigned", "task.inProgress", "task.failed"]
    failed = viewer.events[-1]
    assert failed["level"] == "stop"
    assert failed["values"]["reason"] == "the mop is lost"
    assert failed["text"] == '"Wipe the table" fails with mop-1: the mop is lost'

    assert JOINTS not in viewer.topics
    viewer.want(JOINTS)
    viewer.read_until(lambda: JOINTS in viewer.topics)
    stamp = viewer.topics[JOINTS]["stamp"]
    viewer.read_until(lambda: viewer.topics[JOINTS]["stamp"] > stamp)


def test_a_broker_that_dies_is_said_to_be_down_and_is_followed_again_when_it_is_back(
    cell: Any, look: Callable[[], Any], broker: Broker
) -> None:
    cell.start("context_broker", "webui")
    viewer = look()
    viewer.read_until(lambda: viewer.service("context-broker")["state"] == "up")
    broker.put(entity(TASK, "pending", "2999-01-01T00:00:00.000Z"))
    viewer.read_until(lambda: task_moves(viewer) == ["task.pending"])
    cell.kill("context_broker")
    viewer.read_until(lambda: viewer.service("context-broker")["state"] == "down")
    assert "does not answer" in viewer.service("context-broker")["detail"]
    assert httpx.get(f"{cell.url('webui')}/readyz").is_success  # the page must be there to say so
    cell.start("context_broker")
    broker.move(TASK, "assigned", "2999-01-01T00:00:01.000Z")
    viewer.read_until(lambda: viewer.service("context-broker")["state"] == "up")
    viewer.read_until(lambda: task_moves(viewer) == ["task.pending", "task.assigned"])
    broker.move(TASK, "inProgress", "2999-01-01T00:00:02.000Z")
    viewer.read_until(lambda: "task.inProgress" in task_moves(viewer))
    told = [event["key"] for event in viewer.events if event["source"] == "context-broker"]
    assert told == ["service.down", "service.up"]


def test_a_server_started_anew_tells_what_happened_meanwhile_and_nothing_twice(
    cell: Any, look: Callable[[], Any], broker: Broker
) -> None:
    cell.start("context_broker", "webui")
    viewer = look()
    other = f"{TASK}-b"
    broker.put(entity(TASK, "pending", "2999-01-01T00:00:00.000Z"))
    broker.put(entity(other, "pending", "2999-01-01T00:00:00.000Z"))
    viewer.read_until(lambda: task_moves(viewer) and task_moves(viewer, other))
    last = viewer.events[-1]["seq"]
    cell.kill("webui")
    broker.move(TASK, "completed", "2999-01-01T00:00:05.000Z")
    cell.start("webui")
    viewer = look()
    viewer.read_until(lambda: "task.completed" in task_moves(viewer))
    assert task_moves(viewer) == ["task.pending", "task.completed"]
    assert task_moves(viewer, other) == ["task.pending"]
    seqs = [event["seq"] for event in viewer.events]
    assert seqs == sorted(set(seqs))
    asked = httpx.get(f"{cell.url('webui')}/api/events", params={"after": last}).json()
    assert [event["seq"] for event in asked] == [seq for seq in seqs if seq > last]
    assert all(event["at"] for event in asked)


def test_a_device_that_is_deleted_is_gone_from_the_page(
    cell: Any, look: Callable[[], Any], broker: Broker
) -> None:
    cell.start("context_broker", "webui")
    viewer = look()
    lamp = "urn:ngsi-ld:Device:demo:lamp-1"
    broker.put(
        {
            "id": lamp,
            "type": "Device",
            "controlledProperty": {"type": "Property", "value": ["light"]},
            "deviceState": {"type": "Property", "value": "error", "observedAt": "2999-01-01T00:00:00Z"},
            "batteryLevel": {"type": "Property", "value": 0.5},
        }
    )
    viewer.read_until(lambda: f"device/{lamp}" in viewer.topics)
    assert viewer.topics[f"device/{lamp}"]["batteryLevel"] == 0.5
    viewer.read_until(lambda: "device.state" in viewer.happened())
    assert viewer.events[-1]["level"] == "stop"
    broker.delete(lamp)
    viewer.read_until(lambda: f"device/{lamp}" not in viewer.topics)


def test_a_page_of_another_site_or_by_a_foreign_name_hears_nothing(cell: Any) -> None:
    cell.start("context_broker", "webui")
    url = f"ws{cell.url('webui').removeprefix('http')}/api/live"
    for headers in ({"Origin": "http://evil.example"}, {"Origin": "null"}):
        with pytest.raises(InvalidStatus) as refused:
            connect_now(url, additional_headers=headers, proxy=None).__enter__()
        assert refused.value.response.status_code == 403


# A page that does not read, against the real WebSocket but a world of our own, which says much.


@asynccontextmanager
async def shown(world: World, port: int, patience_s: float) -> AsyncIterator[str]:
    live = Live(world, Audience(), patience_s)
    app = Starlette(routes=[WebSocketRoute("/live", live.show)])
    server = uvicorn.Server(
        uvicorn.Config(
            app, port=port, log_config=None, timeout_graceful_shutdown=1, ws_per_message_deflate=False
        )
    )
    serving = asyncio.create_task(server.serve())
    while not server.started:
        await asyncio.sleep(0.01)
    try:
        yield f"ws://127.0.0.1:{port}/live"
    finally:
        server.should_exit = True
        await serving


async def newest(link: ClientConnection) -> int:
    """The number in the next batch that has one."""
    while True:
        batch = orjson.loads(await link.recv())
        if "numbers" in batch["topics"]:
            return int(batch["topics"]["numbers"][0])


async def read_to_the_end(link: ClientConnection) -> None:
    while True:
        await link.recv()


async def test_a_page_that_does_not_read_slows_nobody_and_is_let_go(free_port: Callable[[], int]) -> None:
    world = World()
    ballast = "x" * 500_000
    clock = asyncio.get_running_loop().time
    async with shown(world, free_port(), patience_s=1.5) as url:
        async with (
            connect(url, proxy=None, max_size=None, ping_interval=None) as quick,
            connect(url, proxy=None, max_size=None, max_queue=1, ping_interval=None) as slow,
        ):
            await quick.recv()
            number, worst_s, began_s = 0, 0.0, clock()
            while clock() - began_s < 4.0:
                number += 1
                told_s = clock()
                world.tell("numbers", [number, ballast])
                while await newest(quick) < number:
                    pass
                worst_s = max(worst_s, clock() - told_s)
            assert number > 30
            assert worst_s < 1.0
            with pytest.raises(ConnectionClosed):
                await asyncio.wait_for(read_to_the_end(slow), 20)
        async with connect(url, proxy=None, max_size=None, ping_interval=None) as again:
            first = orjson.loads(await again.recv())
            assert first["type"] == "snapshot"
            assert first["topics"]["numbers"][0] == number


async def test_a_page_that_reads_slowly_gets_the_newest_and_not_a_queue(free_port: Callable[[], int]) -> None:
    world = World()
    async with (
        shown(world, free_port(), patience_s=30.0) as url,
        connect(url, proxy=None, max_size=None, max_queue=1, ping_interval=None) as page,
    ):
        await page.recv()
        ballast = "x" * 500_000
        for number in range(1, 301):
            world.tell("numbers", [number, ballast])
            await asyncio.sleep(0.005)
        batches = 0
        while await newest(page) < 300:
            batches += 1
        assert batches < 60
