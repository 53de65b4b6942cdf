"""Joint targets between irregular setpoints: exact in order, and limited after gaps and jumps."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_ur.tracking import CycleClock, TargetTracker

CYCLE_S = 0.002
SPEED, ACCELERATION = 2.0, 16.0


def sine(time_s: float) -> tuple[list[float], list[float], list[float]]:
    """Return a motion that stays within half of the limits."""
    return (
        [0.2 * math.sin(4 * time_s)],
        [0.8 * math.cos(4 * time_s)],
        [-3.2 * math.sin(4 * time_s)],
    )


def test_regular_setpoints_are_followed_exactly() -> None:
    tracker = TargetTracker([SPEED], [ACCELERATION])
    tracker.start([0.0])
    worst = 0.0
    for cycle in range(2000):
        time_s = cycle * CYCLE_S
        sent_s = math.floor(time_s / 0.008) * 0.008
        (target,) = tracker.step(sine(sent_s), time_s - sent_s, CYCLE_S)
        if time_s > 2.0:
            worst = max(worst, abs(target - sine(time_s)[0][0]))
    assert worst < 1e-5


@given(
    st.lists(
        st.tuples(st.floats(-3, 3), st.floats(-2, 2), st.floats(-8, 8), st.integers(0, 60)),
        min_size=1,
        max_size=30,
    )
)
def test_no_setpoint_causes_more_than_the_limits(
    setpoints: list[tuple[float, float, float, int]],
) -> None:
    tracker = TargetTracker([SPEED], [ACCELERATION])
    tracker.start([0.0])
    positions = [0.0]
    for position, velocity, acceleration, cycles in setpoints:
        for cycle in range(cycles):
            setpoint = ([position], [velocity], [acceleration])
            positions += tracker.step(setpoint, cycle * CYCLE_S, CYCLE_S)
    velocities = [(b - a) / CYCLE_S for a, b in itertools.pairwise(positions)]
    assert all(abs(velocity) <= SPEED * (1 + 1e-6) for velocity in velocities)
    changes = [abs(b - a) / CYCLE_S for a, b in itertools.pairwise([0.0, *velocities])]
    assert all(change <= ACCELERATION * (1 + 1e-6) for change in changes)


@pytest.mark.parametrize("goal", [0.001, 0.3, -1.0])
def test_a_setpoint_that_stays_is_reached(goal: float) -> None:
    tracker = TargetTracker([SPEED], [ACCELERATION])
    tracker.start([0.0])
    for _ in range(1500):
        tracker.step(([goal], [0.0], [0.0]), 1.0, CYCLE_S)
    assert tracker.positions[0] == pytest.approx(goal, abs=1e-6)
    assert tracker.velocities[0] == pytest.approx(0.0, abs=1e-3)


def test_setpoints_that_end_bring_the_joint_to_rest() -> None:
    tracker = TargetTracker([SPEED], [ACCELERATION])
    tracker.start([0.0])
    for cycle in range(500):
        time_s = cycle * CYCLE_S
        tracker.step(([time_s], [1.0], [0.0]), 0.0, CYCLE_S)
    for cycle in range(1000):
        tracker.step(([0.998], [1.0], [0.0]), cycle * CYCLE_S, CYCLE_S)
    assert tracker.velocities[0] == pytest.approx(0.0, abs=1e-3)
    assert 1.0 < tracker.positions[0] < 1.0 + 1.0**2 / ACCELERATION


def test_a_joint_does_not_move_backwards_after_a_gap() -> None:
    tracker = TargetTracker([SPEED], [ACCELERATION])
    tracker.start([0.0])
    positions = []
    for cycle in range(3000):
        time_s = cycle * CYCLE_S
        is_gap = 1.0 < time_s < 1.2
        late_s = 0.0 if time_s <= 1.0 else 0.2 if not is_gap else time_s - 1.0
        setpoint = ([0.5 * (time_s - late_s)], [0.5], [0.0])
        positions += tracker.step(setpoint, time_s - 1.0 if is_gap else 0.0, CYCLE_S)
    assert all(b >= a for a, b in itertools.pairwise(positions[500:]))
    assert positions[-1] == pytest.approx(0.5 * (2999 * CYCLE_S - 0.2), abs=1e-6)


def test_cycles_have_equal_length_although_packages_arrive_irregularly() -> None:
    clock = CycleClock()
    times = [clock.next_s(10 + n * CYCLE_S + (0.001 if n % 3 else -0.001), 1, CYCLE_S) for n in range(500)]
    steps = [b - a for a, b in itertools.pairwise(times[200:])]
    assert all(step == pytest.approx(CYCLE_S, rel=0.05) for step in steps)
    assert clock.next_s(20.0, 1, CYCLE_S) == 20.0
