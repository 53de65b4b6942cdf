"""The sequence of the M2O2P paper (Figures 7, 9, 10): a MES defines, an engineer accepts, a cell performs.

The commands are those of docs/how-to/mes.md.
"""

import http.server
import os
import re
import subprocess
import threading
from collections.abc import Iterator
from functools import partial
from typing import Any

import httpx
import orjson
import pytest

from handover.runtime.python_processes import module_command
from tests.kit import processes
from tests.kit.cell import Cell
from tests.kit.other_broker.running import context_link
from tests.kit.paths import REPOSITORY
from tests.kit.waiting import wait_for

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

GUIDE = REPOSITORY / "docs" / "how-to" / "mes.md"
LINK = context_link()
GLOVE, ROBOT = "urn:ngsi-ld:Device:demo:glove-1", "urn:ngsi-ld:Device:demo:ur10-1"
MATERIAL = "urn:ngsi-ld:Material:demo:"


def commands() -> list[str]:
    """Return the shell commands of the guide: variables, definitions, offers, acceptance, start."""
    return re.findall(r"```sh\n(.*?)```", GUIDE.read_text(), re.DOTALL)


class Files(http.server.SimpleHTTPRequestHandler):
    """The file server of the MES."""

    def log_message(self, *_: object) -> None:
        pass


class Changes(http.server.BaseHTTPRequestHandler):
    """Another system that follows what happens in the broker."""

    seen: list[dict[str, Any]]

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.seen.extend(orjson.loads(body)["data"])
        self.send_response(204)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        pass


def served(handler: Any) -> Iterator[str]:
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()
    server.server_close()
    thread.join()


@pytest.fixture
def mes() -> Iterator[str]:
    yield from served(partial(Files, directory=str(GUIDE.parent)))


@pytest.fixture
def seen() -> list[dict[str, Any]]:
    return []


@pytest.fixture
def follower(seen: list[dict[str, Any]]) -> Iterator[str]:
    yield from served(type("Handler", (Changes,), {"seen": seen}))


class Shell:
    """Runs commands of the guide against a cell."""

    def __init__(self, cell: Cell, mes: str) -> None:
        self._variables, *self.commands = commands()
        self._environment = {
            **os.environ,
            "BROKER": cell.url("context_broker"),
            "ORCHESTRATOR": cell.url("task_orchestrator"),
            "MES": mes,
        }

    def run(self, command: str, **variables: str) -> Any:
        """Return what a command prints, read as JSON."""
        ran = subprocess.run(
            ["bash", "-euc", self._variables + command],
            env={**self._environment, **variables},
            capture_output=True,
            text=True,
            timeout=120,
        )
        assert ran.returncode == 0, ran.stderr
        return orjson.loads(ran.stdout) if ran.stdout.strip() else None


def value(entity: dict[str, Any], attribute: str) -> Any:
    return entity.get(attribute, {}).get("value")


def states_of(seen: list[dict[str, Any]], entity_id: str) -> list[str]:
    """Return the distinct states of an entity, in the order in which they were reported."""
    states = [value(entity, "status") for entity in seen if entity["id"] == entity_id]
    return [state for number, state in enumerate(states) if state not in states[:number]]


