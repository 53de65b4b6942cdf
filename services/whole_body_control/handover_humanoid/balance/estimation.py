"""State estimation without a view of the world: leg odometry with an inertial sensor.

Roll and pitch integrate the gyroscope, and follow the accelerometer slowly (a complementary filter after
Mahony 2008, with an estimate of the bias). Feet that carry weight do not move: the velocity of the base is
what keeps the centres of pressure still, weighted by the force on each foot. A foot that lands or rolls does
move a little, so this velocity is smoothed over `LEGS_S`, and what changes faster is the accelerometer's. The
sensor may be on a torso that moves on the root. A robot that leans at the first sample, as one does that was
held by its drives, starts with the tilt of the accelerometer. The position integrates the velocity, and
follows the places where the feet came to stand, so that it does not drift while they stand. The ground is
flat, at height 0. Yaw and position on the ground have no reference, and drift with the steps.

What a period computes of each foot is in plain numbers: an operation of numpy on three of them takes as long
as twenty of Python.
"""

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from handover.errors import UsageError
from handover.runtime.control_cycle import runs_in_cycle
from handover_humanoid.components.robot import RobotSensors
from handover_humanoid.model.kinematics import (
    BASE_POSITIONS,
    BASE_VELOCITIES,
    DOWNWARDS,
    GRAVITY_MPS2,
    Array,
    Kinematics,
    cross,
    quaternion,
)

TILT_GAIN, BIAS_GAIN = 0.4, 0.02
"""How fast the tilt follows the accelerometer in 1/s, and the bias of the gyroscope in 1/s²."""
LEGS_S = 0.04
"""The time constant with which the velocity of the base follows the legs."""
MAX_ACCELERATION_MPS2, MAX_SLIP_MPS = 6.0, 0.1
"""A shock does not last a whole period; where the legs differ by more than this, a foot lands or slips."""
ANCHOR_GAIN = 10.0
"""How fast the position follows the places of the standing feet, in 1/s."""
MIN_CONTACT_N = 30.0
"""A foot with less force does not stand."""
MAX_SHAKE_MPS2 = 3.0
LEANS_RAD, MAX_LEAN_RAD = 0.015, 0.3
"""More than what the noise of one sample looks like, and less than what is no lean but a fall."""
REST_MPS2, REST_RADPS = 0.3, 0.1
UP = np.array([0.0, 0.0, 1.0])


@dataclass
class FootState:
    """A foot: its sole, the force on it in N, the centre of pressure (2,) in the frame of the sole in m."""

    link: str
    sensor_row: int
    to_sole: Array
    weight_below_n: float
    corners: Array
    force_n: float = 0.0
    share: float = 0.5
    """The share of the weight that it carries."""

    def __post_init__(self) -> None:
        self.middle = self.corners.mean(axis=0)
        self.pressure = self.middle[:2].copy()
        self.anchor = np.zeros(3)
        self.sideways_n = (0.0, 0.0)
        self.is_standing = False
        self._offset = tuple(self.to_sole.tolist())
        (self._low_x, self._low_y), (self._high_x, self._high_y) = (
            self.corners[:, :2].min(axis=0).tolist(),
            self.corners[:, :2].max(axis=0).tolist(),
        )

    def measure(self, wrench: Array) -> None:
        """Take the wrench (6,) that the ground exerts on the limb, in the frame of the sensor."""
        x, y, z, around_x, around_y, _ = wrench.tolist()
        self.force_n = max(z + self.weight_below_n, 0.0)
        self.is_standing = self.force_n > MIN_CONTACT_N
        self.sideways_n = (x, y)
        if self.is_standing:
            (a, b, c), down = self._offset, z or 1e-9
            ahead, left = -(around_y - (c * x - a * z)) / down, (around_x - (b * z - c * y)) / down
            self.pressure[0] = min(max(ahead, self._low_x), self._high_x)
            self.pressure[1] = min(max(left, self._low_y), self._high_y)


