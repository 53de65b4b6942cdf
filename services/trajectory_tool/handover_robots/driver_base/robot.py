"""The interface of a robot driver: joints and a gripper.

A simulation, a physics engine or a vendor's driver implements it. A pause is a smooth stop, followed later by
another motion to the same target.
"""

from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Self

from handover_robots.model.faults import LeaseEnded, NoPath, RobotFault, UnknownOutcome, Unreachable
from handover_robots.model.joint_trajectory import JointTrajectory
from handover_robots.model.joints import Joints, JointState, Pace, Velocity
from handover_robots.model.poses import Pose
from handover_robots.scene.scene import Scene
from handover_robots.scene.vision import Vision

if TYPE_CHECKING:
    from fastapi import FastAPI

    from handover.subscriptions.record import SubscriptionRecord
    from handover.tasks.device_lease import Authority, DeviceLease

__all__ = [
    "JointState",
    "Joints",
    "LeaseEnded",
    "NoPath",
    "Pace",
    "Robot",
    "RobotFault",
    "SafetyStatus",
    "StopCategory",
    "TruePart",
    "UnknownOutcome",
    "Unreachable",
    "Velocity",
]

StopCategory = Literal[1, 2]
"""A controlled stop after IEC 60204-1: 1 removes the power of the drives at rest, 2 keeps it."""


@dataclass(frozen=True, slots=True)
class SafetyStatus:
    """The safety functions of a real robot as its controller reports them; they are never reset from here."""

    emergency_stop: bool = False
    protective_stop: bool = False
    safeguard_stop: bool = False
    mode: str = ""
    speed: float | None = None
    """The fraction of the speed that is set at the robot."""
    detail: str = ""


@dataclass(frozen=True, slots=True)
class TruePart:
    """A part of a simulation: the pose of its middle in the cell, and its size along its axes in m."""

    pose: Pose
    size: tuple[float, float, float]


class Robot(ABC):
    """An arm with a gripper; an asynchronous context manager while it is switched on."""

    vision: Vision | None = None
    """The eyes of the robot, for a driver with a camera."""

    lease: "DeviceLease | None" = None
    """The lease of its Device; None where nobody else can command the robot. A driver asks `authority` at the
    start of a motion, and whether that is valid before every setpoint, goal and gripper action."""

    def authority(self) -> "Authority | None":
        """Return the right to command the robot under the present lease; None if it needs none.

        Raises `LeaseEnded` if this process does not hold it.
        """
        lease = self.lease
        if lease is None:
            return None
        authority = lease.authority()
        if not authority.is_valid():
            if lease.holder is not None:
                raise LeaseEnded.translated(
                    "robot.lease_taken",
                    "{holder} holds the lease of {device}, so it is not commanded from here; stop that "
                    "process to take over",
                    device=lease.device,
                    holder=lease.holder,
                )
            raise LeaseEnded.translated(
                "robot.lease_not_granted",
                "the orchestrator has not granted the lease of {device}, so it is not commanded; start "
                "the orchestrator, or set HANDOVER_DEVICE_LEASES=off in a cell without one",
                device=lease.device,
            )
        return authority

    def mount(self, app: "FastAPI") -> None:  # noqa: B027 - most robots have none
        """Add routes of the robot, such as one for notifications."""

    def record_subscriptions(self, record: "SubscriptionRecord") -> Collection[str]:  # noqa: ARG002
        """Add the subscriptions of the robot to `record` from now on; return their ids."""
        return ()

    @abstractmethod
    def state(self) -> JointState:
        """Return the present joints; cheap and thread-safe."""

    def commanded(self) -> Joints:
        """Return the joints that were commanded last, after the limiter; cheap and thread-safe."""
        return self.state().positions

    def safety_status(self) -> SafetyStatus | None:
        """Return what the controller of a real robot reports; None where there is none. Cheap."""
        return None

    @abstractmethod
    def remaining_s(self) -> float:
        """Return the remaining time of the motion; 0 at rest."""

    @abstractmethod
    def estimate_s(self, start: Joints, target: Joints, speed: float) -> float:
        """Return the duration of a motion from rest at `start` to rest at `target` at `speed`."""

    @abstractmethod
    async def move(self, target: Joints, speed: float, pace: Pace) -> bool:
        """Move to `target` at `speed`, a fraction from 0 to 1 of the joint limits, slowed down by `pace`.

        Returns True at rest at the target. After the first pace of 0, the joints stop within their limits and
        False is returned; call again to continue. Raises `RobotFault`, also while another motion runs.
        """

    async def follow(self, trajectory: JointTrajectory, pace: Pace) -> bool:  # noqa: ARG002
        """Follow a planned trajectory from the present joints, with pauses as for `move`.

        A stop stays on the path of the trajectory. Raises `RobotFault`, also if the driver only moves on
        straight lines in joint space.
        """
        raise RobotFault.translated(
            "robot.driver_cannot_follow",
            "the driver {driver} cannot follow planned motions; use another driver, or a scene "
            "without obstacles",
            driver=type(self).__name__,
        )

    async def servo(self, velocity: Velocity, until: Callable[[], bool], pace: Pace) -> bool:  # noqa: ARG002
        """Move with the latest commanded joint velocities until `until` returns True.

        The limiter changes velocities that lead beyond a limit. Returns True at rest, and False after a stop
        because of a pace of 0. Raises `RobotFault`, also if the driver has no velocity commands.
        """
        raise RobotFault.translated(
            "robot.driver_has_no_servo",
            "the driver {driver} follows no velocity commands; use another driver",
            driver=type(self).__name__,
        )

    async def stop(self, category: StopCategory) -> None:  # noqa: ARG002
        """Bring a motion to rest within the limits, and return at rest; the motion returns False.

        Raises `RobotFault`, also if the driver cannot stop a motion of another caller.
        """
        raise RobotFault.translated(
            "robot.driver_has_no_stop",
            "the driver {driver} has no stop command; pause or cancel the Task",
            driver=type(self).__name__,
        )

    def digital_inputs(self) -> int | None:
        """Return the digital inputs of the controller, one bit each; None while they are unknown."""
        return None

    def prepare_scene(self, scene: Scene) -> Callable[[], Awaitable[None]] | None:  # noqa: ARG002
        """Return what brings a changed scene to the robot, once it is at rest; None where nothing does.

        Raises `UsageError` for a scene in which the robot cannot be. It may take a second.
        """
        return None

    def true_parts(self) -> Sequence[TruePart] | None:
        """Return where the loose parts of a simulation really are; None for a robot that cannot know."""
        return None

    def wrist_force_n(self) -> float | None:
        """Return the measured force at the wrist in N; None without a measurement. Cheap and thread-safe."""
        return None

    @abstractmethod
    async def close_gripper(self) -> bool:
        """Close the gripper; return True when an object is between its fingers. Raises `RobotFault`."""

    @abstractmethod
    async def open_gripper(self) -> None:
        """Open the gripper. Raises `RobotFault`."""

    @property
    def is_holding(self) -> bool | None:
        """Return whether something is between the fingers; None where the gripper does not measure it."""
        return None

    @property
    @abstractmethod
    def gripper_closed(self) -> bool:
        """Return whether the gripper is closed."""

    @abstractmethod
    async def __aenter__(self) -> Self: ...

    @abstractmethod
    async def __aexit__(self, *_: object) -> None: ...
