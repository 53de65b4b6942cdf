"""The model of a robot: joints with limits, kinematics and gripper; `robots.urdf` reads it from a URDF.

Everything that the trajectory tool and the web page know of a robot comes from its model. The kinematic chain
leads from the root link of the URDF to the tip of the tool. The movable joints on it are the joints of the
robot, in this order; joints beside it, such as fingers, are not planned.
"""

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

from handover.messages import Message, message, text_of
from handover_robots.model.faults import Unreachable
from handover_robots.model.joints import Joints
from handover_robots.model.poses import Frame, Pose, Vector, cross, turn
from handover_robots.model.srdf import LinkPair
from handover_robots.model.trajectory import Limits

JointKind = Literal["revolute", "continuous", "prismatic"]

InverseKinematics = Callable[[Frame, Joints], Joints]
"""Returns the joints nearest to given ones with the flange at a frame. Raises `Unreachable`."""

AllSolutions = Callable[[Frame, Joints], list[Joints]]
"""Returns every solution (full turns aside) with the flange at a frame, none when it is out of reach."""

NumericalInverse = Callable[[Pose, Joints], Joints]
"""Returns the joints nearest to given ones with the tip of the tool at a pose. Raises `Unreachable`."""

IDENTITY = Frame(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), (0.0, 0.0, 0.0))

MAX_PLAIN_NUMBER = 1e6
"""From here on a text has a power of ten: a mistyped position may have 300 digits."""


MEASURING_ERROR = 0.002
"""A joint at its limit is measured at most this far beyond it, in rad or m."""


@dataclass(frozen=True, slots=True)
class Joint:
    """A movable joint; units are rad and s, for a prismatic joint m and s.

    `lower` and `upper` are None for a continuous joint. `labels` are names for people, by language.
    """

    name: str
    kind: JointKind
    lower: float | None
    upper: float | None
    max_velocity: float
    max_acceleration: float
    max_jerk: float
    labels: Mapping[str, str]

    @property
    def unit(self) -> str:
        """Return the unit of the position."""
        return "m" if self.kind == "prismatic" else "rad"


@dataclass(frozen=True, slots=True)
class Finger:
    """A joint of the gripper, for display: its positions when opened, closed, and closed around a part."""

    joint: str
    opened: float
    closed: float
    holding: float


@dataclass(frozen=True, slots=True)
class Segment:
    """A joint of the chain: its fixed origin, its axis, and its number if it is movable."""

    origin: Frame
    axis: Vector
    kind: str
    number: int | None

    def frame(self, joints: Joints) -> Frame:
        """Return the frame of the joint at these positions, seen from the joint before."""
        if self.number is None:
            return self.origin
        return self.origin @ joint_motion(self.kind, self.axis, joints[self.number])


