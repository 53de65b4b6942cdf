"""What every robot driver does: the tests of a driver subclass `RobotContract` and make the robot.

class TestMyRobot(RobotContract):
    @pytest.fixture
    async def robot(self): ...
"""

import asyncio
from typing import Any

import pytest

from services.trajectory_tool.joint_trajectory import JointTrajectory
from services.trajectory_tool.planning import is_available
from services.trajectory_tool.robot import Joints, Robot, RobotFault
from services.trajectory_tool.trajectory import Limits
from tests.kit.waiting import until


class RobotContract:
    """The tests; a subclass has the fixture `robot`, switched on and at rest at `home`."""

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

    def require_rest(self, robot: Robot) -> None:
        """Require joints at rest."""
        assert max(map(abs, robot.state().velocities)) <= self.still

    async def test_the_joints_are_at_home_at_first(self, robot: Robot) -> None:
        state = robot.state()
        assert state.positions == pytest.approx(self.home, abs=self.tolerance)
        assert len(state.velocities) == len(self.home)
        assert robot.remaining_s() == 0.0

    async def test_a_motion_reaches_its_target_at_rest(self, robot: Robot) -> None:
        assert await robot.move(self.target(), 1.0, lambda: 1.0)
        assert robot.state().positions == pytest.approx(self.target(), abs=self.tolerance)
        self.require_rest(robot)

    async def test_a_planned_motion_is_followed(self, robot: Robot) -> None:
        if not is_available():
            pytest.skip("the extra motion has no wheels here")
        trajectory = self.planned(robot.state().positions, self.target())
        assert await robot.follow(trajectory, lambda: 1.0)
        assert robot.state().positions == pytest.approx(self.target(), abs=self.tolerance)

    def planned(self, start: Joints, target: Joints) -> JointTrajectory:
        """Return a straight line as a trajectory."""
        import numpy as np

        from services.trajectory_tool.planning import timing

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
        self.require_rest(robot)
        rest = robot.state().positions
        assert self.home[0] + 0.15 < rest[0] < self.home[0] + 1.0
        assert await robot.move(self.target(1.0), 1.0, lambda: 1.0)
        assert robot.state().positions == pytest.approx(self.target(1.0), abs=self.tolerance)

    async def test_a_lower_pace_slows_the_joints(self, robot: Robot) -> None:
        fastest = [0.0]
        done = asyncio.Event()

        async def watch() -> None:
            while not done.is_set():
                fastest[0] = max(fastest[0], abs(robot.state().velocities[0]))
                await asyncio.sleep(0.005)

        watching = asyncio.create_task(watch())
        assert await robot.move(self.target(), 1.0, lambda: 0.1)
        done.set()
        await watching
        assert fastest[0] <= 0.1 * self.limits.velocity[0] * 1.1 + self.still

    async def test_a_cancelled_motion_comes_to_rest(self, robot: Robot) -> None:
        moving = asyncio.create_task(robot.move(self.target(2.0), 1.0, lambda: 1.0))
        await until(lambda: robot.state().velocities[0] > 0.2)
        moving.cancel()
        with pytest.raises(asyncio.CancelledError):
            await moving
        self.require_rest(robot)
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
        self.require_rest(robot)
        assert robot.state().positions[0] > self.home[0] + 0.2 - self.tolerance

    async def test_a_stop_ends_the_motion_at_rest(self, robot: Robot) -> None:
        moving = asyncio.create_task(robot.move(self.target(2.0), 1.0, lambda: 1.0))
        await until(lambda: robot.state().velocities[0] > 0.2)
        await robot.stop(2)
        assert not await moving
        self.require_rest(robot)

    async def test_a_second_motion_is_refused_while_one_runs(self, robot: Robot) -> None:
        moving = asyncio.create_task(robot.move(self.target(1.0), 1.0, lambda: 1.0))
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
        moving: asyncio.Task[Any] = asyncio.create_task(robot.move(self.target(2.0), 1.0, lambda: 1.0))
        await until(lambda: robot.state().velocities[0] > 0.2)
        await robot.__aexit__(None, None, None)
        assert not await moving
        with pytest.raises(RobotFault):
            await robot.move(self.home, 1.0, lambda: 1.0)
