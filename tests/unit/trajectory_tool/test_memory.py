from pathlib import Path

import pytest

from handover.errors import UsageError
from services.trajectory_tool.contents import initial
from services.trajectory_tool.memory import Act, Memory, MemoryFile
from services.trajectory_tool.poses import pointing_down
from services.trajectory_tool.robots.ur10 import ROBOT
from services.trajectory_tool.scene import load

SCENE = load(None, ROBOT)
DIGEST = SCENE.digest(ROBOT.joint_names)
MEMORY = Memory(
    scene=DIGEST,
    joints=(0.1, -1.2, 1.3, -1.4, -1.5, 1.6),
    gripper_closed=True,
    contents=initial(SCENE).gripped("part-3"),
    last_act=Act("urn:ngsi-ld:Task:demo:t", "gripped", "part-3", pointing_down((0.1, 0.2, 0.3), 0.4)),
    seen="part-3",
)


@pytest.fixture
def file(tmp_path: Path) -> MemoryFile:
    return MemoryFile(tmp_path / "trajectory_tool" / "ur10-1.json")


def test_a_saved_memory_is_loaded_with_full_precision(file: MemoryFile) -> None:
    file.save(MEMORY)
    assert file.load(DIGEST, 6) == MEMORY


def test_without_a_file_there_is_no_memory(file: MemoryFile) -> None:
    assert file.load(DIGEST, 6) is None


def test_an_interrupted_write_keeps_the_earlier_memory(file: MemoryFile) -> None:
    file.save(MEMORY)
    file.path.with_suffix(".new").write_bytes(b'{"scene": "')
    assert file.load(DIGEST, 6) == MEMORY


def test_the_memory_of_another_scene_is_ignored(file: MemoryFile) -> None:
    file.save(MEMORY)
    assert file.load("another", 6) is None


@pytest.mark.parametrize("text", ["", "{", "{}", "[1]", '{"scene": 1}'])
def test_a_damaged_memory_is_refused_with_the_way_out(file: MemoryFile, text: str) -> None:
    file.save(MEMORY)
    file.path.write_text(text)
    with pytest.raises(UsageError, match=r"ur10-1\.json, is damaged; delete it") as refused:
        file.load(DIGEST, 6)
    assert "\n" not in str(refused.value)


def test_a_memory_with_fewer_joints_than_the_robot_is_damaged(file: MemoryFile) -> None:
    file.save(MEMORY)
    with pytest.raises(UsageError, match="is damaged"):
        file.load(DIGEST, 7)


def test_the_memory_of_another_robot_is_ignored(file: MemoryFile) -> None:
    file.save(MEMORY)
    assert file.load(SCENE.digest(("rail", *ROBOT.joint_names)), 7) is None


def test_a_memory_that_cannot_be_read_is_named(file: MemoryFile) -> None:
    file.path.mkdir(parents=True)
    with pytest.raises(UsageError, match=r"ur10-1\.json, cannot be read"):
        file.load(DIGEST, 6)
