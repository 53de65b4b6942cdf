"""The driver `ur` does what every driver does, with a controller of the e-Series."""

from collections.abc import Callable

import pytest

from handover_robots.driver_contract import RobotContract
from handover_robots.model.joints import Joints
from handover_robots.robots.ur10 import ROBOT
from services.trajectory_tool.tests.integration.universal_robots.conftest import HOME
from tests.kit.ur_controllers import RunningController

pytestmark = pytest.mark.slow


class TestUniversalRobot(RobotContract):
    home = HOME
    limits = ROBOT.limits

    @pytest.fixture
    def frequency_hz(self) -> float:
        return 500.0

    @pytest.fixture
    def move_by_hand(self, controller: RunningController) -> Callable[[Joints], None]:
        return lambda displacements: controller.do(lambda simulated: simulated.move_by_hand(displacements))
