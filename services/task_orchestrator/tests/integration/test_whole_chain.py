"""Broker, orchestrator and performer together, and killed: processes end, nothing is done twice."""

import os
import random
import time
from typing import Any

import orjson
import pytest

from services.task_orchestrator.tests.integration.cell import Cell, eventually
from services.task_orchestrator.tests.unit.drawing import (
    ONE_STEP,
    activity,
    boundary,
    drawing,
    end,
    flow,
    path,
    start,
    timer,
)

pytestmark = pytest.mark.slow

FOUND = {"found": True, "part": "gear-3", "pose": {"position": [0.4, 0.1, 0.2], "orientation": [0, 0, 0, 1]}}
BIN_PICKING: dict[str, Any] = {
    "scan-1": {"found": False},
    "scan-2": FOUND,
    "pick-1": {"fails": "the part slipped"},
    "scan-3": FOUND,
}
STORY = [
    *(
        "confirm_clear-1",
        "home_before-1",
        "scan-1",
        "stir_bin-1",
        "scan-2",
        "confirm_pick-1",
        "pick-1",
        "free_part-1",
    ),
    *("scan-3", "confirm_pick-2", "pick-2", "confirm_grip-1", "place-1", "confirm_placed-1", "home_after-1"),
]


def play(running: Cell, script: dict[str, Any]) -> None:
    running.script_file.write_bytes(orjson.dumps(script))


def steps(running: Cell, process: str) -> list[str]:
    prefix = f"urn:ngsi-ld:Task:demo:{process}-"
    return [task.removeprefix(prefix) for task in running.done() if task.startswith(prefix)]


def deploy(running: Cell, body: str) -> None:
    answer = running.api.post(
        "/definitions", content=drawing(body), headers={"Content-Type": "application/xml"}
    )
    assert answer.is_success, answer.text


@pytest.mark.nightly
def test_bin_picking_goes_the_way_the_results_say(running: Cell) -> None:
    play(running, BIN_PICKING)
    process = running.start("bin-picking")
    seen = running.ended(process)
    assert (seen["status"], seen["reason"]) == ("completed", None)
    assert steps(running, process) == STORY
    entity = eventually(
        lambda: next(
            (e for e in [running.entity(seen["entity"])] if e and e["status"]["value"] == "completed"),
            None,
        ),
        "the Process entity being completed",
    )
    assert [link["object"] for link in entity["isComposedOf"]["value"]] == [
        task["id"] for task in seen["tasks"]
    ]
    assert entity["outputParameters"]["value"]["scan"]["part"] == "gear-3"
    definition = running.entity("urn:ngsi-ld:ProcessDefinition:demo:bin-picking")
    assert definition is not None
    assert definition["name"]["value"] == "Bin picking"
    ours = [
        each for each in running.of_type("TaskDefinition") if each["isPartOf"]["object"] == definition["id"]
    ]
    assert len(ours) == 12
    asked = running.entity(seen["tasks"][0]["id"])
    assert asked is not None
    assert asked["workParameters"]["value"]["gesture"] == "Thumbs up"
    assert running.alerts(process) == []


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("database_url", "victim"),
    [
        ("sqlite", "orchestrator"),
        ("sqlite", "broker"),
        ("sqlite", "performer"),
        ("postgresql", "orchestrator"),  # the others know nothing of its database
    ],
    indirect=["database_url"],
)
def test_after_any_service_is_killed_the_process_ends_and_nothing_is_repeated(
    running: Cell, database_url: str | None, victim: str
) -> None:
    seed = int(os.environ.get("KILL_SEED", random.randrange(10**6)))
    dice = random.Random(seed)
    play(running, BIN_PICKING)
    killed = {member.name: member for member in running.members}[victim]
    process = running.start("bin-picking")
    for done in (2, 6, 10):
        eventually(lambda done=done: len(steps(running, process)) >= done, f"step {done} (seed {seed})")  # type: ignore[misc]
        time.sleep(dice.uniform(0, 0.05))  # anywhere within a step: that is what is tried here
        killed.kill()
        killed.start()
    seen = running.ended(process)
    assert seen["status"] == "completed", f"seed {seed}: {seen['reason']}"
    assert steps(running, process) == STORY, f"seed {seed}"
    assert len(running.tasks(process)) == len(STORY), f"seed {seed}"


