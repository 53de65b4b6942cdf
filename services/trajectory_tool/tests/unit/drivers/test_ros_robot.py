"""A robot behind ROS: the trajectory that is sent, and the joints that are read."""

import pytest

from handover_datamodels.arm_stream import MAX_POINTS as MAX_MESSAGE_POINTS
from handover_robots.drivers.ros_goals import FOLLOWING_RAD, MAX_POINTS, Way, points
from handover_robots.drivers.ros_link import in_order
from handover_robots.limits.limiter import JointLimiter
from handover_robots.model.faults import RobotFault
from handover_robots.model.trajectory import Course, Setpoint
from handover_robots.robots.ur10 import ROBOT

HOME = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
JOINT_NAMES = ROBOT.joint_names
AWAY = (0.6, -1.2, 1.4, -1.5, -1.5, 0.2)
CYCLE_S = 0.008


def setpoints(speed: float) -> list[Setpoint]:
    limits = ROBOT.limits
    course = Course(HOME, AWAY, limits.slowed(speed), limits, began_s=0.0)
    made = [course.at(0.0)]
    while not course.is_over((len(made) - 1) * CYCLE_S):
        made.append(course.at(len(made) * CYCLE_S))
    return made


@pytest.mark.parametrize("speed", [1.0, 0.5, 0.01])
@pytest.mark.parametrize("late_s", [0.0, 0.03])
def test_a_goal_ends_at_rest_at_its_target_after_the_time_planned(speed: float, late_s: float) -> None:
    planned = setpoints(speed)
    made = points(planned, CYCLE_S, late_s)
    assert len(made) <= MAX_POINTS <= MAX_MESSAGE_POINTS
    assert made[-1].positions == AWAY
    assert made[-1].velocities == (0.0,) * 6
    times_s = [point.time_s for point in made]
    assert times_s == sorted(set(times_s))
    assert times_s[0] > 0
    assert times_s[-1] == pytest.approx((len(planned) - 1) * CYCLE_S - late_s)


def test_a_goal_that_is_late_has_the_same_points_at_the_same_times() -> None:
    planned = setpoints(1.0)
    punctual = {round(point.time_s, 4): point.positions for point in points(planned, CYCLE_S)}
    late = {
        round(point.time_s + 2 * CYCLE_S, 4): point.positions
        for point in points(planned, CYCLE_S, 2 * CYCLE_S)
    }
    at_both = [time_s for time_s in late if time_s in punctual]
    assert all(late[time_s] == punctual[time_s] for time_s in at_both)
    every = {round(number * CYCLE_S, 4): setpoint.positions for number, setpoint in enumerate(planned)}
    assert all(every[time_s] == pytest.approx(here, abs=1e-6) for time_s, here in late.items())


def test_a_goal_that_is_later_than_the_whole_motion_is_its_end() -> None:
    (only,) = points(setpoints(1.0), CYCLE_S, 100.0)
    assert only.positions == AWAY
    assert only.time_s > 0


def test_a_limiter_resumes_from_a_moving_setpoint_and_still_refuses_a_jump() -> None:
    planned = setpoints(1.0)
    limiter = JointLimiter(ROBOT.limits)
    middle = len(planned) // 2
    limiter.resume(planned[middle], middle * CYCLE_S)
    assert limiter.limit(planned[middle + 1], (middle + 1) * CYCLE_S) == planned[middle + 1]
    limiter.resume(planned[middle], middle * CYCLE_S)
    with pytest.raises(RobotFault, match="exceeds"):
        limiter.limit(planned[middle + 20], (middle + 1) * CYCLE_S)


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


def test_an_arm_that_is_late_at_the_end_of_a_motion_follows_it_within_the_delay_only() -> None:
    """The last setpoints hardly move, so the delay counts by the way and not by the present speed."""
    way, planned = Way(delay_s=0.2), setpoints(1.0)
    for number, setpoint in enumerate(planned):
        way.advance(number * CYCLE_S, setpoint.positions)
    cycles = round(0.2 / CYCLE_S)
    assert way.is_near(planned[-1].positions)
    assert way.is_near(planned[-cycles].positions)
    assert not way.is_near(planned[-2 * cycles].positions)


def test_an_arm_that_stands_still_is_not_near_a_motion_that_was_computed_late() -> None:
    way = Way(delay_s=0.5)
    way.advance(0.0, HOME)
    way.advance(2.0, AWAY)
    assert way.is_near(HOME), "no later report can have come yet"
    way.advance(3.0, AWAY)
    assert not way.is_near(HOME)
    assert way.is_near((AWAY[0] + 0.9 * FOLLOWING_RAD, *AWAY[1:]))
