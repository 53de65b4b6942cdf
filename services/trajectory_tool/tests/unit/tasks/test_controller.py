"""The controller's judgement, with a broker that is not there: nothing here depends on an answer of it."""

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from prometheus_client import REGISTRY

from handover.broker import BrokerClient
from handover.performer import Job, TaskFailed
from handover.tasks.finished_tasks import FinishedTasks
from handover_datamodels.entities import DeviceState, Task
from handover_robots.settings import TrajectorySettings
from handover_robots.tasks.controller import Controller, Controllers


@pytest.fixture
async def controller(tmp_path: Path, free_port: Any) -> AsyncIterator[Controller]:
    settings = TrajectorySettings.load(
        data_dir=tmp_path, broker_url=f"http://127.0.0.1:{free_port()}", robot_speed=1.0
    )
    async with BrokerClient(settings) as broker:
        made = Controllers(settings, broker).by_name["ur10-1"]
        async with made.unit:
            yield made


def a_job(
    controller: Controller, definition: str = "home", involves: tuple[str, ...] = (), **parameters: Any
) -> Job:
    task = Task.from_ngsild(
        {
            "id": "urn:ngsi-ld:Task:demo:t",
            "type": "Task",
            "isDefinedBy": f"urn:ngsi-ld:TaskDefinition:demo:{definition}",
            "status": "inProgress",
            "involves": [{"type": "Relationship", "object": involve} for involve in involves],
            "workParameters": {"type": "Property", "value": parameters},
        }
    )
    return Job(
        task, controller.device.id, controller.broker, FinishedTasks(controller.settings, controller.name)
    )


def counted(operation: str, outcome: str) -> float:
    labels = {"operation": operation, "outcome": outcome}
    return REGISTRY.get_sample_value("handover_trajectory_tool_tasks_total", labels) or 0.0


async def test_the_task_definition_names_the_operation(controller: Controller) -> None:
    before = counted("home", "completed")
    result = await controller.perform(a_job(controller, "home"))
    assert result["progress"] == 1.0
    assert result["durationS"] >= 0
    assert counted("home", "completed") == before + 1
    assert controller.work is None


async def test_the_operation_in_the_parameters_comes_first(controller: Controller) -> None:
    assert "found" in await controller.perform(a_job(controller, "home", operation="scan", bin="bin-1"))


@pytest.mark.nightly
async def test_a_pick_takes_the_only_material_of_its_task(controller: Controller) -> None:
    robot, part = controller.device.id, "urn:ngsi-ld:Material:demo:part-3"
    assert (await controller.perform(a_job(controller, "pick", (robot, part))))["part"] == "part-3"
    await controller.perform(a_job(controller, "place", location="fixture-1"))
    job = a_job(controller, "pick", (robot, part), part="part-1")
    assert (await controller.perform(job))["part"] == "part-1"


async def test_unknown_operations_are_counted_together(controller: Controller) -> None:
    before = counted("unknown", "failed")
    with pytest.raises(TaskFailed, match="dance"):
        await controller.perform(a_job(controller, operation="dance"))
    assert counted("unknown", "failed") == before + 1
    assert controller.device.state is DeviceState.IDLE


async def test_a_fault_of_the_robot_fails_the_task_and_shows_on_the_device(controller: Controller) -> None:
    async with controller.unit.robot:
        pass  # somebody has switched it off
    with pytest.raises(TaskFailed, match="the robot cannot move: the robot is switched off"):
        await controller.perform(a_job(controller))
    assert controller.device.state is DeviceState.ERROR


async def test_a_full_disk_fails_the_task_with_the_reason(controller: Controller) -> None:
    in_the_way = controller.unit.file.path.with_suffix(".new")
    in_the_way.mkdir(parents=True)
    with pytest.raises(TaskFailed, match=r"cannot be stored in .*cell\.json: .*HANDOVER_DATA_DIR"):
        await controller.perform(a_job(controller))
    assert controller.device.state is DeviceState.IDLE
    in_the_way.rmdir()
    await controller.perform(a_job(controller))


async def test_the_joints_are_stored_when_the_robot_is_switched_off(tmp_path: Path) -> None:
    settings = TrajectorySettings.load(data_dir=tmp_path)
    async with BrokerClient(settings) as broker:
        controller = Controllers(settings, broker).by_name["ur10-1"]
        async with controller.unit as unit:
            await unit.robot.move((0.1, -1.5, 1.5, -1.5, -1.5, 0.1), 1.0, lambda: 1.0)
        assert Controllers(settings, broker).cell.only.joints == (0.1, -1.5, 1.5, -1.5, -1.5, 0.1)
