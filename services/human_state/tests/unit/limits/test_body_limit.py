"""The speed limit of a person falls at once, rises slowly and only for a calm body, and stops by itself."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_body.fusion.baseline import by_age
from handover_body.fusion.person_state import PersonState
from handover_body.limits.body_limit import (
    RADAR_TIMEOUT_S,
    BodyLimit,
    HeartRate,
    RefusedReset,
)
from handover_body.limits.curve import LimitCurve, of_baseline
from handover_body.limits.strain import Strain
from handover_body.model.features import Feature, FeatureName
from handover_body.model.signals import SensorFault, SensorReport

CURVE = LimitCurve()
STEP_S = 0.05


def steady(limit: BodyLimit, bpm: float, seconds: float, *, has_fault: bool = False) -> BodyLimit:
    """Feed one heart rate a second, and step 20 times a second."""
    start_s = limit.at_s
    for index in range(1, round(seconds / STEP_S) + 1):
        now_s = start_s + index * STEP_S
        at_s = start_s + (index // 20)
        limit = limit.step(HeartRate(bpm, at_s), now_s, has_fault=has_fault)
    return limit


def silent(limit: BodyLimit, seconds: float) -> BodyLimit:
    start_s = limit.at_s
    for index in range(1, round(seconds / STEP_S) + 1):
        limit = limit.step(None, start_s + index * STEP_S)
    return limit


def at_full_speed() -> BodyLimit:
    return steady(BodyLimit(CURVE, 0.0, 0.0), 70, 40)


def test_it_begins_at_a_quarter_and_rises_to_full_speed() -> None:
    limit = BodyLimit(CURVE, 0.0, 0.0)
    assert limit.fraction == 0.25
    assert steady(limit, 70, 9.9).fraction == 0.25
    assert steady(limit, 70, 12.0).fraction == pytest.approx(0.25 + 0.05 * 2, abs=0.01)
    assert at_full_speed().fraction == 1.0


def test_a_higher_heart_rate_lowers_it_at_once() -> None:
    limit = at_full_speed()
    lower = limit.step(HeartRate(121, limit.at_s + STEP_S), limit.at_s + STEP_S)
    assert lower.fraction == pytest.approx(CURVE.fraction(121))
    assert lower.fraction == pytest.approx(1 - 31 / 35 * 0.8)


def test_it_rises_only_when_five_bpm_more_would_allow_more_for_ten_seconds() -> None:
    strained = steady(at_full_speed(), 110, 1)
    assert strained.fraction == pytest.approx(CURVE.fraction(110))
    assert steady(strained, 106, 60).fraction == strained.fraction, "111 bpm would allow less"
    calmer = steady(strained, 100, 10)
    assert calmer.fraction == strained.fraction
    assert steady(calmer, 100, 2).fraction == pytest.approx(strained.fraction + 0.1, abs=0.011)
    assert steady(calmer, 100, 60).fraction == pytest.approx(CURVE.fraction(105))


def test_one_high_value_restarts_the_ten_seconds() -> None:
    strained = steady(at_full_speed(), 110, 1)
    waiting = steady(strained, 100, 9)
    interrupted = steady(steady(waiting, 108, 1), 100, 9)
    assert interrupted.fraction == strained.fraction


def test_a_silent_sensor_lets_it_fall_to_a_quarter_and_to_zero_at_ten_seconds() -> None:
    limit = at_full_speed()
    last_s = limit.newest.at_s if limit.newest else 0
    assert silent(limit, 3.0 - (limit.at_s - last_s)).fraction == 1.0
    assert silent(limit, 6.5 - (limit.at_s - last_s)).fraction == pytest.approx(0.25, abs=0.02)
    assert 0 < silent(limit, 9.9 - (limit.at_s - last_s)).fraction <= 0.25
    stopped = silent(limit, 10.05 - (limit.at_s - last_s))
    assert (stopped.fraction, stopped.is_stopped) == (0.0, True)


def test_a_radar_has_twenty_seconds() -> None:
    limit = at_full_speed()
    limit = limit.step(HeartRate(70, limit.at_s, 3.0, RADAR_TIMEOUT_S), limit.at_s)
    assert silent(limit, 9.0).fraction == 1.0
    assert silent(limit, 19.9).fraction == pytest.approx(0.25)
    assert silent(limit, 20.1).is_stopped


def test_a_sensor_that_says_a_long_period_stops_at_ten_seconds_all_the_same() -> None:
    limit = at_full_speed()
    limit = limit.step(HeartRate(70, limit.at_s, 1e6), limit.at_s)
    assert silent(limit, 8.3).fraction == pytest.approx(0.25)
    assert silent(limit, 10.1).is_stopped


def test_without_a_first_heart_rate_nothing_moves_and_no_reset_is_needed_for_it() -> None:
    limit = silent(BodyLimit(CURVE, 0.0, 0.0), 10.1)
    assert (limit.fraction, limit.is_stopped) == (0.0, False)
    assert limit.reason(10.1) == "no heart rate yet"
    assert steady(limit, 70, 9.9).fraction == 0.0
    assert steady(limit, 70, 12).fraction == pytest.approx(0.1, abs=0.011)


def test_a_stop_needs_a_reset_while_the_heart_rate_is_fresh() -> None:
    stopped = silent(at_full_speed(), 11)
    with pytest.raises(RefusedReset, match="put the sensor on"):
        stopped.reset(stopped.at_s)
    back = steady(stopped, 70, 30)
    assert back.fraction == 0.0
    released = back.reset(back.at_s)
    assert released.fraction == pytest.approx(0.05)
    assert steady(released, 70, 12).fraction == pytest.approx(0.15, abs=0.011)


def test_a_curve_to_zero_stops_and_the_reset_waits_for_rest() -> None:
    limit = steady(BodyLimit(LimitCurve(least=0.0), 0.0, 0.0), 130, 1)
    assert limit.is_stopped
    with pytest.raises(RefusedReset, match="rest, then reset"):
        limit.reset(limit.at_s)


def test_a_fault_of_another_sensor_keeps_it_from_rising() -> None:
    strained = steady(at_full_speed(), 120, 1)
    assert steady(strained, 70, 60, has_fault=True).fraction == strained.fraction


def test_the_curve_of_a_baseline_spans_light_to_vigorous_exertion() -> None:
    curve = of_baseline(by_age(40))
    assert (curve.free_bpm, curve.strained_bpm) == (pytest.approx(103), pytest.approx(136))


@pytest.mark.parametrize("curve", [(90, 92, 0.2), (20, 125, 0.2), (90, 300, 0.2), (90, 125, 1.0)])
def test_a_curve_that_makes_no_sense_is_refused(curve: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match=r"bpm|fraction"):
        LimitCurve(*curve)


def test_strain_lasts_after_minutes_and_ends_with_recovery() -> None:
    strain, at_s = Strain(threshold=0.45), 0.0
    for _ in range(200):
        strain, at_s = strain.take(0.6, at_s), at_s + 1
    assert not strain.is_lasting
    for _ in range(400):
        strain, at_s = strain.take(0.6, at_s), at_s + 1
    assert strain.is_lasting
    for _ in range(100):
        strain, at_s = strain.take(0.3, at_s), at_s + 1
    assert strain.is_lasting, "a short pause is no recovery"
    for _ in range(400):
        strain, at_s = strain.take(0.1, at_s), at_s + 1
    assert not strain.is_lasting


BPM = st.one_of(st.floats(60, 140), st.sampled_from([70.0, 85.0, 125.0, 220.0]))
EVENTS = st.lists(
    st.tuples(
        st.sampled_from(["beat", "beat", "beat", "fault", "silence", "reset"]),
        BPM,
        st.sampled_from([0.0, 0.05, 0.2, 1.0, 1.0, 2.0, 4.0, 30.0]),
        st.sampled_from([1.0, 3.0, float("nan"), 1e9]),
        st.integers(1, 40),
    ),
    max_size=30,
)


@given(EVENTS, st.sampled_from([0.0, 0.2, 0.5]))
@settings(max_examples=300)
def test_any_sequence_keeps_the_invariants(
    events: list[tuple[str, float, float, float, int]], least: float
) -> None:
    limit = BodyLimit(LimitCurve(least=least), 0.0, 0.0)
    for kind, bpm, pause_s, period_s, times in events:
        for _ in range(times):
            before, now_s = limit, limit.at_s + pause_s
            if kind == "reset":
                try:
                    limit = limit.reset(now_s)
                except RefusedReset:
                    assert before.is_stopped
                assert limit.is_stopped or not before.is_stopped or limit.fraction <= 0.05
                continue
            beat = HeartRate(bpm, now_s, period_s) if kind == "beat" else None
            limit = limit.step(beat, now_s, has_fault=kind == "fault")
            assert 0.0 <= limit.fraction <= 1.0
            assert limit.fraction <= before.fraction + 0.05 * min(pause_s, 1.0) + 1e-9
            assert not before.is_stopped or limit.is_stopped, "only a person ends a stop"
            assert limit.fraction == 0.0 or not limit.is_stopped
            assert limit.fraction > 0.0 or limit.is_stopped or before.newest is None or before.fraction == 0.0
            if kind != "beat":
                assert limit.fraction <= before.fraction, "it never rises on a fault or in a pause"
            elif limit.fraction > before.fraction:
                assert limit.fraction <= limit.curve.fraction(bpm + 5)
            else:
                assert limit.fraction <= max(limit.curve.fraction(bpm), 0.0) or limit.is_stopped
            if limit.newest is not None and now_s - limit.newest.at_s >= limit.newest.timeout_s:
                assert limit.fraction == 0.0


SENSED = st.lists(
    st.tuples(
        st.sampled_from(["calm", "calm", "strained", "wild", "poor", "off", "nothing"]),
        st.sampled_from(["strap", "wrist"]),
        st.integers(1, 25),
    ),
    max_size=20,
)


@given(SENSED)
def test_no_fault_of_a_sensor_raises_the_limit_of_the_person(sensed: list[tuple[str, str, int]]) -> None:
    state, limit, now_s = PersonState(), BodyLimit(CURVE, 0.0, 0.0), 0.0
    for kind, source, times in sensed:
        for turn in range(times):
            now_s += 1.0
            bpm = {"calm": 70.0, "strained": 115.0, "wild": 40.0 + 150 * (turn % 2), "poor": 60.0}.get(kind)
            if bpm is not None:
                quality = 0.2 if kind == "poor" else 0.9
                state.take(Feature(FeatureName.HEART_RATE, source, bpm, now_s, quality), now_s)
            elif kind == "off":
                state.report(SensorReport(source, now_s, fault=SensorFault.NO_CONTACT))
            before = limit
            value = state.for_limits(FeatureName.HEART_RATE, now_s)
            beat = None if value is None else HeartRate(float(value.value), value.at_s)
            has_fault = state.has_fault(FeatureName.HEART_RATE, now_s)
            limit = limit.step(beat, now_s, has_fault=has_fault)
            if kind in {"wild", "poor", "off", "nothing"} and has_fault:
                assert limit.fraction <= before.fraction
            if beat is not None:
                assert limit.fraction <= CURVE.fraction(beat.bpm)


def test_the_machine_is_a_value() -> None:
    limit = at_full_speed()
    assert limit.step(None, limit.at_s) == replace(limit, exceeds_since_s=None)
