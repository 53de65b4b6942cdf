"""Robot drivers by name: what `HANDOVER_ROBOT` chooses, ours and those of other packages.

A driver moves the joints of any robot model. A package registers a factory, which makes a `Robot` from a
`RobotContext`:

    [project.entry-points."handover.robot_drivers"]
    my-controller = "my_controller:make_robot"
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

from handover.broker import BrokerClient
from handover.extensions import ExtensionPoint
from services.trajectory_tool.robot import Joints, Robot
from services.trajectory_tool.robot_model import RobotModel
from services.trajectory_tool.settings import TrajectorySettings
from services.trajectory_tool.trajectory import Limits

DRIVERS = ExtensionPoint(
    "robot driver",
    "handover.robot_drivers",
    {
        "simulated": "services.trajectory_tool.simulated_robot:SimulatedRobot.from_context",
        "ros": "services.trajectory_tool.ros_robot:RosRobot.from_context",
    },
)


@dataclass(frozen=True, slots=True)
class Clock:
    """Time for a robot: `now_s` on any monotonic clock, and how to wait for `s` seconds on it."""

    now_s: Callable[[], float] = time.monotonic
    wait_s: Callable[[float], None] = time.sleep


@dataclass(frozen=True, slots=True)
class RobotContext:
    """What a robot is made from.

    `limits` are those of the model, or of the settings. `joints` and `gripper_closed` are the state that was
    stored last, or home. `gripper_s` is how long the gripper of the scene takes. `is_between_fingers` says
    for joint positions whether a simulated gripper closes on a part. `broker` is None where a cell is tried
    without one.
    """

    settings: TrajectorySettings
    model: RobotModel
    limits: Limits
    joints: Joints
    gripper_closed: bool
    gripper_s: float
    is_between_fingers: Callable[[Joints], bool]
    broker: BrokerClient | None = None
    clock: Clock | None = None


RobotFactory = Callable[[RobotContext], Robot]
