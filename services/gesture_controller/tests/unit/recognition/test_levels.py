"""Thresholds follow from a fist and an open hand; the error names a finger that is unclear."""

import random
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_gloves.recognition.finger_states import finger_states
from handover_gloves.recognition.levels import MAX_INVERTED, CalibrationFailed, calibrate

FIST, OPEN = [300.0, 500, 500, 500, 450], [400.0, 700, 700, 690, 680]


def shown(levels: Sequence[float], noise: float = 3, count: int = 100) -> list[list[float]]:
    chance = random.Random(7)
    return [[chance.gauss(level, noise) for level in levels] for _ in range(count)]


def test_a_fist_reads_bent_and_an_open_hand_straight() -> None:
    calibration = calibrate(shown(FIST), shown(OPEN))
    assert finger_states(FIST, calibration.thresholds) == "22222"
    assert finger_states(OPEN, calibration.thresholds) == "00000"
    middle = [bent + 0.58 * (straight - bent) for bent, straight in zip(FIST, OPEN, strict=True)]
    assert finger_states(middle, calibration.thresholds) == "11111"


def test_stray_frames_do_not_move_the_thresholds() -> None:
    strays = [[0.0, 4095, 0, 4095, 0]] * 8
    clean, stained = (
        calibrate(shown(FIST), shown(OPEN)),
        calibrate(shown(FIST) + strays, shown(OPEN) + strays),
    )
    for one, other in zip(clean.thresholds.fingers, stained.thresholds.fingers, strict=True):
        assert one.upper == pytest.approx(other.upper, abs=2)
        assert one.lower == pytest.approx(other.lower, abs=2)


def test_a_finger_that_stayed_bent_is_named() -> None:
    lame = [*OPEN[:3], FIST[3], OPEN[4]]
    with pytest.raises(CalibrationFailed, match=r"^ring: ") as failed:
        calibrate(shown(FIST), shown(lame))
    assert "thumb" not in str(failed.value)
    assert "calibrate again" in str(failed.value)


def test_exchanged_poses_are_reported() -> None:
    with pytest.raises(CalibrationFailed, match="check that fist and open hand are not exchanged"):
        calibrate(shown(OPEN), shown(FIST))


def test_the_error_for_a_finger_that_moved_in_the_fist_says_to_keep_still() -> None:
    frames = shown(FIST)
    for frame in frames[:20]:
        frame[1] = OPEN[1]
    with pytest.raises(CalibrationFailed, match="index: bent and straight cannot be separated in the fist"):
        calibrate(frames, shown(OPEN))


def test_the_error_for_a_finger_that_moved_in_the_open_hand_says_to_keep_still() -> None:
    frames = shown(OPEN)
    for frame in frames[:20]:
        frame[4] = FIST[4]
    with pytest.raises(CalibrationFailed, match="stretch the little fully, keep it still"):
        calibrate(shown(FIST), frames)


def test_too_few_frames_are_refused() -> None:
    with pytest.raises(CalibrationFailed, match="9 frames of the fist are too few"):
        calibrate(shown(FIST, count=9), shown(OPEN))
    with pytest.raises(CalibrationFailed, match="0 frames of the open hand are too few"):
        calibrate(shown(FIST), [])


def test_a_frame_without_all_fingers_is_refused() -> None:
    with pytest.raises(CalibrationFailed, match="a frame of the fist has not five values"):
        calibrate([*shown(FIST), [1, 2, 3, 4]], shown(OPEN))


HANDS = st.lists(st.floats(0, 4095), min_size=5, max_size=5)


@given(HANDS, HANDS)
def test_thresholds_never_come_out_the_wrong_way_round(fist: list[float], open_hand: list[float]) -> None:
    try:
        calibration = calibrate([fist] * 10, [open_hand] * 10)
    except CalibrationFailed:
        return
    for place, threshold in enumerate(calibration.thresholds.fingers):
        ends = sorted((fist[place], open_hand[place]))
        assert ends[0] < threshold.lower <= threshold.upper < ends[1]
    assert finger_states(fist, calibration.thresholds) == "22222"
    assert finger_states(open_hand, calibration.thresholds) == "00000"
    assert sum(threshold.inverted for threshold in calibration.thresholds.fingers) <= MAX_INVERTED


def test_a_sensor_that_hardly_falls_is_no_inverted_one() -> None:
    with pytest.raises(CalibrationFailed, match=r"^ring: the sensor does not rise"):
        calibrate(shown(FIST), shown([*OPEN[:3], FIST[3] - 30, OPEN[4]]))
