"""Robots of strangers: their URDFs become folders that load, and each bad one gets its answer."""

import itertools
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from structlog.testing import capture_logs
from typer.testing import CliRunner

from handover.command_line.main import app
from handover.errors import UsageError
from handover_robots.cell.cell import RobotCell
from handover_robots.model.obstacles import Mesh, World
from handover_robots.planning import is_available
from handover_robots.robots import ROBOTS, ur5e
from handover_robots.robots.folder import load_robot
from handover_robots.robots.urdf import read_model
from handover_robots.settings import TrajectorySettings

if not is_available():
    pytest.skip("the extra motion has no wheels here", allow_module_level=True)

from handover_robots.onboarding.add import Added, add_robot
from handover_robots.onboarding.home import find_home
from handover_robots.onboarding.hulls import MAX_CORNERS, MAX_PIECES, enclosing, pieces_of
from handover_robots.onboarding.refinement import SEED
from handover_robots.onboarding.shapes import Fitted, fit
from handover_robots.planning.arm import Arm, corners_of
from handover_robots.planning.collision import Collisions, geometry_of, link_of
from handover_robots.planning.mesh_files import load_mesh
from handover_robots.planning.planner import Planner

UR5E = Path(ur5e.__file__).parent / "ur5e.urdf"

INERTIA = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
CYLINDER = '<origin xyz="0 0 0.15"/><geometry><cylinder radius="0.04" length="0.2"/></geometry>'
TUBE = f"<collision>{CYLINDER}</collision>"
LIMIT = '<limit lower="-3" upper="3" velocity="2" effort="50"/>'


def link(name: str, shape: str = TUBE) -> str:
    return f'<link name="{name}">{INERTIA}{shape}</link>'


def joint(
    name: str, parent: str, child: str, *, kind: str = "revolute", axis: str = "0 1 0", inner: str = LIMIT
) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 0.3"/><axis xyz="{axis}"/>{inner}</joint>'
    )


def mesh(file: str, scale: str = "1 1 1") -> str:
    return f'<collision><geometry><mesh filename="{file}" scale="{scale}"/></geometry></collision>'


def robot(*elements: str) -> str:
    return f'<robot name="arm">{"".join(elements)}</robot>'


def arm(**changed: str) -> str:
    """Return an arm with six joints, some of its elements changed by name."""
    elements: dict[str, str] = {}
    for number in range(7):
        elements[f"l{number}"] = link(f"l{number}")
    for number in range(1, 7):
        axis = ("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1")[number - 1]
        elements[f"j{number}"] = joint(f"j{number}", f"l{number - 1}", f"l{number}", axis=axis)
    return robot(*{**elements, **changed}.values())


@pytest.fixture
def added(tmp_path: Path) -> Any:
    def add(text: str, **options: Any) -> Added:
        file = tmp_path / "given" / "arm.urdf"
        file.parent.mkdir(exist_ok=True)
        file.write_text(text)
        return add_robot(str(file), "arm-1", tmp_path / "robots", samples=200, **options)

    return add


def texts(result: Added) -> str:
    return "\n".join(f"{finding.level} {finding.about}: {finding.text}" for finding in result.findings)


def test_an_added_robot_is_found_by_name_and_moves(added: Any, tmp_path: Path) -> None:
    result = added(arm())
    assert result.model.joint_names == ("j1", "j2", "j3", "j4", "j5", "j6")
    model = load_robot("arm-1", tmp_path, tmp_path)
    assert model.revision == result.model.revision
    plan = Planner(model).to_joints(model.home, (0.5, 0.4, 0.3, 0.2, 0.5, 0.1))
    assert plan.trajectory.duration_s > 0
    settings = TrajectorySettings.load(data_dir=tmp_path, robot_model="arm-1")
    assert RobotCell(settings).only.name == "arm-1-1"


