"""A valid heart rate is never far too low, from 30 to 220 bpm, whatever interrupts it; and it is valid."""

import gzip
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from handover_body.fusion.person_state import PersonState
from handover_body.model.features import MIN_QUALITY, Feature, FeatureName, Status
from handover_body.model.signals import SensorFault, SensorReport
from handover_body.processing.rhythm import steady_from
from services.human_state.tests.unit.hearts import BEATS, Heart, course, heart, heart_rates, with_fault
from tests.kit.paths import REPOSITORY

HANDED = REPOSITORY.parent / "shared" / "data" / "heart_rate"
MAX_LOW_S = 3.0
MAX_RECOVERY_S = 15.0
SLOW = settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.too_slow])


@pytest.mark.parametrize("bpm", [30, 41, 60, 95, 130, 172, 181, 190, 205, 220])
def test_a_steady_rate_is_valid_and_right(bpm: int) -> None:
    given_heart = heart(bpm, 40)
    shown = heart_rates(given_heart)
    assert np.mean([feature.status is Status.VALID for feature in shown]) >= 0.99
    assert all(abs(float(feature.value) - bpm) < 0.05 * bpm for feature in shown)
    assert course(given_heart, shown).valid_again_s(0) <= 10


@pytest.mark.parametrize(("rate_hz", "beat", "bpm"), [
    (125.0, "normal", 195), (250.0, "deep S", 200), (500.0, "wide", 178), (1000.0, "normal", 215),
    (360.0, "tall T", 42), (125.0, "tall T", 60), (130.0, "tall T", 90), (250.0, "wide", 35),
])  # fmt: skip
def test_the_shape_of_the_beat_and_the_sampling_rate_do_not_matter(
    rate_hz: float, beat: str, bpm: int
) -> None:
    shown = heart_rates(heart(bpm, 30, rate_hz=rate_hz, beat=beat))
    assert np.mean([feature.status is Status.VALID for feature in shown]) >= 0.95
    assert all(abs(float(f.value) - bpm) < 0.06 * bpm for f in shown if f.status is Status.VALID)


@pytest.mark.nightly
@SLOW
@given(
    bpm=st.integers(30, 220),
    kind=st.sampled_from(["nan", "flat", "noise", "movement", "gap"]),
    seconds=st.sampled_from([0.5, 2.0, 3.0, 6.0]),
    beat=st.sampled_from(sorted(BEATS)),
    seed=st.integers(0, 999),
)
def test_no_fault_in_the_middle_makes_a_valid_rate_too_low(
    bpm: int, kind: str, seconds: float, beat: str, seed: int
) -> None:
    faulty = with_fault(heart(bpm, 25 + seconds + 20, beat=beat, seed=seed), kind, 25, seconds, seed)
    seen = course(faulty, heart_rates(faulty))
    assert seen.longest_low_s() <= MAX_LOW_S
    assert seen.valid_again_s(25 + seconds) <= MAX_RECOVERY_S


@pytest.mark.nightly
@SLOW
@given(
    bpm=st.integers(120, 220),
    second=st.floats(0.45, 0.95),
    beat=st.sampled_from(["normal", "deep S", "wide"]),
    seed=st.integers(0, 999),
)
def test_beats_of_two_heights_that_alternate_are_not_half_as_many(
    bpm: int, second: float, beat: str, seed: int
) -> None:
    alternating = heart(bpm, 40, beat=beat, second=second, seed=seed)
    assert course(alternating, heart_rates(alternating)).longest_low_s() <= MAX_LOW_S


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("before", "after"), [(80, 190), (120, 190), (60, 120), (180, 90), (190, 80), (70, 175)]
)
def test_a_step_is_followed_and_never_averaged_away(before: int, after: int) -> None:
    stepped = heart(lambda at_s: before if at_s < 25 else after, 45)
    seen = course(stepped, heart_rates(stepped))
    assert seen.longest_low_s() <= MAX_LOW_S
    assert seen.valid_again_s(25.5) <= MAX_RECOVERY_S


@pytest.mark.parametrize(("kind", "seconds"), [("gap", 2.0), ("flat", 4.0), ("noise", 3.0)])
def test_a_ramp_with_a_fault_is_followed(kind: str, seconds: float) -> None:
    ramp = heart(lambda at_s: 70 + 2.2 * min(max(at_s - 10, 0), 60), 85)
    faulty = with_fault(ramp, kind, 40, seconds)
    seen = course(faulty, heart_rates(faulty))
    assert seen.longest_low_s() <= MAX_LOW_S
    assert seen.valid_again_s(40 + seconds) <= MAX_RECOVERY_S


