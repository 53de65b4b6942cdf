"""The parts of a simulated cell, and what people do with them: fill a bin, stir it, empty a fixture."""

import math
from collections.abc import Iterator

import numpy as np

from services.trajectory_tool.physics.simulation import Simulation
from services.trajectory_tool.poses import Pose, Vector
from services.trajectory_tool.scene import OpenBox, Scene

DROP_FROM_M = 0.03
"""Parts fall into a bin from this height above its rim."""

FILLED_SHARE = 0.5
"""The share of the width of a bin, in its middle, in which parts are dropped."""

SETTLE_EACH_S = 0.3
AT_FIXTURE_M = 0.04


class Parts:
    """The loose parts; `seed` determines where they fall."""

    def __init__(self, simulation: Simulation, scene: Scene, seed: int) -> None:
        self._simulation = simulation
        self._scene = scene
        self._random = np.random.default_rng(seed)
        self._count = len(simulation.world.parts)

    @staticmethod
    def needed(scene: Scene) -> int:
        """Return how many parts a scene needs: one filling of the bins, the fixtures and the gripper."""
        return (
            2 * sum(len(bin_.parts) for bin_ in scene.bins.values())
            + sum(len(fixture.nests) for fixture in scene.fixtures.values())
            + 1
        )

    def fill(self, bin_name: str) -> None:
        """Drop new parts into a bin, if it is empty, and wait until they lie still."""
        if self.in_bin(bin_name):
            return
        walls = self._walls(bin_name)
        spare = [part for part in range(self._count) if self._simulation.is_parked(part)]
        spare += [part for part in range(self._count) if part not in spare and self._is_lost(part)]
        for part in spare[: len(self._scene.bins[bin_name].parts)]:
            x, y = self._random.uniform(-0.5, 0.5, 2) * FILLED_SHARE * np.array(walls.size[:2])
            quaternion = self._random.normal(size=4)
            a, b, c, d = (quaternion / np.linalg.norm(quaternion)).tolist()
            above = walls.pose.frame() @ Pose((x, y, walls.size[2] + DROP_FROM_M), (a, b, c, d)).frame()
            self._simulation.put(part, Pose.of(above))
            self._simulation.step_for(SETTLE_EACH_S)
        self._simulation.settle()

    def stir(self, bin_name: str) -> None:
        """Push the parts of a bin up and towards its middle, and wait until they lie still."""
        middle = np.array(self._walls(bin_name).position)
        for part in self.in_bin(bin_name):
            way = (middle - np.array(self._simulation.part_pose(part).position))[:2]
            push = 2.5 * way + self._random.uniform(-0.2, 0.2, 2)
            up = self._random.uniform(0.5, 0.8)
            self._simulation.push(part, (*push.tolist(), up), self._random.uniform(-6, 6, 3).tolist())
        self._simulation.settle()

    def clear(self, fixture: str) -> None:
        """Take the parts in a fixture away."""
        for part in self.in_fixture(fixture):
            self._simulation.park(part)

    def in_bin(self, bin_name: str) -> list[int]:
        """Return the parts that lie in a bin, the highest first."""
        walls = self._walls(bin_name)
        back = walls.pose.frame().inverse()
        width, depth, height = walls.size
        found = []
        for part, pose in self._present():
            x, y, z = (back @ pose.frame()).position
            if abs(x) < width / 2 and abs(y) < depth / 2 and 0 < z < height + 0.1:
                found.append((-z, part))
        return [part for _, part in sorted(found)]

    def in_fixture(self, fixture: str) -> list[int]:
        """Return the parts that lie at a nest of a fixture."""
        nests = [nest.position for nest in self._scene.fixtures[fixture].nests]
        return [part for part, pose in self._present() if any(_is_at(pose.position, nest) for nest in nests)]

    def _walls(self, bin_name: str) -> OpenBox:
        walls = self._scene.bins[bin_name].walls
        assert walls is not None  # noqa: S101 - checked when the robot is made
        return walls

    def _present(self) -> Iterator[tuple[int, Pose]]:
        for part in range(self._count):
            if not self._simulation.is_parked(part):
                yield part, self._simulation.part_pose(part)

    def _is_lost(self, part: int) -> bool:
        """Return whether a part lies neither in a bin nor in a fixture nor in the gripper."""
        return (
            part != self._simulation.gripped_part()
            and not any(part in self.in_bin(name) for name in self._scene.bins)
            and not any(part in self.in_fixture(name) for name in self._scene.fixtures)
        )


def _is_at(position: Vector, nest: Vector) -> bool:
    return math.dist(position[:2], nest[:2]) < AT_FIXTURE_M and abs(position[2] - nest[2]) < AT_FIXTURE_M
