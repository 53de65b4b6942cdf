"""The belt follows the walker, keeps its limits in every case, and stops when it does not see them."""

import math
import random
from collections.abc import Iterator
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_cases.machines.treadmill.belt import (
    LOST_S,
    MAX_PAUSE_S,
    Belt,
    BeltSettings,
    BeltState,
    StopReason,
)
from handover_cases.machines.treadmill.simulation import Habits, SimulatedWalker

STEP_S = 0.05
SETTINGS = BeltSettings()
FREE = 1.3


@dataclass
class Scene:
    """A belt and a walker; `run` lets time pass and returns the belt."""

    belt: Belt
    walker: SimulatedWalker

    def run(self, seconds: float, allowed_mps: float = FREE) -> Belt:
        for _ in range(round(seconds / STEP_S)):
            self.walker.step(STEP_S, self.belt.speed_mps)
            reading = self.walker.reading(SETTINGS.sensor_to_middle_m)
            self.belt = self.belt.step(reading, allowed_mps, self.belt.at_s + STEP_S)
        return self.belt


def scene(pace_mps: float = 0.9, seed: int = 1) -> Scene:
    return Scene(Belt(SETTINGS, 0.0).start(0.0), SimulatedWalker(seed, Habits(pace_mps)))


def test_the_belt_runs_as_fast_as_the_walker_and_keeps_them_in_the_middle() -> None:
    made = scene(0.9)
    belt = made.run(40)
    assert belt.state is BeltState.FOLLOWING
    assert belt.speed_mps == pytest.approx(made.walker.walk_mps, abs=0.1)
    assert abs(made.walker.place_m) < 0.15
    assert belt.distance_m == pytest.approx(0.9 * 40, rel=0.15)


@pytest.mark.parametrize("seed", range(4))
def test_a_walker_who_changes_the_pace_stays_between_the_ends(seed: int) -> None:
    made = scene(0.5, seed)
    for pace_mps in (1.2, 0.4, 1.1, 0.6):
        made.walker.pace_mps = pace_mps
        assert made.run(20).state is BeltState.FOLLOWING
        assert abs(made.walker.place_m) < 0.3


def test_a_limit_slows_the_belt_within_its_deceleration_and_never_raises_it() -> None:
    made = scene(1.1)
    fast = made.run(30)
    made.walker.pace_mps = 0.4
    slow = made.run(5, allowed_mps=0.4)
    assert fast.speed_mps > 0.9
    assert slow.speed_mps <= 0.4 + 1e-9
    assert slow.state is BeltState.FOLLOWING
    assert made.run(20, allowed_mps=50.0).speed_mps < 0.7, "a higher limit makes nobody faster"


def test_a_limit_of_nothing_stops_the_belt_until_a_person_starts_it() -> None:
    made = scene(1.0)
    made.run(20)
    stopped = made.run(3, allowed_mps=0.0)
    assert (stopped.state, stopped.reason, stopped.speed_mps) == (BeltState.STOPPED, StopReason.LIMIT, 0.0)
    assert made.run(5).speed_mps == 0.0
    made.belt = made.belt.start(made.belt.at_s)
    assert made.belt.state is BeltState.FOLLOWING


def test_a_walker_who_is_not_seen_any_more_stops_the_belt_by_the_ramp() -> None:
    made = scene(1.2)
    fast = made.run(30).speed_mps
    made.walker.is_on_belt = False
    held = made.run(LOST_S - 0.1)
    assert held.state is BeltState.FOLLOWING
    assert held.speed_mps <= fast + 1e-9
    lost = made.run(0.3)
    assert (lost.state, lost.reason) == (BeltState.STOPPING, StopReason.LOST)
    assert made.run(fast / SETTINGS.stop_deceleration + 0.1).state is BeltState.STOPPED


@pytest.mark.parametrize(("place_m", "reason"), [(0.6, StopReason.FRONT_END), (-0.7, StopReason.REAR_END)])
def test_a_walker_too_near_an_end_stops_the_belt(place_m: float, reason: StopReason) -> None:
    made = scene(1.0)
    belt = made.run(20)
    for share in (0.2, 0.4, 0.6, 0.8, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0):
        belt = belt.step(SETTINGS.sensor_to_middle_m - share * place_m, FREE, belt.at_s + STEP_S)
    assert (belt.state, belt.reason) == (BeltState.STOPPING, reason)


def busy_steps(seed: int, seconds: float) -> Iterator[float]:
    """Yield the times between the cycles of a busy machine: many are late, the next one follows at once."""
    chance, passed_s = random.Random(seed), 0.0
    while passed_s < seconds:
        late_s = chance.uniform(STEP_S, 0.9 * MAX_PAUSE_S) if chance.random() < 0.3 else 0.0
        for step_s in (late_s, 0.0005) if late_s else (STEP_S,):
            passed_s += step_s
            yield step_s


