import itertools
import math
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_robots.model.faults import RobotFault
from handover_robots.model.joints import Joints
from handover_robots.model.trajectory import Course, Limits, Setpoint, duration_s

unhurried = settings(deadline=None)
UR10 = Limits((2.09, 2.09, 3.14, 3.14, 3.14, 3.14), (8.0,) * 6, (80.0,) * 6)
CYCLE_S = 0.008
FULL_TURN = 2 * math.pi

angle = st.floats(-FULL_TURN, FULL_TURN) | st.sampled_from([0.0, 1e-12, 1e-6])
joints = st.tuples(*[angle] * 6)
speeds = st.floats(0.05, 1.0)


def a_course(start: Joints, target: Joints, speed: float = 1.0) -> Course:
    return Course(start, target, UR10.slowed(speed), UR10, began_s=10.0)


def sampled(course: Course, until_s: float = math.inf) -> Iterator[tuple[float, Setpoint]]:
    """Follow a course cycle by cycle until it is over; the time counts from its beginning."""
    for cycle in itertools.count():
        since_s = cycle * CYCLE_S
        yield since_s, course.at(10.0 + since_s, pace=1.0 if since_s < until_s else 0.0)
        if course.is_over(10.0 + since_s):
            return


def within(values: Joints, limits: Joints) -> bool:
    return all(abs(value) <= limit * (1 + 1e-6) for value, limit in zip(values, limits, strict=True))


def require_limits(course: Course, limits: Limits, until_s: float = math.inf) -> list[Setpoint]:
    """Follow a course to its end and require every limit, also between the cycles, of every setpoint."""
    setpoints = [setpoint for _, setpoint in sampled(course, until_s)]
    for setpoint in setpoints:
        assert within(setpoint.velocities, limits.velocity)
        assert within(setpoint.accelerations, limits.acceleration)
    for before, following in itertools.pairwise(setpoints):
        # What changes between two cycles can have changed no faster than its own derivative allows.
        for derivative, values, others in (
            (limits.velocity, before.positions, following.positions),
            (limits.acceleration, before.velocities, following.velocities),
            (limits.jerk, before.accelerations, following.accelerations),
        ):
            changes = tuple((b - a) / CYCLE_S for a, b in zip(values, others, strict=True))
            assert within(tuple(change - math.copysign(1e-6, change) for change in changes), derivative)
    return setpoints


@unhurried
@given(joints, joints, speeds)
def test_no_joint_ever_exceeds_its_limits(start: Joints, target: Joints, speed: float) -> None:
    setpoints = require_limits(a_course(start, target, speed), UR10.slowed(speed))
    assert setpoints[0].positions == pytest.approx(start, abs=1e-8)
    assert setpoints[-1] == Setpoint.at_rest(target)


@unhurried
@given(joints, joints, speeds, st.floats(0, 1))
def test_a_stop_at_any_moment_stays_within_the_limits_and_on_the_way(
    start: Joints, target: Joints, speed: float, share: float
) -> None:
    course = a_course(start, target, speed)
    asked_s = share * duration_s(start, target, UR10.slowed(speed))
    setpoints = require_limits(course, UR10, until_s=asked_s)
    rest = setpoints[-1]
    assert rest.velocities == (0.0,) * 6
    ways = [there - here for here, there in zip(start, target, strict=True)]
    gone = [now - here for here, now in zip(start, rest.positions, strict=True)]
    longest = max(range(6), key=lambda axis: abs(ways[axis]))
    place = gone[longest] / ways[longest] if abs(ways[longest]) > 1e-9 else 0.0
    assert -1e-9 <= place <= 1 + 1e-9
    assert gone == pytest.approx([place * way for way in ways], abs=1e-8)


@unhurried
@given(joints, joints, st.floats(0.05, 0.95))
def test_after_a_stop_the_target_is_reached(start: Joints, target: Joints, share: float) -> None:
    course = a_course(start, target)
    *_, (_, rest) = sampled(course, until_s=share * duration_s(start, target, UR10))
    onward = require_limits(a_course(rest.positions, target), UR10)
    assert onward[-1] == Setpoint.at_rest(target)


def test_velocity_begins_to_fall_within_100_ms_and_the_stop_takes_half_a_second() -> None:
    course = a_course((0.0,) * 6, (6.0,) * 6)
    asked_s = 1.5
    followed = list(sampled(course, until_s=asked_s))
    speeds = {since_s: max(map(abs, setpoint.velocities)) for since_s, setpoint in followed}
    full = max(speed for since_s, speed in speeds.items() if since_s < asked_s)
    assert full == pytest.approx(2.09)
    falling_s = min(
        since_s for since_s, speed in speeds.items() if since_s >= asked_s and speed < full - 1e-6
    )
    assert falling_s - asked_s <= 0.1
    assert course.stopping
    assert followed[-1][0] - asked_s <= 0.5


def test_a_stop_from_the_fastest_joint_at_full_speed_takes_half_a_second() -> None:
    course = a_course((0.0,) * 6, (0.0, 0.0, 6.0, 0.0, 0.0, 0.0))
    followed = list(sampled(course, until_s=1.2))
    assert max(setpoint.velocities[2] for _, setpoint in followed) == pytest.approx(3.14)
    assert followed[-1][0] - 1.2 == pytest.approx(0.5, abs=0.01)


def test_a_stop_asked_for_before_the_motion_begins_moves_nothing() -> None:
    course = a_course((0.0,) * 6, (1.0,) * 6)
    assert course.at(10.0, pace=0.0) == Setpoint.at_rest((0.0,) * 6)
    assert course.is_over(10.0)
    assert course.stopping


def test_a_motion_to_where_the_joints_are_is_over_at_once() -> None:
    course = a_course((0.5,) * 6, (0.5,) * 6)
    assert course.is_over(10.0)
    assert course.remaining_s(10.0) == 0.0
    assert not course.stopping


def test_a_cycle_that_comes_late_is_where_an_early_one_would_have_been() -> None:
    often, seldom = a_course((0.0,) * 6, (2.0,) * 6), a_course((0.0,) * 6, (2.0,) * 6)
    for cycle in range(50):
        at_that_time = often.at(10.0 + cycle * CYCLE_S)
    assert seldom.at(10.0 + 49 * CYCLE_S) == at_that_time


def test_half_the_speed_takes_twice_the_time() -> None:
    there = (1.0, 0.5, 0.0, 0.0, 2.0, -1.0)
    full = duration_s((0.0,) * 6, there, UR10)
    assert duration_s((0.0,) * 6, there, UR10.slowed(0.5)) == pytest.approx(2 * full)


def test_a_target_that_is_not_a_number_is_a_fault() -> None:
    with pytest.raises(RobotFault, match="there is no motion"):
        duration_s((0.0,) * 6, (math.nan,) * 6, UR10)
