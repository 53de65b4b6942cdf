"""The robot in simulated physics as a driver, and the real tool with it."""

from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest

from services.trajectory_tool import operations, parameters
from services.trajectory_tool.physics import is_available
from services.trajectory_tool.planning import is_available as is_planning_available

if not (is_available() and is_planning_available()):
    pytest.skip("the extra physics is not installed", allow_module_level=True)

from services.trajectory_tool.drivers import Clock
from services.trajectory_tool.physics.pacing import PacedSimulation
from services.trajectory_tool.physics.parts import Parts
from services.trajectory_tool.physics.robot import PhysicsRobot
from services.trajectory_tool.physics.simulation import Simulation
from services.trajectory_tool.physics.world_model import build
from services.trajectory_tool.poses import Pose
from services.trajectory_tool.robot import Joints, Robot, RobotFault
from services.trajectory_tool.robots.ur10 import ROBOT
from services.trajectory_tool.scene import Scene
from services.trajectory_tool.settings import TrajectorySettings
from services.trajectory_tool.simulated_robot import SimulatedRobot
from services.trajectory_tool.work import Work
from services.trajectory_tool.workcell import Workcell
from tests.integration.trajectory_tool.robot_contract import RobotContract


class TestPhysicsRobot(RobotContract):
    home = ROBOT.home
    limits = ROBOT.limits

    @pytest.fixture
    async def robot(self) -> AsyncIterator[PhysicsRobot]:
        simulation = Simulation(build(ROBOT, Scene(name="empty"), 1), self.home, ROBOT.fingers[0].opened)
        async with PhysicsRobot(PacedSimulation(simulation, 1.0), ROBOT, self.limits) as made:
            yield made


async def path_of(robot: Robot, target: Joints, now_s: Callable[[], float]) -> dict[int, Pose]:
    """Return where the tool is in each cycle of 2 ms of a motion."""
    start_s, path = now_s(), {}

    def record() -> float:
        path[round((now_s() - start_s) * 500)] = ROBOT.tool_pose(robot.state().positions)
        return 1.0

    assert await robot.move(target, 1.0, record)
    return path


async def test_both_simulated_robots_make_the_same_motion_within_a_millimetre() -> None:
    simulation = Simulation(build(ROBOT, Scene(name="empty"), 1), ROBOT.home)
    paced = PacedSimulation(simulation, None)
    time_s = [simulation.time_s]

    def wait(seconds: float) -> None:
        time_s[0] += seconds

    clock = Clock(lambda: time_s[0], wait)
    target = tuple(
        here + turn for here, turn in zip(ROBOT.home, (0.5, 0.2, -0.2, 0.1, 0.3, 0.5), strict=True)
    )
    async with (
        PhysicsRobot(paced, ROBOT, ROBOT.limits) as physical,
        SimulatedRobot(
            ROBOT.home, ROBOT.limits, something_there=lambda _: False, control_hz=500, clock=clock
        ) as kinematic,
    ):
        paths = [
            await path_of(physical, target, lambda: simulation.time_s),
            await path_of(kinematic, target, lambda: time_s[0]),
        ]
    common = paths[0].keys() & paths[1].keys()
    assert len(common) > 100
    # The kinematic robot reports the setpoint of the cycle before.
    assert max(paths[0][step].distance_m(paths[1][min(step + 1, max(common))]) for step in common) < 0.001
    assert abs(max(paths[0]) - max(paths[1])) <= 1


class Freely:
    def may_go(self) -> bool:
        return True

    async def rest(self) -> None:
        raise AssertionError("nobody asked for rest")


class PhysicsCell:
    """A cell with physics as fast as possible, and operations in it."""

    def __init__(self, folder: Path, seed: int = 174) -> None:
        settings = TrajectorySettings(
            data_dir=folder, robot="physics", simulation_pace=0, scan_seed=seed, robot_speed=1.0
        )
        self.workcell = Workcell(settings)
        self.cell = self.workcell.only
        robot = self.cell.robot
        assert isinstance(robot, PhysicsRobot)
        self.robot = robot
        self.parts: Parts = robot.vision.parts  # type: ignore[union-attr]
        self._tasks = 0

    async def do(self, operation: str, **asked: Any) -> dict[str, Any]:
        self._tasks += 1
        known = operations.known(operation)
        read = parameters.read(known.parameters, operation, asked)
        return await known.perform(Work(f"task-{self._tasks}", operation, self.cell, Freely(), 1.0), read)


@pytest.fixture
async def cell(tmp_path: Path) -> AsyncIterator[PhysicsCell]:
    made = PhysicsCell(tmp_path)
    async with made.workcell:
        yield made


async def test_a_part_is_found_by_the_camera_picked_and_lies_in_the_nest(cell: PhysicsCell) -> None:
    before = len(cell.parts.in_bin("bin-1"))
    seen = await cell.do("scan", bin="bin-1")
    assert seen["found"]
    picked = await cell.do("pick", part=seen["part"], pose=seen["pose"])
    assert picked == {"part": seen["part"], "gripped": True}
    assert cell.robot.is_holding
    held = cell.robot.simulation.gripped_part()
    await cell.do("place", location="fixture-1")
    assert not cell.robot.is_holding
    assert cell.parts.in_fixture("fixture-1") == [held]
    assert len(cell.parts.in_bin("bin-1")) == before - 1


async def test_a_part_that_slips_out_of_the_gripper_fails_the_task_with_the_reason(cell: PhysicsCell) -> None:
    seen = await cell.do("scan", bin="bin-1")
    for part in cell.parts.in_bin("bin-1"):
        cell.robot.simulation.set_friction(part, 0.001)
    with pytest.raises(Exception, match=r"slipped|no part at"):
        await cell.do("pick", part=seen["part"], pose=seen["pose"])
    assert cell.cell.held is None
    assert not cell.robot.gripper_closed


async def test_parts_and_a_held_part_are_found_again_after_a_restart(tmp_path: Path) -> None:
    first = PhysicsCell(tmp_path)
    async with first.workcell:
        seen = await first.do("scan", bin="bin-1")
        await first.do("pick", part=seen["part"], pose=seen["pose"])
        lying = [first.robot.simulation.part_pose(part) for part in first.parts.in_bin("bin-1")]
    second = PhysicsCell(tmp_path)
    async with second.workcell:
        assert second.robot.is_holding
        assert second.cell.held == seen["part"]
        found = [second.robot.simulation.part_pose(part) for part in second.parts.in_bin("bin-1")]
        assert max(one.distance_m(other) for one, other in zip(found, lying, strict=True)) < 1e-4
        placed = await second.do("place", location="fixture-1")
        assert placed["part"] == seen["part"]


async def test_an_arm_that_is_blocked_reports_a_fault_and_moves_again(cell: PhysicsCell) -> None:
    robot, home = cell.robot, ROBOT.home
    into_the_table = (home[0], home[1] + 1.6, *home[2:])
    with pytest.raises(RobotFault, match="meets something"):
        await robot.move(into_the_table, 1.0, lambda: 1.0)
    assert await robot.move(home, 0.5, lambda: 1.0)
    assert robot.state().positions == pytest.approx(home, abs=0.01)
