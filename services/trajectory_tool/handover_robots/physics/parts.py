"""The parts of a simulated cell, and what people do with them: fill a bin, stir it, empty a fixture.

What takes time is a generator of the times in s that pass before it continues; see `Simulation.run`.
"""

import math
from collections.abc import Iterator

import numpy as np

from handover_robots.model.poses import Pose, Vector
from handover_robots.physics.simulation import Simulation
from handover_robots.scene.scene import OpenBox, Scene

DROP_FROM_M = 0.03
"""Parts fall into a bin from this height above its rim."""

FILLED_SHARE = 0.5
"""The share of the width of a bin, in its middle, in which parts are dropped."""

DROPPED_SHARE = 0.3
CRUMPLED_RAD = 0.7
"""An object is dropped within this share of the width of a bin; the hinges of cloth are bent by this much."""

SETTLE_EACH_S = 0.3
AT_FIXTURE_M = 0.04


class Parts:
    """The loose parts; `seed` determines where they fall."""

    def __init__(self, simulation: Simulation, scene: Scene, seed: int) -> None:
        self._simulation = simulation
        self._scene = scene
        self._random = np.random.default_rng(seed)
        self._count = self._boxes()

    def _boxes(self) -> int:
        """Return the number of parts that are boxes; the objects come after them."""
        return len(self._simulation.world.parts) - len(self._simulation.world.objects)

    def use(self, scene: Scene) -> list[str]:
        """Continue in another scene; return its bins that are new."""
        before, self._scene = self._scene, scene
        self._count = self._boxes()
        return [name for name in scene.bins if name not in before.bins]

    @staticmethod
    def needed(scene: Scene) -> int:
        """Return how many parts a scene needs: one filling of the bins, the fixtures and the gripper."""
        return (
            2 * sum(len(bin_.parts) for bin_ in scene.bins.values())
            + sum(len(fixture.nests) for fixture in scene.fixtures.values())
            + 1
        )

    def fill(self, bin_name: str) -> Iterator[float]:
        """Drop new parts into a bin, if it is empty, and wait until they lie still."""
        if self.in_bin(bin_name):
            return
        walls = self._walls(bin_name)
        for part in self._spare()[: len(self._scene.bins[bin_name].parts)]:
            x, y = self._random.uniform(-0.5, 0.5, 2) * FILLED_SHARE * np.array(walls.size[:2])
            quaternion = self._random.normal(size=4)
            a, b, c, d = (quaternion / np.linalg.norm(quaternion)).tolist()
            above = walls.pose.frame() @ Pose((x, y, walls.size[2] + DROP_FROM_M), (a, b, c, d)).frame()
            self._simulation.put(part, Pose.of(above))
            yield SETTLE_EACH_S
        for name in self._scene.bins[bin_name].objects:
            self._drop(self._simulation.world.objects[name], walls)
            yield SETTLE_EACH_S
        yield from self._simulation.settling()

    def _drop(self, part: int, walls: OpenBox) -> None:
        """Drop an object that lies as it may, cloth crumpled."""
        x, y = self._random.uniform(-0.5, 0.5, 2) * DROPPED_SHARE * np.array(walls.size[:2])
        half = self._random.uniform(-math.pi, math.pi) / 2
        upright = Pose((x, y, walls.size[2] + DROP_FROM_M), (0.0, 0.0, math.sin(half), math.cos(half)))
        at = walls.pose.frame() @ upright.frame()
        self._simulation.put(part, Pose.of(at))
        self._simulation.bend(part, self._random, CRUMPLED_RAD)
        above_m = self._simulation.lowest_m(part) - at.position[2]
        if above_m < 0:  # a sleeve that hangs down would begin inside of the table
            self._simulation.move(part, (0.0, 0.0, -above_m))

    def stir(self, bin_name: str) -> Iterator[float]:
        """Push the parts of a bin up and towards its middle, and wait until they lie still."""
        middle = np.array(self._walls(bin_name).position)
        gripped = self._simulation.gripped_parts()
        for part in self.in_bin(bin_name):
            if part in gripped:
                continue
            way = (middle - np.array(self._simulation.part_pose(part).position))[:2]
            push = 2.5 * way + self._random.uniform(-0.2, 0.2, 2)
            up = self._random.uniform(0.5, 0.8)
            self._simulation.push(part, (*push.tolist(), up), self._random.uniform(-6, 6, 3).tolist())
        yield from self._simulation.settling()

    def hold_out(self, pose: Pose) -> int | None:
        """Hold a part at a pose, where it stays until `let_go`; return it, None if all are in use."""
        part = next(iter(self._spare()), None)
        if part is not None:
            self._simulation.put(part, pose, is_held=True)
        return part

    def let_go(self, part: int) -> Iterator[float]:
        """Let go of a part that was held out, and wait until it has fallen or stays in a gripper."""
        self._simulation.let_go(part)
        yield SETTLE_EACH_S

    def clear(self, fixture: str) -> None:
        """Take the parts in a fixture away."""
        for part in self.in_fixture(fixture):
            self._simulation.park(part)

    def in_bin(self, bin_name: str) -> list[int]:
        """Return the parts that lie in a bin, the highest first."""
        walls = self._walls(bin_name)
        back = walls.pose.frame().inverse()
        width, depth, height = walls.size
        heights = []
        for part, pose in self._present():
            x, y, z = (back @ pose.frame()).position
            if abs(x) < width / 2 and abs(y) < depth / 2 and 0 < z < height + 0.1:
                heights.append((-z, part))
        return [part for _, part in sorted(heights)]

    def in_fixture(self, fixture: str) -> list[int]:
        """Return the parts that lie at a nest of a fixture."""
        nests = [nest.position for nest in self._scene.fixtures[fixture].nests]
        return [part for part, pose in self._present() if any(_is_at(pose.position, nest) for nest in nests)]

    def _walls(self, bin_name: str) -> OpenBox:
        walls = self._scene.bins[bin_name].walls
        assert walls is not None  # noqa: S101 - checked when the robot is made
        return walls

    def _present(self) -> Iterator[tuple[int, Pose]]:
        for part in range(len(self._simulation.world.parts)):
            if not self._simulation.is_parked(part):
                yield part, self._simulation.part_pose(part)

    def _spare(self) -> list[int]:
        """Return the boxes that nobody needs: those outside of the cell, then those that are lost in it."""
        parked = [part for part in range(self._count) if self._simulation.is_parked(part)]
        return parked + [part for part in range(self._count) if part not in parked and self._is_lost(part)]

    def _is_lost(self, part: int) -> bool:
        """Return whether a part lies neither in a bin nor in a fixture nor in a gripper."""
        return (
            part not in self._simulation.gripped_parts()
            and not any(part in self.in_bin(name) for name in self._scene.bins)
            and not any(part in self.in_fixture(name) for name in self._scene.fixtures)
        )


def _is_at(position: Vector, nest: Vector) -> bool:
    return math.dist(position[:2], nest[:2]) < AT_FIXTURE_M and abs(position[2] - nest[2]) < AT_FIXTURE_M
