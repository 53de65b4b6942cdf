"""Models of robots other than the shipped one: read from a URDF, and refused with the fault."""

import math
from pathlib import Path
from typing import Any

import pytest

from handover.errors import UsageError
from handover_robots.model.faults import Unreachable
from handover_robots.model.poses import pointing_down
from handover_robots.model.robot_model import Finger, RobotModel
from handover_robots.planning import is_available
from handover_robots.robots import urdf
from handover_robots.robots.urdf import read_model

TWO_JOINTS = """<robot name="crane">
  <link name="world"/><link name="base"/><link name="mast"/><link name="boom"/>
  <link name="hook"/><link name="claw"/>
  <joint name="foot" type="fixed"><parent link="world"/><child link="base"/><origin xyz="1 0 0"/></joint>
  <joint name="turn" type="continuous">
    <parent link="base"/><child link="mast"/><axis xyz="0 0 2"/><limit effort="1" velocity="0.5"/>
  </joint>
  <joint name="lift" type="prismatic">
    <parent link="mast"/><child link="boom"/><origin xyz="0 0 0.5" rpy="0 1.5707963267948966 0"/>
    <axis xyz="1 0 0"/>
    <limit lower="-0.4" upper="0" effort="1" velocity="0.1"/>
  </joint>
  <joint name="rope" type="fixed"><parent link="boom"/><child link="hook"/><origin xyz="0 0 2"/></joint>
  <joint name="finger" type="prismatic">
    <parent link="hook"/><child link="claw"/><limit lower="0" upper="0.1" effort="1" velocity="0.1"/>
  </joint>
</robot>"""


def crane(tmp_path: Path, text: str = TWO_JOINTS, **options: Any) -> RobotModel:
    file = tmp_path / "crane.urdf"
    file.write_text(text, encoding="utf-8")
    arguments = {"name": "Crane", "tip": "hook", "max_acceleration": 1.0, "max_jerk": 10.0}
    return read_model(file, **{**arguments, **options})


def test_joints_and_limits_are_those_between_the_root_and_the_tip(tmp_path: Path) -> None:
    model = crane(tmp_path, max_jerk={"turn": 3.0, "lift": 4.0})
    assert model.joint_names == ("turn", "lift")
    assert [joint.unit for joint in model.joints] == ["rad", "m"]
    assert [(joint.lower, joint.upper) for joint in model.joints] == [(None, None), (-0.4, 0.0)]
    assert model.limits.velocity == (0.5, 0.1)
    assert model.limits.jerk == (3.0, 4.0)
    assert model.home == (0.0, 0.0)


def test_the_tool_follows_revolute_and_prismatic_joints(tmp_path: Path) -> None:
    model = crane(tmp_path)
    assert model.tool_pose((0.0, 0.0)).position == pytest.approx((3.0, 0.0, 0.5))
    assert model.tool_pose((math.pi / 2, -0.3)).position == pytest.approx((1.0, 2.0, 0.8))


def test_a_continuous_joint_turns_without_limit_and_a_prismatic_one_stops_at_its_end(tmp_path: Path) -> None:
    model = crane(tmp_path)
    assert model.allow((100.0, -0.4)) == (100.0, -0.4)
    with pytest.raises(Unreachable, match=r"lift cannot be at 0\.100 m: it moves from -0\.400 to 0\.000 m"):
        model.allow((0.0, 0.1))


@pytest.mark.skipif(not is_available(), reason="the extra motion has no wheels here")
def test_a_pose_is_reached_without_a_closed_form(tmp_path: Path) -> None:
    model = crane(tmp_path)
    pose = model.tool_pose((0.3, -0.2))
    assert model.reach(pose, (0.0, 0.0)) == pytest.approx((0.3, -0.2), abs=1e-4)
    with pytest.raises(Unreachable, match=r"the nearest it reaches is"):
        model.reach(pointing_down((9.0, 0.0, 0.5)), (0.0, 0.0))


