"""Pulse, breathing, skin, muscle, movement, pressure and events of synthetic signals with a known truth."""

from dataclasses import replace

import numpy as np
import pytest

from handover_body.model.features import Feature, FeatureName, Status
from handover_body.model.signals import Samples, SensorFault, SensorReport, SignalInfo, SignalKind
from handover_body.processing.events import PersonAnalysis
from handover_body.processing.motion import step_rate
from handover_body.processing.pipeline import pipeline_for, processors_for
from handover_body.processing.pulse import saturation_of
from handover_body.processing.synthesis import (
    acceleration_of,
    breathing_wave,
    packets_of,
    ppg_of,
    synthetic_beats,
)

BEGIN_S = 1_700_000_000.0
PPG = SignalInfo(SignalKind.PPG, "C62", 100.0, ("red", "ir"))
BELT = SignalInfo(SignalKind.RESPIRATION, "C62", 25.0)
CHEST = SignalInfo(SignalKind.ACCELERATION, "MSK", 50.0, ("x", "y", "z"), -80, 80, method="chest strap")


def features_of(info: SignalInfo, values: np.ndarray, packet: int) -> list[Feature]:
    pipeline = pipeline_for(info)
    found = [
        feature for each in packets_of(info, values, "s", BEGIN_S, packet) for feature in pipeline.feed(each)
    ]
    assert pipeline.take_reports() == []
    return found


def values(features: list[Feature], name: FeatureName) -> list[float]:
    return [float(f.value) for f in features if f.name is name and f.status is Status.VALID]


def two_colours(bpm: float) -> np.ndarray:
    ppg = ppg_of(synthetic_beats(60, bpm, seed=2), 60, 100.0)
    noise = np.random.default_rng(1).normal(0, 0.01, (len(ppg), 2))
    return np.column_stack((5000 + 50 * ppg, 5000 + 100 * ppg)) + 20 * noise


@pytest.mark.parametrize("bpm", [48, 75, 130])
def test_the_pulse_of_a_ppg_is_the_heart_rate(bpm: float) -> None:
    features = features_of(PPG, two_colours(bpm), 50)
    rates = [f for f in features if f.name is FeatureName.HEART_RATE]
    assert np.mean([f.quality for f in rates]) > 0.5
    assert [f.value for f in rates if f.quality >= 0.5] == pytest.approx(
        [bpm] * sum(f.quality >= 0.5 for f in rates), abs=3
    )


def test_saturation_is_marked_as_uncalibrated() -> None:
    spo2 = [f for f in features_of(PPG, two_colours(75), 50) if f.name is FeatureName.SPO2]
    assert [f.value for f in spo2] == pytest.approx([97.5] * len(spo2), abs=1)
    assert spo2
    assert not any(f.is_calibrated for f in spo2)
    assert saturation_of(np.zeros(500), np.ones(500), 50.0) is None


def test_noise_is_no_good_pulse() -> None:
    noise = 5000 + np.random.default_rng(3).normal(0, 50, (100 * 60, 2))
    rates = [f for f in features_of(PPG, noise, 50) if f.name is FeatureName.HEART_RATE]
    assert all(f.quality < 0.5 for f in rates)


@pytest.mark.parametrize("per_minute", [8, 14, 22, 32])
def test_breathing_of_a_belt_is_within_one_a_minute(per_minute: float) -> None:
    features = features_of(BELT, breathing_wave(120, 25.0, per_minute, seed=5)[:, None], 25)
    rates = [f for f in features if f.name is FeatureName.BREATHING_RATE]
    assert np.mean([abs(float(f.value) - per_minute) for f in rates]) < 1
    assert np.mean([f.quality for f in rates]) > 0.7


def test_breathing_of_a_radar_that_sends_at_irregular_times_is_within_one_a_minute() -> None:
    info = SignalInfo(SignalKind.RESPIRATION, "C62", None, method="radar 60 GHz")
    pipeline = pipeline_for(info)
    wave = breathing_wave(90, 50.0, 15, seed=5)
    random, found = np.random.default_rng(1), []
    for second in range(90):
        at_s = np.sort(second + np.arange(5) / 5 + random.uniform(0, 0.1, 5))
        values = np.round(60 * np.interp(at_s, np.arange(len(wave)) / 50, wave))
        found += pipeline.feed(Samples("radar", info, BEGIN_S + at_s[0], values[:, None], BEGIN_S + at_s))
    assert pipeline.take_reports() == []
    assert values_of_breathing(found) == pytest.approx([15] * len(values_of_breathing(found)), abs=1.5)
    assert len(values_of_breathing(found)) > 50


