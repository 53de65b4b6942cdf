"""Blinks, fixations, saccades and pupils: the features agree with the simulated eyes, and feed no limit."""

import time
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_body.checks.monitor import SignalMonitor
from handover_body.drivers.runner import SensorRunner
from handover_body.drivers.simulated.driver import SimulatedDriver, SimulatedSettings
from handover_body.drivers.simulated.eyes import EyeMovement, SimulatedEyes
from handover_body.fusion.person_state import PersonState
from handover_body.model.features import Feature, FeatureName, Status
from handover_body.model.signals import (
    EYE_EVENTS,
    ClockKind,
    Samples,
    SensorFault,
    SensorReport,
    SignalInfo,
    SignalKind,
)
from handover_body.monitoring.processors import pipeline_of
from handover_body.processing.eyes import (
    BLINK_WINDOW_S,
    DURATIONS_S,
    EyeEventProcessor,
    GazeProcessor,
    PupilProcessor,
)
from handover_body.processing.pipeline import pipeline_for

START_S = 1_700_000_000.0
TRACKER = (SignalKind.BLINK, SignalKind.FIXATION, SignalKind.SACCADE, SignalKind.EYE_STATE)
BLINK = SignalInfo(SignalKind.BLINK, "SEC", None, ("duration_s",))


@dataclass
class Seen:
    """What a simulated eye tracker gives, and what the eyes did."""

    features: dict[FeatureName, list[Feature]] = field(default_factory=dict)
    faults: list[SensorReport] = field(default_factory=list)
    blinks: dict[float, float] = field(default_factory=dict)
    movements: dict[float, EyeMovement] = field(default_factory=dict)
    lasted_s: float = 0.0

    def mean(self, name: FeatureName) -> float:
        return float(np.mean([one.value for one in self.features[name] if one.quality >= 0.5]))

    def movement_s(self, *, is_saccade: bool) -> list[float]:
        chosen = [one for one in self.movements.values() if bool(one.amplitude_deg) is is_saccade]
        return [one.end_s - one.begin_s for one in chosen if one.end_s < self.lasted_s]


def seen(
    signals: Iterable[SignalKind], seconds: float = 180, blinks_per_minute: float = 17.0, **more: object
) -> Seen:
    driver = SimulatedDriver(
        "glasses",
        SimulatedSettings.model_validate(
            {"signals": tuple(signals), "pace": 0, "start_s": START_S, "seed": 3, **more}
        ),
    )
    driver.person.eyes.blinks_per_minute = blinks_per_minute
    monitors = {info: SignalMonitor("glasses", info) for info in driver.signals}
    kinds = [info.kind for info in driver.signals]
    pipelines = {info: pipeline_of(info, kinds) for info in driver.signals}
    found = Seen(lasted_s=seconds)
    while driver.person.now_s < seconds:
        for samples in driver.next_packets():
            checked = monitors[samples.info].take(samples, samples.end_s + 0.05)
            found.faults += checked.reports
            features = [one for each in checked.reports for one in pipelines[samples.info].report(each)]
            if checked.samples is not None:
                features += pipelines[samples.info].feed(checked.samples)
            for feature in features:
                found.features.setdefault(feature.name, []).append(feature)
        eyes = driver.person.eyes
        found.blinks |= {end: end - begin for begin, end in eyes.blinks if end < seconds}
        found.movements |= {one.begin_s: one for one in eyes.movements}
    return found


def test_a_simulated_tracker_gives_the_rates_of_its_eyes() -> None:
    found = seen(TRACKER)
    assert not found.faults
    assert len(found.blinks) == pytest.approx(3 * 17, rel=0.2)
    assert found.mean(FeatureName.BLINK_RATE) == pytest.approx(len(found.blinks) / 3, rel=0.1)
    blinks_ms = 1000 * float(np.mean(list(found.blinks.values())))
    assert found.mean(FeatureName.BLINK_DURATION) == pytest.approx(blinks_ms, rel=0.1)
    saccades = found.movement_s(is_saccade=True)
    assert 2.5 < len(saccades) / 180 < 4
    assert found.mean(FeatureName.SACCADE_RATE) == pytest.approx(len(saccades) / 180, rel=0.05)
    sizes = [one.amplitude_deg for one in found.movements.values() if one.amplitude_deg]
    assert found.mean(FeatureName.SACCADE_AMPLITUDE) == pytest.approx(np.mean(sizes), rel=0.1)
    fixations_ms = 1000 * float(np.mean(found.movement_s(is_saccade=False)))
    assert found.mean(FeatureName.FIXATION_DURATION) == pytest.approx(fixations_ms, rel=0.05)
    assert found.mean(FeatureName.PUPIL_DIAMETER) == pytest.approx(3.6, abs=0.05)
    newest = found.features[FeatureName.BLINK_RATE][-1]
    assert (newest.quality, newest.status, newest.window_s) == (1.0, Status.VALID, BLINK_WINDOW_S)


