"""The exercise plans that are shipped run as processes: each part is a session of its person."""

import math
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import httpx
import pytest

from services.whole_body_control.tests.integration.conftest import WITHIN_S, HumanoidCell
from services.whole_body_control.tests.integration.people import (
    catching_patient,
    heart_at,
    leading_patient,
    resume,
    stands,
)
from tests.kit.paths import REPOSITORY
from tests.kit.waiting import wait_for

PLANS = REPOSITORY / "services/whole_body_control/handover_humanoid/processes"


class Plan:
    """An exercise plan that runs as a process."""

    def __init__(
        self, humanoid: HumanoidCell, rest: httpx.Client, plan: str, parameters: dict[str, Any]
    ) -> None:
        self._humanoid, self._rest = humanoid, rest
        xml = {"Content-Type": "application/xml"}
        content = (PLANS / f"{plan.replace('-', '_')}.bpmn").read_bytes()
        rest.post("/definitions", content=content, headers=xml).raise_for_status()
        body = {"definition": plan, "parameters": parameters}
        self._process = f"/processes/{rest.post('/processes', json=body).raise_for_status().json()['id']}"

    def is_over(self) -> bool:
        """Resume what has paused, and return whether the process has ended."""
        resume(self._humanoid)
        return self.status() in {"completed", "failed"}

    def status(self) -> str:
        """Return the status of the process."""
        return str(self._rest.get(self._process).json()["status"])


@contextmanager
def running_plan(humanoid: HumanoidCell, plan: str, parameters: dict[str, Any]) -> Iterator[Plan]:
    """Start a plan."""
    humanoid.cell.run("task_orchestrator")
    humanoid.start()
    with httpx.Client(base_url=humanoid.cell.url("task_orchestrator"), timeout=60, trust_env=False) as rest:
        yield Plan(humanoid, rest, plan, parameters)


def run_plan(
    humanoid: HumanoidCell, plan: str, parameters: dict[str, Any], patient: AbstractContextManager[None]
) -> list[dict[str, Any]]:
    """Run a plan to its end with a patient; return the sessions of the person, in their order."""
    with running_plan(humanoid, plan, parameters) as running:
        with patient:
            wait_for(running.is_over, 4 * WITHIN_S, "both exercises end")
        assert running.status() == "completed"
    sessions = sessions_of(humanoid, parameters["person"])
    assert [session["endedBy"] for session in sessions] == ["goal", "goal"]
    assert all(session["task"] for session in sessions)
    return sessions


def sessions_of(humanoid: HumanoidCell, person: str) -> list[dict[str, Any]]:
    sessions: list[dict[str, Any]] = humanoid.http.get("/sessions", params={"person": person}).json()
    return sessions[::-1]


@pytest.mark.nightly
def test_a_juggling_plan_runs_as_a_process(humanoid: HumanoidCell) -> None:
    parameters = {"person": "bert", "warmUpThrows": 1, "throws": 1}
    sessions = run_plan(humanoid, "juggling-exercise", parameters, catching_patient(humanoid))
    assert [session["throws"] for session in sessions] == [1, 1]


@pytest.mark.nightly
def test_a_walking_plan_runs_as_a_process_and_the_robot_is_led(humanoid: HumanoidCell) -> None:
    parameters = {"person": "clara", "warmUpSeconds": 5, "seconds": 10}
    sessions = run_plan(humanoid, "walking-exercise", parameters, leading_patient(humanoid))
    assert [session["application"] for session in sessions] == ["walking", "walking"]
    assert sessions[1]["distanceM"] > 0.1
    report = humanoid.http.get(f"/sessions/{sessions[1]['id']}/report").json()
    assert 3 < report["highestForceN"] < 15


@pytest.mark.nightly
def test_a_limit_of_the_heart_rate_slows_a_walk_and_then_ends_the_plan_on_both_feet(
    humanoid: HumanoidCell,
) -> None:
    parameters = {"person": "aino", "warmUpSeconds": 3600, "seconds": 10}

    def speed_mps() -> float:
        wanted = humanoid.state()["velocityReference"]
        return math.hypot(*wanted) if wanted else 0.0

    def walks() -> bool:
        resume(humanoid)
        return not stands(humanoid) and speed_mps() > 0.04

    def walks_slowly() -> bool:
        resume(humanoid)
        limit = humanoid.state()["limit"]
        return bool(0 < limit["factor"] < 0.25) and 0 < speed_mps() < 0.03

    with heart_at(humanoid) as heart:
        wait_for(lambda: heart.allows(0.5), WITHIN_S, "the limit of a calm person")
        with running_plan(humanoid, "walking-exercise", parameters) as plan, leading_patient(humanoid):
            wait_for(walks, WITHIN_S, "the person leads it")
            heart.beats(150)
            wait_for(walks_slowly, WITHIN_S, "the limit slows it")
            heart.beats(195)
            wait_for(plan.is_over, WITHIN_S, "the limit ends the plan")
            assert plan.status() == "completed"
            wait_for(lambda: stands(humanoid), WITHIN_S, "it finishes its step")
            state = humanoid.state()
            assert state["limit"]["factor"] == 0.0
            assert state["velocityReference"] == [0.0, 0.0]
            assert all(state["feet"][side]["share"] > 0.2 for side in ("left", "right"))
    (session,) = sessions_of(humanoid, "aino")  # the longer walk is not begun
    assert session["endedBy"] == "limit"
    with httpx.Client(base_url=humanoid.cell.url("context_broker"), trust_env=False, timeout=60) as broker:
        task = broker.get(f"/ngsi-ld/v1/entities/{session['task']}", params={"options": "keyValues"}).json()
    assert task["status"] == "completed"
    assert task["outputParameters"]["endedBy"] == "limit"
