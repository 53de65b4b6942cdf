"""What every robot model keeps, as tests: those of a model subclass `ModelContract` and name the robot.

    class TestMyArm(ModelContract):
        robot = "my-arm"      # as in HANDOVER_ROBOT_MODEL; a path of a folder works as well

They need pytest. Those about kinematics and collision need the extra `motion`, and are skipped without it.
"""

import json
import math
from collections import Counter
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from random import Random
from typing import Any

import pytest
from lxml import etree

from handover_robots.cell.cell import RobotCell
from handover_robots.cell.device import description
from handover_robots.model.joints import Joints
from handover_robots.model.obstacles import World
from handover_robots.model.poses import Frame, Pose
from handover_robots.model.robot_model import RobotModel
from handover_robots.planning import is_available
from handover_robots.robots.folder import load_robot
from handover_robots.settings import TrajectorySettings

SEED = 1
"""Of the random positions: the same ones in each run."""
TOLERANCE_M = 1e-4
needs_motion = pytest.mark.skipif(not is_available(), reason="the extra motion has no wheels here")


class ModelContract:
    """The tests; a subclass has `robot`, the name of the model or the folder of one."""

    robot: str
    min_reached = 0.95
    """The fraction of reachable poses that inverse kinematics finds."""
    max_tool_m = 1.0
    """The tip of the tool is no further from the flange."""
    samples = 100
    meshes: str | Path | None = None
    """The URDF of the manufacturer with its meshes; else the robot's own one counts, if meshes draw it."""

    @pytest.fixture
    def model(self, tmp_path: Path) -> RobotModel:
        return _model(self.robot, tmp_path)

    @pytest.fixture
    def planner(self, model: RobotModel) -> Any:
        return _planner(model)

    def positions(self, model: RobotModel, count: int) -> list[Joints]:
        """Return random positions within the limits and one turn."""
        random = Random(SEED)  # noqa: S311 - for tests
        ranges = [
            (max(_bound(joint.lower, -math.pi), -math.pi), min(_bound(joint.upper, math.pi), math.pi))
            for joint in model.joints
        ]
        return [tuple(random.uniform(*between) for between in ranges) for _ in range(count)]

    def test_joints_have_limits_that_a_motion_can_keep(self, model: RobotModel) -> None:
        assert model.joints
        assert len(set(model.joint_names)) == len(model.joints)
        for joint in model.joints:
            limits = (joint.max_velocity, joint.max_acceleration, joint.max_jerk)
            assert all(math.isfinite(limit) and limit > 0 for limit in limits), joint
            assert 0.001 <= joint.max_velocity / joint.max_acceleration <= 10, f"{joint}: s to full speed"
            assert 0.0001 <= joint.max_acceleration / joint.max_jerk <= 10, f"{joint}: s to full acceleration"
            if joint.kind == "continuous":
                assert joint.lower is None
                assert joint.upper is None
            else:
                assert joint.lower is not None
                assert joint.upper is not None
                assert joint.lower < joint.upper

    def test_home_and_all_named_positions_are_within_the_limits(self, model: RobotModel) -> None:
        assert model.allow(model.home) == model.home
        for name, joints in model.poses.items():
            assert model.allow(joints) == joints, name
        assert model.poses.get("home", model.home) == model.home

    def test_the_tool_is_at_the_flange(self, model: RobotModel) -> None:
        for joints in (model.home, *self.positions(model, 5)):
            flange, tool = model.flange(joints), model.tool_pose(joints).frame()
            for frame in (flange, tool):
                _require_rotation(frame)
            assert math.dist(flange.position, tool.position) <= self.max_tool_m

    def test_a_mounted_robot_has_its_tool_where_the_base_carries_it(self, model: RobotModel) -> None:
        base = Pose((0.4, -0.2, 0.1), (0.0, 0.0, math.sin(0.3), math.cos(0.3))).frame()
        reached = model.mounted(base).tool_pose(model.home)
        expected = Pose.of(base @ model.tool_pose(model.home).frame())
        assert reached.distance_m(expected) < TOLERANCE_M

    def test_the_links_that_the_srdf_names_exist(self, model: RobotModel) -> None:
        links = {link.get("name") for link in etree.fromstring(model.urdf.encode()).findall("link")}
        assert model.tip in links
        for pair in model.disabled_pairs:
            assert len(pair) == 2
            assert pair <= links, pair

    def test_the_fingers_move_within_their_limits(self, model: RobotModel) -> None:
        joints = {
            joint.get("name"): joint for joint in etree.fromstring(model.urdf.encode()).findall("joint")
        }
        for finger in model.fingers:
            limit = joints[finger.joint].find("limit")
            assert limit is not None
            lower, upper = float(limit.get("lower", "nan")), float(limit.get("upper", "nan"))
            assert all(lower <= at <= upper for at in (finger.opened, finger.closed, finger.holding))

    @needs_motion
    def test_the_library_for_planning_has_the_tool_at_the_same_pose(
        self, model: RobotModel, planner: Any
    ) -> None:
        for joints in (model.home, *self.positions(model, self.samples)):
            ours, planned = model.tool_pose(joints), planner.arm.tool_pose(joints)
            assert ours.distance_m(planned) < TOLERANCE_M
            assert abs(_dot(ours.orientation, planned.orientation)) == pytest.approx(1.0, abs=1e-6)

    @needs_motion
    def test_named_positions_are_free_of_contact_of_the_robot_with_itself(
        self, model: RobotModel, planner: Any
    ) -> None:
        for name, joints in {"home": model.home, **model.poses}.items():
            assert planner.why_not_free(joints) is None, name

    @needs_motion
    def test_poses_are_reached_by_joints_within_the_limits(self, model: RobotModel, planner: Any) -> None:
        from handover_robots.planning.inverse import Inverse

        inverse, reached = Inverse(planner.arm), 0
        for joints in self.positions(model, self.samples):
            pose = model.tool_pose(joints)
            solution = inverse.solve(pose, _array(model.home))
            if solution is None:
                continue
            assert planner.arm.is_within(solution)
            assert model.tool_pose(tuple(solution.tolist())).distance_m(pose) < TOLERANCE_M
            reached += 1
        assert reached >= self.min_reached * self.samples

    @needs_motion
    def test_the_shapes_enclose_the_meshes_and_leave_the_robot_its_room(self, model: RobotModel) -> None:
        """What `handover robot shapes` measures: 0 mm outside, and few positions refused that are free."""
        from handover_robots.onboarding.comparison import MAX_FALSELY_REFUSED
        from handover_robots.onboarding.enclosure import measure_shapes

        report = measure_shapes(model, str(self._meshes(model)), 10 * self.samples, SEED)
        assert not report.unmapped
        outside = {link.link: link.outside_mm for link in report.links if link.outside_mm > 0}
        assert not outside, f"mm of meshes outside of the shapes: {outside}"
        refused = [pair for pair in report.comparison.pairs if pair.falsely_refused > MAX_FALSELY_REFUSED]
        assert not refused, f"pairs whose shapes refuse what is free by the meshes: {refused}"
        allowed = [pair for pair in report.comparison.pairs if pair.falsely_allowed > 0]
        assert not allowed, f"pairs whose meshes touch where the shapes are free: {allowed}"

    def _meshes(self, model: RobotModel) -> Path:
        if self.meshes is not None:
            if not Path(self.meshes).is_file():
                pytest.skip(f"the URDF with the meshes is not kept here: {self.meshes}")
            return Path(self.meshes)
        if model.file is None or "<mesh" not in model.urdf:
            pytest.skip("there are no meshes; `meshes` of the contract names the URDF of the manufacturer")
        return model.file

    @needs_motion
    def test_no_pair_is_left_unchecked_that_touches_in_some_positions_only(self, model: RobotModel) -> None:
        """Pairs of an SRDF are those that never touch, or always: others would be collisions unseen."""
        from handover_robots.planning.arm import Arm
        from handover_robots.planning.collision import Collisions

        everything = Collisions(Arm(replace(model, disabled_pairs=frozenset())), World())
        touching: Counter[frozenset[str]] = Counter()
        for joints in self.positions(model, 5 * self.samples):
            touching.update(
                {
                    frozenset((contact.first, contact.second))
                    for contact in everything.contacts(_array(joints))
                }
            )
        sometimes = {pair for pair, count in touching.items() if 0 < count < 5 * self.samples}
        hidden = sorted(map(sorted, sometimes & model.disabled_pairs - _neighbours(model)))
        assert not hidden, f"the SRDF leaves pairs unchecked that can collide: {hidden}"

    def test_the_description_has_all_joints_and_can_be_read_back(
        self, model: RobotModel, tmp_path: Path
    ) -> None:
        """It is what `GET /robots/{robot}/description` returns."""
        settings = TrajectorySettings.load(data_dir=tmp_path, robot_model=self.robot, robot="simulated")
        described = json.loads(json.dumps(description(RobotCell(settings).only), allow_nan=False))
        assert [joint["name"] for joint in described["joints"]] == list(model.joint_names)
        assert described["home"] == list(model.home)
        drawn = etree.fromstring(described["urdf"].encode())
        assert set(model.joint_names) <= {joint.get("name") for joint in drawn.findall("joint")}


