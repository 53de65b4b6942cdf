"""The personal recognizer knows a hand by its fist and open hand, and doubts what is half bent."""

from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glove_sdk_bridge.simulation.hand import FIST, OPEN_HAND, Posture, SimulatedHand
from handover_gloves.calibration.samples import sample_of, with_sample
from handover_gloves.recognition.finger_states import BENT, BETWEEN, STRAIGHT
from handover_gloves.recognition.frames import Frame
from handover_gloves.recognition.gestures import M2O2P_GESTURES, Gestures
from handover_gloves.recognition.levels import Calibration, calibrate
from handover_gloves.recognition.personal import PersonalRecognizer
from handover_gloves.recognition.recognizer import CannotRecognize, HandContext, Recognition
from handover_gloves.recognition.thresholds import M2O2P_THRESHOLDS

GESTURES = Gestures({**M2O2P_GESTURES, "Four fingers": "20000", "Fist": "22222", "Open hand": "00000"})
HALF_BENT = 0.6
SHOWN = {STRAIGHT: 1.0, BETWEEN: HALF_BENT, BENT: 0.0}


def posture(code: str) -> Posture:
    thumb, index, middle, ring, little = (SHOWN[state] for state in code)
    return thumb, index, middle, ring, little


def frames(shown: Posture, seconds: float, hz: float, seed: int) -> list[Sequence[float]]:
    hand = SimulatedHand(seed, rate_hz=hz, posture=shown)
    return [hand.read() for _ in range(round(seconds * hz))]


def calibrated(hz: float = 50, seed: int = 1) -> Calibration:
    return calibrate(frames(FIST, 1, hz, seed), frames(OPEN_HAND, 1, hz, seed + 1))


def look(
    recognizer: PersonalRecognizer, shown: Sequence[Sequence[float]], hz: float = 50, from_s: float = 0.0
) -> list[Recognition]:
    seen: list[Recognition] = []
    for number, bend in enumerate(shown):
        frame = Frame(from_s + number / hz, list(bend))
        seen.append(recognizer.see(seen[-1] if seen else None, frame))
    return seen


@pytest.mark.parametrize("hz", [20, 50, 200])
@pytest.mark.parametrize("name", ["Point with index", "Thumbs up", "Horns", "Four fingers", "Open hand"])
def test_gestures_are_recognized_at_any_rate(name: str, hz: float) -> None:
    recognizer = PersonalRecognizer(calibrated(hz), GESTURES)
    seen = look(recognizer, frames(posture(GESTURES.codes[name]), 2, hz, seed=7), hz)
    assert sum(one.gesture == name for one in seen) > 0.98 * len(seen)
    assert 0.5 <= seen[-1].certainty <= 1
    assert recognizer.odds(seen[-1])[name] == pytest.approx(seen[-1].certainty, abs=1e-3)


@given(st.sampled_from(sorted(GESTURES.codes)), st.integers(0, 10_000))
def test_odds_are_probabilities_and_agree_with_the_answer(name: str, seed: int) -> None:
    recognizer = PersonalRecognizer(calibrated(), GESTURES)
    for seen in look(recognizer, frames(posture(GESTURES.codes[name]), 0.3, 50, seed)):
        odds = recognizer.odds(seen)
        assert all(0 <= one <= 1 for one in odds.values())
        assert sum(odds.values()) <= 1.01
        if seen.gesture is not None:
            assert seen.gesture == max(odds, key=lambda gesture: odds[gesture])


def test_no_finger_is_too_bent_or_too_straight_for_a_gesture() -> None:
    recognizer = PersonalRecognizer(calibrated(), GESTURES)
    levels = calibrated().levels
    for beyond in (0.0, 0.1, 0.3):
        bend = [
            level.open + beyond * level.span if state == STRAIGHT else level.fist - beyond * level.span
            for level, state in zip(levels, GESTURES.codes["Thumb and little straight"], strict=True)
        ]
        assert look(recognizer, [bend] * 25)[-1].gesture == "Thumb and little straight"


def test_a_half_bent_hand_shows_no_gesture_and_it_says_so() -> None:
    recognizer = PersonalRecognizer(calibrated(), GESTURES)
    seen = look(recognizer, frames((HALF_BENT,) * 5, 1, 50, seed=3))
    assert {one.gesture for one in seen} == {None}
    assert "half bent" in recognizer.why(seen[-1])


def test_another_gesture_is_seen_within_a_third_of_a_second() -> None:
    recognizer = PersonalRecognizer(calibrated(), GESTURES)
    first = frames(posture("02222"), 2, 50, seed=3)
    then = frames(posture("20220"), 1, 50, seed=3)
    seen = look(recognizer, [*first, *then])[len(first) :]
    assert seen[0].gesture == "Thumbs up"
    assert next(number for number, one in enumerate(seen) if one.gesture == "Horns") <= 17


def test_a_gap_or_a_restarted_clock_resets_the_probabilities() -> None:
    recognizer = PersonalRecognizer(calibrated(), GESTURES)
    before = look(recognizer, frames(posture("02222"), 1, 50, seed=3), from_s=100)[-1]
    horns = Frame(0.0, list(frames(posture("20220"), 0.1, 50, seed=3)[0]))
    for at_s in (3.0, 101.5):
        assert recognizer.see(before, Frame(at_s, horns.bend)).gesture == "Horns"


def test_a_sample_teaches_how_this_person_shows_a_gesture() -> None:
    calibration = calibrated()
    lazy: Posture = (0.0, 1.0, 0.75, 0.0, 0.0)  # points, and the middle finger goes most of the way with it
    shown = frames(lazy, 2, 50, seed=5)
    untaught = look(PersonalRecognizer(calibration, GESTURES), shown)
    assert "Point with index" not in {one.gesture for one in untaught}
    sample = sample_of("20222", frames(lazy, 1, 50, seed=6), calibration.levels)
    taught = look(PersonalRecognizer(with_sample(calibration, sample), GESTURES), shown)
    assert sum(one.gesture == "Point with index" for one in taught) > 0.98 * len(taught)


def test_without_a_calibration_it_cannot_be_made() -> None:
    with pytest.raises(CannotRecognize, match="calibrate the glove first"):
        PersonalRecognizer.from_context(HandContext(M2O2P_THRESHOLDS, GESTURES))