def test_neighbours_in_the_tree_and_pairs_that_never_touch_are_not_checked(added: Any) -> None:
    disabled = added(arm()).model.disabled_pairs
    assert frozenset(("l0", "l1")) in disabled
    assert frozenset(("l0", "l3")) not in disabled


def test_the_pairs_of_a_known_robot_are_found_again(tmp_path: Path) -> None:
    result = add_robot(str(UR5E), "mine", tmp_path, tip="tip", samples=2000)
    assert checked_pairs(result.model) == checked_pairs(ur5e.ROBOT)


def checked_pairs(model: Any) -> set[tuple[str, str]]:
    geometry = Collisions(Arm(model), World()).geometry
    names = [link_of(item.name) for item in geometry.geometryObjects]
    return {(names[pair.first], names[pair.second]) for pair in geometry.collisionPairs}


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (
            {"j2": joint("j2", "l1", "l2", inner='<limit lower="-1" upper="1"/>')},
            "warning j2: no limit of vel",
        ),
        ({"j2": joint("j2", "l1", "l2", inner='<limit lower="-1" upper="1" velocity="99"/>')}, "implausibly"),
        ({"j2": joint("j2", "l1", "l2", inner='<limit upper="1" velocity="1"/>')}, 'j2: no limit "lower"'),
        ({"j1": joint("j1", "l0", "l1", kind="continuous", inner="")}, "info j1: continuous"),
        ({"j1": joint("j1", "l0", "l1", kind="prismatic")}, "info j1: prismatic; positions are in m"),
        ({"l3": '<link name="l3"/>'}, "l3: no geometry; a capsule of radius"),
        ({"l3": link("l3").replace('value="1"', 'value="0"')}, "l3: zero or negative inertia"),
        ({"l3": link("l3").replace('izz="1"', 'izz="5"')}, "l3: no body has this inertia"),
        ({"l3": f'<link name="l3">{TUBE}</link>'}, "l3: no inertia"),
        (
            {"l3": f'<link name="l3">{TUBE}</link>'},
            "warning torques: torques of motions are not checked: the URDF has no inertia for what j3 moves",
        ),
        ({"l3": link("l3", TUBE.replace("collision>", "visual>"))}, "l3: no collision geometry; its visual"),
        (
            {"l3": link("l3", TUBE + '<collision><geometry><box size="0 0 0"/></geometry></collision>')},
            "info l3: a collision without any extent is left out",
        ),
        (
            {
                "l3": link(
                    "l3", TUBE.replace('<cylinder radius="0.04" length="0.2"/>', '<box size="0 .1 .1"/>')
                )
            },
            "info l3: a collision has a size of 0; 0.001 m is used",
        ),
        (
            {"l6": link("l6", '<visual><geometry><sphere radius="0"/></geometry></visual>')},
            "info l6: a visual without any extent is left out",
        ),
        ({"plugin": "<gazebo/><transmission/>"}, "other tools are left out: gazebo, transmission"),
        (
            {"l9": link("l9"), "j9": joint("j9", "l5", "l9")},
            'there are 2 tips (l6, l9); "l6" is used',
        ),
        (
            {"l9": link("l9"), "arm_tcp": link("arm_tcp"), "j9": joint("j9", "l5", "l9")}
            | {"j10": joint("j10", "l5", "arm_tcp", kind="fixed", axis="0 0 0", inner="")},
            '"arm_tcp" is used',
        ),
        (
            {"j2": joint("j2", "l1", "l2", inner='<limit lower="-2" upper="-0.1" velocity="2"/>')},
            "pairs of links are checked",
        ),
        (
            {"same": link("j6"), "j9": joint("j9", "l6", "j6")},
            'info j6: a joint has the same name; the link is called "j6_link" here',
        ),
        (
            {"l9": link("l9"), "j9": joint("j9", "l6", "l9", inner=LIMIT + '<mimic joint="j1"/>')},
            'info j9: mimics "j1"; it is beside the way to the tip; it is held at 0',
        ),
    ],
)
def test_what_is_missing_or_odd_is_reported_and_the_robot_can_be_used(
    added: Any, changed: dict[str, str], said: str
) -> None:
    options = {"tip": "l6"} if "mimics" in said else {}
    assert said in texts(added(arm(**changed), **options))


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "not XML"),
        ("<robot", "not XML"),
        ("<sdf/>", "not <robot>; convert the SDF"),
        ('<robot xmlns:xacro="x"><xacro:include/></robot>', "is a xacro file; expand it first"),
        (robot(), "there is no link"),
        (robot(link("a"), link("a")), 'two links are called "a"'),
        (robot(link("a"), link("b")), "there are 2 root links: a, b"),
        (robot(link("a")), 'no joint moves between the root and "a"'),
        (robot(link("a"), '<joint name="j" type="fixed"/>'), 'the joint "j" has no parent and no child'),
        (robot(link("a"), joint("j", "a", "b")), 'the child "b" of the joint "j" does not exist'),
        (robot(link("a"), link("b"), joint("j", "a", "b"), joint("k", "b", "a")), "loop without a root link"),
        (arm(k=joint("k", "l6", "l2")), 'the link "l2" has 2 parents, a closed loop'),
        (
            arm(j3=joint("j3", "l2", "l3", inner='<limit lower="2" upper="-2" velocity="1"/>')),
            "limits reversed: lower 2.0 is above upper -2.0",
        ),
        (arm(j3=joint("j3", "l2", "l3", inner="")), "is revolute without limits"),
        (
            arm(j3=joint("j3", "l2", "l3", inner='<limit lower="1" upper="1"/>')),
            "cannot move: lower and upper",
        ),
        (
            arm(j3=joint("j3", "l2", "l3", inner='<limit lower="x" upper="1"/>')),
            'lower="x", which is not a n',
        ),
        (arm(j3=joint("j3", "l2", "l3", inner='<limit lower="nan" upper="1"/>')), 'lower="nan"'),
        (arm(j3=joint("j3", "l2", "l3", axis="0 0 0")), "an axis of length 0"),
        (arm(j3=joint("j3", "l2", "l3", axis="0 1")), 'xyz="0 1", which is not three numbers'),
        (arm(j3=joint("j3", "l2", "l3", kind="floating")), "is floating; between base and tip"),
        (arm(j3=joint("j3", "l2", "l3", kind="bendy")), 'the unknown type "bendy"'),
        (
            arm(j3=joint("j3", "l2", "l3", inner=LIMIT + '<mimic joint="j1"/>')),
            'mimics "j1" and is on the way',
        ),
        (arm(l3=link("l3", TUBE.replace('radius="0.04"', 'radius="-1"'))), 'radius="-1"; sizes are in m'),
        (arm(l3=link("l3", TUBE.replace('radius="0.04"', 'radius="40"'))), "at most 20"),
        (
            arm(l3=link("l3", TUBE.replace('"0.04"', '"-1"').replace("collision", "visual"))),
            'a visual shape of "l3" has radius="-1"',
        ),
        (arm(l3=link("l3", mesh("x.stl"))), 'the mesh x.stl of "l3" was not found'),
        (arm(l3=link("l3", mesh("x.stl").replace("collision", "visual"))), 'x.stl of "l3" was not found'),
    ],
)
def test_a_urdf_without_a_unique_meaning_is_refused_by_name_and_nothing_is_written(
    added: Any, tmp_path: Path, text: str, fault: str
) -> None:
    with pytest.raises(UsageError) as refused:
        added(text)
    assert fault in str(refused.value)
    assert all("arm.urdf: " in line for line in str(refused.value).splitlines())
    assert not (tmp_path / "robots" / "arm-1").exists()


