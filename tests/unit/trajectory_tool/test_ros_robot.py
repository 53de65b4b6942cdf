"""A robot behind ROS: the trajectory that is sent, and the joints that are read."""

import pytest

from services.trajectory_tool.robot import RobotFault
from services.trajectory_tool.robots.ur10 import ROBOT
from services.trajectory_tool.ros_robot import MAX_POINTS, at_rate, in_order, points
from services.trajectory_tool.trajectory import Course

HOME = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
JOINT_NAMES = ROBOT.joint_names
AWAY = (0.6, -1.2, 1.4, -1.5, -1.5, 0.2)


def course(speed: float) -> Course:
    limits = ROBOT.limits
    return Course(HOME, AWAY, limits.slowed(speed), limits, began_s=0.0)


@pytest.mark.parametrize("speed", [1.0, 0.5, 0.01])
def test_a_trajectory_ends_at_rest_at_its_target_after_the_time_planned(speed: float) -> None:
    planned = course(speed)
    made = points(planned.at, planned.remaining_s(0.0))
    assert len(made) <= MAX_POINTS
    assert made[-1]["positions"] == list(AWAY)
    assert made[-1]["velocities"] == [0.0] * 6
    times_s = [one["time_from_start"]["sec"] + one["time_from_start"]["nanosec"] / 1e9 for one in made]
    assert times_s == sorted(set(times_s))
    assert times_s[-1] == pytest.approx(planned.remaining_s(0.0), abs=1e-6)


def test_no_point_of_a_trajectory_is_faster_than_the_joints_may_turn() -> None:
    limits = ROBOT.limits
    for one in points(course(0.5).at, course(0.5).remaining_s(0.0)):
        for turns, may in zip(one["velocities"], limits.velocity, strict=True):
            assert abs(turns) <= 0.5 * may + 1e-6


def test_a_lower_pace_slows_velocities_and_accelerations_on_the_same_path() -> None:
    planned = course(1.0)
    whole_s = planned.remaining_s(0.0)
    full = points(planned.at, whole_s)
    slow = points(at_rate(planned.at, 0.5), whole_s / 0.5)
    assert slow[-1]["positions"] == full[-1]["positions"]
    at_half, slow_at_half = planned.at(whole_s / 2), at_rate(planned.at, 0.5)(whole_s)
    assert slow_at_half.positions == at_half.positions
    assert slow_at_half.velocities == tuple(0.5 * value for value in at_half.velocities)
    assert slow_at_half.accelerations == tuple(0.25 * value for value in at_half.accelerations)


def test_joints_are_read_by_name_in_any_order_and_beside_other_joints() -> None:
    names = ["finger_joint", *reversed(JOINT_NAMES)]
    assert in_order(JOINT_NAMES, names, [9.0, *reversed(AWAY)]) == AWAY


@pytest.mark.parametrize(
    ("names", "values", "why"),
    [
        (
            JOINT_NAMES[:5],
            AWAY[:5],
            "wrist_3_joint are not reported; the reported joints are shoulder_pan_joint",
        ),
        (JOINT_NAMES, AWAY[:5], "6 joint names and 5 values are reported"),
        (JOINT_NAMES, (*AWAY[:5], None), "wrist_3_joint are not reported"),
        (None, AWAY, "0 joint names and 6 values"),
        (None, None, "0 joint names and 0 values"),
    ],
)
def test_incomplete_joints_are_refused(names: object, values: object, why: str) -> None:
    with pytest.raises(RobotFault, match=why):
        in_order(JOINT_NAMES, names, values)
