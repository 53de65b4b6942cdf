"""A simulated humanoid: the `Robot` component on MuJoCo, with pushes, sensor noise and, for tests, the truth.

With the same model, seed and commands the motion is the same, bit by bit. Not thread-safe.
"""

import math
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from handover.errors import UsageError
from handover.runtime.control_cycle import runs_in_cycle
from handover_humanoid.components.robot import JointCommand, RobotSensors
from handover_humanoid.model.humanoid import Humanoid, JointMode
from handover_humanoid.model.kinematics import BASE_POSITIONS, BASE_VELOCITIES, Array
from handover_humanoid.simulation.body_model import FREE_JOINT, STEP_S, build

QUATERNION_XYZW = np.array([1, 2, 3, 0])


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """Standard deviations of the noise of a sample; the bias of the gyroscope is drawn once."""

    position_rad: float = 0.0
    velocity_radps: float = 0.0
    gyroscope_radps: float = 0.0
    gyroscope_bias_radps: float = 0.0
    accelerometer_mps2: float = 0.0
    force_n: float = 0.0
    torque_nm: float = 0.0


QUIET = SensorNoise()
TYPICAL_NOISE = SensorNoise(1e-4, 0.01, 0.005, 0.001, 0.05, 1.0, 0.05)
"""Figures of encoders, inertial and force-torque sensors as humanoids have them."""


