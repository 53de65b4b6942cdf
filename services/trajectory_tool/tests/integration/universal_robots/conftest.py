"""A simulated controller, and the driver that is connected to it."""

from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from handover_robots.driver_base.context import RobotContext
from handover_robots.driver_contract import context_of
from handover_robots.robots.ur10 import ROBOT
from handover_ur.driver import UniversalRobot
from handover_ur.simulator.controller import SimulatedController
from tests.kit.ur_controllers import RunningController, running_controller
from tests.kit.waiting import until

HOME = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
NewRobot = Callable[..., AbstractAsyncContextManager[UniversalRobot]]


@pytest.fixture
def frequency_hz() -> float:
    """Return the frequency of the CB3 series, which costs less CPU time than that of the e-Series."""
    return 125.0


@pytest.fixture
def controller(frequency_hz: float) -> Iterator[RunningController]:
    """Return a controller whose arm is powered and at rest at home."""
    with running_controller(SimulatedController(HOME, frequency_hz=frequency_hz)) as running:
        yield running


@pytest.fixture
def context(tmp_path: Path) -> RobotContext:
    """Return what a robot of the cell is made from, without options."""
    return context_of(ROBOT, tmp_path, robot_id="ur10-1", joints=HOME, limiter=None)


@pytest.fixture
def new_robot(controller: RunningController, context: RobotContext) -> NewRobot:
    """Return a function that makes a robot for the controller, with options of the driver."""

    @asynccontextmanager
    async def make(*, wait: bool = True, **options: Any) -> AsyncIterator[UniversalRobot]:
        complete = replace(context, options=controller.options(**options))
        async with UniversalRobot.from_context(complete) as robot:
            if wait:
                await until(lambda: robot.exchange.report().is_connected, why="no report of the controller")
            yield robot

    return make


@pytest.fixture
async def robot(new_robot: NewRobot) -> AsyncIterator[UniversalRobot]:
    """Return a connected robot with a gripper at the tool outputs."""
    async with new_robot(gripper="tool_io") as made:
        yield made
