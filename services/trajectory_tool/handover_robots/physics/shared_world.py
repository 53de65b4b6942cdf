"""The simulated world of a cell, which all of its physics robots share, with the stored state of it.

The first robot of the cell makes it, with the arms of all; see `RobotContext.shared`.
"""

import asyncio
from collections.abc import Awaitable, Callable, Iterator, Mapping
from typing import TypeVar

from handover.errors import UsageError
from handover_robots.driver_base.context import RobotContext
from handover_robots.driver_base.control_thread import Cycles
from handover_robots.model.robot_model import RobotModel
from handover_robots.physics.pacing import PacedSimulation
from handover_robots.physics.parts import Parts
from handover_robots.physics.saved_state import SavedState
from handover_robots.physics.simulation import Simulation
from handover_robots.physics.world_model import build, objects_of
from handover_robots.scene.scene import Scene

T = TypeVar("T")

KEY = "world"


class SharedWorld:
    """The world of the robots `models`; `saved` keeps its state, None keeps nothing."""

    def __init__(
        self,
        paced: PacedSimulation,
        models: Mapping[str, RobotModel],
        scene: Scene,
        parts: Parts,
        saved: SavedState | None = None,
    ) -> None:
        self.paced = paced
        self.simulation = paced.simulation
        self.parts = parts
        self.scene = scene
        self._models = models
        self._saved = saved
        self._changing = asyncio.Lock()

    @classmethod
    def of(cls, context: RobotContext) -> "SharedWorld":
        """Return the world of the cell. Raises `UsageError` for a scene that cannot be simulated."""
        world = context.shared.get(KEY)
        if not isinstance(world, SharedWorld):
            world = context.shared[KEY] = cls._made(context)
        return world

    @classmethod
    def _made(cls, context: RobotContext) -> "SharedWorld":
        settings, scene = context.settings, context.scene
        require_walls(scene)
        models = {name: peer.model for name, peer in context.peers.items()}
        file, digest = settings.data_dir / "trajectory_tool" / "physics.npz", _digest(scene, models)
        stored = SavedState.parts_in(file, digest) - len(objects_of(scene))
        count = max(Parts.needed(scene), stored)
        joints = {name: peer.joints for name, peer in context.peers.items()}
        simulation = Simulation(build(models, scene, count), joints)
        parts = Parts(simulation, scene, settings.scan_seed)
        saved = SavedState(file, digest, simulation)
        if not saved.load():
            for name in scene.bins:
                simulation.run(parts.fill(name))
        return cls(PacedSimulation(simulation, settings.simulation_pace or None), models, scene, parts, saved)

    def save(self) -> None:
        """Store the state, where it is kept."""
        if self._saved is not None:
            self._saved.save()

    def fast_forward(self, robot: str, course: Iterator[float]) -> Awaitable[None]:
        """Simulate a course of events, as fast as possible unless a robot is in motion."""
        cycles = _absolute(self.simulation, course)
        return asyncio.wrap_future(self.paced.submit(robot, cycles, is_paced=False))

    def prepare_scene(self, scene: Scene) -> Callable[[], Awaitable[None]]:
        """Return what continues the simulation in a changed scene; time and all that moves are kept.

        The robots of the cell may all call it: the first one changes the world. Raises `UsageError`.
        """
        require_walls(scene)
        present = self.simulation.world
        parked = len(present.parts) - len(present.objects)
        world = build(self._models, scene, max(Parts.needed(scene), parked))

        def change() -> Iterator[float]:
            self.simulation.change_world(world)
            self.scene = scene
            for name in self.parts.use(scene):
                yield from self.parts.fill(name)

        async def apply() -> None:
            async with self._changing:
                if self.scene.digest == scene.digest:
                    return
                for robot in self._models:  # each comes to rest, since its motion is planned again
                    await asyncio.wrap_future(self.paced.submit(robot, _nothing()))
                await self.fast_forward(next(iter(self._models)), change())
                if self._saved is not None:
                    self._saved.digest = _digest(scene, self._models)
                await asyncio.to_thread(self.save)

        return apply


def require_walls(scene: Scene) -> None:
    """Raise `UsageError` for a bin that cannot hold parts, or whose camera the scene does not have."""
    for name, bin_ in scene.bins.items():
        if bin_.walls is None:
            raise UsageError(
                f'the bin "{name}" of the scene {scene.name} has no walls, so parts would fall out of it; '
                "give it walls, or set HANDOVER_SCENE_FILE to a scene for physics, such as "
                "robots/ur10/bin_picking_physics.yaml"
            )
        if bin_.camera is not None and bin_.camera not in scene.cameras:
            raise UsageError(
                f'the bin "{name}" of the scene {scene.name} names the camera "{bin_.camera}", which the '
                f"scene does not have; it has {', '.join(scene.cameras) or 'none'}"
            )


def _digest(scene: Scene, models: Mapping[str, RobotModel]) -> str:
    robots = (f"{name}:{model.revision}" for name, model in models.items())
    return "-".join((scene.digest, *robots))


def _absolute(simulation: Simulation, course: Iterator[float]) -> Cycles[None]:
    for seconds in course:
        yield simulation.time_s + seconds


def _nothing() -> Cycles[None]:
    return
    yield
