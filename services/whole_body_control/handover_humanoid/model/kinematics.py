"""Kinematics and dynamics of a humanoid with a floating base, in the order of its joints.

A configuration is q = (position of the base in m, orientation as a quaternion x y z w, joints), a velocity
is v = (linear and angular velocity of the base in its own frame, joints). Poses are in the world.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from handover.errors import UsageError
from handover_humanoid.model.humanoid import Humanoid

Array = NDArray[np.float64]

BASE_POSITIONS, BASE_VELOCITIES = 7, 6
ROOT_JOINT = 1
"""The number of the free joint in pinocchio."""
GRAVITY_MPS2 = 9.81
DOWNWARDS = np.array([0.0, 0.0, -GRAVITY_MPS2])
ORIGIN = np.zeros(3)
ALIGNED_RAD = 1e-3
"""Soles that are turned by less face ahead."""


def cross(first: Array, second: Array) -> Array:
    """Return the vector product of two vectors (3,), in a tenth of the time of `numpy.cross`."""
    (a, b, c), (x, y, z) = first.tolist(), second.tolist()
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x])


def rotation_vector(actual: Array, target: Array) -> Array:
    """Return the turn from one orientation (3, 3) to another as a rotation vector (3,) in rad."""
    # `dot` takes half the time of `@` here.
    return np.asarray(pin.log3(target.dot(actual.T)))


def quaternion(rotation: Array) -> Array:
    """Return the quaternion (4,) x y z w of an orientation (3, 3).

    `pin.Quaternion(rotation)` is the same, but of each it keeps 80 bytes for ever (pinocchio 4.1).
    """
    return np.asarray(pin.SE3ToXYZQUAT(pin.SE3(rotation, ORIGIN)))[3:]


class Kinematics:
    """A humanoid for computations; not thread-safe, so each thread makes its own.

    `update` is for one state; the other methods compute what they need of it once, and read it then.
    """

    def __init__(self, humanoid: Humanoid) -> None:
        self.humanoid = humanoid
        try:
            free = pin.buildModelFromXML(humanoid.urdf, pin.JointModelFreeFlyer())
        except (ValueError, RuntimeError) as error:
            raise UsageError(f"the URDF of {humanoid.name} cannot be used: {error}") from None
        self.pin_model = free
        self.data = free.createData()
        self.total_mass_kg = float(pin.computeTotalMass(free))
        self.n_joints = len(humanoid.joints)
        self.n_velocities = BASE_VELOCITIES + self.n_joints
        # pinocchio sorts the children of a link by name; these say where it keeps each of our joints.
        ids = [free.getJointId(name) for name in humanoid.joint_names]
        self._v_of = np.array([free.joints[joint_id].idx_v for joint_id in ids])
        self._columns = np.concatenate([np.arange(BASE_VELOCITIES), self._v_of])
        positions = [*range(BASE_POSITIONS), *(free.joints[joint_id].idx_q for joint_id in ids)]
        # Of a vector in our order, what stands where in one of pinocchio: `take` copies in a quarter of the
        # time of an assignment to indices.
        self._to_q, self._to_v = np.argsort(positions), np.argsort(self._columns)
        self._from_q = np.array(positions)
        self._frames: dict[str, int] = {
            frame.name: index
            for index, frame in enumerate(free.frames)
            if frame.type == pin.FrameType.BODY and frame.name in humanoid.links
        }
        self._poses = {name: self.data.oMf[index] for name, index in self._frames.items()}
        """References to the poses in `data`, which `update` changes in place."""
        self._translations = {name: pose.translation for name, pose in self._poses.items()}
        self._rotations = {name: pose.rotation for name, pose in self._poses.items()}
        """The same memory as arrays: pinocchio takes as long to make one as to compute with it."""
        self._q, self._v = pin.neutral(free), np.zeros(free.nv)
        self._acceleration, self._moved_q = np.zeros(free.nv), np.zeros(free.nq)
        self._still = np.zeros(BASE_VELOCITIES + len(humanoid.joints))
        self._is_at_rest = False
        self._has_jacobians = self._has_centre = self._has_centre_jacobian = False
        """Of the state of `update`: those of the joints, the centre of mass, its Jacobian."""
        self.q = self.neutral(np.zeros(self.n_joints))

    def neutral(self, joints: Sequence[float] | Array) -> Array:
        """Return the configuration with the base at the origin, upright, and these joints."""
        return np.concatenate([[0.0, 0, 0, 0, 0, 0, 1], np.asarray(joints, dtype=np.float64)])

    def standing(self, pose: str) -> Array:
        """Return a named pose with its lowest contact corner on the ground, between the soles.

        The soles face ahead (x), whichever way the root link does.
        """
        q = self.neutral(self.humanoid.pose(pose))
        self.update(q)
        ahead = sum(self.pose(contact.link).rotation[:2, 0] for contact in self.humanoid.contacts.values())
        yaw = math.atan2(ahead[1], ahead[0]) if np.any(ahead) else 0.0
        if abs(yaw) > ALIGNED_RAD:
            q[5], q[6] = math.sin(-yaw / 2), math.cos(yaw / 2)
            self.update(q)
        corners = [
            self.pose(contact.link).act(np.array(corner))
            for contact in self.humanoid.contacts.values()
            for corner in contact.corners
        ]
        lowest = min(float(corner[2]) for corner in corners)
        q[:3] = [*(-np.mean(corners, axis=0)[:2]), -lowest]
        return q

    def update(self, q: Array, v: Array | None = None) -> None:
        """Compute positions and velocities of a state, and of the rest what is asked for later.

        Nothing is computed again for the state at rest that was computed last.
        """
        self.q = q
        q.take(self._to_q, out=self._moved_q, mode="clip")
        if v is None and self._is_at_rest and np.array_equal(self._moved_q, self._q):
            return
        self._q[:] = self._moved_q
        self._is_at_rest = v is None
        (self._still if v is None else v).take(self._to_v, out=self._v, mode="clip")
        pin.forwardKinematics(self.pin_model, self.data, self._q, self._v)
        pin.updateFramePlacements(self.pin_model, self.data)
        self._has_jacobians = self._has_centre = self._has_centre_jacobian = False

    def pose(self, link: str) -> Any:
        """Return the pose of a link as a `pinocchio.SE3`. Raises `UsageError` for an unknown link."""
        of_link = self._poses.get(link)
        return of_link if of_link is not None else self.data.oMf[self._frame(link)]

    def translation(self, link: str) -> Array:
        """Return the place (3,) of a link in m, which the next `update` changes."""
        place = self._translations.get(link)
        return place if place is not None else np.asarray(self.pose(link).translation)

    def rotation(self, link: str) -> Array:
        """Return the orientation (3, 3) of a link, which the next `update` changes."""
        orientation = self._rotations.get(link)
        return orientation if orientation is not None else np.asarray(self.pose(link).rotation)

    def jacobian(self, link: str) -> Array:
        """Return the Jacobian of a link: (6, n_velocities), linear first, in axes of the world."""
        full = self._frame_jacobian(link)
        return np.asarray(full.take(self._columns, axis=1))

    def joint_torques(self, link: str, wrench: Array) -> Array:
        """Return the torques (n_joints,) of a wrench (6,) on a link: force, and moment about its origin, in
        axes of the world."""
        full = self._frame_jacobian(link)
        return np.asarray((wrench @ full).take(self._v_of))

    def write_jacobian(self, link: str, jacobian: Array, rows: slice | Array = slice(None)) -> None:
        """Write rows of the Jacobian of a link, or all six, into `jacobian` (rows, n_velocities)."""
        full = self._frame_jacobian(link)
        full[rows].take(self._columns, axis=1, out=jacobian, mode="clip")

    def point(self, q: Array, link: str, point: Array) -> tuple[Array, Array]:
        """Return a point (3,) of a link in the world at `q`, and its Jacobian (3, n_velocities).

        Without `update`, of which it needs a part; what `update` computed is lost.
        """
        q.take(self._to_q, out=self._q, mode="clip")
        self._is_at_rest = False
        pin.computeJointJacobians(self.pin_model, self.data, self._q)
        self._has_jacobians = True
        pose = pin.updateFramePlacement(self.pin_model, self.data, self._frame(link))
        offset = pose.rotation @ point
        jacobian = self.jacobian(link)
        return pose.translation + offset, jacobian[:3] - pin.skew(offset) @ jacobian[3:]

    def is_on_root(self, link: str) -> bool:
        """Return whether no joint is between the root and a link."""
        return bool(self.pin_model.frames[self._frame(link)].parentJoint == ROOT_JOINT)

    def from_root(self, q: Array, v: Array, link: str) -> tuple[Any, Array]:
        """Return the pose of a link in the frame of the root, and its velocity (6,) in this frame, as a root
        at rest sees it.

        Without `update`, of which it needs a part; what `update` computed is lost.
        """
        q.take(self._to_q, out=self._q, mode="clip")
        v.take(self._to_v, out=self._v, mode="clip")
        self._v[:BASE_VELOCITIES] = 0.0
        self._is_at_rest = self._has_jacobians = self._has_centre = self._has_centre_jacobian = False
        pin.forwardKinematics(self.pin_model, self.data, self._q, self._v)
        frame = self._frame(link)
        pose = self.data.oMi[ROOT_JOINT].actInv(pin.updateFramePlacement(self.pin_model, self.data, frame))
        motion = pin.getFrameVelocity(self.pin_model, self.data, frame, pin.ReferenceFrame.LOCAL)
        return pose, np.concatenate([pose.rotation @ motion.linear, pose.rotation @ motion.angular])

    def velocity(self, link: str) -> Array:
        """Return the velocity of a link: linear and angular, at the link in axes of the world."""
        motion = pin.getFrameVelocity(
            self.pin_model, self.data, self._frame(link), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        return np.asarray(motion.vector)

    def centre_of_mass(self) -> Array:
        """Return the centre of mass in m."""
        self._require_centre()
        return np.asarray(self.data.com[0]).copy()

    def centre_of_mass_velocity(self) -> Array:
        """Return the velocity of the centre of mass in m/s."""
        self._require_centre()
        return np.asarray(self.data.vcom[0]).copy()

    def centre_of_mass_jacobian(self) -> Array:
        """Return the Jacobian of the centre of mass: (3, n_velocities)."""
        self._require_centre_jacobian()
        return np.asarray(self.data.Jcom)[:, self._columns]

    def write_centre_of_mass_jacobian(self, jacobian: Array) -> None:
        """Write the Jacobian of the centre of mass into `jacobian` (3, n_velocities)."""
        self._require_centre_jacobian()
        self.data.Jcom.take(self._columns, axis=1, out=jacobian, mode="clip")

    def write_powers(self, wrenches: Array, powers: Array) -> None:
        """Write the power (k, n_velocities) per velocity of wrenches (k, 6) on whatever each joint moves.

        A wrench is a force in N and its moment about the origin of the world in N m.
        """
        self._require_jacobians()
        (wrenches @ self.data.J).take(self._columns, axis=1, out=powers, mode="clip")

    def moving(self, joint_id: int) -> NDArray[np.bool_]:
        """Return whether each velocity moves what is fixed to a joint of pinocchio."""
        is_moved = np.zeros(self.n_velocities, dtype=np.bool_)
        for support in self.pin_model.supports[joint_id]:
            joint = self.pin_model.joints[support]
            if support:
                is_moved[joint.idx_v : joint.idx_v + joint.nv] = True
        return np.asarray(is_moved[self._columns])

    def joint_number(self, joint_id: int) -> int:
        """Return our number of a joint of pinocchio."""
        return int(np.flatnonzero(self._v_of == self.pin_model.joints[joint_id].idx_v)[0])

    def momentum_matrix(self) -> Array:
        """Return the centroidal momentum matrix: (6, n_velocities), linear first."""
        return np.asarray(pin.computeCentroidalMap(self.pin_model, self.data, self._q))[:, self._columns]

    def mass_matrix(self) -> Array:
        """Return the mass matrix (n_velocities, n_velocities), with the inertia of the drives."""
        upper = np.triu(pin.crba(self.pin_model, self.data, self._q))
        full = upper + np.triu(upper, 1).T
        matrix = np.asarray(full[np.ix_(self._columns, self._columns)])
        joints = np.arange(BASE_VELOCITIES, self.n_velocities)
        matrix[joints, joints] += self.humanoid.drive_inertia
        return matrix

    def joint_damping(self) -> Array:
        """Return the viscous damping of each joint as the URDF has it, in N m s/rad."""
        return np.asarray(np.array(self.pin_model.damping)[self._v_of])

    def inverse_dynamics(self, v: Array, acceleration: Array, upwards: Array) -> Array:
        """Return the forces (n_velocities,) that move the state of `update` without any contact.

        `upwards` (3,) in m/s² is what an accelerometer at rest would show: gravity, and an acceleration of
        the whole body. The inertia of drives is not part of it.
        """
        self.pin_model.gravity.linear = -upwards
        v.take(self._to_v, out=self._v, mode="clip")
        acceleration.take(self._to_v, out=self._acceleration, mode="clip")
        forces = pin.rnea(self.pin_model, self.data, self._q, self._v, self._acceleration)
        return np.asarray(forces.take(self._columns))

    def force_sensor(self, link: str) -> tuple[str, int, int] | None:
        """Return the nearest force-torque sensor between a link and the root, None without one.

        These are its link, the number of the joint that carries it in pinocchio, and its row of the wrenches.
        """
        rows = {
            self.pin_model.frames[self._frame(sensor)].parentJoint: (sensor, row)
            for row, sensor in enumerate(self.humanoid.sensors.force_torque.values())
        }
        above = self.pin_model.supports[self.pin_model.frames[self._frame(link)].parentJoint]
        for joint_id in reversed(list(above)):
            if joint_id in rows:
                sensor, row = rows[joint_id]
                return sensor, int(joint_id), row
        return None

    def force_through(self, joint_id: int) -> Array:
        """Return the force (3,) on the ground that a joint of pinocchio exerts on what it moves, in the last
        `inverse_dynamics`."""
        return np.asarray(self.data.oMi[joint_id].rotation @ self.data.f[joint_id].linear)

    def gravity_torques(self) -> Array:
        """Return the torques (n_joints,) that carry the weight of all limbs in the state of `update`."""
        self.pin_model.gravity.linear = DOWNWARDS
        forces = pin.computeGeneralizedGravity(self.pin_model, self.data, self._q)
        return np.asarray(forces.take(self._v_of))

    def integrate(self, q: Array, v: Array, dt_s: float) -> Array:
        """Return the configuration after moving with `v` for `dt_s`."""
        start, motion = q.take(self._to_q), v.take(self._to_v)
        base = start[3:BASE_POSITIONS]
        base /= math.sqrt(base.dot(base))
        motion *= dt_s
        return np.asarray(pin.integrate(self.pin_model, start, motion).take(self._from_q))

    def _frame_jacobian(self, link: str) -> Array:
        """Return the Jacobian of a link in the order of pinocchio."""
        self._require_jacobians()
        return np.asarray(
            pin.getFrameJacobian(
                self.pin_model, self.data, self._frame(link), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            )
        )

    def _require_jacobians(self) -> None:
        if not self._has_jacobians:
            pin.computeJointJacobians(self.pin_model, self.data)
            self._has_jacobians = True

    def _require_centre(self) -> None:
        if not self._has_centre:
            pin.centerOfMass(self.pin_model, self.data, pin.KinematicLevel.VELOCITY, False)
            self._has_centre = True

    def _require_centre_jacobian(self) -> None:
        if not self._has_centre_jacobian:
            pin.jacobianCenterOfMass(self.pin_model, self.data, False)
            self._has_centre_jacobian = True

    def _frame(self, link: str) -> int:
        frame = self._frames.get(link)
        if frame is None:
            raise UsageError(f'{self.humanoid.name} has no link "{link}"')
        return frame