def test_a_process_of_a_mes_runs_in_the_order_of_the_paper(
    cell: Cell, mes: str, follower: str, seen: list[dict[str, Any]]
) -> None:
    cell.extra["HANDOVER_DETECTION_RATE"] = "1"
    cell.start("context_broker", "task_orchestrator", "trajectory_tool")
    shell = Shell(cell, mes)
    define, look, accept, start = shell.commands
    subscription = {
        "id": "urn:ngsi-ld:Subscription:demo:follower",
        "type": "Subscription",
        "entities": [{"type": each} for each in ("Task", "Process", "Device", "Alert")],
        "notification": {"endpoint": {"uri": follower, "accept": "application/json"}},
    }
    subscriptions = f"{cell.url('context_broker')}/ngsi-ld/v1/subscriptions"
    answer = httpx.post(subscriptions, json=subscription, headers={"Link": LINK}, timeout=120)
    assert answer.status_code == 201, answer.text

    shell.run(define)

    def offered() -> list[dict[str, Any]] | None:
        offers: list[dict[str, Any]] = shell.run(look)
        return offers if len(offers) == 5 else None

    offers = wait_for(offered, 60, "the definitions of the MES are not offered")
    by_type = {each["type"]: each for each in offers}
    assert [each["faults"] for each in offers] == [[]] * 5
    assert {line["performer"] for line in by_type["ProcessDefinition"]["allocation"]} == {
        "Device:glove-1",
        "Device:ur10-1",
    }
    for offer in offers:
        assert shell.run(accept, OFFER=offer["id"])["status"] == "accepted"
    assert shell.run(look) == []

    process = shell.run(start)
    show = f'curl -sS "$ORCHESTRATOR/processes/{process["id"]}"'
    first = f"urn:ngsi-ld:Task:demo:{process['id']}-allow_scan-1"

    def alert(is_active: bool) -> bool:
        alerts = [each for each in seen if each["type"] == "Alert" and each["alertSource"]["object"] == first]
        return bool(alerts) and ("validTo" not in alerts[-1]) is is_active

    wait_for(lambda: alert(is_active=True), 60, "nobody accepts the Task, and no Alert says so")
    cell.start("gesture_controller")
    glove = ["simulate", "--port", str(cell.ports["glove"]), "--controller", cell.url("gesture_controller")]
    operator = processes.spawn(
        [*module_command("glove_sdk_bridge"), *glove],
        {**cell.environment, "PYTHONPATH": str(REPOSITORY)},
        cell.data_dir / "operator.log",
        cell.data_dir,
    )
    try:

        def ended() -> dict[str, Any] | None:
            url = f"{cell.url('task_orchestrator')}/processes/{process['id']}"
            shown: dict[str, Any] = httpx.get(url, timeout=120).json()
            return shown if shown["endedAt"] else None

        shown = wait_for(ended, 120, lambda: f"the process does not end: {shell.run(show)}")
    finally:
        processes.stop(operator)
    assert (shown["status"], shown["reason"]) == ("completed", None)

    tasks = {task["element"]: task for task in shown["tasks"]}
    assert list(tasks) == ["allow_scan", "scan", "allow_pick", "pick"]
    assert tasks["allow_scan"]["workParameters"] == {
        "description": "Confirm that the robot may move above the bin",
        "gesture": "Thumbs up",
    }
    part = shown["variables"]["scan"]["part"]
    assert tasks["allow_pick"]["involves"] == [GLOVE, MATERIAL + part]
    assert tasks["pick"]["involves"] == [ROBOT, MATERIAL + part]
    assert shown["variables"]["pick"]["part"] == part

    reported = partial(states_of, seen, process["entity"])
    wait_for(lambda: reported()[-1:] == ["completed"], 60, "the Process is not reported")
    wait_for(lambda: alert(is_active=False), 60, "the Alert is not cleared")
    for task in tasks.values():
        assert states_of(seen, task["id"]) == ["pending", "assigned", "inProgress", "completed"]

    def position(entity_id: str, state: str) -> int:
        wanted = entity_id, state
        return next(n for n, each in enumerate(seen) if (each["id"], value(each, "status")) == wanted)

    steps = ("pending", "inProgress", "completed")
    order = [position(task["id"], state) for task in tasks.values() for state in steps]
    assert order == sorted(order)
    commanded = [each for each in seen if each["id"] == GLOVE and value(each, "commandId") is not None]
    assert commanded  # the controller reports the command of the gesture to the Device
    busy = [value(each, "deviceState") for each in seen if each["id"] == ROBOT]
    assert {"busy", "idle"} <= set(busy)
    stored = httpx.get(
        f"{cell.url('context_broker')}/ngsi-ld/v1/entities/{process['entity']}", timeout=120
    ).json()
    assert stored["isDefinedBy"]["object"] == "urn:ngsi-ld:ProcessDefinition:mes:supervised-pick"
    composed = [link["object"] for link in stored["isComposedOf"]["value"]]
    assert composed == [task["id"] for task in shown["tasks"]]
