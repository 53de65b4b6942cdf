"""Thresholds are changed finger by finger, and refused if they cannot separate bent from straight."""

import pytest

from handover_gloves.recognition.thresholds import M2O2P_THRESHOLDS, Threshold, WrongThreshold


def test_the_fingers_named_change_and_the_others_stay() -> None:
    changed = M2O2P_THRESHOLDS.with_changes({"ring": {"upper": 700, "lower": 600}, "thumb": {"upper": 990}})
    assert changed.fingers[3] == Threshold(700, 600)
    assert changed.fingers[0] == Threshold(990, 800)
    assert changed.fingers[1:3] == M2O2P_THRESHOLDS.fingers[1:3]


def test_thresholds_come_back_from_what_was_written() -> None:
    assert M2O2P_THRESHOLDS.with_changes(M2O2P_THRESHOLDS.as_dict()) == M2O2P_THRESHOLDS
    turned = M2O2P_THRESHOLDS.with_changes({"ring": {"inverted": True}})
    assert turned.fingers[3] == Threshold(1800, 800, inverted=True)
    assert M2O2P_THRESHOLDS.with_changes(turned.as_dict()) == turned
    assert turned.with_changes({"ring": {"upper": 1700}}).fingers[3] == Threshold(1700, 800, inverted=True)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"pinky": {"upper": 1, "lower": 0}}, 'unknown finger "pinky"; the fingers are thumb, index'),
        ({"ring": {"middle": 3}}, 'ring: unknown bound "middle"'),
        ({"ring": {"upper": 500, "lower": 600}}, "ring: the lower threshold 600 is above the upper one 500"),
        ({"ring": {"lower": 1801}}, "ring: the lower threshold 1801 is above the upper one 1800"),
        ({"ring": {"upper": float("nan")}}, "ring: thresholds are finite numbers"),
        ({"ring": {"upper": float("inf")}}, "ring: thresholds are finite numbers"),
    ],
)
def test_a_wrong_threshold_names_the_finger_and_the_rule(
    changes: dict[str, dict[str, float]], words: str
) -> None:
    with pytest.raises(WrongThreshold, match=words):
        M2O2P_THRESHOLDS.with_changes(changes)
