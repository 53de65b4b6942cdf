"""Several robots in one cell: their names, places and limits, and motions that never meet."""

import asyncio
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handover.broker import BrokerClient
from handover.errors import UsageError
from handover.performer import Job, TaskFailed
from handover_datamodels.entities import DeviceState, Task
from handover_robots.cell.cell import RobotCell
from handover_robots.cell.robot_unit import RobotUnit
from handover_robots.driver_base.context import RobotContext
from handover_robots.drivers import DRIVERS
from handover_robots.drivers.simulated_robot import SimulatedRobot
from handover_robots.model.faults import RobotFault
from handover_robots.model.obstacles import Box, Capsule, Cylinder, Obstacle, World
from handover_robots.model.poses import Frame, pointing_down
from handover_robots.planning import is_available
from handover_robots.settings import TrajectorySettings
from handover_robots.tasks import operations, parameters
from handover_robots.tasks.controller import Controllers
from handover_robots.tasks.work import Work
from tests.kit.waiting import until

if is_available():
    from handover_robots.planning.arm import Arm
    from handover_robots.planning.collision import Collisions
    from handover_robots.planning.volumes import occupied, swept

UNTURNED = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

needs_planning = pytest.mark.skipif(not is_available(), reason="the extra motion has no wheels here")

TWO_ARMS = """
name: two arms
robots:
  left: {model: ur5e, speed: 0.5}
  right:
    model: panda
    base: {position: [1.0, 0.0, 0.0], yaw_deg: 180}
    limits: {velocity: [1, 1, 1, 1, 2, 2, 2]}
"""
BETWEEN = {"position": [0.5, 0.05, 0.25]}


@pytest.fixture
def cell_of(settings: TrajectorySettings, tmp_path: Path, time: Any) -> Callable[[str], RobotCell]:
    def make(text: str) -> RobotCell:
        file = tmp_path / "cell.yaml"
        file.write_text(text)
        return RobotCell(settings.model_copy(update={"cell_file": file, "neighbour_wait_s": 0.5}), time.clock)

    return make


class Freely:
    def may_go(self) -> bool:
        return True

    async def rest(self) -> None:
        raise AssertionError("no rest was requested")


async def do(unit: RobotUnit, operation: str, **asked: Any) -> dict[str, Any]:
    performed = operations.operation_named(operation)
    read = parameters.read(performed.parameters, operation, asked)
    return await performed.perform(Work("task", operation, unit, Freely(), 0.6), read)


@needs_planning
def test_each_robot_has_its_model_place_and_limits(cell_of: Any) -> None:
    units = cell_of(TWO_ARMS).units
    assert list(units) == ["left", "right"]
    assert units["left"].model.name == "UR5e"
    assert units["left"].entry.speed == 0.5
    assert units["right"].limits.velocity == (1, 1, 1, 1, 2, 2, 2)
    assert units["right"].limits.jerk == units["right"].model.limits.jerk
    assert units["right"].tool_pose.position == pytest.approx((1.0 - 0.306891, 0.0, 0.486882), abs=1e-4)


@pytest.mark.nightly
@needs_planning
async def test_robots_that_move_at_the_same_time_never_meet(
    settings: TrajectorySettings, tmp_path: Path
) -> None:
    file = tmp_path / "cell.yaml"
    file.write_text(TWO_ARMS)
    seen: list[tuple[Any, Any]] = []
    async with RobotCell(settings.model_copy(update={"cell_file": file})) as cell:
        left, right = cell.units.values()

        async def repeat(unit: RobotUnit, x: float, *sides: float) -> None:
            for y in sides:
                await do(unit, "moveTo", pose={"position": [x, y, 0.3]})

        async def record() -> None:
            while True:
                seen.append((left.joints, right.joints))
                await asyncio.sleep(0.02)

        recording = asyncio.create_task(record())
        async with asyncio.TaskGroup() as group:
            group.create_task(repeat(left, 0.36, 0.2, -0.2, 0.2))
            group.create_task(repeat(right, 0.66, -0.2, 0.2, -0.2))
        recording.cancel()
        assert left.tool_pose.position == pytest.approx((0.36, 0.2, 0.3), abs=1e-3)
        assert right.tool_pose.position == pytest.approx((0.66, -0.2, 0.3), abs=1e-3)
        assert len(set(seen)) > 20
        for joints, others in dict.fromkeys(seen):
            assert not touches(left, right, joints, others)


