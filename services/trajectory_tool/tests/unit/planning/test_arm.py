"""The arms are compared with the published Denavit-Hartenberg parameters, and with our own kinematics."""

import math
from typing import Any

import numpy as np
import pytest

from handover_robots.planning.arm import Arm
from handover_robots.robots import ROBOTS

NAMES = ("ur10", "ur5e", "panda")

# Universal Robots, "DH parameters for calculations of kinematics and dynamics": a, d, alpha of each joint.
UR10 = ((0, 0.1273, 90), (-0.612, 0, 0), (-0.5723, 0, 0), (0, 0.163941, 90), (0, 0.1157, -90), (0, 0.0922, 0))
UR5E = ((0, 0.1625, 90), (-0.425, 0, 0), (-0.3922, 0, 0), (0, 0.1333, 90), (0, 0.0997, -90), (0, 0.0996, 0))
# Franka Control Interface, "Robot and interface specifications" (DH after Craig): a, d, alpha before joints.
PANDA = (
    (0, 0.333, 0), (0, 0, -90), (0, 0.316, 90), (0.0825, 0, 90),
    (-0.0825, 0.384, -90), (0, 0, 90), (0.088, 0, 90),
)  # fmt: skip


def turn_z(angle: float) -> Any:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])


def turn_x(angle: float) -> Any:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1.0]])


def shift(x: float, z: float) -> Any:
    moved = np.eye(4)
    moved[0, 3], moved[2, 3] = x, z
    return moved


def classic(rows: Any, joints: Any) -> Any:
    reached = np.eye(4)
    for (a, d, alpha), angle in zip(rows, joints, strict=True):
        reached = reached @ turn_z(angle) @ shift(a, d) @ turn_x(math.radians(alpha))
    return reached


def craig(rows: Any, joints: Any) -> Any:
    reached = np.eye(4)
    for (a, d, alpha), angle in zip(rows, joints, strict=True):
        reached = reached @ turn_x(math.radians(alpha)) @ shift(a, 0) @ turn_z(angle) @ shift(0, d)
    return reached


EXPECTED = {
    "ur10": lambda joints: classic(UR10, joints) @ shift(0, 0.15),
    "ur5e": lambda joints: classic(UR5E, joints) @ shift(0, 0.15),
    "panda": lambda joints: craig(PANDA, joints) @ shift(0, 0.107) @ turn_z(-math.pi / 4) @ shift(0, 0.1034),
}


@pytest.fixture(scope="module", params=NAMES)
def arm(request: pytest.FixtureRequest) -> Arm:
    return Arm(ROBOTS.load(request.param))


def samples(arm: Arm, count: int) -> Any:
    return np.random.default_rng(1).uniform(arm.lower, arm.upper, (count, arm.n))


def test_the_tool_is_where_the_published_parameters_have_it(arm: Arm) -> None:
    expected = EXPECTED[arm.model.name.lower()]
    for joints in samples(arm, 200):
        assert arm.tool(joints).homogeneous == pytest.approx(expected(joints), abs=1e-6)


def test_the_tool_is_where_the_robot_model_has_it(arm: Arm) -> None:
    for joints in samples(arm, 50):
        ours = arm.model.tool_pose(tuple(joints.tolist()))
        assert arm.tool_pose(joints).position == pytest.approx(ours.position, abs=1e-9)
        assert arm.tool_pose(joints).orientation == pytest.approx(ours.orientation, abs=1e-6)


def test_no_point_of_the_arm_moves_farther_than_its_bound(arm: Arm) -> None:
    import pinocchio as pin

    data = pin.GeometryData(arm.geometry)
    items = arm.geometry.geometryObjects
    reaches = np.array([arm.reach_of(item) for item in items])
    random = np.random.default_rng(2)

    def corners(joints: Any) -> list[Any]:
        pin.updateGeometryPlacements(arm.pin_model, arm.data, arm.geometry, data, joints)
        reached = []
        for item, placed in zip(items, data.oMg, strict=True):
            box = item.geometry
            box.computeLocalAABB()
            low, high = box.aabb_local.min_, box.aabb_local.max_
            # The middles of the faces of the bounding box belong to each of our shapes, up to rounded edges.
            middles = [
                np.where(np.arange(3) == axis, (low, high)[side], (low + high) / 2)
                for axis in range(3)
                for side in (0, 1)
            ]
            reached.append(np.array([placed.act(middle) for middle in middles]))
        return reached

    for joints in samples(arm, 200):
        step = random.uniform(-0.05, 0.05, arm.n)
        before, after = corners(joints), corners(joints + step)
        for number, (placement, other) in enumerate(zip(before, after, strict=True)):
            moved = float(np.linalg.norm(placement - other, axis=1).max())
            assert moved <= float(reaches[number] @ np.abs(step)) + 1e-9


def test_equivalents_are_the_same_pose_within_the_limits(arm: Arm) -> None:
    for joints in samples(arm, 5):
        solutions = arm.equivalents(joints)
        assert any(np.allclose(solution, joints) for solution in solutions)
        for solution in solutions:
            assert arm.is_within(solution)
            assert arm.tool(solution).isApprox(arm.tool(joints), 1e-9)


def test_the_masses_and_inertias_are_physical(arm: Arm) -> None:
    for number in range(1, arm.pin_model.njoints):
        inertia = arm.pin_model.inertias[number]
        assert inertia.mass > 0
        assert np.linalg.eigvalsh(inertia.inertia).min() > 0
