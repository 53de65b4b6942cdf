"""The trajectory tool moves an arm of a ROS graph, through the broker and the bridge.

The arm is a node with a `FollowJointTrajectory` server, a `GripperCommand` server and joint states. It
behaves like a joint trajectory controller: it follows the points, and stops at its position when cancelled.
"""

import asyncio
import itertools
import time
from collections.abc import AsyncIterator, Iterator
from datetime import UTC, datetime
from typing import Any

import httpx
import numpy as np
import pytest

from datamodels.entities import Task, TaskStatus
from datamodels.times import iso
from ros_fiware_bridge.graph.port import GoalEnded, GoalStatus, Message, ServedGoal
from ros_fiware_bridge.graph.qos import SENSOR_DATA
from tests.integration.ros_fiware_bridge.conftest import Shop
from tests.kit.cell import new_cell
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
REPORTED = ["elbow_joint", "finger_joint", *(name for name in JOINTS if name != "elbow_joint")]
"""The driver reports its joints in another order, and one more."""
_numbers = itertools.count(1)


class Arm:
    """A driver of an arm and its gripper."""

    def __init__(self) -> None:
        self.at = dict(zip(JOINTS, HOME, strict=True)) | {"finger_joint": 0.0}
        self.turning = dict.fromkeys(self.at, 0.0)
        self.goals: list[Message] = []
        self.grips: list[float] = []
        self.part_between_fingers = False
        self.fault = ""
        self.dead = False

    async def report(self, graph: Any) -> None:
        states = await graph.publisher("/joint_states", "sensor_msgs/msg/JointState", SENSOR_DATA)
        while not self.dead:
            now_ns = time.time_ns()
            states.publish(
                {
                    "header": {"stamp": {"sec": now_ns // 10**9, "nanosec": now_ns % 10**9}},
                    "name": REPORTED,
                    "position": [self.at[name] for name in REPORTED],
                    "velocity": [self.turning[name] for name in REPORTED],
                }
            )
            await asyncio.sleep(0.02)

    async def follow(self, goal: ServedGoal) -> Message:
        self.goals.append(goal.request)
        if self.fault:
            raise GoalEnded(GoalStatus.ABORTED, {"error_code": -4, "error_string": self.fault})
        asked = goal.request["trajectory"]
        names, points = asked["joint_names"], asked["points"]
        times = [0.0] + [
            one["time_from_start"]["sec"] + one["time_from_start"]["nanosec"] / 1e9 for one in points
        ]
        way = [[self.at[name] for name in names]] + [list(one["positions"]) for one in points]
        began_s = time.monotonic()
        while (now_s := time.monotonic() - began_s) < times[-1]:
            if self.dead:
                await asyncio.Event().wait()
            if goal.cancel_requested:
                self.turning = dict.fromkeys(self.turning, 0.0)
                raise GoalEnded(GoalStatus.CANCELED)
            for index, name in enumerate(names):
                self.at[name] = float(np.interp(now_s, times, [one[index] for one in way]))
                self.turning[name] = 0.3
            await asyncio.sleep(0.01)
        self.at |= dict(zip(names, map(float, way[-1]), strict=True))
        self.turning = dict.fromkeys(self.turning, 0.0)
        return {"error_code": 0}

    async def grip(self, goal: ServedGoal) -> Message:
        wanted_m = goal.request["command"]["position"]
        self.grips.append(wanted_m)
        if wanted_m == 0.0 and self.part_between_fingers:
            raise GoalEnded(GoalStatus.ABORTED, {"position": 0.03, "stalled": True})
        return {"position": wanted_m, "reached_goal": True}


@pytest.fixture(scope="module")
def at_work(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shop]:
    """A broker, a bridge with the shipped mapping, and a trajectory tool with `HANDOVER_ROBOT=ros`."""
    with new_cell(tmp_path_factory.mktemp("cell")) as cell:
        made = Shop(cell, ros_domain())
        cell.extra.update({"HANDOVER_ROBOT": "ros", "HANDOVER_ROBOT_SPEED": "1"})
        made.begin("", HANDOVER_ROS_MAPPING="arm")
        cell.start("trajectory_tool")
        yield made


@pytest.fixture
async def arm(shop: Shop) -> AsyncIterator[Arm]:
    made = Arm()
    follows = "/joint_trajectory_controller/follow_joint_trajectory"
    await shop.robot.serve_action(follows, "control_msgs/action/FollowJointTrajectory", made.follow)
    await shop.robot.serve_action(
        "/gripper_controller/gripper_cmd", "control_msgs/action/GripperCommand", made.grip
    )
    reporting = asyncio.create_task(made.report(shop.robot))
    yield made
    reporting.cancel()


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


async def test_an_arm_without_joint_states_is_not_moved(shop: Shop) -> None:
    silent = await comes_to(shop, await ask(shop, "moveTo", joints=HOME), TaskStatus.FAILED)
    assert "the joints of urn:ngsi-ld:Device:demo:arm-1 are unknown" in silent["reason"]


async def test_a_task_moves_the_arm_along_a_trajectory_to_its_target(shop: Shop, arm: Arm) -> None:
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
    assert [arm.at[name] for name in JOINTS] == pytest.approx(AWAY, abs=1e-5)
    shown = httpx.get(f"{shop.cell.url('trajectory_tool')}/robots/ur10-1", timeout=120).json()
    assert shown["joints"]["position"] == pytest.approx(AWAY, abs=0.002)
    await shop.until(lambda: no_orders(shop), why="the order is still in the broker")


async def test_a_pause_stops_the_arm_and_it_continues_from_there(shop: Shop, arm: Arm) -> None:
    task = await ask(shop, "moveTo", joints=AWAY, speed=0.3)
    await shop.until(lambda: arm.at[JOINTS[0]] > 0.1, why="the arm never moved")
    await wish(shop, task, "paused")
    await comes_to(shop, task, TaskStatus.PAUSED)
    rests_at = arm.at[JOINTS[0]]
    assert 0.1 < rests_at < 0.6
    assert not any(arm.turning.values())
    await wish(shop, task, "inProgress")
    done = await comes_to(shop, task, TaskStatus.COMPLETED, TaskStatus.FAILED)
    assert done["status"] is TaskStatus.COMPLETED, done
    assert len(arm.goals) == 2
    assert rests_at < arm.goals[1]["trajectory"]["points"][0]["positions"][0] < rests_at + 0.1


async def test_a_cancelled_task_stops_the_arm(shop: Shop, arm: Arm) -> None:
    task = await ask(shop, "moveTo", joints=AWAY, speed=0.2)
    await shop.until(lambda: arm.at[JOINTS[0]] > 0.05, why="the arm never moved")
    await wish(shop, task, "cancelled")
    ended = await comes_to(shop, task, TaskStatus.FAILED)
    assert ended["reason"] == "cancelled"
    assert arm.at[JOINTS[0]] < 0.5
    assert not any(arm.turning.values())


async def test_the_error_of_the_controller_is_the_reason_of_the_task(shop: Shop, arm: Arm) -> None:
    arm.fault = "path tolerance violated at elbow_joint"
    ended = await comes_to(shop, await ask(shop, "moveTo", joints=AWAY), TaskStatus.FAILED)
    assert "gave up: path tolerance violated at elbow_joint" in ended["reason"]
    assert ended["reason"].startswith("the robot cannot move: ")


async def test_a_task_fails_without_progress_while_the_arm_is_unavailable(shop: Shop, arm: Arm) -> None:
    async def progress() -> float:
        task: Task = await shop.broker.get(task_id, Task)
        progress = task.output_parameters.value.get("progress") if task.output_parameters else None
        return float(progress or 0.0)

    task_id = await ask(shop, "moveTo", joints=AWAY, speed=0.1)
    await shop.until(lambda: arm.at[JOINTS[0]] > 0.1, 30.0, "the arm never moved")
    arm.dead = True
    way = (arm.at[JOINTS[0]] - HOME[0]) / (AWAY[0] - HOME[0])
    ended = await comes_to(shop, task_id, TaskStatus.FAILED, TaskStatus.COMPLETED, within_s=90.0)
    assert ended["status"] is TaskStatus.FAILED
    assert "have not been reported for" in ended["reason"]
    assert await progress() <= way + 0.1


async def test_the_gripper_reports_whether_it_holds_a_part(shop: Shop, arm: Arm) -> None:
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