@pytest.mark.parametrize("seed", range(8))
def test_cycles_that_are_late_and_then_follow_at_once_stop_no_belt(seed: int) -> None:
    made = scene(0.9, seed)
    for step_s in busy_steps(seed, 60):
        made.walker.step(min(step_s, 0.2), made.belt.speed_mps)  # the machine pauses, and so does its walker
        reading = made.walker.reading(SETTINGS.sensor_to_middle_m)
        made.belt = made.belt.step(reading, FREE, made.belt.at_s + step_s)
        assert made.belt.state is BeltState.FOLLOWING, (made.belt.reason, made.walker.place_m)
        assert made.belt.place_m == pytest.approx(made.walker.place_m, abs=0.1)


@pytest.mark.parametrize("seed", range(8))
def test_a_walker_who_falls_back_on_a_busy_machine_stops_the_belt(seed: int) -> None:
    made = scene(1.2, seed)
    belt, place_m = made.run(30), made.walker.place_m
    for step_s in busy_steps(seed, 10):
        place_m -= belt.speed_mps * min(step_s, 0.2)  # who has stopped walking is carried back
        belt = belt.step(SETTINGS.sensor_to_middle_m - place_m, FREE, belt.at_s + step_s)
        if belt.state is not BeltState.FOLLOWING:
            break
    assert belt.reason is StopReason.REAR_END
    assert place_m < 0.5 * SETTINGS.rear_end_m


def test_a_pause_without_control_stops_the_belt_though_the_walker_is_seen_after_it() -> None:
    made = scene(0.9)
    belt = made.run(20)
    seen_m = SETTINGS.sensor_to_middle_m - made.walker.place_m
    assert belt.step(seen_m, FREE, belt.at_s + 0.9 * MAX_PAUSE_S).state is BeltState.FOLLOWING
    assert belt.step(None, FREE, belt.at_s + 0.9 * MAX_PAUSE_S).reason is StopReason.LOST
    assert belt.step(seen_m, FREE, belt.at_s + 1.1 * MAX_PAUSE_S).reason is StopReason.LOST


def test_readings_that_cannot_be_the_walker_do_not_move_the_belt() -> None:
    made = scene(0.8)
    belt = made.run(20)
    before = belt
    for reading in (math.nan, math.inf, -1.0, 0.0, 40.0, None):
        belt = belt.step(reading, FREE, belt.at_s + STEP_S)
        assert belt.speed_mps <= before.speed_mps + 1e-9
    assert abs(belt.place_m) < 0.3


def test_a_person_stops_the_belt_and_the_first_reason_stays() -> None:
    made = scene(1.0)
    made.run(10)
    made.belt = made.belt.stop(StopReason.PERSON).stop(StopReason.TIME)
    assert made.run(3).reason is StopReason.PERSON
    moving = scene(1.0)
    moving.run(10)
    moving.belt = moving.belt.stop(StopReason.PERSON)
    assert moving.belt.start(moving.belt.at_s) is moving.belt, "a belt that moves is not started again"


def test_who_stands_on_a_started_belt_is_not_moved() -> None:
    belt = Belt(SETTINGS, 0.0).start(0.0)
    for number in range(200):
        belt = belt.step(SETTINGS.sensor_to_middle_m + 0.02 * math.sin(number), FREE, belt.at_s + STEP_S)
    assert belt.speed_mps == 0.0


readings = st.one_of(st.none(), st.floats(allow_nan=True, allow_infinity=True), st.floats(0.2, 2.0))
events = st.tuples(
    readings,
    st.one_of(st.floats(0, 1.3), st.floats(allow_nan=True, allow_infinity=True)),
    st.one_of(st.just(STEP_S), st.floats(0, 3)),
    st.sampled_from(["", "", "", "", "start", "stop"]),
)


@given(st.lists(events, min_size=1, max_size=80))
def test_nothing_moves_the_belt_beyond_its_limits(
    course: list[tuple[float | None, float, float, str]],
) -> None:
    belt = Belt(SETTINGS, 0.0).start(0.0)
    for reading, allowed_mps, seconds, act in course:
        if act == "start":
            belt = belt.start(belt.at_s)
        elif act == "stop":
            belt = belt.stop(StopReason.PERSON)
        before = belt
        belt = belt.step(reading, allowed_mps, belt.at_s + seconds)
        step_s = min(seconds, 0.2)
        assert 0 <= belt.speed_mps <= SETTINGS.max_speed_mps
        assert belt.speed_mps <= before.speed_mps + SETTINGS.acceleration * step_s + 1e-9
        assert belt.speed_mps >= before.speed_mps - SETTINGS.stop_deceleration * step_s - 1e-9
        if belt.state is not BeltState.FOLLOWING or reading is None or not math.isfinite(reading):
            assert belt.speed_mps <= before.speed_mps + 1e-9
        if belt.speed_mps > before.speed_mps:
            assert belt.speed_mps <= allowed_mps
        assert math.isfinite(belt.place_m)
        if before.state in {BeltState.STOPPING, BeltState.STOPPED} and act != "start":
            assert belt.state in {BeltState.STOPPING, BeltState.STOPPED}


def test_a_belt_that_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match=r"at most 1\.3"):
        BeltSettings(max_speed_mps=2.0)
    with pytest.raises(ValueError, match="middle must lie between"):
        BeltSettings(front_end_m=1.2)
    with pytest.raises(ValueError, match="must rise in this order"):
        BeltSettings(acceleration=3.0)