def touches(unit: RobotUnit, other: RobotUnit, joints: Any, others: Any) -> bool:
    volume = tuple(occupied("other", Arm(other.model), others, (), 0.0))
    return not Collisions(Arm(unit.model), World(volume)).is_free(np.array(joints))


@needs_planning
async def test_a_swept_volume_contains_the_links_at_every_time(cell_of: Any) -> None:
    unit = cell_of("robots: {left: {model: ur5e}}").only
    target = (1.2, -1.0, 1.0, -1.5, -1.2, 0.5)
    plan = await unit.planning.plan(lambda planner: planner.to_joints(unit.home, target))
    arm = Arm(unit.model)
    copies: dict[str, list[Obstacle]] = {}
    for volume in swept("left", arm, plan.trajectory, (), 0.03):
        copies.setdefault(volume.name, []).append(volume)
    for joints in plan.trajectory.positions(0.005):
        for link in occupied("left", arm, tuple(joints), (), 0.0):
            assert any(is_inside(link, copy) for copy in copies[link.name]), link.name


def is_inside(link: Obstacle, copy: Obstacle) -> bool:
    """Return whether the ends of a capsule, or the corners of a box, are inside a larger copy of it."""
    if link.pose == copy.pose:
        return True
    frame = copy.pose.frame().inverse() @ link.pose.frame()
    shape, larger = link.shape, copy.shape
    if isinstance(shape, Capsule) and isinstance(larger, Capsule):
        room, half = larger.radius - shape.radius, shape.length / 2
        ends = [(frame @ Frame(UNTURNED, (0.0, 0.0, side * half))).position for side in (1, -1)]
        return all(np.hypot(np.hypot(x, y), max(abs(z) - larger.length / 2, 0.0)) <= room for x, y, z in ends)
    if isinstance(shape, Cylinder) and isinstance(larger, Cylinder):
        rim = [
            (frame @ Frame(UNTURNED, (x * shape.radius, y * shape.radius, side * shape.length / 2))).position
            for x, y in ((1, 0), (0, 1), (-1, 0), (0, -1))
            for side in (1, -1)
        ]
        return all(np.hypot(x, y) <= larger.radius and abs(z) <= larger.length / 2 for x, y, z in rim)
    if not isinstance(shape, Box) or not isinstance(larger, Box):
        return False
    half_sizes = tuple(size / 2 for size in shape.size)
    corners = [
        frame @ Frame(UNTURNED, (sign[0] * half_sizes[0], sign[1] * half_sizes[1], sign[2] * half_sizes[2]))
        for sign in product((1, -1), repeat=3)
    ]
    return all(
        abs(value) <= size / 2 + 1e-9
        for corner in corners
        for value, size in zip(corner.position, larger.size, strict=True)
    )


@needs_planning
async def test_a_robot_in_the_way_is_waited_for_and_named_when_it_stays(cell_of: Any) -> None:
    async with cell_of(TWO_ARMS) as cell:
        left, right = cell.units.values()
        await do(right, "moveTo", pose=BETWEEN)
        before = left.joints
        with pytest.raises(TaskFailed, match="right panda_"):
            await do(left, "moveTo", pose=BETWEEN)
        assert left.joints == before
        left.neighbour_wait_s = 60.0
        async with asyncio.TaskGroup() as group:
            waiting = group.create_task(do(left, "moveTo", pose=BETWEEN))
            group.create_task(do(right, "home"))
        await waiting
        assert left.tool_pose.distance_m(pointing_down((0.5, 0.05, 0.25))) < 1e-4


