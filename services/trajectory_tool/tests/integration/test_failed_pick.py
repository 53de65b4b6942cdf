"""A pick that fails in simulated physics ends in an incident with its reason."""

from typing import Any

import httpx
import pytest

from handover_robots.physics import is_available
from handover_robots.planning import is_available as is_planning_available
from services.task_orchestrator.tests.unit.drawing import drawing, end, path, start
from tests.kit.cell import Cell
from tests.kit.waiting import wait_for

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(300),
    pytest.mark.skipif(not (is_available() and is_planning_available()), reason="the extra physics"),
]

PICK = """<bpmn:serviceTask id="pick"><bpmn:extensionElements><handover:task definition="pick">
<handover:involves resource="Device:ur10-1"/>
<handover:parameter name="operation" value="pick"/><handover:parameter name="pose" expression="pose"/>
</handover:task></bpmn:extensionElements></bpmn:serviceTask>"""
IN_THE_AIR = {"position": [-0.5, -0.2, 0.4], "orientation": [1.0, 0.0, 0.0, 0.0]}


@pytest.mark.nightly
def test_a_pick_where_no_part_is_ends_in_an_incident_that_says_so(cell: Cell) -> None:
    cell.extra |= {"HANDOVER_ROBOT": "physics", "HANDOVER_SIMULATION_PACE": "0"}
    cell.run("context_broker", "task_orchestrator", "trajectory_tool")
    with httpx.Client(base_url=cell.url("task_orchestrator"), timeout=120) as orchestrator:
        file = drawing(start() + PICK + end() + path("start", "pick", "end"), name="pick-only")
        xml = {"Content-Type": "application/xml"}
        orchestrator.post("/definitions", content=file, headers=xml).raise_for_status()
        body = {"definition": "pick-only", "parameters": {"pose": IN_THE_AIR}}
        process = orchestrator.post("/processes", json=body).raise_for_status().json()["id"]

        def incident() -> dict[str, Any] | None:
            incidents = orchestrator.get(f"/processes/{process}").json().get("incidents")
            return dict(incidents[0]) if incidents else None

        seen = wait_for(incident, 90, "the failed pick is no incident")
        assert seen["element"] == "pick"
        assert "there was no part at" in seen["reason"]
        assert orchestrator.get(f"/processes/{process}").json()["status"] == "inProgress"
