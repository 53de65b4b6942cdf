import asyncio
import time as real_time
from typing import Any

import pytest

from handover.performer import TaskCancelled, TaskFailed
from handover.tasks.outcomes import is_outcome_unknown
from handover_datamodels.streams import SpeedLimitReport
from handover_robots.model.faults import RobotFault
from handover_robots.settings import TrajectorySettings


async def picked(worker: Any) -> dict[str, Any]:
    seen = await worker.do("scan", bin="bin-1")
    return dict(await worker.do("pick", part=seen["part"], pose=seen["pose"]))


async def test_a_part_is_scanned_picked_and_placed(worker: Any) -> None:
    seen = await worker.do("scan", bin="bin-1")
    assert seen["found"]
    assert seen["bin"] == "bin-1"
    assert await worker.do("pick", part=seen["part"], pose=seen["pose"]) == {
        "part": seen["part"],
        "gripped": True,
    }
    assert worker.unit.held == seen["part"]
    placed = await worker.do("place", location="fixture-1")
    assert placed["part"] == seen["part"]
    assert placed["location"] == "fixture-1"
    assert worker.unit.held is None
    lying = worker.unit.contents.find(seen["part"])
    assert lying.place == "fixture-1"
    assert lying.pose.written() == placed["pose"]


async def test_home_and_joint_targets_are_reached(worker: Any) -> None:
    target = [0.1, -1.2, 1.1, -1.4, -1.5, 0.3]
    assert (await worker.do("moveTo", joints=target))["joints"] == target
    assert worker.unit.joints == tuple(target)
    await worker.do("home")
    assert worker.unit.joints == worker.unit.home


async def test_a_pose_is_reached_with_the_tip_of_the_tool(worker: Any) -> None:
    await worker.do("moveTo", pose={"position": [-0.4, 0.5, 0.4], "orientation": [0, 1, 0, 0]})
    tool = worker.unit.tool_pose
    assert tool.position == pytest.approx((-0.4, 0.5, 0.4), abs=1e-6)
    assert [abs(value) for value in tool.orientation] == pytest.approx([0, 1, 0, 0], abs=1e-6)


async def test_speed_scales_the_time_a_motion_takes(worker: Any) -> None:
    there, back = [1.0, -1.2, 1.1, -1.4, -1.5, 0.3], list(worker.unit.home)
    durations = []
    for speed in (1.0, 0.25):
        began_s = worker.time.time_s
        await worker.do("moveTo", joints=there, speed=speed)
        durations.append(worker.time.time_s - began_s)
        await worker.do("moveTo", joints=back)
    assert durations[1] / durations[0] == pytest.approx(4.0, rel=0.02)


async def test_an_unreachable_pose_says_how_far_the_reach_is_and_moves_nothing(worker: Any) -> None:
    before = worker.unit.joints
    with pytest.raises(TaskFailed, match=r'"pose" of moveTo: .*\(2\.000, 0\.000, 0\.500\).*reaches 1\.30 m'):
        await worker.do("moveTo", pose={"position": [2, 0, 0.5]})
    with pytest.raises(TaskFailed, match=r'"joints" of moveTo: elbow_joint cannot be at 9\.000 rad'):
        await worker.do("moveTo", joints=[0, 0, 9, 0, 0, 0])
    assert worker.unit.joints == before


async def test_a_bin_that_does_not_exist_is_refused_with_the_known_ones(worker: Any) -> None:
    with pytest.raises(TaskFailed, match=r'no bin "bin-9"; the cell has bin-1'):
        await worker.do("scan", bin="bin-9")
    with pytest.raises(TaskFailed, match=r'no bin "bin-9"; the cell has bin-1'):
        await worker.do("pick", bin="bin-9")


async def test_an_empty_bin_is_not_found_empty_twice_where_people_fill_it(worker: Any) -> None:
    worker.unit.contents = worker.unit.contents.emptied("bin-1")
    with pytest.raises(TaskFailed, match="bin-1 is empty"):
        await worker.do("pick", bin="bin-1")
    seen = await worker.do("scan", bin="bin-1")
    assert seen == {"found": False, "bin": "bin-1", "reason": "bin-1 is empty"}
    assert (await worker.do("scan", bin="bin-1"))["part"] == "part-7"