def values_of_breathing(found: list[Feature]) -> list[float]:
    return [float(f.value) for f in found if f.name is FeatureName.BREATHING_RATE]


def test_skin_conductance_has_a_slow_and_a_fast_part() -> None:
    t = np.arange(0, 60, 0.1)
    response = 0.8 * np.exp(-np.maximum(t - 40, 0) / 4) * (t > 40)
    info = SignalInfo(SignalKind.EDA, "D80", 10.0)
    features = features_of(info, (5 + response + 0.001 * np.sin(t * 9))[:, None], 5)
    assert values(features, FeatureName.EDA_TONIC)[20] == pytest.approx(5, abs=0.05)
    phasic = [f for f in features if f.name is FeatureName.EDA_PHASIC]
    top = max(phasic, key=lambda f: float(f.value))
    assert top.at_s - BEGIN_S == pytest.approx(41, abs=1.5)
    assert float(top.value) > 0.4


def test_an_electrode_without_skin_has_no_quality() -> None:
    info = SignalInfo(SignalKind.EDA, "D80", 10.0)
    noise = 0.002 + 0.0005 * np.random.default_rng(1).random((300, 1))
    assert all(f.quality == 0 for f in features_of(info, noise, 5))


def test_the_envelope_of_a_muscle_follows_its_strength_in_microvolts() -> None:
    random = np.random.default_rng(2)
    info = SignalInfo(SignalKind.EMG, "2Z", 500.0)
    strength = np.repeat([0.05, 0.3], 1000)
    features = features_of(info, (strength * random.normal(size=2000))[:, None], 50)
    envelope = values(features, FeatureName.EMG_ENVELOPE)
    assert envelope[15] == pytest.approx(46, rel=0.2)
    assert envelope[-1] == pytest.approx(6 * envelope[15], rel=0.25)


@pytest.mark.parametrize("activity", ["walk", "run"])
def test_steps_are_counted_within_five_percent(activity: str) -> None:
    acceleration, steps = acceleration_of(activity, 60, 50.0, seed=4)
    features = features_of(CHEST, acceleration, 25)
    assert values(features, FeatureName.STEPS)[-1] == pytest.approx(steps, rel=0.05)
    assert values(features, FeatureName.CADENCE)[-1] == pytest.approx(steps, rel=0.03)


def test_activity_and_posture_of_a_person_at_rest() -> None:
    features = features_of(CHEST, acceleration_of("rest", 10, 50.0, seed=1)[0], 25)
    last = {f.name: f.value for f in features}
    assert last[FeatureName.ACTIVITY] == "rest"
    assert last[FeatureName.POSTURE] == "upright"
    assert last[FeatureName.STEPS] == 0
    assert FeatureName.SLEEP_POSITION not in last


@pytest.mark.parametrize(
    ("gravity", "position"),
    [((0, 1, 0.1), "supine"), ((0, -1, 0.1), "prone"), ((1, 0.1, 0), "left"), ((-1, 0.1, 0), "right")],
)
def test_the_side_that_is_up_is_the_position_of_sleep(gravity: tuple[float, ...], position: str) -> None:
    lying = 9.80665 * np.array(gravity) / np.linalg.norm(gravity) + np.random.default_rng(1).normal(
        0, 0.02, (500, 3)
    )
    last = {f.name: f.value for f in features_of(CHEST, lying, 25)}
    assert last[FeatureName.POSTURE] == "lying"
    assert last[FeatureName.SLEEP_POSITION] == position


def test_a_sensor_at_the_wrist_gives_no_posture() -> None:
    wrist = replace(CHEST, method="wrist")
    assert FeatureName.POSTURE not in {
        f.name for f in features_of(wrist, acceleration_of("rest", 10, 50.0, 1)[0], 25)
    }


def test_the_centre_of_pressure_follows_the_load() -> None:
    cells = tuple(f"r{row}c{column}" for row in range(3) for column in range(4))
    info = SignalInfo(SignalKind.PRESSURE_MAP, "C62", 10.0, cells, 0, 4096)
    even, right_front = np.full((1, 12), 500.0), np.zeros((1, 12))
    right_front[0, [2, 3]] = 800
    found = features_of(info, np.vstack((even, right_front)), 1)
    assert values(found, FeatureName.CENTRE_OF_PRESSURE_X) == pytest.approx([0, 100])
    assert values(found, FeatureName.CENTRE_OF_PRESSURE_Y) == pytest.approx([0, 100])
    assert values(found, FeatureName.ACTIVE_CELLS) == [12, 2]
    named = replace(info, channels=("x-10y0", "x30y40"), min_value=0)
    centre = features_of(named, np.array([[300.0, 300.0]]), 1)
    assert values(centre, FeatureName.CENTRE_OF_PRESSURE_X) == pytest.approx([10])


