"""The planner of a cell: its world is the scene and the part in the gripper, its limits those of the cell.

A scene with obstacles is planned in, with the extra `motion`. Planning runs in a thread, one plan at a time.
"""

import asyncio
import importlib
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

from handover.errors import UsageError
from services.trajectory_tool.obstacles import Attached, Box, Obstacle, World
from services.trajectory_tool.planning import is_available
from services.trajectory_tool.poses import Pose
from services.trajectory_tool.robot_model import RobotModel
from services.trajectory_tool.scene import Scene
from services.trajectory_tool.trajectory import Limits

if TYPE_CHECKING:
    from services.trajectory_tool.planning.planner import Planner

T = TypeVar("T")

AT_TIP = Pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
INSTALL = 'install the extra "motion": pip install "handover[motion]"'


class MotionPlanning:
    """Plans in a cell. Raises `UsageError` for a scene with obstacles where the extra is missing."""

    def __init__(self, model: RobotModel, limits: Limits, scene: Scene) -> None:
        self._model = model
        self._limits = limits
        self._part_size_m = scene.gripper.part_size_m
        self._one_at_a_time = asyncio.Lock()
        self.obstacles: tuple[Obstacle, ...] = scene.solids()
        self.revision = 0
        """It changes with the obstacles."""
        if self.obstacles and not is_available():
            raise UsageError(f"the scene {scene.name} has obstacles, which need motion planning; {INSTALL}")

    @property
    def avoids_obstacles(self) -> bool:
        """Return whether every motion is planned."""
        return bool(self.obstacles)

    def set_obstacles(self, obstacles: tuple[Obstacle, ...]) -> None:
        """Change the obstacles; a running motion stops and is planned again."""
        self.obstacles = obstacles
        self.revision += 1

    async def plan(self, held: str | None, make: Callable[["Planner"], T]) -> T:
        """Return what `make` plans, with `held` in the gripper. Raises `Unreachable` or `NoPath`."""
        async with self._one_at_a_time:
            return await asyncio.to_thread(self._plan, held, make)

    def _plan(self, held: str | None, make: Callable[["Planner"], T]) -> T:
        if not is_available():
            raise UsageError(f"motion planning is not installed; {INSTALL}")
        self._planner.world = World(self.obstacles, self._attached(held))
        return make(self._planner)

    @cached_property
    def _planner(self) -> "Planner":
        # Imported here: without the extra the tool moves on straight lines in joint space.
        planner = importlib.import_module("services.trajectory_tool.planning.planner")
        made: Planner = planner.Planner(self._model, self._limits)
        return made

    def _attached(self, held: str | None) -> tuple[Attached, ...]:
        if held is None or self._part_size_m is None:
            return ()
        return (Attached(held, Box(self._part_size_m), AT_TIP),)
