"""What a person sees of an object: where it could be gripped, how the fingers would have to turn.

It is taken from the state of the simulation, without error; the errors of people are added in `operators`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handover_robots.model.poses import NO_TURN, Frame, Pose, Vector
from handover_robots.perception.depth_image import Array
from handover_robots.perception.grasps import Fingers
from handover_robots.perception.pinches import best_pinch
from handover_robots.physics.loose_objects import OBJECTS
from handover_robots.physics.simulation import Simulation
from handover_robots.scene.scene import OpenBox

SAMPLES = 7
"""Points along each side of a patch that are seen."""
PATCH_NEAR_M = 0.015
END_ABOVE_M = 0.001
"""Above what the cloth lies on: the ends of the fingers, which are beyond the tip of the URDF."""
INSIDE_SHARE = 0.9
"""The share of the mass of an object that has to be in the box."""


@dataclass(frozen=True, slots=True)
class FingerTarget:
    """Where the tips of the fingers should be, and the direction of closing (rad about z); None: any."""

    tips: Vector
    closing_rad: float | None
    bottom_m: float
    """The height of the lowest point."""


@dataclass(frozen=True, slots=True)
class _Spot:
    """A place on a patch of cloth, in the frame of the patch, and the direction of closing there."""

    patch: int
    place: Vector
    closing: Vector


class SeenObject:
    """An object of the scene in a simulation."""

    def __init__(self, simulation: Simulation, robot: str, name: str, fingers: Fingers) -> None:
        self._robot = robot
        self.name = name
        self._simulation = simulation
        self._part = simulation.world.objects[name]
        self._object = OBJECTS[name]
        self.is_cloth = self._object.is_cloth
        self._fingers = fingers
        self._spot: _Spot | None = None

    def look(self, offered: Pose | None = None) -> None:
        """Look for a place to grip: of cloth it stays the same, wherever that moves, until the next look.

        It is that of a grasp that is `offered`, if there is one.
        """
        if not self.is_cloth:
            return
        boxes = self._simulation.part_boxes(self._part)
        if offered is None:
            self._spot = self._pinch(boxes)
        else:
            x, y, _ = offered.position
            rows = offered.frame().rotation
            self._spot = _spot_at((x, y), math.atan2(rows[1][1], rows[0][1]), boxes)  # fingers close along y

    def target(self) -> FingerTarget:
        """Return where the fingers should grip: around the middle, or at the chosen place of cloth."""
        boxes = self._simulation.part_boxes(self._part)
        positions = np.array([pose.position for pose, _ in boxes])
        bottom = min(pose.position[2] - _reach(pose, size) for pose, size in boxes)
        if self.is_cloth:
            if self._spot is None:
                self._spot = self._pinch(boxes)
            return self._at_spot(self._spot, boxes, bottom)
        x, y, z = self.middle()
        if len(boxes) > 1:  # long: across it
            way = positions[-1] - positions[0]
            return FingerTarget((x, y, z - 0.004), math.atan2(way[1], way[0]) + math.pi / 2, bottom)
        pose, size = boxes[0]
        if len(set(size)) == 1 and self.name != "cube":
            return FingerTarget((x, y, z - 0.004), None, bottom)
        axes = np.array(pose.frame().rotation)
        flat = min(range(3), key=lambda axis: abs(float(axes[2, axis])))
        return FingerTarget((x, y, z - 0.004), math.atan2(axes[1, flat], axes[0, flat]), bottom)

    def _pinch(self, boxes: Sequence[tuple[Pose, Vector]]) -> _Spot:
        """Choose a place where the fingers find room on both sides of cloth; else its highest patch."""
        points = np.vstack([_surface(pose, size) for pose, size in boxes])
        pinch = best_pinch(points, self._fingers)
        if pinch is None:
            patch = max(
                range(len(boxes)), key=lambda number: boxes[number][0].position[2] + _reach(*boxes[number])
            )
            return _Spot(patch, (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))
        return _spot_at(pinch.place, pinch.closing_rad, boxes)

    def _at_spot(self, spot: _Spot, boxes: Sequence[tuple[Pose, Vector]], bottom_m: float) -> FingerTarget:
        frame = boxes[spot.patch][0].frame()
        x, y, _ = (frame @ Frame(NO_TURN, spot.place)).position
        closing = np.array(frame.rotation) @ spot.closing
        near = [
            pose.position[2] - _reach(pose, size)
            for pose, size in boxes
            if math.dist(pose.position[:2], (x, y)) < PATCH_NEAR_M + max(size) / 2
        ]
        end = min(near, default=bottom_m) + END_ABOVE_M
        return FingerTarget(
            (x, y, end + self._fingers.frame.position[2]), math.atan2(closing[1], closing[0]), bottom_m
        )

    def middle(self) -> Vector:
        """Return the middle of the mass."""
        masses = self._simulation.part_masses(self._part)
        total = sum(mass for _, mass in masses)
        x, y, z = (sum(mass * at[axis] for at, mass in masses) / total for axis in range(3))
        return (x, y, z)

    def is_between_fingers(self) -> bool:
        """Return whether both fingers touch it."""
        return self._simulation.gripped_part(self._robot) == self._part

    def is_in(self, box: OpenBox) -> bool:
        """Return whether it lies in a box, and no finger touches it."""
        if self._simulation.is_touched(self._part):
            return False
        back, (width, depth, height) = box.pose.frame().inverse(), box.size
        inside = total = 0.0
        for at, mass in self._simulation.part_masses(self._part):
            x, y, z = np.array(back.rotation) @ np.array(at) + np.array(back.position)
            total += mass
            if abs(x) < width / 2 and abs(y) < depth / 2 and 0 < z < height:
                inside += mass
        return inside >= INSIDE_SHARE * total


def _reach(pose: Pose, size: Vector) -> float:
    """Return how far a box reaches above and below its middle."""
    rows = pose.frame().rotation
    return sum(abs(row) * side for row, side in zip(rows[2], size, strict=True)) / 2


def _surface(pose: Pose, size: Vector) -> Array:
    """Return points over a box: N x 3, in the cell."""
    along = np.linspace(-0.5, 0.5, SAMPLES)
    x, y = (coordinates.ravel() for coordinates in np.meshgrid(along * size[0], along * size[1]))
    frame = pose.frame()
    local = np.stack([x, y, np.zeros_like(x)], axis=1)
    return np.asarray(local @ np.array(frame.rotation).T + np.array(frame.position))


def _spot_at(place: tuple[float, float], closing_rad: float, boxes: Sequence[tuple[Pose, Vector]]) -> _Spot:
    """Return the spot of the patch that is nearest to a place, with its direction of closing."""
    patch = min(range(len(boxes)), key=lambda number: math.dist(boxes[number][0].position[:2], place))
    pose = boxes[patch][0]
    back = pose.frame().inverse()
    at = (back @ Frame(NO_TURN, (*place, pose.position[2]))).position
    closing = np.array(back.rotation) @ (math.cos(closing_rad), math.sin(closing_rad), 0.0)
    x, y, z = closing.tolist()
    return _Spot(patch, at, (x, y, z))