def test_intervals_of_a_strap_give_variability_and_no_second_heart_rate() -> None:
    info = SignalInfo(SignalKind.INTER_BEAT_INTERVAL, "C26", None)
    pipeline = pipeline_for(info)
    at_s, found = BEGIN_S, []
    for number in range(120):
        length_ms = 800.0 + 20 * (-1) ** number
        at_s += length_ms / 1000
        found += pipeline.feed(Samples("strap", info, at_s, np.array([[length_ms]]), np.array([at_s])))
    assert values(found, FeatureName.HRV_RMSSD)[-1] == pytest.approx(40, abs=0.5)
    assert not values(found, FeatureName.HEART_RATE)


def test_each_analysed_kind_has_one_processor_and_others_none() -> None:
    assert len(processors_for(PPG)) == 1
    assert processors_for(SignalInfo(SignalKind.MOOD, "C62", None)) == ()
    assert processors_for(SignalInfo(SignalKind.ECG, "2Z", 10.0)) == (), "too slow to analyse"


def heart_rate(at_s: float, bpm: float, quality: float = 0.9) -> Feature:
    return Feature(FeatureName.HEART_RATE, "h10", bpm, BEGIN_S + at_s, quality)


def test_a_dip_and_a_rise_of_the_heart_rate_is_an_event() -> None:
    analysis = PersonAnalysis("person")
    steady = [f for at in range(180) for f in analysis.take([heart_rate(at, 62 + (at % 3))])]
    assert FeatureName.APNOEA_EVENT not in {f.name for f in steady}
    cycle = [(180 + n, 62 - 10 * np.sin(np.pi * n / 40)) for n in range(30)] + [
        (210 + n, 55 + 2 * n) for n in range(12)
    ]
    events = [
        f
        for at, bpm in cycle
        for f in analysis.take([heart_rate(at, float(bpm))])
        if f.name is FeatureName.APNOEA_EVENT
    ]
    assert [f.value for f in events] == ["cyclicHeartRate"]


def test_a_breathing_pause_of_ten_seconds_is_one_event() -> None:
    analysis = PersonAnalysis("person")
    found = []
    for at in range(40):
        rate = 14.0 if at < 10 else 0.0
        found += analysis.take([Feature(FeatureName.BREATHING_RATE, "radar", rate, BEGIN_S + at, 0.8)])
    assert [f.value for f in found] == ["breathingPause"]


def test_exertion_raises_fatigue_and_rest_lowers_it() -> None:
    analysis = PersonAnalysis("person", rest_bpm=60, maximum_bpm=180)
    work = [
        f for at in range(1200) for f in analysis.take([heart_rate(at, 160)]) if f.name is FeatureName.FATIGUE
    ]
    rest = [
        f
        for at in range(1200, 3000)
        for f in analysis.take([heart_rate(at, 62)])
        if f.name is FeatureName.FATIGUE
    ]
    assert float(work[0].value) < float(work[-1].value)
    assert float(rest[-1].value) < 0.7 * float(work[-1].value)
    assert not any(f.is_calibrated for f in work), "an index never feeds a limit"


def test_values_of_low_quality_do_not_enter_indices() -> None:
    assert PersonAnalysis("person").take([heart_rate(0, 150, quality=0.2)]) == []


def test_a_fault_empties_the_window() -> None:
    pipeline = pipeline_for(PPG)
    packets = packets_of(PPG, two_colours(75), "s", BEGIN_S, 50)
    for packet in packets[:30]:
        pipeline.feed(packet)
    ended = pipeline.report(SensorReport("s", BEGIN_S + 15, fault=SensorFault.GAP))
    assert {f.status for f in ended} == {Status.STALE}
    assert not [
        f for packet in packets[30:40] for f in pipeline.feed(packet) if f.name is FeatureName.HEART_RATE
    ]


def test_a_motion_that_repeats_nothing_has_no_steps() -> None:
    """Swings whose phase jumps all the time: of some, every peak of the autocorrelation is negative."""
    for seed in range(150):
        random = np.random.default_rng(seed)
        phase = np.repeat(random.uniform(0, 2 * np.pi, 16), 7)[:100]
        swing = 1 + 0.2 * np.sin(2 * np.pi * 1.6 * np.arange(100) / 25 + phase)
        assert 0.0 <= step_rate(swing, 25.0) < 5.0
