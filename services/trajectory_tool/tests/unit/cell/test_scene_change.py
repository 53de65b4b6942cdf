"""The scene changes while robots work: validated, durable, and in the middle of a motion."""

from pathlib import Path
from typing import Any

import pytest

from handover.errors import UsageError
from handover_robots.cell.cell import RobotCell
from handover_robots.model.poses import pointing_down
from handover_robots.planning import is_available
from handover_robots.routes.scenes import drawn_shapes
from handover_robots.scene.scene_entities import things_of
from handover_robots.settings import TrajectorySettings

pytestmark = pytest.mark.skipif(not is_available(), reason="the extra motion has no wheels here")

OVER_THE_BIN = {"position": [-0.55, -0.55, 0.4]}
OVER_THE_FIXTURE = {"position": [-0.55, 0.45, 0.4]}
CRATE = {"box": [0.2, 0.06, 0.6], "position": [-0.75, 0.2, 0.3]}


def written(cell: RobotCell, **changed: Any) -> dict[str, Any]:
    """Return the scene as GET answers, some of it changed."""
    return {**cell.scene.model_dump(mode="json"), "digest": "x", "revision": 1, "parts": [], **changed}


async def test_an_obstacle_that_appears_on_the_way_is_avoided(worker: Any, time: Any) -> None:
    await worker.do("moveTo", pose=OVER_THE_BIN)
    unit, cell = worker.unit, worker.cell
    content = written(cell, obstacles={"crate": CRATE})
    await cell.change_scene(written(cell))
    began = unit.planning.revision
    path: list[Any] = []
    changes_s = time.time_s + 0.4
    solids = (
        type(cell.scene)
        .model_validate(
            {key: value for key, value in content.items() if key not in {"digest", "revision", "parts"}}
        )
        .solids()
    )

    def change(now_s: float) -> None:
        path.append(unit.joints)
        if now_s > changes_s and unit.planning.revision == began:
            unit.planning.set_obstacles(solids)
            path.clear()

    time.on_wait = change
    await worker.do("moveTo", pose=OVER_THE_FIXTURE)
    assert unit.planning.revision == began + 1
    assert unit.tool_pose.distance_m(pointing_down((-0.55, 0.45, 0.4))) < 1e-4

    def contacts(planner: Any) -> list[str]:
        return [str(why) for joints in path[::3] if (why := planner.why_not_free(joints)) is not None]

    assert await unit.planning.plan(contacts) == []


async def test_a_change_is_kept_and_counted(settings: TrajectorySettings) -> None:
    first = RobotCell(settings)
    before = first.scene.digest
    notified: list[int] = []
    first.on_scene_change = lambda: notified.append(first.revision)
    await first.change_scene(written(first, obstacles={"crate": CRATE}))
    assert notified == [1]
    assert first.scene.digest != before
    again = RobotCell(settings)
    assert again.revision == 1
    assert again.scene.digest == first.scene.digest
    assert "crate" in again.scene.obstacles
    assert again.only.planning.avoids_obstacles
    assert again.contents == first.contents
    heavier = {**again.scene.gripper.model_dump(mode="json"), "part_mass_kg": 9.0}
    await again.change_scene(written(again, gripper=heavier))
    assert again.only.planning.part_mass_kg == 9.0
    with pytest.raises(UsageError, match="may carry"):
        await again.change_scene(written(again, gripper=heavier | {"part_mass_kg": 9.5}))


async def test_another_scene_file_takes_the_place_of_a_change(
    settings: TrajectorySettings, tmp_path: Path
) -> None:
    await (first := RobotCell(settings)).change_scene(written(first, obstacles={"crate": CRATE}))
    file = tmp_path / "scene.yaml"
    file.write_text("name: other\n")
    other = RobotCell(settings.model_copy(update={"scene_file": file}))
    assert (other.scene.name, other.revision, other.scene.obstacles) == ("other", 0, {})