def test_a_pose_needs_inverse_kinematics_or_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(urdf, "is_available", lambda: False)
    with pytest.raises(Unreachable, match='Crane has no inverse kinematics; give "joints"'):
        crane(tmp_path).reach(pointing_down((1.0, 0.0, 0.5)), (0.0, 0.0))


def test_a_solution_beyond_the_limits_is_refused(tmp_path: Path) -> None:
    model = crane(tmp_path, inverse=lambda flange, near: (0.0, 9.0))
    with pytest.raises(Unreachable, match=r"tool cannot be at .*: lift cannot be at 9\.000 m"):
        model.reach(pointing_down((1.0, 0.0, 0.5)), (0.0, 0.0))


def test_the_revision_differs_for_another_description(tmp_path: Path) -> None:
    assert crane(tmp_path).revision == crane(tmp_path).revision
    assert crane(tmp_path).revision != crane(tmp_path, home={"turn": 1.0}).revision
    longer = TWO_JOINTS.replace('xyz="0 0 2"', 'xyz="0 0 3"')
    assert crane(tmp_path).revision != crane(tmp_path, longer).revision


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("<robot", "<sdf", "is not XML"),
        (TWO_JOINTS, "<sdf/>", "root element is <sdf>, not <robot>"),
        ('<link name="hook"/>', "", 'there is no link "hook"'),
        ('velocity="0.1"', 'velocity="0"', 'joint "lift" needs a velocity limit'),
        ('velocity="0.1"', 'velocity="fast"', 'joint "lift" has an invalid velocity: "fast"'),
        ('lower="-0.4" upper="0"', 'lower="0.4" upper="0"', 'joint "lift" has the lower limit 0.4'),
        ('type="continuous"', 'type="floating"', 'joint "turn" is floating'),
        ('<axis xyz="0 0 2"/>', '<axis xyz="0 0 0"/>', 'joint "turn" has no axis'),
        ('<axis xyz="1 0 0"/>', '<axis xyz="1 0"/>', 'xyz="1 0" must be three numbers'),
        ('<axis xyz="1 0 0"/>', '<mimic joint="turn"/>', 'joint "lift" mimics another one'),
        ('<parent link="world"/>', '<parent link="hook"/>', "form a loop"),
        ('<parent link="mast"/>', "", 'joint "lift" needs a parent and a child'),
        ('<child link="claw"/>', '<child link="boom"/>', 'the link "boom" has two parents'),
    ],
)
def test_a_faulty_description_is_named_with_its_fault(
    tmp_path: Path, old: str, new: str, complaint: str
) -> None:
    assert old in TWO_JOINTS
    with pytest.raises(UsageError, match=complaint) as fault:
        crane(tmp_path, TWO_JOINTS.replace(old, new, 1))
    assert str(tmp_path / "crane.urdf") in str(fault.value)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"home": {"swing": 1.0}}, "home names swing; the joints are turn, lift"),
        ({"home": {"lift": 1.0}}, "home: lift cannot be at 1.000 m"),
        ({"flange": "mast"}, 'the flange "mast" must be a link that "hook" is fixed to'),
        ({"tip": "base"}, "there is no movable joint"),
        ({"max_jerk": {"turn": 1.0}}, 'joint "lift" needs limits of acceleration and jerk'),
        ({"fingers": (Finger("thumb", 0.1, 0.0, 0.05),)}, 'there is no joint "thumb" for a finger'),
    ],
)
def test_options_that_do_not_fit_the_description_are_refused(
    tmp_path: Path, options: dict[str, Any], complaint: str
) -> None:
    with pytest.raises(UsageError, match=complaint):
        crane(tmp_path, **options)


def test_a_missing_description_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"none\.urdf cannot be read"):
        read_model(tmp_path / "none.urdf", name="None", tip="tip", max_acceleration=1.0, max_jerk=1.0)


def test_entities_of_a_description_are_not_resolved(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("0 0 7")
    text = f'<!DOCTYPE robot [<!ENTITY x SYSTEM "file://{secret}">]>' + TWO_JOINTS.replace(
        '<robot name="crane">', '<robot name="crane">&x;'
    )
    assert "0 0 7" not in repr(crane(tmp_path, text))
