"""The semantic model of a humanoid, and what its reading answers to a stranger's files."""

from collections.abc import Callable
from pathlib import Path
from shutil import copytree

import pytest

from handover.errors import UsageError
from handover_humanoid.model.humanoid import Humanoid
from handover_humanoid.model.kinematics import Kinematics
from handover_humanoid.model.reading import read_folder
from handover_humanoid.robots import COMAN, HUMANOIDS, humanoid
from handover_humanoid.simulation.body_model import build
from handover_humanoid.tasks.self_collision import SelfCollision

Change = Callable[[str, str, str], None]
LINE = "[0.1, 0, 0], [0, 0, 0], [-0.05, 0, 0], [-0.1, 0, 0]"


@pytest.fixture(scope="module")
def coman() -> Humanoid:
    return humanoid("coman")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return Path(copytree(COMAN, tmp_path / "coman"))


@pytest.fixture
def change(folder: Path) -> Change:
    """Replaces a text of a file in the folder, which must be there."""

    def replace(file: str, old: str, new: str) -> None:
        text = (folder / file).read_text()
        assert old in text
        (folder / file).write_text(text.replace(old, new, 1))

    return replace


def test_chains_groups_and_limits_have_names(coman: Humanoid) -> None:
    assert len(coman.joints) == 29
    assert coman.chains["right_arm"].joints == (
        "RShSag",
        "RShLat",
        "RShYaw",
        "RElbj",
        "RForearmPlate",
        "RWrj1",
        "RWrj2",
    )
    assert set(coman.members("chains")) == set(coman.joint_names)
    assert coman.joints[coman.index("LKneeSag")].lower == pytest.approx(-0.1745)
    assert coman.sensors.force_torque["l_leg_ft_joint"] == "l_leg_ft"
    assert coman.sensors.inertial == ("imu_link",)
    assert coman.end_effectors["left_foot"] == coman.contacts["left_sole"].link
    assert coman.mass_kg == pytest.approx(32.06, abs=0.01)
    assert any("placeholders" in note for note in coman.notes)


WITHOUT_MASS = (
    '<inertial><mass value="0"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial>'
)
FLAT = '<visual><geometry><box size="0 0 0"/></geometry></visual>'


def fixed(parent: str, child: str) -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{parent}_{child}" type="fixed">{ends}</joint>'


@pytest.mark.parametrize("inside", ["", WITHOUT_MASS, FLAT, WITHOUT_MASS + FLAT])
def test_a_root_and_frames_need_no_mass_of_their_own(coman: Humanoid, folder: Path, inside: str) -> None:
    file = folder / "coman.urdf"
    text = file.read_text()
    begin = text.index("<link")
    added = (
        f'<link name="base_link">{inside}</link><link name="frame">{inside}</link>'
        f"{fixed('base_link', coman.root)}{fixed('r_sole', 'frame')}"
    )
    file.write_text(text[:begin] + added + text[begin:])
    model = read_folder(folder)
    assert model.root == "base_link"
    assert model.mass_kg == pytest.approx(coman.mass_kg)
    assert Kinematics(model).total_mass_kg == pytest.approx(coman.mass_kg)
    assert build(model).body("base_link") is not None


@pytest.mark.parametrize(
    ("shape", "note"),
    [
        ('<box size="0 0 0"/>', "without any extent is left out"),
        ('<sphere radius="0"/>', "without any extent is left out"),
        ('<cylinder radius="0" length="0"/>', "without any extent is left out"),
        ('<box size="0.1 0 0.1"/>', "has a size of 0; 0.001 m is used"),
        ('<cylinder radius="0.05" length="0"/>', "has a size of 0; 0.001 m is used"),
    ],
)
def test_a_shape_of_size_0_is_left_out_or_thickened(
    coman: Humanoid, folder: Path, shape: str, note: str
) -> None:
    file = folder / "coman.urdf"
    text = file.read_text()
    begin = text.index("<link")
    added = f'<link name="frame"><collision><geometry>{shape}</geometry></collision></link>'
    file.write_text(f"{text[:begin]}{added}{fixed('r_sole', 'frame')}{text[begin:]}")
    model = read_folder(folder)
    assert model.notes == (*coman.notes, f'the link "frame": a collision {note}')
    assert any("frame" in pair for pair in model.collision_pairs) is ("is used" in note)
    assert SelfCollision(Kinematics(model)).name
    assert build(model).nbody > 1


