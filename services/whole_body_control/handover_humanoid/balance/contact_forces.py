"""Forces on the feet for a wanted zero moment point, and the joint torques that make them.

The centre of mass of a linear inverted pendulum above the ZMP p needs the force m (c'' + g) with
c'' = omega² (c - p); it passes through the centre of mass. It is shared by the feet that stand, with a centre
of pressure of each inside of its sole, and the joints carry body and forces (Kajita 2010, Caron 2019).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from handover_humanoid.components.robot import JointCommand
from handover_humanoid.model.kinematics import (
    BASE_POSITIONS,
    BASE_VELOCITIES,
    GRAVITY_MPS2,
    Array,
    Kinematics,
    cross,
)
from handover_humanoid.patterns.regions import Footprint, Side

UPWARDS = np.array([0.0, 0.0, GRAVITY_MPS2])


def nearest_in_sole(
    foot: Footprint, sole: Array, point: Array | tuple[float, float], margin_m: float
) -> Array:
    """Return the point (2,) of a rectangular sole, `margin_m` inside, that is nearest to a point."""
    cosine, sine = math.cos(foot.yaw), math.sin(foot.yaw)
    x, y = float(point[0]) - foot.x, float(point[1]) - foot.y
    low_x, low_y, high_x, high_y = _sides(sole.tobytes())
    ahead = min(max(cosine * x + sine * y, low_x + margin_m), high_x - margin_m)
    left = min(max(cosine * y - sine * x, low_y + margin_m), high_y - margin_m)
    return np.array([foot.x + cosine * ahead - sine * left, foot.y + sine * ahead + cosine * left])


@lru_cache(maxsize=16)
def _sides(sole: bytes) -> tuple[float, float, float, float]:
    """Return the least and the largest x and y of the corners of a sole: least x, least y, and the others."""
    corners = np.frombuffer(sole, dtype=np.float64).reshape(-1, 2)
    (low_x, low_y), (high_x, high_y) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    return low_x, low_y, high_x, high_y


def shares(
    feet: Mapping[Side, Footprint], sole: Array, zmp: Array, margin_m: float
) -> dict[Side, tuple[float, Array]]:
    """Return for each standing foot its share of the weight and its centre of pressure (2,)."""
    if len(feet) == 1:
        ((name, foot),) = feet.items()
        return {name: (1.0, nearest_in_sole(foot, sole, zmp, margin_m))}
    (first_side, first), (second_side, second) = feet.items()
    (start_x, start_y), (end_x, end_y) = _middle(first, sole), _middle(second, sole)
    line_x, line_y = end_x - start_x, end_y - start_y
    x, y = zmp.tolist()
    along = (x - start_x) * line_x + (y - start_y) * line_y
    share = min(max(along / (line_x * line_x + line_y * line_y), 0.0), 1.0)
    off_x, off_y = x - (start_x + share * line_x), y - (start_y + share * line_y)
    points = [
        nearest_in_sole(foot, sole, (middle_x + off_x, middle_y + off_y), margin_m)
        for foot, middle_x, middle_y in ((first, start_x, start_y), (second, end_x, end_y))
    ]
    return {first_side: (1.0 - share, points[0]), second_side: (share, points[1])}


def _middle(foot: Footprint, sole: Array) -> tuple[float, float]:
    """Return where the middle of a rectangular sole is on the ground."""
    cosine, sine = math.cos(foot.yaw), math.sin(foot.yaw)
    low_x, low_y, high_x, high_y = _sides(sole.tobytes())
    x, y = (low_x + high_x) / 2, (low_y + high_y) / 2
    return foot.x + cosine * x - sine * y, foot.y + sine * x + cosine * y


@dataclass(frozen=True, slots=True)
class Needed:
    """What a motion needs: torques of the joints without contact, and the wrench of the ground on the robot.

    `force` (3,) in N, `zmp` (2,) in m where it has no horizontal moment, `yaw_moment` in N m there.
    """

    torques: Array
    force: Array
    zmp: Array
    yaw_moment: float


class FeedForward:
    """Joint torques for a motion and the forces of the feet; reads an updated `Kinematics`."""

    def __init__(self, kinematics: Kinematics) -> None:
        self._kinematics = kinematics
        self._damping = kinematics.joint_damping()
        self._drive_inertia = kinematics.humanoid.drive_inertia

    def needed(self, velocity: Array, acceleration: Array, shift: Array) -> Needed:
        """Return what a velocity and an acceleration (n_velocities,) of the reference need.

        `shift` (3,) in m/s² is what the stabiliser adds to the acceleration of the whole body. The wrench has
        the moment that swinging limbs need, which the pendulum of the plan does not know.
        """
        kinematics = self._kinematics
        forces = kinematics.inverse_dynamics(velocity, acceleration, shift + UPWARDS)
        base = kinematics.pose(kinematics.humanoid.root)
        force = base.rotation @ forces[:3]
        moment = base.rotation @ forces[3:BASE_VELOCITIES] + cross(base.translation, force)
        (x, y, z), (around_x, around_y, around_z) = force.tolist(), moment.tolist()
        zmp_x, zmp_y = -around_y / max(z, 1.0), around_x / max(z, 1.0)
        torques = forces[BASE_VELOCITIES:] + self._drive_inertia * acceleration[BASE_VELOCITIES:]
        return Needed(torques, force, np.array([zmp_x, zmp_y]), around_z - (zmp_x * y - zmp_y * x))

    def torques(self, needed: Needed, forces: Mapping[str, tuple[float, Array]], velocity: Array) -> Array:
        """Return the torques of the joints in N m.

        `forces` has for each link on the ground its share of the force and its centre of pressure (2,). The
        known damping of the joints is compensated.
        """
        needed_torques = self._damping * velocity[BASE_VELOCITIES:]
        needed_torques += needed.torques
        x, y, z = needed.force.tolist()
        for link, (share, point) in forces.items():
            (point_x, point_y), (at_x, at_y, at_z) = (
                point.tolist(),
                self._kinematics.pose(link).translation.tolist(),
            )
            a, b, c = point_x - at_x, point_y - at_y, -at_z
            around = (b * z - c * y, c * x - a * z, a * y - b * x + needed.yaw_moment)
            wrench = share * np.array([x, y, z, *around])
            needed_torques -= self._kinematics.joint_torques(link, wrench)
        return np.asarray(needed_torques)

    def write(
        self,
        command: JointCommand,
        q: Array,
        velocity: Array,
        needed: Needed,
        forces: Mapping[str, tuple[float, Array]],
    ) -> None:
        """Write positions and velocities of the reference, and the torques for it, into a command."""
        command.positions[:] = q[BASE_POSITIONS:]
        command.velocities[:] = velocity[BASE_VELOCITIES:]
        command.torques[:] = self.torques(needed, forces, velocity)
