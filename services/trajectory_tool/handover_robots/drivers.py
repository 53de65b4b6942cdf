"""Robot drivers by name: what `HANDOVER_ROBOT` chooses, ours and those of other packages.

A driver moves the joints of any robot model. A package registers a factory, which makes a `Robot` from a
`RobotContext`:

    [project.entry-points."handover.robot_drivers"]
    my-controller = "my_controller:make_robot"
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from handover.broker import BrokerClient
from handover.errors import UsageError
from handover.extensions import ExtensionPoint
from handover.validation import fault_lines
from handover_robots.limits.limiter import Limiter
from handover_robots.position_file import PositionFile
from handover_robots.robot import Joints, Robot
from handover_robots.robot_model import RobotModel
from handover_robots.scene import Scene
from handover_robots.settings import TrajectorySettings
from handover_robots.trajectory import Limits

Form = TypeVar("Form", bound=BaseModel)

DRIVERS = ExtensionPoint(
    "robot driver",
    "handover.robot_drivers",
    {
        "simulated": "handover_robots.simulated_robot:SimulatedRobot.from_context",
        "physics": "handover_robots.physics.robot:PhysicsRobot.from_context",
        "ros": "handover_robots.ros_robot:RosRobot.from_context",
        "ur": "handover_robots.universal_robots.driver:UniversalRobot.from_context",
    },
)


@dataclass(frozen=True, slots=True)
class Clock:
    """Time for a robot: `now_s` on any monotonic clock, and how to wait for `s` seconds on it."""

    now_s: Callable[[], float] = time.monotonic
    wait_s: Callable[[float], None] = time.sleep


@dataclass(frozen=True, slots=True)
class Peer:
    """A robot of the cell with the same driver, and its joints: those that were stored last, or home."""

    model: RobotModel
    joints: Joints


@dataclass(frozen=True, slots=True)
class RobotContext:
    """What a robot is made from.

    `robot_id` is its name in the cell, `options` are the settings of its driver in the cell file. `limits`
    are those of the model, or of the cell file. `joints` and `gripper_closed` are the state that was
    stored last, or home. `gripper_s` is how long the gripper of the scene takes. `is_between_fingers` says
    for joint positions whether a simulated gripper closes on a part. `broker` is None where a cell is tried
    without one.
    """

    settings: TrajectorySettings
    robot_id: str
    options: Mapping[str, Any]
    model: RobotModel
    scene: Scene
    limits: Limits
    joints: Joints
    gripper_closed: bool
    gripper_s: float
    is_between_fingers: Callable[[Joints], bool]
    broker: BrokerClient | None = None
    clock: Clock | None = None
    limiter: Limiter | None = None
    """Every setpoint passes it before it is commanded."""
    positions: PositionFile | None = None
    """Where a simulated robot keeps its joints."""
    peers: Mapping[str, Peer] = field(default_factory=dict)
    """The robots of the cell with this driver, this one included, in the order of the cell file."""
    shared: dict[str, Any] = field(default_factory=dict)
    """What the driver keeps for all of them, such as a simulated world."""

    def read_options(self, form: type[Form]) -> Form:
        """Return the options as `form`. Raises `UsageError` that names each fault."""
        try:
            return form.model_validate(dict(self.options))
        except ValidationError as error:
            faults = fault_lines(error, within=f"robots.{self.robot_id}.settings")
            raise UsageError("\n".join(faults)) from None


RobotFactory = Callable[[RobotContext], Robot]
