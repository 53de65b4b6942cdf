"""A robot as the tool sees one: six joints that can be sent somewhere, and a gripper.

Whatever moves, a simulation, a physics engine or a vendor's driver, stands behind this. To pause is to stop
smoothly and to be told the same target again later.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

from fastapi import FastAPI

from handover.errors import HandoverError

Joints = tuple[float, ...]
"""Six joint angles in rad, in the order of `JOINT_NAMES`."""

JOINT_NAMES = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
"""The joints as ROS names those of Universal Robots, from the base to the flange."""


class RobotFault(HandoverError):
    """The robot cannot move; the message says why and what a person has to do."""


@dataclass(frozen=True, slots=True)
class JointState:
    """The joints at one moment: `stamp_s` in s since 1970, positions in rad, velocities in rad/s.

    `efforts` are torques in Nm, None for a robot that does not measure them.
    """

    stamp_s: float
    positions: Joints
    velocities: Joints
    efforts: Joints | None = None


class Robot(ABC):
    """An arm with a gripper; an asynchronous context manager while it is switched on."""

    def mount(self, app: FastAPI) -> None:  # noqa: B027 - most robots have none
        """Add routes of the robot's own, such as one for notifications."""

    @abstractmethod
    def state(self) -> JointState:
        """Return the joints as they are now; cheap, from any thread."""

    @abstractmethod
    def remaining_s(self) -> float:
        """Return how long the motion under way will still take; 0 at rest."""

    @abstractmethod
    def estimate_s(self, start: Joints, target: Joints, speed: float) -> float:
        """Return how long a motion from rest at `start` to rest at `target` takes at `speed`."""

    @abstractmethod
    async def move(self, target: Joints, speed: float, may_go: Callable[[], bool]) -> bool:
        """Move to `target` at `speed`, a fraction from 0 to 1 of what the joints may do.

        Returns True at rest at the target. `may_go` is asked in each cycle of control: once it answers
        False the joints are brought to rest within their limits, and False is returned; to go on, call
        again. `may_go` may be asked from another thread. Raises `RobotFault`.
        """

    @abstractmethod
    async def close_gripper(self) -> bool:
        """Close the gripper; True when there is something between its fingers. Raises `RobotFault`."""

    @abstractmethod
    async def open_gripper(self) -> None:
        """Open the gripper. Raises `RobotFault`."""

    @property
    @abstractmethod
    def gripper_closed(self) -> bool:
        """Say whether the gripper is closed."""

    @abstractmethod
    async def __aenter__(self) -> Self: ...

    @abstractmethod
    async def __aexit__(self, *_: object) -> None: ...
