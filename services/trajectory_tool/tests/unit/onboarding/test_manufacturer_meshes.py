"""Shapes of robots beside meshes: what is measured, what `robot add` makes of them, and what it refuses."""

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lxml import etree
from typer.testing import CliRunner

from handover.command_line.main import app
from handover.errors import UsageError
from handover_robots.model.robot_model import RobotModel
from handover_robots.planning import is_available
from handover_robots.robots import ROBOTS
from handover_robots.robots.urdf import read_model

if not is_available():
    pytest.skip("the extra motion has no wheels here", allow_module_level=True)

import pinocchio as pin

from handover_robots.onboarding.add import _require_movable, add_robot
from handover_robots.onboarding.comparison import (
    CLEARANCE_M,
    MAX_FALSELY_REFUSED,
    Comparison,
    MeshPairs,
    PairShares,
)
from handover_robots.onboarding.enclosure import measure_shapes
from handover_robots.onboarding.meshes import read_surfaces
from handover_robots.planning.arm import Arm
from handover_robots.planning.planner import Planner
from services.trajectory_tool.tests.unit.onboarding.test_add import arm, box_mesh, joint, link, robot, stl
from tests.kit.paths import REPOSITORY

MANUFACTURERS = Path(os.environ.get("HANDOVER_ROBOT_MESHES", REPOSITORY.parent / "shared/data/robots"))
MESH = '<collision><geometry><mesh filename="{}"/></geometry></collision>'


def with_meshes(folder: Path) -> Path:
    """Write an arm of six joints with bent links: one hull around each would fill their bends."""
    folder.mkdir(exist_ok=True)
    tube = box_mesh((0.06, 0.06, 0.3), (0.0, 0.0, 0.15))
    bent = np.concatenate([tube, box_mesh((0.06, 0.25, 0.05), (0.0, 0.15, 0.275))])
    (folder / "tube.stl").write_bytes(stl(tube.reshape(-1, 3)))
    (folder / "bent.stl").write_bytes(stl(bent.reshape(-1, 3)))
    meshes = {f"l{number}": link(f"l{number}", MESH.format("tube.stl")) for number in range(7)}
    meshes |= {name: link(name, MESH.format("bent.stl")) for name in ("l1", "l3")}
    file = folder / "arm.urdf"
    file.write_text(arm(**meshes))
    return file


def reframed(urdf: str, seed: int) -> str:
    """Return a URDF of the same robot with other names, another base, and frames of links turned at random.

    A frame stays on the axis of its joint, so joints have the same positions.
    """
    random = np.random.default_rng(seed)
    root = etree.fromstring(urdf.encode())
    above = {moving.find("child").get("link"): moving for moving in root.findall("joint")}
    moved = {}
    for body in root.findall("link"):
        turn = pin.SE3.Random()
        turn.translation = random.uniform(-0.2, 0.2, 3)
        if body.get("name") in above:
            axis = np.array([float(part) for part in above[body.get("name")].find("axis").get("xyz").split()])
            turn.translation = random.uniform(-0.1, 0.1) * axis
        moved[body.get("name")] = turn

    def place(element: Any, by: Any) -> None:
        origin = element.find("origin")
        origin = etree.SubElement(element, "origin") if origin is None else origin
        xyz, rpy = (
            np.array([float(part) for part in origin.get(name, "0 0 0").split()]) for name in ("xyz", "rpy")
        )
        placed = by(pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz))
        origin.set("xyz", " ".join(map(repr, placed.translation.tolist())))
        origin.set("rpy", " ".join(map(repr, pin.rpy.matrixToRpy(placed.rotation).tolist())))

    for body in root.findall("link"):
        own = moved[body.get("name")]
        for shape in body.findall("collision"):
            place(shape, lambda at, own=own: own.inverse() * at)
        body.remove(body.find("inertial"))
        body.set("name", f"other_{body.get('name')}")
    for moving in root.findall("joint"):
        parent, child = (moving.find(end) for end in ("parent", "child"))
        before, after = moved[parent.get("link")], moved[child.get("link")]
        place(moving, lambda at, before=before, after=after: before.inverse() * at * after)
        axis = np.array([float(part) for part in moving.find("axis").get("xyz").split()])
        moving.find("axis").set("xyz", " ".join(map(repr, (after.rotation.T @ axis).tolist())))
        for end in (parent, child):
            end.set("link", f"other_{end.get('link')}")
        moving.set("name", f"left_{moving.get('name')}")
    return str(etree.tostring(root, encoding="unicode"))