async def test_a_part_that_the_camera_misses_is_not_found(worker: Any, settings: TrajectorySettings) -> None:
    blind = type(worker)(settings.model_copy(update={"detection_rate": 0.0}), worker.time)
    async with blind.unit:
        seen = await blind.do("scan", bin="bin-1")
    assert seen == {"found": False, "bin": "bin-1", "reason": "no part lies free in bin-1"}


async def test_a_pick_where_no_part_lies_fails_with_the_gripper_open_and_the_arm_up(worker: Any) -> None:
    with pytest.raises(TaskFailed, match=r"no part at \(-0\.550, -0\.550, 0\.200\) m; scan the bin again"):
        await worker.do("pick", pose={"position": [-0.55, -0.55, 0.2]})
    assert not worker.unit.robot.gripper_closed
    assert worker.unit.held is None
    assert worker.unit.tool_pose.position[2] == pytest.approx(0.35, abs=1e-6)


async def test_a_pick_of_another_part_than_lies_there_puts_it_back(worker: Any) -> None:
    lying = worker.unit.contents.find("part-2")
    with pytest.raises(TaskFailed, match=r'"part-2" lies at .* where "part-1" was requested'):
        await worker.do("pick", part="part-1", pose=lying.pose.written())
    assert worker.unit.held is None
    assert worker.unit.contents.find("part-2").place == "bin-1"


async def test_a_pick_without_parameters_takes_the_part_last_seen(worker: Any) -> None:
    with pytest.raises(TaskFailed, match="no part has been seen yet"):
        await worker.do("pick")
    seen = await worker.do("scan", bin="bin-1")
    assert (await worker.do("pick"))["part"] == seen["part"]


async def test_a_part_is_picked_by_its_name_or_from_its_bin(worker: Any) -> None:
    assert (await worker.do("pick", part="part-4"))["part"] == "part-4"
    await worker.do("place", location="fixture-1")
    assert (await worker.do("pick", bin="bin-1"))["part"] == "part-1"
    with pytest.raises(TaskFailed, match='holds "part-1"; place it'):
        await worker.do("pick", part="part-2")


async def test_a_part_that_is_nowhere_cannot_be_picked(worker: Any) -> None:
    with pytest.raises(TaskFailed, match='no part "part-99" lies in the cell'):
        await worker.do("pick", part="part-99")


async def test_a_place_with_an_empty_gripper_fails(worker: Any) -> None:
    with pytest.raises(TaskFailed, match="the gripper is empty; pick a part before"):
        await worker.do("place", location="fixture-1")


async def test_a_place_that_does_not_exist_is_refused_with_the_known_ones(worker: Any) -> None:
    await picked(worker)
    with pytest.raises(TaskFailed, match=r'no fixture "shelf"; the cell has fixture-1'):
        await worker.do("place", location="shelf")
    assert worker.unit.held == "part-1"


async def test_a_part_placed_at_a_pose_lies_there_and_can_be_picked_again(worker: Any) -> None:
    await picked(worker)
    pose = {"position": [-0.3, 0.6, 0.1]}
    placed = await worker.do("place", pose=pose)
    assert "location" not in placed
    assert (await worker.do("pick", pose=pose))["part"] == placed["part"]


async def test_a_full_fixture_is_emptied_by_the_next_station(worker: Any) -> None:
    nests = []
    for _ in range(5):
        await picked(worker)
        nests.append((await worker.do("place", location="fixture-1"))["pose"]["position"])
    assert len({tuple(nest) for nest in nests}) == 4
    assert nests[4] == nests[0]
    assert len(worker.unit.parts_in("fixture-1")) == 1


async def test_a_target_needs_a_position_for_each_joint(worker: Any) -> None:
    with pytest.raises(TaskFailed, match=r"UR10 has 6 joints \(shoulder_pan_joint, .*\), and 7 positions"):
        await worker.do("moveTo", joints=[0.0] * 7)


async def test_a_fixture_that_nobody_empties_is_full(worker: Any, tmp_path: Any) -> None:
    own = tmp_path / "scene.yaml"
    own.write_text(
        worker.unit.model.scene.read_text(encoding="utf-8").replace("emptied: true", "emptied: false")
    )
    strict = type(worker)(
        worker.settings.model_copy(update={"scene_file": own, "robot_name": "ur10-2"}), worker.time
    )
    async with strict.unit:
        for _ in range(4):
            await picked(strict)
            await strict.do("place", location="fixture-1")
        await picked(strict)
        with pytest.raises(TaskFailed, match="all nests of fixture-1 are full"):
            await strict.do("place", location="fixture-1")
        assert strict.unit.held == "part-5"


