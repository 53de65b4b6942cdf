"""The arms of Universal Robots: their model, forward kinematics, and the inverse in closed form.

The arm is a turntable, a planar arm of two links and a wrist; the inverse solves each in turn, and finds
up to eight solutions for a pose. Dimensions: Universal Robots, "DH parameters for calculations of kinematics
and dynamics".
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from handover.messages import Message, message
from handover_robots.model.faults import Unreachable
from handover_robots.model.joints import Joints
from handover_robots.model.poses import Frame
from handover_robots.model.robot_model import Finger, RobotModel
from handover_robots.robots.urdf import read_model

JOINT_LIMIT_RAD = 2 * math.pi
"""Each joint turns by one full turn in both directions."""

HALF_PART_M = 0.015

LABELS = {
    "shoulder_pan_joint": {"en": "Base", "de": "Basis", "fi": "Jalusta"},
    "shoulder_lift_joint": {"en": "Shoulder", "de": "Schulter", "fi": "Olkapää"},
    "elbow_joint": {"en": "Elbow", "de": "Ellbogen", "fi": "Kyynärpää"},
    "wrist_1_joint": {"en": "Wrist 1", "de": "Handgelenk 1", "fi": "Ranne 1"},
    "wrist_2_joint": {"en": "Wrist 2", "de": "Handgelenk 2", "fi": "Ranne 2"},
    "wrist_3_joint": {"en": "Wrist 3", "de": "Handgelenk 3", "fi": "Ranne 3"},
}

_TWISTS = (math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0)

_FULL_TURN = 2 * math.pi
_ROUNDING = 1e-9
_ALIGNED = 1e-6
"""Below this sine of joint 5 the axes of joints 4 and 6 are parallel, but for a microradian, and joint 6 is
free."""


@dataclass(frozen=True, slots=True)
class UrKinematics:
    """An arm by its Denavit-Hartenberg lengths in m; `a2` and `a3` are negative."""

    d1: float
    a2: float
    a3: float
    d4: float
    d5: float
    d6: float

    @property
    def reach_m(self) -> float:
        """Return the maximum distance of the last wrist joint from the shoulder."""
        return abs(self.a2) + abs(self.a3) + self.d5

    def forward(self, joints: Joints) -> Frame:
        """Return the frame of the flange, seen from the base, for six joint angles in rad."""
        first, *rest = (self._link(number, angle) for number, angle in enumerate(joints))
        reached = first
        for link in rest:
            reached = reached @ link
        return reached

    def inverse(self, flange: Frame, near: Joints) -> list[Joints]:
        """Return all solutions (rad, each joint in -pi..pi) with the flange at `flange`.

        `near` has the value of a free joint, such as joint 6 when the axes of joints 4 and 6 are parallel.
        The list is empty when the pose is unreachable.
        """
        return [
            joints
            for shoulder in self._shoulder_angles(flange)
            for wrist, tool in self._wrist_angles(flange, shoulder, near)
            for joints in self._arm_angles(flange, shoulder, wrist, tool)
        ]

    def nearest(self, flange: Frame, current: Joints) -> Joints:
        """Return the solution for `flange` nearest to `current`: with the smallest maximum rotation.

        Joints are within their limits of a full turn in both directions. Raises `Unreachable`.
        """
        solutions = self.inverse(flange, current)
        if not solutions:
            raise Unreachable(self._why_not(flange))
        brought_near = (_brought_near(joints, current) for joints in solutions)
        return min(brought_near, key=lambda joints: _effort(joints, current))

    def _link(self, number: int, angle: float) -> Frame:
        c, s = math.cos(angle), math.sin(angle)
        ct, st = math.cos(_TWISTS[number]), math.sin(_TWISTS[number])
        length = (0.0, self.a2, self.a3, 0.0, 0.0, 0.0)[number]
        return Frame(
            ((c, -s * ct, s * st), (s, c * ct, -c * st), (0.0, st, ct)),
            (length * c, length * s, (self.d1, 0.0, 0.0, self.d4, self.d5, self.d6)[number]),
        )

    def _wrist_centre(self, flange: Frame) -> tuple[float, float, float]:
        x, y, z = flange.position
        axis = (flange.rotation[0][2], flange.rotation[1][2], flange.rotation[2][2])
        return (x - self.d6 * axis[0], y - self.d6 * axis[1], z - self.d6 * axis[2])

    def _shoulder_angles(self, flange: Frame) -> Iterator[float]:
        """Yield joint 1: the planar arm passes the base axis at the distance `d4`, on either side."""
        x, y, _ = self._wrist_centre(flange)
        beside = x * x + y * y - self.d4 * self.d4
        if beside < -_ROUNDING:
            return
        opening = math.atan2(math.sqrt(max(beside, 0.0)), self.d4)
        direction = math.atan2(y, x) + math.pi / 2
        yield _wrapped(direction + opening)
        if opening > _ROUNDING:
            yield _wrapped(direction - opening)

    def _wrist_angles(self, flange: Frame, shoulder: float, near: Joints) -> Iterator[tuple[float, float]]:
        """Yield joints 5 and 6: the wrist has two solutions, unless it is straight."""
        s1, c1 = math.sin(shoulder), math.cos(shoulder)
        across = [s1 * x - c1 * y for x, y in zip(flange.rotation[0], flange.rotation[1], strict=True)]
        sine = math.hypot(across[0], across[1])
        bend = math.atan2(sine, across[2])
        if sine < _ALIGNED:
            for tool in self._free_tool_angles(flange, shoulder, bend, near[5]):
                yield (bend, _wrapped(tool))
            return
        yield (bend, math.atan2(-across[1], across[0]))
        yield (-bend, math.atan2(across[1], -across[0]))

    def _free_tool_angles(self, flange: Frame, shoulder: float, wrist: float, wanted: float) -> list[float]:
        """Return joint 6 for a straight wrist: `wanted` if the arm reaches, else the nearest possible value.

        The axes of joints 4 and 6 are parallel then, `d5` apart: joint 6 moves the end of the forearm along a
        circle, and only a part of that circle may be within the reach of the two links.
        """
        east, north, west = (
            self._forearm_end(flange, shoulder, wrist, angle).position
            for angle in (0.0, math.pi / 2, math.pi)
        )
        x, y = (east[0] + west[0]) / 2, (east[1] + west[1]) / 2
        outward = math.atan2(x * (north[0] - x) + y * (north[1] - y), x * (east[0] - x) + y * (east[1] - y))
        middle, swing = x * x + y * y + self.d5 * self.d5, 2 * math.hypot(x, y) * self.d5
        least, most = (abs(self.a2) - abs(self.a3)) ** 2, (abs(self.a2) + abs(self.a3)) ** 2
        if least <= middle + swing * math.cos(wanted - outward) <= most or swing < _ROUNDING:
            return [wanted]
        edges = ((limit - middle) / swing for limit in (least, most))
        reached = [max(-1.0, min(edge, 1.0)) for edge in edges if abs(edge) <= 1 + _ROUNDING]
        return [outward + side * math.acos(edge) for edge in reached for side in (1, -1)]

    def _forearm_end(self, flange: Frame, shoulder: float, wrist: float, tool: float) -> Frame:
        """Return the frame of joint 4's axis, seen from the shoulder."""
        hand = self._link(4, wrist) @ self._link(5, tool)
        return self._link(0, shoulder).inverse() @ flange @ hand.inverse()

    def _arm_angles(self, flange: Frame, shoulder: float, wrist: float, tool: float) -> Iterator[Joints]:
        """Yield all six joints: the planar arm of two links, with its elbow up or down."""
        forearm_end = self._forearm_end(flange, shoulder, wrist, tool)
        # Joint 4's offset points out of the plane of the arm: x and y are what the two links must span.
        x, y = forearm_end.position[0], forearm_end.position[1]
        cosine = (x * x + y * y - self.a2 * self.a2 - self.a3 * self.a3) / (2 * self.a2 * self.a3)
        if abs(cosine) > 1 + _ROUNDING:
            return
        sine = math.sqrt(max(1 - cosine * cosine, 0.0))
        pitch = math.atan2(forearm_end.rotation[1][0], forearm_end.rotation[0][0])
        for bent in (sine, -sine) if sine > _ROUNDING else (sine,):
            elbow = math.atan2(bent, cosine)
            lift = math.atan2(y, x) - math.atan2(
                self.a3 * math.sin(elbow), self.a2 + self.a3 * math.cos(elbow)
            )
            yield (
                shoulder,
                _wrapped(lift),
                elbow,
                _wrapped(pitch - lift - elbow),
                wrist,
                tool,
            )

    def _why_not(self, flange: Frame) -> Message:
        x, y, z = self._wrist_centre(flange)
        beside_m, distance_m = math.hypot(x, y), math.dist((x, y, z), (0.0, 0.0, self.d1))
        if beside_m < self.d4:
            return message(
                "robot.wrist_too_near",
                "the wrist would be {distance} m from the axis of the base, and the arm passes that axis at "
                "{nearest} m; choose a pose further out",
                distance=f"{beside_m:.3f}",
                nearest=f"{self.d4:.3f}",
            )
        return message(
            "robot.wrist_too_far",
            "the wrist would be {distance} m from the shoulder, and the arm reaches {reach} m at most, "
            "less with some orientations; choose a pose nearer to the base or another orientation",
            distance=f"{distance_m:.3f}",
            reach=f"{self.reach_m:.2f}",
        )


