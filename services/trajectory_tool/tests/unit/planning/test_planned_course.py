"""Stops on a planned trajectory: within the limits of the robot, and on the path."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_robots.model.joint_trajectory import JointTrajectory
from handover_robots.model.planned_course import PlannedCourse
from handover_robots.model.trajectory import Limits
from handover_robots.planning import timing
from handover_robots.robots import ROBOTS

EVERY_S = 0.001
ROUNDING = 1 + 1e-4
BEGAN_S = 100.0


def trajectories(limits: Limits, home: Any, count: int, seed: int) -> list[JointTrajectory]:
    random = np.random.default_rng(seed)
    setpoints = []
    for number in range(count):
        path = list(np.array(home) + random.uniform(-0.8, 0.8, (2 + number % 3, len(home))))
        if len(path) == 2:
            setpoints.append(timing.line(path[0], path[1], limits))
        else:
            setpoints.append(timing.along(timing.BlendedLines(path, limits), limits))
    return setpoints


def until_rest(course: PlannedCourse, stop_at_s: float) -> Any:
    """Return the setpoints of every millisecond until the end of the motion."""
    now_s, setpoints = BEGAN_S, []
    while True:
        setpoints.append(course.at(now_s, pace=1.0 if now_s < stop_at_s else 0.0))
        if course.is_over(now_s):
            return setpoints
        now_s += EVERY_S


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["ur10", "panda"])
@pytest.mark.parametrize("speed", [0.3, 0.6, 1.0])
def test_a_stop_stays_on_the_path_and_within_the_limits(name: str, speed: float) -> None:
    model = ROBOTS.load(name)
    limits = model.limits
    random = np.random.default_rng(8)
    stops = []
    for planned in trajectories(limits, model.home, 25, seed=9):
        trajectory = planned.slowed(speed)
        at_s = BEGAN_S + float(random.uniform(0.05, 0.9)) * trajectory.duration_s
        course = PlannedCourse(trajectory, limits, BEGAN_S)
        setpoints = until_rest(course, at_s)
        velocities = np.array([setpoint.velocities for setpoint in setpoints])
        accelerations = np.array([setpoint.accelerations for setpoint in setpoints])
        positions = np.array([setpoint.positions for setpoint in setpoints])
        assert (np.abs(velocities) <= np.array(limits.velocity) * ROUNDING).all()
        assert (np.abs(accelerations) <= np.array(limits.acceleration) * ROUNDING).all()
        jerks = np.abs(np.diff(accelerations, axis=0)) / EVERY_S
        assert (jerks <= np.array(limits.jerk) * ROUNDING).all()
        assert (np.abs(np.diff(positions, axis=0)) <= np.array(limits.velocity) * EVERY_S * 1.01).all()
        path = trajectory.positions(EVERY_S)
        for position in positions[:: max(len(positions) // 20, 1)]:
            assert np.abs(path - position).max(axis=1).min() < 0.005
        assert setpoints[-1].velocities == (0.0,) * len(model.joints)
        stops.append(BEGAN_S + len(setpoints) * EVERY_S - at_s)
    if speed < 1:
        assert max(stops) < 1.0


def test_a_stop_that_begins_while_the_jerk_changes_stays_within_the_limits() -> None:
    limits = ROBOTS.load("ur10").limits
    start = np.array([-0.178408, -1.207266, -0.017528, 1.747876, 1.287049, 1.005441])
    target = np.array([1.769964, 1.686677, 0.212152, 0.766903, -0.589285, 0.153305])
    trajectory = timing.line(start, target, limits)
    for stop_s in np.arange(0.2, 0.3, 0.005):
        setpoints = until_rest(PlannedCourse(trajectory, limits, BEGAN_S), BEGAN_S + float(stop_s))
        accelerations = np.array([setpoint.accelerations for setpoint in setpoints])
        jerks = np.abs(np.diff(accelerations, axis=0)) / EVERY_S
        assert (jerks <= np.array(limits.jerk) * ROUNDING).all()


@dataclass(frozen=True)
class Change:
    """A lower pace for a while, then a stop; times as fractions of what is left of the motion."""

    pace: float
    after: float
    lasts_s: float
    stopped_after: float


changes = st.builds(
    Change, st.floats(0.05, 1.0), st.floats(0.0, 0.9), st.floats(0.0, 0.5), st.floats(0.0, 1.0)
)


@given(st.sampled_from(["ur10", "panda"]), st.integers(0, 10_000), st.floats(0.2, 1.0), changes)
def test_changes_of_pace_and_a_stop_keep_every_limit_at_every_millisecond(
    name: str, seed: int, speed: float, change: Change
) -> None:
    model = ROBOTS.load(name)
    trajectory = trajectories(model.limits, model.home, 2, seed)[seed % 2].slowed(speed)
    slow_s = change.after * trajectory.duration_s
    stop_s = slow_s + change.stopped_after * (trajectory.duration_s - slow_s)
    course, now_s, setpoints = PlannedCourse(trajectory, model.limits, 0.0), 0.0, []
    while not course.is_over(now_s):
        pace = change.pace if slow_s <= now_s < slow_s + change.lasts_s else 1.0
        setpoints.append(course.at(now_s, pace=0.0 if now_s >= stop_s else pace))
        now_s += EVERY_S
    positions, velocities, accelerations = (
        np.array([setpoint.derivatives[order] for setpoint in setpoints]) for order in range(3)
    )
    for values, limit in (
        (velocities, model.limits.velocity),
        (np.diff(positions, axis=0) / EVERY_S, model.limits.velocity),
        (accelerations, model.limits.acceleration),
        (np.diff(accelerations, axis=0) / EVERY_S, model.limits.jerk),
    ):
        assert (np.abs(values) <= np.array(limit) * ROUNDING).all()


def test_a_change_of_pace_at_the_start_never_looks_before_it() -> None:
    model = ROBOTS.load("ur10")
    (trajectory,) = trajectories(model.limits, model.home, 1, seed=10)
    for again_s in np.arange(0.002, 0.06, 0.002).tolist():
        course = PlannedCourse(trajectory.slowed(0.5), model.limits, 0.0)
        course.at(0.002)
        course.at(0.004, pace=0.2)
        course.at(0.004 + again_s, pace=1.0)
        course.at(0.006 + again_s, pace=0.0)
        assert course.stopping


def test_a_motion_without_a_stop_ends_at_its_target() -> None:
    model = ROBOTS.load("ur10")
    (trajectory,) = trajectories(model.limits, model.home, 1, seed=10)
    setpoints = until_rest(PlannedCourse(trajectory, model.limits, BEGAN_S), stop_at_s=np.inf)
    assert setpoints[-1].positions == pytest.approx(trajectory.target, abs=1e-9)
    assert len(setpoints) * EVERY_S == pytest.approx(trajectory.duration_s, abs=0.003)