def test_every_mesh_that_cannot_be_used_is_named_in_one_line(added: Any, tmp_path: Path) -> None:
    (tmp_path / "given").mkdir()
    (tmp_path / "given" / "text.stl").write_text("no mesh")
    with pytest.raises(UsageError) as refused:
        added(arm(l3=link("l3", mesh("text.stl")), l4=link("l4", mesh("package://none/gone.dae"))))
    unread, absent = str(refused.value).splitlines()
    assert '"l3": the mesh ' in unread
    assert "text.stl cannot be read: " in unread
    assert "assimp" not in unread
    assert "/project" not in unread
    assert 'the mesh package://none/gone.dae of "l4" was not found' in absent
    assert "ROS_PACKAGE_PATH" in absent
    assert not (tmp_path / "robots" / "arm-1").exists()


def test_a_mesh_of_400_mb_is_refused(added: Any, tmp_path: Path) -> None:
    path = tmp_path / "given" / "huge.stl"
    path.parent.mkdir()
    with path.open("wb") as file:
        file.truncate(400 << 20)
    with pytest.raises(UsageError, match="has 400 MB; reduce it to 20 MB at most"):
        added(arm(l3=link("l3", mesh("huge.stl"))))


COLLADA = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>
<created>2020-01-01T00:00:00</created><modified>2020-01-01T00:00:00</modified>{unit}<up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="12">{corners}</float_array><technique_common>
<accessor source="#pa" count="4" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/>
<p>0 1 2 0 1 3 0 2 3 1 2 3</p></triangles>
</mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="s">
<node id="n"><translate>{moved} 0 0</translate><instance_geometry url="#g"/></node></visual_scene>
</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


