"""Retry with broker, orchestrator and performer as they run, and killed between a retry and its effect."""

from typing import Any

import orjson
import pytest

from services.task_orchestrator.tests.integration.cell import Cell, eventually
from services.task_orchestrator.tests.unit.drawing import (
    ONE_STEP,
    activity,
    drawing,
    end,
    gateway,
    path,
    start,
)

pytestmark = pytest.mark.slow

BRANCHES = (
    start()
    + gateway("fork", "parallel")
    + activity("a")
    + activity("b").replace("Device:glove-1", "Device:ur10-1")
    + gateway("join", "parallel")
    + activity("last")
    + end()
    + path("start", "fork", "a", "join", "last", "end")
    + path("fork", "b", "join")
)


def play(running: Cell, **script: Any) -> None:
    running.script_file.write_bytes(
        orjson.dumps({name.replace("_", "-"): said for name, said in script.items()})
    )


def deploy(running: Cell, body: str) -> None:
    assert running.api.post(
        "/definitions", content=drawing(body), headers={"Content-Type": "application/xml"}
    ).is_success


def steps(running: Cell, process: str) -> list[str]:
    prefix = f"urn:ngsi-ld:Task:demo:{process}-"
    return sorted(task.removeprefix(prefix) for task in running.done() if task.startswith(prefix))


def retry(running: Cell, seen: dict[str, Any]) -> dict[str, Any]:
    url = f"/processes/{seen['id']}/tasks/{seen['retry']}/retry"
    answer = running.api.post(url, json={"by": "Anna"})
    assert answer.status_code == 200, answer.text
    goes_on: dict[str, Any] = answer.json()
    return goes_on


@pytest.mark.nightly
def test_a_retried_process_goes_on_in_the_broker_too_and_its_alert_is_over(running: Cell) -> None:
    play(running, work_1={"fails": "the part slipped"}, work_2={"grip": 3})
    deploy(running, ONE_STEP)
    seen = running.stuck(running.start("p"))
    assert seen["incidents"][0]["reason"] == "the part slipped"
    eventually(lambda: running.alerts(seen["id"]), "the Alert")
    retry(running, seen)
    seen = running.ended(seen["id"])
    assert (seen["status"], seen["variables"]["work"]["grip"]) == ("completed", 3)
    assert [(each["visit"], each["status"]) for each in seen["tasks"]] == [
        (1, "failed"),
        (2, "completed"),
    ]
    eventually(lambda: "validTo" in running.alerts(seen["id"])[0], "the Alert being over")

    def reported() -> dict[str, Any] | None:
        entity = running.entity(seen["entity"])
        return entity if entity and entity["status"]["value"] == "completed" else None

    entity = eventually(reported, "the Process entity being completed")
    assert len(entity["isComposedOf"]["value"]) == 2


@pytest.mark.nightly
def test_killed_between_a_retry_and_its_effect_nothing_is_lost_and_nothing_done_twice(
    running: Cell, database_url: str | None
) -> None:
    play(running, a_1={"fails": "no"}, b_1={"after_s": 5})
    deploy(running, BRANCHES)
    seen = running.stuck(running.start("p"))
    running.broker.kill()
    goes_on = retry(running, seen)
    running.orchestrator.kill()
    running.orchestrator.start()
    assert running.look(seen["id"]) == goes_on
    assert steps(running, seen["id"])[:1] == ["a-1"]
    running.broker.start()
    seen = running.ended(seen["id"])
    assert (seen["status"], seen["reason"]) == ("completed", None)
    assert steps(running, seen["id"]) == ["a-1", "a-2", "b-1", "last-1"]
    assert len(running.tasks(seen["id"])) == 4


@pytest.mark.nightly
def test_a_retry_of_the_policy_survives_a_kill_and_is_done_once(
    running: Cell, database_url: str | None
) -> None:
    play(running, work_1={"fails": "the part slipped"})
    policy = '<handover:retry attempts="2" delay="PT3S"/>'
    deploy(running, ONE_STEP.replace("<handover:task", f"{policy}<handover:task", 1))
    process = running.start("p")
    seen = eventually(lambda: _retrying(running, process), "the wait for the next attempt")
    (waiting,) = seen["retries"]
    assert (waiting["failed"], waiting["attempts"], seen["incidents"]) == (1, 2, [])
    running.orchestrator.kill()
    running.orchestrator.start()
    assert running.look(process)["retries"] in ([waiting], [])
    seen = running.ended(process)
    assert seen["status"] == "completed"
    assert steps(running, process) == ["work-1", "work-2"]
    assert seen["tasks"][1]["createdAt"] >= waiting["due"]


def _retrying(running: Cell, process: str) -> dict[str, Any] | None:
    seen = running.look(process)
    return seen if seen["retries"] else None


def test_an_incident_does_not_stop_the_other_branch(running: Cell) -> None:
    play(running, a_1={"fails": "no"}, b_1={"after_s": 1})
    deploy(running, BRANCHES)
    process = running.start("p")
    running.stuck(process)
    eventually(lambda: "b-1" in steps(running, process), "b being done")
    retry(running, running.look(process))
    seen = running.ended(process)
    assert seen["status"] == "completed"
    assert steps(running, process) == ["a-1", "a-2", "b-1", "last-1"]