def test_a_body_without_any_mass_is_refused(coman: Humanoid, folder: Path) -> None:
    """Neither the link that moves nor one that is fixed to it has a mass."""
    file = folder / "coman.urdf"
    text = file.read_text()
    begin = text.index("<link")
    hanging = (
        '<link name="tail"/><link name="tip"/><joint name="tail_joint" type="revolute">'
        f'<parent link="{coman.root}"/><child link="tail"/><axis xyz="0 1 0"/>'
        f'<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>{fixed("tail", "tip")}'
    )
    file.write_text(text[:begin] + hanging + text[begin:])
    with pytest.raises(UsageError, match='"tail" moves and has no <inertial> with a mass'):
        read_folder(folder)


def test_arms_are_more_compliant_than_legs(coman: Humanoid) -> None:
    stiffness = {joint.name: joint.gains.stiffness for joint in coman.joints}
    assert stiffness["LElbj"] < stiffness["LKneeSag"]


def test_every_shipped_humanoid_is_read() -> None:
    for name in HUMANOIDS.names():
        model = humanoid(name)
        for pose in model.poses:
            assert len(model.pose(pose)) == len(model.joints)


def test_unknown_names_are_answered_with_those_that_exist(coman: Humanoid) -> None:
    with pytest.raises(UsageError, match="right_arm"):
        coman.indices("third_arm")
    with pytest.raises(UsageError, match="stand"):
        coman.pose("handstand")
    with pytest.raises(UsageError, match="LKneeSag"):
        coman.index("LKnee")


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("coman.urdf", 'lower="-0.1745" upper="1.9199"', 'lower="1.9" upper="-0.2"', "reversed"),
        ("coman.urdf", 'velocity="4"', 'velocity="0"', "no velocity limit"),
        ("coman.urdf", 'effort="50"', 'effort="nan"', "no effort limit"),
        ("coman.urdf", '<mass value="1.800869', '<mass value="-1.800869', "not above 0"),
        ("coman.urdf", 'ixx="0.0051033"', 'ixx="0.5"', "triangle inequality"),
        ("coman.urdf", '<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>', "no vector of length 1"),
        ("coman.urdf", '<child link="DWS"/>', '<child link="Waist"/>', "form a loop"),
        ("coman.urdf", '<child link="DWS"/>', '<child link="DWT"/>', '"DWT" of the joint "WaistSag"'),
        ("coman.urdf", 'name="WaistLat" type="revolute"', 'name="WaistLat" type="planar"', "is planar"),
        ("coman.urdf", 'name="WaistSag"', 'name="WaistLat"', 'two joints are called "WaistLat"'),
        ("coman.urdf", "</robot>", "", "not XML"),
        ("coman.srdf", 'tip_link="l_wrist"', 'tip_link="r_sole"', "not below"),
        ("coman.srdf", '<link name="imu_link"/>', '<link name="imu"/>', '"imu"'),
        ("coman.srdf", 'name="LKneeSag" value="0.8"', 'name="LKneeSag" value="2.8"', "its limits are"),
        ("coman.srdf", 'name="LKneeSag" value="0.8"', 'name="LKnee" value="0.8"', '"LKnee"'),
        ("robot.yaml", "link: l_sole", "link: l_foot", '"l_foot"'),
        ("robot.yaml", "default:", "usual:", '"default"'),
        ("robot.yaml", "left_arm:", "arm:", '"arm"'),
        ("robot.yaml", "stiffness: 300", "stiffness: -1", "stiffness"),
        ("robot.yaml", "coman.urdf", "talos.urdf", "cannot be read"),
        ("robot.yaml", "name: coman", "", "robot.yaml: name: Field required"),
        ("robot.yaml", "name: coman", "name:\tx", "is not YAML"),
        ("coman.urdf", '<origin xyz="', '<origin xyz="nan ', "three finite numbers"),
        ("coman.urdf", '<cylinder radius="', '<cylinder radius="-', "must be above 0"),
        ("coman.urdf", 'effort="50"', 'effort="0.01"', "needs .* N m to stand"),
        ("coman.srdf", 'name="stand"', 'name="home"', 'no <group_state name="stand">.*has: home'),
        ("coman.srdf", 'group_state name="hold_hands"', 'group_state name="stand"', "two elements"),
        ("coman.srdf", 'name="LAnkSag" value="-0.4"', 'name="LKneeSag" value="0.1"', "two values"),
        ("coman.srdf", 'name="LAnkSag" value="-0.4"', 'name="LAnkSag" value="0.4"', "is tilted by 46"),
        ("coman.srdf", 'link1="DWL"', 'link1="DWM"', '"DWM", which is no link'),
        ("coman.srdf", "</robot>", '<passive_joint name="LKneeSag"/></robot>', "passive"),
        ("coman.srdf", '<link name="imu_link"/>', "", "no .*imu_sensors"),
        ("coman.srdf", '<joint name="l_leg_ft_joint"/>', "", 'force-torque sensor at "left_sole"'),
        ("robot.yaml", "left_sole:", "left_foot:", 'no contact "left_sole".*has: left_foot'),
        ("robot.yaml", "[0.13, 0.05, 0]", "[0.2, 0.05, 0]", "differ"),
        ("robot.yaml", "left_hand:", "left_grip:", 'the grip "left_grip"'),
        ("robot.yaml", "link: l_sole", "link: LSoftHand", "no chain of the SRDF ends at"),
    ],
)
def test_faulty_files_are_explained(
    folder: Path, change: Change, file: str, old: str, *, new: str, message: str
) -> None:
    change(file, old, new)
    with pytest.raises(UsageError, match=message):
        read_folder(folder)


