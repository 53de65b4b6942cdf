"""The robot's thread of control, on a clock that jumps, and on the real one."""

import asyncio
import itertools
import threading
import time as real_time
from collections.abc import AsyncIterator
from typing import Any

import pytest
from prometheus_client import REGISTRY

from handover_robots.driver_base.context import Clock
from handover_robots.drivers.simulated_robot import SimulatedRobot
from handover_robots.model.faults import RobotFault
from handover_robots.robots.ur10 import ROBOT
from tests.kit.waiting import Bound

HOME = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
FAR = (3.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
LIMITS = ROBOT.limits
CYCLE_S = 0.008


def overruns() -> float:
    return REGISTRY.get_sample_value("handover_trajectory_tool_cycle_overruns_total") or 0.0


def a_robot(clock: Clock | None = None, gripper_s: float = 0.3) -> SimulatedRobot:
    return SimulatedRobot(
        HOME, LIMITS, something_there=lambda joints: joints == FAR, gripper_s=gripper_s, clock=clock
    )


@pytest.fixture
async def robot(time: Any) -> AsyncIterator[SimulatedRobot]:
    async with a_robot(time.clock) as made:
        yield made


async def test_a_motion_is_followed_at_125_cycles_a_second(robot: SimulatedRobot, time: Any) -> None:
    waits: list[float] = []
    time.on_wait = waits.append
    assert await robot.move(FAR, 0.5, lambda: 1.0)
    assert robot.state().positions == FAR
    gaps = [b - a for a, b in itertools.pairwise(waits)]
    assert gaps == pytest.approx([CYCLE_S] * len(gaps))
    assert len(waits) == pytest.approx(robot.estimate_s(HOME, FAR, 0.5) / CYCLE_S, abs=1)


async def test_a_pause_begins_to_slow_the_joints_within_100_ms(robot: SimulatedRobot, time: Any) -> None:
    asked_s = time.time_s + 1.0
    seen: list[tuple[float, float]] = []
    time.on_wait = lambda now_s: seen.append((now_s, robot.state().velocities[0]))
    assert not await robot.move(FAR, 1.0, lambda: float(time.time_s < asked_s))
    full = max(velocity for _, velocity in seen)
    slower_s = min(now_s for now_s, velocity in seen if now_s > asked_s and velocity < full - 1e-3)
    assert slower_s - asked_s <= 0.1
    assert robot.state().velocities == (0.0,) * 6
    assert time.time_s - asked_s < 0.6
    assert robot.state().positions[0] < FAR[0]
    assert await robot.move(FAR, 1.0, lambda: 1.0)
    assert robot.state().positions == FAR


async def test_a_motion_that_may_not_begin_moves_nothing(robot: SimulatedRobot) -> None:
    assert not await robot.move(FAR, 1.0, lambda: 0.0)
    assert robot.state().positions == HOME


async def test_remaining_time_counts_down_to_nothing(robot: SimulatedRobot, time: Any) -> None:
    remaining: list[float] = []
    time.on_wait = lambda now_s: remaining.append(robot.remaining_s())
    await robot.move(FAR, 1.0, lambda: 1.0)
    assert remaining == sorted(remaining, reverse=True)
    assert remaining[0] == pytest.approx(robot.estimate_s(HOME, FAR, 1.0), abs=2 * CYCLE_S)
    assert robot.remaining_s() == 0.0


async def test_the_gripper_takes_time_and_detects_an_object(robot: SimulatedRobot, time: Any) -> None:
    began_s = time.time_s
    assert not await robot.close_gripper()
    assert robot.gripper_closed
    assert time.time_s - began_s == pytest.approx(0.3)
    await robot.open_gripper()
    assert not robot.gripper_closed
    await robot.move(FAR, 1.0, lambda: 1.0)
    assert await robot.close_gripper()


async def test_cycles_that_were_missed_are_counted_and_the_arm_is_where_it_should_be() -> None:
    class Late:
        """A clock on which the tenth wait takes 50 ms longer than asked for."""

        def __init__(self) -> None:
            self.time_s, self.waits = 0.0, 0

        def wait(self, seconds: float) -> None:
            self.waits += 1
            self.time_s += seconds + (0.05 if self.waits == 10 else 0.0)

    late = Late()
    before = overruns()
    async with a_robot(Clock(lambda: late.time_s, late.wait)) as robot:
        assert await robot.move(FAR, 1.0, lambda: 1.0)
        assert robot.state().positions == FAR
        assert late.time_s == pytest.approx(robot.estimate_s(HOME, FAR, 1.0), abs=2 * CYCLE_S)
    assert overruns() - before == 5


async def test_a_cancelled_caller_stops_the_motion(eventually_true: Any) -> None:
    async with a_robot() as robot:
        moving = asyncio.create_task(robot.move(FAR, 1.0, lambda: 1.0))
        await eventually_true(lambda: robot.state().velocities[0] > 0.5)
        moving.cancel()
        with pytest.raises(asyncio.CancelledError):
            await moving
        rest = robot.state()
        assert rest.velocities == (0.0,) * 6
        assert HOME[0] < rest.positions[0] < FAR[0]
        assert robot.remaining_s() == 0.0


async def test_switching_off_brings_the_joints_to_rest(eventually_true: Any) -> None:
    robot = a_robot()
    async with robot:
        moving = asyncio.create_task(robot.move(FAR, 1.0, lambda: 1.0))
        await eventually_true(lambda: robot.state().velocities[0] > 0.5)
    assert not await moving
    assert robot.state().velocities == (0.0,) * 6
    with pytest.raises(RobotFault, match="switched off"):
        await robot.move(FAR, 1.0, lambda: 1.0)
    with pytest.raises(RobotFault, match="switched off"):
        await robot.close_gripper()
    assert not any(thread.name.startswith("robot-control") for thread in threading.enumerate())


async def test_a_busy_event_loop_does_not_hold_the_motion_up() -> None:
    async with a_robot() as robot:
        moving = asyncio.create_task(robot.move(FAR, 1.0, lambda: 1.0))
        await asyncio.sleep(0)
        bound = Bound(robot.estimate_s(HOME, FAR, 1.0) + 5.0)
        while robot.state().positions != FAR:
            bound.check("the robot has not arrived")
            real_time.sleep(0.01)  # nothing else in the event loop runs meanwhile
        assert await moving