@needs_planning
async def test_each_robot_keeps_its_own_part_and_joints(cell_of: Any) -> None:
    text = """
    robots:
      left: {model: ur5e}
      right: {model: ur5e, base: {position: [1.4, 0, 0]}}
    scene:
      name: shared bin
      bins: {bin-1: {view: {position: [0.5, 0.2, 0.4]}, parts: [{position: [0.5, 0.2, 0.1]}]}}
    """
    async with cell_of(text) as cell:
        left, right = cell.units.values()
        assert (await do(left, "pick", bin="bin-1"))["part"] == "part-1"
        assert (left.held, right.held) == ("part-1", None)
        with pytest.raises(TaskFailed, match="bin-1 is empty"):
            await do(right, "pick", bin="bin-1")
        joints = left.joints
    again = cell_of(text)
    assert again.units["left"].held == "part-1"
    assert again.units["left"].joints == joints
    assert again.units["right"].held is None


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "must have robots and a scene"),
        ("robots: {}", "robots: Dictionary should have at least 1 item"),
        ("robots: {a b: {}}", r"robots\.a b\.\[key\]"),
        ("robots: {arm: {model: dancer}}", 'there is no robot "dancer"'),
        ("robots: {arm: {driver: telepathy}}", 'there is no robot driver "telepathy"'),
        ("robots: {arm: {speed: 2}}", r"robots\.arm\.speed: .*less than or equal to 1"),
        ("robots: {arm: {base: {yaw_deg: 1, orientation: [0, 0, 0, 1]}}}", "not both"),
        ("robots: {arm: {base: {position: [0, .nan, 0]}}}", "finite"),
        ("robots: {arm: {base: {orientation: [0, 0, 0, 2]}}}", "length 1"),
        ("robots: {arm: {limits: {jerk: [1, 2]}}}", r"arm\.limits\.jerk has 2 values, and the robot has 6"),
        ("robots: {arm: {home: [9, 0, 0, 0, 0, 0]}}", r"arm\.home: shoulder_pan_joint cannot be at 9"),
        ("robots: {arm: {driver: ros, settings: {arn: x}}}", r"robots\.arm\.settings\.arn: Extra inputs"),
        ("robots: {arm: {}}\nscene: {name: x, walls: {}}", r"cell\.yaml: scene: walls: Extra inputs"),
        ("robots: {arm: {}}\nscene: nowhere.yaml", r"nowhere\.yaml cannot be read"),
        ("robots: {", "is not YAML"),
    ],
)
async def test_a_faulty_cell_file_is_refused_with_the_place(
    cell_of: Any, settings: TrajectorySettings, tmp_path: Path, text: str, complaint: str
) -> None:
    file = tmp_path / "cell.yaml"
    file.write_text(text)
    async with BrokerClient(settings) as broker:
        with pytest.raises(UsageError, match=complaint):
            RobotCell(settings.model_copy(update={"cell_file": file}), broker=broker)


class UnpoweredRobot(SimulatedRobot):
    """A driver whose robot has no power until a test switches it on."""

    has_power = False

    @classmethod
    def from_context(cls, context: RobotContext) -> Any:
        return super().from_context(context)

    async def __aenter__(self) -> Any:
        if not type(self).has_power:
            raise RobotFault("the controller has no power")
        return await super().__aenter__()


@needs_planning
async def test_a_faulty_robot_does_not_stop_its_neighbour(
    settings: TrajectorySettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, free_port: Any
) -> None:
    monkeypatch.setattr(UnpoweredRobot, "has_power", False)
    monkeypatch.setitem(DRIVERS.own, "unpowered", f"{__name__}:UnpoweredRobot.from_context")
    file = tmp_path / "cell.yaml"
    file.write_text(TWO_ARMS.replace("speed: 0.5", "driver: unpowered"))
    settings = settings.model_copy(
        update={"cell_file": file, "broker_url": f"http://127.0.0.1:{free_port()}"}
    )
    async with BrokerClient(settings) as broker, Controllers(settings, broker) as controllers:
        left, right = controllers.by_name.values()
        assert left.device.state is DeviceState.ERROR
        with pytest.raises(TaskFailed, match="the controller has no power"):
            await left.perform(job(left))
        assert (await right.perform(job(right)))["progress"] == 1.0
        monkeypatch.setattr(UnpoweredRobot, "has_power", True)
        await until(lambda: left.device.state is DeviceState.IDLE)
        assert (await left.perform(job(left)))["progress"] == 1.0


def job(controller: Any) -> Job:
    task = Task.from_ngsild(
        {
            "id": f"urn:ngsi-ld:Task:demo:{controller.robot_name}",
            "type": "Task",
            "isDefinedBy": "urn:ngsi-ld:TaskDefinition:demo:home",
            "status": "inProgress",
        }
    )
    return Job(task, controller.device.id, controller.broker, controller._finished)
