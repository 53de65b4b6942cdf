"""What a robot driver is made from: the settings, the model, the scene and the stored state."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from handover.broker import BrokerClient
from handover.errors import UsageError
from handover.formats.validation import fault_lines
from handover_robots.driver_base.position_file import PositionFile
from handover_robots.driver_base.robot import Robot
from handover_robots.limits.limiter import Limiter
from handover_robots.model.joints import Joints
from handover_robots.model.robot_model import RobotModel
from handover_robots.model.trajectory import Limits
from handover_robots.scene.scene import Scene
from handover_robots.settings import TrajectorySettings

Form = TypeVar("Form", bound=BaseModel)


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
"""What a package registers as a driver."""
