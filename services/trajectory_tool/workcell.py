"""The workcell: its scene, the parts in it and their stored state, and the robots that share them."""

import asyncio
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Self

from handover.broker import BrokerClient
from handover.errors import UsageError
from handover.telemetry import get_logger
from services.trajectory_tool.camera import Camera
from services.trajectory_tool.cell import Cell
from services.trajectory_tool.cell_file import CellPlan, RobotEntry, cell_plan
from services.trajectory_tool.contents import Contents, initial
from services.trajectory_tool.drivers import Clock
from services.trajectory_tool.memory import Memory, MemoryFile
from services.trajectory_tool.motion import INSTALL, SharedSpace
from services.trajectory_tool.planning import is_available
from services.trajectory_tool.robot import Unreachable
from services.trajectory_tool.robot_model import RobotModel
from services.trajectory_tool.robots.folder import load_robot
from services.trajectory_tool.scene import Scene, load, read_scene
from services.trajectory_tool.settings import TrajectorySettings

log = get_logger(__name__)


class Workcell:
    """All robots of a cell; an asynchronous context manager while they are switched on.

    Robots behind ROS are reached through `broker`. Raises `UsageError` when a robot, the scene or the stored
    state cannot be used.
    """

    def __init__(
        self,
        settings: TrajectorySettings,
        clock: Clock | None = None,
        *,
        broker: BrokerClient | None = None,
    ) -> None:
        plan = cell_plan(settings)
        models = {name: _model(plan, name, entry, settings.data_dir) for name, entry in plan.robots.items()}
        if len(models) > 1 and not is_available():
            raise UsageError(f"several robots in one cell need motion planning; {INSTALL}")
        self.settings = settings
        self.scene = _scene(plan, list(models.values()))
        self.camera = Camera(settings.detection_rate, settings.scan_seed)
        self.file = MemoryFile(settings.data_dir / "trajectory_tool" / "cell.json")
        known = self.file.load(self.scene.digest, {name: model.joint_names for name, model in models.items()})
        self.contents: Contents = known.contents if known else initial(self.scene)
        self.space = SharedSpace()
        self._saving = asyncio.Lock()
        self._on = AsyncExitStack()
        memories = known.robots if known else {}
        self.cells = {
            name: Cell(self, name, entry, models[name], known=memories.get(name), clock=clock, broker=broker)
            for name, entry in plan.robots.items()
        }

    @property
    def only(self) -> Cell:
        """Return the cell of the only robot."""
        (cell,) = self.cells.values()
        return cell

    async def __aenter__(self) -> Self:
        for cell in self.cells.values():
            await self._on.enter_async_context(cell)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._on.aclose()

    async def remember(self) -> None:
        """Store the state of the cell durably. Raises `OSError`."""
        async with self._saving:
            memory = Memory(
                self.scene.digest,
                self.contents,
                {name: cell.memory() for name, cell in self.cells.items()},
            )
            await asyncio.to_thread(self.file.save, memory)


def _model(plan: CellPlan, name: str, entry: RobotEntry, data_dir: Path) -> RobotModel:
    model = entry.mounted(load_robot(entry.model, data_dir, plan.folder))
    if entry.home is None:
        return model
    try:
        return model.with_home(entry.home)
    except Unreachable as why:
        raise UsageError(f"{plan.file}: robots.{name}.home: {why}") from None


def _scene(plan: CellPlan, models: list[RobotModel]) -> Scene:
    if plan.scene is None or isinstance(plan.scene, Path):
        return load(plan.scene, *models)
    return read_scene(plan.scene, plan.folder, f"cell file {plan.file}: scene", *models)