@given(
    unit_m=st.sampled_from((None, 1.0, 0.001, 0.01, 0.0254, 0.3048)),
    scale=st.sampled_from((1.0, 0.5, 2.0)),
    size_m=st.floats(0.05, 1.0),
)
@settings(max_examples=15, deadline=None)
def test_a_mesh_has_its_size_in_m_whatever_its_unit(
    tmp_path_factory: pytest.TempPathFactory, unit_m: float | None, scale: float, size_m: float
) -> None:
    """The same tetrahedron in any unit of COLLADA is the one of an STL file in m."""
    folder = tmp_path_factory.mktemp("meshes")
    corners_m = np.array([[0, 0, 0], [size_m, 0, 0], [0, size_m, 0], [0, 0, size_m]]) / scale
    written = " ".join(map(repr, (corners_m / (unit_m or 1.0)).ravel().tolist()))
    unit = "" if unit_m is None else f'<unit name="u" meter="{unit_m}"/>'
    moved = 0.1 / scale / (unit_m or 1.0)
    (folder / "a.dae").write_text(COLLADA.format(unit=unit, corners=written, moved=moved))
    placed_m = np.add(corners_m, (0.1 / scale, 0, 0))
    (folder / "a.stl").write_bytes(stl(placed_m[[0, 1, 2, 0, 1, 3, 0, 2, 3, 1, 2, 3]]))
    loaded = [load_mesh(folder / file, np.full(3, scale)).vertices() for file in ("a.dae", "a.stl")]
    collada, plain = (np.array([np.min(points, axis=0), np.max(points, axis=0)]) for points in loaded)
    assert collada == pytest.approx(plain, abs=1e-5)
    assert np.ptp(plain, axis=0) == pytest.approx([size_m] * 3, abs=1e-5)
    shape = geometry_of(Mesh(folder / "a.dae", (scale,) * 3))
    assert np.ptp(corners_of(shape), axis=0) == pytest.approx([size_m] * 3, abs=1e-5)