def test_soles_that_are_exchanged_or_on_a_line_are_explained(folder: Path, change: Change) -> None:
    change("robot.yaml", "left_sole:", "a_sole:")
    change("robot.yaml", "right_sole:", "left_sole:")
    change("robot.yaml", "a_sole:", "right_sole:")
    with pytest.raises(UsageError, match='"left_sole" is to the right of "right_sole"'):
        read_folder(folder)
    for _ in range(2):
        change("robot.yaml", "[0.13, 0.05, 0], [0.13, -0.05, 0], [-0.07, -0.05, 0], [-0.07, 0.05, 0]", LINE)
    with pytest.raises(UsageError, match="enclose no area"):
        read_folder(folder)


def test_only_stretched_legs_are_noted(folder: Path, change: Change, coman: Humanoid) -> None:
    assert read_folder(folder).notes == coman.notes
    for hip, knee, ankle in (("LHipSag", "LKneeSag", "LAnkSag"), ("RHipSag", "RKneeSag", "RAnkSag")):
        for joint, old, new in ((hip, -0.4, -0.05), (knee, 0.8, 0.1), (ankle, -0.4, -0.05)):
            change("coman.srdf", f'name="{joint}" value="{old}"', f'name="{joint}" value="{new}"')
    assert "stretches left_leg and right_leg" in read_folder(folder).notes[-1]


def test_external_entities_are_not_read(folder: Path, change: Change) -> None:
    (folder / "secret").write_text("secret")
    change(
        "coman.srdf",
        "<robot",
        f'<!DOCTYPE robot [<!ENTITY e SYSTEM "file://{folder}/secret">]><robot title="&e;"',
    )
    with pytest.raises(UsageError):
        read_folder(folder)