def plain_model(folder: Path, urdf: str) -> RobotModel:
    folder.mkdir(exist_ok=True)
    (folder / "plain.urdf").write_text(urdf)
    return read_model(folder / "plain.urdf", name="plain", tip="l6", max_acceleration=4.0, max_jerk=40.0)


COMPLETE = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
BOX = '<collision><origin xyz="0 0 0.15"/><geometry><box size="0.08 0.06 {}"/></geometry></collision>'


def boxes(length: str) -> str:
    shapes = {f"l{number}": link(f"l{number}", BOX.format(length)) for number in range(7)}
    return etree.tostring(_complete(arm(**shapes)), encoding="unicode")


def _complete(urdf: str) -> Any:
    root = etree.fromstring(urdf)
    for element in root.findall("link"):
        element.replace(element.find("inertial"), etree.fromstring(COMPLETE))
    return root


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_links_are_found_by_kinematics_where_names_and_frames_differ(tmp_path: Path, seed: int) -> None:
    model = plain_model(tmp_path, boxes("0.25"))
    pin.seed(seed)
    (tmp_path / "other.urdf").write_text(reframed(boxes("0.25"), seed))
    report = measure_shapes(model, str(tmp_path / "other.urdf"), 20, 1)
    assert {measured.link: measured.robot_link for measured in report.links} == {
        f"other_l{n}": f"l{n}" for n in range(7)
    }
    assert {measured.outside_mm for measured in report.links} == {0.0}
    assert report.unmapped == {}
    assert report.comparison.falsely_refused == report.comparison.falsely_allowed == 0.0


def test_what_is_outside_is_measured_where_frames_differ(tmp_path: Path) -> None:
    model = plain_model(tmp_path, boxes("0.25"))
    pin.seed(1)
    (tmp_path / "other.urdf").write_text(reframed(boxes("0.28"), 1))
    report = measure_shapes(model, str(tmp_path / "other.urdf"), 300, 1)
    assert [measured.outside_mm for measured in report.links] == pytest.approx([15.0] * 7, abs=0.01)
    assert report.comparison.falsely_allowed > 0


@pytest.mark.parametrize("renamed", [("j3",), ("j1", "j4"), ("j2", "j3", "j5")])
def test_joints_with_other_names_are_found_between_those_with_the_same(
    tmp_path: Path, renamed: tuple[str, ...]
) -> None:
    model = plain_model(tmp_path, boxes("0.25"))
    root = etree.fromstring(boxes("0.28"))
    for element in root.findall("joint"):
        if element.get("name") in renamed:
            element.set("name", f"axis {element.get('name')[1:]} of the maker")
    for text in (link("hand", BOX.format("0.05")), joint("grip", "l6", "hand")):
        root.append(etree.fromstring(text))
    (tmp_path / "other.urdf").write_text(etree.tostring(root, encoding="unicode"))
    report = measure_shapes(model, str(tmp_path / "other.urdf"), 10, 1)
    assert {measured.link: measured.outside_mm for measured in report.links} == pytest.approx(
        {f"l{number}": 15.0 for number in range(7)}, abs=0.01
    )
    assert set(report.unmapped) == {"hand"}


def test_a_urdf_of_another_arm_is_refused_and_says_where_they_differ(tmp_path: Path) -> None:
    model = plain_model(tmp_path, boxes("0.25"))
    other = tmp_path / "other.urdf"
    other.write_text(boxes("0.25").replace('<origin xyz="0 0 0.3"/>', '<origin xyz="0 0.02 0.33"/>'))
    with pytest.raises(UsageError, match=r'what "j2" moves is up to .* mm elsewhere in the other URDF'):
        measure_shapes(model, str(other), 10, 1)
    other.write_text(robot(link("a"), link("b"), joint("elsewhere", "a", "b")))
    with pytest.raises(UsageError, match="have no joint in common: j1, j2, j3, j4, j5, j6; elsewhere"):
        measure_shapes(model, str(other), 10, 1)


