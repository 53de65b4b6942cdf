"""The simulation of a cell: steps of 2 ms with the servos of all arms, grippers, loose parts and sensors.

With the same seed, commands and steps the result is the same, bit by bit. All methods are thread-safe.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from threading import RLock
from typing import Any

import mujoco
import numpy as np

from handover_robots.model.joints import Joints
from handover_robots.model.poses import Pose, Vector
from handover_robots.model.trajectory import Setpoint
from handover_robots.physics.arm import Array, SimulatedArm, frame_of
from handover_robots.physics.robot_bodies import CAMERA_GROUP, STEP_S
from handover_robots.physics.world_model import WorldModel, parked_at

STILL_MPS = 0.002

_STATE = (
    mujoco.mjtState.mjSTATE_FULLPHYSICS | mujoco.mjtState.mjSTATE_WARMSTART | mujoco.mjtState.mjSTATE_CTRL
)


_VISIBLE = np.array([group != CAMERA_GROUP for group in range(mujoco.mjNGROUP)], dtype=np.uint8)


class Simulation:
    """The state of a simulated cell; its arms start at rest at `joints`, with open fingers."""

    def __init__(self, world: WorldModel, joints: Mapping[str, Joints]) -> None:
        self.lock = RLock()
        self._use(world)
        self.arms = {
            name: SimulatedArm(names, self._model, self._data, self.lock, joints[name])
            for name, names in world.arms.items()
        }
        mujoco.mj_forward(self._model, self._data)

    def _use(self, world: WorldModel) -> None:
        """Begin with a model: find the parts; all of its state is initial."""
        self.world = world
        self._model = model = world.mujoco
        self._data = mujoco.MjData(model)
        self._parts = [model.body(name).id for name in world.parts]
        self._part_q = [model.joint(name).qposadr[0] for name in world.parts]
        self._part_v = [model.joint(name).dofadr[0] for name in world.parts]
        self._bodies = [np.flatnonzero(model.body_rootid == body) for body in self._parts]
        self._shapes = [np.flatnonzero(np.isin(model.geom_bodyid, bodies)) for bodies in self._bodies]
        self._part_of_geom = {
            int(geom): number for number, geoms in enumerate(self._shapes) for geom in geoms.tolist()
        }
        self._acceleration = np.zeros(model.nv)
        self._torque = np.zeros(model.nv)

    @property
    def arm(self) -> SimulatedArm:
        """Return the only arm."""
        (arm,) = self.arms.values()
        return arm

    def change_world(self, world: WorldModel) -> None:
        """Continue in another model of the same robots, with at least as many parts.

        Time, joints, fingers and parts stay where they are, with their velocities. What is around them is
        that of the new model from the next step on.
        """
        with self.lock:
            before, data = self._model, self._data
            drives = [name for arm in self.world.arms.values() for name in (*arm.joint_ids, *arm.finger_ids)]
            kept = set(self.world.parts) & set(world.parts)
            bends = [
                before.joint(number).name
                for number in range(before.njnt)
                if before.body(before.body_rootid[before.jnt_bodyid[number]]).name in kept
            ]
            old = [*drives, *bends]
            self._use(world)
            for name, arm in self.arms.items():
                arm.use(world.arms[name], self._model, self._data)
            for name in old:
                was = before.joint(name)
                self._data.joint(name).qpos[:] = data.joint(name).qpos
                self._data.joint(name).qvel[:] = data.joint(name).qvel
                if was.type[0] == mujoco.mjtJoint.mjJNT_FREE:
                    part = world.parts.index(name)
                    self._set_weightless(part, weightless=before.body_gravcomp[was.bodyid[0]] == 1.0)
                    geoms = np.flatnonzero(before.body_rootid[before.geom_bodyid] == was.bodyid[0])
                    for geom, same in zip(geoms, self._shapes[part], strict=True):
                        self._model.geom_friction[same] = before.geom_friction[geom]
                        self._model.geom_priority[same] = before.geom_priority[geom]
            for name in drives:
                self._data.actuator(name).ctrl[:] = data.actuator(name).ctrl
            self._data.time = data.time
            mujoco.mj_forward(self._model, self._data)

    @property
    def time_s(self) -> float:
        """Return the simulated time."""
        return float(self._data.time)

    def place_arm(self, name: str, joints: Joints) -> None:
        """Put an arm at rest at joint positions, with the part that it grips; no time passes."""
        with self.lock:
            arm, part = self.arms[name], self.gripped_part(name)
            held = None if part is None else arm.tool.inverse() @ self.part_pose(part).frame()
            arm.place(joints)
            mujoco.mj_forward(self._model, self._data)
            if part is not None and held is not None:
                self.put(part, Pose.of(arm.tool @ held))

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

    def run(self, course: Iterable[float]) -> None:
        """Simulate each time in s that a course of events yields, before it continues."""
        for seconds in course:
            self.step_for(seconds)

    def _drive(self) -> None:
        """Drive all arms; their inertias do not depend on each other, so one product has all torques."""
        arms = self.arms.values()
        for arm in arms:
            arm.want(self._acceleration)
        mujoco.mj_mulM(self._model, self._data, self._torque, self._acceleration)
        for arm in arms:
            arm.drive(self._torque)

    def gripped_part(self, name: str) -> int | None:
        """Return the number of the part that all fingers of an arm touch; None without one."""
        with self.lock:
            of_geom = self._part_of_geom
            touched = [
                {of_geom[geom] for geom in shapes if geom in of_geom} for shapes in self.arms[name].touched()
            ]
            return min(set.intersection(*touched), default=None) if touched else None

    def gripped_parts(self) -> set[int]:
        """Return the numbers of the parts in all grippers."""
        parts = (self.gripped_part(name) for name in self.arms)
        return {part for part in parts if part is not None}

    def part_pose(self, part: int) -> Pose:
        """Return the pose of a part."""
        with self.lock:
            body = self._parts[part]
            return Pose.of(frame_of(self._data.xmat[body], self._data.xpos[body]))

    def part_masses(self, part: int) -> list[tuple[Vector, float]]:
        """Return where the mass of a part is: the middle of each of its pieces, and its mass in kg."""
        with self.lock:
            middles = self._data.xipos[self._bodies[part]].tolist()
            masses = self._model.body_mass[self._bodies[part]].tolist()
        return [((x, y, z), mass) for (x, y, z), mass in zip(middles, masses, strict=True)]

    def part_boxes(self, part: int) -> list[tuple[Pose, Vector]]:
        """Return the pose and the size of the box around each shape of a part."""
        boxes: list[tuple[Pose, Vector]] = []
        with self.lock:
            for geom in self._shapes[part]:
                x, y, z = (2 * self._model.geom_aabb[geom][3:]).tolist()
                frame = frame_of(self._data.geom_xmat[geom], self._data.geom_xpos[geom])
                boxes.append((Pose.of(frame), (x, y, z)))
        return boxes

    def is_touched(self, part: int) -> bool:
        """Return whether a finger touches a part."""
        with self.lock:
            fingers = set[int]().union(*(arm.finger_shapes for arm in self.arms.values()))
            return any(
                (geom in fingers and self._part_of_geom.get(other) == part)
                or (other in fingers and self._part_of_geom.get(geom) == part)
                for geom, other in self._data.contact.geom.tolist()
            )

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

    def put(self, part: int, pose: Pose, *, is_held: bool = False) -> None:
        """Put a part at a pose, at rest and flat; then it falls, or floats while a person holds it."""
        x, y, z, w = pose.orientation
        self._set_part(part, pose.position, (w, x, y, z), weightless=is_held)

    def let_go(self, part: int) -> None:
        """Let a part fall that a person held."""
        with self.lock:
            self._set_weightless(part, weightless=False)

    def bend(self, part: int, random: Any, most_rad: float) -> None:
        """Bend all hinges of a part by random angles."""
        with self.lock:
            hinges = self._hinges(part)
            self._data.qpos[hinges] = random.uniform(-most_rad, most_rad, len(hinges))
            mujoco.mj_forward(self._model, self._data)

    def lowest_m(self, part: int) -> float:
        """Return the height of the lowest point of a part."""
        return min(
            pose.position[2]
            - sum(abs(row) * side for row, side in zip(pose.frame().rotation[2], size, strict=True)) / 2
            for pose, size in self.part_boxes(part)
        )

    def move(self, part: int, way: Vector) -> None:
        """Move a part by `way` in m as it is; no time passes."""
        with self.lock:
            at = self._part_q[part]
            self._data.qpos[at : at + 3] += way
            mujoco.mj_forward(self._model, self._data)

    def push(self, part: int, velocity: Sequence[float], spin: Sequence[float]) -> None:
        """Set the velocity of a part in m/s and rad/s."""
        with self.lock:
            at = self._part_v[part]
            self._data.qvel[at : at + 6] = [*velocity, *spin]

    def set_friction(self, part: int, friction: float) -> None:
        """Set the sliding friction of a part; the pads of the fingers then have no more than that."""
        with self.lock:
            self._model.geom_friction[self._shapes[part], 0] = friction
            self._model.geom_priority[self._shapes[part]] = 2

    def settling(self, max_s: float = 4.0) -> Iterator[float]:
        """Yield times to simulate until all parts lie still, but for those in grippers."""
        for _ in range(math.ceil(max_s / 0.1)):
            yield 0.1
            lying = set(range(len(self._parts))) - self.gripped_parts()
            if all(self.part_speed_mps(part) < STILL_MPS for part in lying):
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
                "fingers": np.array([arm.finger_command for arm in self.arms.values()]),
            }

    def restore(self, saved: dict[str, Any]) -> bool:
        """Take over a saved state, at rest; return False for one of another model."""
        state = np.asarray(saved["state"], dtype=np.float64)
        if len(state) != mujoco.mj_stateSize(self._model, _STATE) or len(saved["parked"]) != len(self._parts):
            return False
        with self.lock:
            mujoco.mj_setState(self._model, self._data, state, _STATE)
            self._data.qvel[:] = 0.0
            for part, parked in enumerate(saved["parked"]):
                self._set_weightless(part, weightless=bool(parked))
            mujoco.mj_forward(self._model, self._data)
            for arm, (target, speed) in zip(self.arms.values(), saved["fingers"].tolist(), strict=True):
                arm.restore_fingers((target, speed))
                arm.command(Setpoint.at_rest(arm.positions))
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
            hinges = self._hinges(part)
            self._data.qpos[hinges] = 0.0
            self._data.qvel[v : v + 6 + len(hinges)] = 0.0
            self._set_weightless(part, weightless=weightless)
            mujoco.mj_forward(self._model, self._data)

    def _set_weightless(self, part: int, *, weightless: bool) -> None:
        self._model.body_gravcomp[self._bodies[part]] = 1.0 if weightless else 0.0

    def _hinges(self, part: int) -> Any:
        """Return where the angles of the hinges of a part are in the state: behind its pose."""
        count = int(self._model.body_jntnum[self._bodies[part]].sum()) - 1
        return np.arange(self._part_q[part] + 7, self._part_q[part] + 7 + count)
