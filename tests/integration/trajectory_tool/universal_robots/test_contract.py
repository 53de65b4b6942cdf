"""The driver `ur` does what every driver does, with a controller of the e-Series."""

import pytest

from services.trajectory_tool.robots.ur10 import ROBOT
from tests.integration.trajectory_tool.robot_contract import RobotContract
from tests.integration.trajectory_tool.universal_robots.conftest import HOME

pytestmark = pytest.mark.slow


class TestUniversalRobot(RobotContract):
    home = HOME
    limits = ROBOT.limits

    @pytest.fixture
    def frequency_hz(self) -> float:
        return 500.0
