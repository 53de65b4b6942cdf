"""The trajectory tool moves an arm of a ROS graph, through the broker and the bridge.

The arm is a node with a `FollowJointTrajectory` server, a `GripperCommand` server and joint states.
"""

import asyncio
import itertools
from collections.abc import AsyncIterator, Iterator
from datetime import UTC, datetime
from typing import Any

import httpx
import pytest

from handover_datamodels.entities import Task, TaskStatus
from handover_datamodels.times import iso
from ros_fiware_bridge.tests.integration.conftest import Shop
from tests.kit.cell import new_cell
from tests.kit.ros_arm import RosArm
from tests.kit.ros_domains import ros_domain

pytestmark = pytest.mark.slow

ROBOT = "urn:ngsi-ld:Device:demo:ur10-1"
HOME = [0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0]
AWAY = [0.6, -1.2, 1.4, -1.5, -1.5, 0.2]
JOINTS = [
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
]
_numbers = itertools.count(1)


@pytest.fixture(scope="module")
def at_work(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shop]:
    """A broker, a bridge with the shipped mapping, and a trajectory tool with `HANDOVER_ROBOT=ros`."""
    with new_cell(tmp_path_factory.mktemp("cell")) as cell:
        made = Shop(cell, ros_domain())
        file = cell.data_dir / "cell.yaml"
        file.write_text("robots: {ur10-1: {driver: ros, speed: 1, settings: {max_delay_s: 5}}}")
        cell.extra["HANDOVER_CELL_FILE"] = str(file)
        made.begin("", HANDOVER_ROS_MAPPING="arm")
        cell.start("trajectory_tool")
        yield made


@pytest.fixture
async def arm(shop: Shop) -> AsyncIterator[RosArm]:
    made = RosArm(JOINTS, HOME)
    await made.join(shop.robot)
    yield made
    await made.leave()


async def ask(shop: Shop, operation: str, **parameters: Any) -> str:
    task_id = f"urn:ngsi-ld:Task:demo:{operation}-{next(_numbers)}"
    pending = {"type": "Property", "value": "pending", "observedAt": iso(datetime.now(UTC))}
    await shop.broker.create(
        {
            "id": task_id,
            "type": "Task",
            "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:work"},
            "status": pending,
            "involves": {"type": "Property", "value": [{"type": "Relationship", "object": ROBOT}]},
            "workParameters": {"type": "Property", "value": {"operation": operation, **parameters}},
        }
    )
    return task_id


async def wish(shop: Shop, task_id: str, wanted: str) -> None:
    written = {"type": "Property", "value": wanted, "observedAt": iso(datetime.now(UTC))}
    await shop.broker.append(task_id, {"requestedStatus": written})


async def comes_to(shop: Shop, task_id: str, *wanted: TaskStatus, within_s: float = 30.0) -> dict[str, Any]:
    async def there() -> Task | None:
        found: Task = await shop.broker.get(task_id, Task)
        return found if found.status.value in wanted else None

    task = await shop.until(there, within_s, f"{task_id} never became {wanted}")
    outputs = dict(task.output_parameters.value) if task.output_parameters else {}
    return {"status": task.status.value, **outputs}


async def no_orders(shop: Shop) -> bool:
    return not await shop.broker.query(type="Task", id_pattern=".*ur10-1-order-.*")


@pytest.mark.nightly
async def test_an_arm_without_joint_states_is_not_moved(shop: Shop) -> None:
    silent = await comes_to(shop, await ask(shop, "moveTo", joints=HOME), TaskStatus.FAILED)
    assert (
        "the joints of urn:ngsi-ld:Device:demo:arm-1 are unknown: /joint_states has not been"
        in silent["reason"]
    )


async def test_a_task_moves_the_arm_along_a_trajectory_to_its_target(shop: Shop, arm: RosArm) -> None:
    done = await comes_to(
        shop, await ask(shop, "moveTo", joints=AWAY), TaskStatus.COMPLETED, TaskStatus.FAILED
    )
    assert done["status"] is TaskStatus.COMPLETED, done
    assert done["joints"] == pytest.approx(AWAY, abs=0.002)
    (goal,) = arm.goals
    assert list(goal["trajectory"]["joint_names"]) == JOINTS
    points = goal["trajectory"]["points"]
    assert len(points) > 3
    assert list(points[-1]["positions"]) == pytest.approx(AWAY, abs=1e-5)
    assert list(points[-1]["velocities"]) == [0.0] * 6
    times = [one["time_from_start"]["sec"] * 10**9 + one["time_from_start"]["nanosec"] for one in points]
    assert times == sorted(set(times))
    assert arm.position.tolist() == pytest.approx(AWAY, abs=1e-5)
    shown = httpx.get(f"{shop.cell.url('trajectory_tool')}/robots/ur10-1", timeout=120).json()
    assert shown["joints"]["position"] == pytest.approx(AWAY, abs=0.002)
    await shop.until(lambda: no_orders(shop), why="the order is still in the broker")


