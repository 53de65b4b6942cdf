from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.robots.jerk_reference import optimal_duration_s
from handover_robots.model.joint_trajectory import JointTrajectory
from handover_robots.model.trajectory import Limits, duration_s
from handover_robots.planning import retiming, timing
from handover_robots.robots import ROBOTS

UR10 = ROBOTS.load("ur10")
UR5E = ROBOTS.load("ur5e")
PANDA = ROBOTS.load("panda")
EVERY_S = 0.001
ROUNDING = 1e-6


def assert_within(trajectory: JointTrajectory, limits: Limits) -> None:
    """Check every millisecond, and the bounds that hold between."""
    times = np.arange(0.0, trajectory.duration_s, EVERY_S)
    for order, limit in enumerate((limits.velocity, limits.acceleration, limits.jerk), 1):
        peaks = np.abs(trajectory.derivative(times, order)).max(axis=0)
        assert (peaks <= np.array(limit) * (1 + ROUNDING)).all(), order
    assert not list(trajectory.violations(limits))


def assert_at_rest_at_ends(trajectory: JointTrajectory) -> None:
    ends = np.array([0.0, trajectory.duration_s])
    for order in (1, 2):
        assert trajectory.derivative(ends, order) == pytest.approx(0.0, abs=1e-6)


paths = st.integers(2, 6).flatmap(
    lambda count: st.lists(
        st.lists(st.floats(-2.0, 2.0), min_size=7, max_size=7), min_size=count, max_size=count
    )
)


def distinct(path: list[list[float]], joints: int) -> list[Any]:
    waypoints = [np.array(path[0][:joints])]
    for point in path[1:]:
        if np.abs(np.array(point[:joints]) - waypoints[-1]).max() > 1e-3:
            waypoints.append(np.array(point[:joints]))
    return waypoints


@settings(deadline=None, max_examples=60)
@given(paths, st.sampled_from([UR10, PANDA]))
def test_no_limit_is_exceeded_at_any_millisecond(path: list[list[float]], robot: Any) -> None:
    points = distinct(path, len(robot.joints))
    if len(points) < 2:
        return
    limits = robot.limits
    if len(points) == 2:
        trajectory = timing.line(points[0], points[1], limits)
    else:
        trajectory = timing.along(timing.BlendedLines(points, limits), limits)
    assert_within(trajectory, limits)
    assert_at_rest_at_ends(trajectory)
    assert trajectory.start == pytest.approx(points[0])
    assert trajectory.target == pytest.approx(points[-1])


@settings(deadline=None, max_examples=30)
@given(paths, st.sampled_from([UR10, PANDA]))
def test_a_faster_timing_keeps_path_and_limits(path: list[list[float]], robot: Any) -> None:
    points = distinct(path, len(robot.joints))
    if len(points) < 3:
        return
    planned = timing.along(timing.BlendedLines(points, robot.limits), robot.limits)
    trajectory = retiming.faster(planned, robot.limits)
    assert trajectory.duration_s <= planned.duration_s
    assert_within(trajectory, robot.limits)
    assert_at_rest_at_ends(trajectory)
    assert (trajectory.start, trajectory.target) == (planned.start, planned.target)
    dense = planned.positions(EVERY_S)
    for place in trajectory.positions(20 * EVERY_S):
        assert np.abs(dense - place).max(axis=1).min() < 0.004


@pytest.mark.parametrize("robot", [UR10, UR5E])
def test_a_faster_timing_of_a_curve_is_near_the_optimum_where_the_jerk_is_limited(robot: Any) -> None:
    points = [np.zeros(6), np.array([0.8, -0.5, 0.4, 0, 0, 0]), np.array([0.2, 0.3, 0.9, 0.5, 0, 0])]
    planned = timing.along(timing.BlendedLines(points, robot.limits), robot.limits)
    assert retiming.faster(planned, robot.limits).duration_s < 1.03 * optimal_duration_s(
        planned, robot.limits
    )


