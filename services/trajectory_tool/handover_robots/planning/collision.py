"""Checks of a robot among obstacles with coal, by way of pinocchio.

A check computes the forward kinematics, compares bounding boxes and then the shapes of the pairs that are
near, all in one call. The margin of a check is a part of the request of each pair, so there is one set of
requests for each margin; sets are made when they are first used.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from handover.errors import UsageError
from handover_robots.model.obstacles import (
    Attached,
    Box,
    Capsule,
    Cylinder,
    Mesh,
    Obstacle,
    Shape,
    Sphere,
    World,
)
from handover_robots.planning.arm import Arm, Array, se3_of
from handover_robots.planning.bounds import DistanceBounds
from handover_robots.planning.mesh_files import load_mesh, mesh_fault

NAIVE_MAX_GEOMETRIES = 150
"""With more geometries, sweep and prune is faster than comparing all bounding boxes."""


@dataclass(frozen=True, slots=True)
class Clearance:
    """The distance between two things in m, negative when they penetrate."""

    first: str
    second: str
    distance_m: float


NOTHING_NEAR = Clearance("robot", "nothing", math.inf)


class _Checks:
    """The requests of all pairs, each with a margin."""

    def __init__(self, model: Any, geometry: Any, margins_m: Array) -> None:
        self.data = pin.GeometryData(geometry)
        for request, margin_m in zip(self.data.collisionRequests, margins_m.tolist(), strict=True):
            request.security_margin = margin_m
        few = geometry.ngeoms <= NAIVE_MAX_GEOMETRIES
        manager = (
            pin.BroadPhaseManager_NaiveCollisionManager if few else pin.BroadPhaseManager_SSaPCollisionManager
        )
        self.broad = manager(model, geometry, self.data)
        self.callback = pin.CollisionCallBackDefault(geometry, self.data, True)


SHAPE_EXCESS_M = 1e-3
"""How much nearer than their meshes the shapes of two links may be: twice the tolerance of polytopes.

