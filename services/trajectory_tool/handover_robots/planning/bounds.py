"""Lower bounds of the distances of all pairs of a configuration, in some 20 µs.

Each moving geometry is covered by spheres, and each fixed one by a box in its own axes. The distance of a
sphere to a box, or to another sphere, has a closed form; NumPy computes all of them at once. A bound holds
while a pair is apart; of pairs in contact, it says only that the distance is at most 0.

Example: a tube of 0.53 m with a radius of 62 mm is covered by four spheres with a radius of 0.13 m, so its
bound is up to 66 mm too low.
"""

from typing import Any

import coal
import numpy as np

from handover_robots.planning.arm import Arm, Array, corners_of
from handover_robots.planning.link_points import LinkPoints

MAX_SPHERES = 4
"""The spheres for one geometry; more cost more than they exclude."""

ROUNDING_M = 1e-7
_ZERO, _SUM = np.zeros(()), np.ones(4)


class DistanceBounds:
    """Bounds for the pairs of a geometry model, in their order. Not thread-safe."""

    def __init__(self, arm: Arm, geometry: Any) -> None:
        items = geometry.geometryObjects
        moving = [number for number, item in enumerate(items) if item.parentJoint > 0]
        fixed = [number for number, item in enumerate(items) if item.parentJoint == 0]
        self._make_spheres(arm, [items[number] for number in moving])
        self._make_boxes([items[number] for number in fixed])
        self._number_pairs(geometry, moving, fixed)

    def __call__(self) -> Array:
        """Return a bound for each pair at the configuration of the last forward kinematics."""
        centres = self._centres()
        outside = self._axes @ centres.T
        np.abs(outside, out=outside)
        outside -= self._halves
        np.maximum(outside, _ZERO, out=outside)
        outside *= outside
        by_axis = outside.reshape(3, self._boxes, len(centres))
        away = by_axis[0]
        away += by_axis[1]
        away += by_axis[2]
        np.sqrt(away, out=away)
        away -= self._radii
        between = centres.take(self._ones, axis=0)
        between -= centres.take(self._others, axis=0)
        between *= between
        apart = np.sqrt(between @ _SUM)
        apart -= self._sums
        to_boxes = np.minimum.reduceat(away, self._first, axis=1).ravel()
        to_others = np.minimum.reduceat(apart, self._first_of_pair) if len(apart) else apart
        bounds = np.concatenate((to_boxes, to_others)).take(self._order)
        bounds -= ROUNDING_M
        return np.asarray(bounds)

    def _make_spheres(self, arm: Arm, items: list[Any]) -> None:
        points: list[tuple[int, Array]] = []
        radii: list[float] = []
        first: list[int] = []
        for item in items:
            first.append(len(points))
            centres, radius_m = _spheres(item.geometry)
            points += [(item.parentJoint, item.placement.act(centre)) for centre in centres]
            radii += [radius_m] * len(centres)
        self._centres = LinkPoints(arm, points)
        self._radii, self._first = np.array(radii), np.array(first, dtype=np.int64)

    def _make_boxes(self, items: list[Any]) -> None:
        self._boxes = len(items)
        axes, halves = [], []
        for item in items:
            centre, half = local_box(item.geometry)
            turned = item.placement.rotation.T
            axes.append(np.column_stack([turned, -turned @ item.placement.act(centre)]))
            halves.append(half)
        # All first axes, then all second ones, then all third ones.
        self._axes = np.array(axes).reshape(-1, 3, 4).transpose(1, 0, 2).reshape(-1, 4).copy()
        self._halves = np.array(halves).reshape(-1, 3).T.reshape(-1, 1).copy()

    def _number_pairs(self, geometry: Any, moving: list[int], fixed: list[int]) -> None:
        columns = {number: place for place, number in enumerate(moving)}
        rows = {number: place for place, number in enumerate(fixed)}
        ends = [*self._first.tolist(), len(self._radii)]
        order: list[int] = []
        ones: list[int] = []
        others: list[int] = []
        first: list[int] = []
        for pair in geometry.collisionPairs:
            near, far = pair.first, pair.second
            if near in rows or far in rows:
                row, column = (rows[near], columns[far]) if near in rows else (rows[far], columns[near])
                order.append(row * len(moving) + column)
                continue
            order.append(self._boxes * len(moving) + len(first))
            first.append(len(ones))
            for sphere in range(ends[columns[near]], ends[columns[near] + 1]):
                for against in range(ends[columns[far]], ends[columns[far] + 1]):
                    ones.append(sphere)
                    others.append(against)
        self._order = np.array(order, dtype=np.int64)
        self._ones, self._others = np.array(ones, dtype=np.int64), np.array(others, dtype=np.int64)
        self._first_of_pair = np.array(first, dtype=np.int64)
        self._sums = self._radii[self._ones] + self._radii[self._others]


def _spheres(shape: Any) -> tuple[list[Array], float]:
    """Return the centres and the radius of spheres that cover a shape, along its longest axis."""
    centre, half = local_box(shape)
    if isinstance(shape, coal.Sphere):
        return [centre], float(shape.radius)
    longest = int(half.argmax())
    beside = np.delete(half, longest)
    is_capsule = isinstance(shape, coal.Capsule)
    across = float(shape.radius) if isinstance(shape, coal.Capsule | coal.Cylinder) and longest == 2 else 0.0
    if isinstance(shape, coal.ConvexBase):
        across = float(np.linalg.norm(np.delete(corners_of(shape) - centre, longest, axis=1), axis=1).max())
    across = across or float(np.linalg.norm(beside))
    along = float(shape.halfLength) if is_capsule else float(half[longest])
    count = min(max(round(along / max(across, 1e-9)), 1), MAX_SPHERES)
    reach = along / count
    radius_m = across + reach if is_capsule else float(np.hypot(across, reach))
    direction = np.eye(3)[longest]
    places = (np.arange(count) + 0.5) * 2 * reach - along
    return [centre + place * direction for place in places.tolist()], radius_m


def local_box(shape: Any) -> tuple[Array, Array]:
    """Return the centre and the half sides of the box of a shape in its own axes."""
    shape.computeLocalAABB()
    box = shape.aabb_local
    return np.array((box.max_ + box.min_) / 2), np.array((box.max_ - box.min_) / 2)
