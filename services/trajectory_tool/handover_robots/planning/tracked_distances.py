"""All distances of a robot in each cycle of a motion, from those of the cycles before.

A distance changes at most by the ways of the two geometries since it was computed. So each pair has the last
computed distance and a radius: the sum of those ways. A pair is computed again as soon as its radius exceeds
a small share of what its distance exceeds a horizon. Therefore:

- every distance below the horizon is exact (to the tolerance of coal), in each cycle;
- every other one is known to `SHARE` of what it exceeds the horizon, so it is above the horizon as well.

The bound holds for any change of the joints, also a jump: the way of a geometry is the largest one of the
corners of a polytope around it, since a rigid motion is affine and the norm of an affine function is largest
at a corner. The core of a capsule is a line, and the distance of the capsule is that of the line without the
radius. All shapes are convex; their signed distance changes at most by their ways where they penetrate, too.
For two links, only the joints between them count, each by the reach of the outer link.

Example: with a horizon of 0.1 m, a pair of 0.5 m is computed again after a way of 20 mm: at a speed of 1 m/s
in every tenth cycle of 2 ms.
"""

from itertools import product
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from handover_robots.planning.arm import Arm, Array
from handover_robots.planning.bounds import local_box
from handover_robots.planning.collision import Clearance, Collisions
from handover_robots.planning.link_points import LinkPoints

HORIZON_M = 0.1
SHARE = 0.05
MANY_SHARE = 0.4
"""From this fraction of the pairs on, it costs less to compute all distances in one call."""


class TrackedDistances:
    """The distances of all pairs of `collisions` from one configuration to the next. Not thread-safe."""

    def __init__(self, collisions: Collisions, horizon_m: float = HORIZON_M) -> None:
        self._collisions = collisions
        self._horizon_m = horizon_m
        self._geometry = collisions.geometry
        self._data = pin.GeometryData(self._geometry)
        self._model, self._kinematics = collisions.arm.pin_model, collisions.arm.data
        self._make_points(collisions.arm)
        self._make_pairs()
        self._joints: Array | None = None
        self.distances_m: Array = np.zeros(collisions.pairs)
        """The last computed distance of each pair, in the order of the pairs."""
        self.radii_m: Array = np.zeros(collisions.pairs)
        """How far each distance is from its last computed value at most; 0 where it is exact."""
        self._allowed_m: Array = np.zeros(collisions.pairs)
        self.computed = 0
        """The number of computed distances, for measurements."""

    def update(self, joints: Array) -> None:
        """Take the joints of this cycle."""
        if not len(self.distances_m):
            return
        before = self._joints
        self._joints = joints.copy()
        if before is None:
            self._compute_all(joints)
            self._points_before = self._points()
            return
        pin.updateGeometryPlacements(self._model, self._kinematics, self._geometry, self._data, joints)
        self._add_ways(np.abs(joints - before))
        stale = (self.radii_m > self._allowed_m).nonzero()[0]
        if len(stale) > MANY_SHARE * len(self.radii_m):
            self._compute_all(joints)
        elif len(stale):
            self._compute(stale)

    def closest(self) -> Clearance | None:
        """Return the closest pair with its exact distance; None without pairs."""
        if not len(self.distances_m):
            return None
        while self.radii_m[number := int((self.distances_m - self.radii_m).argmin())] > 0:
            self._compute(np.array([number]))
        return self._collisions.clearance(number, float(self.distances_m[number]))

    def _compute(self, numbers: Any) -> None:
        compute, geometry, data = pin.computeDistance, self._geometry, self._data
        self._keep(numbers, [compute(geometry, data, number).min_distance for number in numbers.tolist()])

    def _compute_all(self, joints: Array) -> None:
        pin.computeDistances(self._model, self._kinematics, self._geometry, self._data, joints)
        distances_m = [result.min_distance for result in self._data.distanceResults]
        self._keep(np.arange(len(distances_m)), distances_m)

    def _keep(self, numbers: Any, found_m: list[float]) -> None:
        new = np.array(found_m)
        self.computed += len(new)
        self.distances_m[numbers] = new
        self.radii_m[numbers] = 0.0
        new -= self._horizon_m
        new *= SHARE
        self._allowed_m[numbers] = np.maximum(new, 0.0)

    def _add_ways(self, turned: Array) -> None:
        points = self._points()
        moved = points - self._points_before
        self._points_before = points
        moved *= moved
        of_geometries = np.sqrt(np.maximum.reduceat(moved.sum(axis=1), self._first))
        self.radii_m += np.concatenate((of_geometries, self._between @ turned)).take(self._way_of_pair)

    def _make_points(self, arm: Arm) -> None:
        items = self._geometry.geometryObjects
        self._moving = [number for number, item in enumerate(items) if item.parentJoint > 0]
        points: list[tuple[int, Array]] = []
        first = []
        for number in self._moving:
            item = items[number]
            first.append(len(points))
            points += [(item.parentJoint, item.placement.act(corner)) for corner in _corners(item.geometry)]
        self._points = LinkPoints(arm, points)
        self._first = np.array(first, dtype=np.int64)

    def _make_pairs(self) -> None:
        """Number the ways: first those of the moving geometries, then those between two of them."""
        ways = {number: place for place, number in enumerate(self._moving)}
        between: list[int] = []
        way_of_pair = []
        for number, pair in enumerate(self._geometry.collisionPairs):
            moving = [ways[link] for link in (pair.first, pair.second) if link in ways]
            way_of_pair.append(moving[0] if len(moving) == 1 else len(ways) + len(between))
            if len(moving) > 1:
                between.append(number)
        self._way_of_pair = np.array(way_of_pair, dtype=np.int64)
        self._between = self._collisions.approaches[between]


def _corners(shape: Any) -> list[Array]:
    """Return the corners of a polytope around a shape, or around its core without its radius."""
    if isinstance(shape, coal.Capsule):
        return [np.array([0.0, 0.0, side * shape.halfLength]) for side in (-1, 1)]
    if isinstance(shape, coal.Sphere):
        return [np.zeros(3)]
    centre, half = local_box(shape)
    return [centre + half * np.array(side) for side in product((-1, 1), repeat=3)]
