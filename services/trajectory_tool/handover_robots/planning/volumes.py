"""The volume that a robot occupies, as obstacles for the others: at rest, or on the way of a motion.

A swept volume consists of copies of each link along the motion. A copy is kept wherever the link has moved
by half of `STEP_M` since the last one, and each is larger by `STEP_M`, so the copies cover what lies between.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from handover_robots.model.joint_trajectory import JointTrajectory
from handover_robots.model.joints import Joints
from handover_robots.model.obstacles import Attached, Box, Capsule, Cylinder, Obstacle, Shape, Sphere
from handover_robots.planning.arm import Arm, pose_of, se3_of
from handover_robots.planning.collision import geometry_of, link_of

STEP_M = 0.08
SAMPLE_EVERY_S = 0.01


@dataclass(frozen=True, slots=True)
class _Part:
    """A shape that moves with a joint (0: the base), at a fixed placement; no point is beyond `radius_m`."""

    name: str
    joint: int
    placement: Any
    shape: Shape
    radius_m: float


def occupied(
    name: str, arm: Arm, joints: Joints, attached: Sequence[Attached], clearance_m: float
) -> Iterator[Obstacle]:
    """Yield the links of the robot `name` at rest, each larger by `clearance_m`."""
    pin.forwardKinematics(arm.pin_model, arm.data, np.array(joints))
    for part in _parts(arm, attached):
        placement = arm.data.oMi[part.joint] * part.placement
        yield Obstacle(f"{name} {part.name}", grown(part.shape, clearance_m), pose_of(placement))


def swept(
    name: str, arm: Arm, trajectory: JointTrajectory, attached: Sequence[Attached], clearance_m: float
) -> Iterator[Obstacle]:
    """Yield obstacles that cover the links of the robot `name` along a motion, and `clearance_m` more."""
    parts = list(_parts(arm, attached))
    larger = [grown(part.shape, STEP_M + clearance_m) for part in parts]
    kept: list[Any] = [None] * len(parts)
    for joints in trajectory.positions(SAMPLE_EVERY_S):
        pin.forwardKinematics(arm.pin_model, arm.data, joints)
        for number, part in enumerate(parts):
            placement = arm.data.oMi[part.joint] * part.placement
            if kept[number] is None or _moved_m(kept[number], placement, part.radius_m) > STEP_M / 2:
                kept[number] = placement
                yield Obstacle(f"{name} {part.name}", larger[number], pose_of(placement))


def grown(shape: Shape, by_m: float) -> Shape:
    """Return a shape that contains every point within `by_m` of another one."""
    match shape:
        case Box((width, depth, height)):
            return Box((width + 2 * by_m, depth + 2 * by_m, height + 2 * by_m))
        case Cylinder(radius, length):
            return Cylinder(radius + by_m, length + 2 * by_m)
        case Capsule(radius, length):
            return Capsule(radius + by_m, length)
        case Sphere(radius):
            return Sphere(radius + by_m)
        case _:
            raise ValueError("a mesh has no larger copy")


def _parts(arm: Arm, attached: Sequence[Attached]) -> Iterator[_Part]:
    """Yield everything that moves with the robot, and its base."""
    for item in arm.solids.geometryObjects:
        shape, local = plain(item.geometry)
        item.geometry.computeLocalAABB()
        radius_m = float(item.geometry.aabb_radius)
        yield _Part(link_of(item.name), item.parentJoint, item.placement * local, shape, radius_m)
    tip = arm.pin_model.frames[arm.tip]
    for thing in attached:
        geometry = geometry_of(thing.shape)
        geometry.computeLocalAABB()
        placement = tip.placement * se3_of(thing.pose)
        yield _Part(thing.name, tip.parentJoint, placement, thing.shape, float(geometry.aabb_radius))


def plain(shape: Any) -> tuple[Shape, Any]:
    """Return a shape of coal as a value, and its pose in its own frame; a hull is replaced by its box."""
    here = pin.SE3.Identity()
    match shape:
        case coal.Box():
            x, y, z = (2 * shape.halfSide).tolist()
            return Box((x, y, z)), here
        case coal.Capsule():
            return Capsule(float(shape.radius), 2 * float(shape.halfLength)), here
        case coal.Cylinder():
            return Cylinder(float(shape.radius), 2 * float(shape.halfLength)), here
        case coal.Sphere():
            return Sphere(float(shape.radius)), here
    shape.computeLocalAABB()
    box = shape.aabb_local
    x, y, z = (box.max_ - box.min_).tolist()
    here.translation = (box.max_ + box.min_) / 2
    return Box((x, y, z)), here


def _moved_m(before: Any, now: Any, radius_m: float) -> float:
    """Return how far a point within `radius_m` of the centre of a shape has moved at most."""
    turned = float(np.linalg.norm(pin.log3(before.rotation.T @ now.rotation)))
    return float(np.linalg.norm(now.translation - before.translation)) + turned * radius_m