Between two links this is taken off a margin, to not less than half of it: what is free by the meshes with
the smallest margin is not refused. Shapes enclose the meshes, so that links which are allowed never touch.
"""
MANY_SHARE = 0.2
"""From this fraction of the pairs on, it costs less to compute all distances in one call."""


class Collisions:
    """The robot in a world. Not thread-safe. Raises `UsageError` for a mesh that cannot be used."""

    def __init__(self, arm: Arm, world: World) -> None:
        self.arm = arm
        self.world = world
        self.geometry, self._names = _joined(arm, world)
        self._checks: dict[tuple[float, float], _Checks] = {}
        self._exact: Any = None
        self.checked = 0
        """The number of checked configurations, for measurements."""
        items = self.geometry.geometryObjects
        reaches = np.array([arm.reach_of(item) for item in items]).reshape(-1, arm.n)
        self.reach = reaches.max(axis=0, initial=0.0)
        """How far any point moves at most for 1 rad (or 1 m) of each joint."""
        self.approaches = self._approaches(reaches)
        """How far the two geometries of each pair approach at most for 1 rad (or 1 m) of each joint."""
        travels = self.approaches / np.maximum(self.reach, 1e-9)
        self._shares = travels.max(axis=1, initial=0.0)
        """For each pair, how much of the travel of a motion the pair approaches at most."""
        self._lower_bounds = DistanceBounds(arm, self.geometry)
        links = len(arm.geometry.geometryObjects)
        self._is_own = np.array(
            [pair.first < links and pair.second < links for pair in self.geometry.collisionPairs], bool
        )
        """Whether each pair is of two links."""

    @property
    def pairs(self) -> int:
        """Return the number of pairs that are checked."""
        return len(self.geometry.collisionPairs)

    def is_free(self, joints: Array, margin_m: float = 0.0) -> bool:
        """Return whether everything is farther apart than `margin_m`, two links `SHAPE_EXCESS_M` less."""
        return self.is_free_within(joints, 0.0, margin_m)

    def is_free_within(self, joints: Array, travel_m: float, margin_m: float) -> bool:
        """Return whether no motion with a travel of `travel_m` from here leads to a contact.

        Also, everything is farther apart than `margin_m` here. A pair needs a margin of the share of the
        travel that the pair can approach by.
        """
        checks = self._checks.get((travel_m, margin_m))
        if checks is None:
            own_m = max(margin_m - SHAPE_EXCESS_M, margin_m / 2)
            margins = np.maximum(self._shares * travel_m, np.where(self._is_own, own_m, margin_m))
            checks = _Checks(self.arm.pin_model, self.geometry, margins)
            self._checks[(travel_m, margin_m)] = checks
        self.checked += 1
        return not pin.computeCollisions(
            self.arm.pin_model, self.arm.data, checks.broad, checks.callback, joints
        )

    def travel_m(self, start: Array, end: Array) -> float:
        """Return how far any point moves at most between two configurations on a straight line."""
        return float(self.reach @ np.abs(end - start))

    def closest(self, joints: Array) -> Clearance:
        """Return the closest pair of a configuration.

        The pair with the lowest bound is computed, and its bound replaced by its distance, until the lowest
        is a distance. With a contact all pairs are computed, since bounds say nothing about penetration.
        """
        if not self.pairs:
            return NOTHING_NEAR
        self._place(joints)
        bounds = self._lower_bounds()
        computed: set[int] = set()
        while (number := int(bounds.argmin())) not in computed:
            bounds[number] = self._distance_m(number)
            computed.add(number)
        if bounds[number] <= 0:
            number = self.closest_index(joints)
            return self.clearance(number, float(self._distance_data().distanceResults[number].min_distance))
        return self.clearance(number, float(bounds[number]))

    def distances(self, joints: Array) -> list[Clearance]:
        """Return the distances of all pairs that are checked; empty without any."""
        data = self._distance_data()
        pin.computeDistances(self.arm.pin_model, self.arm.data, self.geometry, data, joints)
        names = self._names
        clearances = [
            Clearance(names[pair.first], names[pair.second], result.min_distance)
            for pair, result in zip(self.geometry.collisionPairs, data.distanceResults, strict=True)
        ]
        return clearances or [NOTHING_NEAR]

    def within(self, joints: Array, horizon_m: float) -> list[Clearance]:
        """Return the exact distances of the pairs that are nearer than `horizon_m`, at least 0, in any order.

        The other pairs are farther apart by their lower bounds, which cost a tenth of the distances.
        """
        if not self.pairs:
            return []
        self._place(joints)
        near = np.flatnonzero(self._lower_bounds() < horizon_m).tolist()
        if len(near) > MANY_SHARE * self.pairs:
            self.closest_index(joints)
            results = self._distance_data().distanceResults
            distances_m = [float(results[number].min_distance) for number in near]
        else:
            distances_m = [self._distance_m(number) for number in near]
        return [
            self.clearance(number, distance_m)
            for number, distance_m in zip(near, distances_m, strict=True)
            if distance_m < horizon_m
        ]

    def closest_index(self, joints: Array) -> int:
        """Compute the distances of all pairs, and return the number of the closest."""
        data = self._distance_data()
        return int(pin.computeDistances(self.arm.pin_model, self.arm.data, self.geometry, data, joints))

    def _place(self, joints: Array) -> None:
        pin.updateGeometryPlacements(
            self.arm.pin_model, self.arm.data, self.geometry, self._distance_data(), joints
        )

    def _distance_m(self, number: int) -> float:
        return float(pin.computeDistance(self.geometry, self._distance_data(), number).min_distance)

    def clearance(self, number: int, distance_m: float) -> Clearance:
        """Return a distance with the names of its pair."""
        pair = self.geometry.collisionPairs[number]
        return Clearance(self._names[pair.first], self._names[pair.second], distance_m)

    def contacts(self, joints: Array, margin_m: float = 0.0) -> list[Clearance]:
        """Return the pairs within `margin_m`, the closest first, one for each two things."""
        near: dict[tuple[str, str], Clearance] = {}
        beyond_m = math.nextafter(margin_m, math.inf)
        for pair in sorted(self.within(joints, beyond_m), key=lambda pair: pair.distance_m):
            near.setdefault((pair.first, pair.second), pair)
        return list(near.values())

    def _approaches(self, reaches: Array) -> Array:
        """Return a row for each pair: only the joints between two geometries change their distance.

        Each joint does by the reach of the outer geometry.
        """
        items = self.geometry.geometryObjects
        rows = np.zeros((self.pairs, self.arm.n))
        for row, pair in zip(rows, self.geometry.collisionPairs, strict=True):
            inner, outer = sorted((pair.first, pair.second), key=lambda number: items[number].parentJoint)
            first = items[inner].parentJoint
            row[first:] = reaches[outer][first:]
        return rows

    def _distance_data(self) -> Any:
        if self._exact is None:
            self._exact = pin.GeometryData(self.geometry)
        return self._exact


def geometry_of(shape: Shape) -> Any:
    """Return the shape for coal. Raises `UsageError` for a mesh that cannot be used."""
    match shape:
        case Box(size):
            return coal.Box(*map(float, size))
        case Cylinder(radius, length):
            return coal.Cylinder(float(radius), float(length))
        case Capsule(radius, length):
            return coal.Capsule(float(radius), float(length))
        case Sphere(radius):
            return coal.Sphere(float(radius))
        case Mesh(file, scale):
            return _hull(file, scale)


def _hull(file: Path, scale: tuple[float, float, float]) -> Any:
    mesh = load_mesh(file, np.array(scale))
    try:
        mesh.buildConvexHull(True, "Qt")
    except (ValueError, RuntimeError) as error:
        raise UsageError(f"the mesh {file} cannot be used: {mesh_fault(error)}") from None
    return mesh.convex


def _joined(arm: Arm, world: World) -> tuple[Any, list[str]]:
    """Return the geometry of robot and world with its pairs, and a name for each geometry."""
    geometry = arm.geometry.copy()
    names = [link_of(item.name) for item in geometry.geometryObjects]
    moving = [number for number, item in enumerate(geometry.geometryObjects) if item.parentJoint > 0]
    own = len(names)
    tip = arm.pin_model.frames[arm.tip]
    for attached in world.attached:
        placement = tip.placement * se3_of(attached.pose)
        _add(geometry, attached, tip.parentJoint, placement)
        names.append(attached.name)
    carried = list(range(own, len(names)))
    for obstacle in world.obstacles:
        _add(geometry, obstacle, 0, se3_of(obstacle.pose))
        names.append(obstacle.name)
    around = range(own + len(carried), len(names))
    disabled = arm.model.disabled_pairs
    for first in range(own):
        for second in range(first + 1, own):
            if _may_collide(arm, names[first], names[second], disabled):
                geometry.addCollisionPair(pin.CollisionPair(first, second))
    for held in carried:
        for link in range(own):
            far = tip.parentJoint - arm.joint_of_link(names[link]) > 1
            if far and not world.may_touch(names[held], names[link]):
                geometry.addCollisionPair(pin.CollisionPair(link, held))
    for number in (*moving, *carried):
        for other in around:
            if not world.may_touch(names[number], names[other]):
                geometry.addCollisionPair(pin.CollisionPair(number, other))
    return geometry, names


def link_of(geometry_name: str) -> str:
    """Return the link of a geometry: pinocchio names it by the link and a number."""
    return geometry_name.rsplit("_", 1)[0]


def _add(geometry: Any, solid: Obstacle | Attached, joint: int, placement: Any) -> None:
    name = f"{solid.name}_{geometry.ngeoms}"
    item = pin.GeometryObject(name, joint, placement, geometry_of(solid.shape))
    geometry.addGeometryObject(item)


def _may_collide(arm: Arm, first: str, second: str, disabled: frozenset[frozenset[str]]) -> bool:
    """Return whether two links can collide: they do not share a joint, and the SRDF does not disable them."""
    apart = abs(arm.joint_of_link(first) - arm.joint_of_link(second))
    return apart > 1 and frozenset((first, second)) not in disabled
