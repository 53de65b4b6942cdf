import re
from pathlib import Path

import pytest

from handover.errors import UsageError
from handover_robots.robots.ur10 import ROBOT
from handover_robots.scene.reading import load

assert ROBOT.scene is not None
BUILT_IN = ROBOT.scene


def written(tmp_path: Path, *replacements: tuple[str, str]) -> Path:
    text = BUILT_IN.read_text(encoding="utf-8")
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new)
    file = tmp_path / "scene.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def test_the_built_in_cell_has_the_bin_and_the_fixture_of_the_process() -> None:
    scene = load(None, ROBOT)
    assert "bin-1" in scene.bins
    assert "fixture-1" in scene.fixtures


def test_a_scene_file_is_read(tmp_path: Path) -> None:
    scene = load(written(tmp_path, ("bin-1:", "crate:"), ("looks_for_s: 0.5", "looks_for_s: 2")), ROBOT)
    assert scene.bins["crate"].looks_for_s == 2
    assert scene.digest != load(None, ROBOT).digest


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("[-0.60, -0.50, 0.09]", "[-1.60, -0.50, 0.09]", r"bins\.bin-1\.parts\.0: .*reaches 1\.30 m"),
        ("[-0.60, -0.50, 0.09]", "[-0.60, -0.50]", r"bins\.bin-1\.parts\.0\.position"),
        ("[-0.60, -0.50, 0.09]", "[-0.60, .nan, 0.09]", r"bins\.bin-1\.parts\.0\.position\.1: .*finite"),
        ("yaw_deg: 17", "yaw_grad: 17", r"bins\.bin-1\.parts\.0\.yaw_grad"),
        ("fixture-1:", "bin-1:", r'"bin-1" is a bin and a fixture'),
        ("approach_m: 0.15", "approach_m: 15", r"gripper\.approach_m: .*less than or equal to 1"),
        ("gripper:", "home: [0]\ngripper:", r"home: UR10 has 6 joints .*wrist_3_joint\), and 1 positions"),
        (
            "gripper:",
            "home: [7, 0, 0, 0, 0, 0]\ngripper:",
            r"home: shoulder_pan_joint cannot be at 7\.000 rad",
        ),
        ("view: {position: [-0.55", "view: {position: [0.01", r"bins\.bin-1\.view"),
        ("fixtures:", "fixtures: {", "is not YAML"),
        (
            "gripper:\n",
            "gripper:\n  part_mass_kg: 9.1\n",
            r"gripper: a part of 9\.1 kg and the tool of 1 kg are more than the 10 kg that UR10 may carry",
        ),
    ],
)
def test_a_fault_in_a_scene_is_a_line_that_names_its_place(
    tmp_path: Path, old: str, new: str, complaint: str
) -> None:
    file = written(tmp_path, (old, new))
    if complaint.startswith(r"bins\.bin-1\.view"):
        file = written(tmp_path, (old, new), ("-0.55, 0.50], yaw_deg: 0}    #", "0.01, 0.50]} #"))
    with pytest.raises(UsageError, match=complaint) as fault:
        load(file, ROBOT)
    assert all(str(file) in line for line in str(fault.value).splitlines())


def test_a_missing_scene_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=re.escape(str(tmp_path / "none.yaml"))):
        load(tmp_path / "none.yaml", ROBOT)


@pytest.mark.parametrize("text", ["", "- a list", "just words"])
def test_a_file_that_is_no_scene_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "scene.yaml").write_text(text)
    with pytest.raises(UsageError, match="must name the cell"):
        load(tmp_path / "scene.yaml", ROBOT)
