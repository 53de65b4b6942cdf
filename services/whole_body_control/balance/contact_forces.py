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

from services.whole_body_control.components.robot import JointCommand
from services.whole_body_control.model.kinematics import (
    BASE_POSITIONS,
    BASE_VELOCITIES,
    GRAVITY_MPS2,
    Array,
    Kinematics,
    cross,
)
from services.whole_body_control.patterns.regions import Footprint, Side, turn

UPWARDS = np.array([0.0, 0.0, GRAVITY_MPS2])


def nearest_in_sole(foot: Footprint, sole: Array, point: Array, margin_m: float) -> Array:
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
    (first, one), (second, other) = feet.items()
    low_x, low_y, high_x, high_y = _sides(sole.tobytes())
    centre = np.array([(low_x + high_x) / 2, (low_y + high_y) / 2])
    start, end = turn(one.yaw) @ centre + one.place, turn(other.yaw) @ centre + other.place
    line = end - start
    share = min(max(float((zmp - start) @ line / (line @ line)), 0.0), 1.0)
    offset = zmp - (start + share * line)
    points = [
        nearest_in_sole(foot, sole, middle + offset, margin_m)
        for foot, middle in ((one, start), (other, end))
    ]
    return {first: (1.0 - share, points[0]), second: (share, points[1])}


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
        zmp = np.array([-moment[1], moment[0]]) / max(force[2], 1.0)
        yaw_moment = moment[2] - (zmp[0] * force[1] - zmp[1] * force[0])
        torques = forces[BASE_VELOCITIES:] + self._drive_inertia * acceleration[BASE_VELOCITIES:]
        return Needed(torques, force, zmp, float(yaw_moment))

    def torques(self, needed: Needed, forces: Mapping[str, tuple[float, Array]], velocity: Array) -> Array:
        """Return the torques of the joints in N m.

        `forces` has for each link on the ground its share of the force and its centre of pressure (2,). The
        known damping of the joints is compensated.
        """
        kinematics, found = self._kinematics, needed.torques
        wrench = np.empty(6)
        for link, (share, point) in forces.items():
            pose = kinematics.pose(link)
            arm = np.array([*(point - pose.translation[:2]), -pose.translation[2]])
            wrench[:3], wrench[3:] = share * needed.force, share * cross(arm, needed.force)
            wrench[5] += share * needed.yaw_moment
            found = found - wrench @ kinematics.jacobian(link)[:, BASE_VELOCITIES:]
        return np.asarray(found + self._damping * velocity[BASE_VELOCITIES:])

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