@pytest.mark.parametrize(
    ("name", "content", "fault"),
    [
        ("mm.stl", None, "is 300 m long"),
        ("a.dae", COLLADA.format(unit='<unit meter="0"/>', corners="0 " * 12, moved=0), "in m, above 0"),
        ("a.dae", COLLADA.format(unit='<unit meter="mm"/>', corners="0 " * 12, moved=0), "in m, above 0"),
        ("a.dae", "no XML", "cannot be read"),
        ("a.3mf", "x", "is not read; convert it to STL"),
    ],
)
def test_a_mesh_with_an_implausible_or_unknown_unit_is_refused(
    added: Any, tmp_path: Path, name: str, content: str | None, fault: str
) -> None:
    file = tmp_path / "given" / name
    file.parent.mkdir()
    if content is None:
        file.write_bytes(stl(box_mesh((100.0, 100.0, 300.0), (0, 0, 150.0)).reshape(-1, 3)))
    else:
        file.write_text(content)
    with pytest.raises(UsageError, match=fault) as refused:
        added(arm(l3=link("l3", mesh(name))))
    assert name in str(refused.value)
    if content is None:
        assert added(arm(l3=link("l3", mesh(name, "0.001 0.001 0.001")))).model.joint_names


def stl(points: Any) -> bytes:
    triangles = [points[number : number + 3] for number in range(0, len(points) - 2, 3)]
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *np.ravel(triangle), 0) for triangle in triangles)
    return b"\0" * 80 + struct.pack("<I", len(triangles)) + body


def test_meshes_of_a_ros_package_become_capsules_that_contain_them(
    added: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    share = tmp_path / "ros" / "share" / "arm_description"
    share.mkdir(parents=True)
    random = np.random.default_rng(1)
    points = random.normal(size=(300, 3)) * (0.01, 0.01, 0.08)
    (share / "link.stl").write_bytes(stl(points))
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "ros"))
    result = added(arm(l3=link("l3", mesh("package://arm_description/link.stl"))))
    assert "info l3: convex hulls in capsules and boxes replace its meshes" in texts(result)
    assert "mesh" not in result.model.urdf


def contains(shape: Fitted, points: Any) -> Any:
    """Return for each point whether the shape contains it."""
    local = np.array([shape.placement.actInv(point) for point in points])
    if len(shape.size) == 3:
        return (np.abs(local) <= np.array(shape.size) / 2 + 1e-9).all(axis=1)
    radius, length = shape.size
    beyond = np.maximum(np.abs(local[:, 2]) - length / 2, 0.0)
    return np.sqrt(local[:, 0] ** 2 + local[:, 1] ** 2 + beyond**2) <= radius + 1e-9


def test_a_fitted_shape_contains_every_point() -> None:
    random = np.random.default_rng(2)
    for scale in ((0.02, 0.02, 0.2), (0.1, 0.1, 0.1), (0.2, 0.01, 0.1)):
        points = random.uniform(-1, 1, (200, 3)) * scale + (0.3, -0.2, 0.1)
        assert contains(fit(points), points).all()


def box_mesh(size: tuple[float, float, float], at: tuple[float, float, float]) -> Any:
    """Return the 12 triangles of a box."""
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * size + at
    sides = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
    return corners[[half for a, b, c, d in sides for half in ((a, b, c), (a, c, d))]]


def hulls_contain(corners: Any, points: Any) -> Any:
    """Return for each point whether the convex hull of some corners contains it."""
    planes = ConvexHull(corners).equations
    return (points @ planes[:, :3].T + planes[:, 3]).max(axis=1) <= 1e-9


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_the_pieces_of_a_mesh_contain_all_of_it(seed: int) -> None:
    random = np.random.default_rng(seed)
    triangles = random.normal(size=(random.integers(4, 80), 3, 3)) * random.uniform(0.01, 0.3, 3)
    shares = random.dirichlet((1.0, 1.0, 1.0), (200, 1))
    on_it = (triangles[random.integers(0, len(triangles), 200)] * shares.transpose(0, 2, 1)).sum(axis=1)
    pieces = pieces_of(triangles)
    assert len(pieces) <= MAX_PIECES
    assert np.any([hulls_contain(piece.corners, on_it) for piece in pieces], axis=0).all()
    assert np.any([contains(fit(piece.corners), on_it) for piece in pieces], axis=0).all()


