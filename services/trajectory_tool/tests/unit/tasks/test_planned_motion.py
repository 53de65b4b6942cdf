"""Tasks in a cell with obstacles: every motion is planned, followed, paused, and planned again."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handover.errors import UsageError
from handover.performer import TaskFailed
from handover_robots.cell import motion
from handover_robots.cell.cell import RobotCell
from handover_robots.cell.robot_unit import RobotUnit
from handover_robots.model.obstacles import Box, Obstacle
from handover_robots.model.poses import Pose, pointing_down
from handover_robots.planning import is_available
from handover_robots.robots import ur10
from handover_robots.settings import TrajectorySettings
from tests.kit.paths import REPOSITORY

pytestmark = pytest.mark.skipif(not is_available(), reason="the extra motion has no wheels here")

SCENE = ur10.FOLDER / "bin_picking_with_obstacles.yaml"
OVER_THE_BIN = {"position": [-0.55, -0.55, 0.4]}
OVER_THE_FIXTURE = {"position": [-0.55, 0.45, 0.4]}
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


@pytest.fixture
def settings(settings: TrajectorySettings) -> TrajectorySettings:
    return settings.model_copy(update={"scene_file": SCENE})


@pytest.fixture
async def path(worker: Any, time: Any) -> list[tuple[float, ...]]:
    """The joints of every control cycle."""
    seen: list[tuple[float, ...]] = []
    time.on_wait = lambda now_s: seen.append(worker.unit.joints)
    return seen


async def touching(unit: RobotUnit, path: list[tuple[float, ...]]) -> list[str]:
    def contacts(planner: Any) -> list[str]:
        return [str(why) for joints in path if (why := planner.why_not_free(joints)) is not None]

    return await unit.planning.plan(contacts)


async def test_a_part_is_picked_and_placed_without_a_contact(worker: Any, path: list[Any]) -> None:
    seen = await worker.do("scan", bin="bin-1")
    assert await worker.do("pick", part=seen["part"], pose=seen["pose"]) == {
        "part": seen["part"],
        "gripped": True,
    }
    placed = await worker.do("place", location="fixture-1")
    assert placed["location"] == "fixture-1"
    await worker.do("home")
    assert worker.unit.joints == pytest.approx(worker.unit.home)
    assert len(path) > 500
    assert await touching(worker.unit, path[::5]) == []


async def test_the_way_leads_around_what_a_straight_line_would_touch(worker: Any, path: list[Any]) -> None:
    low = {"position": [-0.75, 0.22, 0.1]}, {"position": [-0.75, -0.2, 0.1]}
    await worker.do("moveTo", pose=low[0])
    start = np.array(worker.unit.joints)
    await worker.do("moveTo", pose=low[1])
    end = np.array(worker.unit.joints)
    line = [tuple(start + share * (end - start)) for share in np.linspace(0, 1, 100)]
    assert any("divider" in why for why in await touching(worker.unit, line))
    assert await touching(worker.unit, path[::3]) == []


async def test_the_tool_moves_straight_below_its_speed(worker: Any, path: list[Any], time: Any) -> None:
    await worker.do("moveTo", pose=OVER_THE_BIN)
    path.clear()
    began_s = time.time_s
    done = await worker.do("moveLinear", pose={"position": [-0.55, -0.4, 0.3]}, toolSpeed=0.1)
    assert done["pose"]["position"] == pytest.approx([-0.55, -0.4, 0.3], abs=1e-4)
    assert time.time_s - began_s > np.hypot(0.15, 0.1) / 0.1
    model = worker.unit.model
    for joints in path:
        x, y, z = model.tool_pose(joints).position
        assert x == pytest.approx(-0.55, abs=0.001)
        assert z == pytest.approx(0.4 - (y + 0.55) * 0.1 / 0.15, abs=0.002)


async def test_a_target_in_contact_is_refused_with_the_pair_and_nothing_moves(worker: Any) -> None:
    before = worker.unit.joints
    with pytest.raises(TaskFailed, match=r'"pose" of moveTo: .* (touches|mm from) (divider|table)'):
        await worker.do("moveTo", pose={"position": [-0.75, 0.05, 0.2]})
    with pytest.raises(TaskFailed, match=r"moveTo: the robot cannot be at the target: .* table"):
        await worker.do("moveTo", joints=[0.0, 0.3, 0.0, -1.5, -1.5, 0.0])
    with pytest.raises(TaskFailed, match=r"moveLinear: the tool cannot move straight: .*"):
        await worker.do("moveLinear", pose={"position": [-0.68, -0.16, -0.02]})
    assert worker.unit.joints == before


class PausesOnce:
    """A pause at a time, until the robot has come to rest."""

    def __init__(self, time: Any, at_s: float) -> None:
        self._time, self._at_s, self.rested_at = time, at_s, 0.0

    def may_go(self) -> bool:
        return self.rested_at > 0 or self._time.time_s < self._at_s

    async def rest(self) -> None:
        self.rested_at = self._time.time_s


async def test_a_pause_stops_on_the_path_and_the_motion_is_planned_again(
    worker: Any, path: list[Any], time: Any
) -> None:
    steering = PausesOnce(time, time.time_s + 0.8)
    paused_s = time.time_s + 0.8
    await worker.do("moveTo", pose=OVER_THE_FIXTURE, steering=steering)
    assert 0 < steering.rested_at - paused_s < 1.0
    assert worker.unit.tool_pose.distance_m(pointing_down((-0.55, 0.45, 0.4))) < 1e-5
    assert await touching(worker.unit, path[::3]) == []


async def test_changed_obstacles_stop_the_motion_and_are_avoided(
    worker: Any, path: list[Any], time: Any
) -> None:
    await worker.do("moveTo", pose=OVER_THE_BIN)
    planning = worker.unit.planning
    crate = Obstacle("crate", Box((0.2, 0.06, 0.6)), Pose((-0.75, 0.2, 0.3), UPRIGHT))
    changes_s = time.time_s + 0.5

    def change(now_s: float) -> None:
        path.append(worker.unit.joints)
        if now_s > changes_s and planning.revision == 0:
            planning.set_obstacles((*planning.obstacles, crate))
            path.clear()

    time.on_wait = change
    await worker.do("moveTo", pose=OVER_THE_FIXTURE)
    assert planning.revision == 1
    assert worker.unit.tool_pose.distance_m(pointing_down((-0.55, 0.45, 0.4))) < 1e-5
    assert await touching(worker.unit, path[::2]) == []


def test_a_cell_without_obstacles_does_not_load_the_planner(settings: TrajectorySettings) -> None:
    program = (
        "import sys\n"
        "import handover_robots.app\n"
        "from handover_robots.cell.cell import RobotCell\n"
        "from handover_robots.settings import TrajectorySettings\n"
        "unit = RobotCell(TrajectorySettings.load()).only\n"
        "assert not unit.planning.avoids_obstacles\n"
        "print(sorted({'pinocchio', 'coal', 'ompl', 'toppra'} & sys.modules.keys()))\n"
    )
    environment = {**os.environ, "HANDOVER_DATA_DIR": str(settings.data_dir)}
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=REPOSITORY, env=environment
    )
    assert ran.stdout.strip() == "[]", ran.stderr


def test_obstacles_need_the_extra(settings: TrajectorySettings, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(motion, "is_available", lambda: False)
    with pytest.raises(UsageError, match=r"has obstacles, which need motion planning; install the extra"):
        RobotCell(settings)


def test_a_scene_names_faulty_obstacles(settings: TrajectorySettings, tmp_path: Path) -> None:
    file = tmp_path / "cell.yaml"
    file.write_text("name: cell\nobstacles:\n  post: {box: [1, 1, 1], sphere: 0.1, position: [0, 0, 9]}\n")
    with pytest.raises(UsageError, match=r"obstacles\.post: .* needs one of"):
        RobotCell(settings.model_copy(update={"scene_file": file}))


def test_the_walls_of_a_bin_are_inside_its_size(settings: TrajectorySettings) -> None:
    walls = [solid for solid in RobotCell(settings).scene.solids() if solid.name == "bin-1"]
    assert len(walls) == 5
    for wall in walls:
        assert isinstance(wall.shape, Box)
        for axis, (middle, half) in enumerate(((-0.55, 0.2), (-0.535, 0.2))):
            reach = abs(wall.pose.position[axis] - middle) + wall.shape.size[axis] / 2
            assert reach <= half + 1e-9
    assert replace(walls[0], name="other") != walls[0]


async def test_an_arm_without_closed_form_is_moved_to_poses(
    worker: Any, settings: TrajectorySettings, time: Any
) -> None:
    panda = settings.model_copy(update={"robot_model": "panda", "scene_file": None})
    made = type(worker)(panda, time)
    async with made.unit:
        await made.do("moveTo", pose={"position": [0.4, 0.2, 0.3]})
        assert made.unit.tool_pose.position == pytest.approx((0.4, 0.2, 0.3), abs=1e-4)
        with pytest.raises(TaskFailed, match=r"cannot be at \(2\.000, .* the nearest it reaches"):
            await made.do("moveTo", pose={"position": [2.0, 0.0, 0.3]})