def test_links_of_further_joints_are_named_as_not_compared(tmp_path: Path) -> None:
    model = plain_model(tmp_path, boxes("0.25"))
    root = etree.fromstring(boxes("0.25"))
    for text in (link("hand", BOX.format("0.05")), joint("grip", "l6", "hand")):
        root.append(etree.fromstring(text))
    (tmp_path / "other.urdf").write_text(etree.tostring(root, encoding="unicode"))
    report = measure_shapes(model, str(tmp_path / "other.urdf"), 10, 1)
    assert report.unmapped == {"hand": 'it moves with the joint "grip", which plain does not have'}


def test_the_command_prints_the_shares_of_all_pairs(tmp_path: Path) -> None:
    file = with_meshes(tmp_path / "given")
    add_robot(str(file), "bent", tmp_path, samples=300)
    asked = ["robot", "shapes", str(tmp_path / "bent"), "--meshes", str(file), "--configurations", "200"]
    result = CliRunner().invoke(app, [*asked, "--json"])
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert {measured["link"]: measured["outside_mm"] for measured in report["links"]} == {
        f"l{n}": 0.0 for n in range(7)
    }
    assert report["falsely_refused"] <= MAX_FALSELY_REFUSED
    assert report["falsely_allowed"] == 0
    assert report["pairs"]
    assert all(
        {"first", "second", "falsely_refused", "falsely_allowed"} <= set(pair) for pair in report["pairs"]
    )
    assert "self-collision in 200 uniform positions (seed 1)" in CliRunner().invoke(app, asked).stdout


def test_a_collision_that_the_srdf_hides_is_counted_as_falsely_allowed(tmp_path: Path) -> None:
    file = with_meshes(tmp_path / "given")
    model = add_robot(str(file), "bent", tmp_path, samples=300).model
    hiding = replace(model, disabled_pairs=model.disabled_pairs | {frozenset(("l1", "l4"))})
    report = measure_shapes(hiding, str(file), 300, 1).comparison
    (hidden,) = (pair for pair in report.pairs if (pair.first, pair.second) == ("l1", "l4"))
    assert hidden.falsely_allowed == hidden.touching > 0


def test_an_srdf_beside_the_urdf_is_read_and_what_its_pairs_hide_is_reported(tmp_path: Path) -> None:
    file = with_meshes(tmp_path / "given")
    states = {"ready": "0.6", "crossed": "2.9", "beyond": "4"}
    file.with_suffix(".srdf").write_text(
        '<robot name="arm"><disable_collisions link1="l1" link2="l4" reason="Never"/>'
        '<disable_collisions link1="l1" link2="nowhere"/>'
        + "".join(
            f'<group_state name="{name}" group="arm">'
            + "".join(f'<joint name="j{n}" value="{value}"/>' for n in (2, 3, 5))
            + "</group_state>"
            for name, value in states.items()
        )
        + "</robot>"
    )
    bent = add_robot(str(file), "bent", tmp_path, samples=300)
    said = "\n".join(f"{finding.level} {finding.about}: {finding.text}" for finding in bent.findings)
    assert frozenset(("l1", "l4")) in bent.model.disabled_pairs
    assert bent.model.poses["ready"] == pytest.approx((0, 0.6, 0.6, 0, 0.6, 0))
    assert set(bent.model.poses) == {"home", "ready"}
    assert (
        "arm.srdf is read: 1 pairs of links that need no check, 3 positions; the URDF has no link now" in said
    )
    assert 'its position "beyond" is left out: it is outside of the limits' in said
    assert 'its position "crossed" is left out: l' in said
    assert "warning l1, l4: their meshes touch in " in said
    assert "the SRDF disables the pair" in said
    assert bent.comparison.falsely_allowed == 0
    with pytest.raises(UsageError, match=r"the SRDF .*other\.srdf cannot be read"):
        add_robot(str(file), "bent", tmp_path, srdf=tmp_path / "other.srdf", replaces=True)


