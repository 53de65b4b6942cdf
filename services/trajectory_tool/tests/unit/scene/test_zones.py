"""Zones, fences and cameras of a scene, and robots that stand elsewhere than at the origin of the cell."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from handover_robots.model.obstacles import Box
from handover_robots.model.poses import Pose, pointing_down
from handover_robots.planning import is_available
from handover_robots.robots import ROBOTS
from handover_robots.scene.scene import Scene

HALF = math.sqrt(0.5)
AT = [0, 3, 0]
BASE = Pose((1.2, -0.3, 0.4), (0.0, 0.0, HALF, HALF))


def scene(**written: object) -> Scene:
    return Scene.model_validate({"name": "cell", **written})


def test_a_zone_contains_the_points_of_its_shape() -> None:
    zones = scene(
        zones={
            "gap": {"kind": "keepOut", "box": [2, 1, 1], "position": [1, 0, 0], "yaw_deg": 90},
            "bench": {
                "kind": "reducedSpeed",
                "cylinder": {"radius": 0.5, "length": 2},
                "position": [0, 3, 0],
            },
            "head": {
                "kind": "reducedSpeed",
                "sphere": 0.2,
                "position": [0, 0, 2],
                "max_tool_speed_mps": 0.1,
            },
        }
    ).all_zones()
    gap, bench, head = zones
    assert gap.contains((1.4, 0.9, 0.0))
    assert not gap.contains((1.9, 0.4, 0.0))
    assert gap.distance_m((1.0, 1.5, 0.0)) == pytest.approx(0.5)
    assert bench.distance_m((1.0, 3.0, 0.0)) == pytest.approx(0.5)
    assert head.contains((0.1, 0.1, 1.9))
    assert [zone.max_tool_speed_mps for zone in zones] == [0.0, 0.25, 0.1]


def test_only_a_keep_out_zone_is_an_obstacle() -> None:
    written = {"box": [1, 1, 1], "position": [0, 0, 0]}
    solids = scene(
        zones={"gap": {"kind": "keepOut", **written}, "bench": {"kind": "reducedSpeed", **written}}
    ).solids()
    assert [solid.name for solid in solids] == ["gap"]


def test_a_zone_is_no_mesh() -> None:
    with pytest.raises(ValidationError, match='a zone is a "box"'):
        scene(zones={"gap": {"kind": "keepOut", "mesh": "gap.stl", "position": [0, 0, 0]}})


def test_a_fence_has_a_panel_between_each_two_points() -> None:
    panels = scene(fences={"fence": {"points": [[0, 0], [2, 0], [2, 1]], "height_m": 1.6}}).solids()
    assert [panel.shape for panel in panels] == [Box((2.0, 0.04, 1.6)), Box((1.0, 0.04, 1.6))]
    assert panels[1].pose.position == pytest.approx((2.0, 0.5, 0.8))


def test_a_camera_has_a_housing() -> None:
    (housing,) = scene(cameras={"camera-1": {"position": [0, 0, 1.5]}}).solids()
    assert housing.name == "camera-1"


@pytest.mark.parametrize("name", ["ur10", "panda"])
def test_the_poses_of_a_mounted_robot_are_those_of_the_cell(name: str) -> None:
    model = ROBOTS.load(name)
    mounted = model.mounted(BASE.frame())
    at_home = model.tool_pose(model.home)
    moved = Pose.of(BASE.frame() @ at_home.frame())
    assert mounted.tool_pose(model.home).position == pytest.approx(moved.position)
    assert mounted.revision != model.revision


@pytest.mark.skipif(not is_available(), reason="the extra motion has no wheels here")
@pytest.mark.parametrize("name", ["ur10", "panda"])
def test_a_mounted_robot_is_planned_in_the_frame_of_the_cell(name: str) -> None:
    from handover_robots.model.obstacles import Obstacle, World
    from handover_robots.planning.arm import Arm
    from handover_robots.planning.collision import Collisions

    mounted = ROBOTS.load(name).mounted(BASE.frame())
    arm = Arm(mounted)
    assert arm.tool_pose(mounted.home).position == pytest.approx(mounted.tool_pose(mounted.home).position)
    target = pointing_down((1.2, 0.2, 0.7))
    reached = mounted.tool_pose(mounted.reach(target, mounted.home))
    assert reached.position == pytest.approx(target.position, abs=1e-4)
    at_tool = Obstacle("post", Box((0.2, 0.2, 0.2)), mounted.tool_pose(mounted.home))
    assert not Collisions(arm, World((at_tool,))).is_free(np.array(mounted.home))