@pytest.mark.nightly
@pytest.mark.parametrize("blinks_per_minute", [6.0, 17.0, 35.0])
def test_an_eog_shows_blinks_and_no_saccades_as_blinks(blinks_per_minute: float) -> None:
    found = seen([SignalKind.EOG], blinks_per_minute=blinks_per_minute)
    assert not found.faults
    assert found.mean(FeatureName.BLINK_RATE) == pytest.approx(len(found.blinks) / 3, rel=0.15, abs=1)
    blinks_ms = 1000 * float(np.mean(list(found.blinks.values())))
    assert found.mean(FeatureName.BLINK_DURATION) == pytest.approx(blinks_ms, rel=0.25)


def test_gaze_in_degrees_shows_fixations_and_saccades() -> None:
    found = seen([SignalKind.GAZE])
    saccades = found.movement_s(is_saccade=True)
    assert found.mean(FeatureName.SACCADE_RATE) == pytest.approx(len(saccades) / 180, rel=0.1)
    fixations_ms = 1000 * float(np.mean(found.movement_s(is_saccade=False)))
    assert found.mean(FeatureName.FIXATION_DURATION) == pytest.approx(fixations_ms, rel=0.1)


def test_a_tracker_with_events_needs_no_gaze_and_another_sensor_does() -> None:
    gaze = SignalInfo(SignalKind.GAZE, "DD", 200.0, ("gaze_x", "gaze_y"))
    assert not pipeline_of(gaze, [SignalKind.GAZE, SignalKind.SACCADE]).has_processors
    assert pipeline_of(gaze, [SignalKind.GAZE, SignalKind.BLINK]).has_processors


def test_the_quality_grows_with_the_window_and_a_fault_forgets() -> None:
    pipeline = pipeline_for(BLINK)

    def blink(at_s: float) -> list[Feature]:
        samples = Samples("glasses", BLINK, at_s, np.array([[0.2]]), np.array([at_s]))
        return [one for one in pipeline.feed(samples) if one.name is FeatureName.BLINK_RATE]

    assert blink(START_S) == []
    rates = [one for second in range(4, 65, 4) for one in blink(START_S + second)]
    assert [one.value for one in rates] == pytest.approx([15.0] * len(rates))
    assert [one.quality for one in rates] == pytest.approx([min(n * 4 / 60, 1) for n in range(1, 17)])
    report = SensorReport("glasses", START_S + 65, fault=SensorFault.GAP, kind=SignalKind.BLINK)
    assert {one.status for one in pipeline.report(report)} == {Status.STALE}
    assert blink(START_S + 70) == [], "no interval over the gap"


@given(
    kind=st.sampled_from(sorted(EYE_EVENTS)),
    events=st.lists(
        st.tuples(st.floats(1e-3, 30), st.floats(allow_nan=True, allow_infinity=True), st.floats(-1e9, 1e9)),
        min_size=1,
        max_size=60,
    ),
)
@settings(deadline=None)
def test_whatever_a_tracker_sends_values_are_those_of_eyes(
    kind: SignalKind, events: list[tuple[float, float, float]]
) -> None:
    info = SignalInfo(kind, "DD", None, ("duration_s", "amplitude_deg"))
    processor = EyeEventProcessor(info)
    lowest, highest = DURATIONS_S[kind]
    at_s = START_S
    for passed_s, duration_s, size in events:
        at_s += passed_s
        for one in processor.feed(Samples("g", info, at_s, np.array([[duration_s, size]]), np.array([at_s]))):
            assert 0 <= one.quality <= 1
            assert np.isfinite(one.value)
            if "Duration" in one.name:
                assert 1000 * lowest * (1 - 1e-9) <= float(one.value) <= 1000 * highest * (1 + 1e-9)


def test_impossible_durations_lower_the_quality() -> None:
    processor = EyeEventProcessor(BLINK)
    found: list[Feature] = []
    for number in range(30):
        at_s = START_S + 4 * number
        row = np.array([[0.2 if number % 3 == 0 else 40.0]])
        found += processor.feed(Samples("g", BLINK, at_s, row, np.array([at_s])))
    rates = [one for one in found if one.name is FeatureName.BLINK_RATE]
    assert rates[-1].value == pytest.approx(15)
    assert rates[-1].quality < 0.5, "two of three blinks cannot be: the value does not count"


@pytest.mark.parametrize(
    ("make", "info"),
    [
        (EyeEventProcessor, SignalInfo(SignalKind.BLINK, "SEC", None, ("",))),
        (GazeProcessor, SignalInfo(SignalKind.GAZE, "C62", 200.0, ("gaze_x", "gaze_y"))),
        (GazeProcessor, SignalInfo(SignalKind.GAZE, "DD", 30.0, ("gaze_x", "gaze_y"))),
        (PupilProcessor, SignalInfo(SignalKind.EYE_STATE, "C62", 200.0, ("pupil_left_mm",))),
    ],
)
def test_signals_of_another_form_are_refused(make: type, info: SignalInfo) -> None:
    with pytest.raises(ValueError, match="needs"):
        make(info)


