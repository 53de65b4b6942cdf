"""Every shipped robot keeps the contract of a robot model, and the contract finds what is wrong."""

import os
from dataclasses import replace
from pathlib import Path

import pytest

from handover_robots.model.robot_model import RobotModel
from handover_robots.model_contract import ModelContract
from handover_robots.planning import is_available
from handover_robots.robots import ROBOTS
from tests.kit.paths import REPOSITORY

MANUFACTURERS = Path(os.environ.get("HANDOVER_ROBOT_MESHES", REPOSITORY.parent / "shared/data/robots"))


class TestUR10(ModelContract):
    robot = "ur10"
    meshes = MANUFACTURERS / "ur10/ur10.urdf"


class TestUR5e(ModelContract):
    robot = "ur5e"
    meshes = MANUFACTURERS / "ur5e/ur5e.urdf"


class TestPanda(ModelContract):
    robot = "panda"
    meshes = MANUFACTURERS / "fer/fer.urdf"


@pytest.mark.skipif(not is_available(), reason="the extra motion has no wheels here")
def test_a_model_whose_srdf_hides_a_collision_breaks_the_contract() -> None:
    model: RobotModel = ROBOTS.load("ur10")
    hiding = replace(model, disabled_pairs=model.disabled_pairs | {frozenset(("upper_arm", "gripper"))})
    with pytest.raises(AssertionError, match="upper_arm"):
        TestUR10().test_no_pair_is_left_unchecked_that_touches_in_some_positions_only(hiding)


def test_a_model_that_is_jerky_beyond_reason_breaks_the_contract() -> None:
    model: RobotModel = ROBOTS.load("ur10")
    jerky = replace(model, joints=(replace(model.joints[0], max_jerk=1e9), *model.joints[1:]))
    with pytest.raises(AssertionError, match="full acceleration"):
        TestUR10().test_joints_have_limits_that_a_motion_can_keep(jerky)
