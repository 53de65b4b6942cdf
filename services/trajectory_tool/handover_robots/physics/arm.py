"""An arm of the simulation: its joint servo, its gripper and the sensors at its wrist.

The servo is computed torque: the inertia of the arm times the wanted acceleration, plus gravity and Coriolis
forces, with feedback of position and velocity. Between two commands the motion is extrapolated from the last
one. The servo does not know the load, and torques end at the limits of the drives, so the arm sags and is
blocked like a real one.
"""

from dataclasses import dataclass
from threading import RLock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handover.runtime.control_cycle import runs_in_cycle
from handover_robots.model.joints import Joints
from handover_robots.model.poses import Frame
from handover_robots.model.trajectory import Setpoint
from handover_robots.physics.robot_bodies import ArmNames

Array = NDArray[np.float64]

SERVO_RAD_S = 60.0
"""The bandwidth of the joint servo; it is critically damped."""

MAX_EXTRAPOLATION_S = 0.05
"""Without a new command for this time, the arm holds its position."""

MAX_TRACKING_ERROR = 0.05
"""A joint that is this far from its command, in rad or m, is blocked."""

FINGER_GAIN = 30.0
STALLED_MPS = 0.002
STALLED_STEPS = 20


@dataclass(frozen=True, slots=True)
class Wrench:
    """Force in N and torque in Nm that the tool exerts on the flange, in the axes of the tool."""

    force: tuple[float, float, float]
    torque: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Blocked:
    """A joint that did not follow its command, and by how much, in rad or m."""

    joint: str
    error: float


