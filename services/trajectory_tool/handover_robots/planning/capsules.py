"""Capsules around the links of a robot, and around what its tool carries."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from handover_robots.model.obstacles import Attached, Box, Capsule, Cylinder, Shape, Sphere
from handover_robots.model.robot_model import RobotModel
from handover_robots.planning.arm import Arm, Array, corners_of, se3_of
from handover_robots.planning.collision import geometry_of
from handover_robots.planning.volumes import plain


@dataclass(frozen=True, slots=True)
class _Moved:
    """Capsules, each at a joint (0: the base): ends in the frame of the joint, radii, and reaches.

    `reaches` has a row for each capsule: how far a point of it moves at most for 1 rad of each joint.
    """

    joints: list[int]
    starts: Array
    ends: Array
    radii: Array
    reaches: Array


class LinkCapsules:
    """The capsules of a robot; used by one thread at a time."""

    def __init__(self, model: RobotModel) -> None:
        self._arm = arm = Arm(model)
        self.centre = np.array(arm.pin_model.jointPlacements[1].translation)
        """The first joint, in the frame of the cell."""
        self.reach_m = 0.0
        """No point is farther from `centre`."""
        self._items = list(arm.geometry.geometryObjects)
        self._attached: tuple[Attached, ...] | None = None
        self.attach(())

    def attach(self, attached: tuple[Attached, ...]) -> None:
        """Set what the tool carries."""
        if attached == self._attached:
            return
        self._attached = attached
        arm, items = self._arm, list(self._items)
        tip = arm.pin_model.frames[arm.tip]
        for thing in attached:
            placement = tip.placement * se3_of(thing.pose)
            items.append(pin.GeometryObject(thing.name, tip.parentJoint, placement, geometry_of(thing.shape)))
        self._moved = _moved(arm, items)
        self.reach_m = max(self._reach_m(item, number) for number, item in enumerate(items))

    def within(self, lower: Array, upper: Array) -> tuple[Array, Array, Array]:
        """Return starts, ends and radii of capsules that cover the robot in all positions of a box."""
        arm, moved = self._arm, self._moved
        pin.forwardKinematics(arm.pin_model, arm.data, (lower + upper) / 2)
        frames = [arm.data.oMi[joint] for joint in range(arm.pin_model.njoints)]
        turns = np.array([frame.rotation for frame in frames])[moved.joints]
        places = np.array([frame.translation for frame in frames])[moved.joints]
        starts = np.einsum("nij,nj->ni", turns, moved.starts) + places
        ends = np.einsum("nij,nj->ni", turns, moved.ends) + places
        return starts, ends, moved.radii + moved.reaches @ ((upper - lower) / 2)

    def _reach_m(self, item: Any, number: int) -> float:
        moved, placements = self._moved, self._arm.pin_model.jointPlacements
        joint = item.parentJoint
        origin = self.centre if joint == 0 else np.zeros(3)
        ends = (moved.starts[number] - origin, moved.ends[number] - origin)
        far = float(moved.radii[number] + max(np.linalg.norm(end) for end in ends))
        while joint > 1:
            joint_range = np.array([self._arm.lower[joint - 1], self._arm.upper[joint - 1]])
            far += float(np.linalg.norm(placements[joint].translation))
            far += 0.0 if self._arm.is_turning[joint - 1] else float(np.abs(joint_range).max())
            joint -= 1
        if not self._arm.is_turning[0]:
            far += float(np.abs([self._arm.lower[0], self._arm.upper[0]]).max())
        return float(far)


def _moved(arm: Arm, items: Sequence[Any]) -> _Moved:
    starts, ends, radii = [], [], []
    for item in items:
        placement = item.placement
        if isinstance(item.geometry, coal.ConvexBase):
            start, end, radius = _around(corners_of(item.geometry))
        else:
            shape, local = plain(item.geometry)
            start, end, radius = _capsule(shape)
            placement = placement * local
        starts.append(placement.act(start))
        ends.append(placement.act(end))
        radii.append(radius)
    reaches = np.array([arm.reach_of(item) for item in items]).reshape(-1, arm.n)
    joints = [item.parentJoint for item in items]
    return _Moved(joints, np.array(starts), np.array(ends), np.array(radii), reaches)


def _around(corners: Array) -> tuple[Array, Array, float]:
    """Return the ends and the radius of the smallest capsule along an axis of the frame."""
    capsules = []
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    for axis in np.eye(3):
        along = (corners - middle) @ axis
        squared = np.maximum(((corners - middle) ** 2).sum(axis=1) - along**2, 0.0)
        largest = float(squared.max())
        # The half spheres at the ends cover as much as each corner leaves room.
        half = max(float((np.abs(along) - np.sqrt(largest - squared)).max()), 0.0)
        radius = math.sqrt(largest)
        volume = largest * (half + 2 / 3 * radius)
        capsules.append((volume, middle - half * axis, middle + half * axis, radius))
    _, start, end, radius = min(capsules, key=lambda capsule: capsule[0])
    return start, end, radius


def _capsule(shape: Shape) -> tuple[Array, Array, float]:
    """Return the ends and the radius of a capsule that contains a shape."""
    match shape:
        case Capsule(radius, length) | Cylinder(radius, length):
            end = np.array([0.0, 0.0, length / 2])
            return -end, end, radius
        case Sphere(radius):
            return np.zeros(3), np.zeros(3), radius
        case Box(size):
            longest = int(np.argmax(size))
            across = [side / 2 for number, side in enumerate(size) if number != longest]
            end = np.zeros(3)
            end[longest] = size[longest] / 2
            return -end, end, math.hypot(*across)
        case _:
            raise ValueError("a mesh has no capsule")
