"""A robot carries no more than its model says, the tool included."""

from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from handover.errors import UsageError
from handover_robots.model.faults import NoPath
from handover_robots.model.obstacles import World
from handover_robots.planning.planner import Planner
from handover_robots.robots import ROBOTS
from handover_robots.robots.folder import read_folder
from handover_robots.scene.reading import read_scene

TOOLS_KG = {"ur10": 1.0, "ur5e": 1.0, "panda": 0.76}
"""The gripper with its fingers; the link that the gripper is fixed to is one of the robot."""
OWN = {name: ROBOTS.load(name) for name in TOOLS_KG}
PLANNERS = {name: Planner(model) for name, model in OWN.items()}
UNKNOWN = Planner(replace(OWN["ur5e"], name="mine", max_payload_kg=None))


def test_the_payload_of_our_robots_is_known() -> None:
    assert {name: model.max_payload_kg for name, model in OWN.items()} == {"ur10": 10, "ur5e": 5, "panda": 3}
    assert {name: model.tool_kg for name, model in OWN.items()} == pytest.approx(TOOLS_KG)


@given(name=st.sampled_from(sorted(OWN)), mass_kg=st.floats(0.001, 30))
def test_a_scene_whose_parts_are_too_heavy_is_refused(name: str, mass_kg: float) -> None:
    model = OWN[name]
    content = {"name": "cell", "gripper": {"part_mass_kg": mass_kg}}
    if mass_kg + TOOLS_KG[name] <= (model.max_payload_kg or 0.0):
        assert read_scene(content, Path(), "scene", model).gripper.part_mass_kg == mass_kg
        return
    with pytest.raises(
        UsageError, match=r"scene: gripper: a part of .* more than the .* kg that .* may carry"
    ):
        read_scene(content, Path(), "scene", *OWN.values())


@given(name=st.sampled_from(sorted(OWN)), mass_kg=st.floats(0, 30))
def test_no_planner_takes_a_part_that_is_too_heavy(name: str, mass_kg: float) -> None:
    model, world = OWN[name], World(payload_kg=mass_kg)
    if mass_kg + TOOLS_KG[name] <= (model.max_payload_kg or 0.0):
        PLANNERS[name].world = world
        assert PLANNERS[name].world == world
        return
    with pytest.raises(NoPath, match=rf"a part of .* more than the .* kg that {model.name} may carry"):
        Planner(model, world=world)
    before = PLANNERS[name].world
    with pytest.raises(NoPath, match="choose a lighter part"):
        PLANNERS[name].world = world
    assert PLANNERS[name].world == before


def test_a_part_for_a_robot_without_a_limit_is_no_silent_payload() -> None:
    content = {"name": "cell", "gripper": {"part_mass_kg": 2.0}}
    unlimited = replace(OWN["ur5e"], name="mine", max_payload_kg=None)
    with capture_logs() as logged:
        read_scene({"name": "cell"}, Path(), "scene", unlimited)
        read_scene(content, Path(), "scene", OWN["ur5e"])
        assert not logged
        read_scene(content, Path(), "scene", OWN["ur5e"], unlimited)
    (warning,) = logged
    assert "give the robot max_payload_kg in its robot.yaml" in warning["event"]
    assert (warning["log_level"], warning["robot"]) == ("warning", "mine")


@given(mass_kg=st.floats(0.001, 30))
def test_no_planner_takes_a_part_for_a_robot_whose_payload_is_unknown(mass_kg: float) -> None:
    planner = UNKNOWN
    planner.world = World()
    with pytest.raises(NoPath, match=r"unknown how much mine may carry.*give the robot max_payload_kg"):
        planner.world = World(payload_kg=mass_kg)
    assert planner.world == World()


def test_a_robot_of_a_stranger_says_what_it_carries(tmp_path: Path) -> None:
    ur5e = Path(str(files(ROBOTS.own["ur5e"].partition(":")[0])))
    entry = {
        "name": "mine", "urdf": str(ur5e / "ur5e.urdf"), "tip": "tip", "max_acceleration": 5.0,
        "max_jerk": 50.0,
    }  # fmt: skip
    for limit in ({}, {"max_payload_kg": 2.5}):
        (tmp_path / "robot.yaml").write_text(yaml.safe_dump({**entry, **limit}))
        assert read_folder(tmp_path).max_payload_kg == limit.get("max_payload_kg")
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump({**entry, "max_payload_kg": 0}))
    with pytest.raises(UsageError, match="max_payload_kg"):
        read_folder(tmp_path)
