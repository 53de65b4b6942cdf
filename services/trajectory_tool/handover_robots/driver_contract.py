"""What every robot driver does, as tests: those of a driver subclass `RobotContract` and make the robot.

    class TestMyRobot(RobotContract):
        home, limits = ROBOT.home, ROBOT.limits

        @pytest.fixture
        async def robot(self, tmp_path):
            async with make_robot(context_of(ROBOT, tmp_path)) as made:
                yield made

        @pytest.fixture
        def move_by_hand(self, robot):
            return robot.controller.move_by_hand

They need pytest with pytest-asyncio in its mode `auto`.
"""

import asyncio
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from handover_robots.driver_base.context import RobotContext
from handover_robots.driver_base.robot import Robot
from handover_robots.limits.limiter import JointLimiter
from handover_robots.model.faults import RobotFault
from handover_robots.model.joint_trajectory import JointTrajectory
from handover_robots.model.joints import Joints
from handover_robots.model.robot_model import RobotModel
from handover_robots.model.trajectory import Limits
from handover_robots.planning import is_available
from handover_robots.scene.scene import Scene
from handover_robots.settings import TrajectorySettings

MAX_WAIT_S = 300.0
POLL_S = 0.02
INTERRUPTED = 0.2
"""The speed of a motion that is interrupted: it takes seconds, so that it still runs on a busy machine."""


def context_of(model: RobotModel, data_dir: Path, **changes: Any) -> RobotContext:
    """Return what a robot of a cell without things is made from; `changes` are other attributes of it."""
    attributes: dict[str, Any] = {
        "settings": TrajectorySettings.load(data_dir=data_dir),
        "robot_id": "robot-1",
        "options": {},
        "model": model,
        "scene": Scene(name="empty"),
        "limits": model.limits,
        "joints": model.home,
        "gripper_closed": False,
        "gripper_s": 0.01,
        "is_between_fingers": lambda _: True,
        "limiter": JointLimiter(model.limits, [(joint.lower, joint.upper) for joint in model.joints]),
    }
    return RobotContext(**{**attributes, **changes})


async def until(condition: Callable[[], bool], why: str = "the condition does not hold") -> None:
    """Wait until a condition holds; fail with the reason when it does not."""
    ends_s = time.monotonic() + MAX_WAIT_S
    while not condition():
        assert time.monotonic() < ends_s, why
        await asyncio.sleep(POLL_S)