def test_a_robot_whose_shapes_leave_it_no_room_is_refused() -> None:
    pair = PairShares("l1", "l4", 0.06, 0.21, 0.0)
    with pytest.raises(
        UsageError, match=r"l1 and l4 refuse 21\.0 % of the positions that their meshes allow"
    ):
        _require_movable(Path("arm.urdf"), Comparison(1000, 2, 900, 0.21, 0.0, (pair,), ()))


def test_no_shape_is_lost_to_an_incomplete_inertia(tmp_path: Path) -> None:
    """The reader of URDFs drops a link's shapes then, with a line on stderr alone."""
    (tmp_path / "arm.urdf").write_text(arm())
    raw = read_model(tmp_path / "arm.urdf", name="raw", tip="l6", max_acceleration=4.0, max_jerk=40.0)
    with pytest.raises(
        UsageError, match=r"the collision shapes of l0, .* cannot be read; give their <inertial>"
    ):
        Arm(raw)
    added = add_robot(str(tmp_path / "arm.urdf"), "arm", tmp_path / "robots", samples=100).model
    assert Arm(added).geometry.ngeoms == 7


def test_a_hull_without_volume_is_named(tmp_path: Path) -> None:
    for text, fault in (
        ("0 0 0 1 1", "must have the x y z of four"),
        ("0 0 0  1 0 0  0 1 0  1 1 0", "thinner"),
    ):
        hollow = boxes("0.25").replace("</geometry>", f"</geometry><hull>{text}</hull>", 1)
        with pytest.raises(UsageError, match=fault):
            Arm(plain_model(tmp_path, hollow))


@pytest.mark.parametrize("name", ["lite6", "ur5e", "fer"])
def test_the_arm_of_a_manufacturer_reaches_its_joint_goals(tmp_path: Path, name: str) -> None:
    file = MANUFACTURERS / name / f"{name}.urdf"
    if not file.is_file():
        pytest.skip(
            f"the meshes are not kept here; HANDOVER_ROBOT_MESHES names their folder ({MANUFACTURERS})"
        )
    added = add_robot(str(file), name, tmp_path)
    assert added.comparison.configurations == 1000
    assert all(pair.falsely_refused <= MAX_FALSELY_REFUSED for pair in added.comparison.pairs)
    assert added.comparison.falsely_allowed == 0
    report = measure_shapes(added.model, str(file), 300, 3)
    assert {measured.outside_mm for measured in report.links} == {0.0}
    planner = Planner(added.model)
    meshes = MeshPairs(planner.arm, read_surfaces(etree.parse(file).getroot(), file, []))
    for seed in (1, 2, 3):
        random = np.random.default_rng(seed)
        tried = random.uniform(planner.arm.lower, planner.arm.upper, (60, planner.arm.n))
        free = [
            joints for joints, near in zip(tried, meshes.within(tried, CLEARANCE_M), strict=True) if not near
        ]
        for goal in free[:8]:
            plan = planner.to_joints(planner.model.home, tuple(goal.tolist()))
            assert (
                planner.model.tool_pose(plan.target).distance_m(planner.model.tool_pose(tuple(goal))) < 1e-3
            )


def test_a_joint_whose_range_the_arm_divides_is_turned_the_other_way(tmp_path: Path) -> None:
    """The upper arm of a UR5e cannot pass its base: a lift by 200 degrees is reached as one by -160."""
    planner = Planner(ROBOTS.load("ur5e"))
    home = planner.model.home
    target = (home[0], np.radians(200), *home[2:])
    plan = planner.to_joints(home, target)
    assert plan.target[1] == pytest.approx(np.radians(-160), abs=1e-6)
    assert planner.model.tool_pose(plan.target).distance_m(planner.model.tool_pose(target)) < 1e-6
