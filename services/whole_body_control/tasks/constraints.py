"""The constraints: joint limits, contacts, the support polygon, and links that must not touch."""

import numpy as np
from scipy.spatial import ConvexHull

from services.whole_body_control.model.kinematics import BASE_POSITIONS, BASE_VELOCITIES, Array, Kinematics
from services.whole_body_control.tasks.base import NO_BOUND, Bounds, Constraint

GRAVITY_MPS2 = 9.81


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
        self._matrix = np.zeros((len(joints), kinematics.n_velocities))
        self._matrix[:, BASE_VELOCITIES:] = np.eye(len(joints))

    def bounds(self, kinematics: Kinematics, q: Array, dt_s: float) -> Bounds:  # noqa: ARG002
        """Return one row for each joint."""
        joints, approach_s = q[BASE_POSITIONS:], max(self._margin_s, dt_s)
        lower = np.clip((self.lower - joints) / approach_s, -self.velocity, self.velocity)
        upper = np.clip((self.upper - joints) / approach_s, -self.velocity, self.velocity)
        return Bounds(self._matrix, lower, upper)


class Contact(Constraint):
    """A link does not move, as a foot on the ground: an equality above all levels."""

    def __init__(self, link: str) -> None:
        self.name, self.link = f"contact of {link}", link

    def bounds(self, kinematics: Kinematics, q: Array, dt_s: float) -> Bounds:  # noqa: ARG002
        """Return six rows that are zero."""
        return Bounds(kinematics.jacobian(self.link), np.zeros(6), np.zeros(6))


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
