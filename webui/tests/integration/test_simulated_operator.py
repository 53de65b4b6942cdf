"""The simulated operator, started from the page: completes a process, and ends with the server."""

import socket
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import httpx
import psutil
import pytest

from tests.kit.cell import Cell

pytestmark = [pytest.mark.slow, pytest.mark.timeout(240)]


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    """One cell for all of these tests: no operator outlives its test."""
    return shared_cell


def operators(cell: Cell) -> list[psutil.Process]:
    """The operators that the server has started and that live."""
    found = []
    for child in psutil.Process(cell.processes["webui"].pid).children():
        with suppress(psutil.NoSuchProcess):  # one that has just died is a zombie without a command line
            if "glove_sdk_bridge" in child.cmdline():
                found.append(child)
    return found


@pytest.mark.nightly
def test_the_operator_completes_a_process(
    whole_cell: Cell, look: Callable[[], Any], browser: httpx.Client
) -> None:
    viewer = look()
    started = browser.post("/api/operator", json={"glove": "glove-1"})
    assert started.status_code == 201
    assert started.json()["running"] is True
    viewer.read_until(lambda: viewer.topics["operator"]["running"])
    viewer.read_until(lambda: viewer.topics["glove/glove-1"]["connected"])
    twice = browser.post("/api/operator", json={"glove": "glove-1"})
    assert twice.status_code == 409
    assert "glove-1" in twice.json()["detail"]

    process = browser.post("/api/task-orchestrator/processes", json={"definition": "bin-picking"}).json()
    seen_holds, seen_progress = set(), set()

    def completed() -> bool:
        seen_holds.add(viewer.topics["glove/glove-1"]["hold"]["heldMs"])
        seen_progress.add(viewer.topics["robot/ur10-1"]["progress"])
        return bool(viewer.topics.get(f"process/{process['id']}", {}).get("status") == "completed")

    viewer.read_until(completed, 150)
    assert max(seen_holds) > 1000
    assert len(seen_progress) > 5
    viewer.read_until(lambda: "process.completed" in viewer.event_keys())
    tasks = viewer.topics[f"process/{process['id']}"]["tasks"]
    for task in tasks:
        moves = [event["key"] for event in viewer.events if event["values"].get("task") == task["id"]]
        assert moves[0] == "task.pending"
        assert moves[-1] == "task.completed"
        assert len(moves) == len(set(moves))
    assert viewer.event_keys().count("process.started") == 1

    stopped = browser.delete("/api/operator")
    assert stopped.json()["running"] is False
    assert operators(whole_cell) == []
    assert browser.delete("/api/operator").status_code == 200
    viewer.read_until(lambda: not viewer.topics["glove/glove-1"]["connected"])
    viewer.read_until(lambda: viewer.event_keys("operator.") == ["operator.started", "operator.stopped"])


def test_the_operator_is_restarted_and_ends_with_the_server(
    cell: Cell, browser: httpx.Client, eventually: Callable[..., None]
) -> None:
    cell.run("context_broker", "gesture_controller", "webui")
    assert browser.post("/api/operator", json={"glove": "glove-2"}).status_code == 201
    eventually(lambda: operators(cell), 30)
    (first,) = operators(cell)
    first.kill()
    eventually(lambda: any(operator.pid != first.pid for operator in operators(cell)), 30)
    (second,) = operators(cell)
    cell.kill("webui")
    eventually(lambda: not second.is_running() or second.status() == psutil.STATUS_ZOMBIE, 30)


def test_a_connected_glove_is_not_taken_over(
    cell: Cell, look: Callable[[], Any], browser: httpx.Client
) -> None:
    cell.run("context_broker", "gesture_controller", "webui")
    viewer = look()
    with socket.create_connection(("127.0.0.1", cell.ports["glove"])) as glove:
        glove.sendall(b'{"type": "hello", "version": 1, "glove": "glove-1", "hand": "right"}\n')
        viewer.read_until(lambda: viewer.topics.get("glove/glove-1", {}).get("connected"))
        worn = browser.post("/api/operator", json={"glove": "glove-1"})
    assert worn.status_code == 409
    assert "glove-1 is connected" in worn.json()["detail"]
    assert browser.post("/api/operator", json={"glove": "no glove"}).status_code == 400
    assert operators(cell) == []
