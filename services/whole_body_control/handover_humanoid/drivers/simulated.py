"""The driver `simulated`: a robot in MuJoCo that stands, without a ball and without people."""

from handover.formats.validation import ClosedModel
from handover_humanoid.behaviours.walking import WalkingSettings
from handover_humanoid.drivers import DriverContext
from handover_humanoid.model.kinematics import Kinematics
from handover_humanoid.simulation.simulated_robot import SimulatedRobot


class NoOptions(ClosedModel):
    """It has none."""


def make_robot(context: DriverContext) -> SimulatedRobot:
    """Return the robot. Raises `UsageError` for options, and for a model that MuJoCo cannot use."""
    context.read_options(NoOptions)
    start = Kinematics(context.humanoid).standing(WalkingSettings().pose)
    return SimulatedRobot(context.humanoid, start)
