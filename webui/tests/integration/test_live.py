"""The live WebSocket: changes in the cell arrive, also after restarts of services."""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from typing import Any

import httpx
import orjson
import pytest
import uvicorn
from pydantic import TypeAdapter
from starlette.applications import Starlette
from starlette.routing import WebSocketRoute
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect as connect_now

from handover_processes.documents.definitions import DefinitionView
from handover_processes.documents.processes import ProcessView
from handover_web.live.live_socket import LiveSocket
from handover_web.live.live_state import LiveState
from handover_web.live.viewers import Viewers
from handover_web.live.views import ORCHESTRATOR_TOPICS, TOPICS, LiveEvent, type_of_topic
from services.task_orchestrator.tests.unit.drawing import drawing
from tests.kit.other_broker.running import context_link
from tests.kit.waiting import scaled

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
    """A client that writes to the broker like another program."""

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
    with httpx.Client(base_url=url, headers={"Link": context_link()}, timeout=120, trust_env=False) as http:
        yield Broker(http)


OF_ORCHESTRATOR = {"DefinitionView": DefinitionView, "ProcessView": ProcessView}


def check_type(topic: str, value: Any) -> None:
    """Check the value of a topic against its type."""
    schema = ORCHESTRATOR_TOPICS.get(topic.partition("/")[0] + "/")
    type_ = type_of_topic(topic) if schema is None else OF_ORCHESTRATOR[schema]
    TypeAdapter(type_).validate_json(orjson.dumps(value), strict=True)


def task_moves(viewer: Any, task: str = TASK) -> list[str]:
    return [event["key"] for event in viewer.events if event["values"].get("task") == task]


