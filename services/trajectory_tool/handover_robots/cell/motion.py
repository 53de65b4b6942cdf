"""The planner of a robot in its cell: its world is the scene, the other robots and the part in the gripper.

A scene with obstacles is planned in, with the extra `motion`, and so is every cell with several robots.
Planning runs in a thread, one plan at a time in a cell.

Each robot occupies a volume: its links where they are, or, during a motion, everything that they sweep on the
way. A plan is made among the volumes of the others and its own volume is reserved before the next plan is
made. So no two motions can meet, whatever their timing. A robot whose way is blocked by another one waits
until that volume changes.
"""

import asyncio
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

from handover.distribution import install_command
from handover.errors import UsageError
from handover.messages import text_of
from handover_robots.model.faults import NoPath, Unreachable
from handover_robots.model.joints import Joints
from handover_robots.model.obstacles import Attached, Box, Obstacle, World
from handover_robots.model.poses import Pose
from handover_robots.model.robot_model import RobotModel
from handover_robots.model.trajectory import Limits
from handover_robots.planning import is_available
from handover_robots.scene.contents import Grip
from handover_robots.scene.scene import Scene

if TYPE_CHECKING:
    from handover_robots.planning.planner import Plan, Planner

T = TypeVar("T")

AT_TIP = Pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
INSTALL = f"install the extra: {install_command('motion')}"
GRIP_TOLERANCE_M = 0.004
"""A part that was seen is held this exactly; it lies on something when it is gripped."""

CLEARANCE_M = 0.03
"""The additional distance from another robot."""


class BlockedByNeighbour(NoPath):
    """Only another robot is in the way; a later attempt may succeed."""


class SharedSpace:
    """The planners of the robots in a cell: one plans at a time, among the volumes of the others."""

    def __init__(self) -> None:
        self.lock = asyncio.Lock()
        self.planners: dict[str, MotionPlanning] = {}
        self._changed = asyncio.Event()

    def notify(self) -> None:
        """Wake those that wait for a change of a volume."""
        self._changed.set()
        self._changed = asyncio.Event()

    async def wait_for_change(self, timeout_s: float) -> None:
        """Return after a change of a volume, or when the time is over."""
        try:
            await asyncio.wait_for(self._changed.wait(), timeout_s)
        except TimeoutError:
            return


class MotionPlanning:
    """Plans for one robot. Raises `UsageError` where motion is to be planned and the extra is missing.

    `name` is that of the robot in `space`, `joints` returns its present joints, `held` the part in its
    gripper and `grip` how it is held.
    """

    def __init__(
        self,
        model: RobotModel,
        limits: Limits,
        scene: Scene,
        *,
        name: str = "robot",
        space: SharedSpace | None = None,
        joints: Callable[[], Joints] | None = None,
        held: Callable[[], str | None] = lambda: None,
        grip: Callable[[], Grip | None] = lambda: None,
    ) -> None:
        self._model = model
        self._limits = limits
        self.set_part(scene)
        self._name = name
        self._joints = joints or (lambda: model.home)
        self._held = held
        self._grip = grip
        self.space = space or SharedSpace()
        self.space.planners[name] = self
        self._reserved: tuple[Obstacle, ...] | None = None
        self.obstacles: tuple[Obstacle, ...] = scene.solids()
        self.revision = 0
        """It changes with the obstacles."""
        if self.obstacles and not is_available():
            raise UsageError(f"the scene {scene.name} has obstacles, which need motion planning; {INSTALL}")

    @property
    def avoids_obstacles(self) -> bool:
        """Return whether every motion is planned."""
        return bool(self.obstacles) or len(self.space.planners) > 1

    def set_part(self, scene: Scene) -> None:
        """Take what the gripper of a changed scene holds: the size and the mass of its parts."""
        self._part_size_m = scene.gripper.part_size_m
        self.part_mass_kg = scene.gripper.part_mass_kg or 0.0

    def set_obstacles(self, obstacles: tuple[Obstacle, ...]) -> None:
        """Change the obstacles; a running motion stops and is planned again."""
        self.obstacles = obstacles
        self.revision += 1

    def world(self) -> World:
        """Return the obstacles and the part in the gripper, without other robots; thread-safe."""
        return self._world(self.obstacles)

    async def plan(self, make: Callable[["Planner"], T]) -> T:
        """Return what `make` plans. Raises `Unreachable` or `NoPath`; `BlockedByNeighbour` if others move."""
        async with self.space.lock:
            return await asyncio.to_thread(self._plan, make)

    async def plan_motion(self, make: Callable[["Planner"], "Plan"]) -> "Plan":
        """Return a motion and reserve the volume that it sweeps, until `end_motion`; raises as `plan`."""
        async with self.space.lock:
            plan = await asyncio.to_thread(self._plan, make)
            if len(self.space.planners) > 1:
                self._reserved = await asyncio.to_thread(self._swept_by, plan)
                self.space.notify()
            return plan

    def end_motion(self) -> None:
        """Release the volume of a motion: the robot is at rest."""
        if self._reserved is not None:
            self._reserved = None
            self.space.notify()

    def neighbours(self) -> tuple[Obstacle, ...]:
        """Return the volumes of the other robots; call it while `space.lock` is held."""
        volumes: list[Obstacle] = []
        for name, other in self.space.planners.items():
            if name != self._name:
                volumes += other.occupied()
        return tuple(volumes)

    def occupied(self) -> tuple[Obstacle, ...]:
        """Return the volume of this robot: reserved by its motion, or that of its links at rest."""
        if self._reserved is not None:
            return self._reserved
        from handover_robots.planning.volumes import occupied  # noqa: PLC0415 - needs the extra

        return tuple(occupied(self._name, self._planner.arm, self._joints(), self._attached(), CLEARANCE_M))

    def _swept_by(self, plan: "Plan") -> tuple[Obstacle, ...]:
        from handover_robots.planning.volumes import swept  # noqa: PLC0415 - needs the extra

        return tuple(swept(self._name, self._planner.arm, plan.trajectory, self._attached(), CLEARANCE_M))

    def _plan(self, make: Callable[["Planner"], T]) -> T:
        if not is_available():
            raise UsageError(f"motion planning is not installed; {INSTALL}")
        others = self.neighbours()
        self._planner.world = self._world(self.obstacles + others)
        try:
            return make(self._planner)
        except (NoPath, Unreachable) as why:
            if others and self._is_possible_alone(make):
                raise BlockedByNeighbour(text_of(why)) from why
            raise

    def _is_possible_alone(self, make: Callable[["Planner"], object]) -> bool:
        self._planner.world = self.world()
        try:
            make(self._planner)
        except (NoPath, Unreachable):
            return False
        return True

    @cached_property
    def _planner(self) -> "Planner":
        # Imported here: without the extra the tool moves on straight lines in joint space.
        from handover_robots.planning.planner import Planner  # noqa: PLC0415

        return Planner(self._model, self._limits)

    def _world(self, obstacles: tuple[Obstacle, ...]) -> World:
        payload_kg = self.part_mass_kg if self._held() is not None else 0.0
        return World(obstacles, self._attached(), payload_kg=payload_kg)

    def _attached(self) -> tuple[Attached, ...]:
        held = self._held()
        if held is None or self._part_size_m is None:
            return ()
        grip = self._grip()
        if grip is None:
            return (Attached(held, Box(self._part_size_m), AT_TIP),)
        x, y, z = (max(side - 2 * GRIP_TOLERANCE_M, GRIP_TOLERANCE_M) for side in grip.size)
        return (Attached(held, Box((x, y, z)), grip.part),)