_models: dict[str, RobotModel] = {}


def _model(robot: str, data_dir: Path) -> RobotModel:
    if robot not in _models:
        _models[robot] = load_robot(robot, data_dir, Path())
    return _models[robot]


def _planner(model: RobotModel) -> Any:
    from handover_robots.planning.planner import Planner

    return Planner(model, world=World())


def _neighbours(model: RobotModel) -> frozenset[frozenset[str]]:
    """Return the pairs of links that share a joint, or are joined by one link between them."""
    joints = etree.fromstring(model.urdf.encode()).findall("joint")
    joined = [
        frozenset((joint.find("parent").get("link"), joint.find("child").get("link"))) for joint in joints
    ]
    across = {first ^ second for first, second in combinations(joined, 2) if len(first & second) == 1}
    return frozenset(joined) | across


def _array(joints: Joints) -> Any:
    import numpy as np

    return np.array(joints)


def _bound(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value


def _dot(first: tuple[float, ...], second: tuple[float, ...]) -> float:
    return sum(a * b for a, b in zip(first, second, strict=True))


def _require_rotation(frame: Frame) -> None:
    for number, row in enumerate(frame.rotation):
        products = [_dot(row, other) for other in frame.rotation]
        assert products == pytest.approx([float(number == index) for index in range(3)], abs=1e-9)
