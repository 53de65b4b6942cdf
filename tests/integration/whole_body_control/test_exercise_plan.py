"""The exercise plans that are shipped run as processes: each part is a session of its person."""

from contextlib import AbstractContextManager
from typing import Any

import httpx

from tests.integration.whole_body_control.conftest import WITHIN_S, HumanoidCell
from tests.integration.whole_body_control.people import catching_patient, leading_patient, resume
from tests.kit.paths import REPOSITORY
from tests.kit.waiting import wait_for

PLANS = REPOSITORY / "services/whole_body_control/processes"


def run_plan(
    humanoid: HumanoidCell, plan: str, parameters: dict[str, Any], patient: AbstractContextManager[None]
) -> list[dict[str, Any]]:
    """Run a plan to its end with a patient; return the sessions of the person, in their order."""
    humanoid.cell.run("task_orchestrator")
    humanoid.start()
    with httpx.Client(base_url=humanoid.cell.url("task_orchestrator"), timeout=60, trust_env=False) as rest:
        xml = {"Content-Type": "application/xml"}
        content = (PLANS / f"{plan.replace('-', '_')}.bpmn").read_bytes()
        rest.post("/definitions", content=content, headers=xml).raise_for_status()
        body = {"definition": plan, "parameters": parameters}
        process = f"/processes/{rest.post('/processes', json=body).raise_for_status().json()['id']}"

        def is_over() -> bool:
            resume(humanoid)
            return bool(rest.get(process).json()["status"] in {"completed", "failed"})

        with patient:
            wait_for(is_over, 4 * WITHIN_S, "both exercises end")
        assert rest.get(process).json()["status"] == "completed"
    found: list[dict[str, Any]] = humanoid.http.get(
        "/sessions", params={"person": parameters["person"]}
    ).json()
    assert [one["endedBy"] for one in found] == ["goal", "goal"]
    assert all(one["task"] for one in found)
    return found[::-1]


def test_a_juggling_plan_runs_as_a_process(humanoid: HumanoidCell) -> None:
    parameters = {"person": "bert", "warmUpThrows": 1, "throws": 1}
    sessions = run_plan(humanoid, "juggling-exercise", parameters, catching_patient(humanoid))
    assert [one["throws"] for one in sessions] == [1, 1]


def test_a_walking_plan_runs_as_a_process_and_the_robot_is_led(humanoid: HumanoidCell) -> None:
    parameters = {"person": "clara", "warmUpSeconds": 5, "seconds": 10}
    sessions = run_plan(humanoid, "walking-exercise", parameters, leading_patient(humanoid))
    assert [one["application"] for one in sessions] == ["walking", "walking"]
    assert sessions[1]["distanceM"] > 0.1
    report = humanoid.http.get(f"/sessions/{sessions[1]['id']}/report").json()
    assert 3 < report["highestForceN"] < 15
