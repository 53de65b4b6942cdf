import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_robots.model.faults import Unreachable
from handover_robots.model.joints import Joints
from handover_robots.model.poses import Frame, Pose, pointing_down
from handover_robots.robots.universal_robots import JOINT_LIMIT_RAD
from handover_robots.robots.ur10 import KINEMATICS, ROBOT

forward, inverse, nearest = KINEMATICS.forward, KINEMATICS.inverse, KINEMATICS.nearest

unhurried = settings(deadline=None)
CLOSE = 1e-5  # a hundredth of a millimetre: a tenth of what the robot repeats
HOME = (0.0, -math.pi / 2, math.pi / 2, -math.pi / 2, -math.pi / 2, 0.0)
angles = st.floats(-math.pi, math.pi)
joints = st.tuples(*[angles] * 6)
wide_joints = st.tuples(*[st.floats(-JOINT_LIMIT_RAD, JOINT_LIMIT_RAD)] * 6)


def difference(first: Frame, second: Frame) -> float:
    turned = max(
        abs(a - b)
        for row, row_of_second in zip(first.rotation, second.rotation, strict=True)
        for a, b in zip(row, row_of_second, strict=True)
    )
    return max(turned, math.dist(first.position, second.position))


def same_angles(first: Joints, second: Joints, within: float) -> bool:
    return all(abs(math.remainder(a - b, 2 * math.pi)) < within for a, b in zip(first, second, strict=True))


def test_the_stretched_arm_is_where_the_data_sheet_says() -> None:
    flange = forward((0.0,) * 6)
    assert flange.position == pytest.approx((-0.612 - 0.5723, -0.163941 - 0.0922, 0.1273 - 0.1157))


def test_the_upright_arm_is_where_the_data_sheet_says() -> None:
    flange = forward((0.0, -math.pi / 2, 0.0, -math.pi / 2, 0.0, 0.0))
    assert flange.position == pytest.approx((0.0, -0.163941 - 0.0922, 0.1273 + 0.612 + 0.5723 + 0.1157))


@unhurried
@given(wide_joints)
def test_the_description_has_the_flange_where_the_kinematics_has_it(held: Joints) -> None:
    assert difference(ROBOT.flange(held), forward(held)) < 1e-9


@unhurried
@given(joints)
def test_every_solution_brings_the_flange_to_the_pose(held: Joints) -> None:
    flange = forward(held)
    for solution in inverse(flange, held):
        assert difference(forward(solution), flange) < CLOSE


@unhurried
@given(joints)
def test_the_way_the_arm_is_held_is_among_the_solutions(held: Joints) -> None:
    flange = forward(held)
    solutions = inverse(flange, held)
    assert solutions
    singular = abs(math.sin(held[4])) < 1e-3 or abs(math.sin(held[2])) < 1e-3
    if not singular and len(solutions) == 8:
        assert any(same_angles(solution, held, 1e-4) for solution in solutions)


@unhurried
@given(wide_joints)
def test_the_nearest_solution_is_no_turn_at_all_from_where_the_arm_is(held: Joints) -> None:
    reached = nearest(forward(held), held)
    assert difference(forward(reached), forward(held)) < CLOSE
    assert all(abs(angle) <= JOINT_LIMIT_RAD for angle in reached)
    if min(abs(math.sin(held[2])), abs(math.sin(held[4]))) > 0.05 and len(inverse(forward(held), held)) == 8:
        assert max(abs(a - b) for a, b in zip(reached, held, strict=True)) < 1e-4


@unhurried
@given(joints, wide_joints)
def test_the_nearest_solution_is_nearer_than_any_other(held: Joints, current: Joints) -> None:
    flange = forward(held)
    chosen = max(abs(a - b) for a, b in zip(nearest(flange, current), current, strict=True))
    for solution in inverse(flange, current):
        assert chosen <= max(abs(a - b) for a, b in zip(solution, current, strict=True)) + 1e-6


@unhurried
@given(joints)
def test_a_pose_and_its_frame_are_the_same(held: Joints) -> None:
    flange = forward(held)
    pose = Pose.of(flange)
    assert math.hypot(*pose.orientation) == pytest.approx(1.0)
    assert difference(pose.frame(), flange) < 1e-9


def test_there_are_eight_ways_to_hold_the_arm_at_an_ordinary_pose() -> None:
    held = (0.3, -1.2, 1.4, -0.7, -1.1, 0.4)
    solutions = inverse(forward(held), held)
    assert len(solutions) == 8
    assert len({tuple(round(angle, 6) for angle in solution) for solution in solutions}) == 8


def test_a_straight_wrist_leaves_the_last_joint_where_it_is() -> None:
    held = (0.3, -1.2, 1.4, -0.7, 0.0, 0.8)
    solutions = inverse(forward(held), held)
    straight = [solution for solution in solutions if abs(solution[4]) < 1e-6]
    assert straight
    assert all(solution[5] == pytest.approx(0.8) for solution in straight)
    assert nearest(forward(held), held) == pytest.approx(held, abs=1e-6)


def test_a_stretched_elbow_is_reached() -> None:
    held = (0.3, -1.2, 0.0, -0.7, -1.1, 0.8)
    assert difference(forward(nearest(forward(held), held)), forward(held)) < CLOSE


def test_too_far_away_says_how_far_the_arm_reaches() -> None:
    with pytest.raises(Unreachable, match=r"wrist would be 2\.\d+ m from the shoulder.*reaches 1\.30 m"):
        nearest(pointing_down((2.0, 0.5, 0.3)).frame(), HOME)


def test_inside_the_column_of_the_base_says_how_near_the_arm_gets() -> None:
    with pytest.raises(Unreachable, match=r"0\.050 m from the axis of the base.*further out"):
        nearest(pointing_down((0.05, 0.0, 0.8)).frame(), HOME)
    assert inverse(pointing_down((0.05, 0.0, 0.8)).frame(), HOME) == []


def test_a_target_across_the_half_turn_is_reached_the_short_way() -> None:
    before = (math.pi - 0.1, *HOME[1:])
    beyond = (math.pi + 0.1, *HOME[1:])
    assert nearest(forward(beyond), before) == pytest.approx(beyond)


@unhurried
@given(st.tuples(*[angles] * 4), st.sampled_from([0.0, math.pi, -math.pi]), angles, wide_joints)
def test_a_straight_wrist_is_reached_whatever_the_last_joint_is_now(
    arm: tuple[float, ...], wrist: float, tool: float, current: Joints
) -> None:
    flange = forward((*arm, wrist, tool))
    assert difference(forward(nearest(flange, current)), flange) < CLOSE