async def test_parts_follow_the_bins_and_fixtures(settings: TrajectorySettings) -> None:
    cell = RobotCell(settings)
    bin_1 = cell.scene.model_dump(mode="json")["bins"]["bin-1"]
    moved = {**bin_1, "parts": bin_1["parts"][:2]}
    await cell.change_scene(written(cell, bins={"bin-1": bin_1, "bin-2": moved}))
    assert len(cell.contents.in_place("bin-1")) == 6
    assert [lying.part for lying in cell.contents.in_place("bin-2")] == ["part-7", "part-8"]
    await cell.change_scene(written(cell, bins={"bin-2": moved}))
    assert {lying.place for lying in cell.contents.lying} == {"bin-2"}


@pytest.mark.parametrize(
    ("changed", "fault"),
    [
        ({"obstacles": {"crate": {"position": [0, 0, 0]}}}, "needs one of"),
        ({"obstacles": {"crate": {**CRATE, "position": [0, 0, float("nan")]}}}, "finite"),
        ({"obstacles": {"crate": {**CRATE, "box": [0, 1, 1]}}}, "greater than 0"),
        ({"zones": {"bin-1": {**CRATE, "kind": "keepOut"}}}, '"bin-1" is a bin and a zone'),
        ({"fixtures": {"f": {"nests": [{"position": [9, 9, 0.1]}]}}}, r"fixtures\.f\.nests\.0: .*reach"),
        ({"obstacles": {"m": {"mesh": "../../etc/passwd", "position": [0, 0, 0]}}}, "beside the scene file"),
        ({"obstacles": {"m": {"mesh": "/etc/passwd", "position": [0, 0, 0]}}}, "beside the scene file"),
        ({"obstacles": {"m": {"mesh": "none.stl", "position": [0, 0, 0]}}}, "none.stl cannot be read"),
        ({"furniture": {}}, "Extra inputs"),
    ],
)
async def test_a_faulty_change_is_refused_and_nothing_changes(
    settings: TrajectorySettings, changed: dict[str, Any], fault: str
) -> None:
    cell = RobotCell(settings)
    before = cell.scene.digest
    with pytest.raises(UsageError, match=fault):
        await cell.change_scene(written(cell, **changed))
    assert (cell.scene.digest, cell.revision) == (before, 0)
    assert RobotCell(settings).revision == 0


async def test_a_robot_that_a_new_obstacle_touches_is_named(settings: TrajectorySettings) -> None:
    cell = RobotCell(settings)
    x, y, z = cell.only.tool_pose.position
    around_tool = {"box": [0.3, 0.3, 0.3], "position": [x, y, z]}
    await cell.change_scene(written(cell, obstacles={"crate": around_tool}))
    (contact,) = await cell.contacts()
    assert contact.startswith("ur10-1: ")
    assert "crate" in contact


@pytest.mark.parametrize("text", ["", "{}", '{"origin": 1}'])
async def test_a_damaged_change_is_refused_with_the_way_out(settings: TrajectorySettings, text: str) -> None:
    await (cell := RobotCell(settings)).change_scene(written(cell))
    (settings.data_dir / "trajectory_tool" / "scene.json").write_text(text)
    with pytest.raises(UsageError, match=r"scene\.json is damaged; delete it"):
        RobotCell(settings)


async def test_each_thing_is_drawn_and_written(settings: TrajectorySettings) -> None:
    cell = RobotCell(settings)
    sphere = {"sphere": 0.1, "position": [1, 1, 1]}
    await cell.change_scene(
        written(
            cell,
            obstacles={"crate": CRATE},
            fences={"fence": {"points": [[1, 1], [1, 2]]}},
            cameras={"camera": {"position": [0, 0, 2]}},
            zones={"walkway": {**sphere, "kind": "reducedSpeed"}, "gap": {**sphere, "kind": "keepOut"}},
        )
    )
    drawn = {shape["name"]: shape["kind"] for shape in drawn_shapes(cell.scene)}
    assert drawn == {
        "crate": "obstacle",
        "fence": "fence",
        "camera": "camera",
        "walkway": "reducedSpeed",
        "gap": "keepOut",
    }
    things = things_of(cell.scene)
    assert {name for kind in things.values() for name in kind} == {*drawn, "bin-1", "fixture-1"}
