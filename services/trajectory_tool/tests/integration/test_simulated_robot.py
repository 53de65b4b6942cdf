"""The simulated robot as a driver."""

from collections.abc import AsyncIterator, Callable

import pytest

from handover_robots.driver_contract import RobotContract
from handover_robots.drivers.simulated_robot import SimulatedRobot
from handover_robots.model.joints import Joints
from handover_robots.model.trajectory import Setpoint
from handover_robots.robots.ur10 import ROBOT


class TestSimulatedRobot(RobotContract):
    home = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
    limits = ROBOT.limits
    still = 0.0

    @pytest.fixture
    async def robot(self) -> AsyncIterator[SimulatedRobot]:
        async with SimulatedRobot(self.home, self.limits, something_there=lambda joints: False) as made:
            yield made

    @pytest.fixture
    def move_by_hand(self, robot: SimulatedRobot) -> Callable[[Joints], None]:
        def move(displacements: Joints) -> None:
            there = tuple(map(sum, zip(robot.setpoint.positions, displacements, strict=True)))
            robot.setpoint = Setpoint.at_rest(there)

        return move
