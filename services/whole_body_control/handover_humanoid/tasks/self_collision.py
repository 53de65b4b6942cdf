"""Links that must not touch: a constraint whose cost depends on the few pairs that are near.

The distance of two links changes by at most the sum, over the joints between them, of the motion of the joint
times its longest lever. A pair that was far is therefore not computed again before the joints have moved by
as much as it had room. With COMAN standing that leaves some 25 of 331 pairs.
"""

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from handover.errors import UsageError
from handover.messages import number_text
from handover_humanoid.model.kinematics import BASE_POSITIONS, BASE_VELOCITIES, Array, Kinematics
from handover_humanoid.tasks.base import NO_BOUND, Bounds, Constraint

ROW_BLOCK = 8
"""Rows of near pairs come in multiples of this, so that the shape of the problem seldom changes."""


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
                f"the distance {number_text(min_distance_m)} m must be 0 or more, and less than the "
                f"{number_text(near_m)} m from which on pairs are watched"
            )
        self.name = "self-collision"
        self._min_distance_m, self._near_m, self._margin_s = min_distance_m, near_m, margin_s
        self._geometry = _geometry(kinematics)
        self._data = pin.GeometryData(self._geometry)
        frames = kinematics.pin_model.frames
        self._links = [frames[shape.parentFrame].name for shape in self._geometry.geometryObjects]
        self._pairs = [(pair.first, pair.second) for pair in self._geometry.collisionPairs]
        self._signs = _signs(kinematics, self._geometry)
        self._levers = np.abs(self._signs[:, BASE_VELOCITIES:]) * _levers(kinematics, self._geometry)
        self._joints, self._moved = np.zeros(kinematics.n_joints), np.zeros(kinematics.n_joints)
        count = len(self._pairs)
        self._room_m, self._used_m, self._more_m = np.zeros(count), np.zeros(count), np.zeros(count)
        """How much nearer each pair may come before it is near, and by how much it may have come nearer."""
        self._near = np.zeros(count, dtype=np.int64)
        self._distances_m = np.zeros(count)
        self._wrenches, self._points = np.zeros((count, 6)), np.zeros((count, 3))

    def distances(self, kinematics: Kinematics) -> dict[tuple[str, str], float]:
        """Return the distance in m between the shapes of each pair of links, negative where they overlap."""
        by_links: dict[tuple[str, str], float] = {}
        self._compute_all(kinematics)
        for (first, second), result in zip(self._pairs, self._data.distanceResults, strict=True):
            links = (self._links[first], self._links[second])
            by_links[links] = min(result.min_distance, by_links.get(links, np.inf))
        return by_links

    def smallest_m(self, kinematics: Kinematics) -> float:
        """Return the smallest distance in m of all pairs."""
        return float(self._data.distanceResults[self._compute_all(kinematics)].min_distance)

    def bounds(self, kinematics: Kinematics, q: Array, dt_s: float) -> Bounds:
        """Return one row for each near pair: the rate at which its distance grows."""
        near_count = self._find_near(kinematics, q)
        count = -(-near_count // ROW_BLOCK) * ROW_BLOCK
        matrix, at_least = np.zeros((count, kinematics.n_velocities)), np.full(count, -NO_BOUND)
        if near_count:
            wrenches, points = self._wrenches[:near_count], self._points[:near_count]
            (x, y, z), (a, b, c) = points.T, wrenches[:, :3].T
            wrenches[:, 3], wrenches[:, 4], wrenches[:, 5] = y * c - z * b, z * a - x * c, x * b - y * a
            # The nearest points lie on the normal, so that one wrench serves both links: the distance grows
            # with its power in the joints that move the second link, and shrinks with that of the first.
            rows = matrix[:near_count]
            kinematics.write_powers(wrenches, rows)
            rows *= self._signs[self._near[:near_count]]
            of_gap = (self._min_distance_m - self._distances_m[:near_count]) / max(self._margin_s, dt_s)
            np.minimum(of_gap, self.MAX_PARTING_MPS, out=at_least[:near_count])
        return Bounds(matrix, at_least, np.full(count, NO_BOUND))

    def _find_near(self, kinematics: Kinematics, q: Array) -> int:
        """Compute the distances of pairs that may be near, and return how many are."""
        pin.updateGeometryPlacements(kinematics.pin_model, kinematics.data, self._geometry, self._data)
        np.subtract(q[BASE_POSITIONS:], self._joints, out=self._moved)
        self._joints[:] = q[BASE_POSITIONS:]
        np.abs(self._moved, out=self._moved)
        self._used_m += np.dot(self._levers, self._moved, out=self._more_m)
        count = 0
        # A joint that is not a number makes a sum that is none, which is not below the room.
        for index in np.flatnonzero(~(self._used_m < self._room_m)).tolist():
            result = pin.computeDistance(self._geometry, self._data, index)
            distance_m = result.min_distance
            self._room_m[index], self._used_m[index] = distance_m - self._near_m, 0.0
            if distance_m < self._near_m:
                self._near[count], self._distances_m[count] = index, distance_m
                self._wrenches[count, :3], self._points[count] = result.normal, result.getNearestPoint1()
                count += 1
        return count

    def _compute_all(self, kinematics: Kinematics) -> int:
        """Compute the distances of all pairs, and return the number of the nearest one."""
        pin.updateGeometryPlacements(kinematics.pin_model, kinematics.data, self._geometry, self._data)
        return int(pin.computeDistances(self._geometry, self._data))


def _signs(kinematics: Kinematics, geometry: Any) -> Array:
    """Return for each pair and velocity 1 where it moves the second link alone, and -1 for the first."""
    moves = np.array(
        [kinematics.moving(shape.parentJoint) for shape in geometry.geometryObjects], dtype=np.float64
    )
    pairs: NDArray[np.int64] = np.array([(pair.first, pair.second) for pair in geometry.collisionPairs])
    return np.asarray(moves[pairs[:, 1]] - moves[pairs[:, 0]])


def _levers(kinematics: Kinematics, geometry: Any) -> Array:
    """Return for each pair and joint by how many m it moves any point of either shape at most, per rad or m.

    The lever of a joint is not longer than the way from it along the joints to the farthest point.
    """
    model = kinematics.pin_model
    levers = np.zeros((len(geometry.geometryObjects), kinematics.n_joints))
    for number, item in enumerate(geometry.geometryObjects):
        item.geometry.computeLocalAABB()
        centre = item.placement.act(item.geometry.aabb_center)
        way_m = float(np.linalg.norm(centre)) + item.geometry.aabb_radius
        joint = item.parentJoint
        while model.joints[joint].nv == 1:
            index = kinematics.joint_number(joint)
            limits = kinematics.humanoid.joints[index]
            is_turning = "P" not in model.joints[joint].shortname().removeprefix("JointModel")
            levers[number, index] = way_m if is_turning else 1.0
            way_m += float(np.linalg.norm(model.jointPlacements[joint].translation))
            way_m += 0.0 if is_turning else max(abs(limits.lower), abs(limits.upper))
            joint = model.parents[joint]
    pairs = [(pair.first, pair.second) for pair in geometry.collisionPairs]
    return np.array([np.maximum(levers[first], levers[second]) for first, second in pairs])


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
    for index, shape in enumerate(geometry.geometryObjects):
        shapes.setdefault(kinematics.pin_model.frames[shape.parentFrame].name, []).append(index)
    for first, second in sorted(tuple(sorted(pair)) for pair in humanoid.collision_pairs):
        for index_of_first in shapes.get(first, ()):
            for other in shapes.get(second, ()):
                geometry.addCollisionPair(pin.CollisionPair(index_of_first, other))
    if not len(geometry.collisionPairs):
        raise UsageError(
            f"{humanoid.name} has no collision shapes in pairs; its self-collision is not checked"
        )
    return geometry