class SimulatedArm:
    """One arm in the state of a simulation, whose `lock` it uses; it starts at rest, opened, at `joints`."""

    def __init__(self, names: ArmNames, model: Any, data: Any, lock: RLock, joints: Joints) -> None:
        self._lock = lock
        self.use(names, model, data)
        self._command = Setpoint.at_rest(joints)
        self._commanded_s = 0.0
        self._finger_target = names.opened
        self._finger_speed = 0.1
        self._stalled = 0
        self.blocked: Blocked | None = None
        """Set when the arm was blocked; it holds its position until the next command after `unblock`."""
        self._data.qpos[self._q] = joints
        self._data.qpos[self._finger_q] = names.opened

    def use(self, names: ArmNames, model: Any, data: Any) -> None:
        """Continue in another model: find what the arm is made of."""
        self.names, self._data = names, data
        joints, fingers = names.joint_ids, names.finger_ids
        self._q = np.array([model.joint(name).qposadr[0] for name in joints])
        self._v = np.array([model.joint(name).dofadr[0] for name in joints])
        self._drives = np.array([model.actuator(name).id for name in joints])
        self._torque_limits = model.actuator_ctrlrange[self._drives, 1].copy()
        self._finger_q = np.array([model.joint(name).qposadr[0] for name in fingers], dtype=np.int64)
        self._finger_v = np.array([model.joint(name).dofadr[0] for name in fingers], dtype=np.int64)
        self._finger_drives = np.array([model.actuator(name).id for name in fingers], dtype=np.int64)
        self._finger_geoms = [_geoms_of_joint(model, name) for name in fingers]
        self._tip = model.site(names.tip_id).id

    @property
    def positions(self) -> Joints:
        """Return the joint positions."""
        with self._lock:
            return tuple(self._data.qpos[self._q].tolist())

    @property
    def velocities(self) -> Joints:
        """Return the joint velocities."""
        with self._lock:
            return tuple(self._data.qvel[self._v].tolist())

    @property
    def torques(self) -> Joints:
        """Return the measured torques of the drives: Nm, of prismatic joints N."""
        with self._lock:
            return tuple(self._data.actuator_force[self._drives].tolist())

    @property
    def finger_position(self) -> float:
        """Return the position of the first finger, in m."""
        with self._lock:
            return float(self._data.qpos[self._finger_q[0]]) if len(self._finger_q) else 0.0

    @property
    def tool(self) -> Frame:
        """Return the frame of the tip of the tool."""
        with self._lock:
            return frame_of(self._data.site_xmat[self._tip], self._data.site_xpos[self._tip])

    @property
    def wrench(self) -> Wrench:
        """Return the force and torque at the wrist."""
        with self._lock:
            force = self._data.sensor(self.names.force_id).data.tolist()
            torque = self._data.sensor(self.names.torque_id).data.tolist()
        return Wrench((force[0], force[1], force[2]), (torque[0], torque[1], torque[2]))

    @runs_in_cycle
    def command(self, setpoint: Setpoint) -> None:
        """Set what the servo follows from now on."""
        with self._lock:
            self._command, self._commanded_s = setpoint, self._data.time

    def place(self, joints: Joints) -> None:
        """Put the joints at rest at positions; no time passes."""
        with self._lock:
            self._data.qpos[self._q] = joints
            self._data.qvel[self._v] = 0.0
            self.command(Setpoint.at_rest(self.positions))

    def unblock(self) -> None:
        """Hold the present position after the arm was blocked."""
        with self._lock:
            self.blocked = None
            self.command(Setpoint.at_rest(self.positions))

    def move_fingers(self, target: float, speed_mps: float) -> None:
        """Open or close the gripper; it pushes with its full force where something is in the way."""
        with self._lock:
            self._finger_target, self._finger_speed, self._stalled = target, speed_mps, 0

    @property
    def are_fingers_at_rest(self) -> bool:
        """Return whether the fingers have stopped: at their target or at a part."""
        return self._stalled >= STALLED_STEPS

    @property
    def finger_command(self) -> tuple[float, float]:
        """Return the target and the speed of the fingers."""
        return self._finger_target, self._finger_speed

    def restore_fingers(self, command: tuple[float, float]) -> None:
        """Continue with a stored target and speed of the fingers."""
        self._finger_target, self._finger_speed = command

    @property
    def finger_shapes(self) -> set[int]:
        """Return the shapes of the fingers."""
        return set[int]().union(*self._finger_geoms)

    def touched(self) -> list[set[int]]:
        """Return for each finger the shapes that it touches."""
        with self._lock:
            touching: list[set[int]] = [set() for _ in self._finger_geoms]
            for first, second in self._data.contact.geom.tolist():
                for geom, against in ((first, second), (second, first)):
                    for finger, geoms in zip(touching, self._finger_geoms, strict=True):
                        if geom in geoms:
                            finger.add(against)
            return touching

    def want(self, acceleration: Array) -> None:
        """Enter the wanted acceleration of the joints into that of all joints; called in each step."""
        data, command = self._data, self._command
        since_s = data.time - self._commanded_s
        position, velocity = np.array(command.positions), np.array(command.velocities)
        wanted = np.array(command.accelerations)
        if since_s <= MAX_EXTRAPOLATION_S:
            position += velocity * since_s + wanted * (0.5 * since_s * since_s)
            velocity += wanted * since_s
        else:
            position += velocity * MAX_EXTRAPOLATION_S
            velocity[:] = wanted[:] = 0.0
        error = position - data.qpos[self._q]
        if np.abs(error).max() > MAX_TRACKING_ERROR:
            worst = int(np.abs(error).argmax())
            self.blocked = self.blocked or Blocked(self.names.joints[worst], float(error[worst]))
            self._command = Setpoint.at_rest(tuple(data.qpos[self._q].tolist()))
            self._commanded_s = data.time
        wanted += SERVO_RAD_S**2 * error + 2 * SERVO_RAD_S * (velocity - data.qvel[self._v])
        acceleration[self._v] = wanted

    def drive(self, torque: Array) -> None:
        """Command the drives: `torque` accelerates all joints as wanted; called in each step."""
        data = self._data
        wanted = torque[self._v] + data.qfrc_bias[self._v]
        data.ctrl[self._drives] = np.clip(wanted, -self._torque_limits, self._torque_limits)
        if len(self._finger_q):
            left = self._finger_target - data.qpos[self._finger_q]
            data.ctrl[self._finger_drives] = np.clip(
                FINGER_GAIN * left, -self._finger_speed, self._finger_speed
            )
            is_still = np.abs(data.qvel[self._finger_v]).max() < STALLED_MPS
            self._stalled = self._stalled + 1 if is_still else 0


def frame_of(matrix: Array, position: Array) -> Frame:
    """Return a frame from the arrays of MuJoCo."""
    a, b, c, d, e, f, g, h, i = matrix.tolist()
    x, y, z = position.tolist()
    return Frame(((a, b, c), (d, e, f), (g, h, i)), (x, y, z))


def _geoms_of_joint(model: Any, joint: str) -> set[int]:
    body = int(model.joint(joint).bodyid[0])
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    return set(range(first, first + count))
