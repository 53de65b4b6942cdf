"""Processes and Tasks move an arm of Universal Robots: orchestrator, broker, trajectory tool, controller."""

from collections.abc import AsyncIterator
from typing import Any

import httpx
import pytest

from handover_datamodels.entities import TaskStatus
from handover_ur.states import RuntimeState, UrSafetyStatus
from services.trajectory_tool.tests.integration.test_tasks import AWAY, HOME, Shop, at_work
from tests.kit.cell import Cell
from tests.kit.ur_controllers import RunningController
from tests.kit.waiting import until

pytestmark = pytest.mark.slow

PROCESS = """<?xml version="1.0" encoding="UTF-8"?>
<bpmn:definitions xmlns:bpmn="http://www.omg.org/spec/BPMN/20100524/MODEL" xmlns:handover="urn:handover:bpmn"
    id="file" targetNamespace="urn:test">
  <bpmn:process id="there-and-back" isExecutable="true">
    <bpmn:startEvent id="begin" />
    <bpmn:sequenceFlow id="a" sourceRef="begin" targetRef="there" />
    <bpmn:serviceTask id="there">
      <bpmn:extensionElements>
        <handover:task definition="moveTo">
          <handover:involves expression="&quot;Device:ur10-1&quot;" />
          <handover:parameter name="joints" expression="[0.6, -1.2, 1.4, -1.5, -1.5, 0.0]" />
        </handover:task>
      </bpmn:extensionElements>
    </bpmn:serviceTask>
    <bpmn:sequenceFlow id="b" sourceRef="there" targetRef="back" />
    <bpmn:serviceTask id="back">
      <bpmn:extensionElements>
        <handover:task definition="home">
          <handover:involves expression="&quot;Device:ur10-1&quot;" />
        </handover:task>
      </bpmn:extensionElements>
    </bpmn:serviceTask>
    <bpmn:sequenceFlow id="c" sourceRef="back" targetRef="end" />
    <bpmn:endEvent id="end" />
  </bpmn:process>
</bpmn:definitions>
"""


@pytest.fixture
async def shop(cell: Cell, controller: RunningController) -> AsyncIterator[Shop]:
    """Return a shop whose robot is an arm of Universal Robots."""
    options = controller.options(gripper="tool_io")
    cell.extra["HANDOVER_ROBOT"] = "ur"
    cell.extra.update({f"HANDOVER_UR_{name.upper()}": str(value) for name, value in options.items()})
    async with at_work(cell) as made:
        yield made


@pytest.mark.nightly
async def test_a_process_moves_the_arm(shop: Shop, controller: RunningController) -> None:
    shop.cell.run("task_orchestrator")
    url = shop.cell.url("task_orchestrator")
    async with httpx.AsyncClient(base_url=url, timeout=60, trust_env=False) as api:
        deployed = await api.post(
            "/definitions", content=PROCESS, headers={"content-type": "application/xml"}
        )
        assert deployed.status_code == 201, deployed.text
        started = await api.post("/processes", json={"definition": "there-and-back"})
        process = started.json()["id"]
        moved = [0.0]

        async def is_completed() -> Any:
            moved[0] = max(moved[0], controller.do(lambda simulated: simulated.positions[0]))
            shown = (await api.get(f"/processes/{process}")).json()
            assert shown["status"] != "failed", shown
            return shown["status"] == "completed"

        await until(is_completed, 60.0, "the process does not end")
    assert moved[0] == pytest.approx(0.6, abs=0.02)
    assert controller.do(lambda simulated: tuple(simulated.positions)) == pytest.approx(HOME, abs=0.005)
    assert controller.do(lambda simulated: simulated.safety) is UrSafetyStatus.NORMAL


@pytest.mark.nightly
async def test_a_paused_task_continues_after_the_arm_was_moved_by_hand(
    shop: Shop, controller: RunningController
) -> None:
    task = await shop.ask("moveTo", joints=AWAY, speed=0.4)
    await shop.in_motion()
    await shop.wish(task, "paused")
    await shop.comes_to(task, TaskStatus.PAUSED)
    controller.do(lambda simulated: simulated.move_by_hand((0.1, 0.1, -0.1, 0.0, 0.0, 0.2)))
    await shop.wish(task, "inProgress")
    assert (await shop.comes_to(task, TaskStatus.COMPLETED))["joints"] == pytest.approx(AWAY, abs=0.005)
    assert controller.do(lambda simulated: simulated.safety) is UrSafetyStatus.NORMAL


@pytest.mark.nightly
async def test_a_task_fails_with_the_state_of_the_controller(
    shop: Shop, controller: RunningController
) -> None:
    task = await shop.ask("moveTo", joints=AWAY, speed=0.4)
    await shop.in_motion()
    controller.do(lambda simulated: simulated.protective_stop("collision"))
    failed = await shop.comes_to(task, TaskStatus.FAILED)
    assert "protective stop; remove the cause, then unlock the arm" in failed["reason"]
    async with httpx.AsyncClient(base_url=shop.cell.url("trajectory_tool"), timeout=120) as api:
        shown = (await api.get("/robots/ur10-1/limits")).json()["safetyStatus"]
    assert shown["protectiveStop"], shown
    assert shown["detailCode"] == "robot.ur_protective_stop", shown


@pytest.mark.nightly
async def test_the_arm_stops_when_the_tool_is_killed_and_continues_when_it_is_back(
    shop: Shop, controller: RunningController
) -> None:
    task = await shop.ask("moveTo", joints=AWAY, speed=0.3)
    await shop.in_motion()
    shop.cell.kill("trajectory_tool")
    await until(lambda: controller.do(lambda simulated: simulated.is_at_rest), why="the arm does not stop")
    await until(lambda: controller.do(lambda simulated: simulated.runtime) is RuntimeState.STOPPED)
    rest = controller.do(lambda simulated: simulated.positions[0])
    assert 0 < rest < AWAY[0]
    before_s = controller.do(lambda simulated: simulated.time_s)
    await until(lambda: controller.do(lambda simulated: simulated.time_s) > before_s + 0.2)
    assert controller.do(lambda simulated: simulated.positions[0]) == rest
    shop.cell.start("trajectory_tool")
    assert (await shop.comes_to(task, TaskStatus.COMPLETED))["joints"] == pytest.approx(AWAY, abs=0.005)
    assert controller.do(lambda simulated: simulated.safety) is UrSafetyStatus.NORMAL
