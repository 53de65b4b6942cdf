"""The speed of the tool in whole motions: in zones, in reduced mode, with a validated speed."""

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
import yaml

from handover_robots.cell.cell import RobotCell
from handover_robots.cell.robot_unit import RobotUnit
from handover_robots.drivers.simulated_robot import SimulatedRobot
from handover_robots.limits.guards import tool_speed_mps
from handover_robots.limits.store import MeasuredStop, SafeSpeed
from handover_robots.model.joints import Velocity
from handover_robots.model.trajectory import Setpoint
from handover_robots.planning import is_available
from handover_robots.scene.scene import Zone
from handover_robots.settings import TrajectorySettings
from handover_robots.tasks.work import Work
from services.trajectory_tool.tests.unit.conftest import Freely, JumpingTime

HOME = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
AWAY = (2.6, -1.2, 1.9, -2.0, -1.4, 0.5)
VALIDATED = datetime(2026, 3, 2, tzinfo=UTC)
BENCH = {"kind": "reducedSpeed", "box": [0.1, 2.0, 4.0], "position": [0.0, -1.1, 1.0]}
POST = {"post": {"box": [0.1, 0.1, 0.1], "position": [2.5, 2.5, 0.0]}}
PLANNED = pytest.mark.parametrize(
    "is_planned",
    [
        False,
        pytest.param(
            True, marks=pytest.mark.skipif(not is_available(), reason="the extra motion has no wheels here")
        ),
    ],
)


class Steered(Freely):
    """Work that waits while a limit holds it up."""

    async def rest(self) -> None:
        return


class Recorded:
    """A cell whose robot records each setpoint that is commanded."""

    def __init__(self, folder: Path, time: JumpingTime, scene: dict[str, Any]) -> None:
        file = folder / "cell.yaml"
        file.write_text(
            yaml.safe_dump({"scene": {"name": "cell", **scene}, "robots": {"ur10-1": {"speed": 1.0}}})
        )
        self.cell = RobotCell(TrajectorySettings.load(data_dir=folder, cell_file=file), time.clock)
        self.setpoints: list[Setpoint] = []
        robot = self.unit.robot
        assert isinstance(robot, SimulatedRobot)
        self.robot, command = robot, robot.command

        def record(setpoint: Setpoint) -> None:
            self.setpoints.append(setpoint)
            command(setpoint)
            if len(self.setpoints) % 5 == 0:  # every 40 ms
                self.unit.speed.evaluate()

        robot.command = record  # type: ignore[method-assign]

    @property
    def unit(self) -> RobotUnit:
        return self.cell.only

    async def move(self, *targets: tuple[float, ...]) -> None:
        async with self.cell:
            work = Work("task", "moveTo", self.unit, Steered(), 1.0)
            for target in targets:
                await work.go(target)

    async def servo(self, velocity: Velocity, seconds: float) -> None:
        async with self.cell:
            ends_s = self.robot.clock.now_s() + seconds
            await self.robot.servo(velocity, lambda: self.robot.clock.now_s() >= ends_s, lambda: 1.0)

    def speeds(self, within: Callable[[Setpoint], bool] = lambda _: True) -> list[float]:
        return [
            tool_speed_mps(self.unit.model, setpoint) for setpoint in self.setpoints[::5] if within(setpoint)
        ]

    def is_in(self, zone: Zone) -> Callable[[Setpoint], bool]:
        return lambda setpoint: zone.contains(self.unit.model.tool_pose(setpoint.positions).position)


@PLANNED
async def test_the_tool_is_slow_everywhere_in_a_zone_and_fast_outside(
    tmp_path: Path, time: JumpingTime, is_planned: bool
) -> None:
    made = Recorded(tmp_path, time, {"zones": {"bench": BENCH}, "obstacles": POST if is_planned else {}})
    (zone,) = made.unit.scene.all_zones()
    stop = MeasuredStop(delay_s=0.052, deceleration_mps2=5.3, measured_at=VALIDATED)
    await made.unit.speed.set_stop(stop, "Aino")
    await made.move(AWAY, HOME)
    inside = made.speeds(made.is_in(zone))
    assert len(inside) > 10
    assert max(inside) <= 0.25
    assert max(made.speeds()) > 0.3


@PLANNED
async def test_a_validated_speed_is_never_exceeded(
    tmp_path: Path, time: JumpingTime, is_planned: bool
) -> None:
    made = Recorded(tmp_path, time, {"obstacles": POST if is_planned else {}})
    speed = SafeSpeed(end_effector="gripper", speed_mps=0.3, validated_at=VALIDATED)
    await made.unit.speed.set_safe_speed(speed, "Aino")
    await made.move(AWAY, HOME)
    assert 0.25 < max(made.speeds()) <= 0.3


async def test_commanded_velocities_slow_down_for_a_zone(tmp_path: Path, time: JumpingTime) -> None:
    made = Recorded(tmp_path, time, {"zones": {"bench": BENCH}})
    (zone,) = made.unit.scene.all_zones()
    await made.servo(lambda: (1.2, 0.0, 0.0, 0.0, 0.0, 0.0), 3.0)
    inside = made.speeds(made.is_in(zone))
    assert len(inside) > 10
    assert max(inside) <= 0.25 * 1.001
    assert max(made.speeds()) > 0.4


async def test_a_lower_limit_slows_commanded_velocities_down(tmp_path: Path, time: JumpingTime) -> None:
    made = Recorded(tmp_path, time, {})

    def velocity() -> tuple[float, ...]:
        if len(made.setpoints) == 60:
            made.unit.speed._store.put(
                "ur10-1", made.unit.speed.record.model_copy(update={"mode": "reduced"})
            )
        return (0.8, 0.0, 0.0, 0.0, 0.0, 0.0)

    await made.servo(velocity, 3.0)
    assert max(made.speeds()) > 0.4
    assert 0.1 < tool_speed_mps(made.unit.model, made.setpoints[200]) <= 0.25 * 1.001
