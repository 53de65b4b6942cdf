"""The constraints: joint limits, contacts, the support polygon, and friction."""

from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from handover_humanoid.model.kinematics import (
    BASE_POSITIONS,
    BASE_VELOCITIES,
    GRAVITY_MPS2,
    Array,
    Kinematics,
    rotation_vector,
)
from handover_humanoid.tasks.base import NO_BOUND, Bounds, Constraint


class JointLimits(Constraint):
    """Position and velocity limits of all joints.

    A joint approaches a position limit with the time constant `margin_s`, so that it arrives at rest; beyond
    the limit it returns by the same law.
    """

    def __init__(self, kinematics: Kinematics, share: float = 1.0, margin_s: float = 0.05) -> None:
        self.name = "joint limits"
        joints = kinematics.humanoid.joints
        self.lower = np.array([joint.lower for joint in joints])
        self.upper = np.array([joint.upper for joint in joints])
        self.velocity = share * np.array([joint.max_velocity for joint in joints])
        self._margin_s = margin_s
        matrix = np.zeros((len(joints), kinematics.n_velocities))
        matrix[:, BASE_VELOCITIES:] = np.eye(len(joints))
        self._bounds = Bounds(matrix, np.zeros(len(joints)), np.zeros(len(joints)))

    def bounds(self, kinematics: Kinematics, q: Array, dt_s: float) -> Bounds:  # noqa: ARG002
        """Return one row for each joint."""
        joints, rate = q[BASE_POSITIONS:], 1.0 / max(self._margin_s, dt_s)
        slowest = np.negative(self.velocity)
        for limit, bound in ((self.lower, self._bounds.lower), (self.upper, self._bounds.upper)):
            np.subtract(limit, joints, out=bound)
            np.multiply(bound, rate, out=bound)
            np.minimum(bound, self.velocity, out=bound)
            np.maximum(bound, slowest, out=bound)
        return self._bounds


class Contact(Constraint):
    """A link does not move, as a foot on the ground: an equality above all levels.

    With a `target` (a `pinocchio.SE3`) it is drawn there with `gain` in 1/s, so that rounding does not let
    it drift over thousands of cycles.
    """

    def __init__(self, link: str, target: Any = None, gain: float = 10.0) -> None:
        self.name, self.link = f"contact of {link}", link
        self.target, self.gain = target, gain
        self._bounds: Bounds | None = None

    def bounds(self, kinematics: Kinematics, q: Array, dt_s: float) -> Bounds:  # noqa: ARG002
        """Return six rows that are zero, or lead back to the target."""
        if self._bounds is None:
            wanted = np.zeros(6)
            self._bounds = Bounds(np.zeros((6, kinematics.n_velocities)), wanted, wanted)
        wanted = self._bounds.lower
        kinematics.write_jacobian(self.link, self._bounds.matrix)
        wanted[:] = 0.0
        if self.target is not None:
            np.subtract(self.target.translation, kinematics.translation(self.link), out=wanted[:3])
            wanted[3:] = rotation_vector(kinematics.rotation(self.link), self.target.rotation)
            wanted *= self.gain
        return self._bounds


class SupportPolygon(Constraint):
    """The centre of mass, or the capture point, stays in the hull of contacts, `margin_m` from its edges.

    The capture point is x + v / omega, omega = sqrt(g / height) (Pratt 2006): with `is_capture_point` the
    velocity is bounded, so that the robot can still come to rest above the polygon.
    """

    def __init__(
        self, contacts: tuple[str, ...], margin_m: float = 0.02, *, is_capture_point: bool = True
    ) -> None:
        self.name = "capture point" if is_capture_point else "support polygon"
        self._contacts, self._margin_m, self._is_capture_point = contacts, margin_m, is_capture_point

    def bounds(self, kinematics: Kinematics, q: Array, dt_s: float) -> Bounds:  # noqa: ARG002
        """Return one row for each edge of the polygon."""
        corners = np.array(
            [
                kinematics.pose(contact.link).act(np.array(corner))
                for name in self._contacts
                for contact in (kinematics.humanoid.contacts[name],)
                for corner in contact.corners
            ]
        )
        edges = ConvexHull(corners[:, :2]).equations  # outward normals and offsets: normal @ x + offset <= 0
        normals, offsets = edges[:, :2], edges[:, 2]
        com = kinematics.centre_of_mass()
        room = -offsets - self._margin_m - normals @ com[:2]
        height = max(float(com[2] - corners[:, 2].min()), 0.05)
        reach_s = np.sqrt(height / GRAVITY_MPS2) if self._is_capture_point else dt_s
        rows = normals @ kinematics.centre_of_mass_jacobian()[:2]
        return Bounds(rows, np.full(len(room), -NO_BOUND), room / reach_s)