@pytest.mark.nightly
async def test_a_pause_stops_the_arm_and_it_continues_from_there(shop: Shop, arm: RosArm) -> None:
    task = await ask(shop, "moveTo", joints=AWAY, speed=0.3)
    await shop.until(lambda: arm.position[0] > 0.1, why="the arm never moved")
    await wish(shop, task, "paused")
    await comes_to(shop, task, TaskStatus.PAUSED)
    rests_at = arm.position[0]
    assert 0.1 < rests_at < 0.6
    assert arm.is_at_rest
    await wish(shop, task, "inProgress")
    done = await comes_to(shop, task, TaskStatus.COMPLETED, TaskStatus.FAILED)
    assert done["status"] is TaskStatus.COMPLETED, done
    whole, stop, rest = arm.goals
    assert stop["trajectory"]["points"][-1]["positions"][0] == pytest.approx(rests_at, abs=0.002)
    assert len(stop["trajectory"]["points"]) < len(whole["trajectory"]["points"])
    assert rests_at < rest["trajectory"]["points"][0]["positions"][0] < rests_at + 0.1


async def test_a_cancelled_task_stops_the_arm(shop: Shop, arm: RosArm) -> None:
    task = await ask(shop, "moveTo", joints=AWAY, speed=0.2)
    await shop.until(lambda: arm.position[0] > 0.05, why="the arm never moved")
    await wish(shop, task, "cancelled")
    ended = await comes_to(shop, task, TaskStatus.FAILED)
    assert ended["reason"] == "cancelled"
    assert arm.position[0] < 0.5
    assert arm.is_at_rest


async def test_the_error_of_the_controller_is_the_reason_of_the_task(shop: Shop, arm: RosArm) -> None:
    arm.fault = "path tolerance violated at elbow_joint"
    ended = await comes_to(shop, await ask(shop, "moveTo", joints=AWAY), TaskStatus.FAILED)
    assert "did not follow the trajectory: path tolerance violated at elbow_joint" in ended["reason"]
    assert ended["reason"].startswith("the robot cannot move: ")


@pytest.mark.nightly
async def test_a_task_fails_without_progress_while_the_arm_is_unavailable(shop: Shop, arm: RosArm) -> None:
    async def progress() -> float:
        task: Task = await shop.broker.get(task_id, Task)
        progress = task.output_parameters.value.get("progress") if task.output_parameters else None
        return float(progress or 0.0)

    task_id = await ask(shop, "moveTo", joints=AWAY, speed=0.1)
    await shop.until(lambda: arm.position[0] > 0.1, 30.0, "the arm never moved")
    arm.dead = True
    way = (arm.position[0] - HOME[0]) / (AWAY[0] - HOME[0])
    ended = await comes_to(shop, task_id, TaskStatus.FAILED, TaskStatus.COMPLETED, within_s=90.0)
    assert ended["status"] is TaskStatus.FAILED
    assert "have not been reported for" in ended["reason"]
    assert await progress() <= way + 0.1


@pytest.mark.nightly
async def test_the_gripper_reports_whether_it_holds_a_part(shop: Shop, arm: RosArm) -> None:
    arm.part_between_fingers = True
    picked = await comes_to(
        shop, await ask(shop, "pick", bin="bin-1"), TaskStatus.COMPLETED, TaskStatus.FAILED
    )
    assert picked["status"] is TaskStatus.COMPLETED, picked
    assert picked["gripped"]
    assert arm.grips == [0.0]
    free = f"{shop.cell.url('trajectory_tool')}/robots/ur10-1/gripper/free"
    freed = await asyncio.to_thread(httpx.post, free, timeout=120)
    assert freed.is_success, freed.text
    assert arm.grips == [0.0, 0.085]
    assert freed.json()["gripper"] == {"closed": False, "holds": None, "interrupted": None}