async def test_a_person_can_take_the_part_out_of_the_gripper(worker: Any) -> None:
    await picked(worker)
    assert await worker.unit.free() == "part-1"
    assert worker.unit.held is None
    assert worker.unit.contents.find("part-1") is None
    assert (await worker.do("pick", part="part-2"))["part"] == "part-2"


class AfterTheGripper:
    """Ends the work, as a power cut would, after the gripper has acted and before the Task is done."""

    def __init__(self, unit: Any, held: bool) -> None:
        self.unit, self.held = unit, held
        self.acted = False

    def may_go(self) -> bool:
        self.acted = self.acted or (self.unit.held is not None) is self.held
        return not self.acted

    async def rest(self) -> None:
        raise TaskCancelled("power cut")


async def test_a_pick_cut_short_after_the_grip_is_not_done_twice(worker: Any) -> None:
    with pytest.raises(TaskCancelled):
        await worker.do("pick", task="pick", bin="bin-1", steering=AfterTheGripper(worker.unit, held=True))
    down = worker.unit.tool_pose
    again = worker.after_a_power_cut()
    async with again.unit:
        assert again.unit.held == "part-1"
        assert again.unit.robot.gripper_closed
        assert again.unit.tool_pose.distance_m(down) < 1e-6
        assert await again.do("pick", task="pick", bin="bin-1") == {"part": "part-1", "gripped": True}
        assert len(again.unit.parts_in("bin-1")) == 5
        assert again.unit.tool_pose.position[2] > down.position[2] + 0.1


async def test_a_place_cut_short_after_the_release_is_not_done_twice(worker: Any) -> None:
    await picked(worker)
    with pytest.raises(TaskCancelled):
        await worker.do(
            "place", task="place", location="fixture-1", steering=AfterTheGripper(worker.unit, held=False)
        )
    again = worker.after_a_power_cut()
    async with again.unit:
        placed = await again.do("place", task="place", location="fixture-1")
        assert placed["part"] == "part-1"
        assert placed["location"] == "fixture-1"
        assert [part.part for part in again.unit.parts_in("fixture-1")] == ["part-1"]
        with pytest.raises(TaskFailed, match="the gripper is empty"):
            await again.do("place", task="another", location="fixture-1")


class PowerCut(BaseException):
    """Ends the run of a Task where nothing can be recorded any more."""


@pytest.mark.parametrize(
    ("operation", "asked", "act", "why"),
    [
        ("pick", {"bin": "bin-1"}, "close_gripper", "while the gripper closed for t; look what it holds"),
        ("place", {"location": "fixture-1"}, "open_gripper", "while the gripper opened for t; look whether"),
    ],
)
async def test_an_act_of_the_gripper_without_a_record_has_an_unknown_outcome(
    worker: Any, monkeypatch: pytest.MonkeyPatch, *, operation: str, asked: Any, act: str, why: str
) -> None:
    if operation == "place":
        await picked(worker)

    async def cut() -> bool:
        raise PowerCut

    monkeypatch.setattr(worker.unit.robot, act, cut)
    with pytest.raises(PowerCut):
        await worker.do(operation, task="t", **asked)
    again = worker.after_a_power_cut()
    async with again.unit:
        here = again.unit.joints
        with pytest.raises(TaskFailed, match=why) as failed:
            await again.do(operation, task="t", **asked)
        assert is_outcome_unknown({"reason": failed.value.reason})
        with pytest.raises(TaskFailed, match=why) as failed:
            await again.do("pick", task="another", bin="bin-1")
        assert not is_outcome_unknown({"reason": failed.value.reason}), "nothing was begun for this Task"
        assert again.unit.joints == here
        await again.do("home")
        await again.unit.free()
        assert (await again.do("pick", bin="bin-1"))["gripped"]


async def test_a_part_that_is_held_already_counts_as_picked(worker: Any) -> None:
    await picked(worker)
    assert (await worker.do("pick", part="part-1"))["gripped"]


class PausedAt:
    """Holds the work up in `after_s` from now on the robot's clock; after the rest it may go on."""

    def __init__(self, worker: Any, after_s: float) -> None:
        self.time, self.at_s = worker.time, worker.time.time_s + after_s
        self.unit = worker.unit
        self.rests: list[Any] = []

    def may_go(self) -> bool:
        return bool(self.rests) or self.time.time_s < self.at_s

    async def rest(self) -> None:
        self.rests.append(self.unit.robot.state())


