"""The cell: its scene, the parts in it and their stored state, and the robots that share them."""

import asyncio
from collections.abc import Callable, Mapping
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any, Self

from handover.broker import BrokerClient
from handover.errors import UsageError
from handover.telemetry import get_logger
from handover_datamodels.streams import PeopleReport
from handover_robots.cell.cell_file import Base, CellPlan, RobotEntry, cell_plan
from handover_robots.cell.manual_mode import ManualMode
from handover_robots.cell.memory import Memory, MemoryFile
from handover_robots.cell.motion import INSTALL, SharedSpace
from handover_robots.cell.robot_unit import RobotUnit
from handover_robots.driver_base.context import Clock, Peer
from handover_robots.limits.neighbours import MovingRobots
from handover_robots.limits.store import LimitStore
from handover_robots.metrics import SCENE_CHANGES
from handover_robots.model.faults import Unreachable
from handover_robots.model.joints import Joints
from handover_robots.model.obstacles import Obstacle
from handover_robots.model.robot_model import RobotModel
from handover_robots.people.measured import SceneSensors
from handover_robots.planning import is_available
from handover_robots.robots.folder import load_robot
from handover_robots.scene.contents import Contents, initial
from handover_robots.scene.reading import load, read_scene
from handover_robots.scene.scene import Scene
from handover_robots.scene.scene_file import ChangedScene, SceneFile
from handover_robots.scene.vision import Camera
from handover_robots.settings import TrajectorySettings

log = get_logger(__name__)

VIEW_ONLY = frozenset({"digest", "revision", "parts", "trueParts", "shapes"})
"""What GET adds to a scene; a client may send it back."""


class RobotCell:
    """All robots of a cell; an asynchronous context manager while they are switched on.

    Robots behind ROS are reached through `broker`. `plan` is by default that of the settings; `folder` has
    the stored state. Raises `UsageError` when a robot, the scene or the stored state cannot be used.
    """

    def __init__(
        self,
        settings: TrajectorySettings,
        clock: Clock | None = None,
        *,
        broker: BrokerClient | None = None,
        plan: CellPlan | None = None,
        folder: Path | None = None,
    ) -> None:
        plan = plan or cell_plan(settings)
        folder = folder or settings.data_dir / "trajectory_tool"
        models = {name: _model(plan, name, entry, settings.data_dir) for name, entry in plan.robots.items()}
        if len(models) > 1 and not is_available():
            raise UsageError(f"several robots in one cell need motion planning; {INSTALL}")
        self.settings = settings
        self.folder = folder
        self.plan_folder = plan.folder
        self._plan = plan
        self._models = models
        configured = _scene(plan, list(models.values()))
        self._origin = configured.digest
        self._scene_file = SceneFile(folder / "scene.json")
        changed = self._scene_file.load(self._origin)
        self.revision = changed.revision if changed else 0
        """The number of changes of the scene at run time."""
        self.scene = configured
        if changed is not None:
            source = f"changed scene {self._scene_file.path}"
            self.scene = read_scene(changed.scene, configured.folder, source, *models.values())
        self.on_scene_change: Callable[[], None] = lambda: None
        self._changing = asyncio.Lock()
        self.camera = Camera(settings.detection_rate, settings.scan_seed)
        self.file = MemoryFile(folder / "cell.json")
        memory = self.file.load(
            self.scene.digest, {name: model.joint_names for name, model in models.items()}
        )
        self.contents: Contents = memory.contents if memory else initial(self.scene)
        self.space = SharedSpace()
        self.manual = ManualMode()
        self.moving = MovingRobots()
        self.limit_store = LimitStore(settings.data_dir / "trajectory_tool" / "limits.json")
        self._saving = asyncio.Lock()
        self._on = AsyncExitStack()
        memories = self._memories = memory.robots if memory else {}
        self.shared: dict[str, dict[str, Any]] = {}
        """What each driver keeps for all of its robots."""
        self.units = {
            name: RobotUnit(
                self, name, entry, models[name], memory=memories.get(name), clock=clock, broker=broker
            )
            for name, entry in plan.robots.items()
        }
        self.people_sensors = SceneSensors(
            lambda: self.scene, lambda: [unit.model.chain(unit.joints) for unit in self.units.values()]
        )
        if memory is None and any(unit.robot.vision is not None for unit in self.units.values()):
            self.contents = Contents()  # where the parts are is known when they have been seen

    @property
    def has_several_robots(self) -> bool:
        """Return whether robots may meet."""
        return len(self._models) > 1

    def home_of(self, model: RobotModel) -> Joints:
        """Return the home position of a robot in the scene."""
        return model.home if self.scene.home is None else self.scene.home

    def stored_joints(self, name: str) -> Joints:
        """Return the joints of a robot that were stored last, or its home."""
        memory = self._memories.get(name)
        return self.home_of(self._models[name]) if memory is None else memory.joints

    def peers_of(self, driver: str) -> dict[str, Peer]:
        """Return the robots of a driver."""
        return {
            name: Peer(self._models[name], self.stored_joints(name))
            for name, entry in self._plan.robots.items()
            if entry.driver == driver
        }

    @property
    def only(self) -> RobotUnit:
        """Return the only robot."""
        (unit,) = self.units.values()
        return unit

    async def __aenter__(self) -> Self:
        for unit in self.units.values():
            await self._on.enter_async_context(unit)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._on.aclose()

    async def change_scene(self, written: Mapping[str, Any]) -> None:
        """Replace the scene durably; motions that run stop and are planned again.

        Parts in a bin or fixture that is gone leave the cell; a new bin has its parts. Raises `UsageError`
        for a scene that cannot be used, `OSError` when it cannot be stored.
        """
        async with self._changing:
            content = {name: value for name, value in written.items() if name not in VIEW_ONLY}
            scene = read_scene(content, self.scene.folder, "scene", *self._models.values())
            _require_own_meshes(scene)
            solids = scene.solids()
            if solids:
                await asyncio.to_thread(_require_usable, solids)
            applies = [
                await asyncio.to_thread(unit.robot.prepare_scene, scene) for unit in self.units.values()
            ]
            changed = ChangedScene(origin=self._origin, revision=self.revision + 1, scene=content)
            await asyncio.to_thread(self._scene_file.save, changed)
            before, self.scene, self.revision = self.scene, scene, changed.revision
            self.contents = self.contents.moved(before, scene)
            for unit in self.units.values():
                unit.planning.set_part(scene)
                unit.planning.set_obstacles(solids)
            for apply in applies:
                if apply is not None:
                    await apply()
                    for name in scene.bins.keys() - before.bins.keys():
                        self.contents = self.contents.observed(name, [])  # known when it has been seen
                unit.speed.set_zones(scene.all_zones())
                unit.speed.evaluate()
            SCENE_CHANGES.inc()
            log.info("scene changed", revision=self.revision, digest=scene.digest)
            self.on_scene_change()
            await self.remember()

    async def receive_people(self, report: PeopleReport) -> None:
        """Give a report of people to every robot. Raises `RefusedReport`, `OSError`."""
        for unit in self.units.values():
            await unit.speed.receive_people(report)

    async def contacts(self) -> list[str]:
        """Return what each robot touches where it stands now."""
        touching = []
        for name, unit in self.units.items():
            if not unit.planning.avoids_obstacles:
                continue
            why = await unit.planning.plan(lambda planner, unit=unit: planner.why_not_free(unit.joints))  # type: ignore[misc]
            if why is not None:
                touching.append(f"{name}: {why}")
        return touching

    async def remember(self) -> None:
        """Store the state of the cell durably. Raises `OSError`."""
        async with self._saving:
            memory = Memory(
                self.scene.digest,
                self.contents,
                {name: unit.memory() for name, unit in self.units.items()},
            )
            await asyncio.to_thread(self.file.save, memory)