@pytest.mark.nightly
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_a_polytope_around_a_fine_mesh_has_few_corners_and_contains_it(seed: int) -> None:
    random = np.random.default_rng(seed)
    directions = random.normal(size=(1500, 3))
    points = directions / np.linalg.norm(directions, axis=1)[:, None] * random.uniform(0.03, 0.2, 3)
    corners = enclosing(points)
    assert len(corners) < MAX_CORNERS + 10
    assert hulls_contain(corners, points).all()
    assert ConvexHull(corners).volume < 1.1 * ConvexHull(points).volume


def test_a_mesh_in_a_plane_gets_a_thin_polytope() -> None:
    flat = np.array([[[0, 0, 0], [0.1, 0, 0], [0, 0.2, 0]]])
    (piece,) = pieces_of(flat)
    assert hulls_contain(piece.corners, flat.reshape(-1, 3)).all()
    assert ConvexHull(piece.corners).volume < 1e-4


def test_a_bent_link_is_cut_at_its_bend() -> None:
    """One hull around this link would close the corner that the next link moves into."""
    bent = np.concatenate([box_mesh((0.1, 0.1, 0.4), (0, 0, 0)), box_mesh((0.3, 0.1, 0.1), (0.2, 0, 0.15))])
    pieces = pieces_of(bent)
    hull_m3 = ConvexHull(bent.reshape(-1, 3)).volume
    assert sum(ConvexHull(piece.corners).volume for piece in pieces) < 0.8 * hull_m3
    assert not np.any([hulls_contain(piece.corners, np.array([[0.2, 0.0, 0.0]])) for piece in pieces])


def test_the_home_position_has_room_for_a_first_motion(added: Any) -> None:
    planner = Planner(added(arm()).model)
    assert planner.collisions.is_free(np.array(planner.model.home), 0.01)


def tool_of(model: Any, joints: Any) -> Any:
    return Arm(model).tool(np.array(joints))


@pytest.mark.parametrize("name", ["ur10", "ur5e", "panda", "arm"])
def test_the_home_position_has_the_tool_down_near_the_middle_of_the_joints(name: str, added: Any) -> None:
    model = added(arm()).model if name == "arm" else ROBOTS.load(name)
    home = find_home(Arm(model), SEED)
    tool, planner = tool_of(model, home.joints), Planner(model)
    assert home.is_tool_down
    assert tool.rotation[:, 2] == pytest.approx([0, 0, -1], abs=0.01)
    assert tool.translation[2] > 0
    assert planner.collisions.is_free(np.array(home.joints), 0.01)
    assert planner.arm.manipulability(np.array(home.joints)) > 0.02
    low, high = planner.arm.lower, planner.arm.upper
    away = np.abs(np.array(home.joints) - (low + high) / 2) / np.minimum((high - low) / 2, np.pi)
    assert away.max() < 0.75
    assert np.linalg.norm(away) < 1.1


def test_the_home_position_is_named_with_the_reason(added: Any) -> None:
    result = added(arm())
    assert "info home: [" in texts(result)
    assert "the tool points down there" in texts(result)
    beside = joint("j1", "l0", "l1", axis="0 0 1") + joint("j2", "l1", "l2", axis="0 0 1")
    upright = added(robot(link("l0"), link("l1"), link("l2"), beside), replaces=True)
    assert "no such position with the tool down is free" in texts(upright)


def test_an_arm_that_always_touches_itself_is_refused_with_the_pair(tmp_path: Path) -> None:
    ball = '<collision><geometry><sphere radius="0.6"/></geometry></collision>'
    file = tmp_path / "arm.urdf"
    text = arm(l0=link("l0", ball), l3=link("l3", ball))
    file.write_text(text.replace('ixx="1"', 'ixx="1" ixy="0" ixz="0" iyz="0"'))
    model = read_model(file, name="arm", tip="l6", max_acceleration=1.0, max_jerk=10.0)
    with pytest.raises(UsageError, match=r"free of contact: l0 and l3 in 100 % of the positions"):
        find_home(Arm(model), SEED)