class StateEstimator:
    """Estimates base, velocities, centre of mass and feet; starts at rest at `q`. Not thread-safe.

    `kinematics` is updated with the estimate, and belongs to it.
    """

    def __init__(self, kinematics: Kinematics, q: Array) -> None:
        self.kinematics = kinematics
        humanoid = kinematics.humanoid
        self.q, self.v = q.copy(), np.zeros(kinematics.n_velocities)
        self._rotation = pin.Quaternion(q[3:7]).toRotationMatrix()
        self._position = q[:3].copy()
        self._bias, self._has_begun = np.zeros(3), False
        self._feet_frame: Array | None = None
        """Of the present state, once it is known."""
        kinematics.update(q)
        self._inertial = humanoid.sensors.inertial[0]
        self._is_inertial_on_root = kinematics.is_on_root(self._inertial)
        self._place_inertial()
        self._velocity = np.zeros(3)
        """Of the inertial sensor, on the ground."""
        self.feet = {
            name: _foot(kinematics, contact.link, np.array(contact.corners))
            for name, contact in humanoid.contacts.items()
        }
        for foot in self.feet.values():
            foot.anchor = np.array(kinematics.pose(foot.link).translation)
            foot.is_standing = True
        self.com, self.com_velocity = kinematics.centre_of_mass(), np.zeros(3)

    def take_tilt(self, other: "StateEstimator") -> None:
        """Take roll, pitch and the bias of the gyroscope from another estimator of the same robot."""
        yaw_here, yaw_there = _yaw(self._rotation), _yaw(other._rotation)
        self._rotation = pin.exp3(np.array([0.0, 0.0, yaw_here - yaw_there])) @ other._rotation
        self._bias, self._feet_frame = other._bias.copy(), None

    def feet_frame(self) -> Array:
        """Return place (2,) and yaw of the frame between the soles: x ahead, y to the left."""
        if self._feet_frame is None:
            places, yaw, own_yaw = np.zeros(2), 0.0, _yaw(self._rotation)
            for foot in self.feet.values():
                pose = self.kinematics.pose(foot.link)
                places += (pose.translation + pose.rotation @ foot.middle)[:2]
                yaw += math.remainder(_yaw(pose.rotation) - own_yaw, 2 * math.pi)
            count = len(self.feet)
            self._feet_frame = np.array([*(places / count), own_yaw + yaw / count])
        return self._feet_frame.copy()

    @property
    def rotation(self) -> Array:
        """Return the orientation (3, 3) of the base."""
        return np.asarray(self._rotation)

    @runs_in_cycle
    def update(self, sensors: RobotSensors, dt_s: float) -> None:
        """Compute the state of `dt_s` after the last one."""
        self.q[BASE_POSITIONS:] = sensors.positions
        self.v[BASE_VELOCITIES:] = sensors.velocities
        if not self._is_inertial_on_root:
            self._place_inertial()
        spin = self._turn(sensors, dt_s)
        self._feet_frame = None
        self._measure_feet(sensors)
        self.q[:3] = self._position
        self.q[3:BASE_POSITIONS] = quaternion(self._rotation)
        self.v[:3] = 0.0
        self.v[3:BASE_VELOCITIES] = spin
        self.kinematics.update(self.q, self.v)
        walked, correction = self._walked()
        velocity = self._fused(walked, sensors, spin, dt_s)
        step = (velocity + ANCHOR_GAIN * correction) * dt_s
        self._position += step
        self.q[:3] = self._position
        self.v[:3] = self._rotation.T @ velocity
        self.com = self.kinematics.centre_of_mass() + step
        self.com_velocity = self.kinematics.centre_of_mass_velocity() + velocity
        self._anchor(step)

    def sole(self, name: str) -> Array:
        """Return the place (3,) of the origin of a sole."""
        return np.array(self.kinematics.pose(self.feet[name].link).translation)

    def velocity_of(self, link: str) -> Array:
        """Return the velocity (3,) of a link on the ground, in m/s."""
        return np.asarray(self.kinematics.velocity(link)[:3] + self._rotation @ self.v[:3])

    @property
    def centre_of_pressure(self) -> Array:
        """Return the measured centre of pressure (2,) on the ground; not finite while no foot stands."""
        points = sum((foot.share * self._point(foot)[:2] for foot in self.feet.values()), np.zeros(2))
        return points if any(foot.is_standing for foot in self.feet.values()) else np.full(2, np.nan)

    def force_of(self, foot: FootState) -> Array:
        """Return the force (3,) of the ground on a foot in N: across the sole as measured, in its frame."""
        return np.array([*foot.sideways_n, foot.force_n])

    def pressure_of(self, foot: FootState) -> Array:
        """Return the centre of pressure (2,) of a foot on the ground in m; NaN while it does not stand."""
        return self._point(foot)[:2] if foot.is_standing else np.full(2, np.nan)

    def _place_inertial(self) -> None:
        """Find where the inertial sensor is on the root; joints of a torso may be between them."""
        pose, velocity = self.kinematics.from_root(self.q, self.v, self._inertial)
        self._of_inertial, self._to_inertial = pose.rotation.copy(), pose.translation.copy()
        self._inertial_speed, self._inertial_spin = velocity[:3], velocity[3:]

    def _turn(self, sensors: RobotSensors, dt_s: float) -> Array:
        """Integrate the gyroscope and return the angular velocity of the base in its own frame."""
        spin = self._of_inertial @ sensors.gyroscope - self._inertial_spin - self._bias
        force = self._of_inertial @ sensors.accelerometer
        strength = math.sqrt(force.dot(force))
        if not self._has_begun:
            self._has_begun = True
            is_at_rest = abs(strength - GRAVITY_MPS2) < REST_MPS2 and spin @ spin < REST_RADPS**2
            self._lean(force / max(strength, 1e-9), is_at_rest=is_at_rest)
        corrected = spin
        if abs(strength - GRAVITY_MPS2) < MAX_SHAKE_MPS2:
            error = cross(force / strength, self._rotation[2])
            corrected = spin + TILT_GAIN * error
            self._bias -= BIAS_GAIN * dt_s * error
        self._rotation = self._rotation @ pin.exp3(corrected * dt_s)
        return np.asarray(spin)

    def _lean(self, upwards: Array, *, is_at_rest: bool) -> None:
        """Turn the start so that `upwards` (3,), in the frame of the base, points up, if it is far off."""
        measured = self._rotation @ upwards
        turn = cross(measured, UP)
        sine = float(np.linalg.norm(turn))
        angle = float(np.arctan2(sine, measured[2]))
        if is_at_rest and LEANS_RAD < angle < MAX_LEAN_RAD:
            self._rotation = pin.exp3(turn * (angle / sine)) @ self._rotation

    def _measure_feet(self, sensors: RobotSensors) -> None:
        total = 0.0
        for foot in self.feet.values():
            foot.measure(sensors.wrenches[foot.sensor_row])
            total += foot.force_n if foot.is_standing else 0.0
        for foot in self.feet.values():
            foot.share = foot.force_n / total if foot.is_standing else 0.0

    def _point(self, foot: FootState) -> Array:
        """Return the centre of pressure (3,) in the world."""
        pose = self.kinematics.pose(foot.link)
        return np.asarray(pose.translation + pose.rotation[:, :2] @ foot.pressure)

    def _walked(self) -> tuple[Array, Array]:
        """Return the velocity (3,) of the base, and its distance (3,) from where the feet put it."""
        x = y = z = away_x = away_y = away_z = 0.0
        for foot in self.feet.values():
            if not foot.share:
                continue
            share, (ahead, left) = foot.share, foot.pressure.tolist()
            pose = self.kinematics.pose(foot.link)
            (xx, xy, _), (yx, yy, _), (zx, zy, _) = pose.rotation.tolist()
            arm_x, arm_y, arm_z = xx * ahead + xy * left, yx * ahead + yy * left, zx * ahead + zy * left
            moving_x, moving_y, moving_z, a, b, c = self.kinematics.velocity(foot.link).tolist()
            x -= share * (moving_x + b * arm_z - c * arm_y)
            y -= share * (moving_y + c * arm_x - a * arm_z)
            z -= share * (moving_z + a * arm_y - b * arm_x)
            for_x, for_y, for_z = (foot.anchor - pose.translation).tolist()
            away_x, away_y, away_z = away_x + share * for_x, away_y + share * for_y, away_z + share * for_z
        return np.array([x, y, z]), np.array([away_x, away_y, away_z])

    def _fused(self, walked: Array, sensors: RobotSensors, spin: Array, dt_s: float) -> Array:
        """Return the velocity (3,) of the base, with what the legs say of it."""
        rotation = self._rotation
        acceleration = rotation @ (self._of_inertial @ sensors.accelerometer) + DOWNWARDS
        arm = rotation @ (cross(spin, self._to_inertial) + self._inertial_speed)
        self._velocity += dt_s * _limited(acceleration, MAX_ACCELERATION_MPS2)
        if any(foot.share for foot in self.feet.values()):
            self._velocity += min(dt_s / LEGS_S, 1.0) * _limited(walked + arm - self._velocity, MAX_SLIP_MPS)
        return np.asarray(self._velocity - arm)

    def _anchor(self, step: Array) -> None:
        """Keep the places of standing feet; those that come to stand do so on the ground where they are."""
        for foot in self.feet.values():
            if foot.share < 0.3:
                foot.anchor = self.kinematics.pose(foot.link).translation + step
                foot.anchor[2] = 0.0


def _limited(vector: Array, most: float) -> Array:
    return np.minimum(np.maximum(vector, -most), most)


def _yaw(rotation: Array) -> float:
    return math.atan2(rotation[1, 0], rotation[0, 0])


def _foot(kinematics: Kinematics, link: str, corners: Array) -> FootState:
    """Return a foot with the force-torque sensor above it. Raises `UsageError` without one."""
    humanoid = kinematics.humanoid
    sole = kinematics.pose(link)
    chain = next((leg for leg in humanoid.chains.values() if leg.tip == link), None)
    sensors = list(humanoid.sensors.force_torque.items())
    joint_id = kinematics.pin_model.getJointId(chain.joints[-1]) if chain else None
    for row, (_, sensor) in enumerate(sensors):
        frame = kinematics.pin_model.frames[kinematics.pin_model.getFrameId(sensor)]
        if frame.parentJoint == joint_id:
            offset = kinematics.pose(sensor).actInv(sole).translation
            mass_kg = kinematics.pin_model.inertias[joint_id].mass
            return FootState(link, row, np.array(offset), mass_kg * GRAVITY_MPS2, corners)
    raise UsageError(
        f'{humanoid.name} has no force-torque sensor at "{link}", at the tip of a chain; balance needs one'
    )
