"""The quality of a pulse says whether its rate is right: high where it is, low where it is not."""

import numpy as np
import pytest
from numpy.typing import NDArray

from handover_body.model.features import FeatureName, Status
from handover_body.model.signals import SignalInfo, SignalKind
from handover_body.processing.beats import BeatDetector
from handover_body.processing.pipeline import pipeline_for
from handover_body.processing.pulse import pulse_of, unwrapped
from handover_body.processing.synthesis import packets_of
from tests.kit.paths import REPOSITORY

RECORDS = REPOSITORY.parent / "shared" / "data" / "physiology"
Floats = NDArray[np.float64]


def pulses(
    bpm: float, dicrotic: float, jitter: float, seed: int, duration_s: float = 10.0
) -> tuple[Floats, float]:
    """Return a PPG at 50 Hz, each pulse a fast rise and a slow fall with a second wave, and its mean rate."""
    random = np.random.default_rng(seed)
    time_s = np.arange(round(50 * duration_s)) / 50
    wave = 0.3 * np.sin(2 * np.pi * 0.22 * time_s)
    at_s, inside = -1.5, []
    while at_s < duration_s + 0.5:
        late = time_s - at_s
        stretch = np.sqrt(np.clip(60 / bpm, 0.3, 1.2))
        wave += np.interp(late / stretch, [0, 0.16, 0.4, 0.8], [0, 1, 0.35, 0], left=0, right=0)
        wave += dicrotic * np.exp(-0.5 * ((late / stretch - 0.46) / 0.07) ** 2)
        if 0 <= at_s < duration_s:
            inside.append(at_s)
        at_s += 60 / bpm * (1 + jitter * random.normal())
    wave += random.normal(0, 0.01, len(wave))
    return wave, 60 / float(np.mean(np.diff(inside)))


def test_a_right_pulse_has_quality_also_with_a_second_wave_and_an_irregular_heart() -> None:
    good = right = 0
    for seed in range(120):
        random = np.random.default_rng(seed)
        dicrotic, jitter = random.uniform(0, 0.5), random.choice([0.01, 0.04, 0.1])
        wave, bpm = pulses(random.uniform(45, 190), dicrotic, jitter, seed)
        found, quality = pulse_of(wave, 50.0)
        if abs(found - bpm) <= 5:
            right += 1
            good += quality >= 0.5
    assert right >= 100
    assert good >= 0.9 * right


def test_what_is_no_pulse_has_no_quality() -> None:
    trusted = 0
    for seed in range(80):
        noise = np.random.default_rng(seed).normal(size=540)
        trusted += pulse_of(np.convolve(noise, np.ones(12) / 12, "valid")[:500], 50.0)[1] >= 0.5
    assert trusted <= 2


@pytest.mark.parametrize("bpm", [19.6, 25, 240])
def test_a_pulse_that_no_heart_has_is_never_valid(bpm: float) -> None:
    info = SignalInfo(SignalKind.PPG, "C62", 50.0)
    wave, _ = pulses(bpm, 0.1, 0.01, 1, duration_s=40)
    pipeline = pipeline_for(info)
    features = [
        f for packet in packets_of(info, wave[:, None], "ppg", 1e9, 25) for f in pipeline.feed(packet)
    ]
    rates = [f for f in features if f.name is FeatureName.HEART_RATE and f.status is Status.VALID]
    assert all(30 <= float(f.value) <= 220 and f.quality >= 0.5 for f in rates)
    assert not [f for f in rates if abs(float(f.value) - bpm) < 3 and not 30 <= bpm <= 220]


def test_a_wave_that_ran_over_the_range_of_its_converter_is_restored() -> None:
    wave, _ = pulses(100, 0.1, 0.02, 3)
    wave = np.repeat(wave, 5)  # 250 Hz
    wave = np.convolve(np.pad(wave, 3, "edge"), np.ones(7) / 7, "valid")
    span = 0.7 * np.ptp(wave)
    wrapped = (wave - wave.min()) % span
    restored = unwrapped(wrapped[:, None])[:, 0]
    assert np.corrcoef(restored, wave)[0, 1] > 0.99
    assert unwrapped(wave[:, None])[:, 0] is not None
    assert np.array_equal(unwrapped(wave[:, None])[:, 0], wave)


@pytest.mark.parametrize(("name", "lead"), [("a103l", 0), ("v102s", 1)])
def test_the_quality_of_a_recorded_pulse_is_right(name: str, lead: int) -> None:
    if not (RECORDS / f"{name}.hea").is_file():
        pytest.skip(f"the records are not kept here ({RECORDS})")
    import wfdb

    record = wfdb.rdrecord(str(RECORDS / name))
    signals = np.nan_to_num(record.p_signal)
    detector = BeatDetector(250.0)
    beats = [b for at in range(0, len(signals), 140) for b in detector.feed(signals[at : at + 140, lead])]
    at_s = np.array([beat.position for beat in beats + detector.flush()]) / 250
    ppg = signals[:, record.sig_name.index("PLETH")]
    right, wrong = [], []
    for first_s in range(int(len(ppg) / 250) - 10):
        inside = at_s[(at_s >= first_s) & (at_s < first_s + 10)]
        if len(inside) < 4:
            continue
        part = unwrapped(ppg[250 * first_s : 250 * (first_s + 10), None])[:, 0].reshape(-1, 5).mean(axis=1)
        found, quality = pulse_of(part, 50.0)
        apart = min(abs(found - 60 / np.mean(np.diff(inside))), abs(found - 60 / np.median(np.diff(inside))))
        if apart <= 5:
            right.append(quality)
        elif apart > 10:
            wrong.append(quality)
    assert np.mean(np.array(right) >= 0.5) >= 0.9
    assert np.mean(np.array(wrong) < 0.5) >= 0.9
