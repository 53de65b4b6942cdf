"""The exercise plan that is shipped runs as a process: each part is a session of its person."""

import httpx

from tests.integration.whole_body_control.conftest import WITHIN_S, HumanoidCell
from tests.integration.whole_body_control.people import catching_patient, resume
from tests.kit.paths import REPOSITORY
from tests.kit.waiting import wait_for

PLAN = REPOSITORY / "services/whole_body_control/processes/juggling_exercise.bpmn"


def test_an_exercise_plan_runs_as_a_process(humanoid: HumanoidCell) -> None:
    humanoid.cell.run("task_orchestrator")
    humanoid.start()
    with httpx.Client(base_url=humanoid.cell.url("task_orchestrator"), timeout=60, trust_env=False) as rest:
        xml = {"Content-Type": "application/xml"}
        rest.post("/definitions", content=PLAN.read_bytes(), headers=xml).raise_for_status()
        parameters = {"person": "bert", "warmUpThrows": 1, "throws": 1}
        body = {"definition": "juggling-exercise", "parameters": parameters}
        process = f"/processes/{rest.post('/processes', json=body).raise_for_status().json()['id']}"

        def is_over() -> bool:
            resume(humanoid)
            return bool(rest.get(process).json()["status"] in {"completed", "failed"})

        with catching_patient(humanoid):
            wait_for(is_over, 4 * WITHIN_S, "both exercises end")
        assert rest.get(process).json()["status"] == "completed"
    sessions = humanoid.http.get("/sessions", params={"person": "bert"}).json()
    assert [one["endedBy"] for one in sessions] == ["goal", "goal"]
    assert all(one["task"] for one in sessions)
