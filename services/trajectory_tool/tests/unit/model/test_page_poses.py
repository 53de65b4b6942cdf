"""The poses that the 3D view of the page is checked against are those of the UR10's model."""

import json

import pytest

from handover_robots.robots.ur10 import ROBOT
from tests.kit.paths import REPOSITORY

KNOWN = json.loads((REPOSITORY / "webui/app/src/robot3d/ur10.poses.json").read_text(encoding="utf-8"))


def test_the_page_and_the_tool_name_the_joints_alike() -> None:
    assert tuple(KNOWN["joint_names"]) == ROBOT.joint_names


@pytest.mark.parametrize("example", KNOWN["poses"], ids=lambda example: example["name"])
def test_the_page_has_the_tip_where_the_tool_has_it(example: dict[str, list[float]]) -> None:
    pose = ROBOT.tool_pose(tuple(example["joints"]))
    assert pose.position == pytest.approx(example["position"], abs=2e-6)
    assert pose.orientation == pytest.approx(example["orientation"], abs=2e-6)
