"""Measure how a robot stops: the time and the way of the tool from the command to rest."""

import asyncio
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise

from handover_robots.cell.robot_unit import RobotUnit
from handover_robots.limits.guards import tool_speed_mps
from handover_robots.limits.store import MeasuredStop
from handover_robots.model.faults import RobotFault
from handover_robots.model.joints import Joints, JointState, Pace
from handover_robots.model.trajectory import Setpoint

SAMPLE_S = 0.004
SLOWER = 0.98
"""The robot reacts when its tool is slower than this fraction of the speed at the command."""
MIN_SPEED_MPS = 0.05
MAX_DECELERATION_MPS2 = 100.0


@dataclass(frozen=True, slots=True)
class StopMeasurement:
    """A stop from `speed_mps` of the tool: the delay, the duration and the way until rest."""

    speed_mps: float
    delay_s: float
    duration_s: float
    distance_m: float

    @property
    def deceleration_mps2(self) -> float:
        """Return the constant deceleration that leads to the same way after the delay."""
        braking_m = self.distance_m - self.speed_mps * self.delay_s
        if braking_m <= self.speed_mps**2 / (2 * MAX_DECELERATION_MPS2):
            return MAX_DECELERATION_MPS2
        return self.speed_mps**2 / (2 * braking_m)

    def stored(self) -> MeasuredStop:
        """Return the stop as it is stored for protective distances."""
        return MeasuredStop(
            delay_s=round(self.delay_s, 4),
            deceleration_mps2=round(self.deceleration_mps2, 3),
            measured_at=datetime.now(UTC),
        )


async def measure_stop(unit: RobotUnit, target: Joints, speed: float) -> StopMeasurement:
    """Move towards `target` at `speed`, and stop in the middle of the way.

    The robot must be switched on. Raises `RobotFault` when the tool is too slow to measure.
    """
    start = unit.joints
    is_stopping = asyncio.Event()

    def pace() -> float:
        return 0.0 if is_stopping.is_set() else 1.0

    moving = asyncio.create_task(_move(unit, target, speed, pace))
    clock = asyncio.get_running_loop().time
    samples: list[tuple[float, JointState]] = []
    commanded_s: float | None = None
    while not moving.done():
        state = unit.robot.state()
        samples.append((clock(), state))
        if commanded_s is None and _share(start, target, state.positions) >= 0.5:
            commanded_s = clock()
            is_stopping.set()
        await asyncio.sleep(SAMPLE_S)
    await moving
    samples.append((clock(), unit.robot.state()))
    if commanded_s is None:
        raise RobotFault("the motion was over before the stop; choose a longer one")
    return _evaluated(unit, samples, commanded_s)


async def _move(unit: RobotUnit, target: Joints, speed: float, pace: Pace) -> bool:
    if not unit.planning.avoids_obstacles:
        return await unit.robot.move(target, speed, pace)
    plan = await unit.planning.plan_motion(lambda planner: planner.to_joints(unit.joints, target))
    try:
        return await unit.robot.follow(plan.trajectory.slowed(speed), pace)
    finally:
        unit.planning.end_motion()


def _share(start: Joints, target: Joints, here: Joints) -> float:
    number = max(range(len(start)), key=lambda joint: abs(target[joint] - start[joint]))
    way = target[number] - start[number]
    return (here[number] - start[number]) / way if way else 1.0


def _evaluated(
    unit: RobotUnit, samples: list[tuple[float, JointState]], commanded_s: float
) -> StopMeasurement:
    after = [(at_s, state) for at_s, state in samples if at_s >= commanded_s]
    still = (0.0,) * len(unit.home)
    speeds = [
        (at_s, tool_speed_mps(unit.model, Setpoint(state.positions, state.velocities, still)))
        for at_s, state in after
    ]
    speed_mps = speeds[0][1]
    if speed_mps < MIN_SPEED_MPS:
        raise RobotFault(f"the tool moved at {speed_mps:.3f} m/s only; choose a longer or faster motion")
    slower_s = next((at_s for at_s, mps in speeds if mps < SLOWER * speed_mps), speeds[-1][0])
    rest_s = next((at_s for at_s, mps in speeds if mps < 0.001), speeds[-1][0])
    poses = [unit.model.tool_pose(state.positions) for _, state in after]
    way_m = sum(before.distance_m(after) for before, after in pairwise(poses))
    return StopMeasurement(speed_mps, slower_s - commanded_s, rest_s - commanded_s, way_m)