def test_somebody_who_stares_is_no_silent_sensor_and_a_tracker_that_is_gone_is() -> None:
    monitor = SignalMonitor("glasses", BLINK)
    for number in range(8):
        at_s = START_S + number
        samples = Samples("glasses", BLINK, at_s, np.array([[0.2]]), np.array([at_s]), ClockKind.DEVICE)
        monitor.take(samples, at_s + 0.05)
    assert monitor.silence(START_S + 7 + 40) is None
    silent = monitor.silence(START_S + 7 + 61)
    assert silent is not None
    assert silent.fault is SensorFault.GAP


def test_who_stares_while_the_tracker_sees_the_eyes_has_a_rate_and_no_silent_sensor() -> None:
    monitor, pipeline = SignalMonitor("glasses", BLINK), pipeline_for(BLINK)
    features: list[Feature] = []

    def take(samples: Samples | None) -> None:
        features.extend(() if samples is None else pipeline.feed(samples))

    for number in range(100):
        at_s = START_S + number
        if number < 30 and number % 3 == 0:
            blink = Samples("glasses", BLINK, at_s, np.array([[0.2]]), np.array([at_s]))
            take(monitor.take(blink, at_s).samples)
        for part in (0.1, 0.5, 0.9):
            take(monitor.nothing_happened(at_s + part, at_s + part + 0.05))
        assert monitor.silence(at_s + 1) is None
    rates = [one for one in features if one.name is FeatureName.BLINK_RATE]
    assert len(rates) == pytest.approx(100, abs=35), "about once a second, with an event or without"
    known = {round(one.at_s - START_S): one for one in rates if one.quality >= 0.5}
    assert known[32].value == pytest.approx(20, abs=2)
    assert known[60].value == pytest.approx(10, abs=1.1)
    assert (known[99].value, known[99].quality) == (0.0, 1.0)
    assert all(one.value > 0 for one in features if one.name is FeatureName.BLINK_DURATION)
    gone = monitor.silence(START_S + 99 + 62)
    assert gone is not None, "a tracker that sends nothing is silent again"
    assert gone.fault is SensorFault.GAP


async def test_a_tracker_that_sends_gaze_or_pupils_says_that_there_was_no_blink() -> None:
    for stream in (SignalKind.GAZE, SignalKind.EYE_STATE):
        items = await run_tracker((SignalKind.BLINK, stream), blinks_per_minute=0.0)
        empty = [one for one in items if one.info.kind is SignalKind.BLINK]
        assert all(len(one.values) == 0 for one in empty)
        assert [one.start_s - empty[0].start_s for one in empty] == pytest.approx(range(len(empty)), abs=0.3)
        assert len(empty) == pytest.approx(20, abs=2)
    alone = await run_tracker((SignalKind.BLINK, SignalKind.FIXATION), blinks_per_minute=0.0)
    assert not [one for one in alone if one.info.kind is SignalKind.BLINK]


async def run_tracker(signals: tuple[SignalKind, ...], blinks_per_minute: float) -> list[Samples]:
    """Return what 20 s of a simulated tracker send through its runner."""
    driver = SimulatedDriver(
        "glasses", SimulatedSettings(signals=signals, pace=0, start_s=START_S, duration_s=20)
    )
    driver.person.eyes.blinks_per_minute = blinks_per_minute
    driver.person.eyes.blinks.clear()
    items: list[Samples | SensorReport] = []
    await SensorRunner(driver, items.append).run()
    return [one for one in items if isinstance(one, Samples)]


def test_the_eyes_are_the_same_whatever_the_steps_of_time() -> None:
    one, other = SimulatedEyes(5), SimulatedEyes(5)
    for second in range(1, 61):
        one.advance(second)
    for tenth in range(1, 601):
        other.advance(tenth / 10)
    assert list(one.movements) == list(other.movements)
    assert list(one.blinks) == list(other.blinks)
    assert len(one.movements) < 100, "memory is bounded"


def test_blinks_that_last_minutes_are_found_and_pass_as_no_value() -> None:
    faults = [{"kind": "unit", "at_s": 60, "duration_s": 60, "size": 1000.0}]
    found = seen([SignalKind.BLINK], 120, faults=faults)
    assert {one.fault for one in found.faults} == {SensorFault.SATURATED}
    valid = [one for values in found.features.values() for one in values if one.status is Status.VALID]
    assert valid
    assert all(one.at_s < START_S + 60.3 for one in valid)


@given(st.lists(st.tuples(st.sampled_from(list(FeatureName)[-12:-4]), st.floats(0, 500)), max_size=30))
def test_no_value_of_the_eyes_feeds_a_limit(values: list[tuple[FeatureName, float]]) -> None:
    state, now_s = PersonState(), time.monotonic()
    for number, (name, value) in enumerate(values):
        feature = Feature(name, "glasses", value, now_s + 0.01 * number, 1.0)
        state.take(replace(feature, at_s=now_s + 0.01 * number), now_s + 1)
    assert state.for_limits(FeatureName.HEART_RATE, now_s + 1) is None