@settings(deadline=None, max_examples=30)
@given(paths)
def test_a_motion_with_stops_passes_every_point(path: list[list[float]]) -> None:
    points = distinct(path, 6)
    if len(points) < 2:
        return
    trajectory = timing.with_stops(points, UR10.limits)
    assert_within(trajectory, UR10.limits)
    dense = trajectory.positions(EVERY_S)
    for point in points:
        assert np.abs(dense - point).max(axis=1).min() < 2e-3


def test_a_line_takes_as_long_as_the_time_optimal_profile() -> None:
    random = np.random.default_rng(4)
    for start, end in random.uniform(-1.5, 1.5, (50, 2, 6)):
        optimal_s = duration_s(tuple(start), tuple(end), UR10.limits)
        trajectory = timing.line(start, end, UR10.limits)
        assert trajectory.duration_s == pytest.approx(optimal_s, rel=0.02)


def test_a_line_stays_a_line() -> None:
    start, end = np.zeros(6), np.array([1.0, -0.5, 0.25, 2.0, 0.0, -1.0])
    dense = timing.line(start, end, UR10.limits).positions(EVERY_S)
    shares = dense[:, 3] / 2.0
    assert dense == pytest.approx(start + shares[:, None] * (end - start), abs=1e-12)


def test_a_rounded_path_is_nearly_as_fast_as_without_a_limit_of_jerk() -> None:
    random = np.random.default_rng(5)
    ratios = []
    for _ in range(15):
        path = list(np.array(PANDA.home) + random.uniform(-0.8, 0.8, (4, 7)))
        curve = timing.BlendedLines(path, PANDA.limits)
        positions, spacing_s = timing.fastest(curve, PANDA.limits)
        ratios.append(timing.along(curve, PANDA.limits).duration_s / ((len(positions) - 1) * spacing_s))
    assert max(ratios) < 1.03


def test_a_rounded_path_is_faster_than_one_with_stops() -> None:
    path = [np.zeros(6), np.full(6, 0.5), np.array([1.0, 0.5, 0.0, 0.5, 1.0, 0.5])]
    rounded = timing.along(timing.BlendedLines(path, UR10.limits), UR10.limits)
    assert rounded.duration_s < timing.with_stops(path, UR10.limits).duration_s


def test_a_slowed_trajectory_follows_the_same_path() -> None:
    trajectory = timing.line(np.zeros(6), np.ones(6), UR10.limits)
    slow = trajectory.slowed(0.5)
    assert slow.duration_s == pytest.approx(2 * trajectory.duration_s)
    assert slow.at(slow.duration_s / 3).positions == pytest.approx(
        trajectory.at(trajectory.duration_s / 3).positions
    )


def test_positions_and_derivatives_belong_together() -> None:
    path = [np.zeros(6), np.full(6, 0.5), np.array([1.0, 0.5, 0.0, 0.5, 1.0, 0.5])]
    trajectory = timing.along(timing.BlendedLines(path, UR10.limits), UR10.limits)
    times = np.linspace(0.1, trajectory.duration_s - 0.1, 50)
    step = 1e-5
    for order in (0, 1, 2):
        slope = (trajectory.derivative(times + step, order) - trajectory.derivative(times - step, order)) / (
            2 * step
        )
        assert slope == pytest.approx(
            trajectory.derivative(times, order + 1), abs=0.5 if order == 2 else 1e-3
        )
    for time_s in times[:5].tolist():
        setpoint = trajectory.at(time_s)
        assert setpoint.positions == pytest.approx(trajectory.derivative(np.array([time_s]), 0)[0])
        assert setpoint.velocities == pytest.approx(trajectory.derivative(np.array([time_s]), 1)[0])
        assert setpoint.accelerations == pytest.approx(trajectory.derivative(np.array([time_s]), 2)[0])