@dataclass(frozen=True)
class RobotModel:
    """A robot: what it is, not what it does now. Made by `read_model`."""

    name: str
    urdf: str
    joints: tuple[Joint, ...]
    home: Joints
    tip: str
    fingers: tuple[Finger, ...]
    inverse: InverseKinematics | None
    solutions: AllSolutions | None
    scene: Path | None
    disabled_pairs: frozenset[LinkPair]
    """Pairs of links that are not checked for collision."""
    poses: Mapping[str, Joints]
    """Named positions of the joints."""
    to_flange: tuple[Segment, ...] = field(repr=False)
    """The joints of the chain from the root link to the flange."""
    tool: Frame = field(repr=False)
    """The tip of the tool, seen from the flange."""
    driver_scenes: Mapping[str, Path] = field(default_factory=dict)
    """The scene for a driver in place of `scene`, by the name of the driver."""
    file: Path | None = field(default=None, repr=False)
    """The URDF that the model was read from."""
    base: Frame = IDENTITY
    """Where the root link stands in the frame of the cell; all poses of the model are in that frame."""
    max_payload_kg: float | None = None
    """What the robot may carry at its flange, the tool included; None where its maker is not known."""
    tool_kg: float = 0.0
    """The mass of what the last moving link carries, by its inertias in the URDF."""
    make_inverse: "Callable[[RobotModel], NumericalInverse | None] | None" = field(
        default=None, repr=False, compare=False
    )
    """Makes the inverse kinematics of a model without a closed form; None where the extra is missing."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Return the names of the joints, from the base to the flange."""
        return tuple(joint.name for joint in self.joints)

    @property
    def limits(self) -> Limits:
        """Return the limits of velocity, acceleration and jerk."""
        return Limits(
            tuple(joint.max_velocity for joint in self.joints),
            tuple(joint.max_acceleration for joint in self.joints),
            tuple(joint.max_jerk for joint in self.joints),
        )

    @cached_property
    def revision(self) -> str:
        """Return a hash that differs between descriptions that are drawn or moved differently."""
        described = (self.name, self.home, self.joints, self.tip, self.fingers, self.urdf, self.base)
        return hashlib.sha256(repr(described).encode()).hexdigest()[:16]

    def mounted(self, base: Frame) -> "RobotModel":
        """Return the model with its root link at `base` in the frame of the cell."""
        from_cell, inverse, solutions = base.inverse(), self.inverse, self.solutions
        return replace(
            self,
            base=base @ self.base,
            to_flange=(Segment(base, (0.0, 0.0, 1.0), "fixed", None), *self.to_flange),
            inverse=inverse and (lambda flange, near: inverse(from_cell @ flange, near)),
            solutions=solutions and (lambda flange, near: solutions(from_cell @ flange, near)),
        )

    def with_home(self, home: Joints) -> "RobotModel":
        """Return the model with another home position. Raises `Unreachable`."""
        self.allow(home)
        return replace(self, home=home, poses={**self.poses, "home": home})

    def flange(self, joints: Joints) -> Frame:
        """Return the frame of the flange, seen from the cell."""
        reached = IDENTITY
        for segment in self.to_flange:
            reached = reached @ segment.frame(joints)
        return reached

    def chain(self, joints: Joints) -> list[Vector]:
        """Return the positions of the joints from the base to the flange, and of the tool's tip."""
        reached, positions = IDENTITY, []
        for segment in self.to_flange:
            reached = reached @ segment.frame(joints)
            positions.append(reached.position)
        return [*positions, (reached @ self.tool).position]

    def jacobian(self, joints: Joints) -> list[tuple[Vector, Vector]]:
        """Return for each joint the linear and the angular velocity of the tool's tip in axes of the cell.

        They are for a velocity of 1 rad/s, for prismatic joints 1 m/s.
        """
        reached = IDENTITY
        axes: list[tuple[int, str, Vector, Vector]] = []
        for segment in self.to_flange:
            if segment.number is None:
                reached = reached @ segment.origin
                continue
            before = reached @ segment.origin
            axes.append((segment.number, segment.kind, turn(before.rotation, segment.axis), before.position))
            reached = before @ joint_motion(segment.kind, segment.axis, joints[segment.number])
        x, y, z = (reached @ self.tool).position
        columns: dict[int, tuple[Vector, Vector]] = {}
        for number, kind, axis, (x0, y0, z0) in axes:
            if kind == "prismatic":
                columns[number] = axis, (0.0, 0.0, 0.0)
            else:
                columns[number] = cross(axis, (x - x0, y - y0, z - z0)), axis
        return [columns[number] for number in range(len(self.joints))]

    def tool_pose(self, joints: Joints) -> Pose:
        """Return the pose of the tool's tip."""
        return Pose.of(self.flange(joints) @ self.tool)

    def flange_for(self, pose: Pose) -> Frame:
        """Return the frame of the flange with the tip of the tool at `pose`."""
        return pose.frame() @ self.tool.inverse()

    def reach(self, pose: Pose, near: Joints) -> Joints:
        """Return the joints nearest to `near` with the tip of the tool at `pose`. Raises `Unreachable`."""
        if self.inverse is None:
            return self._reach_numerically(pose, near)
        try:
            return self.allow(self.inverse(self.flange_for(pose), near))
        except Unreachable as why:
            where = ", ".join(f"{value:.3f}" for value in pose.position)
            raise Unreachable(
                message(
                    "robot.tool_unreachable",
                    "the tool cannot be at ({position}) m: {why}",
                    position=where,
                    why=text_of(why),
                )
            ) from None

    def _reach_numerically(self, pose: Pose, near: Joints) -> Joints:
        numerical_inverse = self._numerical_inverse
        if numerical_inverse is None:
            raise Unreachable(
                message(
                    "robot.no_inverse_kinematics",
                    '{robot} has no inverse kinematics; give "joints" instead of a pose, or install the '
                    'extra "motion"',
                    robot=self.name,
                )
            )
        return numerical_inverse(pose, near)

    @cached_property
    def _numerical_inverse(self) -> NumericalInverse | None:
        return None if self.make_inverse is None else self.make_inverse(self)

    def measured_within(self, joints: Joints) -> Joints:
        """Return measured joints without what they are beyond a limit by the errors of servo and encoder."""

        def within(joint: Joint, position: float) -> float:
            if joint.lower is None or joint.upper is None:
                return position
            nearest = min(max(position, joint.lower), joint.upper)
            return nearest if abs(nearest - position) < MEASURING_ERROR else position

        return tuple(within(joint, position) for joint, position in zip(self.joints, joints, strict=True))

    def payload_fault(self, payload_kg: float) -> Message | None:
        """Return why the robot may not carry a part of this mass in its tool; None if it may."""
        if self.max_payload_kg is None:
            if payload_kg <= 0.0:
                return None
            return message(
                "robot.payload_unknown",
                "it is unknown how much {robot} may carry, so no motion with a part of {part} kg is planned; "
                "give the robot max_payload_kg in its robot.yaml, or remove part_mass_kg from the scene",
                part=f"{payload_kg:g}",
                robot=self.name,
            )
        if payload_kg + self.tool_kg <= self.max_payload_kg:
            return None
        return message(
            "robot.payload_exceeded",
            "a part of {part} kg and the tool of {tool} kg are more than the {limit} kg that {robot} may "
            "carry; choose a lighter part, or correct part_mass_kg of the scene, or max_payload_kg of the "
            "model",
            part=f"{payload_kg:g}",
            tool=f"{self.tool_kg:g}",
            limit=f"{self.max_payload_kg:g}",
            robot=self.name,
        )

    def allow(self, joints: Joints) -> Joints:
        """Return `joints` if there is one for each joint, within its limits. Raises `Unreachable`."""
        if len(joints) != len(self.joints):
            raise Unreachable(
                message(
                    "robot.wrong_joint_count",
                    "{robot} has {count} joints ({names}), and {given} positions are given",
                    robot=self.name,
                    count=len(self.joints),
                    names=", ".join(self.joint_names),
                    given=len(joints),
                )
            )
        for joint, position in zip(self.joints, joints, strict=True):
            if joint.lower is None or joint.upper is None or joint.lower <= position <= joint.upper:
                continue
            raise Unreachable(
                message(
                    "robot.joint_limit",
                    "{joint} cannot be at {position} {unit}: it moves from {lower} to {upper} {unit}; "
                    "choose a position in between",
                    joint=joint.name,
                    position=f"{position:.3f}" if abs(position) < MAX_PLAIN_NUMBER else f"{position:.3g}",
                    lower=f"{joint.lower:.3f}",
                    upper=f"{joint.upper:.3f}",
                    unit=joint.unit,
                )
            )
        return joints


def joint_motion(kind: str, axis: Vector, position: float) -> Frame:
    """Return the frame of a joint that has moved by `position` from 0."""
    x, y, z = axis
    if kind == "prismatic":
        return Frame(IDENTITY.rotation, (x * position, y * position, z * position))
    c, s = math.cos(position), math.sin(position)
    d = 1 - c
    return Frame(
        (
            (c + x * x * d, x * y * d - z * s, x * z * d + y * s),
            (y * x * d + z * s, c + y * y * d, y * z * d - x * s),
            (z * x * d - y * s, z * y * d + x * s, c + z * z * d),
        ),
        (0.0, 0.0, 0.0),
    )
