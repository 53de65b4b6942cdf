from services.trajectory_tool.contents import initial
from services.trajectory_tool.robots.ur10 import ROBOT
from services.trajectory_tool.scene import load

SCENE = load(None, ROBOT)


def test_the_parts_of_a_new_cell_lie_in_its_bin() -> None:
    contents = initial(SCENE)
    parts = [one.part for one in contents.in_place("bin-1")]
    assert parts == ["part-1", "part-2", "part-3", "part-4", "part-5", "part-6"]


def test_a_part_moves_from_the_bin_to_the_gripper_to_the_fixture() -> None:
    gripped = initial(SCENE).gripped("part-2")
    assert gripped.find("part-2") is None
    nest = gripped.free_nest(SCENE, "fixture-1")
    assert nest is not None
    placed = gripped.released("part-2", "fixture-1", nest)
    assert [one.part for one in placed.in_place("fixture-1")] == ["part-2"]
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
