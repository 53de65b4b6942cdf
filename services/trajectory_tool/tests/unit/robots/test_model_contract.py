"""Every shipped robot keeps the contract of a robot model, and the contract finds what is wrong."""

import os
from dataclasses import replace
from pathlib import Path

import pytest

from handover.extensions import ExtensionPoint
from handover_robots import robots
from handover_robots.model.robot_model import RobotModel
from handover_robots.model_contract import ModelContract
from handover_robots.planning import is_available
from handover_robots.robots import ROBOTS, robots_in
from tests.kit.paths import REPOSITORY

MANUFACTURERS = Path(os.environ.get("HANDOVER_ROBOT_MESHES", REPOSITORY.parent / "shared/data/robots"))


OTHER_NAMES = {"panda": "fer"}
"""The name of the manufacturer for the folder of a robot."""


def contract_of(robot: str) -> type[ModelContract]:
    """Return the contract of a robot as a class that pytest collects."""
    name = OTHER_NAMES.get(robot, robot)
    return type(
        f"Test_{robot}", (ModelContract,), {"robot": robot, "meshes": MANUFACTURERS / name / f"{name}.urdf"}
    )


globals().update({f"Test_{robot}": contract_of(robot) for robot in ROBOTS.own})
UR10 = contract_of("ur10")


def test_a_folder_is_a_robot_without_a_registration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "lamp_arm").mkdir()
    (tmp_path / "lamp_arm/__init__.py").write_text("from handover_robots.robots.ur5e import ROBOT\n")
    (tmp_path / "reader.py").write_text("")  # a module beside the robots is none
    monkeypatch.setattr(robots, "__path__", [*robots.__path__, str(tmp_path)])
    with_lamp = ExtensionPoint("robot", "handover.robots", robots_in(robots.__path__))
    assert {*with_lamp.names()} == {*ROBOTS.names(), "lamp_arm"}
    assert with_lamp.load("lamp_arm").name == "UR5e"


@pytest.mark.skipif(not is_available(), reason="the extra motion has no wheels here")
def test_a_model_whose_srdf_hides_a_collision_breaks_the_contract() -> None:
    model: RobotModel = ROBOTS.load("ur10")
    hiding = replace(model, disabled_pairs=model.disabled_pairs | {frozenset(("upper_arm", "gripper"))})
    with pytest.raises(AssertionError, match="upper_arm"):
        UR10().test_no_pair_is_left_unchecked_that_touches_in_some_positions_only(hiding)


def test_a_model_that_is_jerky_beyond_reason_breaks_the_contract() -> None:
    model: RobotModel = ROBOTS.load("ur10")
    jerky = replace(model, joints=(replace(model.joints[0], max_jerk=1e9), *model.joints[1:]))
    with pytest.raises(AssertionError, match="full acceleration"):
        UR10().test_joints_have_limits_that_a_motion_can_keep(jerky)
