"""The constraints: joint limits, contacts, the support polygon, and links that must not touch."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from handover.errors import UsageError
from services.whole_body_control.model.kinematics import (
    BASE_POSITIONS,
    BASE_VELOCITIES,
    GRAVITY_MPS2,
    Array,
    Kinematics,
)
from services.whole_body_control.tasks.base import NO_BOUND, Bounds, Constraint

ROW_BLOCK = 8
"""Rows of near pairs come in multiples of this, so that the shape of the problem seldom changes."""


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


class SelfCollision(Constraint):
    """Links of the collision pairs stay `min_distance_m` apart.

    Distances are those of the capsules and boxes of the URDF, computed by coal. Pairs that are nearer than
    `near_m` get a row: their distance shrinks with the time constant `margin_s` at most. Links that are too
    near, or touch, are moved apart by the same law, with `MAX_PARTING_MPS` at most.
    """

    MAX_PARTING_MPS = 0.1

    def __init__(
        self,
        kinematics: Kinematics,
        min_distance_m: float = 0.005,
        near_m: float = 0.05,
        margin_s: float = 0.1,
    ) -> None:
        if not 0 <= min_distance_m < near_m:
            raise ValueError(
                f"the distance {min_distance_m} m must be 0 or more, and less than the {near_m} m "
                "from which on pairs are watched"
            )
        self.name = "self-collision"
        self._min_distance_m, self._near_m, self._margin_s = min_distance_m, near_m, margin_s
        self._geometry = _geometry(kinematics)
        self._data = pin.GeometryData(self._geometry)
        frames = kinematics.pin_model.frames
        self._links = [frames[each.parentFrame].name for each in self._geometry.geometryObjects]
        self._pairs = [(pair.first, pair.second) for pair in self._geometry.collisionPairs]

    def distances(self, kinematics: Kinematics) -> dict[tuple[str, str], float]:
        """Return the distance in m between the shapes of each pair of links, negative where they overlap."""
        found: dict[tuple[str, str], float] = {}
        for (first, second), result in self._results(kinematics):
            links = (self._links[first], self._links[second])
            found[links] = min(result.min_distance, found.get(links, np.inf))
        return found

    def bounds(self, kinematics: Kinematics, q: Array, dt_s: float) -> Bounds:  # noqa: ARG002
        """Return one row for each near pair: the rate at which its distance grows."""
        approach_s = max(self._margin_s, dt_s)
        rows, lower = [], []
        for (first, second), result in self._results(kinematics):
            distance = result.min_distance
            if distance < self._near_m:
                normal = np.asarray(result.normal)
                of_first = _at_point(kinematics, self._links[first], result.getNearestPoint1())
                of_second = _at_point(kinematics, self._links[second], result.getNearestPoint2())
                rows.append(normal @ (of_second - of_first))
                lower.append(min((self._min_distance_m - distance) / approach_s, self.MAX_PARTING_MPS))
        count = -(-len(rows) // ROW_BLOCK) * ROW_BLOCK
        matrix, at_least = np.zeros((count, kinematics.n_velocities)), np.full(count, -NO_BOUND)
        if rows:
            matrix[: len(rows)], at_least[: len(rows)] = rows, lower
        return Bounds(matrix, at_least, np.full(count, NO_BOUND))

    def _results(self, kinematics: Kinematics) -> Iterator[tuple[tuple[int, int], Any]]:
        pin.updateGeometryPlacements(kinematics.pin_model, kinematics.data, self._geometry, self._data)
        pin.computeDistances(self._geometry, self._data)
        return zip(self._pairs, self._data.distanceResults, strict=True)


def _geometry(kinematics: Kinematics) -> Any:
    """Return the shapes of the URDF with the collision pairs of the model. Raises `UsageError`."""
    humanoid = kinematics.humanoid
    try:
        geometry = pin.buildGeomFromUrdfString(
            kinematics.pin_model, humanoid.urdf, pin.GeometryType.COLLISION
        )
    except (ValueError, RuntimeError) as error:
        raise UsageError(
            f"the collision shapes of {humanoid.name} cannot be used: {error}; give its links capsules"
        ) from None
    shapes: dict[str, list[int]] = {}
    for index, each in enumerate(geometry.geometryObjects):
        shapes.setdefault(kinematics.pin_model.frames[each.parentFrame].name, []).append(index)
    for first, second in sorted(tuple(sorted(pair)) for pair in humanoid.collision_pairs):
        for one in shapes.get(first, ()):
            for other in shapes.get(second, ()):
                geometry.addCollisionPair(pin.CollisionPair(one, other))
    if not len(geometry.collisionPairs):
        raise UsageError(
            f"{humanoid.name} has no collision shapes in pairs; its self-collision is not checked"
        )
    return geometry


def _at_point(kinematics: Kinematics, link: str, point: Array) -> Array:
    """Return the Jacobian (3, n_velocities) of a point in m that moves with a link."""
    jacobian = kinematics.jacobian(link)
    return np.asarray(jacobian[:3] - pin.skew(point - kinematics.pose(link).translation) @ jacobian[3:])
