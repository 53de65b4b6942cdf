"""The driver `simulated`: a robot in MuJoCo that stands, without a ball and without people."""

from pydantic import BaseModel, ConfigDict

from services.whole_body_control.behaviours.walking import WalkingSettings
from services.whole_body_control.drivers import DriverContext
from services.whole_body_control.model.kinematics import Kinematics
from services.whole_body_control.simulation.simulated_robot import SimulatedRobot


class NoOptions(BaseModel):
    """It has none."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def make_robot(context: DriverContext) -> SimulatedRobot:
    """Return the robot. Raises `UsageError` for options, and for a model that MuJoCo cannot use."""
    context.read_options(NoOptions)
    start = Kinematics(context.humanoid).standing(WalkingSettings().pose)
    return SimulatedRobot(context.humanoid, start)