class SimulatedRobot:
    """A humanoid in MuJoCo, which stands at `q` (base and joints, as in `Kinematics`) at rest.

    It has the modes of its model.
    """

    is_simulated, delay_s = True, 0.0

    def __init__(
        self, humanoid: Humanoid, q: Array, noise: SensorNoise = QUIET, seed: int = 0, model: Any = None
    ) -> None:
        self.humanoid, self.modes = humanoid, humanoid.modes
        self.period_s = STEP_S
        servo = [joint.servo or joint.gains for joint in humanoid.joints]
        self._servo_stiffness = np.array([gains.stiffness for gains in servo])
        self._servo_damping = np.array([gains.damping for gains in servo])
        self._target, self._stiffness, self._zeros = np.zeros((3, len(servo)))
        self.model = build(humanoid) if model is None else model
        self._data = mujoco.MjData(self.model)
        self._noise, self._random = noise, np.random.default_rng(seed)
        self._bias = self._random.normal(scale=noise.gyroscope_bias_radps, size=3)
        self._gyroscope_at, wrench = 2 * len(humanoid.joints), [noise.force_n] * 3 + [noise.torque_nm] * 3
        of_joints = [
            [deviation] * len(humanoid.joints) for deviation in (noise.position_rad, noise.velocity_radps)
        ]
        inertial = [[noise.gyroscope_radps] * 3, [noise.accelerometer_mps2] * 3]
        self._deviations = np.concatenate(
            [*of_joints, *inertial, *[wrench] * len(humanoid.sensors.force_torque)]
        )
        model = self.model
        joints = [model.joint(name) for name in humanoid.joint_names]
        self._q_of = np.array([joint.qposadr[0] for joint in joints])
        self._v_of = np.array([joint.dofadr[0] for joint in joints])
        if model.joint(FREE_JOINT).qposadr[0] != 0:
            raise UsageError(f"the base of {humanoid.name} is not the first joint of its model")
        self._push_until_s, self._pushed = -np.inf, np.zeros(6)
        self._root = model.body(humanoid.root).id
        self._bodies = {link: model.body(link).id for link in humanoid.links if _has_body(model, link)}
        data = self._data
        # Views of what MuJoCo keeps in place: each access to an attribute of it makes a new array.
        self._qpos, self._qvel, self._ctrl = data.qpos, data.qvel, data.ctrl
        self._efforts, self._sensed, self._forces = data.actuator_force, data.sensordata, data.xfrc_applied
        self._gain, self._bias_of_q = model.actuator_gainprm[:, 0], model.actuator_biasprm[:, 1]
        self._bias_of_v = model.actuator_biasprm[:, 2]
        if not humanoid.sensors.inertial:
            raise UsageError(f"{humanoid.name} has no inertial sensor; add it to the group imu_sensors")
        self._wrenches_at = 6 * len(humanoid.sensors.inertial)
        self.place(q)

    def place(self, q: Array) -> None:
        """Put the robot at rest in a configuration, with its drives set to hold it."""
        mujoco.mj_resetData(self.model, self._data)
        self._data.qpos[:3], self._data.qpos[3:7] = q[:3], np.roll(q[3:7], 1)
        self._data.qpos[self._q_of] = q[BASE_POSITIONS:]
        self._data.ctrl[:] = q[BASE_POSITIONS:]
        mujoco.mj_forward(self.model, self._data)

    @runs_in_cycle
    def read(self, sensors: RobotSensors) -> None:
        """Write the present measurements into `sensors`."""
        sensed, noise = self._sensed, self._noise
        sensors.time_s = self._data.time
        self._qpos.take(self._q_of, out=sensors.positions, mode="clip")
        self._qvel.take(self._v_of, out=sensors.velocities, mode="clip")
        sensors.torques[:] = self._efforts
        sensors.gyroscope[:], sensors.accelerometer[:] = sensed[:3], sensed[3:6]
        sensors.wrenches.ravel()[:] = sensed[self._wrenches_at :]
        sensors.wrenches *= -1.0  # MuJoCo: what the limb exerts on the world
        if noise is not QUIET:
            self._disturb(sensors)

    @runs_in_cycle
    def write(self, command: JointCommand) -> None:
        """Set the drives. Raises `ValueError` for a command that it cannot follow; the last one holds."""
        if command.mode not in self.modes:
            raise ValueError(f'{self.humanoid.name} has no mode "{command.mode}" of joints')
        target, stiffness, damping = self._target, self._servo_stiffness, self._servo_damping
        if command.mode is JointMode.IMPEDANCE:
            damping = command.damping
            stiffness = np.maximum(command.stiffness, 1e-6, out=self._stiffness)
            np.multiply(damping, command.velocities, out=target)
            target += command.torques
            target /= stiffness
            target += command.positions
        else:
            target[:] = command.positions if command.mode is JointMode.POSITION else command.torques
        if not math.isfinite(target.dot(self._zeros)):  # 0 times infinity is not a number
            raise ValueError("the command has a value that is not finite; the drives keep the last one")
        self._ctrl[:] = target
        if command.mode is JointMode.TORQUE:
            self._gain[:], self._bias_of_q[:], self._bias_of_v[:] = 1.0, 0.0, 0.0
            return
        self._gain[:] = stiffness
        np.negative(stiffness, out=self._bias_of_q)
        np.negative(damping, out=self._bias_of_v)

    def wait(self) -> None:
        """Simulate one period."""
        self._forces[self._root] = self._pushed if self._push_until_s > self._data.time else 0.0
        mujoco.mj_step(self.model, self._data)

    def close(self) -> None:
        """Nothing is left open."""

    def push(self, impulse_ns: Array, duration_s: float = 0.1) -> None:
        """Push the root link with an impulse (3,) in N s, as a constant force from now on."""
        self._pushed[:3] = np.asarray(impulse_ns) / duration_s
        self._push_until_s = self._data.time + duration_s - STEP_S / 2

    def pull(self, link: str, force: Array) -> None:
        """Pull at a link with a force (3,) in N in the frame of the root link, until the next call."""
        rotation = self._data.xmat[self._root].reshape(3, 3)
        self._forces[self._bodies[link], :3] = rotation @ force

    @property
    def time_s(self) -> float:
        """Return the simulated time."""
        return float(self._data.time)

    @property
    def height_m(self) -> float:
        """Return the true height of the base; for tests and pictures, not for control."""
        return float(self._data.qpos[2])

    def true_configuration(self) -> Array:
        """Return the configuration, base and joints; for tests and pictures, not for control."""
        base = self._data.qpos[:BASE_POSITIONS]
        return np.concatenate([base[:3], base[3:7][QUATERNION_XYZW], self._data.qpos[self._q_of]])

    def true_velocity(self) -> Array:
        """Return the velocity, with that of the base in its own frame; for tests, not for control."""
        rotation = self._data.xmat[self._root].reshape(3, 3)
        base = self._data.qvel[:BASE_VELOCITIES]
        return np.concatenate([rotation.T @ base[:3], base[3:], self._data.qvel[self._v_of]])

    def _disturb(self, sensors: RobotSensors) -> None:
        noise = self._random.standard_normal(len(self._deviations))
        noise *= self._deviations
        noise[self._gyroscope_at : self._gyroscope_at + 3] += self._bias
        end = 0
        for part in (sensors.positions, sensors.velocities, sensors.gyroscope, sensors.accelerometer):
            np.add(part, noise[end : end + len(part)], out=part)
            end += len(part)
        sensors.wrenches += noise[end:].reshape(sensors.wrenches.shape)


def _has_body(model: Any, link: str) -> bool:
    return bool(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, link) >= 0)