async def test_a_pause_in_the_middle_rests_and_then_reaches_the_target(worker: Any) -> None:
    target = [2.0, -1.2, 1.1, -1.4, -1.5, 0.3]
    pause = PausedAt(worker, after_s=1.0)
    await worker.do("moveTo", joints=target, steering=pause)
    assert len(pause.rests) == 1
    assert pause.rests[0].velocities == (0.0,) * 6
    assert 0.1 < pause.rests[0].positions[0] < 1.9
    assert worker.unit.joints == tuple(target)


async def test_a_stop_on_the_way_is_no_progress(worker: Any) -> None:
    target = [2.0, -1.2, 1.1, -1.4, -1.5, 0.3]
    pause = PausedAt(worker, after_s=1.0)
    seen: list[float] = []
    remaining_s: list[float] = []

    def look(now_s: float) -> None:
        if worker.work and not pause.rests:
            seen.append(worker.work.progress())
            remaining_s.append(worker.work.remaining_s())

    worker.time.on_wait = look
    await worker.do("moveTo", joints=target, steering=pause)
    assert pause.rests[0].positions[0] < 1.9
    assert 0.2 < seen[-1] < 0.8
    assert min(remaining_s) > 0.2


async def test_progress_never_goes_back_and_ends_at_one(worker: Any) -> None:
    seen: list[float] = []
    pause = PausedAt(worker, after_s=2.5)
    worker.time.on_wait = lambda now_s: seen.append(worker.work.progress()) if worker.work else None
    await worker.do("pick", bin="bin-1", steering=pause)
    assert pause.rests
    assert seen == sorted(seen)
    assert seen[0] < 0.1
    assert worker.work.progress() == pytest.approx(1.0)
    assert worker.work.remaining_s() == 0.0


async def test_each_robot_task_of_the_process_takes_a_few_seconds(worker: Any) -> None:
    took = {}
    for operation, asked in (
        ("scan", {"bin": "bin-1"}),
        ("pick", {}),
        ("place", {"location": "fixture-1"}),
        ("home", {}),
    ):
        began_s = worker.time.time_s
        await worker.do(operation, **asked)
        took[operation] = worker.time.time_s - began_s
    assert all(1.0 < seconds < 4.0 for seconds in took.values()), took


async def test_a_robot_that_is_switched_off_does_not_move(worker: Any, settings: TrajectorySettings) -> None:
    other = worker.after_a_power_cut()
    async with other.unit:
        pass
    with pytest.raises(RobotFault, match="switched off"):
        await other.do("moveTo", joints=[0.0, -1.0, 1.0, -1.0, -1.0, 0.0])


async def test_reduced_mode_slows_a_motion_down(worker: Any) -> None:
    target = [2.0, -1.2, 1.1, -1.4, -1.5, 0.3]
    began_s = worker.time.time_s
    await worker.do("moveTo", joints=target)
    full_s = worker.time.time_s - began_s
    await worker.do("home")
    await worker.unit.speed.set_mode("reduced", "Aino")
    began_s = worker.time.time_s
    await worker.do("moveTo", joints=target)
    assert worker.time.time_s - began_s > 2 * full_s


async def test_a_stop_by_a_limit_lasts_until_its_end_and_the_target_is_reached(worker: Any) -> None:
    target = [2.0, -1.2, 1.1, -1.4, -1.5, 0.3]
    stop = SpeedLimitReport(source="heart", stamp=real_time.time(), fraction=0.0, reason="heart rate")
    await worker.unit.speed.receive_limit(stop)
    moving = asyncio.create_task(worker.do("moveTo", joints=target))
    await asyncio.sleep(0.2)
    assert worker.unit.joints == worker.unit.home
    await worker.unit.speed.remove("heart", "Aino", "a test")
    await moving
    assert worker.unit.joints == tuple(target)


async def test_a_scan_looks_from_an_adjusted_position(worker: Any) -> None:
    view = worker.unit.scene.bins["bin-1"].view.pose
    await worker.do("scan", bin="bin-1", offset=[0.02, -0.03, 0.04])
    assert worker.unit.tool_pose.distance_m(view.moved((0.02, -0.03, 0.04))) < 0.001


async def test_a_scan_from_a_view_that_the_bin_does_not_have_is_refused(worker: Any) -> None:
    with pytest.raises(TaskFailed, match="bin-1 has 1 views, from 0 to 0"):
        await worker.do("scan", bin="bin-1", view=1)
