"""The constraints: joint limits, contacts, and the support polygon."""

from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from services.whole_body_control.model.kinematics import (
    BASE_POSITIONS,
    BASE_VELOCITIES,
    GRAVITY_MPS2,
    Array,
    Kinematics,
)
from services.whole_body_control.tasks.base import NO_BOUND, Bounds, Constraint


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

    def bounds(self, kinematics: Kinematics, q: Array, dt_s: float) -> Bounds:  # noqa: ARG002
        """Return six rows that are zero, or lead back to the target."""
        wanted = np.zeros(6)
        if self.target is not None:
            pose = kinematics.pose(self.link)
            wanted[:3] = self.gain * (self.target.translation - pose.translation)
            wanted[3:] = self.gain * pin.log3(self.target.rotation @ pose.rotation.T)
        return Bounds(kinematics.jacobian(self.link), wanted, wanted.copy())


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
