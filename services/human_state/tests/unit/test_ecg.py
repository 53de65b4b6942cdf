"""R peaks, heart rate and variability of synthetic people with known beats, and of a record if kept."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from handover_body.model.features import Feature, FeatureName, Status
from handover_body.model.signals import SignalInfo, SignalKind
from handover_body.processing.beats import BeatDetector
from handover_body.processing.pipeline import pipeline_for
from handover_body.processing.rhythm import Interval, Rhythm, lf_hf, rmssd_ms
from handover_body.processing.synthesis import (
    TrueBeat,
    add_ecg_noise,
    ecg_of,
    packets_of,
    synthetic_beats,
)
from tests.kit.paths import REPOSITORY

TOLERANCE_S = 0.15  # ANSI/AAMI EC57
ECG = SignalInfo(SignalKind.ECG, "2Z", 130.0, min_value=-10, max_value=10)


def found_beats(ecg: np.ndarray, rate_hz: float, packet: int = 73) -> np.ndarray:
    detector = BeatDetector(rate_hz)
    found = []
    for first in range(0, len(ecg), packet):
        found += detector.feed(ecg[first : first + packet])
    found += detector.flush()
    return np.array([beat.position for beat in found]) / rate_hz


def matched(truth: Sequence[float], found: np.ndarray) -> tuple[int, np.ndarray]:
    """Return how many true beats were found, and the errors in s."""
    errors = []
    for at_s in truth:
        near = found[np.abs(found - at_s) <= TOLERANCE_S]
        if len(near):
            errors.append(float(near[0] - at_s))
    return len(errors), np.array(errors)


def times(beats: list[TrueBeat]) -> list[float]:
    return [beat.at_s for beat in beats]


@pytest.mark.parametrize(("rate_hz", "sign"), [(130.0, 1.0), (250.0, -1.0), (512.0, 1.0)])
def test_every_beat_of_a_person_with_ectopic_beats_is_found(rate_hz: float, sign: float) -> None:
    beats = synthetic_beats(120, 72, seed=5, ectopic_share=0.08)
    assert {beat.kind for beat in beats} == {"N", "A", "V"}
    found = found_beats(sign * ecg_of(beats, 120, rate_hz), rate_hz)
    count, errors = matched(times(beats), found)
    assert count == len(beats) == len(found)
    normal = [error for error, beat in zip(errors, beats, strict=True) if beat.kind == "N"]
    assert np.std(normal) < 0.001


def test_noise_of_four_times_the_power_costs_at_most_one_beat_of_two_hundred() -> None:
    beats = synthetic_beats(240, 75, seed=6)
    found = found_beats(add_ecg_noise(ecg_of(beats, 240, 130.0), 130.0, -6, seed=1), 130.0)
    count, _ = matched(times(beats), found)
    assert count >= 0.995 * len(beats)
    assert len(found) <= 1.005 * len(beats)


def test_a_heart_rate_between_40_and_180_is_followed() -> None:
    beats = synthetic_beats(180, lambda at_s: 110 + 70 * np.sin(2 * np.pi * at_s / 180 - 1.5), seed=7)
    found = found_beats(ecg_of(beats, 180, 130.0), 130.0)
    count, _ = matched(times(beats), found)
    assert count == len(beats) == len(found)


def test_the_size_of_packets_does_not_change_the_beats() -> None:
    ecg = ecg_of(synthetic_beats(40, 70, seed=8), 40, 130.0)
    whole = found_beats(ecg, 130.0, 65)
    assert found_beats(ecg, 130.0, 130) == pytest.approx(whole, abs=0.003)


def test_noise_without_a_heart_is_no_good_heart_rate() -> None:
    random = np.random.default_rng(4)
    pipeline = pipeline_for(ECG)
    features = [
        f
        for p in packets_of(ECG, random.normal(0, 0.2, (130 * 60, 1)), "ecg", 1e9, 73)
        for f in pipeline.feed(p)
    ]
    rates = [f for f in features if f.name is FeatureName.HEART_RATE]
    assert all(f.quality < 0.5 for f in rates)


def features_of(ecg: np.ndarray, info: SignalInfo = ECG) -> list[Feature]:
    pipeline = pipeline_for(info)
    found = [f for p in packets_of(info, ecg[:, None], "ecg", 1e9, 73) for f in pipeline.feed(p)]
    assert pipeline.take_reports() == []
    return found


def test_heart_rate_and_variability_are_those_of_the_beats() -> None:
    beats = synthetic_beats(320, 66, seed=9)
    features = features_of(ecg_of(beats, 320, 130.0))
    rates = [f for f in features if f.name is FeatureName.HEART_RATE]
    assert all(f.status is Status.VALID for f in rates)
    assert np.mean([f.value for f in rates]) == pytest.approx(66, abs=0.3)
    assert np.mean([f.quality for f in rates]) > 0.9
    intervals = np.diff(times(beats))
    last = {f.name: f.value for f in features}
    assert last[FeatureName.HRV_SDNN] == pytest.approx(1000 * intervals.std(), rel=0.1)
    assert last[FeatureName.HRV_RMSSD] == pytest.approx(
        1000 * np.sqrt(np.mean(np.diff(intervals) ** 2)), rel=0.15
    )
    breathing = [f for f in features if f.name is FeatureName.BREATHING_RATE]
    assert breathing[-1].value == pytest.approx(15, abs=1)
    assert all(f.quality <= 0.4 for f in breathing), "breathing of an ECG must not control"


def test_variability_ignores_ectopic_beats_and_their_neighbours() -> None:
    quiet = [Interval(at, 0.8, 1.0, True) for at in np.arange(0.8, 40, 0.8)]
    ectopic = [*quiet[:20], Interval(quiet[20].at_s - 0.3, 0.5, 1.0, False), *quiet[21:]]
    assert rmssd_ms(ectopic) == pytest.approx(0, abs=1e-6)


def test_the_ratio_of_frequencies_follows_the_modulation() -> None:
    at_s = np.cumsum(np.full(300, 0.8))
    slow = [Interval(t, 0.8 + 0.03 * np.sin(2 * np.pi * 0.1 * t), 1.0, True) for t in at_s]
    fast = [Interval(t, 0.8 + 0.03 * np.sin(2 * np.pi * 0.25 * t), 1.0, True) for t in at_s]
    (low, high), (low_of_fast, high_of_fast) = lf_hf(slow) or (0, 1), lf_hf(fast) or (1, 0)
    assert low > 10 * high
    assert high_of_fast > 10 * low_of_fast


def test_a_heart_rate_ends_when_no_beats_come() -> None:
    rhythm = Rhythm("test")
    for number in range(12):
        rhythm.add_beat(100 + number * 0.8, 1.0)
    last = 100 + 11 * 0.8
    assert rhythm.features("s", last + 1, 1.0)[0].status is Status.VALID
    ended = rhythm.features("s", last + 4, 1.0)
    assert [(f.status, f.quality) for f in ended] == [(Status.IMPLAUSIBLE, 0.0)]
    assert rhythm.features("s", last + 5, 1.0) == []


def test_an_ecg_too_slow_for_beats_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="50 to 2,000 Hz; this one has 10 Hz"):
        pipeline_for(SignalInfo(SignalKind.ECG, "2Z", 10.0))


RECORDS = Path(os.environ.get("HANDOVER_PHYSIOLOGY", REPOSITORY.parent / "shared/data/physiology"))


def test_the_annotated_beats_of_record_100_are_found() -> None:
    if not (RECORDS / "100.dat").is_file():
        pytest.skip(f"the records are not kept here; HANDOVER_PHYSIOLOGY names their folder ({RECORDS})")
    import wfdb

    record = wfdb.rdrecord(str(RECORDS / "100"), sampto=360 * 300)
    notes = wfdb.rdann(str(RECORDS / "100"), "atr", sampto=360 * 300)
    truth = [
        at / 360 for at, symbol in zip(notes.sample, notes.symbol, strict=True) if symbol in "NLRAVJSFEj/"
    ]
    found = found_beats(record.p_signal[:, 0], 360.0, 200)
    count, errors = matched(truth, found)
    assert count == len(truth) == len(found)
    assert errors.std() < 0.0015
