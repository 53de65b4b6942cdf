"""The driver does what every driver does, with any robot: here a UR10."""

from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest
from rail_robot.driver import SteadyRobot

from handover_robots.driver_contract import RobotContract, context_of
from handover_robots.drivers import DRIVERS
from handover_robots.model.joints import Joints
from handover_robots.robots import ROBOTS

UR10 = ROBOTS.load("ur10")


class TestSteadyRobot(RobotContract):
    """The tests of the contract."""

    home = UR10.home
    limits = UR10.limits

    @pytest.fixture
    async def robot(self, tmp_path: Path) -> AsyncIterator[SteadyRobot]:
        async with DRIVERS.load("steady")(context_of(UR10, tmp_path)) as made:
            yield made

    @pytest.fixture
    def move_by_hand(self, robot: SteadyRobot) -> Callable[[Joints], None]:
        return robot.controller.move_by_hand
