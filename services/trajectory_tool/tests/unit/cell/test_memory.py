from dataclasses import replace
from pathlib import Path

import pytest

from handover.errors import UsageError
from handover_robots.cell.memory import Act, Memory, MemoryFile, RobotMemory
from handover_robots.model.poses import pointing_down
from handover_robots.robots.ur10 import ROBOT
from handover_robots.scene.contents import initial
from handover_robots.scene.reading import load

SCENE = load(None, ROBOT)
ROBOTS = {"ur10-1": ROBOT.joint_names}
MEMORY = Memory(
    scene=SCENE.digest,
    contents=initial(SCENE).gripped("part-3"),
    robots={
        "ur10-1": RobotMemory(
            joint_names=ROBOT.joint_names,
            joints=(0.1, -1.2, 1.3, -1.4, -1.5, 1.6),
            gripper_closed=True,
            held="part-3",
            last_act=Act("urn:ngsi-ld:Task:demo:t", "gripped", "part-3", pointing_down((0.1, 0.2, 0.3), 0.4)),
            seen="part-3",
        )
    },
)


@pytest.fixture
def file(tmp_path: Path) -> MemoryFile:
    return MemoryFile(tmp_path / "trajectory_tool" / "cell.json")


def test_a_saved_memory_is_loaded_with_full_precision(file: MemoryFile) -> None:
    file.save(MEMORY)
    assert file.load(SCENE.digest, ROBOTS) == MEMORY


def test_without_a_file_there_is_no_memory(file: MemoryFile) -> None:
    assert file.load(SCENE.digest, ROBOTS) is None


def test_an_interrupted_write_keeps_the_earlier_memory(file: MemoryFile) -> None:
    file.save(MEMORY)
    file.path.with_suffix(".new").write_bytes(b'{"scene": "')
    assert file.load(SCENE.digest, ROBOTS) == MEMORY


def test_the_memory_of_another_scene_is_ignored(file: MemoryFile) -> None:
    file.save(MEMORY)
    assert file.load("another", ROBOTS) is None


@pytest.mark.parametrize("text", ["", "{", "{}", "[1]", '{"scene": 1}'])
def test_a_damaged_memory_is_refused_with_the_way_out(file: MemoryFile, text: str) -> None:
    file.save(MEMORY)
    file.path.write_text(text)
    with pytest.raises(UsageError, match=r"cell\.json, is damaged; delete it") as refused:
        file.load(SCENE.digest, ROBOTS)
    assert "\n" not in str(refused.value)


def test_a_memory_with_fewer_joints_than_names_is_damaged(file: MemoryFile) -> None:
    robot = replace(MEMORY.robots["ur10-1"], joints=(0.1, 0.2))
    file.save(replace(MEMORY, robots={"ur10-1": robot}))
    with pytest.raises(UsageError, match="is damaged"):
        file.load(SCENE.digest, ROBOTS)


def test_the_memory_of_a_robot_with_other_joints_or_another_name_is_ignored(file: MemoryFile) -> None:
    file.save(MEMORY)
    for robots in ({"ur10-1": ("rail", *ROBOT.joint_names)}, {"ur10-2": ROBOT.joint_names}):
        memory = file.load(SCENE.digest, robots)
        assert memory is not None
        assert memory.contents == MEMORY.contents
        assert memory.robots == {}


def test_a_memory_that_cannot_be_read_is_named(file: MemoryFile) -> None:
    file.path.mkdir(parents=True)
    with pytest.raises(UsageError, match=r"cell\.json, cannot be read"):
        file.load(SCENE.digest, ROBOTS)