@pytest.mark.nightly
def test_a_page_receives_a_snapshot_and_every_change(
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
    broker.move(TASK, "pending", "2999-01-01T00:00:00.000Z")  # a late write: rejected
    broker.move(TASK, "failed", "2999-01-01T00:00:03.000Z", reason="the mop is lost")
    viewer.read_until(lambda: "task.failed" in task_moves(viewer))
    assert task_moves(viewer) == ["task.pending", "task.assigned", "task.inProgress", "task.failed"]
    failed = viewer.events[-1]
    assert failed["level"] == "stop"
    assert failed["values"]["reason"] == "the mop is lost"
    assert failed["text"] == '"Wipe the table" failed with mop-1: the mop is lost'

    assert JOINTS not in viewer.topics
    viewer.subscribe(JOINTS)
    viewer.read_until(lambda: JOINTS in viewer.topics)
    stamp = viewer.topics[JOINTS]["stamp"]
    viewer.read_until(lambda: viewer.topics[JOINTS]["stamp"] > stamp)


@pytest.mark.nightly
def test_an_incident_and_what_a_person_does_about_it_arrive(
    whole_cell: Any, look: Callable[[], Any], broker: Broker, browser: httpx.Client
) -> None:
    viewer = look()
    processes = "/api/task-orchestrator/processes"
    begun = browser.post(processes, json={"definition": "bin-picking"}).raise_for_status().json()
    viewer.read_until(lambda: viewer.process().get("tasks", [{}])[0].get("status") == "inProgress")
    [task] = viewer.process()["tasks"]
    broker.move(task["id"], "failed", "2999-01-01T00:00:00.000Z", reason="nobody was there")
    viewer.read_until(lambda: viewer.process()["incidents"])
    [incident] = viewer.process()["incidents"]
    assert (incident["element"], incident["task"]) == ("confirm_clear", task["id"])
    assert viewer.process()["status"] == "inProgress"
    viewer.read_until(lambda: "process.incident" in viewer.event_keys())
    [event] = [event for event in viewer.events if event["key"] == "process.incident"]
    assert event["level"] == "stop"
    assert event["values"]["name"] == "Confirm that the cell is clear"
    assert event["values"]["reason"] == "nobody was there"
    check_type(f"process/{begun['id']}", viewer.process())

    # No entity in the broker changes with a variable: the server reads what a page has written.
    decision = {"by": "Anna", "why": "another shift", "variables": {"shift": 2}}
    browser.post(f"{processes}/{begun['id']}/variables", json=decision).raise_for_status()
    viewer.read_until(lambda: viewer.process()["variables"].get("shift") == 2)
    [act] = viewer.process()["acts"]
    assert (act["act"], act["by"], act["verified"], act["why"]) == (
        "setVariables", "Anna", False, "another shift",
    )  # fmt: skip
    check_type(f"process/{begun['id']}", viewer.process())


@pytest.mark.nightly
@pytest.mark.usefixtures("whole_cell")
def test_all_topics_match_their_types(look: Callable[[], Any], browser: httpx.Client) -> None:
    viewer = look()
    viewer.subscribe(JOINTS)
    begun = {"definition": "bin-picking", "parameters": {"robot": "Device:ur10-2"}}
    browser.post("/api/task-orchestrator/processes", json=begun).raise_for_status()
    file = drawing('<bpmn:userTask id="weigh" name="Weigh the part"/>', name="weighing")
    definitions = "/api/task-orchestrator/definitions"
    browser.post(definitions, content=file, headers={"Content-Type": "application/xml"}).raise_for_status()
    weighing = {"definition": "weighing"}  # its Task is one for people, so it is in the tasklist
    process = browser.post("/api/task-orchestrator/processes", json=weighing).raise_for_status().json()["id"]
    comment = {"by": "Anna", "text": "the scale drifts"}
    browser.post(f"/api/task-orchestrator/processes/{process}/comments", json=comment).raise_for_status()
    not_here = {"people", "alert", "registeredDevices", "registeredDevice"}
    families = {name.rstrip("/") for name in (*TOPICS, *ORCHESTRATOR_TOPICS)} - not_here
    viewer.read_until(lambda: JOINTS in viewer.topics and viewer.process().get("tasks"))
    viewer.read_until(lambda: families <= {topic.partition("/")[0] for topic in viewer.topics})
    assert viewer.topics["comments"] == {"counts": {process: 1}}
    for topic, value in viewer.topics.items():
        check_type(topic, value)
    TypeAdapter(list[LiveEvent]).validate_python(viewer.events, strict=True)


def test_a_killed_broker_is_shown_as_down_and_followed_again_after_its_restart(
    cell: Any, look: Callable[[], Any], broker: Broker
) -> None:
    cell.start("context_broker", "webui")
    viewer = look()
    viewer.read_until(lambda: viewer.service("context-broker")["state"] == "up")
    broker.put(entity(TASK, "pending", "2999-01-01T00:00:00.000Z"))
    viewer.read_until(lambda: task_moves(viewer) == ["task.pending"])
    cell.kill("context_broker")
    viewer.read_until(lambda: viewer.service("context-broker")["state"] == "down")
    assert "does not respond" in viewer.service("context-broker")["detail"]
    assert httpx.get(
        f"{cell.url('webui')}/readyz", timeout=120
    ).is_success  # the page must be there to say so
    cell.start("context_broker")
    broker.move(TASK, "assigned", "2999-01-01T00:00:01.000Z")
    viewer.read_until(lambda: viewer.service("context-broker")["state"] == "up")
    viewer.read_until(lambda: task_moves(viewer) == ["task.pending", "task.assigned"])
    broker.move(TASK, "inProgress", "2999-01-01T00:00:02.000Z")
    viewer.read_until(lambda: "task.inProgress" in task_moves(viewer))
    received = [event["key"] for event in viewer.events if event["source"] == "context-broker"]
    # On a busy machine a check may time out as well.
    assert received
    assert received == ["service.down", "service.up"] * (len(received) // 2)


def test_a_restarted_server_reports_missed_events_once(
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
    asked = httpx.get(f"{cell.url('webui')}/api/events", params={"after": last}, timeout=120).json()
    assert [event["seq"] for event in asked] == [seq for seq in seqs if seq > last]
    assert all(event["at"] for event in asked)


def test_deleted_devices_disappear_from_the_page(cell: Any, look: Callable[[], Any], broker: Broker) -> None:
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
    viewer.read_until(lambda: "device.state" in viewer.event_keys())
    assert [one["level"] for one in viewer.events if one["key"] == "device.state"] == ["stop"]
    broker.delete(lamp)
    viewer.read_until(lambda: f"device/{lamp}" not in viewer.topics)


def test_live_connections_of_other_origins_are_rejected(cell: Any) -> None:
    cell.start("context_broker", "webui")
    url = f"ws{cell.url('webui').removeprefix('http')}/api/live"
    for headers in ({"Origin": "http://evil.example"}, {"Origin": "null"}):
        with pytest.raises(InvalidStatus) as refused:
            connect_now(url, additional_headers=headers, proxy=None).__enter__()
        assert refused.value.response.status_code == 403


# A page that does not read, with a real WebSocket and a live state that changes often.


@asynccontextmanager
async def serve_live(state: LiveState, port: int, send_timeout_s: float) -> AsyncIterator[str]:
    live = LiveSocket(state, Viewers(), send_timeout_s)
    app = Starlette(routes=[WebSocketRoute("/live", live.serve)])
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


async def next_number(link: ClientConnection) -> int:
    """Return the number in the next batch with one."""
    while True:
        batch = orjson.loads(await link.recv())
        if "numbers" in batch["topics"]:
            return int(batch["topics"]["numbers"][0])


async def read_to_the_end(link: ClientConnection) -> None:
    while True:
        await link.recv()


@pytest.mark.nightly
async def test_a_page_that_does_not_read_is_disconnected(
    free_port: Callable[[], int],
) -> None:
    state = LiveState()
    ballast = "x" * 500_000
    clock = asyncio.get_running_loop().time
    async with serve_live(state, free_port(), send_timeout_s=1.5) as url:
        async with (
            connect(url, proxy=None, max_size=None, ping_interval=None) as quick,
            connect(url, proxy=None, max_size=None, max_queue=1, ping_interval=None) as slow,
        ):
            await quick.recv()
            number, worst_s, began_s = 0, 0.0, clock()
            while clock() - began_s < 4.0:
                number += 1
                published_s = clock()
                state.publish("numbers", [number, ballast])
                while await next_number(quick) < number:
                    pass
                worst_s = max(worst_s, clock() - published_s)
            assert number > 30
            assert worst_s < 1.0
            with pytest.raises(ConnectionClosed):
                await asyncio.wait_for(read_to_the_end(slow), scaled(20))
        async with connect(url, proxy=None, max_size=None, ping_interval=None) as again:
            first = orjson.loads(await again.recv())
            assert first["type"] == "snapshot"
            assert first["topics"]["numbers"][0] == number


async def test_a_slow_page_receives_the_newest_values_only(free_port: Callable[[], int]) -> None:
    state = LiveState()
    async with (
        serve_live(state, free_port(), send_timeout_s=30.0) as url,
        connect(url, proxy=None, max_size=None, max_queue=1, ping_interval=None) as page,
    ):
        await page.recv()
        ballast = "x" * 500_000
        for number in range(1, 301):
            state.publish("numbers", [number, ballast])
            await asyncio.sleep(0.005)
        batches = 0
        while await next_number(page) < 300:
            batches += 1
        assert batches < 60
