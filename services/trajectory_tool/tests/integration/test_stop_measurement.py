from pathlib import Path

import pytest

from handover_robots.cell.cell import RobotCell
from handover_robots.settings import TrajectorySettings
from handover_robots.tasks.stop_measurement import StopMeasurement, measure_stop


async def test_the_stop_of_a_robot_is_measured(tmp_path: Path) -> None:
    settings = TrajectorySettings.load(data_dir=tmp_path)
    async with RobotCell(settings) as cell:
        unit = cell.only
        stop = await measure_stop(unit, (unit.home[0] + 3.0, *unit.home[1:]), 0.4)
    assert stop.speed_mps > 0.05
    assert 0 <= stop.delay_s <= stop.duration_s
    assert stop.distance_m > 0.0


def test_the_deceleration_leads_to_the_measured_way() -> None:
    stop = StopMeasurement(speed_mps=1.0, delay_s=0.1, duration_s=0.8, distance_m=0.4)
    assert stop.deceleration_mps2 == pytest.approx(1 / 0.6)
    assert stop.speed_mps * stop.delay_s + 1.0 / (2 * stop.deceleration_mps2) == pytest.approx(0.4)
