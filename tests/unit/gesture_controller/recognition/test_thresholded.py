"""Thresholds: a finger that wavers keeps what it was for a moment; one that stays between is half bent."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.gesture_controller.frames import Frame
from services.gesture_controller.gestures import M2O2P_GESTURES, Gestures
from services.gesture_controller.recognition.recognizer import Given, Recognition
from services.gesture_controller.recognition.thresholded import KEEP_S, ThresholdRecognizer
from services.gesture_controller.thresholds import Threshold, Thresholds

RECOGNIZER = ThresholdRecognizer.made_from(
    Given(Thresholds((Threshold(600, 400),) * 5), Gestures(M2O2P_GESTURES))
)
LEVELS = {"0": 700.0, "1": 500.0, "2": 300.0}


def show(codes: list[str], hz: float = 50) -> list[Recognition]:
    seen: list[Recognition] = []
    for number, code in enumerate(codes):
        frame = Frame(number / hz, [LEVELS[state] for state in code])
        seen.append(RECOGNIZER.see(seen[-1] if seen else None, frame))
    return seen


@pytest.mark.parametrize("hz", [20, 50, 200])
def test_a_finger_that_wavers_keeps_what_it_was_for_a_moment_at_any_rate(hz: int) -> None:
    seen = show(["02222"] * hz + ["12222"] * hz, hz)[hz:]
    kept = [one.gesture for one in seen].count("Thumbs up")
    assert kept == pytest.approx(KEEP_S * hz, abs=1)
    assert {one.states for one in seen} == {"12222"}, "the page shows the fingers as they are"
    assert seen[-1].gesture is None


def test_a_finger_that_was_never_decided_is_between() -> None:
    assert [one.gesture for one in show(["12222"] * 5)] == [None] * 5


def test_a_finger_that_goes_through_is_what_it_becomes_at_once() -> None:
    assert show(["02222", "12222", "22222"])[-1].gesture is None
    assert show(["22222", "12222", "02222"])[-1].gesture == "Thumbs up"


@given(st.lists(st.sampled_from(["02222", "12222", "22222", "11111"]), min_size=1, max_size=60))
def test_no_gesture_is_answered_whose_fingers_were_not_seen_in_their_states_lately(codes: list[str]) -> None:
    for number, seen in enumerate(show(codes)):
        if seen.gesture is not None:
            lately = codes[max(0, number - round(KEEP_S * 50) - 1) : number + 1]
            for place, state in enumerate(M2O2P_GESTURES[seen.gesture]):
                assert any(code[place] == state for code in lately)


def test_it_says_why_and_how_near_each_gesture_is() -> None:
    (seen,) = show(["02122"])
    assert RECOGNIZER.why(seen) == (
        "thumb 700 is above 600, straight; index 300 is below 400, bent; middle 500 is between 400 and 600; "
        "ring 300 is below 400, bent; little 300 is below 400, bent: no gesture has these states"
    )
    odds = RECOGNIZER.odds(seen)
    assert odds["Thumbs up"] == pytest.approx(0.5)
    assert odds["Horns"] == 0