@pytest.mark.nightly
def test_many_processes_survive_kills_of_everybody(running: Cell) -> None:
    body = (
        start() + activity("a") + activity("b") + activity("c") + end() + path("start", "a", "b", "c", "end")
    )
    deploy(running, body)
    processes = [running.start("p") for _ in range(15)]
    for member in (running.orchestrator, running.broker, running.performer, running.orchestrator):
        eventually(lambda: any(steps(running, process) for process in processes), "the first step")
        member.kill()
        member.start()
    for process in processes:
        assert running.ended(process)["status"] == "completed"
        assert steps(running, process) == ["a-1", "b-1", "c-1"]


def test_a_process_started_while_the_broker_is_away_goes_on_when_it_is_back(running: Cell) -> None:
    running.broker.kill()
    deploy(running, ONE_STEP)
    process = running.start("p")
    assert running.look(process)["waiting"] == ["work"]
    running.broker.start()
    assert running.ended(process)["status"] == "completed"


def test_a_pending_task_that_somebody_deletes_is_posted_again(running: Cell) -> None:
    running.performer.kill()
    deploy(running, ONE_STEP)
    process = running.start("p")
    task = running.look(process)["tasks"][0]["id"]
    eventually(lambda: running.entity(task), "the Task")
    assert running.entities.delete(f"/{task}").status_code == 204
    eventually(lambda: running.entity(task), "the Task being there again")
    running.performer.start()
    assert running.ended(process)["status"] == "completed"
    assert steps(running, process) == ["work-1"]


def test_a_cancelled_process_stops_its_performer(running: Cell) -> None:
    play(running, {"work-1": {"after_s": 3}})
    deploy(running, ONE_STEP)
    process = running.start("p")
    task = running.look(process)["tasks"][0]["id"]
    eventually(lambda: running.look(process)["tasks"][0]["status"] == "inProgress", "the Task being begun")
    assert running.api.post(f"/processes/{process}/cancel").status_code == 200
    eventually(lambda: running.look(process)["tasks"][0]["status"] == "failed", "the Task being let go")
    entity = running.entity(task)
    assert entity is not None
    assert entity["outputParameters"]["value"]["reason"] == "cancelled"
    assert steps(running, process) == []


def test_a_task_nobody_takes_up_raises_an_alert_that_is_cleared_when_somebody_does(running: Cell) -> None:
    body = start() + activity("work", attributes='deadline="PT0.3S"') + end() + path("start", "work", "end")
    running.performer.kill()
    deploy(running, body)
    process = running.start("p")
    (alert,) = eventually(lambda: running.alerts(process), "the Alert")
    assert alert["subCategory"]["value"] == "taskNotAccepted"
    assert alert["alertSource"]["object"] == running.look(process)["tasks"][0]["id"]
    assert "validTo" not in alert
    running.performer.start()
    assert running.ended(process)["status"] == "completed"
    eventually(lambda: "validTo" in running.alerts(process)[0], "the Alert being over")
    assert len(running.alerts(process)) == 1


def test_a_failed_task_raises_an_alert(running: Cell) -> None:
    play(running, {"work-1": {"fails": "the part is not there"}})
    deploy(running, ONE_STEP)
    seen = running.stuck(running.start("p"))
    assert seen["incidents"][0]["reason"] == "the part is not there"
    (alert,) = eventually(lambda: running.alerts(seen["id"]), "the Alert")
    assert alert["subCategory"]["value"] == "processIncident"


def test_a_timer_fires_on_time_though_the_orchestrator_was_dead_meanwhile(running: Cell) -> None:
    late = (
        boundary("late", "work", timer("PT2S"))
        + activity("remind")
        + flow("late", "remind")
        + flow("remind", "end")
    )
    play(running, {"work-1": {"after_s": 60}})
    deploy(running, ONE_STEP + late)
    process = running.start("p")
    eventually(lambda: running.look(process)["tasks"][0]["status"] == "inProgress", "the Task being begun")
    running.orchestrator.kill()
    running.orchestrator.start()
    assert running.ended(process)["status"] == "completed"
    assert steps(running, process) == ["remind-1"]
    cancelled = running.look(process)["tasks"][0]
    assert (cancelled["element"], cancelled["cancelled"]) == ("work", True)
