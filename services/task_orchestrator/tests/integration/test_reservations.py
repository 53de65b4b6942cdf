"""Reservations over REST: two processes on one robot work one after the other, also across kills."""

import itertools
from typing import Any

import orjson
import pytest

from services.task_orchestrator.tests.integration.cell import Cell, eventually
from services.task_orchestrator.tests.unit.drawing import activity, drawing, end, path, start

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("allocation")]

ROBOT = "urn:ngsi-ld:Device:demo:ur10-1"
FOUND = {"found": True, "part": "part-1", "pose": {"position": [0.4, 0.1, 0.2], "orientation": [0, 0, 0, 1]}}


def of_process(running: Cell, process: str, state: str) -> dict[str, Any] | None:
    found = running.look(process)["reservations"]
    return next((each for each in found if each["state"] == state), None)


@pytest.mark.nightly
def test_two_bin_picking_processes_on_one_robot_work_one_after_the_other(running: Cell) -> None:
    running.script_file.write_bytes(orjson.dumps({"scan-1": FOUND, "scan-2": FOUND}))
    first, second = running.start("bin-picking"), running.start("bin-picking")
    waiting = eventually(lambda: of_process(running, second, "waiting"), "the second process waits")
    assert waiting["element"] == "bin-picking"
    ended = [running.ended(each) for each in (first, second)]
    assert [each["status"] for each in ended] == ["completed", "completed"]
    done = [task for task in running.done() if f":{first}-" in task or f":{second}-" in task]
    holders = [name for name, _ in itertools.groupby(done, key=lambda task: f":{first}-" in task)]
    assert holders == [True, False], f"the processes interleave: {done}"
    held = [each["reservations"] for each in ended]
    assert [[(r["state"], r["agents"]) for r in each] for each in held] == [[("ended", [ROBOT])]] * 2
    assert held[1][0]["heldAt"] >= held[0][0]["since"]


def stuck_holder(running: Cell, name: str) -> tuple[str, str, str]:
    """Return a process with an incident that holds the robot, its token, and a process that waits for it."""
    body = start() + activity("grip") + end() + path("start", "grip", "end")
    reserve = '<bpmn:extensionElements><handover:reserve resource="Device:ur10-1"/></bpmn:extensionElements>'
    file = drawing(reserve + body.replace("glove-1", "ur10-1"), name=name)
    answer = running.api.post("/definitions", content=file, headers={"Content-Type": "application/xml"})
    assert answer.is_success, answer.text
    running.script_file.write_bytes(orjson.dumps({"grip-1": {"fails": "the part slipped"}}))
    holder = running.start(name)
    (incident,) = running.stuck(holder)["incidents"]
    waiting = running.start(name)
    reason = eventually(lambda: of_process(running, waiting, "waiting"), "the second process waits")
    assert reason["reasonCode"] == "reservation.held"
    assert reason["reasonParameters"]["process"] == holder
    return holder, str(incident["token"]), waiting


@pytest.mark.nightly
def test_an_incident_keeps_the_robot_across_kill_9_until_an_engineer_releases_it(running: Cell) -> None:
    holder, token, waiting = stuck_holder(running, "slips")
    running.orchestrator.kill()
    running.script_file.write_text("{}")
    running.orchestrator.start()
    held = eventually(lambda: of_process(running, holder, "held"), "the reservation after the restart")
    assert held["agents"] == [ROBOT]
    assert running.look(waiting)["tasks"] == []
    url = f"/processes/{holder}/reservations/{held['key']}/release"
    answer = running.api.post(url, json={"by": "Anna", "why": "the gripper is empty"})
    assert answer.status_code == 200, answer.text
    assert running.ended(waiting)["status"] == "completed"
    seen = running.look(holder)
    assert [(act["act"], act["by"], act["why"]) for act in seen["acts"]] == [
        ("release", "Anna", "the gripper is empty")
    ]
    assert [each["state"] for each in seen["reservations"]] == ["released"]
    assert running.api.post(url, json={"by": "Anna"}).status_code == 409
    retried = running.api.post(f"/processes/{holder}/tokens/{token}/retry", json={"by": "Anna"})
    assert retried.is_success, retried.text
    assert running.ended(holder)["status"] == "completed"


def test_cancelling_a_process_gives_the_robot_to_the_one_that_waits(running: Cell) -> None:
    holder, _, waiting = stuck_holder(running, "drops")
    running.script_file.write_text("{}")
    assert running.api.post(f"/processes/{holder}/cancel", json={"by": "Anna"}).is_success
    assert running.ended(waiting)["status"] == "completed"
    assert of_process(running, holder, "ended") is not None
