"""The simulation of a cell: steps of 2 ms with a joint servo, a gripper, loose parts and sensors.

The servo is computed torque: the inertia of the arm times the wanted acceleration, plus gravity and Coriolis
forces, with feedback of position and velocity. Between two commands the motion is extrapolated from the last
one. The servo does not know the load, and torques end at the limits of the drives, so the arm sags and is
blocked like a real one.

With the same seed, commands and steps the result is the same, bit by bit. All methods are thread-safe.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from threading import RLock
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from services.trajectory_tool.physics.world_model import CAMERA_GROUP, STEP_S, WorldModel, parked_at
from services.trajectory_tool.poses import Frame, Pose
from services.trajectory_tool.robot import Joints
from services.trajectory_tool.trajectory import Setpoint

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

_STATE = (
    mujoco.mjtState.mjSTATE_FULLPHYSICS | mujoco.mjtState.mjSTATE_WARMSTART | mujoco.mjtState.mjSTATE_CTRL
)


_VISIBLE = np.array([group != CAMERA_GROUP for group in range(mujoco.mjNGROUP)], dtype=np.uint8)


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


class Simulation:
    """The state of a simulated cell; it starts at rest at `joints`, with the fingers at `opening`."""

    def __init__(self, world: WorldModel, joints: Joints, opening: float = 0.0) -> None:
        self.world = world
        self.lock = RLock()
        self._model = model = world.mujoco
        self._data = mujoco.MjData(model)
        self._q = np.array([model.joint(name).qposadr[0] for name in world.joints])
        self._v = np.array([model.joint(name).dofadr[0] for name in world.joints])
        self._drives = np.array([model.actuator(name).id for name in world.joints])
        self._torque_limits = model.actuator_ctrlrange[self._drives, 1].copy()
        self._finger_q = np.array([model.joint(name).qposadr[0] for name in world.fingers], dtype=np.int64)
        self._finger_v = np.array([model.joint(name).dofadr[0] for name in world.fingers], dtype=np.int64)
        self._finger_drives = np.array([model.actuator(name).id for name in world.fingers], dtype=np.int64)
        self._finger_geoms = [_geoms_of_joint(model, name) for name in world.fingers]
        self._parts = [model.body(name).id for name in world.parts]
        self._part_q = [model.joint(name).qposadr[0] for name in world.parts]
        self._part_v = [model.joint(name).dofadr[0] for name in world.parts]
        self._part_of_geom = {int(model.geom(name).id): number for number, name in enumerate(world.parts)}
        self._tip = model.site("tip").id
        self._acceleration = np.zeros(model.nv)
        self._torque = np.zeros(model.nv)
        self._command = Setpoint.at_rest(joints)
        self._commanded_s = 0.0
        self._finger_target = opening
        self._finger_speed = 0.1
        self._stalled = 0
        self.blocked: Blocked | None = None
        """Set when the arm was blocked; it holds its position until the next command after `unblock`."""
        self._data.qpos[self._q] = joints
        self._data.qpos[self._finger_q] = opening
        mujoco.mj_forward(model, self._data)

    @property
    def time_s(self) -> float:
        """Return the simulated time."""
        return float(self._data.time)

    @property
    def positions(self) -> Joints:
        """Return the joint positions."""
        with self.lock:
            return tuple(self._data.qpos[self._q].tolist())

    @property
    def velocities(self) -> Joints:
        """Return the joint velocities."""
        with self.lock:
            return tuple(self._data.qvel[self._v].tolist())

    @property
    def torques(self) -> Joints:
        """Return the measured torques of the drives: Nm, of prismatic joints N."""
        with self.lock:
            return tuple(self._data.actuator_force[self._drives].tolist())

    @property
    def finger_position(self) -> float:
        """Return the position of the first finger, in m."""
        with self.lock:
            return float(self._data.qpos[self._finger_q[0]]) if len(self._finger_q) else 0.0

    @property
    def tool(self) -> Frame:
        """Return the frame of the tip of the tool."""
        with self.lock:
            return _frame(self._data.site_xmat[self._tip], self._data.site_xpos[self._tip])

    @property
    def wrench(self) -> Wrench:
        """Return the force and torque at the wrist."""
        with self.lock:
            force = self._data.sensor("wrist_force").data.tolist()
            torque = self._data.sensor("wrist_torque").data.tolist()
        return Wrench((force[0], force[1], force[2]), (torque[0], torque[1], torque[2]))

    def command(self, setpoint: Setpoint) -> None:
        """Set what the servo follows from now on."""
        with self.lock:
            self._command, self._commanded_s = setpoint, self._data.time

    def unblock(self) -> None:
        """Hold the present position after the arm was blocked."""
        with self.lock:
            self.blocked = None
            self.command(Setpoint.at_rest(self.positions))

    def move_fingers(self, target: float, speed_mps: float) -> None:
        """Open or close the gripper; it pushes with its full force where something is in the way."""
        with self.lock:
            self._finger_target, self._finger_speed, self._stalled = target, speed_mps, 0

    @property
    def are_fingers_at_rest(self) -> bool:
        """Return whether the fingers have stopped: at their target or at a part."""
        return self._stalled >= STALLED_STEPS

    def step(self, count: int = 1) -> None:
        """Simulate `count` steps of `STEP_S`."""
        with self.lock:
            for _ in range(count):
                mujoco.mj_step1(self._model, self._data)
                self._drive()
                mujoco.mj_step2(self._model, self._data)

    def step_for(self, seconds: float) -> None:
        """Simulate a time."""
        self.step(round(seconds / STEP_S))

    def _drive(self) -> None:
        data, command = self._data, self._command
        since_s = data.time - self._commanded_s
        position, velocity = np.array(command.positions), np.array(command.velocities)
        acceleration = np.array(command.accelerations)
        if since_s <= MAX_EXTRAPOLATION_S:
            position += velocity * since_s + acceleration * (0.5 * since_s * since_s)
            velocity += acceleration * since_s
        else:
            position += velocity * MAX_EXTRAPOLATION_S
            velocity[:] = acceleration[:] = 0.0
        error = position - data.qpos[self._q]
        if np.abs(error).max() > MAX_TRACKING_ERROR:
            worst = int(np.abs(error).argmax())
            self.blocked = self.blocked or Blocked(self.world.joints[worst], float(error[worst]))
            self._command = Setpoint.at_rest(tuple(data.qpos[self._q].tolist()))
            self._commanded_s = data.time
        acceleration += SERVO_RAD_S**2 * error + 2 * SERVO_RAD_S * (velocity - data.qvel[self._v])
        self._acceleration[self._v] = acceleration
        mujoco.mj_mulM(self._model, data, self._torque, self._acceleration)
        wanted = self._torque[self._v] + data.qfrc_bias[self._v]
        data.ctrl[self._drives] = np.clip(wanted, -self._torque_limits, self._torque_limits)
        if len(self._finger_q):
            left = self._finger_target - data.qpos[self._finger_q]
            data.ctrl[self._finger_drives] = np.clip(
                FINGER_GAIN * left, -self._finger_speed, self._finger_speed
            )
            is_still = np.abs(data.qvel[self._finger_v]).max() < STALLED_MPS
            self._stalled = self._stalled + 1 if is_still else 0

    def gripped_part(self) -> int | None:
        """Return the number of the part that all fingers touch; None without one."""
        with self.lock:
            touching: list[set[int]] = [set() for _ in self._finger_geoms]
            for one, other in self._data.contact.geom.tolist():
                for geom, against in ((one, other), (other, one)):
                    part = self._part_of_geom.get(against)
                    if part is None:
                        continue
                    for finger, geoms in zip(touching, self._finger_geoms, strict=True):
                        if geom in geoms:
                            finger.add(part)
            common = set.intersection(*touching) if touching else set()
            return min(common) if common else None

    def part_pose(self, part: int) -> Pose:
        """Return the pose of a part."""
        with self.lock:
            body = self._parts[part]
            return Pose.of(_frame(self._data.xmat[body], self._data.xpos[body]))

    def part_speed_mps(self, part: int) -> float:
        """Return the speed of a part."""
        with self.lock:
            at = self._part_v[part]
            return float(np.linalg.norm(self._data.qvel[at : at + 3]))

    def is_parked(self, part: int) -> bool:
        """Return whether a part waits outside of the cell."""
        return bool(self._model.body_gravcomp[self._parts[part]] == 1.0)

    def park(self, part: int) -> None:
        """Take a part out of the cell."""
        self._set_part(part, parked_at(part), (1.0, 0.0, 0.0, 0.0), weightless=True)

    def put(self, part: int, pose: Pose) -> None:
        """Put a part at a pose, at rest; from then on it falls."""
        x, y, z, w = pose.orientation
        self._set_part(part, pose.position, (w, x, y, z), weightless=False)

    def push(self, part: int, velocity: Sequence[float], spin: Sequence[float]) -> None:
        """Set the velocity of a part in m/s and rad/s."""
        with self.lock:
            at = self._part_v[part]
            self._data.qvel[at : at + 6] = [*velocity, *spin]

    def set_friction(self, part: int, friction: float) -> None:
        """Set the sliding friction of a part; the pads of the fingers then have no more than that."""
        with self.lock:
            geom = self._model.geom(self.world.parts[part]).id
            self._model.geom_friction[geom, 0] = friction
            self._model.geom_priority[geom] = 2

    def settle(self, max_s: float = 4.0) -> None:
        """Simulate until all parts lie still."""
        for _ in range(math.ceil(max_s / 0.1)):
            self.step_for(0.1)
            if all(self.part_speed_mps(part) < 0.002 for part in range(len(self._parts))):
                return

    def cast_rays(self, origin: Array, directions: Array, cutoff_m: float) -> Array:
        """Return the distance along each direction of length 1, nan without a hit.

        The housings of cameras are transparent.
        """
        count = len(directions)
        hits = np.full(count, -1, dtype=np.int32)
        distances = np.zeros(count)
        with self.lock:
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_multiRay(
                self._model,
                self._data,
                origin,
                np.ascontiguousarray(directions).reshape(-1),
                _VISIBLE,
                True,
                -1,
                hits,
                distances,
                None,
                count,
                cutoff_m,
            )
        distances[hits < 0] = np.nan
        return distances

    def saved(self) -> dict[str, Any]:
        """Return the whole state as arrays."""
        with self.lock:
            state = np.zeros(mujoco.mj_stateSize(self._model, _STATE))
            mujoco.mj_getState(self._model, self._data, state, _STATE)
            return {
                "state": state,
                "parked": np.array([self.is_parked(part) for part in range(len(self._parts))]),
                "fingers": np.array([self._finger_target, self._finger_speed]),
            }

    def restore(self, saved: dict[str, Any]) -> bool:
        """Take over a saved state, at rest; return False for one of another model."""
        state = np.asarray(saved["state"], dtype=np.float64)
        if len(state) != mujoco.mj_stateSize(self._model, _STATE) or len(saved["parked"]) != len(self._parts):
            return False
        with self.lock:
            mujoco.mj_setState(self._model, self._data, state, _STATE)
            self._data.qvel[:] = 0.0
            for body, parked in zip(self._parts, saved["parked"], strict=True):
                self._model.body_gravcomp[body] = 1.0 if parked else 0.0
            self._finger_target, self._finger_speed = (float(value) for value in saved["fingers"])
            mujoco.mj_forward(self._model, self._data)
            self.command(Setpoint.at_rest(self.positions))
        return True

    def _set_part(
        self,
        part: int,
        position: Sequence[float],
        orientation: tuple[float, float, float, float],
        *,
        weightless: bool,
    ) -> None:
        with self.lock:
            at, v = self._part_q[part], self._part_v[part]
            self._data.qpos[at : at + 7] = [*position, *orientation]
            self._data.qvel[v : v + 6] = 0.0
            self._model.body_gravcomp[self._parts[part]] = 1.0 if weightless else 0.0
            mujoco.mj_forward(self._model, self._data)


def _geoms_of_joint(model: Any, joint: str) -> set[int]:
    body = int(model.joint(joint).bodyid[0])
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    return set(range(first, first + count))


def _frame(matrix: Array, position: Array) -> Frame:
    a, b, c, d, e, f, g, h, i = matrix.tolist()
    x, y, z = position.tolist()
    return Frame(((a, b, c), (d, e, f), (g, h, i)), (x, y, z))
