"""A gesture too near another is refused with the name of the other and the distance."""

from collections.abc import Collection

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_gloves.people.nearness import Neighbour, find_rejection, neighbours
from handover_gloves.people.person import Sample
from handover_gloves.recognition.gestures import M2O2P_GESTURES
from handover_gloves.recognition.thresholds import Threshold, Thresholds

THRESHOLDS = Thresholds((Threshold(600, 400),) * 5)
CODES = st.text("02", min_size=5, max_size=5)


def why_too_near(code: str, near: Collection[Neighbour], unreliable: Collection[str]) -> str | None:
    rejection = find_rejection(code, near, unreliable)
    return None if rejection is None else rejection.why


def sampled(*levels: float, noise: float = 5.0) -> Sample:
    return Sample("glove-1", levels, (noise,) * 5)


@given(CODES, st.dictionaries(st.text(min_size=1), CODES, max_size=8))
def test_the_nearest_comes_first_and_the_distance_is_the_number_of_fingers(
    code: str, others: dict[str, str]
) -> None:
    found = neighbours(code, others)
    assert [one.distance for one in found] == sorted(
        sum(mine != theirs for mine, theirs in zip(code, other, strict=True)) for other in others.values()
    )
    assert {one.name for one in found} == set(others)


def test_the_same_code_is_the_other_gesture() -> None:
    why = why_too_near("20220", neighbours("20220", M2O2P_GESTURES), ())
    assert why is not None
    assert why.startswith('it is "Horns" (code 20220, no finger differs)')


def test_one_finger_is_enough_unless_its_sensor_is_unreliable_fingers() -> None:
    near = neighbours("20000", {"Middle, ring and little straight": "22000", "Horns": "20220"})
    assert why_too_near("20000", near, ()) is None
    assert why_too_near("20000", near, {"ring"}) is None
    why = why_too_near("20000", near, {"index"})
    assert why is not None
    assert '"Middle, ring and little straight" (code 22000, 1 finger differs: index)' in why
    assert "the sensor of the index hardly separates" in why


def test_a_recorded_gesture_must_be_clear_of_its_own_noise() -> None:
    others = {"Middle, ring and little straight": "22000"}
    clear = neighbours("20000", others, sampled(100, 700, 700, 700, 700), THRESHOLDS)
    assert clear[0].sigmas == 20.0
    assert why_too_near("20000", clear, ()) is None
    close = neighbours("20000", others, sampled(100, 610, 700, 700, 700), THRESHOLDS)
    why = why_too_near("20000", close, ())
    assert why is not None
    assert "1 finger differs: index, 2 times the noise; 4 are needed" in why


def test_of_two_fingers_that_differ_the_surer_one_counts() -> None:
    near = neighbours("20000", {"A": "22200"}, sampled(100, 610, 700, 700, 700), THRESHOLDS)
    assert near[0].sigmas == 20.0


def test_of_two_recorded_gestures_the_less_sure_one_counts() -> None:
    clear, close = sampled(100, 700, 700, 700, 700), sampled(100, 390, 700, 700, 700)
    near = neighbours("20000", {"A": "22000"}, clear, THRESHOLDS, {"A": close})
    assert near[0].sigmas == 2.0
    assert "2 times the noise" in str(why_too_near("20000", near, ()))


@pytest.mark.parametrize("code", ["00000", "22222"])
def test_resting_shapes_are_no_gestures(code: str) -> None:
    assert "rests or carries" in str(why_too_near(code, [], ()))