class Friction(Constraint):
    """The contacts can make the force that the motion needs: none has to slip, or to pull.

    The force on the whole body is m (c'' + g), with c'' = (J v - c'_before) / dt for the centre of mass. It
    has to lie in the sum of the friction cones of the contacts, each with the normal of its surface and
    `SIDES` edges on the true cone; that is necessary and, without regard to moments, sufficient. `share` is
    what part of the coefficients of friction may be used. The velocity before is that of the centre of mass
    between two calls, or `velocity_before` (3,) where it is set; the first call takes it as zero.
    """

    SIDES = 8
    SAME = 1e-6
    """Normals that differ by less make the same cone."""

    def __init__(self, contacts: tuple[str, ...], share: float = 1.0) -> None:
        if not 0 < share <= 1:
            raise ValueError(f"the share of the friction is {share}; it must be above 0, and 1 at most")
        self.name = "friction"
        self._contacts, self._share = contacts, share
        self.velocity_before: Array | None = None
        self._com_before: Array | None = None
        self._normals, self._facets = np.full((len(contacts), 3), np.nan), np.zeros((0, 3))

    def bounds(self, kinematics: Kinematics, q: Array, dt_s: float) -> Bounds:  # noqa: ARG002
        """Return one row for each face of the sum of the cones; none where they make every force."""
        com = kinematics.centre_of_mass()
        before = self.velocity_before
        if before is None:
            before = np.zeros(3) if self._com_before is None else (com - self._com_before) / dt_s
        self._com_before = com
        facets = self._facets_of(kinematics)
        rows = facets @ kinematics.centre_of_mass_jacobian()
        at_most = facets @ (before - np.array([0.0, 0.0, GRAVITY_MPS2 * dt_s]))
        return Bounds(rows, np.full(len(facets), -NO_BOUND), at_most)

    def _facets_of(self, kinematics: Kinematics) -> Array:
        """Return outward normals (k, 3); a force is possible if its product with none is positive."""
        contacts = [kinematics.humanoid.contacts[name] for name in self._contacts]
        rotations = [kinematics.pose(contact.link).rotation for contact in contacts]
        normals = np.array([rotation[:, 2] for rotation in rotations])
        if not np.abs(normals - self._normals).max(initial=0.0) < self.SAME:
            coefficients = [self._share * contact.friction for contact in contacts]
            self._facets = _facets(np.vstack([*map(_edges, rotations, coefficients)]))
            self._normals = normals
        return self._facets


def _edges(rotation: Array, coefficient: float) -> Array:
    """Return the edges (k, 3) of a friction cone about the z axis of a surface."""
    angles = np.arange(Friction.SIDES) * (2 * np.pi / Friction.SIDES)
    local = np.column_stack(
        [coefficient * np.cos(angles), coefficient * np.sin(angles), np.ones(len(angles))]
    )
    return np.asarray(local @ rotation.T)


def _facets(edges: Array) -> Array:
    """Return the outward normals (k, 3) of the faces of the cone that edges span."""
    if not np.isfinite(edges).all():
        return np.zeros((0, 3))
    faces = ConvexHull(np.vstack([np.zeros(3), edges])).equations
    through_apex = faces[np.abs(faces[:, 3]) < 1e-9, :3]
    return np.unique(np.round(through_apex, 9), axis=0)
