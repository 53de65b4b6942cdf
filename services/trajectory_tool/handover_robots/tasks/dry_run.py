"""A dry run: the operations of a process in a simulated cell whose clock jumps, with checks of every motion.

The robots are simulated, whatever their drivers are; planning, limits and scene are those of the cell. A
motion takes only the time of its computation. Every control cycle is checked afterwards for joint limits and,
with the extra `motion`, for contacts.
"""

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

from handover.errors import HandoverError
from handover.performer import TaskFailed
from handover_robots.cell.cell import RobotCell
from handover_robots.cell.cell_file import cell_plan
from handover_robots.cell.robot_unit import RobotUnit
from handover_robots.driver_base.context import Clock
from handover_robots.model.faults import Unreachable
from handover_robots.model.joints import Joints
from handover_robots.planning import is_available
from handover_robots.settings import TrajectorySettings
from handover_robots.tasks import operations, parameters
from handover_robots.tasks.work import Work

CHECK_EVERY_CYCLES = 3
CONTROL_HZ = 125.0


@dataclass(frozen=True)
class NearestPair:
    """The two things that were nearest to each other on the way of a robot, and their distance in m."""

    first: str
    second: str
    distance_m: float


@dataclass(frozen=True)
class Step:
    """One performed operation: its duration, its result, or why it cannot be done.

    `nearest` is the smallest distance on the way, with its pair; None without the extra `motion`, without a
    motion, and where nothing can touch.
    """

    robot: str
    operation: str
    duration_s: float
    result: Mapping[str, Any] = field(default_factory=dict)
    faults: tuple[str, ...] = ()
    nearest: NearestPair | None = None


class _JumpingTime:
    """A clock on which waiting takes no time; it records the joints of the robots at each wait."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.joints: list[Joints] = []
        self.observed: RobotUnit | None = None
        self._lock = threading.Lock()

    def wait(self, seconds: float) -> None:
        with self._lock:
            self.now_s += max(seconds, 0.0)
            if self.observed is not None:
                self.joints.append(self.observed.joints)

    @property
    def clock(self) -> Clock:
        return Clock(lambda: self.now_s, self.wait)


class _Freely:
    def may_go(self) -> bool:
        return True

    async def rest(self) -> None:
        return


class _DryWork(Work):
    """Work without waiting: cameras and people answer at once."""

    def __init__(self, time: _JumpingTime, operation: str, unit: RobotUnit, speed: float) -> None:
        super().__init__("dry-run", operation, unit, _Freely(), speed)
        self._time = time

    async def wait(self, seconds: float) -> None:
        self._time.wait(seconds)

    async def wait_for_confirmation(self, timeout_s: float, contact_n: float | None) -> bool:  # noqa: ARG002
        return True


class DryRun:
    """A cell for dry runs, with its state in `folder`; an asynchronous context manager.

    Raises `UsageError` for an invalid cell.
    """

    def __init__(self, settings: TrajectorySettings, folder: Path) -> None:
        update = {"detection_rate": 1.0, "control_hz": CONTROL_HZ, "neighbour_wait_s": 0.0}
        self._time = _JumpingTime()
        plan = cell_plan(settings)
        simulated = {
            name: entry.model_copy(update={"driver": "simulated", "settings": {}})
            for name, entry in plan.robots.items()
        }
        self._cell = RobotCell(
            settings.model_copy(update=update),
            self._time.clock,
            plan=replace(plan, robots=simulated, scene_driver=next(iter(plan.robots.values())).driver),
            folder=folder,
        )

    @property
    def robots(self) -> tuple[str, ...]:
        """Return the names of the robots."""
        return tuple(self._cell.units)

    async def __aenter__(self) -> Self:
        await self._cell.__aenter__()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._cell.__aexit__(*_)

    async def perform(self, robot: str, operation: str, values: Mapping[str, Any]) -> Step:
        """Perform an operation, and return what it took and what is wrong with it."""
        unit, time = self._cell.units[robot], self._time
        time.joints, time.observed = [unit.joints], unit
        began_s, result, faults = time.now_s, {}, []
        try:
            performed = operations.operation_named(operation)
            read = parameters.read(performed.parameters, operation, values)
            work = _DryWork(time, operation, unit, unit.entry.speed * read.speed)
            result = await performed.perform(work, read)
        except (TaskFailed, HandoverError) as fault:
            faults.append(str(fault))
        finally:
            time.observed = None
        path = time.joints[::CHECK_EVERY_CYCLES]
        faults += await self._faults_of(unit, path)
        nearest = await self._nearest(unit, path)
        return Step(robot, operation, time.now_s - began_s, result, tuple(dict.fromkeys(faults)), nearest)

    async def _nearest(self, unit: RobotUnit, path: list[Joints]) -> NearestPair | None:
        if not is_available() or not any(joints != path[0] for joints in path):
            return None

        def least_clearance(planner: Any) -> Any:
            return planner.least_clearance(path)

        least = await unit.planning.plan(least_clearance)
        return None if least is None else NearestPair(least.first, least.second, round(least.distance_m, 4))

    async def _faults_of(self, unit: RobotUnit, path: list[Joints]) -> list[str]:
        faults = []
        for joints in path:
            try:
                unit.model.allow(joints)
            except Unreachable as why:
                faults.append(str(why))
        if is_available():

            def contacts(planner: Any) -> list[str]:
                return [str(why) for joints in path if (why := planner.why_not_free(joints)) is not None]

            faults += await unit.planning.plan(contacts)
        return list(dict.fromkeys(faults))[:3]