def read_ur(
    folder: Path,
    file: str,
    *,
    name: str,
    kinematics: UrKinematics,
    max_payload_kg: float,
    scene: Path | None = None,
) -> RobotModel:
    """Return the model of an arm with the parallel gripper, from the URDF and SRDF `file` of its folder.

    Universal Robots publishes no limits of acceleration and jerk; these are ours.
    """
    return read_model(
        folder / f"{file}.urdf",
        name=name,
        flange="gripper",
        tip="tip",
        srdf=folder / f"{file}.srdf",
        max_acceleration=8.0,
        max_jerk=80.0,
        labels=LABELS,
        fingers=(
            Finger("finger_left_joint", opened=0.034, closed=0.0, holding=HALF_PART_M),
            Finger("finger_right_joint", opened=0.034, closed=0.0, holding=HALF_PART_M),
        ),
        inverse=kinematics.nearest,
        solutions=kinematics.inverse,
        scene=scene,
        max_payload_kg=max_payload_kg,
    )


def _brought_near(joints: Joints, current: Joints) -> Joints:
    return tuple(_same_angle_near(angle, now) for angle, now in zip(joints, current, strict=True))


def _same_angle_near(angle: float, now: float) -> float:
    turns = (angle + _FULL_TURN * turn for turn in (-1, 0, 1))
    allowed = (turned for turned in turns if abs(turned) <= JOINT_LIMIT_RAD + _ROUNDING)
    chosen = min(allowed, key=lambda turned: abs(turned - now))
    return max(-JOINT_LIMIT_RAD, min(chosen, JOINT_LIMIT_RAD))


def _effort(joints: Joints, current: Joints) -> tuple[float, float]:
    ways = [abs(angle - now) for angle, now in zip(joints, current, strict=True)]
    return (round(max(ways), 9), sum(ways))


def _wrapped(angle: float) -> float:
    return math.remainder(angle, _FULL_TURN)
