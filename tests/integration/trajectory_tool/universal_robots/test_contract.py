"""The driver `ur` does what every driver does."""

from services.trajectory_tool.robots.ur10 import ROBOT
from tests.integration.trajectory_tool.robot_contract import RobotContract
from tests.integration.trajectory_tool.universal_robots.conftest import HOME


class TestUniversalRobot(RobotContract):
    home = HOME
    limits = ROBOT.limits
