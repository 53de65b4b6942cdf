"""A cell whose time is its own: the robot's thread waits on a clock that jumps."""

import threading
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest

from handover_robots.cell.cell import RobotCell
from handover_robots.driver_base.context import Clock
from handover_robots.settings import TrajectorySettings
from handover_robots.tasks import operations, parameters
from handover_robots.tasks.work import Work
from tests.kit.waiting import until


class JumpingTime:
    """A clock on which waiting takes no time; `on_wait` gets the time after each wait."""

    def __init__(self) -> None:
        self.time_s = 1000.0
        self.on_wait: Callable[[float], None] = lambda now_s: None
        self._lock = threading.Lock()

    def wait(self, seconds: float) -> None:
        with self._lock:
            self.time_s += seconds
        self.on_wait(self.time_s)

    @property
    def clock(self) -> Clock:
        return Clock(lambda: self.time_s, self.wait)


class Freely:
    """Nobody holds the work up."""

    def may_go(self) -> bool:
        return True

    async def rest(self) -> None:
        raise AssertionError("nobody asked for rest")


class Worker:
    """Does operations in a cell, as the controller would; each call is another Task unless one is named."""

    def __init__(self, settings: TrajectorySettings, time: JumpingTime) -> None:
        self.settings = settings
        self.time = time
        self.cell = RobotCell(settings, time.clock)
        self.unit = self.cell.only
        self.work: Work | None = None
        self._tasks = 0

    async def do(
        self, operation: str, *, task: str | None = None, steering: Any = None, **asked: Any
    ) -> dict[str, Any]:
        self._tasks += 1
        performed = operations.operation_named(operation)
        read = parameters.read(performed.parameters, operation, asked)
        speed = self.settings.robot_speed * read.speed
        self.work = Work(task or f"task-{self._tasks}", operation, self.unit, steering or Freely(), speed)
        return await performed.perform(self.work, read)

    def after_a_power_cut(self) -> "Worker":
        """Return the worker that finds the cell as the memory file has it."""
        return Worker(self.settings, self.time)


@pytest.fixture
def time() -> JumpingTime:
    return JumpingTime()


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> TrajectorySettings:
    monkeypatch.chdir(tmp_path)
    return TrajectorySettings.load(data_dir=tmp_path, detection_rate=1.0)


@pytest.fixture
async def worker(settings: TrajectorySettings, time: JumpingTime) -> AsyncIterator[Worker]:
    made = Worker(settings, time)
    async with made.unit:
        yield made


@pytest.fixture
def eventually_true() -> Callable[..., Any]:
    """Wait for a condition with a bound, letting others run meanwhile."""

    return until
