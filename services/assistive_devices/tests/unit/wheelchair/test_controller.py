"""The controller of the wheelchair: equations 1 and 2, and what no command or fault may do."""

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_body.limits.curve import LimitCurve
from handover_cases.machines.wheelchair.case import vmax_of
from handover_cases.machines.wheelchair.controller import Centre, Wheelchair, WheelchairParameters
from handover_cases.model.smoothing import Smoothed

DT_S = 0.05
GIVEN = WheelchairParameters()
UPRIGHT = Centre(3.0, -20.0)


def lean(right: float, forwards: float) -> Centre:
    """Return the centre of pressure of a lean, 1 being as far as counts."""

    def shift(share: float) -> float:
        reach = GIVEN.dead_zone_mm + abs(share) * (GIVEN.full_lean_mm - GIVEN.dead_zone_mm)
        return math.copysign(reach, share) if share else 0.0

    return Centre(UPRIGHT.x_mm + shift(right), UPRIGHT.y_mm + shift(forwards))


def run(chair: Wheelchair, centre: Centre | None, fraction: float, seconds: float) -> Wheelchair:
    for _ in range(round(seconds / DT_S)):
        chair = chair.step(centre, fraction, DT_S)
    return chair


@pytest.fixture
def ready() -> Wheelchair:
    """A chair whose person sat upright, with the limit of a calm body."""
    chair = run(Wheelchair().start(), UPRIGHT, 1.0, 3.0)
    assert chair.is_calibrated
    assert chair.linear == chair.angular == 0.0
    return chair


@pytest.mark.parametrize("bpm", [60, 90, 97.5, 107.5, 120, 125, 160])
def test_the_limit_of_human_state_with_the_curve_of_the_case_is_equation_2(bpm: float) -> None:
    curve = LimitCurve(90, 125, 0.0)
    assert curve.fraction(bpm) * GIVEN.max_speed_mps == pytest.approx(vmax_of(bpm, GIVEN.max_speed_mps))


def test_a_lean_within_the_dead_zone_moves_nothing(ready: Wheelchair) -> None:
    near = Centre(UPRIGHT.x_mm + 0.9 * GIVEN.dead_zone_mm, UPRIGHT.y_mm - 0.9 * GIVEN.dead_zone_mm)
    chair = run(ready, near, 1.0, 5.0)
    assert (chair.linear, chair.angular) == (0.0, 0.0)


def test_equation_1_scales_the_velocity_and_keeps_the_curve(ready: Wheelchair) -> None:
    free = run(ready, lean(-0.5, 1.0), 1.0, 6.0)
    assert free.linear == pytest.approx(GIVEN.max_speed_mps, rel=0.01)
    slow = run(free, lean(-0.5, 1.0), 0.5, 6.0)
    assert slow.linear == pytest.approx(0.5 * GIVEN.max_speed_mps, rel=0.01)
    assert slow.linear / slow.angular == pytest.approx(free.linear / free.angular, rel=0.02)


def test_on_the_spot_the_turn_has_a_limit_of_its_own(ready: Wheelchair) -> None:
    assert run(ready, lean(1.0, 0.0), 1.0, 6.0).angular == pytest.approx(-GIVEN.max_spot_turn_radps, rel=0.01)
    assert run(ready, lean(1.0, 0.0), 0.5, 6.0).angular == pytest.approx(
        -0.5 * GIVEN.max_spot_turn_radps, rel=0.01
    )


def test_a_limit_of_0_stops_translation_and_turn(ready: Wheelchair) -> None:
    chair = run(run(ready, lean(-0.5, 1.0), 1.0, 6.0), lean(-0.5, 1.0), 0.0, 8.0)
    assert abs(chair.linear) < 0.005
    assert abs(chair.angular) < 0.005


def test_without_a_centre_of_pressure_it_stops_within_the_deceleration(ready: Wheelchair) -> None:
    driving = run(ready, lean(0.0, 1.0), 1.0, 6.0)
    seconds = driving.linear / GIVEN.deceleration_mps2
    assert run(driving, None, 1.0, seconds + DT_S).linear == 0.0


def test_a_person_who_does_not_sit_still_is_not_calibrated() -> None:
    chair = Wheelchair().start()
    for step in range(200):
        chair = chair.step(lean(0.0, 1.0 if step % 20 < 10 else -1.0), 1.0, DT_S)
    assert not chair.is_calibrated
    assert chair.linear == 0.0


FRACTIONS = st.one_of(st.floats(0, 1), st.sampled_from([0.0, 1.0, math.nan, math.inf, -1.0, 7.0]))
CENTRES = st.one_of(st.none(), st.builds(lean, st.floats(-1.5, 1.5), st.floats(-1.5, 1.5)))
ACTS = st.lists(
    st.tuples(CENTRES, FRACTIONS, st.booleans(), st.integers(1, 40), st.sampled_from([0.0, 0.05, 0.3])),
    max_size=25,
)


@settings(max_examples=80)
@given(acts=ACTS)
def test_no_command_and_no_fault_raises_a_limit(
    acts: list[tuple[Centre | None, float, bool, int, float]],
) -> None:
    chair = run(Wheelchair().start(), UPRIGHT, 1.0, 3.0)
    for centre, fraction, may_rise, steps, dt_s in acts:
        limit = min(max(fraction, 0.0), 1.0) if math.isfinite(fraction) else 0.0
        for _ in range(steps):
            before, chair = chair, chair.step(centre, fraction, dt_s, may_rise=may_rise)
            allowed = GIVEN.max_speed_mps * limit
            assert abs(chair.linear) <= GIVEN.max_speed_mps + 1e-9
            assert abs(chair.angular) <= GIVEN.max_turn_radps + 1e-9
            assert abs(chair.linear) <= max(abs(before.linear), chair.vmax.value) + 1e-9
            assert chair.vmax.value <= max(before.vmax.value, allowed) + 1e-9
            if not may_rise:
                assert chair.vmax.value <= before.vmax.value + 1e-9
            if centre is None:
                assert abs(chair.linear) <= abs(before.linear)
            rise = GIVEN.acceleration_mps2 * min(dt_s, 0.2)
            assert abs(chair.linear) - abs(before.linear) <= rise + 1e-9


@settings(max_examples=40)
@given(speed=st.floats(0, 1.2), fraction=st.floats(0, 1), right=st.floats(-1, 1))
def test_a_limit_that_falls_is_followed_within_the_deceleration(
    speed: float, fraction: float, right: float
) -> None:
    calm = run(Wheelchair().start(), UPRIGHT, 1.0, 3.0)
    driving = replace(calm, linear=speed, vmax=Smoothed(1.2))
    chair = run(driving, lean(right, 1.0), fraction, 8.0)
    assert chair.linear <= fraction * GIVEN.max_speed_mps + 0.01