@pytest.mark.parametrize(("name", "before"), [("svt190", 80), ("svt120_190", 120)])
def test_the_handed_fast_hearts_are_fast(name: str, before: int) -> None:
    path = HANDED / f"{name}.csv.gz"
    if not path.is_file():
        pytest.skip(f"the recordings of fast hearts are not kept here ({path})")
    with gzip.open(path, "rt") as file:
        ecg = np.loadtxt(file, delimiter=",", skiprows=1)[:, 1]
    fast = Heart(ecg, 360.0, lambda at_s: before if at_s < 40 else 190)
    shown = heart_rates(fast)
    seen = course(fast, shown)
    assert seen.longest_low_s() <= MAX_LOW_S
    assert seen.valid_again_s(40.5) <= MAX_RECOVERY_S
    assert np.mean([feature.status is Status.VALID for feature in shown]) > 0.97


def beat_of(bpm: float, at_s: float, quality: float = 0.9) -> Feature:
    return Feature(FeatureName.HEART_RATE, "strap", bpm, at_s, quality, method="device")


@given(st.floats(100, 220), st.floats(0.4, 0.85), st.floats(0.5, 4))
def test_after_a_fault_a_much_lower_rate_is_doubted_for_ten_seconds(
    bpm: float, share: float, fault_s: float
) -> None:
    state = PersonState()
    for number in range(11):
        state.take(beat_of(bpm, number), number)
    state.report(SensorReport("strap", 10.1, fault=SensorFault.GAP))
    counted = []
    for number in range(30):
        at_s = 10.1 + fault_s + number
        taken = state.take(beat_of(bpm * share, at_s), at_s)
        if taken is not None and taken.status is Status.VALID:
            counted.append(at_s)
    assert bpm - bpm * share <= 15 or counted[0] > 20
    assert counted[0] <= 10.1 + fault_s + 15


def test_a_rate_that_glides_to_its_half_is_doubted() -> None:
    state = PersonState()
    shown = [state.take(beat_of(max(190.0 - 9 * max(0, n - 20), 95.0), n), n) for n in range(60)]
    lowest = min(float(f.value) for f in shown[:31] if f is not None and f.status is Status.VALID)
    assert lowest >= 140
    assert shown[-1] is not None
    assert shown[-1].status is Status.VALID


def test_a_higher_rate_after_a_fault_counts_at_once() -> None:
    state = PersonState()
    for number in range(5):
        state.take(beat_of(90, number), number)
    state.report(SensorReport("strap", 4.5, fault=SensorFault.GAP))
    state.take(beat_of(180, 6), 6)
    taken = state.take(beat_of(180, 7), 7)
    assert taken is not None
    assert taken.status is Status.VALID


@given(st.floats(), st.sampled_from(list(FeatureName)), st.sampled_from(list(Status)))
def test_a_valid_feature_has_quality(quality: float, name: FeatureName, status: Status) -> None:
    made = Feature(name, "any", 70.0, 0.0, quality, status)
    if made.status is Status.VALID:
        assert not math.isnan(quality)
        assert made.quality >= MIN_QUALITY
    else:
        assert made.status is (Status.IMPLAUSIBLE if status is Status.VALID else status)


def test_intervals_before_a_change_of_the_rate_are_left_out() -> None:
    assert steady_from(np.array([0.75] * 12)) == 0
    assert steady_from(np.array([0.75] * 3 + [0.32] * 9)) == 3
    irregular = 0.7 * (1 + 0.2 * np.random.default_rng(1).uniform(-1, 1, 14))
    assert steady_from(irregular) == 0


def test_recorded_hearts_stay_valid() -> None:
    folder = REPOSITORY.parent / "shared" / "data" / "physiology"
    if not (folder / "a103l.hea").is_file():
        pytest.skip(f"the records are not kept here ({folder})")
    from handover_body.drivers.recording.tracks import read  # of the extra

    least = {("a103l", "II"): 0.91, ("a103l", "V"): 0.94, ("v102s", "II"): 0.4, ("v102s", "V"): 0.94}
    for (name, lead), share in least.items():
        track = next(t for t in read(Path(folder / f"{name}.hea"), {}).tracks if t.name == lead)
        recorded = Heart(track.values[:, 0] / 1000, 250.0, lambda _: 0.0)
        seen = course(recorded, heart_rates(recorded))
        assert np.mean(~np.isnan(seen.bpm)) >= share, (name, lead)
