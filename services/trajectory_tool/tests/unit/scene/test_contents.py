import pytest

from handover_robots.model.poses import Pose, pointing_down
from handover_robots.robots.ur10 import ROBOT
from handover_robots.scene.contents import Contents, Grip, initial
from handover_robots.scene.reading import load

SCENE = load(None, ROBOT)


def test_the_parts_of_a_new_cell_lie_in_its_bin() -> None:
    contents = initial(SCENE)
    parts = [lying.part for lying in contents.in_place("bin-1")]
    assert parts == ["part-1", "part-2", "part-3", "part-4", "part-5", "part-6"]


def test_a_part_moves_from_the_bin_to_the_gripper_to_the_fixture() -> None:
    gripped = initial(SCENE).gripped("part-2")
    assert gripped.find("part-2") is None
    nest = gripped.free_nest(SCENE, "fixture-1")
    assert nest is not None
    placed = gripped.released("part-2", "fixture-1", nest)
    assert [lying.part for lying in placed.in_place("fixture-1")] == ["part-2"]
    assert len(placed.lying) == 6


def test_a_nest_with_a_part_is_not_free() -> None:
    contents = initial(SCENE)
    for number in range(1, 5):
        nest = contents.free_nest(SCENE, "fixture-1")
        assert nest is not None
        contents = contents.gripped(f"part-{number}").released(f"part-{number}", "fixture-1", nest)
    assert contents.free_nest(SCENE, "fixture-1") is None
    assert contents.emptied("fixture-1").free_nest(SCENE, "fixture-1") is not None


def test_the_gripper_closes_on_the_nearest_part_or_on_nothing() -> None:
    contents = initial(SCENE)
    first = contents.find("part-1")
    assert first is not None
    assert contents.between_fingers(first.pose.raised(0.005), 0.02) == "part-1"
    assert contents.between_fingers(first.pose.raised(0.1), 0.02) is None


def test_a_bin_that_is_filled_again_has_new_parts() -> None:
    contents = initial(SCENE).emptied("bin-1").filled(SCENE, "bin-1")
    assert contents.in_place("bin-1")[0].part == "part-7"
    assert len(contents.lying) == 6


def test_a_nest_is_taken_by_a_part_that_is_held_beside_its_middle() -> None:
    nest = initial(SCENE).free_nest(SCENE, "fixture-1")
    assert nest is not None
    beside = Grip(Pose((0.0, 0.02, -0.006), (0.0, 0.0, 0.0, 1.0)), (0.024, 0.06, 0.024))
    x, y, z = nest.position
    tool = Pose((x, y + 0.02, z), nest.orientation)  # the tool points down: its y is the other way round
    contents = Contents().released("part-1", "fixture-1", tool, beside)
    assert contents.find("part-1").middle[:2] == pytest.approx((x, y))  # type: ignore[union-attr]
    assert contents.free_nest(SCENE, "fixture-1") != nest


def test_a_part_that_is_seen_again_nearby_keeps_its_name() -> None:
    before = Contents().observed("bin-1", [(at(0.0), None), (at(0.1), None)])
    assert [lying.part for lying in before.in_place("bin-1")] == ["part-1", "part-2"]
    after = before.observed("bin-1", [(at(0.3), None), (at(0.105), None)])
    assert [lying.part for lying in after.in_place("bin-1")] == ["part-3", "part-2"]


def test_a_standing_part_reaches_further_below_the_tips_than_a_lying_one() -> None:
    size = (0.024, 0.06, 0.024)
    lying = Grip(Pose((0.0, 0.0, -0.006), (0.0, 0.0, 0.0, 1.0)), size)
    standing = Grip(Pose((0.0, 0.0, 0.012), (2**-0.5, 0.0, 0.0, 2**-0.5)), size)
    assert lying.below_m == pytest.approx(0.006)
    assert standing.below_m == pytest.approx(0.042)


def at(x: float) -> Pose:
    return pointing_down((x, 0.0, 0.1))
