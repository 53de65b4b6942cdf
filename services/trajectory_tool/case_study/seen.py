"""What a person sees of an object: where it could be gripped, how the fingers would have to turn.

It is taken from the state of the simulation, without error; the errors of people are added in `operators`.
"""

import math
from dataclasses import dataclass

import numpy as np

from services.trajectory_tool.physics.loose_objects import OBJECTS
from services.trajectory_tool.physics.simulation import Simulation
from services.trajectory_tool.poses import Vector
from services.trajectory_tool.scene import OpenBox

PATCH_NEAR_M = 0.03
INSIDE_SHARE = 0.9
"""The share of the mass of an object that has to be in the box."""


@dataclass(frozen=True, slots=True)
class Target:
    """Where the tips of the fingers should be, and the direction of closing (rad about z); None: any."""

    tips: Vector
    closing_rad: float | None
    top_m: float


class SeenObject:
    """An object of the scene in a simulation."""

    def __init__(self, simulation: Simulation, robot: str, name: str) -> None:
        self._robot = robot
        self.name = name
        self._simulation = simulation
        self._part = simulation.world.objects[name]
        self._object = OBJECTS[name]

    def target(self) -> Target:
        """Return where the fingers should grip: around the middle, or at the highest fold of cloth."""
        boxes = self._simulation.part_boxes(self._part)
        positions = np.array([pose.position for pose, _ in boxes])
        reaches = [
            sum(abs(row) * side for row, side in zip(pose.frame().rotation[2], size, strict=True)) / 2
            for pose, size in boxes
        ]
        tops = positions[:, 2] + reaches
        top = float(tops.max())
        if self._object.is_cloth:
            x, y, _ = positions[int(tops.argmax())].tolist()
            near = np.linalg.norm(positions[:, :2] - (x, y), axis=1) < PATCH_NEAR_M
            bottom = float(positions[near, 2].min())
            return Target((x, y, bottom + 0.005), None, top)
        x, y, z = self.middle()
        if len(boxes) > 1:  # long: across it
            way = positions[-1] - positions[0]
            return Target((x, y, z - 0.004), math.atan2(way[1], way[0]) + math.pi / 2, top)
        pose, size = boxes[0]
        if len(set(size)) == 1 and self.name != "cube":
            return Target((x, y, z - 0.004), None, top)
        axes = np.array(pose.frame().rotation)
        flat = min(range(3), key=lambda axis: abs(float(axes[2, axis])))
        return Target((x, y, z - 0.004), math.atan2(axes[1, flat], axes[0, flat]), top)

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