class RobotContract:
    """The tests; a subclass has the fixtures `robot`, switched on and at rest at `home`, and `move_by_hand`.

    `move_by_hand` is a function that moves the joints of the robot at rest by displacements, without the
    driver, as a person does.
    """

    home: Joints
    limits: Limits
    tolerance = 0.005
    """How far the joints may be from their target, in rad (m)."""
    still = 0.02
    """Slower joints are at rest, in rad/s (m/s)."""
    has_servo = True

    def target(self, turn: float = 0.5) -> Joints:
        """Return joints with the first one turned."""
        return (self.home[0] + turn, *self.home[1:])

    async def at_rest(self, robot: Robot) -> None:
        """Wait for a report of joints at rest: on a busy machine, reports are late."""
        await until(lambda: max(map(abs, robot.state().velocities)) <= self.still, why="the joints move")

    async def test_the_joints_are_at_home_at_first(self, robot: Robot) -> None:
        state = robot.state()
        assert state.positions == pytest.approx(self.home, abs=self.tolerance)
        assert len(state.velocities) == len(self.home)
        assert robot.remaining_s() == 0.0

    async def test_a_motion_reaches_its_target_at_rest(self, robot: Robot) -> None:
        assert await robot.move(self.target(), 1.0, lambda: 1.0)
        await self.at_rest(robot)
        assert robot.state().positions == pytest.approx(self.target(), abs=self.tolerance)

    async def test_a_planned_motion_is_followed(self, robot: Robot) -> None:
        if not is_available():
            pytest.skip("the extra motion has no wheels here")
        trajectory = self.planned(robot.state().positions, self.target())
        assert await robot.follow(trajectory, lambda: 1.0)
        await self.at_rest(robot)
        assert robot.state().positions == pytest.approx(self.target(), abs=self.tolerance)

    def planned(self, start: Joints, target: Joints) -> JointTrajectory:
        """Return a straight line as a trajectory."""
        import numpy as np

        from handover_robots.planning import timing

        return timing.line(np.array(start), np.array(target), self.limits)

    async def test_a_planned_motion_from_elsewhere_is_a_fault(self, robot: Robot) -> None:
        if not is_available():
            pytest.skip("the extra motion has no wheels here")
        with pytest.raises(RobotFault):
            await robot.follow(self.planned(self.target(0.3), self.target()), lambda: 1.0)

    async def test_a_pause_rests_on_the_way_and_the_motion_can_be_resumed(self, robot: Robot) -> None:
        started = robot.state().positions[0]

        def until_half_way() -> float:
            return 1.0 if abs(robot.state().positions[0] - started) < 0.2 else 0.0

        assert not await robot.move(self.target(1.0), 1.0, until_half_way)
        await self.at_rest(robot)
        rest = robot.state().positions
        assert self.home[0] + 0.15 < rest[0] < self.home[0] + 1.0
        assert await robot.move(self.target(1.0), 1.0, lambda: 1.0)
        assert robot.state().positions == pytest.approx(self.target(1.0), abs=self.tolerance)

    async def test_a_robot_that_was_moved_by_hand_while_paused_continues_from_there(
        self, robot: Robot, move_by_hand: Callable[[Joints], object]
    ) -> None:
        """It neither jumps back to its path nor follows a plan that begins elsewhere."""
        target = self.target(1.0)
        assert not await robot.move(
            target, 1.0, lambda: 1.0 if robot.state().positions[0] < self.home[0] + 0.3 else 0.0
        )
        rest = robot.state().positions
        moved = tuple(joint + 0.1 for joint in rest)
        move_by_hand((0.1,) * len(rest))
        await until(lambda: robot.state().positions == pytest.approx(moved, abs=self.tolerance))
        if is_available():
            with pytest.raises(RobotFault):
                await robot.follow(self.planned(rest, target), lambda: 1.0)
        path: list[Joints] = []

        def watched() -> float:
            path.append(robot.state().positions)
            return 1.0

        assert await robot.move(target, 1.0, watched)
        assert robot.state().positions == pytest.approx(target, abs=self.tolerance)
        assert path[0] == pytest.approx(moved, abs=0.05)

    async def test_a_lower_pace_slows_the_joints(self, robot: Robot) -> None:
        """Measured over the whole motion: late cycles of a busy machine are visible in single velocities."""
        began_s, start = robot.state().stamp_s, robot.state().positions[0]
        assert await robot.move(self.target(), 1.0, lambda: 0.1)
        took_s, way = robot.state().stamp_s - began_s, abs(self.target()[0] - start)
        assert took_s >= 0.9 * way / (0.1 * self.limits.velocity[0])

    async def test_a_cancelled_motion_comes_to_rest(self, robot: Robot) -> None:
        moving = asyncio.create_task(robot.move(self.target(2.0), INTERRUPTED, lambda: 1.0))
        await until(lambda: robot.state().velocities[0] > 0.1)
        moving.cancel()
        with pytest.raises(asyncio.CancelledError):
            await moving
        await self.at_rest(robot)
        assert robot.state().positions[0] < self.home[0] + 2.0

    async def test_the_gripper_closes_and_opens(self, robot: Robot) -> None:
        await robot.close_gripper()
        assert robot.gripper_closed
        await robot.open_gripper()
        assert not robot.gripper_closed

    async def test_joints_follow_commanded_velocities_until_the_end(self, robot: Robot) -> None:
        if not self.has_servo:
            with pytest.raises(RobotFault):
                await robot.servo(lambda: self.home, lambda: True, lambda: 1.0)
            return
        velocity = (0.3, *(0.0,) * (len(self.home) - 1))
        assert await robot.servo(
            lambda: velocity, lambda: robot.state().positions[0] > self.home[0] + 0.2, lambda: 1.0
        )
        await self.at_rest(robot)
        assert robot.state().positions[0] > self.home[0] + 0.2 - self.tolerance

    async def test_a_stop_ends_the_motion_at_rest(self, robot: Robot) -> None:
        moving = asyncio.create_task(robot.move(self.target(2.0), INTERRUPTED, lambda: 1.0))
        await until(lambda: robot.state().velocities[0] > 0.1)
        await robot.stop(2)
        assert not await moving
        await self.at_rest(robot)

    async def test_a_second_motion_is_refused_while_one_runs(self, robot: Robot) -> None:
        moving = asyncio.create_task(robot.move(self.target(1.0), 2 * INTERRUPTED, lambda: 1.0))
        await until(lambda: robot.state().velocities[0] > 0.05)
        with pytest.raises(RobotFault):
            await robot.move(self.home, 1.0, lambda: 1.0)
        assert await moving
        assert robot.state().positions == pytest.approx(self.target(1.0), abs=self.tolerance)

    async def test_a_target_that_is_no_number_is_a_fault(self, robot: Robot) -> None:
        with pytest.raises(RobotFault):
            await robot.move((float("nan"), *self.home[1:]), 1.0, lambda: 1.0)
        assert robot.state().positions == pytest.approx(self.home, abs=self.tolerance)

    async def test_switching_off_brings_the_joints_to_rest(self, robot: Robot) -> None:
        moving: asyncio.Task[Any] = asyncio.create_task(
            robot.move(self.target(2.0), INTERRUPTED, lambda: 1.0)
        )
        await until(lambda: robot.state().velocities[0] > 0.1)
        await robot.__aexit__(None, None, None)
        assert not await moving
        with pytest.raises(RobotFault):
            await robot.move(self.home, 1.0, lambda: 1.0)
