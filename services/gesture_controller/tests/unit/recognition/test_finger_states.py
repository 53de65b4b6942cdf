"""A finger is straight above its upper threshold, bent below its lower one, and between otherwise."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_gloves.recognition.finger_states import finger_states
from handover_gloves.recognition.thresholds import M2O2P_THRESHOLDS, Threshold, Thresholds

SAME = Thresholds((Threshold(600, 400),) * 5)


@pytest.mark.parametrize(
    ("bend", "states"),
    [
        ([900, 900, 900, 900, 900], "00000"),
        ([100, 100, 100, 100, 100], "22222"),
        ([500, 500, 500, 500, 500], "11111"),
        ([900, 100, 500, 100, 900], "02120"),
    ],
)
def test_each_finger_is_read_with_its_own_thresholds(bend: list[float], states: str) -> None:
    assert finger_states(bend, SAME) == states


def test_a_value_on_a_threshold_is_between() -> None:
    assert finger_states([600, 400, 600.001, 399.999, 500], SAME) == "11021"


def test_the_thresholds_shipped_by_m2o2p_read_thumbs_up() -> None:
    assert finger_states([1012, 640, 498, 701, 850], M2O2P_THRESHOLDS) == "02222"


@given(st.lists(st.floats(-1e6, 1e6), min_size=5, max_size=5))
def test_a_hand_has_five_states_whatever_it_sends(bend: list[float]) -> None:
    states = finger_states(bend, SAME)
    assert len(states) == 5
    assert set(states) <= set("012")
