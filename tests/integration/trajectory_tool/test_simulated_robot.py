"""The simulated robot as a driver."""

from collections.abc import AsyncIterator

import pytest

from services.trajectory_tool.robots.ur10 import ROBOT
from services.trajectory_tool.simulated_robot import SimulatedRobot
from tests.integration.trajectory_tool.robot_contract import RobotContract


class TestSimulatedRobot(RobotContract):
    home = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
    limits = ROBOT.limits
    still = 0.0

    @pytest.fixture
    async def robot(self) -> AsyncIterator[SimulatedRobot]:
        async with SimulatedRobot(self.home, self.limits, something_there=lambda joints: False) as made:
            yield made
