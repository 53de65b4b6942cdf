"""Thresholds: a finger that wavers keeps what it was for a moment; one that stays between is half bent.

Once the hand is calibrated, a thumb in between goes by the index finger, and what holds something is doubted.
"""

import random
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glove_sdk_bridge.simulation.hand import FIST, OPEN_HAND, Posture, SimulatedHand
from handover_gloves.recognition.frames import Frame
from handover_gloves.recognition.gestures import M2O2P_GESTURES, Gestures
from handover_gloves.recognition.levels import BENT_BELOW, STRAIGHT_ABOVE, calibrate
from handover_gloves.recognition.population import BEFOREHAND, Stand
from handover_gloves.recognition.recognizer import HandContext, Recognition
from handover_gloves.recognition.thresholded import GRIP_APART, LEEWAY, STEADY_S, ThresholdRecognizer
from handover_gloves.recognition.thresholds import Threshold, Thresholds

RECOGNIZER = ThresholdRecognizer.from_context(
    HandContext(Thresholds((Threshold(600, 400),) * 5), Gestures(M2O2P_GESTURES))
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
    assert kept == pytest.approx(STEADY_S * hz, abs=1)
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
            lately = codes[max(0, number - round(STEADY_S * 50) - 1) : number + 1]
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


HAND = calibrate([[300.0] * 5] * 20, [[700.0] * 5] * 20)
CALIBRATED = ThresholdRecognizer.from_context(HandContext(HAND.thresholds, Gestures(M2O2P_GESTURES), HAND))


def stand(*postures: Sequence[float], seconds: float = 1.0) -> list[Recognition]:
    """What is seen in fingers that stand so (0 as in the fist, 1 as in the open hand), each for `seconds`."""
    seen: list[Recognition] = []
    for posture in postures:
        for _ in range(round(seconds * 50)):
            frame = Frame(len(seen) / 50, [300 + 400 * share for share in posture])
            seen.append(CALIBRATED.see(seen[-1] if seen else None, frame))
    return seen


def test_a_finger_near_the_threshold_that_it_passed_keeps_what_it_was_for_good() -> None:
    near = BENT_BELOW[1] + 0.9 * LEEWAY * (STRAIGHT_ABOVE[1] - BENT_BELOW[1])
    beyond = BENT_BELOW[1] + 1.1 * LEEWAY * (STRAIGHT_ABOVE[1] - BENT_BELOW[1])
    clear, keeps, lifted = (0.9, 0.1, 0, 0, 0.9), (0.9, near, 0, 0, 0.9), (0.9, beyond, 0, 0, 0.9)
    assert stand(clear, keeps, seconds=3)[-1].gesture == "Thumb and little straight"
    assert stand(clear, lifted, seconds=3)[-1].gesture is None
    assert stand(keeps)[-1].gesture is None, "nobody saw it bent"


@pytest.mark.parametrize(
    ("posture", "gesture"),
    [
        ((0.53, 1, 1, 0, 0), "Index and middle straight"),
        ((0.53, 0, 0, 0, 0.9), "Thumb and little straight"),
        ((0.53, 0, 0, 0, 0), None),
        ((0.95, 0, 0, 0, 0), "Thumbs up"),
        ((0.53, 0.65, 0, 0, 0.9), None),
    ],
)
def test_a_thumb_in_between_is_what_the_index_finger_makes_likely(
    posture: Sequence[float], gesture: str | None
) -> None:
    assert stand(posture)[-1].gesture == gesture


@pytest.mark.parametrize(
    ("held", "looks_like"),
    [
        ((0.75, 0.3, 0.25, 0.25, 0.25), "Thumbs up"),
        ((0.4, 0.85, 0.3, 0.3, 0.3), "Point with index"),
        ((0.7, 0.85, 0.85, 0.35, 0.35), "Thumb, index and middle straight"),
    ],
)
def test_a_hand_that_holds_something_shows_no_gesture_and_it_says_why(
    held: Sequence[float], looks_like: str
) -> None:
    seen = stand(held)[-1]
    assert seen.gesture is None
    assert 1 <= len(seen.unclear_fingers) <= 2
    assert f"{looks_like}, but as in a hand that holds something" in CALIBRATED.why(seen)
    assert f"must stand {GRIP_APART:.0%} above them" in CALIBRATED.why(seen)
    clear = [1.0 if share > 0.6 else 0.1 for share in held]
    assert stand(clear)[-1].gesture == looks_like
    assert stand(clear)[-1].unclear_fingers == ()


def test_a_tremble_towards_a_grip_does_not_break_a_hold_but_a_grip_ends_it() -> None:
    clear, gripped = (0.95, 0.1, 0.1, 0.1, 0.1), (0.7, 0.2, 0.2, 0.2, 0.2)
    tremble = stand(clear, gripped, clear, seconds=0.9 * STEADY_S)
    assert {one.gesture for one in tremble} == {"Thumbs up"}
    ended = stand(clear, gripped, seconds=2)[100:]
    assert [one.gesture for one in ended].count("Thumbs up") == pytest.approx(STEADY_S * 50, abs=1)
    assert ended[-1].gesture is None


def test_hands_that_stand_anyhow_but_half_closed_show_no_gesture() -> None:
    chance = random.Random(5)
    hand = SimulatedHand(5, posture=FIST)
    fist = [list(hand.read()) for _ in range(50)]
    hand.move(OPEN_HAND, 0.2)
    calibration = calibrate(fist, [list(hand.read()) for _ in range(60)][10:])
    reader = ThresholdRecognizer.from_context(
        HandContext(calibration.thresholds, Gestures(M2O2P_GESTURES), calibration)
    )
    for _ in range(100):
        posture: Posture = (
            chance.uniform(0.2, 0.6),
            chance.uniform(0.2, 0.6),
            chance.uniform(0.2, 0.6),
            chance.uniform(0.2, 0.6),
            chance.uniform(0.2, 0.6),
        )
        hand.move(posture, 0.3)
        seen: Recognition | None = None
        shown = []
        for number in range(90):
            seen = reader.see(seen, Frame(number / 50, list(hand.read())))
            shown.append(seen.gesture)
        assert len(set(shown[15:])) > 1 or shown[-1] is None, "nothing is held for a second and a half"


def test_thresholds_stand_where_people_at_large_say() -> None:
    """The numbers of the population hardly change if one person is left out."""
    kinds = BEFOREHAND.kinds
    dragged = kinds["bent beside"]
    assert BENT_BELOW[1] == pytest.approx(dragged.share + 3 * dragged.spread, abs=0.02)
    assert BENT_BELOW[0] == pytest.approx(
        meeting(kinds["bent thumb"], kinds["straight thumb alone"]), abs=0.06
    )
    upper = meeting(kinds["bent thumb beside"], kinds["straight thumb"])
    assert STRAIGHT_ABOVE[0] == pytest.approx(upper, abs=0.06)


def meeting(bent: Stand, straight: Stand) -> float:
    """Where a finger is as many deviations from the one as from the other."""
    return (bent.share * straight.spread + straight.share * bent.spread) / (bent.spread + straight.spread)