def _require_own_meshes(scene: Scene) -> None:
    """Refuse meshes outside of the folder of the scene: a client must not read other files."""
    things = [
        *scene.obstacles.items(),
        *((name, fixture.body) for name, fixture in scene.fixtures.items() if fixture.body),
    ]
    for name, thing in things:
        mesh = thing.mesh
        if mesh is not None and (mesh.is_absolute() or ".." in mesh.parts):
            raise UsageError(f"scene: {name}: the mesh {mesh} must be beside the scene file, without ..")


def _require_usable(solids: tuple[Obstacle, ...]) -> None:
    """Refuse meshes that cannot be loaded, and any obstacle without the extra for planning."""
    if not is_available():
        raise UsageError(f"scene: obstacles need motion planning; {INSTALL}")
    from handover_robots.planning.collision import geometry_of  # noqa: PLC0415 - needs the extra

    for solid in solids:
        geometry_of(solid.shape)


def _model(plan: CellPlan, name: str, entry: RobotEntry, data_dir: Path) -> RobotModel:
    model = entry.mounted(load_robot(entry.model, data_dir, plan.folder))
    if entry.home is None:
        return model
    try:
        return model.with_home(entry.home)
    except Unreachable as why:
        raise UsageError(f"{plan.file}: robots.{name}.home: {why}") from None


def _scene_for(plan: CellPlan, model: RobotModel) -> Path | None:
    """Return the scene that a model has for its driver, else its scene; None without one.

    That for a driver is around the origin, so a robot elsewhere has none.
    """
    entry = next(iter(plan.robots.values()))
    is_at_origin = entry.base.pose == Base().pose
    driver = plan.scene_driver or entry.driver
    return model.driver_scenes.get(driver, model.scene) if is_at_origin else model.scene


def _scene(plan: CellPlan, models: list[RobotModel]) -> Scene:
    if plan.scene is None or isinstance(plan.scene, Path):
        return load(plan.scene or _scene_for(plan, models[0]), *models)
    return read_scene(plan.scene, plan.folder, f"cell file {plan.file}: scene", *models)
