"""Plausibility and fusion: what of several sensors counts as the state of a person."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_body.fusion.person_state import MAX_SOURCES, PersonState
from handover_body.fusion.plausibility import MIN_QUALITY, stale_after_s
from handover_body.model.features import Feature, FeatureName, Status
from handover_body.model.signals import LinkState, SensorFault, SensorReport

HEART = FeatureName.HEART_RATE


def beat(bpm: float | str, at_s: float, source: str = "strap", quality: float = 0.9) -> Feature:
    return Feature(HEART, source, bpm, at_s, quality, method="ecg")


def seen(*features: Feature) -> PersonState:
    state = PersonState()
    for feature in features:
        state.take(feature, feature.at_s)
    return state


def test_a_value_counts_from_the_second_on() -> None:
    state = seen(beat(70, 0))
    assert state.for_limits(HEART, 0) is None
    state.take(beat(71, 1), 1)
    value = state.for_limits(HEART, 1)
    assert value is not None
    assert (value.value, value.status) == (71, Status.VALID)


@pytest.mark.parametrize("bpm", [29, 221, math.nan, math.inf, "fast"])
def test_a_heart_rate_that_no_body_has_is_implausible(bpm: float | str) -> None:
    state = seen(beat(70, 0), beat(71, 1), beat(bpm, 2))
    assert state.for_limits(HEART, 2) is None
    shown = state.value(HEART, 2)
    assert shown is not None
    assert shown.status is Status.IMPLAUSIBLE


def test_an_outlier_does_not_count_and_neither_does_the_value_after_it() -> None:
    state = seen(beat(70, 0), beat(71, 1), beat(140, 2))
    assert state.for_limits(HEART, 2) is None
    state.take(beat(72, 3), 3)
    assert state.for_limits(HEART, 3) is None
    state.take(beat(72, 4), 4)
    assert state.for_limits(HEART, 4) is not None


def test_a_poor_value_does_not_count() -> None:
    state = seen(beat(70, 0), beat(70, 1), beat(70, 2, quality=MIN_QUALITY - 0.01))
    assert state.for_limits(HEART, 2) is None


def test_a_value_is_stale_after_three_seconds_and_three_periods() -> None:
    state = seen(beat(70, 0), beat(70, 1))
    assert state.for_limits(HEART, 4.0) is not None
    assert state.for_limits(HEART, 4.01) is None
    slow = seen(*(replace(beat(70, at), period_s=3.0) for at in (0, 3)))
    assert slow.for_limits(HEART, 12.0) is not None
    assert slow.for_limits(HEART, 12.01) is None


@pytest.mark.parametrize("period_s", [math.inf, math.nan, -1.0, 1e9])
def test_no_period_keeps_a_value_for_long(period_s: float) -> None:
    assert 3.0 <= stale_after_s(period_s) <= 180.0


def test_sensors_that_agree_are_averaged_by_quality() -> None:
    state = seen(
        *(beat(70, at, "strap", 0.9) for at in (0, 1)), *(beat(80, at, "wrist", 0.6) for at in (0, 1))
    )
    value = state.value(HEART, 1)
    assert value is not None
    assert value.value == pytest.approx(74.0)
    assert not value.disagree


def test_of_two_sensors_that_disagree_by_40_bpm_the_higher_rate_holds() -> None:
    state = seen(
        *(beat(80, at, "strap", 1.0) for at in (0, 1)), *(beat(120, at, "wrist", 0.5) for at in (0, 1))
    )
    value = state.for_limits(HEART, 1)
    assert value is not None
    assert (value.value, value.disagree) == (120, True)


def test_an_uncalibrated_value_is_shown_and_feeds_no_limit() -> None:
    state = seen(
        *(Feature(FeatureName.SPO2, "clip", 88.0, at, 0.9, is_calibrated=False) for at in (0.0, 1.0))
    )
    assert state.for_limits(FeatureName.SPO2, 1) is None
    shown = state.value(FeatureName.SPO2, 1)
    assert shown is not None
    assert not shown.is_calibrated


@pytest.mark.parametrize(
    "report",
    [
        SensorReport("strap", 2, fault=SensorFault.CLOCK_JUMP),
        SensorReport("strap", 2, has_contact=False),
        SensorReport("strap", 2, link=LinkState.LOST),
    ],
)
def test_after_a_fault_two_new_values_are_needed(report: SensorReport) -> None:
    state = seen(beat(70, 0), beat(70, 1))
    state.report(report)
    assert state.for_limits(HEART, 2) is None
    assert state.has_fault(HEART, 2)
    state.take(beat(70, 2.5), 2.5)
    assert state.for_limits(HEART, 2.5) is None
    state.take(beat(70, 3.5), 3.5)
    assert state.for_limits(HEART, 3.5) is not None
    assert not state.has_fault(HEART, 3.5)


def test_a_clock_ahead_keeps_no_value_fresh() -> None:
    state = PersonState()
    for at in (0.0, 1.0):
        state.take(beat(70, at + 1000), at)
    assert state.for_limits(HEART, 1.0) is not None
    assert state.for_limits(HEART, 4.1) is None


def test_the_number_of_sensors_of_a_person_is_bounded() -> None:
    state = seen(*(beat(70, 0, f"sensor-{number}") for number in range(2 * MAX_SOURCES)))
    assert len(state.sources) == MAX_SOURCES


FEATURES = st.builds(
    Feature,
    name=st.just(HEART),
    source=st.sampled_from(["a", "b"]),
    value=st.one_of(st.floats(), st.floats(60, 90), st.text(max_size=3)),
    at_s=st.one_of(st.floats(0, 60), st.floats()),
    quality=st.one_of(st.floats(0, 1), st.floats()),
    status=st.sampled_from(list(Status)),
    period_s=st.one_of(st.just(1.0), st.floats()),
    is_calibrated=st.booleans(),
)


@given(st.lists(st.tuples(FEATURES, st.floats(0, 2)), max_size=40))
def test_whatever_is_sent_only_plausible_fresh_calibrated_values_feed_limits(
    sent: list[tuple[Feature, float]],
) -> None:
    state, now_s = PersonState(), 0.0
    for feature, pause_s in sent:
        now_s += pause_s
        state.take(feature, now_s)
        for each in (state.for_limits(HEART, now_s), state.value(HEART, now_s)):
            if each is None or each.status is not Status.VALID:
                continue
            assert isinstance(each.value, float | int)
            assert 30 <= each.value <= 220
            assert MIN_QUALITY <= each.quality <= 1
            assert each.at_s <= now_s
        usable = state.for_limits(HEART, now_s)
        assert usable is None or usable.is_calibrated


def test_an_event_counts_at_once() -> None:
    event = Feature(FeatureName.APNOEA_EVENT, "analysis", "cyclicHeartRate", 10.0, 0.6, method="apnoea-1")
    found = seen(event).value(FeatureName.APNOEA_EVENT, 10.0)
    assert found is not None
    assert (found.value, found.status) == ("cyclicHeartRate", Status.VALID)


def test_a_poor_second_method_of_a_sensor_hides_no_good_one_but_a_heart_rate_counts() -> None:
    belt = Feature(FeatureName.BREATHING_RATE, "chest", 15.0, 0.0, 1.0, method="belt")
    of_ecg = replace(belt, value=9.0, quality=0.4, method="ecg")
    state = PersonState()
    for second in range(4):
        state.take(replace(belt, at_s=second), second)
        state.take(replace(of_ecg, at_s=second + 0.5), second + 0.5)
    breathing = state.value(FeatureName.BREATHING_RATE, 3.5)
    assert breathing is not None
    assert (breathing.value, breathing.status) == (15.0, Status.VALID)
    state.report(SensorReport("chest", 4.0, fault=SensorFault.GAP))
    state.take(replace(of_ecg, at_s=4.5), 4.5)
    left = state.value(FeatureName.BREATHING_RATE, 4.5)
    assert left is not None
    assert left.status is Status.IMPLAUSIBLE

    state = seen(beat(70, 0), beat(71, 1))
    state.take(replace(beat(72, 2, quality=0.2), method="pulse"), 2)
    assert state.for_limits(HEART, 2) is None