@pytest.mark.parametrize("name", ["ur10", "ur5e", "panda", "..", ".", "-x", "a/b", "", "ä"])
def test_a_name_that_means_something_else_is_refused_and_nothing_is_lost(name: str, tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(arm())
    kept = tmp_path / "robots" / "kept.txt"
    kept.parent.mkdir()
    kept.write_text("x")
    options = ["--data-dir", str(tmp_path), "--replace"]
    done = CliRunner().invoke(app, ["robot", "add", str(file), f"--name={name}", *options])
    assert isinstance(done.exception, UsageError)
    assert "name" in str(done.exception)
    assert [path.name for path in kept.parent.iterdir()] == ["kept.txt"]


def test_a_robot_that_was_added_under_a_name_of_handover_is_not_used_silently(
    tmp_path: Path,
) -> None:
    add_robot(str(UR5E), "ur10", tmp_path / "robots", tip="tip", samples=200)
    with capture_logs() as logs:
        assert load_robot("ur10", tmp_path, tmp_path).name == "UR10"
    assert any("not the added one" in line["event"] for line in logs)
    listed = CliRunner().invoke(app, ["robot", "list", "--data-dir", str(tmp_path)]).output
    assert "(not used: ur10 is of Handover)" in listed.replace("\n", " ")


@pytest.mark.nightly
def test_an_arm_with_meshes_is_free_where_arms_of_this_kind_work(tmp_path: Path) -> None:
    """The shapes of a UR3 overlap beside its wrist, its meshes never do."""
    try:
        model = add_robot("example-robot-data:ur3_robot", "ur3", tmp_path, samples=1000).model
    except UsageError as missing:
        pytest.skip(str(missing))
    assert frozenset(("forearm_link", "wrist_2_link")) in model.disabled_pairs
    assert frozenset(("base_link", "forearm_link")) not in model.disabled_pairs
    planner = Planner(model)
    plan = planner.to_joints(model.home, (0.5, -1.3, 1.2, -1.4, -1.5, 0.0))
    onward = planner.to_joints(
        plan.trajectory.at(plan.trajectory.duration_s).positions, (-2.5, -1.3, 1.2, -1.4, -1.5, 0.0)
    )
    assert onward.trajectory.duration_s > 0


def test_an_existing_robot_is_replaced_only_on_request(added: Any) -> None:
    added(arm())
    with pytest.raises(UsageError, match="exists; choose another name, or replace it"):
        added(arm())
    assert added(arm(), replaces=True).model.joint_names[0] == "j1"


def test_the_command_prints_the_report_and_how_to_use_the_robot(tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(arm())
    options = ["robot", "add", str(file), "--name", "arm-1", "--data-dir", str(tmp_path)]
    done = CliRunner().invoke(app, options)
    assert done.exit_code == 0, done.output
    assert "6 joints from the base to l6" in done.output
    assert "HANDOVER_ROBOT_MODEL=arm-1" in done.output
    listed = CliRunner().invoke(app, ["robot", "list", "--data-dir", str(tmp_path)])
    assert [line.split()[0] for line in listed.output.splitlines()] == ["panda", "ur10", "ur5e", "arm-1"]


@pytest.mark.parametrize(
    ("source", "fault"),
    [
        ("nowhere.urdf", "cannot be read"),
        ("package://nowhere/arm.urdf", "was not found; source the setup file"),
        ("example-robot-data:no_such_robot", "example-robot-data"),
    ],
)
def test_a_source_that_is_not_there_is_named(tmp_path: Path, source: str, fault: str) -> None:
    with pytest.raises(UsageError, match=fault):
        add_robot(source, "arm-1", tmp_path)
